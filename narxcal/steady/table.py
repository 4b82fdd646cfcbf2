"""A steady-state model given as a table: gridded or scattered points, and its CSV file.

A full grid is interpolated multilinearly (or, along its first input, by a monotone cubic);
scattered points linearly over a Delaunay triangulation (scipy.spatial, Qhull). The multilinear
interpolation is compiled: it gives what `scipy.interpolate.RegularGridInterpolator` gives at less
than a tenth of the cost per call, which counts where samples arrive one by one.
"""

from __future__ import annotations

import gzip
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from os import PathLike
from pathlib import Path
from typing import Any, ClassVar, Self, get_args

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import LinearNDInterpolator, PchipInterpolator
from scipy.spatial import ConvexHull, QhullError

from narxcal.channels import CHANNELS, channel
from narxcal.steady.model import (
    Arrays,
    Envelope,
    Method,
    Names,
    at_known,
    checked_inputs,
    register_steady,
    stored,
    stored_names,
)
from narxcal.support.arrays import BoolArray, FloatArray, IntArray
from narxcal.support.compiled import compiled
from narxcal.support.errors import ConfigError, DataError
from narxcal.support.files import is_file

_SUBDIVISIONS = 16  # of each interval of a cubic: its error is below 1/256 of a straight line's
_CHUNK = 4096  # samples evaluated at a time, to bound memory
_LONGEST_LINE = 100_000  # characters, of some thousand columns
_MOST_CHARACTERS = 200_000_000  # of a file: ten million numbers; a small archive may unpack to more


@dataclass(frozen=True)
class Multilinear:
    """Compiled multilinear interpolation on a rectilinear grid.

    `nodes` are the axes one after the other, axis `d` starting at `starts[d]`. `values`
    (points, n_out) is the grid flattened in C order; a step along axis `d` adds `strides[d]` to the
    row.
    """

    nodes: FloatArray
    starts: IntArray
    values: FloatArray
    strides: IntArray

    @classmethod
    def of(cls, axes: Sequence[FloatArray], values: FloatArray) -> Self:
        """Prepare increasing `axes` and `values` of shape (len(axis) for each axis, n_out)."""
        lengths = [len(axis) for axis in axes]
        strides = np.cumprod([1, *reversed(lengths[1:])])[::-1]
        return cls(
            np.concatenate(axes),
            np.cumsum([0, *lengths], dtype=np.int64),
            np.ascontiguousarray(values.reshape(-1, values.shape[-1])),
            np.ascontiguousarray(strides, dtype=np.int64),
        )

    def __call__(self, inputs: FloatArray) -> FloatArray:
        """Values (n, n_out) at `inputs` (n, n_in), each clamped to its axis."""
        given = np.ascontiguousarray(inputs)
        return _interpolate(self.nodes, self.starts, self.values, self.strides, given)


@compiled
def _interpolate(
    nodes: FloatArray, starts: IntArray, values: FloatArray, strides: IntArray, inputs: FloatArray
) -> FloatArray:
    samples, dims = inputs.shape
    outputs = values.shape[1]
    result = np.zeros((samples, outputs))
    share = np.empty(dims)
    for k in range(samples):
        base = 0
        for d in range(dims):
            axis = nodes[starts[d] : starts[d + 1]]
            x = min(max(inputs[k, d], axis[0]), axis[-1])
            cell = min(max(np.searchsorted(axis, x, side="right") - 1, 0), len(axis) - 2)
            share[d] = (x - axis[cell]) / (axis[cell + 1] - axis[cell])
            base += cell * strides[d]
        for corner in range(1 << dims):
            weight, row = 1.0, base
            for d in range(dims):
                if corner >> d & 1:
                    weight *= share[d]
                    row += strides[d]
                else:
                    weight *= 1.0 - share[d]
            if weight > 0.0:
                for o in range(outputs):
                    result[k, o] += weight * values[row, o]
    return result


@register_steady
class SteadyTable:
    """Interpolates `values` `(n, n_out)` known at `points` `(n, n_in)`.

    Exact at the points, and between the smallest and largest value everywhere. Outside, a
    grid is evaluated at the nearest condition in its box; scattered points where the line to
    their centre enters their convex hull (continuous, unlike the nearest point).

    `method="pchip"` (grids only) is a monotone cubic (Fritsch and Butland, 1984) along the
    first input, the driver, sampled finely; the other inputs stay linear, so that a table
    monotone in the driver stays so.

    Raises `DataError` for points that do not span a table and `ConfigError` for a method the
    points do not allow.
    """

    kind: ClassVar[str] = "table"

    def __init__(
        self,
        names: Names,
        points: ArrayLike,
        values: ArrayLike,
        method: Method = "linear",
    ) -> None:
        self.input_names, self.output_names = (tuple(part) for part in names)
        self.method = method
        self.points = np.array(points, dtype=np.float64)
        self.values = np.array(values, dtype=np.float64)
        self._check()
        self.envelope = Envelope.of(self.points)
        axes = _grid_axes(self.points)
        self.gridded = axes is not None
        self._interpolant: _Grid | _Scatter = (
            _Scatter(self.points, self.values)
            if axes is None
            else _Grid(axes, _on_grid(self.points, self.values, axes), method)
        )

    def _check(self) -> None:
        n_in, n_out = len(self.input_names), len(self.output_names)
        rows = len(self.points)
        if self.points.shape != (rows, n_in) or self.values.shape != (rows, n_out):
            raise DataError(
                f"a table of {n_in} inputs and {n_out} outputs needs points (rows, {n_in}) and "
                f"values (rows, {n_out}), got {self.points.shape} and {self.values.shape}"
            )
        if self.method not in get_args(Method):
            raise ConfigError(
                f"unknown table method '{self.method}'", hint="Use 'linear' or 'pchip'"
            )
        if not (np.isfinite(self.points).all() and np.isfinite(self.values).all()):
            raise DataError("the table contains values that are not finite", hint="Leave them out")
        for name, column in zip(self.input_names, self.points.T, strict=True):
            if len(np.unique(column)) < 2:
                raise DataError(
                    "the table needs at least two values of each input",
                    channel=name,
                    hint="Leave an input out that does not vary",
                )
        if len(np.unique(self.points, axis=0)) != rows:
            raise DataError(
                "the table contains the same conditions twice", hint="Keep one row each"
            )
        if self.method == "pchip" and _grid_axes(self.points) is None:
            raise ConfigError(
                "method 'pchip' needs a full grid, and the table is scattered",
                hint="Fill the grid, or use 'linear'",
            )

    @property
    def interpolated(self) -> tuple[tuple[FloatArray, ...], FloatArray] | None:
        """Axes and values (nodes of each axis..., n_out) between which a grid is multilinear.

        None for scattered points.
        """
        return self._interpolant.grid if isinstance(self._interpolant, _Grid) else None

    def outputs(self, inputs: ArrayLike) -> FloatArray:
        """Steady-state outputs `(..., n_out)` at `inputs` `(..., n_in)`; NaN where an input is."""
        array = checked_inputs(inputs, self.input_names)
        return at_known(self._interpolant.values, array, len(self.output_names))

    def inside(self, inputs: ArrayLike) -> BoolArray:
        """Whether each sample lies in the grid's box or the points' convex hull: `(...,)`."""
        array = checked_inputs(inputs, self.input_names)
        flat = array.reshape(-1, len(self.input_names))
        result = np.asarray(np.isfinite(flat).all(axis=1))
        result[result] = self._interpolant.inside(flat[result])
        return result.reshape(array.shape[:-1])

    def to_arrays(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        meta = {
            "input_names": list(self.input_names),
            "output_names": list(self.output_names),
            "method": self.method,
        }
        return meta, {"points": self.points, "values": self.values}

    @classmethod
    def from_arrays(cls, meta: Mapping[str, Any], arrays: Arrays) -> Self:
        what = "steady-state table"
        names = stored_names(meta, what)
        points, values = stored(arrays, "points", what), stored(arrays, "values", what)
        return cls(names, points, values, stored(meta, "method", what))


class _Grid:
    def __init__(self, axes: list[FloatArray], values: FloatArray, method: Method) -> None:
        ends = (np.array([axis[end] for axis in axes]) for end in (0, -1))
        self.inside = Envelope(*ends).inside
        if method == "pchip":
            fine = _refined(axes[0])
            values = PchipInterpolator(axes[0], values, axis=0)(fine)
            axes = [fine, *axes[1:]]
        self.grid = (tuple(axes), values)
        self.values = Multilinear.of(axes, values)


class _Scatter:
    """Linear on simplices, in inputs scaled to their range so that units do not matter."""

    def __init__(self, points: FloatArray, values: FloatArray) -> None:
        self._low = points.min(axis=0)
        self._range = np.ptp(points, axis=0)
        scaled = (points - self._low) / self._range
        try:
            hull = ConvexHull(scaled)
            self._interpolate = LinearNDInterpolator(scaled, values)
        except QhullError:
            raise DataError(
                f"the {len(points)} rows of the table do not span its {points.shape[1]} inputs",
                hint="Add rows in which the inputs vary independently, or drop an input",
            ) from None
        self._normals, self._offsets = hull.equations[:, :-1], hull.equations[:, -1]
        self._centre = scaled.mean(axis=0)
        self._depth = -(self._normals @ self._centre + self._offsets)

    def values(self, inputs: FloatArray) -> FloatArray:
        chunks = np.array_split(inputs, max(1, -(-len(inputs) // _CHUNK)))
        return np.concatenate([self._chunk(chunk) for chunk in chunks])

    def _chunk(self, inputs: FloatArray) -> FloatArray:
        ray = (inputs - self._low) / self._range - self._centre
        # A facet at distance `depth` from the centre is met after depth / (n . ray) of the ray.
        ratio = (ray @ self._normals.T) / self._depth
        reach = np.maximum(ratio.max(axis=1, initial=0.0), 1.0)[:, None]
        result = np.asarray(self._interpolate(self._centre + ray / reach), dtype=np.float64)
        # Rounding can leave a point on the hull just outside all simplices.
        lost = np.isnan(result).any(axis=1)
        if lost.any():
            pulled = self._centre + ray[lost] / reach[lost] * (1.0 - 1e-9)
            result[lost] = self._interpolate(pulled)
        return result

    def inside(self, inputs: FloatArray) -> BoolArray:
        scaled = (inputs - self._low) / self._range
        return np.asarray((scaled @ self._normals.T + self._offsets <= 1e-9).all(axis=1))


def _grid_axes(points: FloatArray) -> list[FloatArray] | None:
    """Sorted values of each input if the (distinct) points fill the whole grid, else None."""
    axes = [np.unique(column) for column in points.T]
    full = int(np.prod([len(axis) for axis in axes], dtype=np.int64)) == len(points)
    return axes if full else None


def _on_grid(points: FloatArray, values: FloatArray, axes: list[FloatArray]) -> FloatArray:
    places = tuple(
        np.searchsorted(axis, column) for axis, column in zip(axes, points.T, strict=True)
    )
    grid = np.empty((*(len(axis) for axis in axes), values.shape[1]))
    grid[places] = values
    return grid


def _refined(axis: FloatArray) -> FloatArray:
    """`axis` with further nodes in each interval, its own kept exactly."""
    share = np.arange(_SUBDIVISIONS) / _SUBDIVISIONS
    between = axis[:-1, None] + np.diff(axis)[:, None] * share
    return np.append(between.ravel(), axis[-1])


def read_steady_table(
    path: str | PathLike[str],
    input_names: Sequence[str] | None = None,
    output_names: Sequence[str] | None = None,
    method: Method = "linear",
) -> SteadyTable:
    """Read a CSV (or .csv.gz) whose header names canonical channels in canonical units.

    Lines that start with `#` are comments. Where the header is separated by `;` or tabs, numbers
    may have decimal commas. By default the channels with the role of an output are the outputs and
    the others the inputs; name them where one is otherwise (fuel flow as the driver). Further
    columns are ignored.
    """
    file = Path(path)
    cells = _read_cells(file)
    header = list(cells.columns)
    if not any(name in CHANNELS for name in header):  # what it is instead is nobody's business
        raise DataError(
            "the file is no table of a steady-state model: no column is a channel",
            file=file,
            hint="Its header names channels, such as TRA_deg, ALT_ft, N1_pct",
        )
    outputs = tuple(output_names or _by_role(header, input_names or (), output=True))
    inputs = tuple(input_names or _by_role(header, outputs, output=False))
    for name in (*inputs, *outputs):
        if name not in header:
            raise DataError(
                "the table lacks this column",
                file=file,
                channel=name,
                hint=f"Columns found: {', '.join(header)}",
            )
    if not inputs or not outputs:
        raise DataError(
            f"the table needs input and output columns, got inputs {list(inputs)} and outputs "
            f"{list(outputs)}",
            file=file,
        )
    points, values = (
        np.column_stack([_numbers(cells[name], file) for name in names])
        for names in (inputs, outputs)
    )
    try:
        return SteadyTable((inputs, outputs), points, values, method)
    except DataError as error:
        raise DataError(error.problem, file=file, channel=error.channel, hint=error.hint) from None


def _by_role(header: Sequence[str], taken: Sequence[str], *, output: bool) -> list[str]:
    return [
        name
        for name in header
        if name not in taken
        and channel(name).role != "time"
        and (channel(name).role == "output") == output
    ]


def _read_cells(file: Path) -> pd.DataFrame:
    """Columns as numbers, or as text where a cell is none; the index is the line of the file."""
    if not is_file(file):
        raise DataError("the table does not exist", file=file)
    try:
        lines = {n: line for n, line in _lines(file) if not line.startswith("#")}
        if len(lines) < 2:
            raise DataError("the table has no rows", file=file)
        header = next(iter(lines.values()))
        separator = next((each for each in ",;\t" if each in header), ",")
        decimal = "." if separator == "," else ","
        text = "".join(lines.values())
        if decimal == ",":
            text = text.replace(",", ".")
        cells = pd.read_csv(
            StringIO(text), sep=separator, keep_default_na=False, skipinitialspace=True
        )
    except (OSError, EOFError, ValueError, zlib.error) as error:  # ValueError also of pandas
        raise DataError(f"the table cannot be read: {error}", file=file) from None
    if not isinstance(cells.index, pd.RangeIndex) or len(cells) != len(lines) - 1:
        raise DataError("the rows have more cells than the header", file=file)
    cells.index = pd.Index(list(lines)[1:])
    return cells.rename(columns=str.strip)


def _lines(file: Path) -> Iterator[tuple[int, str]]:
    """Lines with content and their numbers; raises `DataError` where they are too many."""
    opener = gzip.open if file.suffix == ".gz" else open
    with opener(file, "rt", encoding="utf-8-sig") as stream:
        number, left = 0, _MOST_CHARACTERS
        while line := stream.readline(_LONGEST_LINE + 1):
            number, left = number + 1, left - len(line)
            if left < 0 or len(line) > _LONGEST_LINE:
                raise DataError(
                    f"the table has a line of more than {_LONGEST_LINE} characters, "
                    f"or more than {_MOST_CHARACTERS // 10**6} million in all",
                    file=file,
                    hint="Thin out its nodes",
                )
            if line.strip(" ,;\t\r\n"):
                yield number, line


def _numbers(column: pd.Series[Any], file: Path) -> FloatArray:
    numbers = np.asarray(pd.to_numeric(column, errors="coerce"), dtype=np.float64)
    bad = np.flatnonzero(~np.isfinite(numbers))
    if len(bad):
        cell = column.iloc[bad[0]]
        raise DataError(
            f"expected a number, got '{'' if pd.isna(cell) else str(cell).strip()}'",
            file=file,
            channel=str(column.name),
            row=int(column.index[bad[0]]),
        )
    return numbers
