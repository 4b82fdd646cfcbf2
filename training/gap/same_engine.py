"""Whether the recorded engine is the simulator's own, but for an effect on how it moves.

No two builds settle alike: components a percent apart shift what they settle at by a thousandth of
its level at least, and so does whatever a simulator lacks of an engine; no two sensors read alike
either. Where all that settles is as simulated, to a fraction of that, at more than one power, the
record was made from this very simulator: then no misfit is anybody's, and an effect has to be
larger than noise alone makes it, not larger than what builds and simulators differ by.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from narxcal.effects.base import FloatArray
from narxcal.effects.running import Flights
from training.gap.quadratic import Misfit
from training.gap.scatter import levels

_REST_S: Final = 15.0  # for so long the simulator's outputs have stood still
_STILL: Final = 0.002  # of their ranges
_BLOCK_S: Final = 10.0
_FEW: Final = 6  # blocks, of all flights
_APART: Final = 0.2  # of the first output's range: powers that are not one
_ALIKE: Final = 2e-4  # of its level: what an output may be off at rest
_CHANCE: Final = 2.0  # standard errors of a block's mean


def is_same_engine(
    flights: Flights, measure: Misfit, response: FloatArray, noise: FloatArray
) -> bool:
    """Whether what a `response` (flights, time, outputs) leaves of the gap is noise at rest.

    `noise` (outputs,) is its standard deviation. Where too little stood still, or at one power
    alone, nobody knows: False.
    """
    rest, signals = measure.gap - response, flights.signals
    steps = max(1, round(_BLOCK_S / signals.dt_s))
    found = [_blocks(flights, measure, rest, (f, steps)) for f in range(len(rest))]
    off, power = (np.concatenate(part) for part in zip(*found, strict=True))
    if len(power) < _FEW or np.ptp(power) < _APART * (signals.high[0] - signals.low[0]):
        return False
    level = np.sqrt(np.mean(levels(flights.y, signals.outputs) ** 2, axis=(0, 1)))
    bound = np.maximum(_ALIKE * level, _CHANCE * noise / np.sqrt(steps))
    known = (measure.weights > 0.0).any(axis=(0, 1))
    return bool((np.sqrt(np.mean(off**2, axis=0)) <= bound)[known].all())


def _blocks(
    flights: Flights, measure: Misfit, rest: FloatArray, place: tuple[int, int]
) -> tuple[FloatArray, FloatArray]:
    """Means of what is left (blocks, outputs), and of the first simulated output (blocks,).

    Of blocks of a flight that are at rest throughout and known in every output that is known.
    """
    f, steps = place
    signals, y = flights.signals, flights.y[f]
    window = max(1, round(_REST_S / signals.dt_s))
    # The window ends at the sample: an engine that has just arrived has not stood still.
    behind = (window - 1) // 2
    moved = maximum_filter1d(y, window, axis=0, origin=behind) - minimum_filter1d(
        y, window, axis=0, origin=behind
    )
    still = (moved <= _STILL * (signals.high - signals.low)).all(axis=1)
    still &= (measure.weights[f][:, (measure.weights > 0.0).any(axis=(0, 1))] > 0.0).all(axis=1)
    still &= np.arange(len(y)) < flights.lengths[f]
    count = len(y) // steps
    whole = still[: count * steps].reshape(count, steps).all(axis=1)
    means = rest[f, : count * steps].reshape(count, steps, rest.shape[-1]).mean(axis=1)[whole]
    power = y[: count * steps, 0].reshape(count, steps).mean(axis=1)[whole]
    return means, power
