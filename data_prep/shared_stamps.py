"""Stamps that several rows share because the clock shows whole seconds: how far apart the rows are.

A recorder of ten rows a second whose clock shows seconds writes the same stamp ten times. Counted
per stamp the rows say their own rate, and `data_prep.stamps.undo_rounding` puts them in between.
Where each row of a stamp holds other channels, another engine, or the same values again, nothing
lies in between.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from data_prep.stamps import native_interval, on_raster, undo_rounding
from narxcal.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from data_prep.log import FloatArray

_SHORTEST_S = 1e-4
_FEW = 3  # whole stamps, at least
_REGULAR = 0.9  # of the stamps hold as many rows as the others, or one more or less
_FILLED, _CHANGES = 0.9, 0.02  # of the rows of a channel that is sampled row by row
_WHOLE_HZ = 0.005
_ORDINARY = 0.95  # of the steps between rows are no large move
_SURELY, _NOTHING = 5.0, 0.1  # standard errors, and of a step: so far apart means may be by chance


def usual_interval(time: FloatArray, channels: Mapping[str, FloatArray], file: str) -> float:
    """`row_interval`, refused where no recorder is so fast: the stamps are no seconds."""
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
    """Interval of ordered rows `(rows,)` in s, be there one row to a stamp or several."""
    return shared_interval(time, channels) or native_interval(time)


def shared_interval(time: FloatArray, channels: Mapping[str, FloatArray]) -> float:
    """Interval of ordered rows `(rows,)` of which several share each stamp, in s; 0 if none do.

    `channels` are the other columns of the same rows. A whole number of Hz is taken where it is
    within 0.5 % and keeps time over all rows.
    """
    stamps, counts = np.unique(time, return_counts=True)
    if len(stamps) < _FEW or np.median(counts) < 2.0 or not _row_by_row(time, channels):
        return 0.0
    steps = np.diff(stamps)
    step = float(np.median(steps))
    if not on_raster(stamps, step):
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
    """Whether rows that share a stamp follow each other in time, by every channel that tells."""
    same = np.diff(time) == 0.0
    told = []
    for values in channels.values():
        steps = np.diff(values)
        known = np.isfinite(steps)
        within, between = steps[same & known], steps[~same & known]
        if np.isfinite(values).mean() < _FILLED or np.mean(within != 0.0) < _CHANGES:
            continue
        told.append(_alike(within, between))
    return bool(told) and all(told)


def _alike(within: FloatArray, between: FloatArray) -> bool:
    """Whether rows step from each other within a stamp as they do from one to the next.

    Rows of two engines in turn step up within each and down between them, and further within.
    """
    every = np.concatenate([within, between])
    low, high = np.quantile(every, [1.0 - _ORDINARY, _ORDINARY])
    within, between = np.clip(within, low, high), np.clip(between, low, high)
    error = np.hypot(within.std() / np.sqrt(len(within)), between.std() / np.sqrt(len(between)))
    apart = abs(float(within.mean() - between.mean()))
    return apart <= max(_SURELY * float(error), _NOTHING * float(np.abs(within).mean()))
