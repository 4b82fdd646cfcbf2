"""A model sampled on grids: what an exported table or FMU computes, in Python.

One full grid over all inputs, or a sum of grids: one over the inputs that act together, and
for every switch whose effect merely adds a grid of its own, which holds what the switch
changes. The twin of the C code in an FMU.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from narxcal.errors import ModelError
from narxcal.multilinear import Multilinear
from narxcal.steady_state import Envelope, Floats, SteadyStateModel, at_known, checked_inputs

# Sampled so many at a time: a model may need much more memory than its inputs.
_CHUNK = 20_000

Function = Callable[[Floats], Floats]


@dataclass(frozen=True, eq=False)
class Block:
    """`values` (nodes of each axis..., n_out) over the inputs `columns`, rising `axes`."""

    columns: tuple[int, ...]
    axes: tuple[Floats, ...]
    values: Floats

    @property
    def rows(self) -> int:
        """How many conditions the block holds."""
        return int(np.prod([len(axis) for axis in self.axes], dtype=np.int64))

    def interpolant(self) -> Multilinear:
        """Multilinear interpolation over the block's own columns."""
        return Multilinear.of(self.axes, self.values)


class GriddedModel:
    """Sum of `blocks`; `known` says at which nodes of the first one the model holds.

    A sample is inside where no input was held at an end and all nodes it depends on hold.
    """

    def __init__(
        self,
        names: tuple[Sequence[str], Sequence[str]],
        blocks: Sequence[Block],
        known: NDArray[np.bool_],
    ) -> None:
        self.input_names, self.output_names = (tuple(part) for part in names)
        self.blocks, self.known = tuple(blocks), known
        self._interpolants = [block.interpolant() for block in blocks]
        first = self.blocks[0]
        self._unknown = Multilinear.of(first.axes, (~known[..., None]).astype(np.float64))
        ends = [self._ends(column) for column in range(len(self.input_names))]
        self.envelope = Envelope(*np.array(ends).T)

    def _ends(self, column: int) -> tuple[float, float]:
        block = next(block for block in self.blocks if column in block.columns)
        axis = block.axes[block.columns.index(column)]
        return float(axis[0]), float(axis[-1])

    @property
    def rows(self) -> int:
        """How many conditions are stored."""
        return sum(block.rows for block in self.blocks)

    def outputs(self, inputs: ArrayLike) -> Floats:
        """Settled outputs `(..., n_out)` at `inputs` `(..., n_in)`; NaN where an input is."""
        array = checked_inputs(inputs, self.input_names)
        return at_known(self._added, array, len(self.output_names))

    def _added(self, inputs: Floats) -> Floats:
        total = np.zeros((len(inputs), len(self.output_names)))
        for interpolate, block in zip(self._interpolants, self.blocks, strict=True):
            total += interpolate(inputs[:, block.columns])
        return total

    def inside(self, inputs: ArrayLike) -> NDArray[np.bool_]:
        """Whether each sample lies between nodes at which the model holds: `(...,)`."""
        array = checked_inputs(inputs, self.input_names)
        flat = array.reshape(-1, len(self.input_names))
        result = self.envelope.inside(flat)
        unknown = self._unknown(flat[result][:, self.blocks[0].columns])[:, 0]
        result[result] = unknown == 0.0
        return result.reshape(array.shape[:-1])


def sample(
    function: Function, axes: Sequence[Floats], watch: Callable[[int, int], None] | None = None
) -> Floats:
    """Values (nodes of each axis..., n_out) of `function` `(n, axes) -> (n, n_out)` on a grid."""
    shape = tuple(len(axis) for axis in axes)
    count = int(np.prod(shape, dtype=np.int64))
    parts = []
    for start in range(0, count, _CHUNK):
        places = np.unravel_index(np.arange(start, min(start + _CHUNK, count)), shape)
        points = [axis[place] for axis, place in zip(axes, places, strict=True)]
        parts.append(function(np.column_stack(points)))
        if watch is not None:
            watch(min(start + _CHUNK, count), count)
    values = np.concatenate(parts)
    return values.reshape(*shape, values.shape[-1])


def settled(model: SteadyStateModel, inputs: Floats) -> Floats:
    """Outputs of `model` (n, n_out); raises `ModelError` where they are no numbers."""
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


def nine_digits(values: Floats) -> Floats:
    """Each number as it comes back from text of nine significant digits.

    That is far more than any engine is known to, and half the size of all digits.
    """
    flat = [float(f"{value:.9g}") for value in values.ravel().tolist()]
    return np.array(flat).reshape(values.shape)
