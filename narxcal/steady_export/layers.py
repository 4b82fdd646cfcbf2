"""What the grids of an export hold: the model over some inputs, and what single switches add.

With every switch in one grid, five switches make it 32 times as large. Most switches only
shift the outputs a little, by an amount that depends smoothly on the rest, so that

    f(c, s) ~ f(c, k, 0) + sum over additive switches i of  s_i (f(c, k, e_i) - f(c, k, 0))

with c the continuous inputs and k the switches that act together. Each sum needs coarse nodes
only. Which switches may be taken out of k is measured, not assumed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from narxcal.steady_export.axis_nodes import AxisNodes, best_nodes, curves
from narxcal.steady_export.grid import Grid, candidates, is_switch
from narxcal.steady_export.gridded import settled
from narxcal.steady_state import Floats, SteadyStateModel

# Random conditions that tell which switches add up; candidates and lines that nodes are chosen
# by, fewer of them for what a switch adds: it is small, and each condition costs two samples.
_DRAWS = 1024
_FINE, _COARSE = (128, 48), (32, 18)


@dataclass(frozen=True, eq=False)
class Layer:
    """The model over the inputs `names`, or, with `switch`, what that one adds to it.

    Switches not among `names` stand at 0. `share` is the part of the tolerance that the
    layer's nodes may use up.
    """

    model: SteadyStateModel
    grid: Grid
    names: tuple[str, ...]
    switch: str | None
    share: float

    @property
    def columns(self) -> tuple[int, ...]:
        """Places of the layer's inputs among those exported."""
        return tuple(self.grid.varying.index(name) for name in self.names)

    def __call__(self, points: Floats) -> Floats:
        """Values (n, n_out) at `points` (n, names)."""
        full = self.embedded(points)
        if self.switch is None:
            return settled(self.model, full)
        column = self.model.input_names.index(self.switch)
        gate = full[:, column].copy()
        full[:, column] = 1.0
        with_it = settled(self.model, full)
        full[:, column] = 0.0
        return gate[:, None] * (with_it - settled(self.model, full))

    @property
    def others(self) -> int:
        """Rows that the switches multiply by."""
        return math.prod(len(self.grid.axes[name]) for name in self.names if is_switch(name))

    def embedded(self, points: Floats) -> Floats:
        """Conditions (n, n_in) of the model with the layer's inputs at `points`."""
        full = np.zeros((len(points), len(self.model.input_names)))
        for name, value in self.grid.fixed.items():
            full[:, self.model.input_names.index(name)] = value
        full[:, [self.model.input_names.index(name) for name in self.names]] = points
        return full

    def plans(self, scale: Floats, rng: np.random.Generator) -> dict[str, AxisNodes]:
        """Plan the axes that nodes may be added to, errors in units of `scale` (n_out,)."""
        return {name: self._plan(name, scale, rng) for name in self.names if not is_switch(name)}

    def _plan(self, name: str, scale: Floats, rng: np.random.Generator) -> AxisNodes:
        most, lines = _FINE if self.switch is None else _COARSE
        places = candidates(self.grid.axes[name], most)
        others = self._lines(lines, rng)
        values = curves(lambda at: self(at) / scale, others, self.names.index(name), places)
        return best_nodes(places, values, self.grid.axes[name])

    def _lines(self, count: int, rng: np.random.Generator) -> Floats:
        """Random conditions (count, names), every third in a corner, where errors are largest."""
        order = [list(self.grid.axes).index(name) for name in self.names]
        drawn = self.grid.draw(count, rng)[:, order]
        low = np.array([self.grid.axes[name][0] for name in self.names])
        high = np.array([self.grid.axes[name][-1] for name in self.names])
        corner = rng.integers(0, 2, drawn[::3].shape)
        drawn[::3] = np.where(corner, high, low)
        if self.switch is not None:
            drawn[:, self.names.index(self.switch)] = 1.0
        return drawn


def layers(model: SteadyStateModel, grid: Grid, additive: Sequence[str]) -> list[Layer]:
    """One layer over all inputs but the `additive` switches, and one for each of these."""
    together = tuple(name for name in grid.varying if name not in additive)
    base = Layer(model, grid, together, None, 0.7 if additive else 1.0)
    rest = [
        Layer(
            model,
            grid,
            tuple(one for one in grid.varying if one in together or one == name),
            name,
            0.3 / len(additive),
        )
        for name in additive
    ]
    return [base, *rest]


def additive_switches(
    model: SteadyStateModel, grid: Grid, scale: Floats, allowed: float
) -> tuple[str, ...]:
    """Switches whose effects may be summed with an error of at most `allowed` times `scale`.

    Starts from all and gives up, one by one, the switch without which the sum is best.
    """
    points = grid.draw(_DRAWS, np.random.default_rng(1))
    points = points[model.inside(points)]
    truth = settled(model, points) if len(points) else np.zeros((0, len(scale)))
    chosen = [name for name in grid.varying if is_switch(name) and grid.axes[name] == (0.0, 1.0)]

    def error(additive: Sequence[str]) -> float:
        parts = layers(model, grid, additive)
        places = [[model.input_names.index(name) for name in part.names] for part in parts]
        found = sum(part(points[:, place]) for part, place in zip(parts, places, strict=True))
        return float((np.abs(found - truth) / scale).max(initial=0.0))

    while chosen and error(chosen) > allowed:
        fewer = [[one for one in chosen if one != name] for name in chosen]
        chosen = min(fewer, key=error)
    return tuple(chosen)
