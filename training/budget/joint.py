"""Several effects at once: their joint fit, what each set of causes does, and left-out units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from narxcal.support.arrays import FloatArray, IntArray
from training.budget.dictionary import Node
from training.budget.fitting import Frame, Single
from training.budget.nuisances import BUILD, OFFSET, SMALL, START
from training.budget.quadratic import Columns, Solved, no_columns, solve
from training.budget.shares import Split, shapley

_Z: float = 1.645  # of a 90 % interval


@dataclass(frozen=True, eq=False)
class Joint:
    """Effects fitted together: one node each, and the steps from it.

    `theta` and `spread` hold parameters and their standard deviations per effect; `others`
    (units,) the parameters found without each unit.
    """

    nodes: tuple[Node, ...]
    frame: Frame
    solved: Solved
    theta: tuple[FloatArray, ...]
    spread: tuple[FloatArray, ...]
    others: tuple[tuple[FloatArray, ...], ...]

    def responses(self, steps: FloatArray) -> list[FloatArray]:
        """What each effect does after the steps of all."""
        return [n.response(x) for n, x in zip(self.nodes, self.parts(steps), strict=True)]

    def parts(self, x: FloatArray) -> list[FloatArray]:
        """The step of each effect out of that of all."""
        ends = np.cumsum([len(n.free) for n in self.nodes])
        return list(np.split(x, ends)[:-1])


class _Rows:
    """Inner products of all rows of several nodes, combined for any subset of them."""

    def __init__(self, frame: Frame, nodes: Sequence[Node]) -> None:
        self.nodes = nodes
        if nodes:
            self._inner = frame.inner(np.concatenate([node.rows for node in nodes]))
        self._starts = np.cumsum([0, *(len(node.rows) for node in nodes)])
        self._frame = frame

    def of(self, which: Sequence[int]) -> Columns:
        """Columns of some of the nodes together."""
        if not which:
            return no_columns(self._frame.grams)
        first = [self._starts[k] for k in which]
        slopes = [j for k in which for j in range(self._starts[k] + 1, self._starts[k + 1])]
        rr, rn, rd = self._inner
        mix = np.zeros((1 + len(slopes), rr.shape[1]))
        mix[0, first] = 1.0
        mix[np.arange(1, len(mix)), slopes] = 1.0
        names = {self.nodes[k].name for k in which}
        absent = np.array([name in names for name in self._frame.nuisances.effect])
        box = np.concatenate([self.nodes[k].box for k in which])
        return Columns(mix @ rr @ mix.T, mix @ rn, rd @ mix.T, box, absent)


def together(frame: Frame, singles: Sequence[Single]) -> Joint:
    """Fit the effects of `singles` together, from their nodes."""
    nodes = tuple(one.node for one in singles)
    rows = _Rows(frame, nodes)
    columns = rows.of(list(range(len(nodes))))
    found = solve(frame.grams, columns)
    units = len(frame.grams.dd)
    left_out = [solve(frame.grams, columns, u) for u in range(units)] if units > 1 else []
    steps = np.array([one.x for one in left_out]).reshape(len(left_out), len(found.x))
    variance = np.diag(found.covariance).copy()
    if len(steps):
        variance += (units - 1) / units * ((steps - steps.mean(axis=0)) ** 2).sum(axis=0)
    joint = Joint(nodes, frame, found, (), (), ())
    theta = _thetas(joint, found.x)
    spread = [np.zeros(len(t)) for t in theta]
    for node, into, sd in zip(nodes, spread, joint.parts(np.sqrt(variance)), strict=True):
        into[list(node.free)] = sd
    others = tuple(_thetas(joint, x) for x in steps)
    return replace(joint, theta=theta, spread=tuple(spread), others=others)


def _thetas(joint: Joint, x: FloatArray) -> tuple[FloatArray, ...]:
    return tuple(n.at(part) for n, part in zip(joint.nodes, joint.parts(x), strict=True))


def by_others(joint: Joint) -> FloatArray | None:
    """What the effects do in each unit by the others' parameters, less by those of all."""
    if not joint.others or not joint.nodes:
        return None
    record = joint.frame.record
    change = np.zeros_like(record.gap)
    mine = np.sum(joint.responses(joint.solved.x), axis=0)
    for u, thetas in enumerate(joint.others):
        pairs = zip(joint.nodes, thetas, strict=True)
        steps = np.concatenate([(t - n.theta)[list(n.free)] for n, t in pairs])
        theirs = np.sum(joint.responses(steps), axis=0)
        here = record.unit == u
        change[here] = (theirs - mine)[here]
    return change


def budget_of(frame: Frame, singles: Sequence[Single], cells: IntArray) -> Split:
    """Shares (effects, build, offsets; outputs, cells) of the squared gap over ranges squared.

    `cells` (flights, time) is the number of the phase of each sample, -1 for none.
    """
    rows, kinds = _Rows(frame, [one.node for one in singles]), np.array(frame.nuisances.kind)
    count, limit = len(singles), frame.grams.limit
    build = np.isin(kinds, (BUILD, SMALL))
    offsets = np.isin(kinds, (OFFSET, START))
    phases = int(cells.max()) + 1
    flat = np.eye(phases)[np.maximum(cells, 0)] * (cells >= 0)[..., None]
    gap, scale = frame.gap, 1.0 / frame.record.span**2

    def worth(causes: frozenset[int]) -> FloatArray:
        allowed = np.zeros(len(limit), dtype=bool)
        allowed |= build if count in causes else False
        allowed |= offsets if count + 1 in causes else False
        grams = replace(frame.grams, limit=np.where(allowed, limit, 0.0))
        which = sorted(c for c in causes if c < count)
        found = solve(grams, rows.of(which))
        change = np.tensordot(found.nu, frame.nuisances.columns, axes=1)
        at = 0
        for k in which:
            size = len(rows.nodes[k].free)
            change = change + rows.nodes[k].response(found.x[at : at + size])
            at += size
        taken = (gap**2 - (gap - change) ** 2) * frame.record.known * scale
        return np.asarray(np.einsum("ftc,ftp->cp", taken, flat))

    return shapley(count + 2, worth)


def interval(value: float, spread: float, low: float, high: float) -> tuple[float, float, float]:
    """A value with its 90 % interval, within bounds."""
    return value, max(low, value - _Z * spread), min(high, value + _Z * spread)
