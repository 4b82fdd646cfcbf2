"""Fits single effects to what others leave of the gap, in one metric, by inner products."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from narxcal.support.arrays import FloatArray
from training.budget.dictionary import Dictionary, Node
from training.budget.metric import Metric, Record
from training.budget.nuisances import OFFSET, START, Nuisances
from training.budget.quadratic import Columns, Grams, Solved, no_columns, solve

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

    def energy(self, found: Solved) -> float:
        """Energy beyond noise, with the price of the nuisances."""
        share, least = _LEAST
        return max(found.cost - self.floor, 0.0) + share * self.floor + least

    def columns(self, node: Node) -> Columns:
        """Inner products of a node."""
        absent = np.array([name == node.name for name in self.nuisances.effect])
        return Columns(*self.inner(node.rows.astype(np.float64)), node.box, absent)

    def inner(self, rows: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Inner products of rows among themselves, with the nuisances, and with the gap."""
        found, gram = self._metric.whiten(rows), self._metric.gram
        return gram(found, found), gram(found, self._n), gram(found, self._d)[..., 0]

    def fit(self, nodes: list[Node]) -> Single:
        """The best of the nodes of one effect."""
        fits = []
        for node in nodes:
            columns = self.columns(node)
            fits.append(Single(node, columns, solve(self.grams, columns, begin=self.none.tau)))
        return min(fits, key=lambda one: one.solved.cost)

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

    def bare(self) -> Frame:
        """The same without differences of builds: offsets and starts alone are nuisances."""
        other = object.__new__(Frame)
        other.__dict__.update(self.__dict__)
        keep = np.array([kind in (OFFSET, START) for kind in self.nuisances.kind])
        limit = np.where(keep, self.grams.limit, 0.0)
        grams = self.grams
        other.grams = Grams(grams.nn, grams.nd, grams.dd, grams.floor, limit, grams.independent)
        other.none = solve(other.grams, no_columns(other.grams))
        return other

    def cleaned(self, one: Solved) -> FloatArray:
        """The gap less the nuisances of a fit."""
        return np.asarray(self.gap - np.tensordot(one.nu, self.nuisances.columns, axes=1))

    def explained(self, one: Single) -> float:
        """Share of the cleaned gap that an effect explains where it acts: 0 to 1.

        Every sample counts by the energy of the response there, up to a fiftieth of its peak.
        """
        record = self.record
        weight = record.known / (record.noise**2 + (1e-3 * record.span) ** 2)
        gap, response = self.cleaned(one.solved), one.response
        energy = weight * response**2
        peak = float(energy.max())
        if peak <= 0.0:
            return 0.0
        acts = weight * energy / (energy + _FAINT * peak)
        before = float((acts * (gap**2 - record.noise**2)).sum())
        after = float((acts * ((gap - response) ** 2 - record.noise**2)).sum())
        return 0.0 if before <= 0.0 else float(np.clip(1.0 - after / before, 0.0, 1.0))
