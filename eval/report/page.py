"""The three pages: one self-contained HTML text each, readable from a file without a network.

What a reproduced study puts on its page: the paper's claims beside ours, tables, figures.

The page of a reproduced paper: every claim in one table, then study by study.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import jinja2

from data_prep.log import Audit
from eval.report import event_figures, figures, tables
from eval.report import figures as study_figures
from eval.report import tables as event_tables
from eval.report.content import (
    EventTrace,
    LogPage,
    NoiseSweep,
    RunHeader,
    Scheme,
    WindowTrial,
)
from eval.report.panel import panel
from eval.report.style import Picture, unit
from eval.report.tables import NOTHING, Cell, Table, number
from narxcal.channels import symbol
from narxcal.support.files import atomic_write_text

WORST_EVENTS = 3


@dataclass(frozen=True)
class Outcome:
    """The verdict box: `passed` is None where nothing could be assessed."""

    passed: bool | None
    headline: str
    lines: tuple[str, ...] = ()


@dataclass(frozen=True)
class Count:
    """Events of some logs, and their readings: one reading is one event on one channel."""

    events: int = 0
    events_assessed: int = 0
    events_passed: int = 0
    assessed: int = 0
    passed: int = 0
    not_assessable: int = 0


def count(pages: Sequence[LogPage]) -> Count:
    """Count over all logs; an event passes if every assessable channel of it does."""
    traces = [trace for page in pages for trace in page.events]
    whole = [trace.ok for trace in traces]
    parts = [
        response.verdict.ok
        for trace in traces
        for response in trace.responses.values()
        if response.verdict is not None
    ]
    return Count(
        events=len(traces),
        events_assessed=sum(ok is not None for ok in whole),
        events_passed=sum(ok is True for ok in whole),
        assessed=sum(ok is not None for ok in parts),
        passed=sum(ok is True for ok in parts),
        not_assessable=sum(ok is None for ok in parts),
    )


def outcome(header: RunHeader, pages: Sequence[LogPage]) -> Outcome:
    """Put the counts into a verdict and into words."""
    found = count(pages)
    lines = [_ranking(page) for page in pages if page.scores]
    if not found.assessed:
        return Outcome(None, "No event could be assessed for Ti and Tt", tuple(lines))
    share = 100.0 * found.passed / found.assessed
    rules = f"the '{header.rules}' rules" if header.rules else "the rules"
    headline = f"{found.passed} of {found.assessed} assessable transients ({share:.0f} %) meet "
    headline += f"{rules} for Ti and Tt"
    lines.insert(
        0, f"{found.events_passed} of {_events(found.events_assessed)} pass in every channel."
    )
    if found.not_assessable:
        lines.insert(
            1,
            f"{found.not_assessable} {'transient' if found.not_assessable == 1 else 'transients'} "
            "could not be assessed and count neither way; the reason stands beside each.",
        )
    return Outcome(found.passed == found.assessed, headline, tuple(lines))


def _events(number: int) -> str:
    return f"{number} event" if number == 1 else f"{number} events"


def _ranking(page: LogPage) -> str:
    """Say in which channels the model beats every baseline, and in which it does not."""
    best = {part.channel: (part.rmse, tables.best_of(part)) for part in page.scores}
    won = [symbol(name) for name, (own, least) in best.items() if own == least]
    lost = [symbol(name) for name, (own, least) in best.items() if own > least]
    if not any(part.baselines for part in page.scores):
        return f"{page.name}: no baselines were run."
    text = f"{page.name}: lowest free-run RMSE of all models in {', '.join(won) or 'no channel'}"
    return f"{text}; a baseline does better in {', '.join(lost)}." if lost else f"{text}."


def evaluate_page(
    header: RunHeader,
    pages: Sequence[LogPage],
    verdict: Outcome | None = None,
    sweeps: Sequence[NoiseSweep] = (),
) -> str:
    """Build the page of `evaluate` and `demo`.

    Without a `verdict` the page passes if every assessable event does; `sweeps` adds the
    denoising experiment.
    """
    return render(
        "evaluate.html.j2",
        header=header,
        outcome=verdict or outcome(header, pages),
        count=count(pages),
        logs=pages,
        sweeps=[study_figures.noise(sweep) for sweep in sweeps],
    )


def prepare_page(
    header: RunHeader, pages: Sequence[LogPage], trials: Sequence[WindowTrial] = ()
) -> str:
    """Build the page of `prepare`: windows compared, ranking, events and the audit; no model."""
    return render("prepare.html.j2", header=header, logs=pages, trials=trials, count=count(pages))


def crossval_page(header: RunHeader, schemes: Sequence[Scheme]) -> str:
    """Build the page of `crossval`: every fold, and the spread over the folds."""
    measures = list(dict.fromkeys(part for scheme in schemes for part in scheme.measures))
    drawing = study_figures.spread(schemes, measures) if measures else None
    return render("crossval.html.j2", header=header, schemes=schemes, spread=drawing)


def noise_page(header: RunHeader, verdict: Outcome, sweeps: Sequence[NoiseSweep]) -> str:
    """Build the page of `denoise`: the paper's noise experiment on its own."""
    return render("denoise.html.j2", header=header, outcome=verdict, sweeps=sweeps)


def write_page(path: str | os.PathLike[str], html: str) -> None:
    """Write the page whole or not at all."""
    atomic_write_text(path, html)


def worst_events(page: LogPage) -> list[EventTrace]:
    """Events to show large: the failed ones first, then those nearest to their tolerance."""
    judged = [trace for trace in page.events if trace.ok is not None]
    return sorted(judged, key=lambda trace: -trace.severity)[:WORST_EVENTS]


def status(trace: EventTrace) -> str:
    """Return `pass`, `fail`, `none` (not assessable) or empty (nothing to judge)."""
    if not any(part.verdict for part in trace.responses.values()):
        return ""
    return {True: "pass", False: "fail", None: "none"}[trace.ok]


def reasons(trace: EventTrace) -> list[str]:
    """Why channels of the event failed early or are not assessable, equal reasons together."""
    found: dict[str, list[str]] = {}
    for channel, response in trace.responses.items():
        reason = response.verdict.reason if response.verdict else response.flight.reason
        if reason:
            found.setdefault(reason, []).append(symbol(channel))
    return [f"{', '.join(channels)}: {reason}" for reason, channels in found.items()]


def conditions(trace: EventTrace) -> str:
    """Initial conditions in one line, as a qualification page has to state them."""
    return ", ".join(
        f"{symbol(name)} {value:.3g} {unit(name)}".strip()
        if abs(value) < 1000
        else f"{symbol(name)} {value:.0f} {unit(name)}".strip()
        for name, value in trace.conditions.items()
        if math.isfinite(value)
    )


def masked_share(audit: Audit) -> int:
    """Return the samples that cleaning masked in all."""
    return sum(entry.samples for entry in audit.entries if entry.action == "masked")


def panels(page: LogPage) -> list[tuple[EventTrace, Picture]]:
    """Draw the contact sheet of one log."""
    return [(trace, panel(trace, page.driver_name)) for trace in page.events]


@cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("eval.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    for room in (tables, event_tables, figures, event_figures, study_figures):
        environment.globals[room.__name__.rpartition(".")[2]] = room
    for helper in (symbol, unit, worst_events, panels, masked_share):
        environment.globals[helper.__name__] = helper
    environment.filters.update(status=status, reasons=reasons, conditions=conditions)
    environment.filters["basename"] = os.path.basename
    return environment


def render(template: str, **content: object) -> str:
    """Fill a template of this package."""
    return _environment().get_template(template).render(**content)


@dataclass(frozen=True, kw_only=True)
class Claim:
    """One claim and what we found; `origin` says who makes it: the paper, or our own goal.

    `value` in `unit` is held against `bound`: `below` says on which side it has to be. `met` is
    None where there was nothing to measure. `remark` is for the reader, above all where ours is
    the worse figure.
    """

    what: str
    claimed: str
    value: float
    bound: float
    unit: str = ""
    below: bool = True
    origin: str = "paper"
    remark: str = ""

    @property
    def met(self) -> bool | None:
        """Whether the value is on the good side of the bound."""
        if not math.isfinite(self.value):
            return None
        return self.value < self.bound if self.below else self.value >= self.bound

    @property
    def ours(self) -> str:
        """The value in words."""
        whole = math.isfinite(self.value) and float(self.value).is_integer()
        text = f"{self.value:.0f}" if whole else number(self.value)
        return f"{text} {self.unit}" if self.unit and text != NOTHING else text

    def row(self) -> dict[str, Any]:
        """JSON-able values; None where nothing was measured."""
        return {
            "what": self.what,
            "origin": self.origin,
            "claimed": self.claimed,
            "ours": self.value if math.isfinite(self.value) else None,
            "unit": self.unit,
            "bound": self.bound,
            "met": self.met,
            "remark": self.remark,
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class Study:
    """One study of a paper: `source` is where the paper has it, `text` how ours was done.

    `results` is what `reproduce.json` holds of it, beside the claims; `sheets` are logs of
    which every event is drawn.
    """

    key: str
    title: str
    source: str
    text: str
    claims: Sequence[Claim] = ()
    tables: Sequence[Table] = ()
    pictures: Sequence[Picture] = ()
    sheets: Sequence[LogPage] = ()
    results: Mapping[str, Any] = field(default_factory=dict)

    def row(self) -> dict[str, Any]:
        """One entry of `studies`."""
        return {
            "study": self.key,
            "title": self.title,
            "source": self.source,
            "claims": [claim.row() for claim in self.claims],
            **self.results,
        }


def or_nan(value: float | None) -> float:
    """Turn what a table leaves out into what a claim leaves open."""
    return math.nan if value is None else float(value)


def claim_table(claims: Sequence[Claim], caption: str = "") -> Table:
    """Each claim with our figure beside it and, where ours falls short, a mark."""
    remarks = any(claim.remark for claim in claims)
    head = ("claim", "made by", "claimed", "ours", "outcome", *(("remark",) if remarks else ()))
    rows = tuple(
        (
            Cell(claim.what, "head"),
            Cell(claim.origin),
            Cell(claim.claimed),
            Cell(claim.ours, number=True),
            _outcome(claim),
            *((Cell(claim.remark),) if remarks else ()),
        )
        for claim in claims
    )
    return Table(caption, head, rows)


def _outcome(claim: Claim) -> Cell:
    if claim.met is None:
        return Cell("not measured", "none")
    return Cell("✓ reached", "good") if claim.met else Cell("✗ not reached", "bad")


def reproduction_page(header: RunHeader, studies: Sequence[Study]) -> str:
    """Build the page; it passes where no claim was missed."""
    return render(
        "reproduce.html.j2",
        header=header,
        outcome=outcome_of(studies),
        studies=studies,
        claim_table=claim_table,
    )


def outcome_of(studies: Sequence[Study]) -> Outcome:
    """Count the claims reached, and name those that are not."""
    judged = [claim for study in studies for claim in study.claims if claim.met is not None]
    reached = sum(claim.met is True for claim in judged)
    missed = [
        f"{claim.what}: {claim.ours}, not {claim.claimed}." for claim in judged if not claim.met
    ]
    headline = f"{reached} of {len(judged)} claims are reached"
    passed = not missed if judged else None
    return Outcome(passed, headline, (*counts(judged), *missed))


def counts(judged: Sequence[Claim]) -> list[str]:
    """Say how many claims of the paper, and how many goals of our own, are reached."""
    lines = []
    for origin in dict.fromkeys(claim.origin for claim in judged):
        own = [claim.met is True for claim in judged if claim.origin == origin]
        whose = "the paper's claims" if origin == "paper" else "our own goals"
        lines.append(f"{sum(own)} of {len(own)} of {whose} are reached.")
    return lines
