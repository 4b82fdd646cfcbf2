"""Choose the nodes of an export: until the sampled model meets the tolerance or is too large."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from narxcal.export.grid import (
    Block,
    Grid,
    GriddedModel,
    finite_outputs,
    is_switch,
    nine_digits,
    sample,
)
from narxcal.export.report import ADVICE, ExportOptions, ExportReport, Measured, Probes, Stopped
from narxcal.steady.model import SteadyStateModel
from narxcal.support.arrays import BoolArray, FloatArray, IntArray
from narxcal.support.compiled import compiled
from narxcal.support.errors import ModelError


def candidates(nodes: Sequence[float], most: int) -> FloatArray:
    """Candidates for nodes: `nodes` and round numbers between them, at most about `most`."""
    low, high = nodes[0], nodes[-1]
    step = _round_up((high - low) / most)
    between = step * np.arange(math.ceil(low / step), math.floor(high / step) + 1)
    # Multiples of 0.01 as they are written, without the rounding error of 7 * 0.01.
    between = np.array([float(f"{value:.9g}") for value in between])
    apart = np.abs(between[:, None] - np.array(nodes)).min(axis=1) > 0.3 * step
    return np.union1d(np.array(nodes), between[apart])


def _round_up(step: float) -> float:
    power = 10.0 ** math.floor(math.log10(step))
    return next(m * power for m in (1.0, 2.0, 2.5, 5.0, 10.0) if m * power >= step * (1.0 - 1e-9))


_MOST_SEGMENTS = 64


@dataclass(frozen=True, eq=False)
class AxisNodes:
    """Best nodes of one axis, for each number of segments.

    A curve sampled at M candidates is interpolated linearly between some of them. Its error is that
    of the worst segment, so the best nodes are a shortest path over segments (dynamic programming;
    Bellman 1961, Communications of the ACM 4(6)). `errors[k]` is the error with `k` segments
    (infinite where the required nodes need more), `before[k, j]` the node before candidate `j` on
    the best path to it.
    """

    candidates: FloatArray
    errors: FloatArray
    before: IntArray

    @property
    def fewest(self) -> int:
        """Smallest number of segments with all required nodes."""
        return int(np.flatnonzero(np.isfinite(self.errors))[0])

    def finer(self, segments: int) -> int | None:
        """Next number of segments with a smaller error, None where there is none."""
        better = np.flatnonzero(self.errors[segments:] < self.errors[segments] * (1.0 - 1e-9))
        return segments + int(better[0]) if len(better) else None

    def nodes(self, segments: int) -> FloatArray:
        """Best nodes for `segments`: `(segments + 1,)`."""
        place = len(self.candidates) - 1
        path = [place]
        for count in range(segments, 0, -1):
            place = int(self.before[count, place])
            path.append(place)
        return self.candidates[path[::-1]]


def best_nodes(candidates: FloatArray, values: FloatArray, required: Sequence[float]) -> AxisNodes:
    """Plan an axis from curves `values` (M, curves) at `candidates` (M,).

    The `required` nodes are always among the chosen.
    """
    error = segment_errors(candidates, np.ascontiguousarray(values))
    for place in np.flatnonzero(np.isin(candidates, required)):
        error[:place, place + 1 :] = np.inf
    count = min(len(candidates) - 1, _MOST_SEGMENTS)
    worst = np.full((count + 1, len(candidates)), np.inf)
    before = np.zeros(worst.shape, dtype=np.int64)
    worst[0, 0] = 0.0
    for segments in range(1, count + 1):
        through = np.maximum(worst[segments - 1][:, None], error)
        before[segments] = through.argmin(axis=0)
        worst[segments] = through.min(axis=0)
    return AxisNodes(candidates, worst[:, -1], before)


@compiled
def segment_errors(candidates: FloatArray, values: FloatArray) -> FloatArray:
    """Largest error (M, M) of the straight line from candidate i to candidate j, inf for j <= i."""
    count, width = values.shape
    error = np.full((count, count), np.inf)
    for low in range(count - 1):
        for high in range(low + 1, count):
            worst = 0.0
            for between in range(low + 1, high):
                share = candidates[between] - candidates[low]
                share /= candidates[high] - candidates[low]
                for k in range(width):
                    line = values[low, k] + share * (values[high, k] - values[low, k])
                    worst = max(worst, abs(values[between, k] - line))
            error[low, high] = worst
    return error


def curves(
    function: Callable[[FloatArray], FloatArray],
    others: FloatArray,
    column: int,
    candidates: FloatArray,
) -> FloatArray:
    """Sample `function` `(n, axes) -> (n, n_out)` along one column: (M, lines * n_out).

    `others` (lines, axes) are the values of the other inputs.
    """
    points = np.repeat(others[None], len(candidates), axis=0)
    points[:, :, column] = candidates[:, None]
    found = function(points.reshape(-1, others.shape[1]))
    return found.reshape(len(candidates), -1)


def grow(
    axes: Mapping[str, AxisNodes], others: int, goal: float, most: int
) -> tuple[dict[str, int], Literal["size", "nodes"] | None]:
    """Refine the axis with the largest error until the sum of all errors is at most `goal`.

    `others` is the factor on the rows by the axes not refined, `most` the limit of rows. Returns
    the segments of each axis and, where the goal was not reached, whether the `size` or the lack
    of further `nodes` was the reason.
    """
    segments = {name: axis.fewest for name, axis in axes.items()}
    open_axes, too_many = set(axes), False

    def error(name: str) -> float:
        return float(axes[name].errors[segments[name]])

    while sum(map(error, axes)) > goal:
        if not open_axes:
            return segments, "size" if too_many else "nodes"
        name = max(sorted(open_axes), key=error)
        finer = axes[name].finer(segments[name])
        tried = {**segments, name: finer or 0}
        rows = others * int(np.prod([count + 1 for count in tried.values()], dtype=np.int64))
        if finer is None or rows > most:
            open_axes.remove(name)
            too_many = too_many or finer is not None
        else:
            segments = tried
    return segments, None


# Random conditions to decide which switches add up; and numbers of candidates and lines to choose
# nodes by, fewer for the part of a switch: it is small, and each condition costs two samples.
_DRAWS = 1024
_FINE, _COARSE = (128, 48), (32, 18)


@dataclass(frozen=True, eq=False)
class Layer:
    """The model over the inputs `names`, or, with `switch`, the change by that switch.

    With every switch in one grid, five switches make it 32 times as large. Most switches only
    shift the outputs a little, by an amount that depends smoothly on the other inputs, so that

        f(c, s) ~ f(c, k, 0) + sum over additive switches i of  s_i (f(c, k, e_i) - f(c, k, 0))

    with c the continuous inputs and k the switches that act together. Each term of the sum needs
    coarse nodes only. Switches not among `names` are 0. `share` is the part of the tolerance that
    the layer's nodes may use.
    """

    model: SteadyStateModel
    grid: Grid
    names: tuple[str, ...]
    switch: str | None
    share: float

    @property
    def columns(self) -> tuple[int, ...]:
        """Indices of the layer's inputs among those exported."""
        return tuple(self.grid.varying.index(name) for name in self.names)

    def __call__(self, points: FloatArray) -> FloatArray:
        """Values (n, n_out) at `points` (n, names)."""
        full = self.embedded(points)
        if self.switch is None:
            return finite_outputs(self.model, full)
        column = self.model.input_names.index(self.switch)
        gate = full[:, column].copy()
        full[:, column] = 1.0
        with_it = finite_outputs(self.model, full)
        full[:, column] = 0.0
        return gate[:, None] * (with_it - finite_outputs(self.model, full))

    @property
    def others(self) -> int:
        """Factor on the rows by the switches."""
        return math.prod(len(self.grid.axes[name]) for name in self.names if is_switch(name))

    def embedded(self, points: FloatArray) -> FloatArray:
        """Conditions (n, n_in) of the model with the layer's inputs at `points`."""
        full = np.zeros((len(points), len(self.model.input_names)))
        for name, value in self.grid.fixed.items():
            full[:, self.model.input_names.index(name)] = value
        full[:, [self.model.input_names.index(name) for name in self.names]] = points
        return full

    def axis_nodes(self, scale: FloatArray, rng: np.random.Generator) -> dict[str, AxisNodes]:
        """Best nodes of each continuous axis, with errors in units of `scale` (n_out,)."""
        return {name: self._axis(name, scale, rng) for name in self.names if not is_switch(name)}

    def _axis(self, name: str, scale: FloatArray, rng: np.random.Generator) -> AxisNodes:
        most, lines = _FINE if self.switch is None else _COARSE
        places = candidates(self.grid.axes[name], most)
        others = self._lines(lines, rng)
        values = curves(lambda at: self(at) / scale, others, self.names.index(name), places)
        return best_nodes(places, values, self.grid.axes[name])

    def _lines(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Draw conditions (count, names), every third in a corner, where errors are largest."""
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
    """Make one layer over all inputs but the `additive` switches, and one for each of these."""
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
    model: SteadyStateModel, grid: Grid, scale: FloatArray, allowed: float
) -> tuple[str, ...]:
    """Find switches whose effects may be summed with an error of at most `allowed` times `scale`.

    Backward elimination: starts from all and drops the switch without which the sum is best.
    """
    points = grid.draw(_DRAWS, np.random.default_rng(1))
    points = points[model.inside(points)]
    truth = finite_outputs(model, points) if len(points) else np.zeros((0, len(scale)))
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


# Errors of several axes rarely have their maximum at one point: the first sum of errors tried is
# this many tolerances, and there are so many rounds.
_FIRST_GOAL, _ROUNDS = 2.0, 8


@dataclass(frozen=True, eq=False)
class Planned:
    """A sampled model, its errors, and why its nodes were not refined further."""

    gridded: GriddedModel
    measured: Measured
    stopped: Stopped
    additive: tuple[str, ...]

    def report(self, grid: Grid, options: ExportOptions, file: str, size: int) -> ExportReport:
        """Report on `file` of `size` bytes."""
        axes = {
            name: tuple(axis.tolist())
            for block in reversed(self.gridded.blocks)
            for name, axis in zip(_names(block, grid), block.axes, strict=True)
        }
        return ExportReport(
            file,
            size,
            self.gridded.rows,
            {name: axes[name] for name in grid.varying},
            grid.fixed,
            self.additive,
            self.measured,
            options.tolerance_pct,
            self.stopped,
        )


def _names(block: Block, grid: Grid) -> list[str]:
    return [grid.varying[column] for column in block.columns]


def plan(model: SteadyStateModel, grid: Grid, options: ExportOptions, *, separate: bool) -> Planned:
    """Sample `model` on `grid`, refined by `options`; `separate` allows a sum of grids.

    Where the given nodes meet the tolerance, the grid is used unchanged.

    Raises `ModelError` where the model's outputs are not finite, where the grid is too large before
    refinement, and, under `strict`, where the tolerance is missed.
    """
    planned = _planned(model, grid, options, separate=separate)
    if options.strict and planned.measured.worst_pct > options.tolerance_pct:
        worst = max(planned.measured.outputs, key=lambda output: output.max_pct)
        raise ModelError(
            f"the error reaches {worst.max_pct:.3g} % of the range with {planned.gridded.rows} "
            f"rows, above the tolerance of {options.tolerance_pct:g} %",
            channel=worst.name,
            hint=ADVICE,
        )
    return planned


def _planned(
    model: SteadyStateModel, grid: Grid, options: ExportOptions, *, separate: bool
) -> Planned:
    if grid.rows <= options.max_rows or not (options.refine and separate):
        whole = _Sampling(model, grid, options, separate=False)
        planned = whole.as_given()
        if planned.stopped == "tolerance" or not options.refine:
            return planned
        if not separate:
            return whole.refined()
    return _Sampling(model, grid, options, separate=True).refined()


@dataclass
class _Sampling:
    """A model to be sampled on layers, and the random conditions that measure the error."""

    model: SteadyStateModel
    grid: Grid
    options: ExportOptions
    separate: bool
    probes: Probes = field(init=False)
    layers: list[Layer] = field(init=False)
    additive: tuple[str, ...] = field(init=False, default=())

    def __post_init__(self) -> None:
        model, grid = self.model, self.grid
        self.tolerance = self.options.tolerance_pct / 100.0
        self.probes = Probes(model, grid, self.options)
        if self.separate:
            allowed = 0.25 * self.tolerance
            self.additive = additive_switches(model, grid, self.probes.scale, allowed)
        self.layers = layers(model, grid, self.additive)
        fewest = sum(_rows(layer, {}) for layer in self.layers)
        if fewest > self.options.max_rows:
            raise ModelError(
                f"the given nodes make {fewest} rows, more than the limit of "
                f"{self.options.max_rows}",
                hint="Allow more rows, give fewer nodes, or fix an input at one node",
            )

    def as_given(self) -> Planned:
        """Sample on the given nodes alone."""
        return self._planned([{}] * len(self.layers), "nodes")

    def refined(self) -> Planned:
        """Add nodes until the measured error meets the tolerance, or no more are allowed."""
        rng = np.random.default_rng(self.options.seed)
        plans = []
        for place, layer in enumerate(self.layers):
            self.options.progress(place, len(self.layers), "choosing nodes")
            plans.append(layer.axis_nodes(self.probes.scale, rng))
        goal = _FIRST_GOAL * self.tolerance
        for _ in range(_ROUNDS):
            axes, stopped = self._grown(plans, goal)
            planned = self._planned(axes, stopped or "nodes")
            if stopped is not None or planned.stopped == "tolerance":
                break
            goal *= min(0.9 * self.tolerance / planned.measured.worst_pct * 100.0, 0.7)
        return planned

    def _grown(
        self, plans: list[dict[str, AxisNodes]], goal: float
    ) -> tuple[list[dict[str, FloatArray]], Stopped | None]:
        """Nodes of each layer's axes, and the reason where the goal was not reached."""
        axes: list[dict[str, FloatArray]] = [{} for _ in plans]
        left, reasons = self.options.max_rows, []
        # The small layers first; the rows that are left are for the first layer.
        for place in [*range(1, len(plans)), 0]:
            layer, axis_nodes = self.layers[place], plans[place]
            most = left if place == 0 else self.options.max_rows // (4 * len(plans))
            segments, reason = grow(axis_nodes, layer.others, goal * layer.share, most)
            axes[place] = {name: each.nodes(segments[name]) for name, each in axis_nodes.items()}
            left -= _rows(layer, axes[place])
            reasons.append(reason)
        reached = [reason for reason in reasons if reason is not None]
        return axes, ("size" if "size" in reached else "nodes") if reached else None

    def _planned(self, axes: list[dict[str, FloatArray]], stopped: Stopped) -> Planned:
        blocks = [self._block(*pair) for pair in zip(self.layers, axes, strict=True)]
        gridded = GriddedModel(
            (self.grid.varying, self.model.output_names), blocks, self._valid_nodes(blocks[0])
        )
        kept = [self.model.input_names.index(name) for name in self.grid.varying]
        measured = self.probes.measure(gridded.outputs(self.probes.inputs[:, kept]))
        if measured.worst_pct <= self.options.tolerance_pct:
            stopped = "tolerance"
        return Planned(gridded, measured, stopped, self.additive)

    def _block(self, layer: Layer, nodes: dict[str, FloatArray]) -> Block:
        axes = tuple(np.array(nodes.get(name, self.grid.axes[name])) for name in layer.names)
        note = f"the part of {layer.switch}" if layer.switch else "the grid"

        def progress(done: int, total: int, _what: str = "") -> None:
            self.options.progress(done, total, note)

        return Block(layer.columns, axes, nine_digits(sample(layer, axes, progress)))

    def _valid_nodes(self, block: Block) -> BoolArray:
        """Whether the model is valid at each node of the first block."""
        base = self.layers[0]

        def inside(points: FloatArray) -> FloatArray:
            return self.model.inside(base.embedded(points))[:, None].astype(np.float64)

        return np.asarray(sample(inside, block.axes)[..., 0] > 0.0)


def _rows(layer: Layer, nodes: dict[str, FloatArray]) -> int:
    lengths = [len(nodes.get(name, layer.grid.axes[name])) for name in layer.names]
    return int(np.prod(lengths, dtype=np.int64))
