"""Parts of long flights, where there are too few flights to take each for one witness."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from eval.gap.data import Pair
from narxcal.support.arrays import FloatArray

FEWEST = 3  # flights
_LEAST_S, _MOST = 300.0, 6
_SEARCH_S = 60.0


def enough(pairs: Sequence[Pair]) -> list[Pair]:
    """The pairs themselves, or, of fewer than three, their parts of at least five minutes.

    A flight is cut where its driver stands stillest, into six parts at most.
    """
    if len(pairs) >= FEWEST:
        return list(pairs)
    return [part for pair in pairs for part in _cut(pair)]


def _cut(pair: Pair) -> list[Pair]:
    samples, dt_s = len(pair.time_s), pair.dt_s
    count = int(np.clip(samples * dt_s / _LEAST_S, 1, _MOST))
    width = max(1, round(2.0 / dt_s))
    motion = np.abs(np.gradient(pair.inputs[pair.driver]))
    motion = np.convolve(motion, np.ones(width), mode="same")
    reach = round(min(_SEARCH_S, 0.1 * _LEAST_S) / dt_s)
    cuts = [0]
    for k in range(1, count):
        middle = k * samples // count
        cuts.append(middle - reach + int(np.argmin(motion[middle - reach : middle + reach])))
    cuts.append(samples)
    if count == 1:
        return [pair]
    return [
        _part(pair, slice(start, stop), k + 1) for k, (start, stop) in enumerate(pairwise(cuts))
    ]


def _part(pair: Pair, rows: slice, number: int) -> Pair:
    def cut(channels: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
        return {name: values[rows] for name, values in channels.items()}

    return replace(
        pair,
        name=f"{pair.name}#{number}",
        time_s=pair.time_s[rows],
        inputs=cut(pair.inputs),
        real=cut(pair.real),
        sim=cut(pair.sim),
        others=cut(pair.others),
        counts=pair.counts if number == 1 else {},
    )
