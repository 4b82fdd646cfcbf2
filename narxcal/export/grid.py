"""The grid of an export: which range and nodes each input has, and a model sampled on grids."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from narxcal.channels import described, is_switch
from narxcal.steady.model import (
    Envelope,
    SteadyStateModel,
    at_known,
    checked_inputs,
    envelope_of,
)
from narxcal.steady.table import Multilinear, SteadyTable
from narxcal.support.arrays import BoolArray, FloatArray
from narxcal.support.errors import ConfigError, ModelError
from narxcal.support.progress import Progress, silent

# Ranges where neither the user nor the model gives any: the envelope of a business jet.
USUAL_RANGES = {
    "TRA_deg": (0.0, 85.0),
    "ALT_ft": (0.0, 43000.0),
    "Mach": (0.0, 0.8),
    "dT_C": (-30.0, 35.0),
}


@dataclass(frozen=True)
class Grid:
    """Nodes per input, in the order of the model's inputs.

    A switch has the nodes 0 and 1. An input of one node is fixed there and not exported. Raises
    `ConfigError` for nodes that do not increase or are not finite.
    """

    axes: Mapping[str, tuple[float, ...]]

    def __post_init__(self) -> None:
        for name, nodes in self.axes.items():
            if not nodes:
                raise ConfigError("an axis needs at least one node, got none", channel=name)
            rising = all(low < high for low, high in pairwise(nodes))
            if not (rising and all(map(math.isfinite, nodes))):
                shown = ", ".join(f"{node:g}" for node in nodes)
                raise ConfigError(f"nodes have to increase, got {shown}", channel=name)
        if self.axes and not self.varying:
            raise ConfigError(
                "every input is fixed, so nothing is left to tabulate",
                hint="Give at least one input two nodes",
            )

    @classmethod
    def of_model(
        cls, model: SteadyStateModel, nodes: Mapping[str, Sequence[float]] | None = None
    ) -> Self:
        """Take `nodes` where they are given and the ends of the model's envelope elsewhere.

        A gridded table keeps all its own nodes.
        """
        given = dict(nodes or {})
        for name in given:
            if name not in model.input_names:
                raise ConfigError(
                    f"'{name}' is no input of the model",
                    hint=f"Inputs are {', '.join(model.input_names)}",
                )
        if isinstance(model, SteadyTable) and model.gridded and model.method == "linear":
            columns = zip(model.input_names, model.points.T, strict=True)
            given = {name: np.unique(column).tolist() for name, column in columns} | given
        ends = zip(model.input_names, *_ends(model), strict=True)
        return cls({name: tuple(given.get(name) or sorted({*both})) for name, *both in ends})

    @property
    def varying(self) -> tuple[str, ...]:
        return tuple(name for name, nodes in self.axes.items() if len(nodes) > 1)

    @property
    def fixed(self) -> dict[str, float]:
        return {name: nodes[0] for name, nodes in self.axes.items() if len(nodes) == 1}

    @property
    def rows(self) -> int:
        return math.prod(len(nodes) for nodes in self.axes.values())

    def draw(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Draw conditions `(count, n_in)`: switches at 0 or 1, the others between the ends."""
        columns = [
            rng.choice(np.array(nodes), count)
            if is_switch(name) or len(nodes) == 1
            else rng.uniform(nodes[0], nodes[-1], count)
            for name, nodes in self.axes.items()
        ]
        return np.column_stack(columns)


def _ends(model: SteadyStateModel) -> tuple[list[float], list[float]]:
    usual = [
        USUAL_RANGES.get(name, (described(name).low, described(name).high))
        for name in model.input_names
    ]
    box, (low, high) = envelope_of(model), np.array(usual).T
    found = (
        np.where(np.isfinite(box.low), box.low, low),
        np.where(np.isfinite(box.high), box.high, high),
    )
    return found[0].tolist(), found[1].tolist()


# Conditions per call: a model may need much more memory than its inputs.
_CHUNK = 20_000

Function = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, eq=False)
class Block:
    """`values` (nodes of each axis..., n_out) over the inputs `columns` with ascending `axes`."""

    columns: tuple[int, ...]
    axes: tuple[FloatArray, ...]
    values: FloatArray

    @property
    def rows(self) -> int:
        return int(np.prod([len(axis) for axis in self.axes], dtype=np.int64))

    def interpolant(self) -> Multilinear:
        return Multilinear.of(self.axes, self.values)


class GriddedModel:
    """A model sampled on grids: the sum of `blocks`. The C code of an FMU computes the same.

    `known` marks the nodes of the first block at which the model is valid. A sample is inside where
    no input is clamped and all nodes that it depends on are valid.
    """

    def __init__(
        self,
        names: tuple[Sequence[str], Sequence[str]],
        blocks: Sequence[Block],
        known: BoolArray,
    ) -> None:
        self.input_names, self.output_names = (tuple(part) for part in names)
        self.blocks, self.known = tuple(blocks), known
        self._interpolants = [block.interpolant() for block in blocks]
        first = self.blocks[0]
        self._unknown = Multilinear.of(first.axes, (~known[..., None]).astype(np.float64))
        ends = [self._ends(column) for column in range(len(self.input_names))]
        self.envelope = Envelope(*np.array(ends).T)

    def _ends(self, column: int) -> tuple[float, float]:
        block = next((block for block in self.blocks if column in block.columns), None)
        if block is None:  # an input on which nothing depends
            return -math.inf, math.inf
        axis = block.axes[block.columns.index(column)]
        return float(axis[0]), float(axis[-1])

    def over(self, names: Sequence[str]) -> GriddedModel:
        """The same model as one of more inputs, on which it does not depend."""
        places = [list(names).index(name) for name in self.input_names]
        blocks = [
            Block(tuple(places[column] for column in block.columns), block.axes, block.values)
            for block in self.blocks
        ]
        return GriddedModel((names, self.output_names), blocks, self.known)

    @property
    def rows(self) -> int:
        return sum(block.rows for block in self.blocks)

    def outputs(self, inputs: ArrayLike) -> FloatArray:
        """Steady outputs `(..., n_out)` at `inputs` `(..., n_in)`; NaN where an input is NaN."""
        array = checked_inputs(inputs, self.input_names)
        return at_known(self._added, array, len(self.output_names))

    def _added(self, inputs: FloatArray) -> FloatArray:
        total = np.zeros((len(inputs), len(self.output_names)))
        for interpolate, block in zip(self._interpolants, self.blocks, strict=True):
            total += interpolate(inputs[:, block.columns])
        return total

    def inside(self, inputs: ArrayLike) -> BoolArray:
        """Whether each sample lies between nodes at which the model is valid: `(...,)`."""
        array = checked_inputs(inputs, self.input_names)
        flat = array.reshape(-1, len(self.input_names))
        result = self.envelope.inside(flat)
        unknown = self._unknown(flat[result][:, self.blocks[0].columns])[:, 0]
        result[result] = unknown == 0.0
        return result.reshape(array.shape[:-1])


def sample(
    function: Function, axes: Sequence[FloatArray], progress: Progress = silent
) -> FloatArray:
    """Sample `function` `(n, axes) -> (n, n_out)` on a grid: (nodes of each axis..., n_out)."""
    shape = tuple(len(axis) for axis in axes)
    count = int(np.prod(shape, dtype=np.int64))
    parts = []
    for start in range(0, count, _CHUNK):
        places = np.unravel_index(np.arange(start, min(start + _CHUNK, count)), shape)
        points = [axis[place] for axis, place in zip(axes, places, strict=True)]
        parts.append(function(np.column_stack(points)))
        progress(min(start + _CHUNK, count), count)
    values = np.concatenate(parts)
    return values.reshape(*shape, values.shape[-1])


def finite_outputs(model: SteadyStateModel, inputs: FloatArray) -> FloatArray:
    """Outputs of `model` (n, n_out); raises `ModelError` where one is not finite."""
    found = np.asarray(model.outputs(inputs), dtype=np.float64)
    bad = ~np.isfinite(found)
    if bad.any():
        row, column = np.argwhere(bad)[0]
        pairs = zip(model.input_names, inputs[row], strict=True)
        at = ", ".join(f"{name} {value:g}" for name, value in pairs)
        raise ModelError(
            f"the model gives no number at {at}",
            channel=model.output_names[column],
            hint="Choose nodes that leave such conditions out",
        )
    return found


def nine_digits(values: FloatArray) -> FloatArray:
    """Round to nine significant digits, as a text of them is read back."""
    flat = [float(f"{value:.9g}") for value in values.ravel().tolist()]
    return np.array(flat).reshape(values.shape)


def rounded(values: FloatArray, most: FloatArray) -> FloatArray:
    """Round (..., n_out) to powers of two, by at most `most` (n_out,).

    Numbers that end in zeros are packed to half the size, and float32 holds them exactly.
    """
    step = 2.0 ** np.floor(np.log2(2.0 * most))
    found: FloatArray = np.round(values / step) * step
    return found
