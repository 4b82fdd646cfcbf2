"""Chooses nodes and samples the model, until it is matched or the size limit is reached."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from narxcal.export.grid import (
    AxisNodes,
    Block,
    Grid,
    GriddedModel,
    Layer,
    additive_switches,
    grow,
    layers,
    nine_digits,
    sample,
)
from narxcal.export.report import ADVICE, ExportOptions, ExportReport, Measured, Probes, Stopped
from narxcal.steady.model import Floats, SteadyStateModel
from narxcal.support.errors import ModelError

# Errors of several axes seldom peak in one place: the first try allows this many tolerances.
_HOPE, _ROUNDS = 2.0, 8


@dataclass(frozen=True, eq=False)
class Planned:
    """A model on its grids, how well it matches, and why its nodes were not refined further."""

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
    """Sample `model` on `grid`, refined as `options` say; `separate` allows a sum of grids.

    Nodes that keep the tolerance as they are given stay one grid, as they are.

    Raises `ModelError` where the model gives no numbers, where the grid is too large before
    anything is refined, and, under `strict`, where the tolerance is missed.
    """
    planned = _planned(model, grid, options, separate=separate)
    if options.strict and planned.measured.worst_pct > options.tolerance_pct:
        worst = max(planned.measured.outputs, key=lambda output: output.max_pct)
        raise ModelError(
            f"the error reaches {worst.max_pct:.3g} % of the range with {planned.gridded.rows} "
            f"rows, and {options.tolerance_pct:g} % was asked for",
            channel=worst.name,
            hint=ADVICE,
        )
    return planned


def _planned(
    model: SteadyStateModel, grid: Grid, options: ExportOptions, *, separate: bool
) -> Planned:
    if grid.rows <= options.max_rows or not (options.refine and separate):
        whole = _Task(model, grid, options, separate=False)
        planned = whole.as_given()
        if planned.stopped == "tolerance" or not options.refine:
            return planned
        if not separate:
            return whole.refined()
    return _Task(model, grid, options, separate=True).refined()


@dataclass
class _Task:
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
        least = sum(_rows(layer, {}) for layer in self.layers)
        if least > self.options.max_rows:
            raise ModelError(
                f"the nodes asked for make {least} rows, more than the {self.options.max_rows} "
                "allowed",
                hint="Allow more rows, give fewer nodes, or fix an input at one node",
            )

    def as_given(self) -> Planned:
        """Sample on the nodes given and nothing else."""
        return self._planned([{}] * len(self.layers), "nodes")

    def refined(self) -> Planned:
        """Add nodes until the measured error keeps the tolerance, or no more are allowed."""
        rng = np.random.default_rng(self.options.seed)
        plans = []
        for place, layer in enumerate(self.layers):
            self.options.watch(place, len(self.layers), "choosing nodes")
            plans.append(layer.plans(self.probes.scale, rng))
        goal = _HOPE * self.tolerance
        for _ in range(_ROUNDS):
            axes, stopped = self._grown(plans, goal)
            planned = self._planned(axes, stopped or "nodes")
            if stopped is not None or planned.stopped == "tolerance":
                break
            goal *= min(0.9 * self.tolerance / planned.measured.worst_pct * 100.0, 0.7)
        return planned

    def _grown(
        self, plans: list[dict[str, AxisNodes]], goal: float
    ) -> tuple[list[dict[str, Floats]], Stopped | None]:
        """Nodes of each layer's axes, and why the goal was not reached, if it was not."""
        axes: list[dict[str, Floats]] = [{} for _ in plans]
        left, reasons = self.options.max_rows, []
        # The small ones first: what they leave is for the large one.
        for place in [*range(1, len(plans)), 0]:
            layer, plan_ = self.layers[place], plans[place]
            most = left if place == 0 else self.options.max_rows // (4 * len(plans))
            segments, reason = grow(plan_, layer.others, goal * layer.share, most)
            axes[place] = {name: plan_[name].nodes(segments[name]) for name in plan_}
            left -= _rows(layer, axes[place])
            reasons.append(reason)
        reached = [reason for reason in reasons if reason is not None]
        return axes, ("size" if "size" in reached else "nodes") if reached else None

    def _planned(self, axes: list[dict[str, Floats]], stopped: Stopped) -> Planned:
        blocks = [self._block(*pair) for pair in zip(self.layers, axes, strict=True)]
        gridded = GriddedModel(
            (self.grid.varying, self.model.output_names), blocks, self._known(blocks[0])
        )
        kept = [self.model.input_names.index(name) for name in self.grid.varying]
        measured = self.probes.measure(gridded.outputs(self.probes.inputs[:, kept]))
        if measured.worst_pct <= self.options.tolerance_pct:
            stopped = "tolerance"
        return Planned(gridded, measured, stopped, self.additive)

    def _block(self, layer: Layer, nodes: dict[str, Floats]) -> Block:
        axes = tuple(np.array(nodes.get(name, self.grid.axes[name])) for name in layer.names)
        note = f"what {layer.switch} adds" if layer.switch else "the grid"

        def watch(done: int, total: int) -> None:
            self.options.watch(done, total, note)

        return Block(layer.columns, axes, nine_digits(sample(layer, axes, watch)))

    def _known(self, block: Block) -> NDArray[np.bool_]:
        """Whether the model holds at each node of the first block."""
        base = self.layers[0]

        def inside(points: Floats) -> Floats:
            return self.model.inside(base.embedded(points))[:, None].astype(np.float64)

        known: NDArray[np.bool_] = sample(inside, block.axes)[..., 0] > 0.0
        return known


def _rows(layer: Layer, nodes: dict[str, Floats]) -> int:
    lengths = [len(nodes.get(name, layer.grid.axes[name])) for name in layer.names]
    return int(np.prod(lengths, dtype=np.int64))
