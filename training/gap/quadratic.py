r"""The measure of misfit: weighted squares of the gap with small nuisances taken out.

Under every hypothesis, and under none, each flight may have its own nuisances: an offset of each
channel, one that grows with power, and one that bends over it (trim, build scatter). They are
linear, with Gaussian priors, so they are eliminated in closed form:

    Q_f(v) = v' W v - b' S^-1 b,    b = X' W v,    S = X' W X + P^-1

`v` is what is left to explain in flight f. Q is a quadratic form, so Gauss-Newton, the jackknife
over flights and the pseudo-nulls all work with its inner products.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from narxcal.effects.running import Flights
from narxcal.support.arrays import FloatArray

TOLERANCE = 1e-3  # of a channel's range: what nobody would call a gap
_OFFSET, _SLOPE, _BEND = 0.03, 0.03, 0.06  # priors of the nuisances, as shares of a range


@dataclass(frozen=True, eq=False)
class Misfit:
    """The gap (flights, time, outputs), zero where unknown, and how it is weighted.

    `weights` has the shape of the gap, zero where nothing is known. `nuisances` (flights, k,
    time, outputs) and the inverses `solved` (flights, k, k) of S belong to it. `floor` (flights,)
    is what noise alone would leave.
    """

    gap: FloatArray
    weights: FloatArray
    nuisances: FloatArray
    solved: FloatArray
    floor: FloatArray

    def inner(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """Inner products (flights, p, q) of `a` (p, flights, time, outputs) and `b` (q, ...)."""
        weighted = b * self.weights
        plain = np.einsum("pftn,qftn->fpq", a, weighted, optimize=True)
        on_a = np.einsum("pftn,fktn->fpk", a * self.weights, self.nuisances, optimize=True)
        on_b = np.einsum("qftn,fktn->fqk", weighted, self.nuisances, optimize=True)
        return np.asarray(plain - np.einsum("fpk,fkl,fql->fpq", on_a, self.solved, on_b))

    def size(self, v: FloatArray) -> FloatArray:
        """Q of `v` (flights, time, outputs) per flight: (flights,)."""
        return np.asarray(self.inner(v[None], v[None])[:, 0, 0])

    def cleaned(self, v: FloatArray) -> FloatArray:
        """`v` less its own best nuisances."""
        on = np.einsum("ftn,fktn->fk", v * self.weights, self.nuisances)
        best = np.einsum("fkl,fl->fk", self.solved, on)
        return np.asarray(v - np.einsum("fk,fktn->ftn", best, self.nuisances))


def misfit(flights: Flights, real: FloatArray, noise: FloatArray, loose: float = 1.0) -> Misfit:
    """Set the measure up for recorded outputs `real`, NaN where unknown.

    `noise` (outputs,) is the standard deviation on the raster; `loose` scales the priors of
    offsets and slopes.
    """
    signals = flights.signals
    known = np.isfinite(real)
    steps = np.arange(real.shape[1])
    known &= (steps < flights.lengths[:, None])[..., None]
    gap = np.where(known, real - flights.y, 0.0)
    span = np.maximum(signals.high - signals.low, 1e-9)
    variance = noise**2 + (TOLERANCE * span) ** 2
    weights = known / variance
    nuisances, priors = _nuisances(flights, span, loose)
    gram = np.einsum("fktn,ftn,fltn->fkl", nuisances, weights, nuisances, optimize=True)
    solved = np.linalg.inv(gram + np.diag(1.0 / priors**2))
    floor = (weights * noise**2).sum(axis=(1, 2))
    return Misfit(gap, weights, nuisances, solved, floor)


def _nuisances(flights: Flights, span: FloatArray, loose: float) -> tuple[FloatArray, FloatArray]:
    """Shapes (flights, k, time, outputs) and the standard deviations of their priors (k,)."""
    y, outputs = flights.y, flights.y.shape[2]
    power = flights.signals.power(y)
    shapes, priors = [], []
    for c in range(outputs):
        one = np.zeros_like(y)
        one[..., c] = 1.0
        sloped = np.zeros_like(y)
        sloped[..., c] = power - 0.5
        bent = np.zeros_like(y)
        bent[..., c] = (power - 0.5) ** 2 - 1.0 / 12.0
        shapes += [one, sloped, bent]
        priors += [loose * share * span[c] for share in (_OFFSET, _SLOPE, _BEND)]
    return np.stack(shapes, axis=1), np.array(priors)
