"""Pages: each one self-contained HTML text, readable from a file without a network."""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import cache
from typing import TYPE_CHECKING, Any

import jinja2
from markupsafe import Markup

from data_prep.log import Audit, Source
from eval.judging.outcome import Outcome
from eval.report import event_figures, figures, live, tables
from eval.report.style import unit
from eval.report.view import LogView
from narxcal.channels import symbol
from narxcal.support.files import versions
from training.responses.transients import AssessedEvent, tally

if TYPE_CHECKING:
    from eval.judging.compare import Comparison
    from eval.judging.crossval import CrossValidation

WORST_EVENTS = 3


def now() -> str:
    return datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")


@dataclass(frozen=True, kw_only=True)
class RunHeader:
    """What a qualification page must say about where it comes from.

    `created` is a text such as `2026-11-21 02:05 UTC`; `versions` are those of this process by
    default; `rules` names the Ti/Tt rule set and
    `tolerances` spells it out; `facts` are further label -> text pairs (split, seeds, hardware,
    command line); `config` is the resolved configuration as text; `cautions` are warnings that a
    reader needs before the figures.
    """

    title: str
    created: str = field(default_factory=now)
    run: str = ""
    model: str = ""
    rules: str = ""
    tolerances: str = ""
    sources: Sequence[Source] = ()
    versions: Mapping[str, str] = field(default_factory=versions)
    facts: Mapping[str, str] = field(default_factory=dict)
    config: str = ""
    cautions: Sequence[str] = ()


def evaluate_page(header: RunHeader, views: Sequence[LogView], outcome: Outcome) -> str:
    assessments = [each for view in views for each in view.assessments]
    return render(
        "evaluate.html.j2",
        header=header,
        outcome=outcome,
        events=sum(len(view.events) for view in views),
        count=tally(assessments),
        assessments=assessments,
        logs=views,
    )


@dataclass(frozen=True, eq=False)
class PreparedLog:
    """One log on the page of `prepare`, as HTML that was made while the log was in memory.

    `number` names its events on the page. The HTML is compressed: that of a thousand hours of
    flight takes a quarter of a gigabyte.
    """

    name: str
    number: str
    events: int
    trial: tables.WindowTrial
    parts: Mapping[str, bytes]

    @classmethod
    def of(cls, view: LogView, trial: tables.WindowTrial, number: str) -> PreparedLog:
        """Make the tables of one log."""
        macros = _macros()
        parts = {"ranking": macros.rankings([view]), "audit": macros.audits([view])}
        return cls(view.name, number, len(view.events), trial, _packed(parts))

    def with_pictures(self, view: LogView) -> PreparedLog:
        """Add the pictures of the log, nine tenths of the time of `prepare`."""
        macros = _macros()
        parts = {
            "overlay": macros.draw(figures.overlay(view), live.of_log(view)),
            "windows": macros.draw(figures.windows(self.trial)),
            "events": macros.contact_sheet(view, self.number),
        }
        return replace(self, parts={**self.parts, **_packed(parts)})

    @property
    def drawn(self) -> bool:
        return "overlay" in self.parts

    def part(self, name: str) -> Markup:
        """HTML of `ranking` or `audit`; with pictures, of `overlay`, `windows` or `events`."""
        return Markup(zlib.decompress(self.parts[name]).decode())  # noqa: S704 - escaped when drawn


def _macros() -> Any:
    return _environment().get_template("macros.html.j2").module


def _packed(parts: Mapping[str, str]) -> dict[str, bytes]:
    return {name: zlib.compress(html.encode(), 1) for name, html in parts.items()}


def prepare_page(header: RunHeader, logs: Sequence[PreparedLog]) -> Iterator[str]:
    """Yield the page of `prepare`: windows compared, ranking, events and the audit; no model."""
    events = sum(log.events for log in logs)
    template = _environment().get_template("prepare.html.j2")
    undrawn = [log for log in logs if not log.drawn]
    return template.generate(header=header, logs=logs, events=events, undrawn=undrawn)


def crossval_page(header: RunHeader, found: CrossValidation) -> str:
    return render("crossval.html.j2", header=header, outcome=found.outcome, found=found)


def compare_page(header: RunHeader, found: Comparison) -> str:
    return render("compare.html.j2", header=header, found=found)


def worst_events(view: LogView) -> list[AssessedEvent]:
    """Events to show large: the failed ones first, then those nearest to their tolerance."""
    judged = [event for event in view.events if event.ok is not None]
    return sorted(judged, key=lambda event: -event.severity)[:WORST_EVENTS]


def status(event: AssessedEvent) -> str:
    """Return `pass`, `fail`, `none` (not assessable) or empty (nothing to judge)."""
    return {True: "pass", False: "fail", None: "none"}[event.ok] if event.assessments else ""


def reasons(event: AssessedEvent) -> list[str]:
    """Why channels of the event failed early or are not assessable, equal reasons together."""
    found: dict[str, list[str]] = {}
    for one in event.assessments:
        if one.verdict.reason:
            found.setdefault(one.verdict.reason, []).append(symbol(one.channel))
    return [f"{', '.join(channels)}: {reason}" for reason, channels in found.items()]


def conditions(view: LogView, event: AssessedEvent) -> str:
    """Initial conditions in one line, as a qualification page has to state them."""
    return ", ".join(
        f"{symbol(name)} {value:{'.3g' if abs(value) < 1000 else '.0f'}} {unit(name)}".strip()
        for name, value in view.conditions(event.event).items()
    )


def masked_share(audit: Audit) -> int:
    return sum(entry.samples for entry in audit.entries if entry.action == "masked")


@cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("eval.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals.update(
        tables=tables, figures=figures, event_figures=event_figures, live=live
    )
    for helper in (symbol, unit, worst_events, masked_share, conditions):
        environment.globals[helper.__name__] = helper
    environment.filters.update(status=status, reasons=reasons, basename=os.path.basename)
    return environment


def render(template: str, **content: object) -> str:
    return _environment().get_template(template).render(**content)
