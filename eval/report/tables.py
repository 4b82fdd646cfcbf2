"""Tables of a page as records of text cells: what is in them, not how they look."""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
import pandas as pd
from markupsafe import escape

from data_prep.log import Audit, AuditEntry, Source
from eval.report.style import NOTHING, number, unit, with_unit
from eval.report.view import LogView
from eval.rules import TimeCheck
from eval.transients import AssessedEvent, Assessment, not_assessable, tally
from narxcal.channels import symbol
from narxcal.intervals import LEVEL

if TYPE_CHECKING:
    from eval.compare import Comparison, Row
    from eval.crossval import CrossValidation, FoldResult
    from eval.denoising import NoiseSweep
    from eval.report.figures import WindowTrial
    from eval.scores import ChannelScores
    from eval.trim import Trim

Mark = Literal["", "best", "good", "bad", "none", "strong", "head", "group"]
BASELINES = {"steady_state": "steady state", "first_order": "first order", "arx": "ARX"}
_MOST_NAMED = 2  # logs of a fold


@dataclass(frozen=True)
class Cell:
    """Text of one cell; `mark` is its meaning, which the page turns into a style."""

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


def figure(value: float | None, mark: Mark = "", digits: int = 3) -> Cell:
    """Put a number into a cell."""
    return Cell(number(value, digits), mark, number=True)


def scores(views: Sequence[LogView]) -> Table:
    """Free-run errors of model and baselines per log and channel; the lowest RMSE is marked."""
    trim = any(one.evaluation.untrimmed for one in views if one.evaluation is not None)
    led = any(
        found.network_rmse != found.rmse
        for one in views if one.evaluation is not None
        for found in one.evaluation.scores.values() if math.isfinite(found.rmse)
    )  # fmt: skip
    band = any(
        math.isfinite(found.coverage)
        for one in views if one.evaluation is not None
        for found in one.evaluation.scores.values()
    )  # fmt: skip
    covered = (f"in {100 * LEVEL:.0f} % interval [%]", "half-width") if band else ()
    head = (
        "channel", "free run RMSE", *(("network RMSE",) if led else ()),
        *(("before trim",) if trim else ()), "bias", "NRMSE [%]",
        "max rel. [%]", "one step RMSE", "static part", "dynamic part",
        *covered, *(f"{name} RMSE" for name in BASELINES.values()),
    )  # fmt: skip
    rows: list[tuple[Cell, ...]] = []
    for view in views:
        if view.evaluation is None:
            continue
        rows.append((Cell(f"{view.name} ({view.evaluation.role})", "group"),))
        for name, found in view.evaluation.scores.items():
            before = view.evaluation.untrimmed.get(name)
            more: tuple[Cell, ...] = (figure(found.network_rmse),) if led else ()
            more += (figure(None if before is None else before.rmse),) if trim else ()
            ends = (figure(100.0 * found.coverage), figure(found.half_width)) if band else ()
            rows.append(_score_row(name, found, more, ends))
    return Table("RMSE, bias and parts in the unit of the channel", head, tuple(rows))


def _score_row(
    name: str, found: ChannelScores, more: tuple[Cell, ...], ends: tuple[Cell, ...]
) -> tuple[Cell, ...]:
    best = found.best_rmse
    return (
        Cell(with_unit(name), "head"),
        figure(found.rmse, "best" if found.rmse == best else ""),
        *more,
        figure(found.bias),
        figure(100.0 * found.nrmse),
        figure(found.max_rel_pct),
        figure(found.one_step_rmse),
        figure(found.static_rmse),
        figure(found.dynamic_rmse),
        *ends,
        *(figure(value, "best" if value == best else "") for value in found.baselines.values()),
    )


def offsets(trim: Trim, channels: Sequence[str], caption: str) -> Table:
    """Trim offsets per channel and altitude across the levels (0 is idle, 1 is full power)."""
    rows = [
        (
            Cell(with_unit(name), "head"),
            Cell(f"{altitude_ft:,.0f}", number=True),
            *(Cell(f"{value:+.3g}", number=True) for value in values),
        )
        for name, table in zip(channels, np.moveaxis(trim.offsets, 2, 0).tolist(), strict=True)
        for altitude_ft, values in zip(trim.altitudes_ft.tolist(), table, strict=True)
    ]
    head = ("channel", "altitude [ft]", *(f"level {level:.2g}" for level in trim.nodes))
    return Table(caption, head, tuple(rows))


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


@dataclass(frozen=True)
class Measure:
    """One column of a cross-validation: `key` into the values of a fold, and how to print it."""

    key: str
    label: str
    unit: str = ""
    limit: float | None = None

    @property
    def title(self) -> str:
        """The label with its unit."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label


def measures(found: CrossValidation) -> list[Measure]:
    """Columns of all schemes: errors of every channel, then the response times."""
    keys = dict.fromkeys(key for fold in found.folds for key in fold.figures)
    columns = []
    for kind, label in _KINDS.items():
        for key in keys:
            head, _, channel = key.partition(".")
            if head == kind:
                of = "%" if kind == "max_rel_pct" else unit(channel)
                bound = found.settings.largest_rmse.get(channel) if kind == "rmse" else None
                columns.append(Measure(key, f"{symbol(channel)} {label}", of, bound))
    columns += [Measure(key, label, "%") for key, label in _TIMES.items()]
    return [*columns, Measure("passed_pct", "Ti/Tt passed", "%")]


_KINDS = {"rmse": "RMSE", "worst_rmse": "worst RMSE", "max_rel_pct": "max rel. error"}
_TIMES = {
    "mean_relative_Ti_pct": "mean rel. error of Ti",
    "mean_relative_Tt_pct": "mean rel. error of Tt",
}


def folds(found: CrossValidation, scheme: str) -> Table:
    """Every fold of a scheme, then mean, standard deviation, least and greatest."""
    columns, rows = measures(found), []
    for fold in found.schemes[scheme]:
        cells = []
        for column in columns:
            value = fold.figures.get(column.key)
            bad = value is not None and column.limit is not None and value > column.limit
            cells.append(figure(value, "bad" if bad else ""))
        rows.append((Cell(fold_name(fold), "head"), Cell(_brief(fold.test)), *cells))
    spread = found.spread(scheme)
    for name in ("mean", "std", "min", "max"):
        values = [spread.get(column.key, {}).get(name) for column in columns]
        cells = [Cell(number(value), "strong", number=True) for value in values]
        rows.append((Cell(name, "strong"), Cell("", "strong"), *cells))
    return Table("", ("fold", "test data", *(column.title for column in columns)), tuple(rows))


def fold_name(fold: FoldResult) -> str:
    """Its name, and the seed that drew it."""
    return fold.name if fold.seed is None else f"{fold.name}, seed {fold.seed}"


def listed(names: Sequence[str]) -> str:
    """Name whole logs; of segments cut from logs, how many there are from each."""
    counts = _segments(names)
    cut = any("[" in name for name in names)
    return ", ".join(
        f"{name} ({n} {'part' if n == 1 else 'parts'})" if cut else name
        for name, n in counts.items()
    )


def _brief(names: Sequence[str]) -> str:
    """As `listed`, but counted where they are too many to name in a cell."""
    counts = _segments(names)
    if len(counts) <= _MOST_NAMED:
        return listed(names)
    cut = any("[" in name for name in names)
    return f"{len(counts)} logs" + (f" ({len(names)} parts)" if cut else "")


def _segments(names: Sequence[str]) -> Counter[str]:
    """Log -> how many of `names` are segments of it (or itself), in order of appearance."""
    return Counter(name.partition("[")[0] for name in names)


def noise(sweep: NoiseSweep) -> Table:
    """RMSE against the clean signal at each signal-to-noise ratio; the lowest is marked."""
    curves = sweep.curves
    rows = []
    for at, (ratio, nis) in enumerate(
        zip(sweep.table["snr_db"], sweep.table["mean_nis"], strict=True)
    ):
        values = [float(curve[at]) for curve in curves.values()]
        least = min((value for value in values if math.isfinite(value)), default=math.nan)
        cells = [figure(value, "best" if value == least else "") for value in values]
        rows.append((Cell(f"{ratio:g}", "head"), *cells, figure(float(nis))))
    caption = f"{sweep.log}: RMSE of {with_unit(sweep.channel)} against the clean signal"
    return Table(caption, ("SNR [dB]", *curves, "mean NIS"), tuple(rows))


def transients(views: Sequence[LogView], *, assessable: bool) -> Table:
    """Ti and Tt of every event and channel that could be assessed, or of those that could not."""
    head = (
        "start [s]", "move", "channel", "Ti flight [s]", "Ti model [s]", "ΔTi [s]", "allowed [s]",
        "Tt flight [s]", "Tt model [s]", "ΔTt [s]", "allowed [s]", "outcome",
    )  # fmt: skip
    rows: list[tuple[Cell, ...]] = []
    for view in views:
        own = [
            _transient_row(event, one)
            for event in view.events
            for one in event.assessments
            if (one.verdict.ok is not None) is assessable
        ]
        rows += [(Cell(view.name, "group"),), *own] if own else []
    caption = "Differences are model minus flight" if assessable else ""
    return Table(caption, head, tuple(rows))


def reasons(assessments: Sequence[Assessment]) -> Table:
    """Why transients could not be assessed, the most frequent reason first.

    Events of different lengths count together.
    """
    found: Counter[str] = Counter()
    for reason, count in not_assessable(assessments).items():
        found[re.sub(r"\.\. of \d+ samples", ".. samples", reason)] += count
    rows = [(Cell(reason), Cell(str(count), number=True)) for reason, count in found.most_common()]
    return Table("", ("reason", "transients"), tuple(rows))


def _seconds(time_s: float | None) -> str:
    return "" if time_s is None else f"{time_s:.1f}"


def findings(views: Sequence[LogView]) -> Table:
    """What the logs show to be wrong; without times the whole of a log."""
    rows: list[tuple[Cell, ...]] = []
    for view in views:
        own = [
            (
                Cell(", ".join(symbol(name) for name in each.channels), "head"),
                Cell(each.kind),
                Cell(_seconds(each.start_s), number=True),
                Cell(_seconds(each.end_s), number=True),
                Cell(f"{each.probability:.3f}", number=True),
                Cell(f"{each.evidence}. {each.remedy}" if each.remedy else each.evidence),
            )
            for each in view.log.findings
        ]
        rows += [(Cell(view.name, "group"),), *own] if own else []
    return Table("", ("channel", "kind", "from [s]", "to [s]", "probability", "what"), tuple(rows))


def masked_scores(views: Sequence[LogView]) -> Table:
    """RMSE with the masks of findings, and on the logs as recorded."""
    rows: list[tuple[Cell, ...]] = []
    for view in views:
        found = view.evaluation
        if found is None or not found.as_recorded:
            continue
        rows.append((Cell(view.name, "group"),))
        for name, before in found.as_recorded.items():
            share = Cell(f"{100.0 * found.faulty.get(name, 0.0):.1f}", number=True)
            pair = figure(found.scores[name].rmse), figure(before.rmse)
            rows.append((Cell(with_unit(name), "head"), share, *pair))
    head = ("RMSE of", "masked [%]", "with masks", "as recorded")
    return Table("Masking improves a score by itself: both stand here", head, tuple(rows))


def levels(views: Sequence[LogView]) -> Table:
    """Level and lag over each whole log, and what held-out training logs allow."""
    marks: dict[bool | None, tuple[str, Mark]] = {
        True: ("pass", "good"), False: ("fail", "bad"), None: ("not judged", "none"),
    }  # fmt: skip
    rows: list[tuple[Cell, ...]] = []
    for view in views:
        if view.evaluation is None or not view.evaluation.levels:
            continue
        rows.append((Cell(view.name, "group"),))
        for each in view.evaluation.levels:
            word, mark = marks[each.ok]
            pairs = figure(each.error), figure(each.allowed), Cell(word, mark)
            lags = figure(each.lag_s, digits=2), figure(each.allowed_lag_s, digits=2)
            logs = Cell(str(each.held_out_logs), number=True)
            rows.append((Cell(with_unit(each.channel), "head"), *pairs, *lags, logs))
    head = ("level of", "error", "allowed", "", "lag [s]", "allowed [s]", "held-out logs")
    caption = "Median of model minus measured, and delay of the model, over the whole log"
    return Table(caption, head, tuple(rows))


def tallies(views: Sequence[LogView]) -> Table:
    """Ti and Tt of the model and of the baselines, on the same events."""
    head = (
        "model", "passed", "assessed", "passed [%]", "mean |ΔTi| [%]", "mean |ΔTt| [%]",
        "mean |ΔTi| [s]", "mean |ΔTt| [s]",
    )  # fmt: skip
    rows: list[tuple[Cell, ...]] = []
    for view in views:
        if view.evaluation is None:
            continue
        rows.append((Cell(view.name, "group"),))
        baselines = {BASELINES[name]: part for name, part in view.evaluation.baselines.items()}
        for name, part in {"model": tally(view.assessments), **baselines}.items():
            values = (
                part.passed_pct, part.mean_relative_Ti_pct, part.mean_relative_Tt_pct,
                part.mean_absolute_Ti_s, part.mean_absolute_Tt_s,
            )  # fmt: skip
            counts = [Cell(str(count), number=True) for count in (part.passed, part.assessed)]
            rows.append((Cell(name, "head"), *counts, *(figure(value) for value in values)))
    caption = "Times read as 100 % wrong where a model failed before they could be compared"
    return Table(caption, head, tuple(rows))


def event_times(event: AssessedEvent) -> Table:
    """Ti and Tt of one event, shown next to its overlay."""
    head = ("channel", "", "flight [s]", "model [s]", "Δ [s]", "|Δ| [%]", "allowed [s]", "outcome")
    rows: list[tuple[Cell, ...]] = []
    for one in event.assessments:
        verdict, name = one.verdict, Cell(symbol(one.channel), "head")
        if verdict.Ti is None or verdict.Tt is None:
            rows.append((name, *[Cell(NOTHING, number=True)] * 6, outcome(one)))
            continue
        rows += [
            (name, Cell(time), *_check_cells(check), _passed(check))
            for time, check in (("Ti", verdict.Ti), ("Tt", verdict.Tt))
        ]
    return Table("", head, tuple(rows))


def outcome(one: Assessment) -> Cell:
    """`pass`, `fail` or `not assessable`, with the reason where there is one."""
    reason = f": {one.verdict.reason}" if one.verdict.reason else ""
    if one.verdict.ok is None:
        return Cell(f"not assessable{reason}", "none")
    return Cell(f"✓ pass{reason}", "good") if one.verdict.ok else Cell(f"✗ fail{reason}", "bad")


def move(event: AssessedEvent) -> str:
    """`fast push`, `slow pull, interrupted`."""
    return f"{event.move}, interrupted" if event.event.interrupted else event.move


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


def _transient_row(event: AssessedEvent, one: Assessment) -> tuple[Cell, ...]:
    verdict, flight, model = one.verdict, one.flight, one.model
    return (
        Cell(f"{event.event.start_s:.1f}", number=True),
        Cell(move(event)),
        Cell(symbol(one.channel)),
        *_times(verdict.Ti, flight.Ti_s, model.Ti_s),
        *_times(verdict.Tt, flight.Tt_s, model.Tt_s),
        outcome(one),
    )


def _times(check: TimeCheck | None, flight_s: float, model_s: float) -> tuple[Cell, ...]:
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


def comparison(found: Comparison) -> Table:
    """Every figure of every row; the least RMSE of a channel is marked."""
    least = {
        name: min((row.channels[name]["rmse"] for row in found.rows if name in row.channels),
                  default=math.nan)
        for name in found.channels
    }  # fmt: skip
    head = ("run", "method", *(f"{name} RMSE" for name in found.channels),
            *(f"{name} [%]" for name in found.channels), "Ti, Tt passed", "parameters", "AIC",
            "fit [s]", "sample [us]", "in 90 % [%]")  # fmt: skip
    return Table(
        "Free run on the same rows; [%] is RMSE over the standard deviation of the channel",
        head, tuple(_compared_row(row, found.channels, least) for row in found.rows),
    )  # fmt: skip


def _compared_row(
    row: Row, channels: Sequence[str], least: Mapping[str, float]
) -> tuple[Cell, ...]:
    found = [row.channels.get(name, {}) for name in channels]
    errors = [one.get("rmse") for one in found]
    marks = [error == least[name] for name, error in zip(channels, errors, strict=True)]
    coverage = None if row.coverage_90 is None else 100.0 * row.coverage_90
    passed = number(None)
    if row.ti_tt is not None:
        passed = f"{row.ti_tt.passed} of {row.ti_tt.assessed}"
    return (
        Cell(row.run, "head"),
        Cell(row.method),
        *(figure(error, "best" if mark else "")
          for error, mark in zip(errors, marks, strict=True)),
        *(figure(None if not one else 100.0 * one["nrmse"]) for one in found),
        Cell(passed, number=True),
        Cell(number(None) if row.parameters is None else str(row.parameters), number=True),
        Cell(number(None) if row.aic is None else f"{row.aic:.0f}", number=True),
        figure(row.fit_s),
        figure(row.simulate_us),
        figure(coverage),
    )  # fmt: skip


def significant(found: Comparison) -> Table:
    """Significant differences, with the interval of each pair alone."""
    head = ("channel", "less", "more", "RMSE less by [%]", "95 % from", "to", "p of the table")
    rows = tuple(
        (
            Cell(one.channel, "head"),
            Cell(one.better),
            Cell(one.worse),
            *(figure(100.0 * (1.0 - ratio)) for ratio in (one.ratio, one.high, one.low)),
            figure(one.p, digits=2),
        )
        for one in found.significant
    )
    return Table("", head, rows)


_DIGITS, _ROWS = "{:.4g}".format, 20


class Summary(NamedTuple):
    """What a shell and a notebook show of a result: title, remarks, and up to twenty rows."""

    title: str
    lines: Sequence[str]
    table: pd.DataFrame

    @property
    def html(self) -> str:
        """For a notebook."""
        listed = "".join(f"<li>{escape(line)}</li>" for line in self.lines)
        rows: str = self.table.to_html(float_format=_DIGITS, border=0, max_rows=_ROWS, na_rep="")
        return f"<h4>{escape(self.title)}</h4>{f'<ul>{listed}</ul>' if self.lines else ''}{rows}"

    @property
    def text(self) -> str:
        """For a shell."""
        rows = self.table.to_string(float_format=_DIGITS, max_rows=_ROWS, na_rep="")
        return "\n".join([self.title, *(f"- {line}" for line in self.lines), rows])


class Shown(ABC):
    """A result that shells and notebooks show by its `summary`."""

    @property
    @abstractmethod
    def summary(self) -> Summary:
        """Title, remarks, table."""

    def __repr__(self) -> str:
        return self.summary.text

    def _repr_html_(self) -> str:
        return self.summary.html
