r"""Where a simulator settles, fitted to its own logs: piecewise lines over the lever.

    s(u) = sum_j hat_j(lever) phi(conditions)' c_j  +  sum_i switch_i hat(lever)' e_i

with phi the constant, linear and quadratic terms of altitude, Mach and temperature. Hats follow the
corners of a control (idle stops, ratings, the floor of approach idle), which no smooth curve does.
Every sample counts by how little moves there; bends are penalised (Eilers & Marx, *Statistical
Science* 11, 1996), so that where nothing was flown the neighbours are followed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.signal import lfilter

from narxcal.channels import SPOOLS
from narxcal.effects.base import Signals
from narxcal.effects.running import Flights
from narxcal.support.arrays import FloatArray

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
        return found

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
    rows, targets = blank.features(u), flights.y
    root = np.sqrt(_stillness(flights))[..., None]
    a = (rows * root).reshape(-1, rows.shape[-1])
    b = (targets * root).reshape(-1, targets.shape[-1])
    penalty = float((root**2).sum()) * _penalty(rows.shape[-1], len(conditions))
    weights = np.asarray(np.linalg.solve(a.T @ a + penalty, a.T @ b), dtype=np.float64)
    return SettledModel(signals, conditions, switches, low, high, weights)


def corrected(model: SettledModel, flights: Flights, missed: FloatArray) -> SettledModel:
    """Settled values that also give what a run over `model` missed where little moves.

    An engine that creeps up to where it settles is not there yet, and holds of a few seconds are
    all that some flights have. What a run with its lags and resets still misses of the logs,
    `missed` (flights, time, outputs), is no dynamics, seen a second late.
    """
    kept = np.exp(-flights.signals.dt_s / _FOLLOWS_S)
    shown = model.features(flights.u)
    rows, _ = lfilter([1.0 - kept], [1.0, -kept], shown, axis=1, zi=kept * shown[:, :1])
    root = np.sqrt(_stillness(flights))[..., None]
    a = (rows * root).reshape(-1, rows.shape[-1])
    b = (missed * root).reshape(-1, missed.shape[-1])
    penalty = float((root**2).sum()) * _penalty(rows.shape[-1], len(model.conditions))
    more = np.linalg.solve(a.T @ a + penalty, a.T @ b - penalty @ model.weights)
    return replace(model, weights=model.weights + np.asarray(more))


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
