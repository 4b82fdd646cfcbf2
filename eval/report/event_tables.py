"""Tables of Ti and Tt: all events of a run, and one event beside its overlay."""

from __future__ import annotations

from collections.abc import Sequence

from eval.report.content import EventTrace, LogPage, Response
from eval.report.style import symbol
from eval.report.tables import NOTHING, Cell, Mark, Table, figure
from eval.transients import TimeCheck


def transients(pages: Sequence[LogPage]) -> Table:
    """Ti and Tt of every event and channel: flight, model, difference, allowed, outcome."""
    head = (
        "start [s]", "move", "channel", "Ti flight [s]", "Ti model [s]", "ΔTi [s]", "allowed [s]",
        "Tt flight [s]", "Tt model [s]", "ΔTt [s]", "allowed [s]", "outcome",
    )  # fmt: skip
    rows: list[tuple[Cell, ...]] = []
    for page in pages:
        rows.append((Cell(page.name, "group"),))
        rows += [
            _transient_row(trace, channel, response)
            for trace in page.events
            for channel, response in trace.responses.items()
        ]
    return Table("Ti and Tt of every event; differences are model minus flight", head, tuple(rows))


def tallies(pages: Sequence[LogPage]) -> Table:
    """Ti and Tt of the model beside those of the baselines, on the same events."""
    head = (
        "model", "passed", "assessed", "passed [%]", "mean |ΔTi| [%]", "mean |ΔTt| [%]",
        "mean |ΔTi| [s]", "mean |ΔTt| [s]",
    )  # fmt: skip
    rows: list[tuple[Cell, ...]] = []
    for page in pages:
        rows.append((Cell(page.name, "group"),))
        for name, part in page.tallies.items():
            values = (
                part.passed_pct, part.mean_relative_Ti_pct, part.mean_relative_Tt_pct,
                part.mean_absolute_Ti_s, part.mean_absolute_Tt_s,
            )  # fmt: skip
            counts = [Cell(str(number), number=True) for number in (part.passed, part.assessed)]
            rows.append((Cell(name, "head"), *counts, *(figure(value) for value in values)))
    caption = "Times read as 100 % wrong where a model failed before they could be compared"
    return Table(caption, head, tuple(rows))


def event_times(trace: EventTrace) -> Table:
    """Build the same figures for one event, to stand beside its overlay."""
    head = ("channel", "", "flight [s]", "model [s]", "Δ [s]", "|Δ| [%]", "allowed [s]", "outcome")
    rows: list[tuple[Cell, ...]] = []
    for channel, response in trace.responses.items():
        verdict, name = response.verdict, Cell(symbol(channel), "head")
        if verdict is None or verdict.Ti is None or verdict.Tt is None:
            rows.append((name, *[Cell(NOTHING, number=True)] * 6, outcome(response)))
            continue
        rows += [
            (name, Cell(time), *_check_cells(check), _passed(check))
            for time, check in (("Ti", verdict.Ti), ("Tt", verdict.Tt))
        ]
    return Table("", head, tuple(rows))


def outcome(response: Response) -> Cell:
    """`pass`, `fail` or `not assessable`, with the reason where there is one."""
    verdict = response.verdict
    if verdict is None:
        return Cell(response.flight.reason or NOTHING, "none")
    reason = f": {verdict.reason}" if verdict.reason else ""
    if verdict.ok is None:
        return Cell(f"not assessable{reason}", "none")
    return Cell(f"✓ pass{reason}", "good") if verdict.ok else Cell(f"✗ fail{reason}", "bad")


def move(trace: EventTrace) -> str:
    """`fast push`, `slow pull, interrupted`."""
    text = f"{trace.event.speed} {'push' if trace.event.label == 0 else 'pull'}"
    return f"{text}, interrupted" if trace.event.interrupted else text


def _check_cells(check: TimeCheck) -> tuple[Cell, ...]:
    return (
        figure(check.flight_s),
        figure(check.model_s),
        Cell(f"{check.error_s:+.3f}", number=True),
        Cell(f"{100.0 * check.relative:.1f}", number=True),
        figure(check.allowed_s),
    )


def _passed(check: TimeCheck) -> Cell:
    return Cell("✓ pass", "good") if check.ok else Cell("✗ fail", "bad")


def _transient_row(trace: EventTrace, channel: str, response: Response) -> tuple[Cell, ...]:
    verdict, flight, model = response.verdict, response.flight, response.model
    own = (model.Ti_s, model.Tt_s) if model else (None, None)
    return (
        Cell(f"{trace.event.start_s:.1f}", number=True),
        Cell(move(trace)),
        Cell(symbol(channel)),
        *_times(verdict.Ti if verdict else None, flight.Ti_s, own[0]),
        *_times(verdict.Tt if verdict else None, flight.Tt_s, own[1]),
        outcome(response),
    )


def _times(check: TimeCheck | None, flight_s: float, model_s: float | None) -> tuple[Cell, ...]:
    """Flight, model, difference and allowed; what was read though it was not compared."""
    if check is None:
        return (
            figure(flight_s),
            figure(model_s),
            Cell(NOTHING, number=True),
            Cell(NOTHING, number=True),
        )
    mark: Mark = "" if check.ok else "bad"
    return (
        figure(check.flight_s),
        figure(check.model_s),
        Cell(f"{check.error_s:+.3f}", mark, number=True),
        figure(check.allowed_s),
    )
