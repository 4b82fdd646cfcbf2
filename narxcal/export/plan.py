"""Choose the nodes of an export: until the sampled model meets the tolerance or is too large.

`export_table` writes what was sampled as a CSV that `narxcal.steady.table` reads.
"""

from __future__ import annotations

import gzip
from collections.abc import Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path

import numpy as np

from narxcal.channels import is_switch
from narxcal.export.grid import (
    Block,
    Grid,
    GriddedModel,
    finite_outputs,
    nine_digits,
    rounded,
    sample,
)
from narxcal.export.nodes import candidates, curves, fewest_nodes, segment_errors
from narxcal.export.report import (
    ADVICE,
    ExportOptions,
    ExportReport,
    Measured,
    Probes,
    Stopped,
    description,
)
from narxcal.steady.model import SteadyStateModel
from narxcal.support.arrays import BoolArray, FloatArray
from narxcal.support.errors import ModelError
from narxcal.support.files import atomic_write_bytes

# Random conditions to decide which switches add up; and numbers of candidates and lines to choose
# nodes by, fewer for the part of a switch: it is small, and each condition costs two samples.
_DRAWS = 1024
_FINE, _COARSE = (128, 48), (32, 18)
Axis = tuple[FloatArray, FloatArray]  # candidates (M,) and errors (M, M) of the lines between them


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

    def embedded(self, points: FloatArray) -> FloatArray:
        """Conditions (n, n_in) of the model with the layer's inputs at `points`."""
        full = np.zeros((len(points), len(self.model.input_names)))
        for name, value in self.grid.fixed.items():
            full[:, self.model.input_names.index(name)] = value
        full[:, [self.model.input_names.index(name) for name in self.names]] = points
        return full

    def axes(self, scale: FloatArray, rng: np.random.Generator) -> dict[str, Axis]:
        """Candidates and errors, in units of `scale` (n_out,), of each continuous axis."""
        return {name: self._axis(name, scale, rng) for name in self.names if not is_switch(name)}

    def _axis(self, name: str, scale: FloatArray, rng: np.random.Generator) -> Axis:
        most, lines = _FINE if self.switch is None else _COARSE
        nodes = self.grid.axes[name]
        places = candidates(nodes, most)
        others = self._lines(lines, rng)
        values = curves(lambda at: self(at) / scale, others, self.names.index(name), places)
        errors = segment_errors(places, values)
        for kept in np.flatnonzero(np.isin(places, nodes)):
            errors[:kept, kept + 1 :] = np.inf
        return places, errors

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


# Rounds, and the factor on what axes may be off by while the grid is too large. Errors of axes
# rarely have their maximum at one point, so each may first have the whole tolerance.
_ROUNDS, _LOOSER = 12, 1.1
_ROUNDED = 0.01  # share of the tolerance by which the values at added nodes may be rounded


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
            grid.varying[column]: tuple(axis.tolist())
            for block in reversed(self.gridded.blocks)
            for column, axis in zip(block.columns, block.axes, strict=True)
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
        return self._planned([{}] * len(self.layers), "nodes")

    def refined(self) -> Planned:
        """Add nodes until the measured error meets the tolerance, or no more are allowed.

        All axes of a layer are off by as much: that makes the product of their nodes the smallest
        where the error of an axis falls with the square of its nodes.
        """
        rng = np.random.default_rng(self.options.seed)
        axes = []
        for place, layer in enumerate(self.layers):
            self.options.progress(place, len(self.layers), "choosing nodes")
            axes.append(layer.axes(self.probes.scale, rng))
        allowed = self.tolerance
        stopped: Stopped = "nodes"
        for _ in range(_ROUNDS):
            nodes = self._nodes(axes, allowed)
            while sum(map(_rows, self.layers, nodes)) > self.options.max_rows:
                allowed, stopped = _LOOSER * allowed, "size"
                nodes = self._nodes(axes, allowed)
            planned = self._planned(nodes, stopped)
            if planned.stopped != "nodes":
                break
            allowed *= min(0.95 * self.options.tolerance_pct / planned.measured.worst_pct, 0.85)
        return planned

    def _nodes(self, axes: list[dict[str, Axis]], allowed: float) -> list[dict[str, FloatArray]]:
        return [
            {name: fewest_nodes(*axis, layer.share * allowed) for name, axis in own.items()}
            for layer, own in zip(self.layers, axes, strict=True)
        ]

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

        values = sample(layer, axes, progress)
        if not nodes:  # those given: a table stays what it is
            return Block(layer.columns, axes, nine_digits(values))
        most = _ROUNDED * self.tolerance / len(self.layers) * self.probes.scale
        return Block(layer.columns, axes, rounded(values, most))

    def _valid_nodes(self, block: Block) -> BoolArray:
        """Whether the model is valid at each node of the first block."""
        base = self.layers[0]

        def inside(points: FloatArray) -> FloatArray:
            return self.model.inside(base.embedded(points))[:, None].astype(np.float64)

        return np.asarray(sample(inside, block.axes)[..., 0] > 0.0)


def _rows(layer: Layer, nodes: dict[str, FloatArray]) -> int:
    lengths = [len(nodes.get(name, layer.grid.axes[name])) for name in layer.names]
    return int(np.prod(lengths, dtype=np.int64))


# --- a table ---


def export_table(
    model: SteadyStateModel,
    grid: Grid,
    path: str | PathLike[str],
    options: ExportOptions | None = None,
) -> ExportReport:
    """Sample `model` on a full grid and write a CSV (or .csv.gz), completely or not at all.

    `grid` has the first nodes; `ExportOptions` limit how many are added. Inputs of one node are
    left out. The same model and options give the same bytes.
    """
    chosen, file = options or ExportOptions(), Path(path)
    planned = plan(model, grid, chosen, separate=False)
    draft = planned.report(grid, chosen, str(file), 0)
    comments = "".join(f"# {line}\n" for line in description(draft, chosen.source))
    data = (comments + _csv(planned)).encode("utf-8")
    if file.suffix == ".gz":
        data = gzip.compress(data, compresslevel=9, mtime=0)
    atomic_write_bytes(file, data)
    return planned.report(grid, chosen, str(file), len(data))


def _csv(planned: Planned) -> str:
    (block,) = planned.gridded.blocks
    nodes = [[repr(value) for value in axis.tolist()] for axis in block.axes]
    places = np.unravel_index(np.arange(block.rows), block.values.shape[:-1])
    values = block.values.reshape(block.rows, -1).tolist()
    lines = [",".join((*planned.gridded.input_names, *planned.gridded.output_names))]
    for where, row in zip(np.column_stack(places).tolist(), values, strict=True):
        at = [axis[place] for axis, place in zip(nodes, where, strict=True)]
        lines.append(",".join([*at, *(f"{value:.9g}" for value in row)]))
    return "\n".join(lines) + "\n"
