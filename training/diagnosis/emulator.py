r"""An emulator of a simulator, fitted to the simulator's own logs.

The product's networks follow logs closely, but nothing holds them to physics where no log ever was:
under heavier rotors they would relax at a rate of their own. So the emulator is a grey box, two
rotors under a control over the simulator's steady values. It gives what *changes*: the difference
between its run with an effect and its run without is added to the log.

Controls that hold another speed, the core's acceleration or fuel follow the same logs; what an
effect on how the engine moves does under them differs. The one under which such an effect explains
clearly more of the recorded gap is the engine's (`choose_control`).

Where the simulator settles (`SettledModel`) are piecewise lines over the lever,

    s(u) = sum_j hat_j(lever) phi(conditions)' c_j  +  sum_i switch_i hat(lever)' e_i

of corrected outputs (`narxcal.atmosphere.corrected_scale`), for flights hardly tell altitude from
Mach, but the similarity of engines does; phi are the constant, linear and quadratic terms of
altitude, Mach and temperature. Hats follow the corners of a control (idle stops, ratings, the floor
of approach idle), which no smooth curve does.
Every sample counts by how little moves there; bends are penalised (Eilers & Marx, *Statistical
Science* 11, 1996), so that where nothing was flown the neighbours are followed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from scipy.signal import lfilter

from narxcal.atmosphere import air_at, corrected_scale, similarity
from narxcal.channels import SPOOLS
from narxcal.effects.base import Pace, Signals, as_simulated
from narxcal.effects.library import hypotheses
from narxcal.effects.running import Flights, Shift
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import DataError
from narxcal.two_spool import HOLDS_FUEL, HOLDS_RATE, TwoSpool
from training.diagnosis.dictionary import Dictionary
from training.diagnosis.fit import Frame
from training.diagnosis.metric import Metric, Record, assumed_variance, few, stretches
from training.diagnosis.nuisances import nuisances
from training.diagnosis.two_spool_fit import GOVERNED_CORE, GOVERNED_FAN, Course, fit_two_spool

CONDITIONS: Final = ("ALT_ft", "Mach", "dT_C")
SWITCHES: Final = ("WOW", "Approach", "ECS", "NAI", "WAI")
_KNOTS: Final = np.concatenate([[0.0, 0.03, 0.06, 0.1, 0.15], np.linspace(0.22, 1.0, 9)])
_SWITCHED: Final = np.array([0.0, 0.05, 0.12, 0.25, 0.5, 1.0])
_STILL: Final = 0.003  # of a channel's range per s: what moves slower counts fully
_FOLLOWS_S: Final = 1.0  # an engine follows where it is commanded to settle within a second or so
_BEND, _SIZE = 1e-6, 1e-5  # penalties on bends over the lever, and on how conditions change them


@dataclass(frozen=True, eq=False)
class SettledModel:
    """`low` and `high` (conditions, 2 rows) are what was flown; `weights` (features, outputs)."""

    signals: Signals
    conditions: tuple[int, ...]
    switches: tuple[int, ...]
    low: FloatArray
    high: FloatArray
    weights: FloatArray

    def outputs(self, u: FloatArray) -> FloatArray:
        """Settled outputs (..., outputs) at inputs (..., inputs), held beyond what was flown."""
        x, phi = self._lever(u), self._conditions(u)
        count, terms = len(_KNOTS), phi.shape[-1]
        smooth = self.weights[: count * terms].reshape(count, terms, -1)
        # Only the two hats next to the lever are not zero: no row of features is ever built.
        lines = np.einsum("...t,ktn->...kn", phi, smooth, optimize=True)
        found = _between(x, _KNOTS, lines)
        for s, part in zip(self.switches, self._switched(), strict=True):
            found += u[..., s, None] * _between(x, _SWITCHED, part)
        scales, zeros = self.scales(u)
        return found * scales - zeros

    def scales(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What corrected outputs are multiplied by (..., outputs), and less by (outputs,)."""
        air = air_at(u, self.signals.inputs)
        pairs = [corrected_scale(name, air) for name in self.signals.outputs]
        scales = [np.broadcast_to(scale, u.shape[:-1]) for scale, _ in pairs]
        return np.stack(scales, axis=-1), np.array([zero for _, zero in pairs])

    def features(self, u: FloatArray) -> FloatArray:
        """Hats times conditions, and switches times hats: (..., features)."""
        x, phi = self._lever(u), self._conditions(u)
        smooth = _hats(x, _KNOTS)[..., :, None] * phi[..., None, :]
        parts = [smooth.reshape(*x.shape, -1)]
        parts += [u[..., s, None] * _hats(x, _SWITCHED) for s in self.switches]
        return np.concatenate(parts, axis=-1)

    def _lever(self, u: FloatArray) -> FloatArray:
        """Share of the driver's range."""
        bottom, top = self.signals.lever
        lever = u[..., self.signals.u(self.signals.driver)]
        return np.asarray(np.clip((lever - bottom) / max(top - bottom, 1e-9), 0.0, 1.0))

    def _conditions(self, u: FloatArray) -> FloatArray:
        """Terms in the conditions, each within -1 .. 1 of what was flown."""
        here = np.clip(u[..., list(self.conditions)], self.low, self.high)
        return _quadratic(2.0 * (here - self.low) / (self.high - self.low) - 1.0)

    def _switched(self) -> FloatArray:
        """Values of every switch at its knots, (switches, knots, outputs)."""
        rest = self.weights[len(self.weights) - len(_SWITCHED) * len(self.switches) :]
        return rest.reshape(len(self.switches), len(_SWITCHED), self.weights.shape[-1])


def fit_settled(flights: Flights) -> SettledModel:
    """Fit to the simulated flights, every sample by how still it is."""
    signals, u = flights.signals, flights.u
    conditions = tuple(signals.u(name) for name in CONDITIONS if name in signals.active)
    switches = tuple(signals.u(name) for name in SWITCHES if name in signals.active)
    flown = u.reshape(-1, u.shape[-1])[:, list(conditions)]
    low, high = flown.min(axis=0), flown.max(axis=0)
    blank = SettledModel(signals, conditions, switches, low, high, np.zeros((0, 0)))
    rows = blank.features(u)
    begun = replace(blank, weights=np.zeros((rows.shape[-1], flights.y.shape[-1])))
    return _added(begun, flights, rows, flights.y + blank.scales(u)[1])


def corrected(model: SettledModel, flights: Flights, missed: FloatArray) -> SettledModel:
    """Settled values that also give what a run over `model` missed where little moves.

    An engine that creeps up to where it settles is not there yet, and holds of a few seconds are
    all that some flights have. What a run with its lags and resets still misses of the logs,
    `missed` (flights, time, outputs), is no dynamics, seen a second late.
    """
    kept = np.exp(-flights.signals.dt_s / _FOLLOWS_S)
    shown = model.features(flights.u)
    rows, _ = lfilter([1.0 - kept], [1.0, -kept], shown, axis=1, zi=kept * shown[:, :1])
    return _added(model, flights, np.asarray(rows), missed)


def _added(
    model: SettledModel, flights: Flights, rows: FloatArray, missed: FloatArray
) -> SettledModel:
    """The model with weights added that give what is `missed`, by features `rows`."""
    every = max(1, round(_FOLLOWS_S / flights.signals.dt_s))  # samples nearer in time say the same
    rows, missed, still = (v[:, ::every] for v in (rows, missed, _stillness(flights)))
    scales, weights = model.scales(flights.u[:, ::every])[0], model.weights.copy()
    penalty = _penalty(rows.shape[-1], len(model.conditions))
    kinds = [similarity(name) for name in flights.signals.outputs]
    for kind in dict.fromkeys(kinds):
        some = [c for c, other in enumerate(kinds) if other == kind]
        root = np.sqrt(still)[..., None]
        b = (missed[..., some] * root).reshape(-1, len(some))
        root = root * scales[..., some[:1]]
        a = (rows * root).reshape(-1, rows.shape[-1])
        price = float((root**2).sum()) * penalty
        weights[:, some] += np.linalg.solve(a.T @ a + price, a.T @ b - price @ weights[:, some])
    return replace(model, weights=weights)


def _stillness(flights: Flights) -> FloatArray:
    """Weights (flights, time) between 1 at rest and 0, and 0 beyond a flight's end."""
    signals = flights.signals
    speeds = [j for j, name in enumerate(signals.outputs) if name in SPOOLS]
    columns = speeds or list(range(len(signals.outputs)))
    span = np.maximum(signals.high - signals.low, 1e-9)[columns]
    rate = np.gradient(flights.y[..., columns] / span, signals.dt_s, axis=1)
    fastest = np.abs(rate).max(axis=-1)
    inside = np.arange(flights.y.shape[1]) < flights.lengths[:, None]
    return np.asarray(np.where(inside, 1.0 / (1.0 + (fastest / _STILL) ** 2), 0.0))


def _between(x: FloatArray, knots: FloatArray, values: FloatArray) -> FloatArray:
    """Straight lines at `x` (...) through `values` (..., knots, n) or (knots, n): (..., n)."""
    after = np.clip(np.searchsorted(knots, x, side="right"), 1, len(knots) - 1)
    part = ((x - knots[after - 1]) / (knots[after] - knots[after - 1]))[..., None]
    if values.ndim == 2:
        low, high = values[after - 1], values[after]
    else:
        at = after[..., None, None]
        low = np.take_along_axis(values, at - 1, axis=-2)[..., 0, :]
        high = np.take_along_axis(values, at, axis=-2)[..., 0, :]
    return np.asarray(low + part * (high - low))


def _hats(x: FloatArray, knots: FloatArray) -> FloatArray:
    """Piecewise linear functions (..., knots), each one at its own knot and none at the others."""
    after = np.clip(np.searchsorted(knots, x, side="right"), 1, len(knots) - 1)
    part = (x - knots[after - 1]) / (knots[after] - knots[after - 1])
    found = np.zeros((*x.shape, len(knots)))
    np.put_along_axis(found, after[..., None] - 1, (1.0 - part)[..., None], axis=-1)
    np.put_along_axis(found, after[..., None], part[..., None], axis=-1)
    return found


def _quadratic(z: FloatArray) -> FloatArray:
    """One, each, and all products of two: (..., 1 + n + n (n + 1) / 2)."""
    count = z.shape[-1]
    products = [z[..., i] * z[..., j] for i in range(count) for j in range(i, count)]
    return np.stack([np.ones(z.shape[:-1]), *np.moveaxis(z, -1, 0), *products], axis=-1)


def _penalty(size: int, conditions: int) -> FloatArray:
    """Penalty (features, features) on bends over the lever, and on all but the mean line."""
    terms = 1 + conditions + conditions * (conditions + 1) // 2
    knots = len(_KNOTS)
    steps = np.diff(_KNOTS)
    bends = np.zeros((knots - 2, knots))
    for i in range(knots - 2):
        bends[i, i : i + 3] = (
            1.0 / steps[i],
            -1.0 / steps[i] - 1.0 / steps[i + 1],
            1.0 / steps[i + 1],
        )
    penalty = np.zeros((size, size))
    smooth = knots * terms
    penalty[:smooth, :smooth] = _BEND * np.kron(bends.T @ bends, np.eye(terms))
    free = np.full(size, _SIZE)
    free[:smooth:terms] = 1e-2 * _SIZE
    return np.asarray(penalty + np.diag(free))


FAN, CORE = "N1_pct", "N2_pct"
_CLEARLY = 0.6  # of the cost of the other kind of control: no tie
_POSSIBLE = 2.0  # times the better one's cost: the logs do not rule it out
_MORE: Final = 0.03  # of the gap
_CHOSEN: Final = 3  # stretches that the control is chosen on: those with most of the gap
_BEGUN, _FITTED = 5, 8  # stretches that rotors are fitted to, first and last: those that move most


@dataclass(frozen=True, eq=False)
class GreyBoxEmulator:
    """Settled values and the two-spool engine that moves between them."""

    settled: SettledModel
    engine: TwoSpool
    _flown: list[FloatArray] = field(default_factory=list, init=False, repr=False)

    def run(
        self,
        flights: Flights,
        given: FloatArray,
        pace: Pace | None = None,
        shift: Shift | None = None,
    ) -> FloatArray:
        """Free runs (rows, time, outputs) of an engine with inputs `given` (blocks, time, inputs).

        Row r has the inputs of block `r % blocks`, settles elsewhere and is loaded by row r of
        `shift`, and starts where flight `r % flights` does, moved by what other inputs and the
        shift change in equilibrium.
        """
        if not (self._flown and self._flown[0] is flights.u):
            self._flown[:] = [flights.u, *self._settles(flights.signals, flights.u)]
        _, flown_to, flown_air, *known = self._flown
        own = given is flights.u and shift is None and _is_simulated(pace, len(given))
        if own and known:
            return known[0]
        order, count = _order(flights.signals), len(flights.u)
        paces = np.stack(pace or as_simulated(len(given)), axis=1)
        rows, which = np.arange(len(paces)) % count, np.arange(len(paces)) % len(given)
        steady, air = flown_to, flown_air
        if given is not flights.u:
            steady, air = self._settles(flights.signals, given)
        load = np.zeros_like(air)
        if shift is not None:
            steady, air, load = steady[which] + shift.settled, air[which], shift.load
            which = np.arange(len(paces))
        start = flights.y[rows, 0] + steady[which, 0] - flown_to[rows, 0]
        into = (_picked(steady, order), air, load, _picked(start, order))
        found = self.engine.free_run(into, which, paces, order.index(flights.signals.hot))
        y = _back(found, order, len(flights.signals.outputs))
        if own:  # every effect is compared with it
            self._flown.append(y)
        return y

    def _settles(self, signals: Signals, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Settled outputs (blocks, time, outputs) and the logarithm of thin air (blocks, time)."""
        return self.settled.outputs(u), np.log(signals.thin_air(u))

    def free_run(self, flights: Flights) -> FloatArray:
        """Its own outputs (flights, time, outputs) from each flight's first sample on."""
        return self.run(flights, flights.u)

    def errors(self, flights: Flights) -> FloatArray:
        """RMSE (outputs,) of the free run over whole flights."""
        wrong = self.free_run(flights) - flights.y
        rows = [e[:n] for e, n in zip(wrong, flights.lengths.tolist(), strict=True)]
        return np.asarray(np.sqrt(np.mean(np.concatenate(rows) ** 2, axis=0)))


def _is_simulated(pace: Pace | None, rows: int) -> bool:
    return pace is None or np.array_equal(np.stack(pace), np.stack(as_simulated(rows)))


def fit_emulators(flights: Flights) -> tuple[GreyBoxEmulator, ...]:
    """Fit to the simulated flights under every kind of control; the better one first.

    A control holds the fan's speed or the core's; of these the other is left out where its cost is
    more than twice as high, or where nothing is governed. On the way it schedules fuel or the
    core's acceleration, and its reset may hold fuel: of either no log of the simulator tells
    anything, and those that do are the last.
    Raises `DataError` where no spool speed is among the outputs.
    """
    signals = flights.signals
    order = _order(signals)
    settled = fit_settled(flights)
    course = _course(_moving(flights, _BEGUN), settled)
    two = order[0] != order[1]
    kinds = (GOVERNED_FAN, GOVERNED_CORE) if signals.governed and two else (GOVERNED_CORE,)
    begun = [fit_two_spool(course, kind) for kind in kinds]
    least = min(cost for _, cost in begun)
    # Both follow the logs of a governed engine about equally well; most controls hold the fan.
    fits = [
        _finished(flights, GreyBoxEmulator(settled, engine))
        for engine, cost in begun
        if cost <= _POSSIBLE * least
    ]
    first = fits[-1] if fits[-1][1] < _CLEARLY * fits[0][1] else fits[0]
    others = [each for each in fits if each is not first and each[1] <= _POSSIBLE * first[1]]
    left = [each for each, _ in (first, *others)]
    if len(kinds) == 1:
        return tuple(left)
    return tuple(_holding(each, what) for what in (0, HOLDS_RATE, HOLDS_FUEL) for each in left)


def widened(one: GreyBoxEmulator, flights: Flights) -> GreyBoxEmulator:
    """The same under the same control, fitted anew to `flights`, which it may not have seen.

    Where a lever is dead, or a limit holds, shows in flights that were there alone.
    """
    governed = one.engine.governed
    known = replace(one.engine, governed=governed % HOLDS_RATE)
    found, _ = _finished(flights, GreyBoxEmulator(fit_settled(flights), known))
    return replace(found, engine=replace(found.engine, governed=governed))


def _holding(one: GreyBoxEmulator, what: int) -> GreyBoxEmulator:
    """The same under a control that holds something else: the simulator's own logs are the same."""
    return replace(one, engine=replace(one.engine, governed=one.engine.governed + what))


def _finished(flights: Flights, begun: GreyBoxEmulator) -> tuple[GreyBoxEmulator, float]:
    """Settled values without what the rotors say is still to come, and the rotors over these.

    With the robust cost of the speeds.
    """
    settled = corrected(begun.settled, flights, flights.y - begun.free_run(flights))
    course = _course(_moving(flights, _FITTED), settled)
    engine, cost = fit_two_spool(course, begun.engine.governed, begun.engine)
    return GreyBoxEmulator(settled, engine), cost


def _moving(flights: Flights, most: int) -> Flights:
    """Stretches as flights, those in which the core moves most."""
    core = flights.y[..., _order(flights.signals)[1]]
    return few(flights, *stretches(flights, np.gradient(core, axis=1) ** 2, most))


def _course(flights: Flights, settled: SettledModel) -> Course:
    order, signals = _order(flights.signals), flights.signals
    return Course(
        y=_picked(flights.y, order),
        steady=_picked(settled.outputs(flights.u), order),
        air=np.log(signals.thin_air(flights.u)),
        inside=(np.arange(flights.y.shape[1]) < flights.lengths[:, None]).astype(float),
        dt_s=signals.dt_s,
    )


def _order(signals: Signals) -> list[int]:
    """Columns of outputs as fan, core, and the others; one spool alone is both."""
    speeds = [signals.y(name) for name in (FAN, CORE) if name in signals.outputs]
    if not speeds:
        raise DataError(
            "no spool speed is recorded",
            hint=f"An engine is emulated by {FAN} and {CORE}, or by one of them",
        )
    rest = [j for j in range(len(signals.outputs)) if j not in speeds]
    return [speeds[0], speeds[-1], *rest]


def _picked(values: FloatArray, order: list[int]) -> FloatArray:
    return np.ascontiguousarray(values[..., order])


def _back(values: FloatArray, order: list[int], count: int) -> FloatArray:
    """Columns in the order of the signals again; of one spool the core's."""
    found = np.empty((*values.shape[:-1], count))
    for place, column in enumerate(order):
        found[..., column] = values[..., place]
    return found


def choose_control(emulators: Sequence[GreyBoxEmulator], record: Record) -> GreyBoxEmulator:
    """The emulator under whose control one effect of moves takes clearly more, or the first."""
    moving = [e for e in hypotheses(record.flights.signals) if e.on_rates]
    if len(emulators) == 1 or not moving:
        return emulators[0]
    some = record.stretches(_CHOSEN)
    left = []
    for one in emulators:
        dictionary = Dictionary(moving, some.flights, one)
        metric = Metric(some, assumed_variance(some))
        frame = Frame(some, metric, some.gap, nuisances(some))
        before = frame.energy(frame.none)
        fits = [frame.fit(nodes) for nodes in dictionary.nodes.values()]
        left.append(min(frame.energy(each.solved) for each in fits) / before)
    best = int(np.argmin(left))
    return emulators[best] if left[best] < left[0] - _MORE else emulators[0]
