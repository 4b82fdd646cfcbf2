"""Responses and slopes of every effect at nodes of its nonlinear parameters, run once per flight.

A hypothesis is a node and a step from it within 0.6 of the way to neutral; parameters in which a
response is linear need one node. Where a step ends far from its node, a node there makes the
linearisation right (Gauss-Newton by nodes): everything else is inner products.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from narxcal.effects.base import Effect, Parameter
from narxcal.effects.running import Emulator, Flights, respond
from narxcal.support.arrays import BoolArray, FloatArray

_REACH: Final = 0.6  # of the way to neutral
_STEP: Final = 0.03  # of a difference, as a share of the size
_NIL: Final = 1e-3  # share of its range below which an amplitude is none


@dataclass(frozen=True, eq=False)
class Node:
    """One effect at `theta` (p,): `rows` (1 + q, flights, time, outputs) are response and slopes.

    `free` are the places in theta of the q parameters that have slopes, the others stay where they
    are; `box` (q, 2) is how far each may go from here. A load of latent windows, `on` (flights,
    time), has so many `switches`.
    """

    effect: Effect
    parameters: tuple[Parameter, ...]
    theta: FloatArray
    free: tuple[int, ...]
    rows: np.ndarray[tuple[int, ...], np.dtype[np.float32]]
    box: FloatArray
    on: BoolArray | None = None
    switches: int = 0

    @property
    def size(self) -> int:
        """Number of free linear parameters and switches, at least 1."""
        return max(1, sum(self.parameters[j].linear for j in self.free) + self.switches)

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.effect.name

    def of(self, free: tuple[int, ...]) -> Node:
        """The same with some of its slopes."""
        some = [self.free.index(j) for j in free]
        return replace(
            self, free=free, rows=self.rows[[0, *(1 + k for k in some)]], box=self.box[some]
        )

    def at(self, x: FloatArray) -> FloatArray:
        """Parameters (p,) after a step x (q,)."""
        found = self.theta.copy()
        found[list(self.free)] += x
        return np.clip(found, [p.low for p in self.parameters], [p.high for p in self.parameters])

    def response(self, x: FloatArray) -> FloatArray:
        """Response (flights, time, outputs) after a step x (q,)."""
        return np.asarray(self.rows[0] + np.tensordot(x, self.rows[1:], axes=1), dtype=np.float64)


class Dictionary:
    """All nodes of all effects: `nodes` maps an effect's name to its own."""

    def __init__(
        self,
        effects: Sequence[Effect],
        flights: Flights,
        emulator: Emulator | None,
        itself: Emulator | None = None,
    ) -> None:
        self._flights, self._emulator, self._itself = flights, emulator, itself
        # Compiled runs and large arrays release Python's lock; a simulator may not bear two runs.
        self.threads = None if itself is None else 1
        with ThreadPoolExecutor(self.threads) as pool:
            names = [effect.name for effect in effects]
            self.nodes = dict(zip(names, pool.map(self._begun, effects), strict=True))

    def _begun(self, effect: Effect) -> list[Node]:
        """Nodes at the starts of an effect, of all its shapes and of each that may act alone."""
        signals = self._flights.signals
        every, *some = effect.acting(signals)
        starts = np.array(effect.nodes(signals))
        nodes = self._run(effect, effect.parameters(signals), starts, every)
        return nodes + [one.of(free) for free in some for one in nodes]

    def add(self, node: Node, theta: FloatArray) -> Node | None:
        """A further node of the same effect at `theta`; None where there is one already."""
        known = self.nodes[node.name]
        size = np.array([_scale(p, v) for p, v in zip(node.parameters, theta, strict=True)])
        for one in known:
            if one.free == node.free and bool((np.abs(one.theta - theta) <= 0.02 * size).all()):
                return None
        (found,) = self._run(node.effect, node.parameters, theta[None], node.free)
        known.append(found)
        return found

    def _run(
        self,
        effect: Effect,
        parameters: tuple[Parameter, ...],
        thetas: FloatArray,
        free: tuple[int, ...],
    ) -> list[Node]:
        """Run nodes with the differences for their slopes, all in one batch."""
        tried = [_differences(parameters, theta, free) for theta in thetas]
        batch = np.concatenate(
            [np.vstack([theta, *each]) for theta, each in zip(thetas, tried, strict=True)]
        )
        found = self._responses(effect, batch)
        nodes, size = [], 1 + len(free)
        for k, theta in enumerate(thetas):
            rows = found[k * size : (k + 1) * size]
            steps = np.array([tried[k][i][j] - theta[j] for i, j in enumerate(free)])
            rows[1:] = (rows[1:] - rows[0]) / steps[:, None, None, None]
            box = np.array([_box(parameters[j], theta[j]) for j in free]).reshape(-1, 2)
            nodes.append(Node(effect, parameters, theta, free, rows.astype(np.float32), box))
        return nodes

    def _responses(self, effect: Effect, thetas: FloatArray) -> FloatArray:
        y, emulator = self._flights.y, self._emulator
        if self._itself is not None and effect.arrives is not None:
            emulator = self._itself
        found = np.empty((len(thetas), *y.shape))
        for k in range(0, len(thetas), 8):
            part = thetas[k : k + 8]
            found[k : k + 8] = respond([(effect, part)], self._flights, emulator) - y
        return np.where(np.isfinite(found), found, 1e6)


def _size(parameter: Parameter, value: float) -> float:
    """Size of an effect in one parameter: how far it is from neutral, or would begin to be."""
    if parameter.linear:
        return parameter.high - parameter.low
    away = abs(value - parameter.neutral)
    small = min(abs(s - parameter.neutral) for s in parameter.starts if s != parameter.neutral)
    if parameter.neutral != 0.0:  # of a limit far above it, or a factor, a share of itself
        away, small = min(away, abs(value)), min(small, abs(value))
    return max(away, 0.3 * small)


def _scale(parameter: Parameter, value: float) -> float:
    """What a difference between nodes is small against.

    An amplitude is small against itself: slopes of what bends its shape are in proportion to it.
    """
    if parameter.linear:
        return max(abs(value), _NIL * (parameter.high - parameter.low))
    return _size(parameter, value)


def _differences(
    parameters: Sequence[Parameter], theta: FloatArray, free: Sequence[int]
) -> list[FloatArray]:
    found = []
    for j in free:
        p, moved = parameters[j], theta.copy()
        step = _STEP * _size(p, theta[j])
        moved[j] += step if theta[j] + step <= p.high else -step
        found.append(moved)
    return found


def _box(parameter: Parameter, value: float) -> tuple[float, float]:
    low, high = parameter.low - value, parameter.high - value
    if parameter.linear:
        return low, high
    reach = _REACH * _size(parameter, value)
    return max(low, -reach), min(high, reach)
