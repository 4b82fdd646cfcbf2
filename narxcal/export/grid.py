"""The nodes between which an exported table interpolates, and where they come from.

A model sampled on grids: what an exported table or FMU computes, in Python.

One full grid over all inputs, or a sum of grids: one over the inputs that act together, and
for every switch whose effect merely adds a grid of its own, which holds what the switch
changes. The twin of the C code in an FMU.

What the grids of an export hold: the model over some inputs, and what single switches add.

With every switch in one grid, five switches make it 32 times as large. Most switches only
shift the outputs a little, by an amount that depends smoothly on the rest, so that

    f(c, s) ~ f(c, k, 0) + sum over additive switches i of  s_i (f(c, k, e_i) - f(c, k, 0))

with c the continuous inputs and k the switches that act together. Each sum needs coarse nodes
only. Which switches may be taken out of k is measured, not assumed.

How far a steady-state model holds along each of its inputs.

The best nodes of one axis: those that leave the smallest error of linear interpolation.

A curve sampled at `M` candidates is to be read off by straight lines between `n` of them. The
worst error is that of the worst segment, so the best choice follows from a shortest path over
segments (dynamic programming; Bellman 1961, Communications of the ACM 4(6), on the
approximation of curves by line segments).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal, Self

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from narxcal.channels import CHANNELS, channel
from narxcal.steady.fitted import FittedSteadyState
from narxcal.steady.model import Envelope, Floats, SteadyStateModel, at_known, checked_inputs
from narxcal.steady.table import Multilinear, SteadyTable
from narxcal.support.errors import ConfigError, ModelError

# What is sampled where neither the user nor the model says how far it holds: the envelope of
# a business jet.
USUAL_RANGES = {
    "TRA_deg": (0.0, 85.0),
    "ALT_ft": (0.0, 43000.0),
    "Mach": (0.0, 0.8),
    "dT_C": (-30.0, 35.0),
}
_RANGE_DRAWS, _STARTS, _HALVINGS = 4096, 64, 80

Range = tuple[float, float]


def model_ranges(
    model: SteadyStateModel, nodes: Mapping[str, Sequence[float]]
) -> dict[str, tuple[float, float]]:
    """Ends of each input: those of `nodes`, else of the model's envelope, else the usual ones.

    A model that is no table is asked: from random conditions inside, each input is moved until
    `inside` says that the envelope ends. Raises `ModelError` where no condition is inside and
    `ConfigError` for an input that is no channel.
    """
    widest = {name: (channel(name).low, channel(name).high) for name in model.input_names}
    given = {name: (float(ends[0]), float(ends[-1])) for name, ends in nodes.items()}
    box = _known_box(model)
    if box is not None:
        return {**box, **given}
    usual = {name: USUAL_RANGES.get(name, widest[name]) for name in model.input_names} | given
    inside = _inside(model, usual)
    if not len(inside):
        inside = _inside(model, widest | given)
    if not len(inside):
        raise ModelError(
            "the model says that it holds nowhere in the range tried",
            hint="Give the ends of its inputs as nodes",
        )
    for name in usual.keys() - given.keys():
        reach = _reach(model, inside, name, widest[name])
        # What reaches every bound of the channel has none of its own.
        usual[name] = usual[name] if reach == widest[name] else reach
    return usual


def _known_box(model: SteadyStateModel) -> dict[str, Range] | None:
    if isinstance(model, SteadyTable):
        box = Envelope.of(model.points)
    elif isinstance(model, FittedSteadyState):
        box = model.envelope
    else:
        return None
    pairs = zip(box.low.tolist(), box.high.tolist(), strict=True)
    return dict(zip(model.input_names, pairs, strict=True))


def _inside(model: SteadyStateModel, ranges: Mapping[str, Range]) -> Floats:
    """Up to 64 random conditions, (n, n_in), that the model calls inside."""
    rng = np.random.default_rng(0)
    low, high = np.array(list(ranges.values())).T
    share = rng.uniform(size=(_RANGE_DRAWS, len(low)))
    switch = [channel(name).role == "switch" for name in ranges]
    share[:, switch] = np.round(share[:, switch])
    drawn = low + share * (high - low)
    found: Floats = drawn[model.inside(drawn)][:_STARTS]
    return found


def _reach(model: SteadyStateModel, inside: Floats, name: str, widest: Range) -> Range:
    column = model.input_names.index(name)
    low, high = (_farthest(model, inside, column, end) for end in widest)
    return float(low.min()), float(high.max())


def _farthest(model: SteadyStateModel, inside: Floats, column: int, end: float) -> Floats:
    """Bisect from each condition towards `end`: the last value still inside, (n,)."""
    near, probe = inside[:, column].copy(), inside.copy()
    far = np.full_like(near, end)
    probe[:, column] = far
    near = np.where(model.inside(probe), far, near)
    for _ in range(_HALVINGS):
        middle = 0.5 * (near + far)
        probe[:, column] = middle
        held = model.inside(probe)
        near, far = np.where(held, middle, near), np.where(held, far, middle)
    # An end at zero is never quite met by halving.
    probe[:, column] = round_ = np.round(near, 9)
    return np.where(model.inside(probe), round_, near)


@dataclass(frozen=True)
class Grid:
    """Nodes per input, in the order of the model's inputs.

    A switch has the nodes 0 and 1. An input of one node is fixed there and left out of what
    is exported. Raises `ConfigError` for nodes that do not increase or are no numbers.
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

        A gridded table has all its own nodes, so that it is exported as it is.

        Raises `ConfigError` for nodes of what is no input or outside the envelope, and
        `ModelError` where the model has no envelope to be found.
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
        found = model_ranges(model, given)
        axes = {name: tuple(given.get(name) or _ends(name, found)) for name in model.input_names}
        return cls(axes)

    @property
    def varying(self) -> tuple[str, ...]:
        """Inputs that the exported table has."""
        return tuple(name for name, nodes in self.axes.items() if len(nodes) > 1)

    @property
    def fixed(self) -> dict[str, float]:
        """Inputs held at one value."""
        return {name: nodes[0] for name, nodes in self.axes.items() if len(nodes) == 1}

    @property
    def rows(self) -> int:
        """How many conditions the full grid has."""
        return math.prod(len(nodes) for nodes in self.axes.values())

    def draw(self, count: int, rng: np.random.Generator) -> Floats:
        """Random conditions `(count, n_in)`: switches at 0 or 1, the others between the ends."""
        columns = [
            rng.choice(np.array(nodes), count)
            if is_switch(name) or len(nodes) == 1
            else rng.uniform(nodes[0], nodes[-1], count)
            for name, nodes in self.axes.items()
        ]
        return np.column_stack(columns)


def is_switch(name: str) -> bool:
    """Whether a channel knows only 0 and 1."""
    return name in CHANNELS and CHANNELS[name].role == "switch"


def candidates(nodes: Sequence[float], most: int) -> Floats:
    """`nodes` and round numbers between them, at most about `most`, where nodes may be added."""
    low, high = nodes[0], nodes[-1]
    step = _round_up((high - low) / most)
    between = step * np.arange(math.ceil(low / step), math.floor(high / step) + 1)
    # Multiples of 0.01 as they are written, not as 7 * 0.01 comes out.
    between = np.array([float(f"{value:.9g}") for value in between])
    apart = np.abs(between[:, None] - np.array(nodes)).min(axis=1) > 0.3 * step
    return np.union1d(np.array(nodes), between[apart])


def _round_up(step: float) -> float:
    power = 10.0 ** math.floor(math.log10(step))
    return next(m * power for m in (1.0, 2.0, 2.5, 5.0, 10.0) if m * power >= step * (1.0 - 1e-9))


def _ends(name: str, found: Mapping[str, tuple[float, float]]) -> tuple[float, ...]:
    low, high = found[name]
    return (low, high) if low < high else (low,)


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


_MOST = 64


@dataclass(frozen=True, eq=False)
class AxisNodes:
    """Best nodes of an axis for each number of them.

    `errors[k]` is the worst error with `k` segments (infinite where the nodes asked for do
    not allow it), `before[k, j]` the node before candidate `j` on the best way to it.
    """

    candidates: Floats
    errors: Floats
    before: NDArray[np.int64]

    @property
    def fewest(self) -> int:
        """The smallest number of segments that holds all nodes asked for."""
        return int(np.flatnonzero(np.isfinite(self.errors))[0])

    def finer(self, segments: int) -> int | None:
        """The next number of segments with a smaller error, None where there is none."""
        better = np.flatnonzero(self.errors[segments:] < self.errors[segments] * (1.0 - 1e-9))
        return segments + int(better[0]) if len(better) else None

    def nodes(self, segments: int) -> Floats:
        """The best nodes for `segments`: `(segments + 1,)`."""
        place = len(self.candidates) - 1
        path = [place]
        for count in range(segments, 0, -1):
            place = int(self.before[count, place])
            path.append(place)
        return self.candidates[path[::-1]]


def best_nodes(candidates: Floats, values: Floats, asked: Sequence[float]) -> AxisNodes:
    """Plan an axis from curves `values` (M, curves) at `candidates` (M,).

    The nodes `asked` for are always among the chosen.
    """
    error = segment_errors(candidates, values)
    for place in np.flatnonzero(np.isin(candidates, asked)):
        error[:place, place + 1 :] = np.inf
    count = min(len(candidates) - 1, _MOST)
    worst = np.full((count + 1, len(candidates)), np.inf)
    before = np.zeros(worst.shape, dtype=np.int64)
    worst[0, 0] = 0.0
    for segments in range(1, count + 1):
        through = np.maximum(worst[segments - 1][:, None], error)
        before[segments] = through.argmin(axis=0)
        worst[segments] = through.min(axis=0)
    return AxisNodes(candidates, worst[:, -1], before)


def segment_errors(candidates: Floats, values: Floats) -> Floats:
    """Worst error (M, M) of the straight line from candidate i to candidate j, inf for j <= i."""
    found: Floats = _run(candidates, np.ascontiguousarray(values))
    return found


def _errors(candidates: Floats, values: Floats) -> Floats:
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


_run: Any = njit(cache=True, nogil=True)(_errors)


def curves(
    function: Callable[[Floats], Floats], others: Floats, column: int, candidates: Floats
) -> Floats:
    """Sample `function` `(n, axes) -> (n, n_out)` along one column: (M, lines * n_out).

    `others` (lines, axes) says where the other inputs stand.
    """
    points = np.repeat(others[None], len(candidates), axis=0)
    points[:, :, column] = candidates[:, None]
    found = function(points.reshape(-1, others.shape[1]))
    return found.reshape(len(candidates), -1)


def grow(
    axes: Mapping[str, AxisNodes], others: int, goal: float, most: int
) -> tuple[dict[str, int], Literal["size", "nodes"] | None]:
    """Refine the axis with the largest error until all errors together are at most `goal`.

    `others` are the rows that the axes not refined multiply by, `most` the rows allowed.
    Returns the segments of each axis and, where the goal was not reached, whether the `size`
    or the lack of further `nodes` was the reason.
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
