"""An unlogged load as a candidate: when it was on, and what looking for it gains in mere noise.

The windows come from each flight's own gap, so they would gain something anywhere. Pseudo-nulls,
what the windows leave in pieces drawn anew, go through the same search: what they gain rarely has
to be exceeded, and what they gain on the average is the windows' price, taken off before the
effect is compared with any other (`priced`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from narxcal.effects.base import Signals
from narxcal.effects.memory import Lag
from narxcal.effects.running import Flights
from narxcal.effects.steady import FOLLOW_S, UnloggedSwitch
from narxcal.support.arrays import BoolArray, FloatArray
from training.gap.blocks import drawn_anew
from training.gap.fitting import Fit
from training.gap.known_load import search_any_size, search_known
from training.gap.levels import Found, Levels, of_paths, search_levels
from training.gap.load_checks import against, as_the_lever
from training.gap.load_windows import Searched, told
from training.gap.path_windows import Window
from training.gap.quadratic import Misfit
from training.gap.window_search import Options, rarely_reached
from training.gap.windows import find_windows

Groups = Sequence[Sequence[int]]
_BEFORE_S, _LONG_S, _AFTER_S = 4.0, 10.0, 1.0  # an engine is unsettled round a move of its driver
_MOVED, _FUEL_MOVED = 0.01, 0.04  # of the driver's range
_BLOCK_S, _KNOT_S = 1.0, 600.0
_LOGGED = ("WOW", "Approach", "ECS", "NAI", "WAI")
_DRAWS, _EDGE_DRAWS, _LEVEL, _STARTS = 12, 8, 0.01, 3
_SHORTEST_S = 12.0
_WANDER_S = 900.0  # shorter flights have hardly time to


@dataclass(frozen=True, eq=False)
class Load:
    """`on` (flights, time) is 1 where a load was found, and `windows` tells when.

    `price` (flights,) is what the windows are worth in noise, in units of the misfit Q; `reason`
    says why there are none.
    """

    on: FloatArray
    windows: tuple[Window, ...]
    price: FloatArray
    reason: str = ""


class Asked(NamedTuple):
    """What is searched: flights, the measure of their gap, and which of them share windows."""

    flights: Flights
    measure: Misfit
    groups: tuple[tuple[int, ...], ...]


def find_load(flights: Flights, measure: Misfit, groups: Groups = (), seed: int = 0) -> Load:
    """Search the gap of `measure` for windows; flights of one of the `groups` share theirs.

    By levels first, which needs the engine to be at rest for seconds only; then by edges in
    coloured noise, for long flights whose levels wander.
    """
    asked = Asked(flights, measure, _all_groups(groups, len(flights.u)))
    levels = levels_of(asked, _BEFORE_S)
    found = search_levels(levels)
    reason, price = _judged(found, levels, asked, seed)
    if reason and float(np.median(flights.lengths)) * flights.signals.dt_s > _WANDER_S:
        levels = levels_of(asked, _LONG_S)
        found = _by_edges(asked, levels, seed)
        again, price = _judged(found, levels, asked, seed)
        reason = again and reason
    if found is None or reason:
        return Load(np.zeros(flights.u.shape[:2]), (), np.zeros(len(flights.u)), reason)
    windows, on = told(found, Searched(flights, measure, levels))
    count = np.bincount([window.flight for window in windows], minlength=len(flights.u))
    return Load(on, windows, price * count / max(count.sum(), 1))


def find_known_load(
    flights: Flights, measure: Misfit, shift: FloatArray, groups: Groups = ()
) -> Load:
    """Windows of other flights, in which a load of known `shift` (outputs,) was on."""
    asked = Asked(flights, measure, _all_groups(groups, len(flights.u)))
    levels = levels_of(asked, _BEFORE_S)
    found = search_any_size(
        levels, shift, search_known(levels, shift), lambda on: _taken(on, shift, asked)
    )
    none = Load(np.zeros(flights.u.shape[:2]), (), np.zeros(len(flights.u)))
    if found is None or found.explained <= 0.0:
        return none
    windows, on = told(found, Searched(flights, measure, levels, shift))
    return replace(none, on=on, windows=windows)


def has_load(tried: Fit) -> bool:
    """Whether one of the effects is an unlogged load."""
    return any(isinstance(effect, UnloggedSwitch) for effect in tried.effects)


def priced(tried: Fit, price: FloatArray | None) -> Fit:
    """The fit with the windows' price on what it leaves of flights, if it has a load in it."""
    if price is None or not has_load(tried):
        return tried
    return replace(tried, held_out=tried.held_out + price)


def witnesses(tried: Fit, price: FloatArray | None) -> BoolArray:
    """Flights (flights,) that can tell for or against: those in which the load was on, or all."""
    if price is None or not has_load(tried):
        return np.ones(len(tried.left), dtype=np.bool_)
    return np.asarray(price > 0.0)


def settled_samples(flights: Flights, before_s: float) -> BoolArray:
    """Where (flights, time) the driver has not moved for `before_s`, nor is about to."""
    signals = flights.signals
    driver = flights.u[..., signals.u(signals.driver)]
    before, after = (round(seconds / signals.dt_s) for seconds in (before_s, _AFTER_S))
    size, origin = before + after + 1, (before - after) // 2
    reach = maximum_filter1d(driver, size, axis=1, origin=origin)
    reach -= minimum_filter1d(driver, size, axis=1, origin=origin)
    moved = (_MOVED if signals.governed else _FUEL_MOVED) * (signals.lever[1] - signals.lever[0])
    within = np.arange(driver.shape[1]) < flights.lengths[:, None]
    return np.asarray((reach < moved) & within)


def levels_of(asked: Asked, before_s: float) -> Levels:
    """The gap in blocks of a second, where the engine is at rest, with its nuisances."""
    flights, measure = asked.flights, asked.measure
    signals, size = flights.signals, _block(flights.signals)
    steady = settled_samples(flights, before_s)
    weight = (measure.weights > 0.0) & steady[..., None]
    count = _summed(weight.astype(np.float64), size)
    known: BoolArray = np.all(count >= 0.5 * size, axis=2)
    mean = _summed(measure.gap * weight, size) / np.maximum(count, 1.0)
    rising = signals.outputs.index("EGT_C") if "EGT_C" in signals.outputs else None
    residual = mean * known[..., None]
    return Levels(residual, known, _nuisances(flights, size), asked.groups, rising)


def _nuisances(flights: Flights, size: int) -> FloatArray:
    """Offset, power, altitude and slow wandering of every flight: (flights, blocks, k)."""
    signals = flights.signals
    power = _summed(signals.power(flights.y)[..., None], size)[..., 0] / size
    columns = [np.ones_like(power), power - 0.5]
    if "ALT_ft" in signals.active:
        altitude = _summed(flights.u[..., [signals.u("ALT_ft")]], size)[..., 0] / size
        columns.append(altitude / 2e4 - 0.5)
    steps = power.shape[1]
    knots = int(steps * _BLOCK_S // _KNOT_S)
    for j in range(1, knots + 1):
        hat = np.maximum(0.0, 1.0 - np.abs(np.arange(steps) / steps * (knots + 1) - j))
        columns.append(np.broadcast_to(hat, power.shape))
    return np.stack(columns, axis=2)


def _summed(values: FloatArray, size: int) -> FloatArray:
    """Sums over blocks of `size` samples of (flights, time, k); a rest is cut."""
    flights, steps, k = values.shape
    count = steps // size
    return np.asarray(values[:, : count * size].reshape(flights, count, size, k).sum(axis=2))


def _block(signals: Signals) -> int:
    return max(1, round(_BLOCK_S / signals.dt_s))


def _all_groups(groups: Groups, flights: int) -> tuple[tuple[int, ...], ...]:
    taken = [f for group in groups for f in group]
    alone = [(f,) for f in range(flights) if f not in taken]
    return (*(tuple(group) for group in groups), *alone)


def _by_edges(asked: Asked, levels: Levels, seed: int) -> Found | None:
    """Windows found by their edges, as levels."""
    flights, measure = asked.flights, asked.measure
    signals = flights.signals
    options = Options(
        asked.groups,
        levels.rising,
        at_rest=False,
        shortest_s=_SHORTEST_S,
        draws=_EDGE_DRAWS,
        seed=seed,
    )
    steady = settled_samples(flights, _LONG_S)
    windows = find_windows(measure.gap, measure.weights, signals.dt_s, options, steady)
    if not windows.found:
        return None
    size = _block(signals)
    return of_paths(_summed(windows.on[..., None], size)[..., 0] > 0.5 * size, levels)


def _judged(found: Found | None, levels: Levels, asked: Asked, seed: int) -> tuple[str, float]:
    """Why this is no unlogged load, empty if it is one, and the price of its windows."""
    if found is None:
        return "no windows stand out of the gap", 0.0
    reason = against(found, levels, _switched(asked.flights))
    if not reason and as_the_lever(found.shift, asked.flights):
        reason = "all outputs are shifted as by a move of the driver: it arrives elsewhere, no load"
    if reason:
        return reason, 0.0
    price, rarely = _price(found, levels, asked, seed)
    if _gain(found.on, asked.measure.gap, asked, 1.0) <= rarely:
        reason = "the windows gain no more than such a search finds in noise"
    return reason, price


def _switched(flights: Flights) -> list[FloatArray]:
    """Blocks of each flight at which a logged switch changes.

    On a raster it may be half on for a sample, between two steps of a half each.
    """
    signals, size = flights.signals, _block(flights.signals)
    columns = [signals.u(name) for name in _LOGGED if name in signals.active]
    moved: BoolArray = np.any(np.diff(flights.u[..., columns] > 0.5, axis=1), axis=2)
    return [np.flatnonzero(row) / size for row in moved]


def _price(found: Found, levels: Levels, asked: Asked, seed: int) -> tuple[float, float]:
    """What windows gain in Q where there are none: on the average, and rarely."""
    random = np.random.default_rng(seed)
    share = np.repeat(levels.known[..., None], found.left.shape[2], axis=2).astype(np.float64)
    size, steps = _block(asked.flights.signals), asked.flights.u.shape[1]
    rows = np.minimum(np.arange(steps) // size, levels.known.shape[1] - 1)
    part = float(levels.known.mean())
    gains = []
    for _ in range(_DRAWS):
        noise = drawn_anew(found.left, share, random) * share
        again = search_levels(replace(levels, residual=noise), starts=_STARTS)
        known = levels.known[:, rows, None]
        values = noise[:, rows] * known
        gains.append(0.0 if again is None else _gain(again.on, values, asked, part))
    return max(float(np.mean(gains)), 1e-9), max(rarely_reached(gains, _LEVEL), 0.0)


def _gain(on: BoolArray, gap: FloatArray, asked: Asked, part: float) -> float:
    """Q that windows (flights, blocks) take off a gap, each flight's shift from the others.

    `part` is the share of the gap that is known; what it gains is scaled up to the whole.
    """
    measure, channels = asked.measure, gap.shape[2]
    slopes = _followed(on, asked.flights)[None, ..., None] * np.eye(channels)[:, None, None]
    hessian = measure.inner(slopes, slopes)
    toward = measure.inner(slopes, gap[None])[..., 0]
    ridge = 1e-9 * (1.0 + np.trace(hessian.sum(axis=0))) * np.eye(channels)
    gain = 0.0
    for f in np.flatnonzero(on.any(axis=1)):
        others = hessian.sum(axis=0) - hessian[f] + ridge
        step = np.linalg.solve(others, toward.sum(axis=0) - toward[f])
        gain += 2.0 * float(step @ toward[f]) - float(step @ hessian[f] @ step)
    return gain / max(part, 1e-9)


def _taken(on: BoolArray, shift: FloatArray, asked: Asked) -> FloatArray:
    """Share (flights,) of Q that a shift (channels,) in windows (flights, blocks) takes off."""
    measure = asked.measure
    left = measure.size(measure.gap - _followed(on, asked.flights)[..., None] * shift)
    before = measure.size(measure.gap)
    return np.asarray(1.0 - left / np.maximum(before, measure.floor))


def _followed(on: BoolArray, flights: Flights) -> FloatArray:
    """Windows (flights, blocks) as the engine follows them, (flights, time)."""
    rows = np.minimum(np.arange(flights.u.shape[1]) // _block(flights.signals), on.shape[1] - 1)
    lag = Lag(np.full(len(on), FOLLOW_S), flights.signals.dt_s)
    return np.asarray(lag(on[:, rows].astype(np.float64)))
