"""Tables of a page as records of text cells: what is in them, not how they look."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
import pandas as pd
from markupsafe import escape

from data_prep.log import AuditEntry, Log, Source
from eval.judging.outcome import plural
from eval.report.style import NOTHING, number, unit, with_unit
from eval.report.view import LogView
from narxcal.channels import symbol
from narxcal.intervals import LEVEL
from narxcal.support.arrays import FloatArray
from training.responses.rules import TimeCheck
from training.responses.transients import AssessedEvent, Assessment, not_assessable, tally

if TYPE_CHECKING:
    from eval.judging.compare import Comparison
    from eval.judging.compare import Row as ComparedRow
    from eval.judging.crossval import CrossValidation, FoldResult
    from eval.judging.trim import Trim
    from eval.reproduce.noise import NoiseSweep

Mark = Literal["", "best", "good", "bad", "none", "strong", "head", "group"]
BASELINES = {"steady_state": "steady state", "first_order": "first order", "arx": "ARX"}
_MOST_NAMED = 2  # logs of a fold


@dataclass(frozen=True)
class Cell:
    """Text of one cell; `mark` is its meaning, which the page turns into a style.

    `level`, -1 to 1, is shown as a colour: orange above zero, violet below.
    """

    text: str
    mark: Mark = ""
    number: bool = False
    level: float = 0.0

    @property
    def background(self) -> str:
        """CSS colour of `level`, light enough for dark text."""
        red_green_blue = "230 97 1" if self.level > 0.0 else "94 60 153"
        return f"rgb({red_green_blue} / {0.5 * abs(self.level):.2f})"


Row = tuple[Cell, ...]


@dataclass(frozen=True)
class Table:
    """A caption, a head and rows of cells; a row of one `group` cell titles those below it."""

    caption: str
    head: tuple[str, ...]
    rows: tuple[Row, ...]

    @property
    def numeric(self) -> tuple[bool, ...]:
        """Which columns hold numbers, and so are set flush right."""
        columns = zip(*(row for row in self.rows if len(row) == len(self.head)), strict=True)
        found = tuple(any(cell.number for cell in column) for column in columns)
        return found or (False,) * len(self.head)


def figure(value: float | None, mark: Mark = "", digits: int = 3) -> Cell:
    return Cell(number(value, digits), mark, number=True)


def row(head: str, *values: Cell | str | float | None) -> Row:
    """Put a heading, texts and numbers (whole ones as they are) into cells."""
    return (Cell(head, "head"), *cells(*values))


def cells(*values: Cell | str | float | None) -> Row:
    """Put texts and numbers into cells without a heading."""
    return tuple(
        one if isinstance(one, Cell)
        else Cell(one) if isinstance(one, str)
        else plain(str(one)) if isinstance(one, int)
        else figure(one)
        for one in values
    )  # fmt: skip


def plain(text: str) -> Cell:
    """A number that is already text."""
    return Cell(text, number=True)


def by_log(views: Sequence[LogView], own: Callable[[LogView], Iterable[Row]]) -> tuple[Row, ...]:
    """Rows of each log below its name; nothing of a log without any."""
    rows: list[Row] = []
    for view in views:
        found = list(own(view))
        rows += [(Cell(view.name, "group"),), *found] if found else []
    return tuple(rows)


def scores(views: Sequence[LogView]) -> Table:
    """Free-run errors of model and baselines per log and channel; the lowest RMSE is marked."""
    judged = [(view.name, view.evaluation) for view in views if view.evaluation is not None]
    known = [found for _, one in judged for found in one.scores.values()]
    trim = any(one.untrimmed for _, one in judged)
    led = any(each.network_rmse != each.rmse for each in known if math.isfinite(each.rmse))
    band = any(math.isfinite(each.coverage) for each in known)
    covered = (f"in {100 * LEVEL:.0f} % interval [%]", "half-width") if band else ()
    head = (
        "channel", "free run RMSE", *(("network RMSE",) if led else ()),
        *(("before trim",) if trim else ()), "bias", "NRMSE [%]",
        "max rel. [%]", "one step RMSE", "static part", "dynamic part",
        *covered, *(f"{name} RMSE" for name in BASELINES.values()),
    )  # fmt: skip
    rows: list[Row] = []
    for log, one in judged:
        rows.append((Cell(f"{log} ({one.role})", "group"),))
        for name, found in one.scores.items():
            before, best = one.untrimmed.get(name), found.best_rmse
            rows.append(row(
                with_unit(name),
                figure(found.rmse, "best" if found.rmse == best else ""),
                *((found.network_rmse,) if led else ()),
                *((None if before is None else before.rmse,) if trim else ()),
                found.bias, 100.0 * found.nrmse, found.max_rel_pct,
                found.one_step_rmse, found.static_rmse, found.dynamic_rmse,
                *((100.0 * found.coverage, found.half_width) if band else ()),
                *(figure(each, "best" if each == best else "")
                  for each in found.baselines.values()),
            ))  # fmt: skip
    return Table("RMSE, bias and parts in the unit of the channel", head, tuple(rows))


def offsets(trim: Trim, channels: Sequence[str], caption: str) -> Table:
    """Trim offsets per channel and altitude across the levels (0 is idle, 1 is full power)."""
    rows = [
        row(
            with_unit(name), plain(f"{altitude_ft:,.0f}"), *(plain(f"{one:+.3g}") for one in values)
        )
        for name, table in zip(channels, np.moveaxis(trim.offsets, 2, 0).tolist(), strict=True)
        for altitude_ft, values in zip(trim.altitudes_ft.tolist(), table, strict=True)
    ]
    head = ("channel", "altitude [ft]", *(f"level {level:.2g}" for level in trim.nodes))
    return Table(caption, head, tuple(rows))


def pearson(table: pd.DataFrame, caption: str, strong: float = 0.8) -> Table:
    """Pearson coefficients in colours, strong ones bold; inputs down, outputs across."""
    rows = [
        row(symbol(str(name)), *(_coefficient(value, strong) for value in map(float, values)))
        for name, values in zip(table.index, table.to_numpy(dtype=float), strict=True)
    ]
    return Table(caption, ("input", *(symbol(str(name)) for name in table.columns)), tuple(rows))


def _coefficient(value: float, strong: float) -> Cell:
    if not math.isfinite(value):
        return Cell(NOTHING, number=True)
    mark: Mark = "strong" if abs(value) >= strong else ""
    return Cell(f"{value:+.3f}", mark, number=True, level=value)


def audit(log: Log, caption: str) -> Table:
    """Everything that cleaning changed, per channel."""
    rows = []
    for entry in _together(log.audit.entries):
        longest = "; ".join(log.moment(*span_s) for span_s in entry.spans_s[:6])
        more = f"; and {len(entry.spans_s) - 6} more" if len(entry.spans_s) > 6 else ""
        channel = "all channels" if entry.channel == "*" else entry.channel
        spans = longest + more or NOTHING
        rows.append(row(channel, entry.action, entry.reason, plain(f"{entry.samples:,}"), spans))
    return Table(caption, ("channel", "what", "why", "samples", "longer spans"), tuple(rows))


def _together(entries: Iterable[AuditEntry]) -> list[AuditEntry]:
    found: dict[tuple[str, str, str], AuditEntry] = {}
    for entry in entries:
        key = entry.channel, entry.action, entry.reason
        last = found.get(key)
        spans_s = (*last.spans_s, *entry.spans_s) if last else entry.spans_s
        samples = entry.samples + (last.samples if last else 0)
        found[key] = replace(entry, samples=samples, spans_s=spans_s)
    return list(found.values())


def sources(files: Sequence[Source]) -> Table:
    """Every data file with its hash, which pins exactly what was evaluated."""
    rows = [row(part.file, part.engine or NOTHING, part.sha256 or NOTHING) for part in files]
    return Table("Data", ("file", "engine", "SHA-256"), tuple(rows))


@dataclass(frozen=True, kw_only=True, eq=False)
class WindowTrial:
    """Moving averages of several widths on one log, as the paper's Fig. 5 compares them.

    `rms` is channel -> window (samples) -> RMS of the smoothed minus the unsmoothed signal;
    `gain` is window -> magnitude response at `frequency_hz` (the closed form for that width).
    `excerpt` shows the same seconds unsmoothed (`0`) and with each window, `(time,)` each.
    """

    log: str
    chosen: int
    rms: Mapping[str, Mapping[int, float]]
    frequency_hz: FloatArray
    gain: Mapping[int, FloatArray]
    excerpt_channel: str
    excerpt_time_s: FloatArray
    excerpt: Mapping[int, FloatArray]


def windows(trials: Sequence[WindowTrial]) -> Table:
    """RMS error that each smoothing window leaves, per log and channel, the chosen one marked."""
    widths = sorted({width for trial in trials for part in trial.rms.values() for width in part})
    rows = [
        row(
            trial.log, symbol(channel), unit(channel),
            *(figure(part.get(width), "best" if width == trial.chosen else "") for width in widths),
        )
        for trial in trials
        for channel, part in trial.rms.items()
    ]  # fmt: skip
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
        return f"{self.label} [{self.unit}]" if self.unit else self.label


def measures(found: CrossValidation) -> list[Measure]:
    """Columns of all schemes: the response times, then the errors of every channel."""
    keys = dict.fromkeys(key for fold in found.folds for key in fold.figures)
    columns = [Measure("passed_pct", "Ti/Tt passed", "%")]
    columns += [Measure(key, label, "%") for key, label in _TIMES.items()]
    for kind, label in _KINDS.items():
        for key in keys:
            head, _, channel = key.partition(".")
            if head == kind:
                of = "%" if kind == "max_rel_pct" else unit(channel)
                bound = found.settings.largest_rmse.get(channel) if kind == "rmse" else None
                columns.append(Measure(key, f"{symbol(channel)} {label}", of, bound))
    return columns


_KINDS = {"rmse": "RMSE", "worst_rmse": "worst RMSE", "max_rel_pct": "max rel. error"}
_TIMES = {
    "mean_relative_Ti_pct": "mean rel. error of Ti",
    "mean_relative_Tt_pct": "mean rel. error of Tt",
}


def folds(found: CrossValidation, scheme: str) -> Table:
    """Every fold of a scheme, then mean, standard deviation, least and greatest."""
    columns, rows = measures(found), []
    for fold in found.schemes[scheme]:
        own = []
        for column in columns:
            value = fold.figures.get(column.key)
            bad = value is not None and column.limit is not None and value > column.limit
            own.append(figure(value, "bad" if bad else ""))
        rows.append(row(fold_name(fold), _brief(fold.test), *own))
    spread = found.spread(scheme)
    for name in ("mean", "std", "min", "max"):
        values = [spread.get(column.key, {}).get(name) for column in columns]
        own = [Cell(number(value), "strong", number=True) for value in values]
        rows.append((Cell(name, "strong"), Cell("", "strong"), *own))
    return Table("", ("fold", "test data", *(column.title for column in columns)), tuple(rows))


def fold_name(fold: FoldResult) -> str:
    return fold.name if fold.seed is None else f"{fold.name}, seed {fold.seed}"


def listed(names: Sequence[str]) -> str:
    """Name whole logs; of segments cut from logs, how many there are from each."""
    counts = _segments(names)
    cut = any("[" in name for name in names)
    return ", ".join(f"{name} ({plural(n, 'part')})" if cut else name for name, n in counts.items())


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
        marked = [figure(value, "best" if value == min(values) else "") for value in values]
        rows.append(row(f"{ratio:g}", *marked, float(nis)))
    caption = f"{sweep.log}: RMSE of {with_unit(sweep.channel)} against the clean signal"
    return Table(caption, ("SNR [dB]", *curves, "mean NIS"), tuple(rows))


def transients(views: Sequence[LogView], *, assessable: bool) -> Table:
    """Ti and Tt of every event and channel that could be assessed, or of those that could not."""
    head = (
        "at", "move", "channel", "Ti flight [s]", "Ti model [s]", "ΔTi [s]", "allowed [s]",
        "Tt flight [s]", "Tt model [s]", "ΔTt [s]", "allowed [s]", "outcome",
    )  # fmt: skip

    def own(view: LogView) -> Iterator[Row]:
        for event in view.events:
            for one in event.assessments:
                if (one.verdict.ok is not None) is assessable:
                    yield _transient_row(view.when(event.event), event, one)

    caption = "Differences are model minus flight" if assessable else ""
    return Table(caption, head, by_log(views, own))


def reasons(assessments: Sequence[Assessment]) -> Table:
    """Why transients could not be assessed, the most frequent reason first."""
    found = not_assessable(assessments, figures=True)
    rows = [cells(reason, count) for reason, count in found.items()]
    return Table("", ("reason", "transients"), tuple(rows))


def findings(views: Sequence[LogView]) -> Table:
    """What the logs show to be wrong, and when."""

    def own(view: LogView) -> Iterator[Row]:
        for each in view.log.findings:
            yield row(
                ", ".join(symbol(name) for name in each.channels), each.kind,
                each.when or "the whole log", plain(f"{each.probability:.3f}"),
                f"{each.evidence}. {each.remedy}" if each.remedy else each.evidence,
            )  # fmt: skip

    head = ("channel", "kind", "when", "probability", "what")
    return Table("", head, by_log(views, own))


def masked_scores(views: Sequence[LogView]) -> Table:
    """RMSE with the masks of findings, and on the logs as recorded."""

    def own(view: LogView) -> Iterator[Row]:
        found = view.evaluation
        if found is None:
            return
        for name, before in found.as_recorded.items():
            share = plain(f"{100.0 * found.faulty.get(name, 0.0):.1f}")
            yield row(with_unit(name), share, found.scores[name].rmse, before.rmse)

    head = ("RMSE of", "masked [%]", "with masks", "as recorded")
    return Table("Masking improves a score by itself: both stand here", head, by_log(views, own))


def levels(views: Sequence[LogView]) -> Table:
    """Level and lag over each whole log, and what held-out training logs allow."""
    marks: dict[bool | None, Cell] = {
        True: Cell("pass", "good"), False: Cell("fail", "bad"), None: Cell("not judged", "none"),
    }  # fmt: skip

    def own(view: LogView) -> Iterator[Row]:
        for each in () if view.evaluation is None else view.evaluation.levels:
            lags = figure(each.lag_s, digits=2), figure(each.allowed_lag_s, digits=2)
            found = each.error, each.allowed, marks[each.ok], *lags, each.held_out_logs
            yield row(with_unit(each.channel), *found)

    head = ("level of", "error", "allowed", "", "lag [s]", "allowed [s]", "held-out logs")
    caption = "Median of model minus measured, and delay of the model, over the whole log"
    return Table(caption, head, by_log(views, own))


def tallies(views: Sequence[LogView]) -> Table:
    """Ti and Tt of the model and of the baselines, on the same events."""
    head = (
        "model", "passed", "assessed", "passed [%]", "mean |ΔTi| [%]", "mean |ΔTt| [%]",
        "mean |ΔTi| [s]", "mean |ΔTt| [s]",
    )  # fmt: skip

    def own(view: LogView) -> Iterator[Row]:
        if view.evaluation is None:
            return
        baselines = {BASELINES[name]: part for name, part in view.evaluation.baselines.items()}
        for name, part in {"model": tally(view.assessments), **baselines}.items():
            yield row(
                name, part.passed, part.assessed, part.passed_pct, part.mean_relative_Ti_pct,
                part.mean_relative_Tt_pct, part.mean_absolute_Ti_s, part.mean_absolute_Tt_s,
            )  # fmt: skip

    caption = "Times read as 100 % wrong where a model failed before they could be compared"
    return Table(caption, head, by_log(views, own))


def event_times(event: AssessedEvent) -> Table:
    """Ti and Tt of one event, shown next to its overlay."""
    head = ("channel", "", "flight [s]", "model [s]", "Δ [s]", "|Δ| [%]", "allowed [s]", "outcome")
    rows: list[Row] = []
    for one in event.assessments:
        verdict, name = one.verdict, symbol(one.channel)
        if verdict.Ti is None or verdict.Tt is None:
            rows.append(row(name, *[plain(NOTHING)] * 6, outcome(one)))
            continue
        rows += [
            row(
                name, time, check.flight_s, check.model_s, plain(f"{check.error_s:+.3f}"),
                plain(f"{100.0 * check.relative:.1f}"), check.allowed_s,
                Cell("✓ pass", "good") if check.ok else Cell("✗ fail", "bad"),
            )
            for time, check in (("Ti", verdict.Ti), ("Tt", verdict.Tt))
        ]  # fmt: skip
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


def _transient_row(when: str, event: AssessedEvent, one: Assessment) -> Row:
    verdict, flight, model = one.verdict, one.flight, one.model
    return cells(
        when,
        move(event),
        symbol(one.channel),
        *_times(verdict.Ti, flight.Ti_s, model.Ti_s),
        *_times(verdict.Tt, flight.Tt_s, model.Tt_s),
        outcome(one),
    )


def _times(check: TimeCheck | None, flight_s: float, model_s: float) -> Row:
    """Flight, model, difference and allowed; what was read though it was not compared."""
    if check is None:
        return cells(flight_s, model_s, plain(NOTHING), plain(NOTHING))
    off = Cell(f"{check.error_s:+.3f}", "" if check.ok else "bad", number=True)
    return cells(check.flight_s, check.model_s, off, check.allowed_s)


def comparison(found: Comparison) -> Table:
    """Every figure of every row; the least RMSE of a channel is marked."""
    head = ("run", "method", *(f"{name} RMSE" for name in found.channels),
            *(f"{name} [%]" for name in found.channels), "Ti, Tt passed", "parameters", "AIC",
            "fit [s]", "sample [us]", "in 90 % [%]")  # fmt: skip
    return Table(
        "Free run on the same rows; [%] is RMSE over the standard deviation of the channel",
        head, tuple(_compared_row(row, found.least) for row in found.rows),
    )  # fmt: skip


def _compared_row(row_: ComparedRow, least: Mapping[str, float]) -> Row:
    found = [row_.channels.get(name, {}) for name in least]
    errors = zip(least.values(), (one.get("rmse") for one in found), strict=True)
    tally_ = row_.ti_tt
    return row(
        row_.run,
        row_.method,
        *(figure(error, "best" if error == best else "") for best, error in errors),
        *(None if not one else 100.0 * one["nrmse"] for one in found),
        None if tally_ is None else plain(f"{tally_.passed} of {tally_.assessed}"),
        row_.parameters,
        None if row_.aic is None else plain(f"{row_.aic:.0f}"),
        row_.fit_s,
        row_.simulate_us,
        None if row_.coverage_90 is None else 100.0 * row_.coverage_90,
    )


def significant(found: Comparison) -> Table:
    """Significant differences, with the interval of each pair alone."""
    head = ("channel", "less", "more", "RMSE less by [%]", "95 % from", "to", "p of the table")
    rows = tuple(
        row(
            one.channel, one.better, one.worse,
            *(100.0 * (1.0 - ratio) for ratio in (one.ratio, one.high, one.low)),
            figure(one.p, digits=2),
        )
        for one in found.significant
    )  # fmt: skip
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
