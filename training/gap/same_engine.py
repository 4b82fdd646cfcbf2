"""Whether the recorded engine is the simulator's own, but for an effect on how it moves.

No two builds settle alike: components a percent apart shift what they settle at by a thousandth of
its level at least, and so does whatever a simulator lacks of an engine; no two sensors read alike
either. Where what settles is as simulated, to a fraction of that, at more than one power, the
record was made from this very simulator: then no misfit is anybody's, and an effect has to be
larger than noise alone makes it, not larger than what builds and simulators differ by. An effect
may shift what settles while it is on, or one reading all along: a third of what is at rest and all
outputs but one are enough, of which builds have none.

Flights that never come to rest say it by the offsets and slopes over power that would have to be
taken out of the gap: of builds whose components scatter by half a percent they are three times a
thousandth of the level at least, of the same engine half of it. There one reading may be off by the
same all along, or by the same rate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from narxcal.effects.running import Flights
from narxcal.support.arrays import FloatArray
from training.gap.fitting import Fit
from training.gap.quadratic import Misfit
from training.gap.scatter import levels
from training.gap.work import Work

_REST_S: Final = 15.0  # for so long the simulator's outputs have stood still
_STILL: Final = 0.01  # of their ranges
_BLOCK_S: Final = 10.0
_FEW: Final = 6  # blocks, of all flights
_APART: Final = 0.2  # of the first output's range: powers that are not one
_ALIKE: Final = 2e-4  # of its level: what an output may be off at rest
_CHANCE: Final = 3.0  # standard errors of a block's mean
_PART, _NEARLY_ALL = 1.0 / 3.0, 0.8  # of what is at rest
_PAIR: Final = 2  # outputs: beside one that is off, the other alone says too little
_SHIFTED: Final = 1e-3  # of its level: offsets and slopes over power that an output needs
_BESIDE: Final = 0.3  # of that, beside a sensor's: a build that shifts one output shifts others
_OF_ITSELF: Final = 0.85  # of what is left: what a small offset of the same engine explains


class _Rest(NamedTuple):
    """What is off at rest, in means over blocks (blocks, outputs), and at what power (blocks,)."""

    off: FloatArray
    power: FloatArray


def is_same_engine(work: Work) -> bool:
    """Whether the gap is of the simulator's own engine, as it stands or without what moves in it.

    That is what leads, or takes most of the gap.
    """
    leader, most = work.fits[0], max(work.fits, key=work.gain)
    flights, measure = work.problem.flights, work.problem.misfit
    return any(
        settles_alike(flights, measure, response, work.noise)
        or needs_no_shift(flights, measure, response)
        for response in (np.zeros_like(leader.response), leader.response, most.response)
    )


def is_but_for(work: Work, offset: Fit, left: Misfit) -> bool:
    """Whether what is `left` of the gap is of the simulator's own engine but for an offset.

    Which explains that: of the same engine nothing else is to be expected.
    """
    before = left.size(left.gap)
    explained = float((before - offset.held_out).sum())
    if explained < _OF_ITSELF * float((before - left.floor).sum()):
        return False
    flights, measure = work.problem.flights, replace(work.problem.misfit, gap=left.gap)
    if settles_alike(flights, measure, offset.response, work.noise, beside=True):
        return True
    # An offset of several parameters takes just the shifts that would tell of another build.
    plain = len(offset.theta) == 1
    return plain and needs_no_shift(flights, measure, offset.response, beside=True)


def settles_alike(
    flights: Flights,
    measure: Misfit,
    response: FloatArray,
    noise: FloatArray,
    *,
    beside: bool = False,
) -> bool:
    """Whether what a `response` (flights, time, outputs) leaves of the gap is noise at rest.

    In a third of what is at rest: an effect may be on for a while. One output of three or more may
    be off, by a sensor. Beside an offset no other has to be, and hardly any time. `noise`
    (outputs,) is its standard deviation. Where too little stood still, or at one power alone,
    nobody knows: False.
    """
    signals, known = flights.signals, measure.weights > 0.0
    steps = max(1, round(_BLOCK_S / signals.dt_s))
    rest = _at_rest(flights, (measure.gap - response, known), steps)
    if len(rest.power) < _FEW:
        return False
    bound = np.maximum(_ALIKE * _level(flights), _CHANCE * noise / np.sqrt(steps))
    alike = (np.abs(rest.off) <= bound)[:, known.any(axis=(0, 1))]
    outputs = alike.shape[1]
    sets = [alike]
    if not beside and outputs > _PAIR:
        sets += [np.delete(alike, k, axis=1) for k in range(outputs)]
    span = _APART * float(signals.high[0] - signals.low[0])
    least = _NEARLY_ALL if beside else _PART
    return any(
        rows.mean() >= least and float(np.ptp(rest.power[rows])) >= span
        for rows in (each.all(axis=1) for each in sets)
    )


def needs_no_shift(
    flights: Flights, measure: Misfit, response: FloatArray, *, beside: bool = False
) -> bool:
    """Whether hardly any offset or slope over power has to be taken out of what is left.

    But for one sensor's bias or drift, unless `response` (flights, time, outputs) is an offset
    `beside` which nothing is; one of several parameters is such shifts itself, and says nothing.
    `measure` has to leave offsets and slopes their room.
    """
    known = measure.weights > 0.0
    rows = known[..., known.any(axis=(0, 1))].all(axis=2)

    def off(left: FloatArray) -> FloatArray:
        return _rms((left - measure.cleaned(left))[rows])

    bound = _SHIFTED * _level(flights)
    less, gap = _BESIDE * bound, (measure.gap - response, known)
    bounds = (less, 0.0) if beside else (bound, less)
    return bool(rows.any()) and _within(flights, gap, off, bounds)


def _within(
    flights: Flights,
    gap: tuple[FloatArray, NDArray[np.bool_]],
    off: Callable[[FloatArray], FloatArray],
    bounds: tuple[FloatArray, FloatArray | float],
) -> bool:
    """Whether all that is `off` (outputs,) is within bounds, but for one sensor's.

    The second of `bounds` is of what is off beside a sensor's bias or drift; 0 allows none.
    """
    left, known = np.where(gap[1], gap[0], 0.0), gap[1]
    told = known.any(axis=(0, 1))
    apart = np.flatnonzero((off(left) > bounds[0]) & told)
    if len(apart) != 1:
        return len(apart) == 0
    own = left[..., apart[0]], known[..., apart[0]]
    time_s = np.broadcast_to(np.arange(left.shape[1]) * flights.signals.dt_s, own[0].shape)
    for shape in (np.ones_like(own[0]), time_s):
        amount = (own[0] * shape)[own[1]].sum() / max((shape**2)[own[1]].sum(), 1e-9)
        rest = left.copy()
        rest[..., apart[0]] -= np.where(own[1], amount * shape, 0.0)
        if not ((off(rest) > bounds[1]) & told).any():
            return True
    return False


def _level(flights: Flights) -> FloatArray:
    """Of each output (outputs,), over all flights."""
    absolute = levels(flights.y, flights.signals.outputs)
    return np.asarray(np.sqrt(np.mean(absolute**2, axis=(0, 1))))


def _rms(values: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


def _at_rest(flights: Flights, gap: tuple[FloatArray, NDArray[np.bool_]], steps: int) -> _Rest:
    """What is left of the gap of all flights where they are at rest."""
    found = [_blocks(flights, gap, (f, steps)) for f in range(len(gap[0]))]
    return _Rest(*(np.concatenate(part) for part in zip(*found, strict=True)))


def _blocks(
    flights: Flights, gap: tuple[FloatArray, NDArray[np.bool_]], place: tuple[int, int]
) -> _Rest:
    """Blocks of a flight that are at rest throughout and known in every output that is known."""
    left, known = gap
    f, steps = place
    signals, y = flights.signals, flights.y[f]
    window = max(1, round(_REST_S / signals.dt_s))
    # The window ends at the sample: an engine that has just arrived has not stood still.
    behind = (window - 1) // 2
    moved = maximum_filter1d(y, window, axis=0, origin=behind) - minimum_filter1d(
        y, window, axis=0, origin=behind
    )
    still = (moved <= _STILL * (signals.high - signals.low)).all(axis=1)
    still &= known[f][:, known.any(axis=(0, 1))].all(axis=1)
    still &= np.arange(len(y)) < flights.lengths[f]
    count = len(y) // steps
    whole = still[: count * steps].reshape(count, steps).all(axis=1)
    means = left[f, : count * steps].reshape(count, steps, left.shape[-1]).mean(axis=1)[whole]
    power = y[: count * steps, 0].reshape(count, steps).mean(axis=1)[whole]
    return _Rest(means, power)
