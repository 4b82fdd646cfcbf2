"""Particle swarm optimisation over a box, vectorised over particles and seeded (eq. 17).

    V+ = w V + b_1 P (X_l - X) + b_2 P (X_g - X),   X+ = X + V+

| symbol | meaning |
|---|---|
| X, V | position and velocity of a particle |
| X_l, X_g | best position of its ring neighbours, of the whole swarm |
| w, P | inertia, influence of both |
| b_1, b_2 | random: 0 or 1 (the paper), or uniform on 0 .. 1 per dimension (the standard) |

Constants of the standard: constriction chi = 2/|2 - f - sqrt(f^2 - 4 f)| with f = 4.1, so
w = 0.7298, P = 2.05 chi = 1.4962 (Clerc and Kennedy, IEEE Trans. Evol. Comput. 6(1), 2002).
The second moment of X stays bounded if P < 12 (1 - w^2)/(7 - 5 w) = 1.67 for uniform draws (Poli
2009) and P < 4 (1 - w^2)/(3 - w) = 0.82 for draws of 0 or 1: with these the usual constants
diverge, so the paper's draws have P = 0.75.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, Literal, NamedTuple

import numpy as np

from narxcal.support.arrays import FloatArray

Cost = Callable[[FloatArray], FloatArray]
Draws = Literal["uniform", "binary"]
_F: Final = 4.1
CHI: Final = 2.0 / abs(2.0 - _F - math.sqrt(_F * _F - 4.0 * _F))
INFLUENCE: Final[dict[Draws, float]] = {"uniform": 2.05 * CHI, "binary": 0.75}
_PARTICLES, _STEPS = 40, 300
_CONTRACTED: Final = 0.01  # root mean square distance from the swarm's mean, of the box


class SwarmResult(NamedTuple):
    """Best position (P,), its cost, and whether the swarm has contracted around it, in words."""

    best: FloatArray
    cost: float
    status: str


def swarm(
    cost: Cost, low: FloatArray, high: FloatArray, seed: int, draws: Draws = "uniform"
) -> SwarmResult:
    """Minimise `cost` (particles, P) -> (particles,) over the box `low` .. `high` (P,).

    The same seed gives the same result. A cost that is not finite counts as infinite.
    """
    random, width, influence = np.random.default_rng(seed), high - low, INFLUENCE[draws]
    X = low + width * random.random((_PARTICLES, len(low)))
    V = width * (random.random(X.shape) - 0.5)
    own, own_cost = X.copy(), _finite(cost(X))

    def draw() -> FloatArray:
        """b: uniform per particle and dimension, or one 0 or 1 per particle and dimension."""
        if draws == "binary":
            return random.integers(0, 2, X.shape).astype(np.float64)
        return random.random(X.shape)

    for _ in range(_STEPS):
        pull = draw() * influence * (_ring(own, own_cost) - X)
        pull += draw() * influence * (own[np.argmin(own_cost)] - X)
        V = CHI * V + pull
        X, V = _confined(X + V, V, low, high)
        now = _finite(cost(X))
        better = now < own_cost
        own[better], own_cost[better] = X[better], now[better]
    return SwarmResult(own[np.argmin(own_cost)], float(own_cost.min()), _status(X / width))


def _ring(own: FloatArray, cost: FloatArray) -> FloatArray:
    """Best position (particles, P) among each one and its two neighbours by index."""
    near = (np.arange(len(own))[:, np.newaxis] + np.array([-1, 0, 1])) % len(own)
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


def _status(scaled: FloatArray) -> str:
    spread = float(np.sqrt(np.mean((scaled - scaled.mean(axis=0)) ** 2)))
    if spread < _CONTRACTED:
        return "converged"
    return f"not converged: spread {100.0 * spread:.3g} % of the box; try another seed"
