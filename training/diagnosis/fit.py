r"""Hypotheses as quadratic problems: what columns leave of the gap, from inner products alone.

For a hypothesis with response r and slopes S, and nuisances N in units of their priors' standard
deviations, the fit minimises over x in its box and nu

    |d - r - S x - N nu|^2 / tau + |nu|^2,    tau = max((rss - floor) / n_eff, 1).

One unknown level of misfit, tau, tempers the whole fit: a simulator's own errors are slow, and
n_eff effective samples, not all of them, are evidence. A `Frame` fits single effects to a gap.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numba import njit
from scipy.linalg import lapack

from narxcal.support.arrays import FloatArray
from training.diagnosis.dictionary import Dictionary, Node
from training.diagnosis.metric import Metric, Record
from training.diagnosis.nuisances import OFFSET, START, Nuisances

_ROUNDS: Final = 3
_SWEEPS: Final = 60
_RIDGE: Final = 1e-9
_FINE: Final = 1e-5
_AT_ONCE: Final = 12  # rows that are compared with the nuisances in one pass


@dataclass(frozen=True, eq=False)
class Grams:
    """Inner products per unit: `nn` (units, k, k), `nd` (units, k), `dd` (units,), all nuisances.

    `floor` (units,) is what noise leaves, `limit` (k,) the bounds of nuisances.
    """

    nn: FloatArray
    nd: FloatArray
    dd: FloatArray
    floor: FloatArray
    limit: FloatArray
    independent: float


@dataclass(frozen=True, eq=False)
class Columns:
    """A hypothesis: inner products of the rows [r, s_1 .. s_p] per unit, and the box of x.

    `rr` (units, 1 + p, 1 + p) among themselves, `rn` (units, 1 + p, k) with nuisances, `rd`
    (units, 1 + p) with the gap; `box` (p, 2). `absent` (k,) marks nuisances that are the effect
    itself.
    """

    rr: FloatArray
    rn: FloatArray
    rd: FloatArray
    box: FloatArray
    absent: FloatArray


@dataclass(frozen=True, eq=False)
class Solved:
    """`x` (p,), `nu` (k,), the residual `rss` (units,), the temper `tau`, and `cost` in all.

    `cost` is the residual with tau times the nuisances' price; `covariance` (p, p) of x.
    """

    x: FloatArray
    nu: FloatArray
    rss: FloatArray
    tau: float
    cost: float
    covariance: FloatArray


def no_columns(grams: Grams) -> Columns:
    """The hypothesis that nothing acts."""
    units, k = grams.nd.shape
    return Columns(
        np.zeros((units, 1, 1)),
        np.zeros((units, 1, k)),
        np.zeros((units, 1)),
        np.zeros((0, 2)),
        np.zeros(k, dtype=bool),
    )


def solve(
    grams: Grams,
    columns: Columns,
    without: int | None = None,
    begin: float = 1.0,
    *,
    rounds: int = _ROUNDS,
) -> Solved:
    """Fit a hypothesis to all units, or to all `without` one; rss is that of every unit.

    The temper begins with `begin`, which one round alone fits with.
    """
    h, g, c = _assembled(grams, columns)
    kept = np.ones(len(c), dtype=bool)
    if without is not None:
        kept[without] = False
    whole_h, whole_g = h[kept].sum(axis=0), g[kept].sum(axis=0)
    floor = float(grams.floor[kept].sum())
    independent = grams.independent * kept.mean()
    k = grams.nn.shape[1]
    p = len(whole_g) - k
    low = np.concatenate([-grams.limit, columns.box[:, 0]])
    high = np.concatenate([grams.limit, columns.box[:, 1]])
    low[:k][columns.absent] = high[:k][columns.absent] = 0.0
    prior = np.concatenate([np.ones(k), np.zeros(p)])
    tau = begin
    for _ in range(rounds):
        a = whole_h + np.diag(tau * prior)
        theta = least(a, whole_g, low, high)
        rss = c - 2.0 * g @ theta + np.einsum("uij,i,j->u", h, theta, theta)
        tau = max((float(rss[kept].sum()) - floor) / independent, 1.0)
    inverse = np.linalg.pinv(whole_h + np.diag(tau * prior + _RIDGE * np.diag(whole_h)))
    nu, x = theta[:k], theta[k:]
    cost = float(rss[kept].sum()) + tau * float(nu @ nu)
    return Solved(x, nu, np.maximum(rss, 0.0), tau, cost, tau * inverse[k:, k:])


def _assembled(grams: Grams, one: Columns) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Hessian (units, n, n), gradient (units, n) and constant (units,) of nuisances and x."""
    units, k = grams.nd.shape
    p = one.rr.shape[1] - 1
    h = np.zeros((units, k + p, k + p))
    h[:, :k, :k] = grams.nn
    h[:, k:, :k] = one.rn[:, 1:]
    h[:, :k, k:] = np.swapaxes(one.rn[:, 1:], 1, 2)
    h[:, k:, k:] = one.rr[:, 1:, 1:]
    g = np.zeros((units, k + p))
    g[:, :k] = grams.nd - one.rn[:, 0]
    g[:, k:] = one.rd[:, 1:] - one.rr[:, 0, 1:]
    c = grams.dd - 2.0 * one.rd[:, 0] + one.rr[:, 0, 0]
    return h, g, c


def least(a: FloatArray, g: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Least of `x' A x - 2 x' g` within bounds: by Cholesky, and by coordinates at the bounds."""
    n = len(g)
    diagonal = np.maximum(np.diag(a), 1e-12)
    scale = 1.0 / np.sqrt(diagonal)
    scaled = a * scale[:, None] * scale[None, :] + _RIDGE * np.eye(n)
    free = high > low
    x = np.zeros(n)
    places = np.flatnonzero(free)
    if not len(places):
        return np.clip(x, low, high)
    _, found, info = lapack.dposv(scaled[np.ix_(places, places)], (g * scale)[places])
    x[places] = found * scale[places] if info == 0 else 0.0
    if bool((x >= low - 1e-12).all() and (x <= high + 1e-12).all()):
        return x
    x = np.clip(x, low, high)
    return np.asarray(_descend(a + np.diag(_RIDGE * diagonal), g, low, high, x))


@njit(cache=True)
def _descend(
    a: FloatArray, g: FloatArray, low: FloatArray, high: FloatArray, x: FloatArray
) -> FloatArray:
    """Coordinate descent from `x`, within bounds."""
    n = len(g)
    slope = a @ x - g
    for _ in range(_SWEEPS):
        most = 0.0
        for i in range(n):
            if a[i, i] <= 0.0 or high[i] <= low[i]:
                continue
            to = min(max(x[i] - slope[i] / a[i, i], low[i]), high[i])
            step = to - x[i]
            if step != 0.0:
                x[i] = to
                for j in range(n):
                    slope[j] += a[j, i] * step
                most = max(most, step * step * a[i, i])
        if most < _FINE * _FINE:
            break
    return x


_FAINT: Final = 0.02  # of the peak of a response: where it counts half
_LEAST: Final = (0.002, 10.0)  # of the noise's energy, and in all: less is no energy to compare


@dataclass(frozen=True, eq=False)
class Single:
    """The best node of one effect, and the fit there."""

    node: Node
    columns: Columns
    solved: Solved

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.node.name

    @property
    def theta(self) -> FloatArray:
        """Its parameters."""
        return self.node.at(self.solved.x)

    @property
    def response(self) -> FloatArray:
        """What it changes, (flights, time, outputs)."""
        return self.node.response(self.solved.x)


class Frame:
    """One metric and one gap: fits effects there, with the nuisances."""

    def __init__(
        self,
        record: Record,
        metric: Metric,
        gap: FloatArray,
        noise: Nuisances,
        *,
        assumed: bool = True,
    ) -> None:
        self.record, self.nuisances, self.gap = record, noise, gap
        self._metric = metric
        self._n = metric.whiten(noise.columns)
        self._d = metric.whiten(gap[None])
        level = np.broadcast_to(record.noise, gap.shape)[None]
        # What was learned is the floor itself.
        floor = float(assumed) * metric.gram(metric.whiten(level), metric.whiten(level))[:, 0, 0]
        self.grams = Grams(
            metric.gram(self._n, self._n),
            metric.gram(self._n, self._d)[..., 0],
            metric.gram(self._d, self._d)[:, 0, 0],
            floor,
            noise.limit,
            record.independent,
        )
        self.none = solve(self.grams, no_columns(self.grams))

    @property
    def floor(self) -> float:
        """Energy of the noise."""
        return float(self.grams.floor.sum())

    @property
    def whole(self) -> float:
        """Energy of the gap beyond noise."""
        return max(float(self.grams.dd.sum()) - self.floor, _LEAST[1])

    def energy(self, found: Solved) -> float:
        """Energy beyond noise, with the price of the nuisances."""
        share, least = _LEAST
        return max(found.cost - self.floor, 0.0) + share * self.floor + least

    def _columns(self, nodes: Sequence[Node], gap: FloatArray | None = None) -> Iterator[Columns]:
        """Inner products of nodes, of several in one pass through the nuisances.

        Those with the gap are with a whitened one instead where it is given.
        """
        some = max(1, _AT_ONCE // len(nodes[0].rows)) if nodes else 1
        for k in range(0, len(nodes), some):
            part = nodes[k : k + some]
            rows = np.concatenate([node.rows for node in part], dtype=np.float64)
            rr, rn, rd = self.inner(rows, gap)
            ends = np.cumsum([len(node.rows) for node in part])
            for node, stop in zip(part, ends.tolist(), strict=True):
                own = slice(stop - len(node.rows), stop)
                absent = np.array([name == node.name for name in self.nuisances.effect])
                yield Columns(rr[:, own, own], rn[:, own], rd[:, own], node.box, absent)

    def inner(
        self, rows: FloatArray, gap: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Inner products of rows among themselves, with the nuisances, and with the gap."""
        found, gram = self._metric.whiten(rows), self._metric.gram
        toward = gram(found, self._d if gap is None else gap)[..., 0]
        return gram(found, found), gram(found, self._n), toward

    def fits(self, nodes: Sequence[Node]) -> list[Single]:
        """Each node by itself."""
        return [
            Single(node, columns, solve(self.grams, columns, begin=self.none.tau))
            for node, columns in zip(nodes, self._columns(nodes), strict=True)
        ]

    def fit(self, nodes: Sequence[Node]) -> Single:
        """The best of the nodes of one effect by Schwarz's criterion: some have fewer slopes."""
        samples = self.record.independent

        def criterion(one: Single) -> float:
            return float(
                samples * np.log(self.energy(one.solved)) + one.node.size * np.log(samples)
            )

        return min(self.fits(nodes), key=criterion)

    def refined(self, one: Single, dictionary: Dictionary, rounds: int = 2) -> Single:
        """The same effect with nodes where its steps end."""
        for _ in range(rounds):
            if all(one.node.parameters[j].linear for j in one.node.free):
                return one
            node = dictionary.add(one.node, one.theta)
            if node is None:
                return one
            there = self.fit([node])
            if there.solved.cost >= one.solved.cost:
                return one if there.solved.cost > 1.02 * one.solved.cost else there
            one = there
        return one

    def apart(self, one: Single, nodes: Sequence[Node]) -> float:
        """Distance of what an effect predicts from the nearest prediction of another one's nodes.

        In standard deviations of what is left without it, differences of build free: the likelier
        of two at a distance d is the right one with probability Phi(d / 2) (Anderson, *An
        Introduction to Multivariate Statistical Analysis*, section 6.4).
        """
        d, tau = self._metric.whiten(one.response[None]), one.solved.tau
        toward, whole = (self._metric.gram(rows, d)[..., 0] for rows in (self._n, d))
        grams = replace(self.grams, nd=toward, dd=whole[:, 0])
        fits = [solve(grams, each, begin=tau, rounds=1) for each in self._columns(nodes, d)]
        return float(min(fit.rss.sum() / tau + fit.nu @ fit.nu for fit in fits) ** 0.5)

    def bare(self) -> Frame:
        """The same without differences of builds: offsets and starts alone are nuisances."""
        other = copy(self)
        keep = np.array([kind in (OFFSET, START) for kind in self.nuisances.kind])
        other.grams = replace(self.grams, limit=np.where(keep, self.grams.limit, 0.0))
        other.none = solve(other.grams, no_columns(other.grams))
        return other

    def within_build(self, one: Single) -> bool:
        """Whether an effect does no more than the most that builds differ by in the same way."""
        noise = self.nuisances
        own = np.array([name == one.name for name in noise.effect])
        if not noise.limit[own].any():
            return False
        weight = self.record.known / self.record.variance
        most = noise.limit[own] ** 2 @ np.einsum("ftc,kftc->k", weight, noise.columns[own] ** 2)
        return bool(np.sum(weight * one.response**2) <= most)

    def cleaned(self, one: Solved) -> FloatArray:
        """The gap less the nuisances of a fit."""
        return np.asarray(self.gap - np.tensordot(one.nu, self.nuisances.columns, axes=1))

    def explained(self, one: Single) -> float:
        """Share of the cleaned gap that an effect explains where it acts: 0 to 1.

        Every sample counts by the energy of the response there, up to a fiftieth of its peak.
        """
        record = self.record
        weight = record.known / record.variance
        gap, response = self.cleaned(one.solved), one.response
        energy = weight * response**2
        peak = float(energy.max())
        if peak <= 0.0:
            return 0.0
        acts = weight * energy / (energy + _FAINT * peak)
        before = float((acts * (gap**2 - record.noise**2)).sum())
        after = float((acts * ((gap - response) ** 2 - record.noise**2)).sum())
        return 0.0 if before <= 0.0 else float(np.clip(1.0 - after / before, 0.0, 1.0))
