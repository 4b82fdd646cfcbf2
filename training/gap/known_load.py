"""Windows of a load whose shift is known, as that of other flights is."""

from __future__ import annotations

import numpy as np

from training.gap.levels import (
    BoolArray,
    FloatArray,
    Found,
    Levels,
    climb,
    inverse_of,
    paths,
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
