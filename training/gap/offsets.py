"""Effects that only shift where the engine settles, judged after all that moves.

Build scatter of one or two percent shifts temperature and speed like wear or a wrong sensor
does, so an offset is claimed only where it is the same in all flights, beyond the residuals, and
larger than scatter makes it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from narxcal.effects.base import Effect, Signals
from narxcal.effects.running import Flights
from narxcal.support.arrays import FloatArray
from training.gap.at_speed import at_one_speed, burns_more
from training.gap.fitting import Fit, Problem, fit, in_nearly_all
from training.gap.quadratic import Misfit, misfit
from training.gap.scatter import build_scatter, levels

TIGHT = 1e-5  # of the priors of offsets and slopes: none, they would take the effect's place
# Shifts that build scatter may make, in % of the level: of a speed by all that an engine may have,
# of one speed alone, and of those that go with the lever or the day, which hardly any engine has.
_SCATTER_PCT = {"EGT_C": 2.4, "FF_kgph": 7.0}
_SPEED_PCT, _UNGOVERNED_PCT = 1.2, 2.0
_SHIFT_PCT = {"deterioration": _SPEED_PCT, "sensor_bias": 1.0}
_TOGETHER_PCT = 0.6
_NEARLY_ALL, _AMONG_OTHERS = 0.85, 1.5  # share of what is left; scatters asked for below it
# Where no second output is off by so much of its level, both are one build: a sensor may be off by
# less.
_ONE_BUILD, _OF_ONE_BUILD = 0.0002, 0.25
# The same of one speed or temperature that explains all but so much: share, scatters.
_LONE = {"_pct": (0.97, 0.6), "_C": (0.95, 0.65)}
# Air whose middle nine tenths differ by less says nothing about the temperature.
_MIDDLE, _ALIKE_K = (0.05, 0.95), 3.0
_DAYS, _BETWEEN_DAYS = 3, 0.4  # flights that tell days apart; how far they do, in scatters
_MOST = 0.5  # of what is left: an offset that takes less is not what is wrong
_AS_GOOD, _LEVEL = 0.75, 0.35  # of what wear takes; of the shift, its growth with power
# How far the fuel flow is up with wear at one fan speed: of how far the temperature is, and in % at
# least. That is hardly any scatter of builds.
SURELY = (0.8, 2.5)
Offset = tuple[list[Fit], FloatArray, float]  # offsets, best first; Q before; Q that is audible


def unexplained(tight: Misfit, explained: FloatArray) -> Misfit:
    """The gap that `explained` (flights, time, outputs) leaves."""
    return replace(tight, gap=np.where(tight.weights > 0.0, tight.gap - explained, 0.0))


def offset_fits(problem: Problem, left: Misfit, effects: Sequence[Effect]) -> list[Fit]:
    """Fit each offset to the gap `left`; best first."""
    own = replace(problem, misfit=left)
    fits = [fit([effect], own) for effect in effects]
    fits = [one for one in fits if not _better_than_new(one, problem.flights)]
    fits = [one for one in fits if not _of_all_days(one, own, effects)]
    fits.sort(key=lambda tried: float(tried.held_out.sum()))
    return plainest(fits, problem.flights, left)


def _of_all_days(tried: Fit, own: Problem, effects: Sequence[Effect]) -> bool:
    """Whether an error of the day's temperature is as well an offset that all days share.

    Where the days flown are alike, both say the same of every channel.
    """
    common = [one for one in effects if one.id == "sensor_bias"]
    if tried.effects[0].id != "temperature_effect" or not common:
        return False
    if _alike(own.flights):
        return True
    return float(fit(common, own).held_out.sum()) <= float(tried.held_out.sum())


def _alike(flights: Flights) -> bool:
    """Whether the air was as warm all along, so that no error can be laid to it."""
    dT_K = flights.u[..., flights.signals.u("dT_C")][_flown(flights)]
    return bool(np.ptp(np.quantile(dT_K, _MIDDLE)) < _ALIKE_K)


def _flown(flights: Flights) -> NDArray[np.bool_]:
    """Samples (flights, time) before the end of each flight."""
    return np.asarray(np.arange(flights.u.shape[1]) < flights.lengths[:, None])


def day_fit(problem: Problem, left: Misfit, effects: Sequence[Effect]) -> Fit | None:
    """Fit an error that follows the day's temperature, beside offsets that all days share.

    What is the same on all days is build scatter or another offset's; without it in the fit it
    would be taken for an effect of the days flown. What the fit takes off held-out flights is what
    it takes of what the common offsets leave. None if no temperature is logged, or if it does not
    take most of that, in (nearly) every flight, and make a difference between the days.
    """
    common = [one for one in effects if one.id == "sensor_bias"]
    days = [one for one in effects if one.id == "temperature_effect"]
    if not (days and common) or len(left.gap) < _DAYS or _alike(problem.flights):
        return None
    own = replace(problem, misfit=left)
    without, tried = fit(common, own), fit([*days, *common], own)
    gained = without.held_out - tried.held_out
    share = _share(gained, without.held_out - left.floor)
    found = _first_of(tried, np.maximum(left.size(left.gap) - gained, tried.held_out))
    middle = found.response[_flown(problem.flights)].mean(axis=0)
    spread = replace(found, response=found.response - middle)
    large = _in_scatters(spread, problem.flights).max() > _BETWEEN_DAYS
    return found if in_nearly_all(gained) and large and share > _MOST else None


def _first_of(together: Fit, held_out: FloatArray) -> Fit:
    """The first effect of a fit of several, all linear, with Q of held-out flights."""
    own = slice(together.sizes[0])
    return Fit(
        effects=together.effects[:1],
        parameters=together.parameters[own],
        theta=together.theta[own],
        left=together.left,
        held_out=held_out,
        others=together.others[:, own],
        response=np.tensordot(together.theta[own], together.slopes[own], axes=1),
        slopes=together.slopes[own],
        sizes=together.sizes[:1],
    )


def whole_gap(flights: Flights, measured: tuple[FloatArray, FloatArray]) -> Misfit:
    """The gap with its offsets: what all effects together have to explain."""
    return misfit(flights, measured[0], measured[1], TIGHT)


def beyond_scatter(tried: Fit, left: Misfit, flights: Flights) -> bool:
    """Whether an offset takes most of what is `left` beyond noise, and more than scatter shifts."""
    before = left.size(left.gap)
    share = _share(before - tried.held_out, before - left.floor)
    together = _TOGETHER_PCT if _agreed(tried, left) else _SPEED_PCT
    sizes, asked = _in_scatters(tried, flights, together), _asked(tried.effects[0], share)
    if tried.effects[0].channel is not None and build_scatter(flights, left) < _ONE_BUILD:
        asked *= _OF_ONE_BUILD
    return share > _MOST and bool(sizes.max() > asked)


def _agreed(tried: Fit, left: Misfit) -> bool:
    """Whether no output is further off with the offset than without.

    A lever that is read wrong shifts all outputs in one proportion, as hardly any build does. Where
    an output contradicts it, the others are shifted as scatter shifts them.
    """
    after = left.gap - tried.response
    gained = (left.weights * (left.gap**2 - after**2)).sum(axis=(0, 1))
    return bool((gained >= 0.0).all())


def _asked(effect: Effect, share: float) -> float:
    """Scatters that an offset has to exceed if it explains a `share` of what is left.

    Scatter leaves something on every output, so the more one offset explains, the less it has to
    be. A build that shifts a speed shifts temperature and fuel flow further, and one that shifts
    the temperature by more than a percent shifts a speed or the fuel flow with it: what is off
    while nothing else is hardly comes from there.
    """
    if share <= _NEARLY_ALL:
        return _AMONG_OTHERS
    for unit, (nearly_all, alone) in _LONE.items():
        if effect.channel is not None and effect.channel.endswith(unit) and share > nearly_all:
            return alone
    return 1.0


def _share(gained: FloatArray, whole: FloatArray) -> float:
    """What is gained in all flights, of what there is."""
    return float(gained.sum()) / max(float(whole.sum()), 1e-9)


def _in_scatters(tried: Fit, flights: Flights, together: float = _TOGETHER_PCT) -> FloatArray:
    """RMS shift of each output (outputs,) over what build scatter may make of it.

    `together` is the scatter of speeds that go with the lever or the day, in %. Both are taken over
    all that was flown: at idle a fan turns so slowly that any shift is much of its speed.
    """
    signals: Signals = flights.signals
    flown, sizes = _flown(flights), []
    response, absolute = tried.response[flown], levels(flights.y[flown], signals.outputs)
    for c, name in enumerate(signals.outputs):
        of_level = np.mean(response[:, c] ** 2) / np.mean(absolute[:, c] ** 2)
        shift = 100.0 * float(np.sqrt(of_level))
        speed = _SHIFT_PCT.get(tried.effects[0].id, together)
        if name in signals.free and c == 0:
            speed = _UNGOVERNED_PCT
        sizes.append(shift / _SCATTER_PCT.get(name, speed))
    return np.array(sizes)


def plainest(fits: list[Fit], flights: Flights, left: Misfit) -> list[Fit]:
    """The fits with a wrong sensor before wear, where wear would say no more than that.

    Wear can shift every output, so that it follows whatever one sensor does and the scatter of
    the others with it. It is no wear if one channel alone is shifted beyond scatter, no more at
    full power than at idle, and that channel's offset takes nearly as much. Where its shift falls
    with power, which wear does the other way round, all that scatter may do to the others is none.
    Where the fuel flow is up about as far as the temperature, it is wear.
    """
    if not fits or fits[0].effects[0].id != "deterioration":
        return fits
    worn, before = fits[0], float(left.size(left.gap).sum())
    sizes, outputs = _in_scatters(worn, flights), flights.signals.outputs
    most = int(np.argmax(sizes))
    alone = [one for one in fits if one.effects[0].channel == outputs[most]]
    flown = _flown(flights)
    shift, power = worn.response[flown][:, most], flights.signals.power(flights.y[flown])
    slope = float(np.cov(shift, power)[0, 1] / max(float(np.var(power)), 1e-12))
    growth = slope * float(np.sign(shift.mean()))
    level = growth < _LEVEL * abs(float(shift.mean()))
    others = float(np.delete(sizes, most).max(initial=0.0))
    silent = 1.0 if growth < 0.0 else min(1.0, 0.5 * sizes[most])
    if not (alone and level and others < silent) or burns_more(at_one_speed(flights, left), SURELY):
        return fits
    if before - float(alone[0].held_out.sum()) < _AS_GOOD * (before - float(worn.held_out.sum())):
        return fits
    return [alone[0], *(one for one in fits if one is not alone[0])]


def _better_than_new(tried: Fit, flights: Flights) -> bool:
    """Whether wear would have cooled the engine: that is build scatter, or something else."""
    signals: Signals = flights.signals
    if tried.effects[0].id != "deterioration" or "EGT_C" not in signals.outputs:
        return False
    return float(np.mean(tried.response[_flown(flights)][:, signals.y("EGT_C")])) < 0.0
