"""Particle swarm optimisation over a box, vectorised over particles and seeded (eq. 17).

    V+ = w V + b_1 P_l (X_l - X) + b_2 P_g (X_g - X),   X+ = X + V+

| symbol | meaning |
|---|---|
| X, V | position and velocity of a particle |
| X_l, X_g | best position of its ring neighbours, of the whole swarm |
| w, P_l, P_g | inertia, influence of both |
| b_1, b_2 | random: 0 or 1 (the paper), or uniform on 0 .. 1 per dimension (the standard) |

Constants of the standard: constriction chi = 2/|2 - f - sqrt(f^2 - 4 f)| with f = 4.1, so
w = 0.7298, P_l = P_g = 2.05 chi = 1.4962 (Clerc and Kennedy, IEEE Trans. Evol. Comput. 6(1), 2002).
The second moment of X stays bounded if P < 12 (1 - w^2)/(7 - 5 w) = 1.67 for uniform draws (Poli
2009) and P < 4 (1 - w^2)/(3 - w) = 0.82 for draws of 0 or 1: with these the usual constants
diverge, so `PAPER` has P = 0.75.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError

Cost = Callable[[FloatArray], FloatArray]
_F = 4.1
CHI = 2.0 / abs(2.0 - _F - math.sqrt(_F * _F - 4.0 * _F))


@dataclass(frozen=True, kw_only=True)
class SwarmSettings:
    """Constants of the swarm; `ring` is the number of neighbours, itself included.

    Without `confine` neither velocities are clipped to half the box nor positions reflected at it.
    """

    inertia: float = CHI
    local: float = 2.05 * CHI
    leader: float = 2.05 * CHI
    draws: Literal["uniform", "binary"] = "uniform"
    particles: int = 40
    steps: int = 300
    ring: int = 3
    confine: bool = True

    def __post_init__(self) -> None:
        if self.particles < self.ring or self.ring < 1 or self.steps < 1:
            raise ConfigError(
                f"swarm: expected particles >= ring >= 1 and steps >= 1, found {self.particles} "
                f"particles, a ring of {self.ring} and {self.steps} steps"
            )

    @property
    def stable(self) -> bool:
        """Whether the second moment of the positions stays bounded (equal influences)."""
        w, P = self.inertia, max(self.local, self.leader)
        if self.draws == "uniform":
            return 12.0 * (1.0 - w * w) / (7.0 - 5.0 * w) > P
        return 4.0 * (1.0 - w * w) / (3.0 - w) > P


STANDARD = SwarmSettings()
PAPER = SwarmSettings(draws="binary", local=0.75, leader=0.75)


@dataclass(frozen=True, eq=False)
class SwarmResult:
    """Best position (P,), its cost, and per step the best cost and the spread of the swarm.

    `spread` is the root mean square distance from the swarm's mean in units of the box.
    """

    best: FloatArray
    cost: float
    costs: FloatArray
    spread: FloatArray
    status: str

    @property
    def converged(self) -> bool:
        """Whether the swarm has contracted."""
        return self.status == "converged"


def swarm(
    cost: Cost, low: FloatArray, high: FloatArray, seed: int, settings: SwarmSettings = STANDARD
) -> SwarmResult:
    """Minimise `cost` (particles, P) -> (particles,) over the box `low` .. `high` (P,).

    The same seed gives the same result. A cost that is not finite counts as infinite.
    """
    random, width = np.random.default_rng(seed), high - low
    X = low + width * random.random((settings.particles, len(low)))
    V = width * (random.random(X.shape) - 0.5)
    own, own_cost = X.copy(), _finite(cost(X))
    costs, spread = np.empty(settings.steps), np.empty(settings.steps)
    for step in range(settings.steps):
        leader = own[np.argmin(own_cost)]
        pull = (
            _draw(random, X.shape, settings) * settings.local * (_ring(own, own_cost, settings) - X)
        )
        pull += _draw(random, X.shape, settings) * settings.leader * (leader - X)
        V = settings.inertia * V + pull
        X = X + V
        if settings.confine:
            X, V = _confined(X, V, low, high)
        now = _finite(cost(X))
        better = now < own_cost
        own[better], own_cost[better] = X[better], now[better]
        costs[step] = own_cost.min()
        spread[step] = _spread(X, width)
        if not np.isfinite(spread[step]):
            costs, spread = costs[: step + 1], spread[: step + 1]
            break
    return SwarmResult(
        own[np.argmin(own_cost)], float(own_cost.min()), costs, spread, _status(spread)
    )


def _draw(
    random: np.random.Generator, shape: tuple[int, ...], settings: SwarmSettings
) -> FloatArray:
    """b: uniform per particle and dimension, or one 0 or 1 per particle and dimension."""
    if settings.draws == "binary":
        return random.integers(0, 2, shape).astype(np.float64)
    return random.random(shape)


def _ring(own: FloatArray, cost: FloatArray, settings: SwarmSettings) -> FloatArray:
    """Best position (particles, P) among the `ring` nearest by index."""
    half = settings.ring // 2
    shifts = np.arange(-half, settings.ring - half)
    near = (np.arange(len(own))[:, np.newaxis] + shifts) % len(own)
    return np.asarray(own[near[np.arange(len(own)), np.argmin(cost[near], axis=1)]])


def _confined(
    X: FloatArray, V: FloatArray, low: FloatArray, high: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Clip V to half the box (X moves by no more), reflect X at its faces and turn V there."""
    limit = 0.5 * (high - low)
    clipped = np.clip(V, -limit, limit)
    X = X - V + clipped
    beyond = (low > X) | (high < X)
    X = np.where(low > X, 2.0 * low - X, np.where(high < X, 2.0 * high - X, X))
    return np.clip(X, low, high), np.where(beyond, -clipped, clipped)


def _finite(cost: FloatArray) -> FloatArray:
    return np.where(np.isfinite(cost), cost, np.inf)


def _spread(X: FloatArray, width: FloatArray) -> float:
    with np.errstate(over="ignore", invalid="ignore"):
        scaled = X / width
        return float(np.sqrt(np.mean((scaled - scaled.mean(axis=0)) ** 2)))


def _status(spread: FloatArray) -> str:
    """A swarm that grows beyond ten boxes diverges; below 1 % of the box it has contracted."""
    last = spread[-1]
    if not np.isfinite(last) or last > 10.0:
        return "diverged: lower the influences (see SwarmSettings.stable) or confine the swarm"
    if last < 0.01:
        return "converged"
    return f"not converged: spread {100.0 * last:.3g} % of the box; raise `steps` or lower inertia"
