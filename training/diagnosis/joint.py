"""Several effects at once: their joint fit, what each cause does, and left-out units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from narxcal.support.arrays import BoolArray, FloatArray
from training.diagnosis.dictionary import Node
from training.diagnosis.fit import Columns, Frame, Single, Solved, no_columns, solve
from training.diagnosis.metric import assumed_variance
from training.diagnosis.nuisances import BUILD, OFFSET, SMALL, START

_Z: float = 1.645  # of a 90 % interval


@dataclass(frozen=True, eq=False)
class Joint:
    """Effects fitted together: one node each, and the steps from it.

    `theta` and `spread` hold parameters and their standard deviations per effect; `left_out`
    (units,) are the fits without each unit, and `others` the parameters found there; nothing of a
    single unit.
    """

    nodes: tuple[Node, ...]
    frame: Frame
    solved: Solved
    left_out: tuple[Solved, ...]
    theta: tuple[FloatArray, ...]
    spread: tuple[FloatArray, ...]
    others: tuple[tuple[FloatArray, ...], ...]

    def components(self) -> list[FloatArray]:
        """What each effect does, what the differences of build do, and what the offsets do.

        In each unit by the fit to the others; of a single unit by its own.
        """
        if not self.left_out:
            return [*self.responses(self.solved.x), *of_nuisances(self.frame, self.solved.nu)]
        found = [np.zeros_like(self.frame.gap) for _ in range(len(self.nodes) + 2)]
        for u, solved in enumerate(self.left_out):
            here = self.frame.record.unit == u
            *others, offsets = *self.responses(solved.x), *of_nuisances(self.frame, solved.nu)
            own = self._own_offsets(here, solved, sum(others, np.zeros_like(offsets)))
            for into, part in zip(found, [*others, offsets + own], strict=True):
                into[here] = part[here]
        return found

    def _own_offsets(self, here: BoolArray, solved: Solved, others: FloatArray) -> FloatArray:
        """Offsets of a flight that is left out as a whole, which the others can't know.

        Those of each half are estimated in the other one; how hot it started is its own.
        """
        record, noise = self.frame.record, self.frame.nuisances
        found = np.zeros_like(self.frame.gap)
        (f, *more) = np.flatnonzero(here.any(axis=1))
        if more or (record.unit[f] >= 0).sum() > here[f].sum():
            return found
        acts = noise.columns[:, f].any(axis=(1, 2))
        start, offset = (acts & (np.array(noise.kind) == kind) for kind in (START, OFFSET))
        found[f] = np.tensordot(self.solved.nu[start], noise.columns[start, f], axes=1)
        rest, columns = self.frame.gap[f] - others[f] - found[f], noise.columns[offset, f]
        weight = record.known[f] / assumed_variance(record)[0][f]
        halves = np.array_split(np.flatnonzero(here[f]), 2)
        for seen, scored in (halves, halves[::-1]):
            part = columns[:, seen]
            inner = np.einsum("ktc,tc,ltc->kl", part, weight[seen], part)
            toward = np.einsum("ktc,tc,tc->k", part, weight[seen], rest[seen])
            nu = np.linalg.solve(inner + solved.tau * np.eye(len(inner)), toward)
            limit = noise.limit[offset]
            found[f, scored] += np.tensordot(np.clip(nu, -limit, limit), columns[:, scored], axes=1)
        return found

    def responses(self, steps: FloatArray) -> list[FloatArray]:
        """What each effect does after the steps of all."""
        return [n.response(x) for n, x in zip(self.nodes, self.parts(steps), strict=True)]

    def parts(self, x: FloatArray) -> list[FloatArray]:
        """The step of each effect out of that of all."""
        ends = np.cumsum([len(n.free) for n in self.nodes])
        return list(np.split(x, ends)[:-1])


def of_nuisances(frame: Frame, nu: FloatArray) -> list[FloatArray]:
    """What nuisances of sizes `nu` do: the differences of build, and the offsets of flights."""
    noise, kinds = frame.nuisances, np.array(frame.nuisances.kind)
    groups = [np.isin(kinds, group) for group in ((BUILD, SMALL), (OFFSET, START))]
    return [np.tensordot(nu[here], noise.columns[here], axes=1) for here in groups]


def _columns(frame: Frame, nodes: Sequence[Node]) -> Columns:
    """Columns of all nodes together: the sum of their responses, and their slopes."""
    if not nodes:
        return no_columns(frame.grams)
    rr, rn, rd = frame.inner(np.concatenate([node.rows for node in nodes]))
    first = np.cumsum([0, *(len(node.rows) for node in nodes)])[:-1]
    slopes = np.setdiff1d(np.arange(rr.shape[1]), first)
    mix = np.zeros((1 + len(slopes), rr.shape[1]))
    mix[0, first] = 1.0
    mix[np.arange(1, len(mix)), slopes] = 1.0
    names = {node.name for node in nodes}
    absent = np.array([name in names for name in frame.nuisances.effect])
    box = np.concatenate([node.box for node in nodes])
    return Columns(mix @ rr @ mix.T, mix @ rn, rd @ mix.T, box, absent)


def together(frame: Frame, singles: Sequence[Single]) -> Joint:
    """Fit the effects of `singles` together, from their nodes."""
    nodes = tuple(one.node for one in singles)
    columns = _columns(frame, nodes)
    found = solve(frame.grams, columns)
    units = len(frame.grams.dd)
    left_out = [solve(frame.grams, columns, u) for u in range(units)] if units > 1 else []
    steps = np.array([one.x for one in left_out]).reshape(len(left_out), len(found.x))
    variance = np.diag(found.covariance).copy()
    if len(steps):
        variance += (units - 1) / units * ((steps - steps.mean(axis=0)) ** 2).sum(axis=0)
    joint = Joint(nodes, frame, found, tuple(left_out), (), (), ())
    theta = _thetas(joint, found.x)
    spread = [np.zeros(len(t)) for t in theta]
    for node, into, sd in zip(
        nodes, spread, joint.parts(np.sqrt(np.maximum(variance, 0.0))), strict=True
    ):
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


def interval(value: float, spread: float, low: float, high: float) -> tuple[float, float, float]:
    """A value with its 90 % interval, within bounds."""
    return value, max(low, value - _Z * spread), min(high, value + _Z * spread)
