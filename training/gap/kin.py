"""Neighbours on one channel, told apart by quick moves: a lag, a late record, metal that warms.

A slow probe, a record that comes late and slow heat all leave a temperature behind, and most of the
energy of any of them lies in the minutes after a move, where an engine differs from its simulator
anyway. What fits these minutes best need not be what is there. The seconds of a move tell: a probe
that is made slow enough to follow the heat comes too late in all of them. So these are compared
octave by octave of frequency, each by the logarithm of what is left in it, as often as it has
independent samples: Whittle's likelihood (*Arkiv foer Matematik* 2, 1953) of a residual of any
colour, with Schwarz' price of a parameter (*Annals of Statistics* 6, 1978). They keep the places
that they have among all effects, and take them in that order.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.fft import dct

from narxcal.effects.sensor_side import SensorLag, TimeSkew
from training.gap.fitting import Fit
from training.gap.together import is_heat
from training.gap.whitened import QUICKEST_HZ, by_octave
from training.gap.work import Work

_COMPARABLE = 0.5  # of the rank of the first: one that explains less is no other name for it


def standings(work: Work) -> dict[str, float]:
    """What the rank of an effect is to be multiplied by, by its name, where it has neighbours."""
    factors: dict[str, float] = {}
    for kin in _neighbours(work):
        ranks = sorted((work.rank(one) for one in kin), reverse=True)
        order = sorted(kin, key=lambda one: _surprise(work, one))
        factors |= {one.name: rank / work.rank(one) for one, rank in zip(order, ranks, strict=True)}
    return factors


def _neighbours(work: Work) -> Iterator[list[Fit]]:
    """Single effects that make one channel late, and gain about as much, two or more."""
    singles = [one for one in work.fits if len(one.effects) == 1]
    for channel in work.problem.flights.signals.outputs:
        kin = [one for one in singles if _makes_late(one, channel)]
        first = max((work.rank(one) for one in kin), default=0.0)
        kin = [one for one in kin if work.rank(one) > _COMPARABLE * first]
        if len(kin) > 1:
            yield kin


def _makes_late(one: Fit, channel: str) -> bool:
    sensor = isinstance(one.effects[0], SensorLag | TimeSkew) and one.effects[0].channel == channel
    return sensor or (channel == "EGT_C" and is_heat(one))


def _surprise(work: Work, tried: Fit) -> float:
    """Negative logarithm of the likelihood of what is left, and half a logarithm per parameter."""
    measure, lengths = work.problem.misfit, work.problem.flights.lengths
    rest = measure.cleaned(measure.gap - tried.response) * (measure.weights > 0.0)
    halves = 2.0 * QUICKEST_HZ * work.problem.flights.signals.dt_s  # half cycles per sample
    surprise, count = 0.0, 0
    for values, length in zip(rest, lengths, strict=True):
        last = int(halves * length) + 1
        power = dct(values[:length], axis=0, norm="ortho")[1:last] ** 2
        surprise += 0.5 * float(np.log(by_octave(power) + work.noise**2).sum())
        count += power.size
    return surprise + 0.5 * len(tried.theta) * float(np.log(max(count, 1)))
