"""Tables of a page as records of text cells: what is in them, not how they look.

Tables of Ti and Tt: all events of a run, and one event beside its overlay.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import pandas as pd

from data_prep.log import Audit, AuditEntry, Source
from eval.report.content import (
    EventTrace,
    LogPage,
    NoiseSweep,
    Offsets,
    Response,
    Scheme,
    Score,
    WindowTrial,
)
from eval.report.style import unit, with_unit
from eval.transients import TimeCheck
from narxcal.channels import symbol

Mark = Literal["", "best", "good", "bad", "none", "strong", "head", "group"]
_OPTIONAL = {"untrimmed_rmse": "before trim", "bias": "bias"}
NOTHING = "\N{EN DASH}"
_MOST_NAMED = 2  # logs of a fold


@dataclass(frozen=True)
class Cell:
    """Text of one cell; `mark` says what it means, which the page turns into a look."""

    text: str
    mark: Mark = ""
    number: bool = False


@dataclass(frozen=True)
class Table:
    """A caption, a head and rows of cells; a row of one `group` cell titles those below it."""

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]

    @property
    def numeric(self) -> tuple[bool, ...]:
        """Which columns hold numbers, and so are set flush right."""
        columns = zip(*(row for row in self.rows if len(row) == len(self.head)), strict=True)
        found = tuple(any(cell.number for cell in column) for column in columns)
        return found or (False,) * len(self.head)


def number(value: float | None, digits: int = 3) -> str:
    """Print `digits` significant digits without an exponent; a dash for what does not exist."""
    if value is None or not math.isfinite(value):
        return NOTHING
    if value == 0.0:
        return "0"
    # The exponent after rounding: 0.9997 is 1.00, as 1.0004 is.
    decimals = max(0, digits - 1 - int(f"{value:.{digits - 1}e}".partition("e")[2]))
    return f"{value:.{min(decimals, 6)}f}"


def figure(value: float | None, mark: Mark = "", digits: int = 3) -> Cell:
    """Put a number into a cell."""
    return Cell(number(value, digits), mark, number=True)


def baseline_names(scores: Iterable[Score]) -> tuple[str, ...]:
    """All baselines that occur, in order of first appearance."""
    return tuple(dict.fromkeys(name for score in scores for name in score.baselines))


def scores(pages: Sequence[LogPage]) -> Table:
    """Free-run errors per log and channel beside the baselines; the lowest RMSE is marked."""
    every = [part for page in pages for part in page.scores]
    names = baseline_names(every)
    # A column is shown if any log has the figure.
    optional = [
        name
        for name in ("untrimmed_rmse", "bias")
        if any(math.isfinite(getattr(part, name)) for part in every)
    ]
    head = (
        "channel", "free run RMSE", *(_OPTIONAL[name] for name in optional), "NRMSE [%]",
        "max rel. [%]", "one step RMSE", "static part", "dynamic part",
        *(f"{name} RMSE" for name in names),
    )  # fmt: skip
    rows: list[tuple[Cell, ...]] = []
    for page in pages:
        role = f" ({page.role})" if page.role else ""
        rows.append((Cell(page.name + role, "group"),))
        rows += [_score_row(part, names, optional) for part in page.scores]
    return Table("RMSE, bias and parts in the unit of the channel", head, tuple(rows))


def best_of(score: Score) -> float:
    """Lowest RMSE among free run and baselines."""
    known = [score.rmse, *score.baselines.values()]
    return min((value for value in known if math.isfinite(value)), default=math.nan)


def _score_row(score: Score, names: Sequence[str], optional: Sequence[str]) -> tuple[Cell, ...]:
    best = best_of(score)
    others = [score.baselines.get(name, math.nan) for name in names]
    return (
        Cell(with_unit(score.channel), "head"),
        figure(score.rmse, "best" if score.rmse == best else ""),
        *(figure(getattr(score, name)) for name in optional),
        figure(100.0 * score.nrmse),
        figure(score.max_rel_pct),
        figure(score.one_step_rmse),
        figure(score.static_rmse),
        figure(score.dynamic_rmse),
        *(figure(value, "best" if value == best else "") for value in others),
    )


def offsets(part: Offsets, caption: str) -> Table:
    """Trim offsets per channel across the power levels (0 is idle, 1 is full power)."""
    rows = [
        (
            Cell(with_unit(name), "head"),
            *(Cell(f"{value:+.3g}", number=True) for value in values),
        )
        for name, values in part.added.items()
    ]
    return Table(caption, ("level", *(f"{level:.2g}" for level in part.levels)), tuple(rows))


def pearson(table: pd.DataFrame, caption: str, strong: float = 0.8) -> Table:
    """Pearson coefficients with the strong ones marked; inputs down, outputs across."""
    rows = [
        (
            Cell(symbol(str(name)), "head"),
            *(
                Cell(
                    f"{value:+.3f}" if math.isfinite(value) else NOTHING,
                    "strong" if abs(value) >= strong else "",
                    number=True,
                )
                for value in map(float, row)
            ),
        )
        for name, row in zip(table.index, table.to_numpy(dtype=float), strict=True)
    ]
    return Table(caption, ("input", *(symbol(str(name)) for name in table.columns)), tuple(rows))


def audit(record: Audit, caption: str) -> Table:
    """Everything that cleaning changed, per channel."""
    rows = []
    for entry in _together(record.entries):
        longest = "; ".join(f"{start:.1f} to {end:.1f}" for start, end in entry.spans_s[:6])
        more = f"; and {len(entry.spans_s) - 6} more" if len(entry.spans_s) > 6 else ""
        channel = "all channels" if entry.channel == "*" else entry.channel
        rows.append(
            (
                Cell(channel, "head"),
                Cell(entry.action),
                Cell(entry.reason),
                Cell(f"{entry.samples:,}", number=True),
                Cell(longest + more or NOTHING),
            )
        )
    return Table(caption, ("channel", "what", "why", "samples", "longer spans [s]"), tuple(rows))


def _together(entries: Iterable[AuditEntry]) -> list[AuditEntry]:
    """Entries of one channel, action and reason as one."""
    found: dict[tuple[str, str, str], AuditEntry] = {}
    for entry in entries:
        key = entry.channel, entry.action, entry.reason
        last = found.get(key)
        found[key] = (
            entry
            if last is None
            else replace(
                entry,
                samples=last.samples + entry.samples,
                spans_s=(*last.spans_s, *entry.spans_s),
            )
        )
    return list(found.values())


def sources(files: Sequence[Source]) -> Table:
    """Every data file with its hash, which pins exactly what was evaluated."""
    rows = [
        (Cell(part.file, "head"), Cell(part.engine or NOTHING), Cell(part.sha256 or NOTHING))
        for part in files
    ]
    return Table("Data", ("file", "engine", "SHA-256"), tuple(rows))


def windows(trials: Sequence[WindowTrial]) -> Table:
    """RMS error that each smoothing window leaves, per log and channel, the chosen one marked."""
    widths = sorted({width for trial in trials for part in trial.rms.values() for width in part})
    rows = [
        (
            Cell(trial.log, "head"),
            Cell(symbol(channel)),
            Cell(unit(channel)),
            *(figure(part.get(width), "best" if width == trial.chosen else "") for width in widths),
        )
        for trial in trials
        for channel, part in trial.rms.items()
    ]
    head = ("log", "channel", "unit", *(f"{width} samples" for width in widths))
    return Table("RMS of smoothed minus unsmoothed signal, by window", head, tuple(rows))


def folds(scheme: Scheme) -> Table:
    """Every fold, then mean, standard deviation, least and greatest of each measure."""
    head = (
        "fold",
        "test data",
        *(f"{part.label} [{part.unit}]" if part.unit else part.label for part in scheme.measures),
    )
    rows = []
    for fold in scheme.folds:
        values = [fold.results.get(part.key, math.nan) for part in scheme.measures]
        marks: list[Mark] = [
            "bad" if part.limit is not None and value > part.limit else ""
            for part, value in zip(scheme.measures, values, strict=True)
        ]
        cells = [figure(value, mark) for value, mark in zip(values, marks, strict=True)]
        rows.append((Cell(fold.name, "head"), Cell(_brief(fold.test)), *cells))
    for name, spread in summary(scheme).items():
        rows.append(
            (
                Cell(name, "strong"),
                Cell("", "strong"),
                *(Cell(number(value), "strong", number=True) for value in spread),
            )
        )
    return Table("", head, tuple(rows))


def _brief(data: str) -> str:
    """Test data of a fold, counted where they are too many to name in a cell."""
    names = data.split(", ")
    if len(names) <= _MOST_NAMED:
        return data
    parts = sum(int(found) for found in re.findall(r"\((\d+) parts?\)", data))
    return f"{len(names)} logs" + (f" ({parts} parts)" if parts else "")


def summary(scheme: Scheme) -> Mapping[str, list[float]]:
    """Mean, sample standard deviation, least and greatest per measure, missing folds left out."""
    table = pd.DataFrame(
        [
            [fold.results.get(part.key, math.nan) for part in scheme.measures]
            for fold in scheme.folds
        ]
    )
    columns = {"mean": table.mean(), "std": table.std(), "min": table.min(), "max": table.max()}
    return {name: [float(value) for value in part] for name, part in columns.items()}


def noise(sweep: NoiseSweep) -> Table:
    """RMSE against the clean signal at each signal-to-noise ratio; the lowest is marked."""
    head = ("SNR [dB]", *sweep.curves, *(("mean NIS",) if sweep.nis is not None else ()))
    rows = []
    for at, ratio in enumerate(sweep.snr_db):
        values = [float(curve[at]) for curve in sweep.curves.values()]
        least = min((value for value in values if math.isfinite(value)), default=math.nan)
        cells = [figure(value, "best" if value == least else "") for value in values]
        check = [figure(float(sweep.nis[at]))] if sweep.nis is not None else []
        rows.append((Cell(f"{ratio:g}", "head"), *cells, *check))
    caption = f"{sweep.log}: RMSE of {with_unit(sweep.channel)} against the clean signal"
    return Table(caption, head, tuple(rows))


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
