"""Windows of a load whose shift is known, as that of other flights is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from narxcal.support.arrays import BoolArray, FloatArray
from training.gap.levels import (
    Found,
    Levels,
    climb,
    inverse_of,
    of_paths,
    paths,
    search_levels,
    share_there,
    without_nuisances,
)

_LOW, _PLAIN = 0.1, 0.3  # where off is, of all levels; least that is explained from there


def search_known(levels: Levels, shift: FloatArray) -> Found | None:
    """Find when a load of a known `shift` (channels,) was on; None where it was on nowhere.

    From what nuisances leave, and from the levels as they are: slow wandering takes up most of a
    long window as long as nobody knows when it was. Levels as they are wander by themselves, so
    that the paths they lead to have to explain `_PLAIN` of what there is.
    """
    left = without_nuisances(levels)
    found = climb(levels, shift, left, fixed=True)
    plain = climb(levels, shift, left, fixed=True, begin=_as_they_are(levels, shift))
    if plain is None or plain.explained < max(_PLAIN, 0.0 if found is None else found.explained):
        return found
    return plain


def search_any_size(
    levels: Levels,
    shift: FloatArray,
    found: Found | None,
    taken: Callable[[BoolArray], FloatArray],
) -> Found | None:
    """Add windows of flights in which none is of the known size, but levels come and go.

    At idle a load shifts an engine otherwise than at power, and no path is that of the known
    `shift`. Windows of any size count if this shift explains `_PLAIN` of all there is in these
    flights: `taken` says for paths (flights, blocks) what share it takes off each (flights,).
    """
    on = np.zeros_like(levels.known) if found is None else found.on.copy()
    for group in levels.groups:
        rows = list(group)
        if on[rows].any() or not levels.known[rows].any():
            continue
        there = search_levels(_of_group(levels, rows))
        if there is None:
            continue
        tried = np.zeros_like(on)
        tried[rows] = there.on
        if float(taken(tried)[rows].min()) >= _PLAIN:
            on |= tried
    before = None if found is None else found.on
    if not on.any() or (before is not None and np.array_equal(on, before)):
        return found
    return of_paths(on, levels, shift)


def _of_group(levels: Levels, rows: list[int]) -> Levels:
    """The levels of the flights of one group alone."""
    return replace(
        levels,
        residual=levels.residual[rows],
        known=levels.known[rows],
        nuisances=levels.nuisances[rows],
        groups=(tuple(range(len(rows))),),
    )


def _as_they_are(levels: Levels, shift: FloatArray) -> BoolArray:
    """Paths (flights, blocks) by the levels less those of their flight that are low."""
    middle = [_of_known(row, known, 0.5) for row, known in _flights(levels.residual, levels)]
    centred = levels.residual - np.stack(middle)[:, None]
    there = share_there(levels.residual, shift, inverse_of(centred, levels.known))
    low = [_of_known(row, known, _LOW) for row, known in _flights(there, levels)]
    return paths(there - np.stack(low)[:, None], levels)


def _flights(values: FloatArray, levels: Levels) -> zip[tuple[FloatArray, BoolArray]]:
    return zip(values, levels.known, strict=True)


def _of_known(row: FloatArray, known: BoolArray, share: float) -> FloatArray:
    """Quantile of the known blocks; zero where none is."""
    if not known.any():
        return np.zeros(row.shape[1:])
    return np.asarray(np.quantile(row[known], share, axis=0))
