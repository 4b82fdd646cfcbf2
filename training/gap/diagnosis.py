"""Which unmodelled effect causes the gap: all candidates, fairly compared, or none of them.

1. Every effect is fitted to all flights; what it is worth is what it takes off flights that had no
   part in the fit (`fitting`). Offsets and slopes over power are nuisances here, so that build
   scatter neither hides nor fakes anything.
2. A claim has to be material beyond small misfit (`allowance`), and hold in nearly every flight:
   the flight is the unit of evidence.
3. A further effect is added as long as it earns its place in the same way.
4. Candidates that the flights cannot tell from the leader are named with it; a leader that leaves
   much of the gap unexplained is no answer.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from narxcal.effects.base import Effect
from narxcal.effects.library import candidates
from narxcal.effects.running import Flights
from narxcal.support.arrays import FloatArray
from training.gap.allowance import Allowance
from training.gap.finding import Finding
from training.gap.fitting import Fit, Problem, fit, in_nearly_all
from training.gap.foils import foil
from training.gap.offsets import (
    Offset,
    beyond_scatter,
    day_fit,
    offset_fits,
    unexplained,
    whole_gap,
)
from training.gap.quadratic import Misfit, misfit
from training.gap.rerun_fit import told_anew
from training.gap.together import added, in_order, taken
from training.gap.unlogged import priced
from training.gap.verdict import bearable, finding
from training.gap.work import Options, Simulators, Watch, Work

OFFSETS = ("deterioration", "sensor_bias", "throttle_bias", "temperature_effect")
_OFFSET = 0.25  # least share of the whole gap of an offset
_OF_WHOLE, _IF_TELLING = 0.015, 0.005  # that of anything, and of what explains all that it touches
_SECOND = 0.25  # of what one effect leaves: less is no reason to name another
_THIRD = 0.2  # of the gap: an effect beside another and an offset
_HALF = 0.5  # of it, where that is less than a further effect's share of the whole
_BESIDE = 0.15  # of what one effect and small misfit leave
_CLOSER, _LEAST = 0.03, 0.01  # or so much more explained where both act, and of the gap
_LIKELY = 10  # pairs that are asked what they take beyond small misfit
_LEADING = 0.7  # of the first one's rank: as likely, if the first holds in too few flights
_ENOUGH = 0.03  # share of the gap that nobody asks about
_OFFERED = 3  # offsets that are told of where nothing is claimed


def diagnose(
    flights: Flights,
    measured: tuple[FloatArray, FloatArray],
    simulators: Simulators,
    options: Options | None = None,
    watch: Watch | None = None,
) -> Finding:
    """Say which effects make the recorded outputs depart from the simulated ones.

    `measured` are the recorded outputs (flights, time, outputs), NaN where unknown, and the
    standard deviation of their noise (outputs,) on the raster. `simulators` say what an effect on
    inputs or rates does. `watch` is told the model at work, its number and how many there are.
    """
    chosen = options or Options()
    real, noise = measured
    problem = Problem(flights, simulators.emulator, misfit(flights, real, noise))
    tight = whole_gap(flights, measured)
    before = problem.misfit.size(problem.misfit.gap)
    work = Work(problem, chosen, before, noise, tight, itself=simulators.itself)
    moving = [c for c in candidates(flights.signals) if c.id not in OFFSETS]
    still = [c for c in candidates(flights.signals) if c.id in OFFSETS]
    claimed = _first(work, moving, watch)
    offset = _offset(work, still, claimed)
    while claimed is not None and (more := _further(work, claimed, offset, watch)) is not None:
        claimed, offset = more, _offset(work, still, more)
    if claimed is not None and not bearable(work, claimed):
        # An offset that needs no help from an effect that explains little is the answer by itself.
        alone = _offset(work, still, None)
        claimed, offset = (claimed, offset) if alone is None else (None, alone)
    claimed, offset = told_anew(work, claimed, offset, watch)
    return finding(work, claimed, offset, noise)


def _first(work: Work, moving: Sequence[Effect], watch: Watch | None) -> Fit | None:
    """The best effect if it earns a claim, or None."""
    work.fits = [_tried(work, [effect], (k, len(moving), watch)) for k, effect in enumerate(moving)]
    work.allowance = Allowance(work.fits, work.problem)
    work.fits.sort(key=work.rank, reverse=True)
    heard = work.audible > work.options.audible * float(work.problem.misfit.floor.sum())
    leading = [one for one in work.fits if work.rank(one) >= _LEADING * work.rank(work.fits[0])]
    earned = (one for one in leading if _earned(work, one, None, work.options.material))
    return next(earned, None) if heard else None


def _further(work: Work, best: Fit, offset: Offset | None, watch: Watch | None) -> Fit | None:
    """A model of one effect more that earns its place.

    Beside an offset it would be a third: then it has to take more than that, or a clear part of
    the gap that moves, in which offsets are nuisances already.
    """
    if len(best.effects) >= work.options.most or work.left(best) <= _ENOUGH:
        return None
    pairs = _pairs(work, watch)
    more = next((p for p in pairs if _earned(work, p, best, _least(work, p, best))), None)
    if more is None:
        return None
    gained = float((best.held_out - more.held_out).sum())
    beside = offset is not None and gained <= _gained(offset)
    return None if beside and gained < _THIRD * work.audible else more


def _least(work: Work, pair: Fit, best: Fit) -> float:
    """Share of the gap that a pair has to take of what is left beside the best, to be worth naming.

    A part of what is left is enough if it is explained where the second effect acts: a slow flow
    meter is little of a gap of all channels.
    """
    unexplained, options = work.unexplained(best), work.options
    least = max(min(options.further, _HALF * unexplained), _ENOUGH)
    rest, own = work.problem.misfit.gap - best.response, pair.response - best.response
    clear = work.explained(own, rest) >= options.aligned
    return least if clear else max(least, _SECOND * unexplained)


def _tried(work: Work, effects: Sequence[Effect], place: tuple[int, int, Watch | None]) -> Fit:
    k, count, watch = place
    if watch is not None:
        watch(" + ".join(effect.name for effect in effects), k, count)
    return priced(fit(effects, work.problem), work.problem.flights.price)


def _earned(work: Work, model: Fit, best: Fit | None, least: float) -> bool:
    """Whether `model` is better than `best`, or than none, on held-out flights, in what counts.

    At least `least`, a part of the whole gap with its offsets, and in all flights but one (all of
    them up to four); and not by small misfit alone. A load says nothing of flights without it, a
    step in mid-flight is no drift, and what no temperature shows no heat.
    """
    gained = (work.before if best is None else best.held_out) - model.held_out
    share = float(gained.sum()) / work.audible
    telling = work.tells(model) or work.stands_out(model)
    heard = float(gained.sum()) > (_IF_TELLING if telling else _OF_WHOLE) * work.whole
    worth = share > least and work.holds(gained, model, best) and heard
    if not (worth and _beyond(work, model, best)):
        return False
    return not foil(model, work.problem.misfit, work.problem.flights.signals.outputs)


def _beyond(work: Work, model: Fit, best: Fit | None) -> bool:
    """Whether small misfit, refitted with either, leaves `model` enough to be better in.

    A second effect that is there makes more of what both touch explained. One that only follows
    other misfit touches more than it explains.
    """
    taken = float(work.beyond(model).sum())
    if best is None:
        return taken >= work.options.beyond * work.audible
    more = taken - float(work.beyond(best).sum())
    closer = work.aligned(model) - work.aligned(best) >= _CLOSER
    return more >= _BESIDE * work.still(best) or (closer and more >= _LEAST * work.audible)


def _pairs(work: Work, watch: Watch | None) -> list[Fit]:
    """Pairs of a leading effect and another, best first: by linear steps, then fitted.

    What the two take together says which may be worth it, and what of that is beyond small misfit
    which of these are.
    """
    singles = [one for one in work.fits if len(one.effects) == 1]
    pairs = [(first, second) for k, first in enumerate(singles[:3]) for second in singles[k + 1 :]]
    pairs.sort(key=lambda pair: taken(work.problem.misfit, *pair), reverse=True)
    likely = [added(*in_order(*pair)) for pair in pairs[:_LIKELY]]
    likely.sort(key=work.worth, reverse=True)
    found = []
    for k, pair in enumerate(likely[:3]):
        if watch is not None:
            watch(" + ".join(effect.name for effect in pair.effects), k, 3)
        found.append(_fitted(work, pair))
    return sorted(found, key=work.worth, reverse=True)


def _fitted(work: Work, pair: Fit) -> Fit:
    """The pair fitted together: among the models of `work` already, or one of them from now on."""
    known = next((one for one in work.fits if one.effects == pair.effects), None)
    if known is None:
        known = priced(fit(pair.effects, work.problem, pair.theta), work.problem.flights.price)
        work.fits.append(known)
    return known


def _gained(offset: Offset) -> float:
    """Q that the best offset takes off held-out flights."""
    fits, before, _ = offset
    return float((before - fits[0].held_out).sum())


def _offset(work: Work, effects: Sequence[Effect], claimed: Fit | None) -> Offset | None:
    """Offsets that earn a claim beside what is, best first; None if none do.

    With Q per flight before, and all of it that is audible.
    """
    explained = np.zeros_like(work.problem.flights.y) if claimed is None else claimed.response
    left = unexplained(work.tight, explained)
    fits, before = offset_fits(work.problem, left, effects), left.size(left.gap)
    if claimed is None:
        work.offered = fits[:_OFFERED]
    by_days = day_fit(work.problem, left, effects)
    offered = [(fits, before, work.whole)] if fits and _stands(work, fits[0], left) else []
    if by_days is not None:
        others = [one for one in fits if one.effects != by_days.effects]
        offered.append(([by_days, *others], before, work.whole))
    return max(offered, key=_gained, default=None)


def _stands(work: Work, best: Fit, left: Misfit) -> bool:
    """Whether an offset is beyond build scatter, a part of the gap, and in (nearly) all flights.

    One that is as large as the library lets it be is none: the simulator is of another engine.
    """
    gained = left.size(left.gap) - best.held_out
    large = beyond_scatter(best, left, work.problem.flights) and not best.at_bound
    return in_nearly_all(gained) and large and float(gained.sum()) / work.whole > _OFFSET
