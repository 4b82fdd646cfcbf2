"""Rows of one engine onto the sampling grid, block by block, as a file is read or grows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from data_prep.config import LogsConfig
from data_prep.derive import derive
from data_prep.log import Audit
from data_prep.sources.grid import ON_GRID, Grid, StreamAudit, interpolated, resample
from data_prep.sources.stamps import (
    Passed,
    clock_goes_on,
    earliest_numbers,
    ordered_rows,
    printed_step,
    row_interval,
    split_at_gaps,
    undo_rounding,
)
from narxcal.channels import described
from narxcal.support.arrays import BoolArray, FloatArray
from narxcal.support.errors import DataError

# Rows kept before the next sample: a channel recorded once in several seconds is still bridged.
_BEHIND_S = 10.0
_ROWS_BEHIND = 64  # as many as show how stamps were printed
_BASELINE_ROWS = 300  # from which the interval of the rows is estimated
_MOST_SAMPLES = 1000  # per row; more come of a wrong unit of time


@dataclass(frozen=True, eq=False)
class Piece:
    """Consecutive samples of the grid: `time_s` `(time,)`, canonical `channels` `(time,)`.

    `interpolated`: per recorded channel, bool (time,), True where a sample lies between two
    measurements (`data_prep.sources.grid.interpolated`). `starts`: the first sample begins a
    recording, at the start of the file or after a gap.
    """

    time_s: FloatArray
    channels: dict[str, FloatArray]
    starts: bool
    interpolated: dict[str, BoolArray] = field(default_factory=dict)


@dataclass
class GridStream:
    """Puts the rows of one engine on a grid of `dt_s`, with the rules of `data_prep.sources.grid`.

    The newest row is kept back until the next one shows that its stamp is sound: one sample of
    look-ahead, and never a shift. `look_ahead_s` more are waited for, so that blanks of slow
    channels are bridged as in a whole file; with 0 such a blank is missing until it is over.

    `rows_s` is the interval of the rows where it is known; else it is estimated from the first ones
    of a recording. `hourly`: the clock shows no hours. `constants` are channels with one value.

    `dropped` counts rows without a usable stamp and lone rows between gaps, `samples` those that
    came out. `audit` adds up what was done to the recording in hand; `ended` is the audit of the
    one before.
    """

    config: LogsConfig
    dt_s: float
    look_ahead_s: float
    file: str = ""
    constants: Mapping[str, float] = field(default_factory=dict)
    hourly: bool = False
    rows_s: float | None = None
    dropped: int = 0
    samples: int = 0
    audit: StreamAudit = field(default_factory=StreamAudit)
    ended: Audit = field(default_factory=Audit)

    def __post_init__(self) -> None:
        self._rows: dict[str, FloatArray] = {}
        self._numbers = np.zeros(0, dtype=np.intp)  # of the rows in hand, in the file
        self._exact = np.zeros(0)  # their times without rounding, NaN until known
        self._first_step = 0.0  # last printed digit of the recording's first stamp
        self._seen = 0
        # Interval of the rows, and from how many rows it was found.
        self._native = (self.rows_s, _BASELINE_ROWS) if self.rows_s else (0.0, 0)
        self._origin = np.nan  # of the grid of the recording in hand
        self._next = 0  # sample of that grid to come next
        self._behind_s = max(_BEHIND_S, 2.0 * self.config.bridge_s)
        self._before: dict[str, float] = {}  # channels of the sample that came last
        self._late = 0  # number of the last row whose lateness was counted
        self._passed = Passed(hourly=self.hourly)  # midnights and full hours

    def push(self, rows: Mapping[str, FloatArray], *, last: bool = False) -> Iterator[Piece]:
        """Take further rows `(rows,)` in file order and yield the samples that are now certain.

        `last` yields all that is left. Raises `DataError` where time goes back.
        """
        self._take(rows)
        order, time = self._ordered(last)
        parts = split_at_gaps(time, self.config.max_gap_s) if len(time) else []
        for part in parts:
            over = last or part is not parts[-1]
            yield from self._part(order[part], time[part], over)
        if parts:
            self._forget(order[parts[-1]], time[parts[-1]])

    def _take(self, rows: Mapping[str, FloatArray]) -> None:
        count = len(rows["time_s"]) if rows else 0
        if count:
            rows = {**rows, "time_s": self._going_on(rows["time_s"])}
            old = self._rows or {name: values[:0] for name, values in rows.items()}
            self._rows = {name: np.concatenate([old[name], rows[name]]) for name in rows}
            new = np.arange(self._seen + 1, self._seen + count + 1)
            self._numbers = np.concatenate([self._numbers, new])
            self._exact = np.concatenate([self._exact, np.full(count, np.nan)])
            self._seen += count

    def _going_on(self, stamps: FloatArray) -> FloatArray:
        """Stamps of new rows, with the days and hours that a clock has counted before them."""
        sound = self._rows.get("time_s", stamps[:0])
        before_s = float(sound[-1]) if len(sound) else np.nan
        going_on, self._passed, moved = clock_goes_on(
            stamps, self.config.max_gap_s, before_s, self._passed
        )
        for entry in moved:
            self.audit.count("*", entry.action, entry.reason, entry.samples)
        return going_on

    def _ordered(self, last: bool) -> tuple[NDArray[np.intp], FloatArray]:
        """Rows in hand whose stamps are sound, in order of time, and their times."""
        stamps = self._rows.get("time_s", np.zeros(0))
        rows = ordered_rows(stamps, self.config.max_gap_s, self.file, self._numbers)
        sound = np.zeros(len(stamps), dtype=np.bool_)
        sound[rows.order] = True
        self.dropped += int((~sound).sum())
        for entry in rows.entries:
            if entry.action == "dropped":
                self.audit.count("*", entry.action, entry.reason, entry.samples)
        self._count_late(stamps[sound], self._numbers[sound])
        newest = int(self._numbers[-1]) if len(stamps) and not last else -1
        self._keep(sound)
        order = (np.cumsum(sound) - 1)[rows.order]
        known = self._numbers[order] != newest
        return order[known], rows.time_s[known]

    def _count_late(self, stamps: FloatArray, numbers: NDArray[np.intp]) -> None:
        if len(stamps):
            late = (np.maximum.accumulate(stamps) > stamps) & (numbers > self._late)
            self.audit.count("*", "repaired", "out of order", int(late.sum()))
            self._late = int(numbers[-1])

    def _part(self, order: NDArray[np.intp], stamps: FloatArray, over: bool) -> Iterator[Piece]:
        """Yield samples of one recording; `over`: no row of it is to come."""
        starts = bool(np.isnan(self._origin))
        if starts and (len(stamps) < 2 or stamps[0] == stamps[-1]):
            self._drop_lone(len(stamps) if over else 0)
            return
        new = np.isnan(self._exact[order])
        rows = {name: values[order] for name, values in self._rows.items()}
        if self._native[1] < _BASELINE_ROWS:
            channels = {name: values for name, values in rows.items() if name != "time_s"}
            self._native = row_interval(stamps, channels), len(stamps)
        time = self._exact[order] = self._without_rounding(self._exact[order], stamps)
        if starts and over and (time[-1] - time[0]) / self.dt_s < 1.0 - ON_GRID:
            self._drop_lone(len(time))
            return
        if starts:
            if self.samples:
                self.ended = self.audit.taken()
            self._origin, self._next, self._before = float(time[0]), 0, {}
        rounded = np.abs(time - stamps)[new] > 0.01 * self._native[0]
        self.audit.count("*", "repaired", "rounded time stamp", int(rounded.sum()))
        limit = time[-1] - (0.0 if over else self.look_ahead_s)
        samples = int(np.floor((limit - self._origin) / self.dt_s + ON_GRID)) + 1 - self._next
        if samples > _MOST_SAMPLES * (len(time) + 10):
            raise DataError(
                f"{len(time)} rows would become {samples} samples at {1 / self.dt_s:.4g} Hz",
                file=self.file,
                channel="time_s",
                hint="Check the unit of time_s and set [logs] raster_hz",
            )
        self.audit.rows(time, rows, new, Grid(self._origin, self.dt_s, 0, 0.0))
        if samples > 0:
            yield self._sampled(time, rows, samples)
        self._origin = np.nan if over else self._origin

    def _drop_lone(self, rows: int) -> None:
        self.dropped += rows
        self.audit.count("*", "dropped", "lone row between gaps", rows)

    def _without_rounding(self, exact: FloatArray, stamps: FloatArray) -> FloatArray:
        """Continue `data_prep.sources.stamps.undo_rounding`: NaN in `exact` are the new rows.

        Where no whole numbers of intervals explain the stamps, they count as they are.
        """
        interval, step = self._native[0], printed_step(stamps)
        if np.isnan(self._origin):
            self._first_step = float(step[0])
            return undo_rounding(stamps, interval)
        at = int(np.flatnonzero(np.isfinite(exact))[-1])
        exact = np.where(np.isnan(exact), stamps, exact)
        slack = 0.5001 * (step[at + 1 :] + self._first_step) / interval + ON_GRID
        steps = (stamps[at + 1 :] - self._origin) / interval
        low = np.append((exact[at] - self._origin) / interval, np.ceil(steps - slack))
        number = earliest_numbers(low)[1:]
        if (number <= np.floor(steps + slack)).all():
            exact[at + 1 :] = self._origin + number * interval
        return exact

    def _sampled(self, time: FloatArray, rows: dict[str, FloatArray], samples: int) -> Piece:
        start = self._origin + self._next * self.dt_s
        grid = Grid(start, self.dt_s, samples, self.config.bridge_s)
        channels: dict[str, FloatArray] = {}
        between: dict[str, BoolArray] = {}
        for name, values in rows.items():
            if name != "time_s":
                hold = described(name).role == "switch"
                channels[name], entries = resample(name, time, values, grid, hold=hold)
                self.audit.add(entries, self.dt_s)
                if not hold:
                    between[name] = interpolated(time, values, grid)
        for name, value in self.constants.items():
            channels[name] = np.full(samples, value)
            self.audit.count(name, "filled", "constant of the config", samples)
        channels |= self._derived(channels)
        self._before = {name: float(values[-1]) for name, values in channels.items()}
        time_s = self._origin + np.arange(self._next, self._next + samples) * self.dt_s
        piece = Piece(
            np.asarray(time_s, dtype=np.float64), channels, self._next == 0, interpolated=between
        )
        self._next += samples
        self.samples += samples
        return piece

    def _derived(self, channels: dict[str, FloatArray]) -> dict[str, FloatArray]:
        """Derive as `data_prep.derive`; weight on wheels goes on from what it was before."""
        rule, decided = self.config.derive.WOW, self._before.get("WOW", np.nan)
        if rule is None or "WOW" in channels or np.isnan(decided):
            return derive(channels, self.config.derive, self.file)
        before = self._before | {rule.airspeed: 0.0 if decided else np.inf}
        longer = {name: np.append(before[name], values) for name, values in channels.items()}
        added = derive(longer, self.config.derive, self.file)
        return {name: values[1:] for name, values in added.items()}

    def _forget(self, order: NDArray[np.intp], time: FloatArray) -> None:
        """Drop rows of the recording in hand that no coming sample needs, and all before it."""
        needed = np.ones(len(time), dtype=np.bool_)
        if not np.isnan(self._origin):
            needed[:-_ROWS_BEHIND] = (
                time[:-_ROWS_BEHIND] >= self._origin + self._next * self.dt_s - self._behind_s
            )
        first = order[needed][0]
        for name, values in self._rows.items():
            if name != "time_s" and described(name).role == "switch":
                known = values[order[~needed]]
                known = known[np.isfinite(known)]
                # A switch stays where it was put, however long ago.
                if len(known) and np.isnan(values[first]):
                    values[first] = known[-1]
        keep = np.zeros(len(self._numbers), dtype=np.bool_)
        keep[order[needed]] = True
        keep[-1] = True
        self._keep(keep)

    def _keep(self, rows: BoolArray) -> None:
        self._rows = {name: values[rows] for name, values in self._rows.items()}
        self._numbers = self._numbers[rows]
        self._exact = self._exact[rows]
