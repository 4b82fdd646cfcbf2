"""Time stamps of one recording: put in order, split at gaps, rid of rounding.

Stamps are `(rows,)` in s, as `data_prep.sources.clock` reads them.

A recorder of ten rows a second whose clock shows seconds writes the same stamp ten times. From the
number of rows per stamp their rate is found, and `undo_rounding` places them in between. Where the
rows of a stamp hold different channels, different engines, or the same values again, nothing lies
in between.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from data_prep.log import AuditEntry
from data_prep.sources.grid import ON_GRID
from narxcal.support.arrays import BoolArray, FloatArray
from narxcal.support.errors import DataError
from narxcal.support.moments import stamp

_MAX_DECIMALS = 7
_BASELINES_ROWS = (256, 64, 16, 4)
DAY_S, _HOUR_S, _MINUTE_S = 86400.0, 3600.0, 60.0
_LATEST_S = 1e11  # later than any clock that counts seconds
_SHARED = 1.5  # rows per stamp, at least, where the clock is coarser than the rows
MIDNIGHT = "clock starts anew at midnight"  # why stamps are moved by whole days
FULL_HOUR = "clock of minutes starts anew each hour"  # and by whole hours
_SHORTEST_S = 1e-4  # between rows of any recorder
_FEW = 3  # whole stamps, at least
_REGULAR = 0.9  # of the stamps hold as many rows as the others, or one more or less
_FILLED, _CHANGES = 0.9, 0.02  # of the rows of a channel that is sampled row by row
_WHOLE_HZ = 0.005
_ORDINARY = 0.95  # of the steps between rows are no large move
_SURELY = 5.0  # standard errors between two means that are surely different
_NO_SHARED = 0.1  # of a step: means this close may differ by chance


@dataclass(frozen=True)
class Rows:
    """Usable rows in order of time: `order` are their indices in the file, `time_s` their stamps.

    Equal stamps may follow each other.
    """

    order: NDArray[np.intp]
    time_s: FloatArray
    entries: tuple[AuditEntry, ...]


class Passed(NamedTuple):
    """Days and hours by which a clock is behind, since it starts anew at midnight or each hour."""

    days: int = 0
    hours: int = 0
    hourly: bool = False  # whether it shows minutes and seconds alone


_NOTHING = Passed()


def unwrap_clock(
    period_s: float,
    stamps: FloatArray,
    so_far: tuple[float, int] = (np.nan, 0),
    max_gap_s: float = np.inf,
) -> tuple[FloatArray, int]:
    """Add the periods that have passed to the stamps of a clock that starts anew each period.

    `so_far` is the last stamp before these, and how many periods had passed then. Returns the
    stamps, and how many have passed at their end. A clock passes midnight, or the full hour, only
    from the last minute of a period to the first of one, and back for a row that comes late; and
    only where the step that this makes is at most `max_gap_s`. Other stamps stay as they are.
    """
    before_s, times = so_far
    known = (stamps >= 0.0) & (stamps <= period_s)
    clock = np.concatenate([[before_s - times * period_s], stamps[known]])
    late = (clock > period_s - _MINUTE_S) & (clock <= period_s)
    early = (clock >= 0.0) & (clock < _MINUTE_S)
    on, back = (np.abs(np.diff(clock) + sign * period_s) <= max_gap_s for sign in (1.0, -1.0))
    begun = (late[:-1] & early[1:] & on).astype(np.intp) - (early[:-1] & late[1:] & back)
    passed = np.maximum(times + np.cumsum(begun), 0)
    if not passed.any():
        return stamps, times
    going_on = stamps.copy()
    going_on[known] += period_s * passed
    return going_on, int(passed[-1])


def clock_goes_on(
    stamps: FloatArray, max_gap_s: float, before_s: float = np.nan, passed: Passed = _NOTHING
) -> tuple[FloatArray, Passed, tuple[AuditEntry, AuditEntry]]:
    """Continue a clock past midnight and, if it shows no hours, past each full hour.

    The latter only where nothing is missing; a column of seconds that goes back to 0 is another
    recording. Returns the stamps, what has passed at their end, and the audit entries of the rows
    moved.
    """
    going_on, hours = stamps, passed.hours
    if passed.hourly:
        since = before_s - passed.days * DAY_S
        going_on, hours = unwrap_clock(_HOUR_S, stamps, (since, hours), max_gap_s)
    daily, days = unwrap_clock(DAY_S, going_on, (before_s, passed.days))
    entries = (
        AuditEntry("*", "repaired", FULL_HOUR, int((going_on > stamps).sum())),
        AuditEntry("*", "repaired", MIDNIGHT, int((daily > going_on).sum())),
    )
    return daily, Passed(days, hours, passed.hourly), entries


def ordered_rows(
    stamps: FloatArray, max_gap_s: float, file: str, numbers: NDArray[np.intp] | None = None
) -> Rows:
    """Drop rows without a usable stamp and put late ones in their place.

    A lone stamp far from both neighbours, which agree with each other, is a fault of the clock:
    its row is dropped. A row that comes late by up to `max_gap_s` is sorted in. Time that goes
    back further is a second recording: `DataError` naming the row, by its number in the file.
    """
    finite = np.abs(stamps) < _LATEST_S  # false for NaN
    order = np.flatnonzero(finite)
    spikes = _lone_spikes(stamps[order], max_gap_s)
    kept = order[~spikes]
    time = stamps[kept]
    lateness = np.maximum.accumulate(time) - time if len(time) else time
    if not finite.any() and np.isfinite(stamps).any():
        first = float(stamps[np.isfinite(stamps)][0])
        raise DataError(
            f"stamps like {first:.13g} are later than any clock that counts seconds",
            file=file,
            channel="time_s",
            hint="Set the unit of time_s: 'ms', 'us' or 'ns'",
        )
    if (lateness > max_gap_s).any():
        at = int((lateness > max_gap_s).argmax())
        raise DataError(
            f"time goes back from {stamp(time[:at].max())} to {stamp(time[at])}",
            file=file,
            channel="time_s",
            row=int(kept[at]) + 1 if numbers is None else int(numbers[kept[at]]),
            hint=_where_it_goes_back(float(time[:at].max()), float(time[at])),
        )
    sorting = np.argsort(time, kind="stable")
    entries = (
        AuditEntry("*", "dropped", "no time stamp", int((~finite).sum())),
        AuditEntry("*", "dropped", "lone wrong time stamp", int(spikes.sum())),
        AuditEntry("*", "repaired", "out of order", int((lateness > 0.0).sum())),
    )
    return Rows(kept[sorting], time[sorting], entries)


def _where_it_goes_back(before_s: float, after_s: float) -> str:
    if _HOUR_S - _MINUTE_S < before_s <= _HOUR_S and after_s < _MINUTE_S:
        return (
            "A worksheet that shows MM:SS.0 leaves the hours out: write HH:MM:SS.0; "
            "or, if it holds more than one recording, split the file there"
        )
    return (
        "It holds more than one recording: split the file there, or name the column that tells "
        "them apart in [logs] instances"
    )


def _lone_spikes(time: FloatArray, max_gap_s: float) -> BoolArray:
    spikes = np.zeros(len(time), dtype=np.bool_)
    if len(time) > 2:
        far = np.abs(np.diff(time)) > max_gap_s
        near = np.abs(time[2:] - time[:-2]) <= max_gap_s
        spikes[1:-1] = far[:-1] & far[1:] & near
    return spikes


def split_at_gaps(time: FloatArray, max_gap_s: float) -> list[slice]:
    cuts = np.flatnonzero(np.diff(time) > max_gap_s) + 1
    edges = [0, *cuts.tolist(), len(time)]
    return [slice(start, stop) for start, stop in pairwise(edges)]


def all_apart(max_gap_s: float, file: str) -> DataError:
    """Return the error of a recording that falls into single rows at its gaps."""
    return DataError(
        f"no two samples are closer than max_gap_s = {max_gap_s:g} s",
        file=file,
        channel="time_s",
        hint="Raise [logs] max_gap_s or check the unit of time_s",
    )


def native_interval(time: FloatArray) -> float:
    """Estimate the sampling interval of ordered stamps despite rounding, jitter and gaps.

    In seconds. The median advance over up to 256 rows is divided by their number: stamps printed
    with five digits repeat or jump, but keep time over the long run. A whole number of Hz is
    taken where it is within 0.5 %, else the interval to four digits, else as measured.
    """
    rows = np.unique(time)
    if len(rows) < 2:
        raise DataError("fewer than two different time stamps")
    measured = _median_advance(rows)
    tidy = float(f"{measured:.4g}")
    rate = round(1.0 / measured)
    if rate and abs(rate * measured - 1.0) <= 0.005:
        tidy = 1.0 / rate
    mean = float(rows[-1] - rows[0]) / (len(rows) - 1)
    median = float(np.median(np.diff(rows)))  # right where many rows are missing
    for interval in (tidy, measured, mean, 1.0 / max(1, round(1.0 / median)), median):
        if on_grid(rows, interval):
            return interval
    return tidy


def _median_advance(rows: FloatArray) -> float:
    """Median advance per row over the longest stretches without a gap."""
    steps = np.diff(rows)
    gaps = np.concatenate([[0], np.cumsum(steps > 3.0 * np.median(steps))])
    for span in _BASELINES_ROWS:
        whole = gaps[span:] == gaps[:-span]
        if whole.any():
            return float(np.median((rows[span:] - rows[:-span])[whole])) / span
    return float(np.median(steps))


def on_grid(time: FloatArray, interval: float) -> bool:
    """Whether every stamp is within 1 % of a whole number of intervals after the first."""
    steps = (time - time[0]) / interval
    return bool((np.abs(steps - np.round(steps)) <= ON_GRID).all())


def undo_rounding(time: FloatArray, interval: float) -> FloatArray:
    """Exact stamps of evenly sampled rows whose stamps were printed with few digits.

    Row `k` belongs to a whole number of intervals `n_k`, strictly increasing, with
    `n_k * interval` within the rounding of its stamp. Where such numbers exist they are the
    simplest explanation of uneven (0.03, 0.06, 0.09, 0.13) or equal stamps, and are taken; else
    the stamps are returned as they are.
    """
    rounding = printed_step(time)
    shared = len(time) > _SHARED * len(np.unique(time))  # whole seconds lie on any grid of Hz
    if on_grid(time, interval) and not shared:
        return time
    slack = 0.5001 * (rounding + rounding[0]) + ON_GRID * interval
    steps = (time - time[0]) / interval
    low = np.ceil(steps - slack / interval)
    high = np.floor(steps + slack / interval)
    number = earliest_numbers(low)
    if (number > high).any():
        return time
    if shared and time[-1] > time[0]:
        # A recording begins within a second: its first rows lie at the end of that.
        first = int(np.count_nonzero(time == time[0]))
        number[:first] = np.minimum(number[first] - first, high[0]) + np.arange(first)
    return np.asarray(time[0] + (number - number[0]) * interval)


def earliest_numbers(low: FloatArray) -> FloatArray:
    """Find the least strictly increasing `n_k >= low_k`: `n_k = k + max_{j<=k}(low_j - j)`."""
    count = np.arange(len(low))
    return np.asarray(count + np.maximum.accumulate(low - count))


def printed_step(time: FloatArray) -> FloatArray:
    """Find the step of the last printed digit around each stamp; 0 where none look rounded."""
    decimals = np.full(len(time), _MAX_DECIMALS)
    for digits in range(_MAX_DECIMALS - 1, -1, -1):
        decimals[np.abs(time - np.round(time, digits)) <= 4.0 * np.spacing(np.abs(time))] = digits
    # A stamp like 1200 shows no digits only because zeros were left out; its neighbours show them.
    # Where the digits change (999.97, 1000.1) the coarser of both sides counts.
    before, after = (
        maximum_filter1d(decimals, size=101, mode="reflect", origin=shift) for shift in (50, -50)
    )
    decimals = np.minimum(before, after)
    return np.where(decimals == _MAX_DECIMALS, 0.0, 10.0**-decimals)


def usual_interval(time: FloatArray, channels: Mapping[str, FloatArray], file: str) -> float:
    """Find the interval of ordered rows in s; `DataError` where the stamps can be no seconds."""
    interval = row_interval(time, channels)
    if interval < _SHORTEST_S:
        raise DataError(
            f"the rows are {interval:.3g} s apart, which no recorder of flights does",
            file=file,
            channel="time_s",
            hint="Set the unit of time_s: days (of a worksheet) are 'd', hours 'h', minutes 'min'",
        )
    return interval


def row_interval(time: FloatArray, channels: Mapping[str, FloatArray]) -> float:
    """Find the interval of ordered rows `(rows,)` in s, with one row to a stamp or several."""
    return shared_interval(time, channels) or native_interval(time)


def shared_interval(time: FloatArray, channels: Mapping[str, FloatArray]) -> float:
    """Find the interval in s of ordered rows of which several share each stamp; 0 if none do.

    `channels` are the other columns of the same rows. A whole number of Hz is taken where it is
    within 0.5 % and keeps time over all rows.
    """
    stamps, counts = np.unique(time, return_counts=True)
    if len(stamps) < _FEW or np.median(counts) < 2.0 or not _row_by_row(time, channels):
        return 0.0
    steps = np.diff(stamps)
    step = float(np.median(steps))
    if not on_grid(stamps, step):
        return 0.0
    whole = np.isclose(steps[1:], step) & np.isclose(steps[:-1], step)
    rows = counts[1:-1][whole]  # the first and the last stamp may be cut
    if len(rows) < _FEW or np.mean(np.abs(rows - rows.mean()) <= 1.0) < _REGULAR:
        return 0.0
    measured = step / float(rows.mean())
    rate = round(1.0 / measured)
    near = rate and abs(rate * measured - 1.0) <= _WHOLE_HZ
    for interval in (1.0 / rate, measured) if near else (measured,):
        if not np.array_equal(undo_rounding(time, interval), time):
            return float(interval)
    return 0.0


def _row_by_row(time: FloatArray, channels: Mapping[str, FloatArray]) -> bool:
    """Whether rows that share a stamp follow each other in time, by each channel that changes."""
    same = np.diff(time) == 0.0
    channels = {
        name: np.where(np.isfinite(values), values, np.nan) for name, values in channels.items()
    }
    if any(_opposed(values, same) for values in channels.values()):
        return False
    found = []
    for values in channels.values():
        steps = np.diff(values)
        known = np.isfinite(steps)
        within, between = steps[same & known], steps[~same & known]
        if np.isfinite(values).mean() < _FILLED or np.mean(within != 0.0) < _CHANGES:
            continue
        found.append(_alike(within, between))
    return bool(found) and all(found)


def _opposed(values: FloatArray, same: BoolArray) -> bool:
    """Whether rows that share a stamp come from different engines, instances or units.

    The change within a stamp is then a difference that lasts, and the step between two later
    stamps takes it back: their product is negative. For one signal in motion it is positive, and
    noise, of which the two share no sample, leaves it at zero.
    """
    last = np.flatnonzero(~same)  # of each stamp but the last
    if len(last) < _FEW + 2:
        return False
    change = values[last[1:]] - values[last[:-1] + 1]
    product = change[:-1] * (values[last[2:] + 1] - values[last[2:]])
    product = product[np.isfinite(product)]
    if len(product) < _FEW or not product.any():
        return False
    # Large moves, in which both are the same engine's, must not decide alone.
    low, high = np.quantile(product, [1.0 - _ORDINARY, _ORDINARY])
    product = np.clip(product, low, high)
    error = float(product.std()) / float(np.sqrt(len(product)))
    return float(product.mean()) < -_SURELY * error


def _alike(within: FloatArray, between: FloatArray) -> bool:
    """Whether rows step from each other within a stamp as they do from one to the next.

    Rows of two engines in turn step up within each and down between them, and further within.
    """
    every = np.concatenate([within, between])
    low, high = np.quantile(every, [1.0 - _ORDINARY, _ORDINARY])
    within, between = np.clip(within, low, high), np.clip(between, low, high)
    error = np.hypot(within.std() / np.sqrt(len(within)), between.std() / np.sqrt(len(between)))
    apart = abs(float(within.mean() - between.mean()))
    return apart <= max(_SURELY * float(error), _NO_SHARED * float(np.abs(within).mean()))
