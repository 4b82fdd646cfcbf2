"""The three pages: one self-contained HTML text each, readable from a file without a network."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import jinja2

from data_prep.log import Audit
from eval.report import event_figures, event_tables, figures, study_figures, tables
from eval.report.content import (
    EventTrace,
    LogPage,
    NoiseSweep,
    RunHeader,
    Scheme,
    WindowTrial,
)
from eval.report.panel import panel
from eval.report.style import symbol, unit
from eval.report.svg import Picture
from narxcal.atomic import atomic_write_text

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
