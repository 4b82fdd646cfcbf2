"""What stands beside what is to be expected, and would be hidden by its leading.

Metal takes heat up and gives it back in every engine, and a simulator that was identified from
flights has little of it. What a control's limit leaves to accelerate with is the difference of two
large torques, and differs from build to build. So wherever else the simulator is nearly right, heat
soak or a limit leads, and leading says nothing about what else is wrong. There every effect of
lever moves is asked what it takes of what the leader leaves, both fitted together. One that takes
more than such effects gain on pseudo-nulls, in nearly every flight, is the news and comes first.
Drifts and loads are no part of the question: they follow slow noise, in which they gain ten times
as much as effects of moves do, and would set the threshold for these.
"""

from __future__ import annotations

import numpy as np

from narxcal.effects.sensor_side import SensorDrift
from narxcal.support.arrays import FloatArray
from training.gap.fitting import Fit, fit, in_nearly_all
from training.gap.foils import foil, heat_of
from training.gap.null import null_gains
from training.gap.together import added, in_order, is_expected, is_heat
from training.gap.unlogged import has_load, priced
from training.gap.work import Watch, Work

_ASKED = 4  # by linear steps, of which each is then fitted
_LEAST = 0.01  # of the gap, beyond small misfit
_BY_MOVES = 0.5  # of what is asked beside heat: a limit follows nothing slow


def beside(work: Work, watch: Watch | None = None) -> Fit | None:
    """The best effect of moves together with what is expected and leads; None if none is seen.

    What is fitted is added to the models of `work`.
    """
    leader = max(work.fits, key=work.rank, default=None)
    if leader is None or not is_expected(leader):
        return None
    movers = [one for one in work.fits if _moves(one) and one is not leader]
    if not movers:
        return None
    pairs = sorted((added(*in_order(leader, one)) for one in movers), key=work.worth, reverse=True)
    found = []
    for k, pair in enumerate(pairs[:_ASKED]):
        if watch is not None:
            watch(" + ".join(effect.name for effect in pair.effects), k, _ASKED)
        found.append(
            priced(fit(pair.effects, work.problem, pair.theta), work.problem.flights.price)
        )
    work.fits += found
    rarely = _threshold(work, movers, leader)
    seen = [pair for pair in found if _seen(work, pair, leader, rarely)]
    return max(seen, key=work.rank, default=None)


def stands(work: Work, pair: Fit, leader: Fit) -> bool:
    """Whether what a pair takes beyond its leader may be named, whatever else is left.

    It is asked for what a single effect is: so much beyond small misfit, times the share that it
    explains of what the leader leaves where it acts itself.
    """
    more = work.beyond(pair) - work.beyond(leader)
    known = heat_of(pair) if is_heat(leader) else leader.response
    aligned = work.explained(pair.response - known, work.problem.misfit.gap - known)
    share, (least, explained) = float(more.sum()) / work.audible, work.options.apart
    least *= 1.0 if is_heat(leader) else _BY_MOVES
    return share * aligned >= least and aligned >= explained and in_nearly_all(more)


def _moves(one: Fit) -> bool:
    """Whether a single effect follows what the lever does, and quicker than heat."""
    slow = is_heat(one) or has_load(one) or isinstance(one.effects[0], SensorDrift)
    return len(one.effects) == 1 and not slow


def _threshold(work: Work, movers: list[Fit], leader: Fit) -> float:
    """Q that the best effect of moves rarely gains where the leader is all there is."""
    measure, options = work.problem.misfit, work.options
    residual: FloatArray = measure.cleaned(measure.gap - leader.response)
    gains = null_gains(movers, measure, residual, options.draws, options.seed)
    return float(np.quantile(gains, options.quantile))


def _seen(work: Work, pair: Fit, leader: Fit, threshold: float) -> bool:
    """Whether a pair is more than its leader: beyond noise, small misfit, in nearly all flights."""
    gained = leader.held_out - pair.held_out
    beyond = float(work.beyond(pair).sum() - work.beyond(leader).sum())
    if not (float(gained.sum()) > threshold and in_nearly_all(gained)):
        return False
    if beyond < _LEAST * work.audible:
        return False
    return not foil(pair, work.problem.misfit, work.problem.flights.signals.outputs)
