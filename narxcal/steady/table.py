"""A steady-state model given as a table: the black box an aircraft maker hands over.

A full grid is interpolated multilinearly (or, along its first input, by a monotone cubic);
scattered points linearly over a Delaunay triangulation (scipy.spatial, Qhull).

Reads the table of a steady-state model from a CSV file.

Compiled multilinear interpolation on a rectilinear grid.

Gives what `scipy.interpolate.RegularGridInterpolator` gives (its slow twin in the tests), at
less than a tenth of the cost per call, which counts where samples arrive one by one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, Self, get_args

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator, PchipInterpolator
from scipy.spatial import ConvexHull, QhullError

from narxcal.steady.model import (
    Arrays,
    Envelope,
    Floats,
    at_known,
    checked_inputs,
    register_steady,
    stored,
)
from narxcal.steady.options import Method
from narxcal.support.errors import ConfigError, DataError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import ArrayLike, NDArray
import csv
import gzip
from pathlib import Path
from typing import TYPE_CHECKING

from narxcal.channels import channel

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from os import PathLike


Integers = NDArray[np.int64]


@dataclass(frozen=True)
class Multilinear:
    """`nodes` are the axes one after the other, axis `d` starting at `starts[d]`.

    `values` (cells, n_out) holds the grid flattened in C order, `strides` what one step along
    an axis adds to the row.
    """

    nodes: Floats
    starts: Integers
    values: Floats
    strides: Integers

    @classmethod
    def of(cls, axes: Sequence[Floats], values: Floats) -> Self:
        """Prepare increasing `axes` and `values` of shape (len(axis) for each axis, n_out)."""
        lengths = [len(axis) for axis in axes]
        strides = np.cumprod([1, *reversed(lengths[1:])])[::-1]
        return cls(
            np.concatenate(axes),
            np.cumsum([0, *lengths], dtype=np.int64),
            np.ascontiguousarray(values.reshape(-1, values.shape[-1])),
            np.ascontiguousarray(strides, dtype=np.int64),
        )

    def __call__(self, inputs: Floats) -> Floats:
        """Values (n, n_out) at `inputs` (n, n_in), each held at the end of its axis."""
        given = np.ascontiguousarray(inputs)
        result: Floats = _run(self.nodes, self.starts, self.values, self.strides, given)
        return result


def _interpolate(
    nodes: Floats, starts: Integers, values: Floats, strides: Integers, inputs: Floats
) -> Floats:
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


_run: Any = njit(cache=True, nogil=True)(_interpolate)


_REFINE = 16
_CHUNK = 4096


class _Interpolant(Protocol):
    """Evaluates `(n, n_in)` finite inputs inside or outside the envelope."""

    def values(self, inputs: Floats) -> Floats: ...

    def inside(self, inputs: Floats) -> NDArray[np.bool_]: ...


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
        names: tuple[Sequence[str], Sequence[str]],
        points: ArrayLike,
        values: ArrayLike,
        method: Method = "linear",
    ) -> None:
        self.input_names, self.output_names = (tuple(part) for part in names)
        self.method = method
        self.points = np.array(points, dtype=np.float64)
        self.values = np.array(values, dtype=np.float64)
        self._check()
        axes = _grid_axes(self.points)
        self.gridded = axes is not None
        self._interpolant: _Interpolant = (
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
            raise DataError("the table holds values that are not finite", hint="Leave them out")
        for name, column in zip(self.input_names, self.points.T, strict=True):
            if len(np.unique(column)) < 2:
                raise DataError(
                    "the table needs at least two values of each input",
                    channel=name,
                    hint="Leave an input out that does not vary",
                )
        if len(np.unique(self.points, axis=0)) != rows:
            raise DataError("the table holds the same conditions twice", hint="Keep one row each")
        if self.method == "pchip" and _grid_axes(self.points) is None:
            raise ConfigError(
                "method 'pchip' needs a full grid, and the table is scattered",
                hint="Fill the grid, or use 'linear'",
            )

    def outputs(self, inputs: ArrayLike) -> Floats:
        """Settled outputs `(..., n_out)` at `inputs` `(..., n_in)`; NaN where an input is."""
        array = checked_inputs(inputs, self.input_names)
        return at_known(self._interpolant.values, array, len(self.output_names))

    def inside(self, inputs: ArrayLike) -> NDArray[np.bool_]:
        """Whether each sample lies in the grid's box or the points' convex hull: `(...,)`."""
        array = checked_inputs(inputs, self.input_names)
        flat = array.reshape(-1, len(self.input_names))
        result = np.asarray(np.isfinite(flat).all(axis=1))
        result[result] = self._interpolant.inside(flat[result])
        return result.reshape(array.shape[:-1])

    def to_arrays(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Names and method; `points` and `values`."""
        meta = {
            "input_names": list(self.input_names),
            "output_names": list(self.output_names),
            "method": self.method,
        }
        return meta, {"points": self.points, "values": self.values}

    @classmethod
    def from_arrays(cls, meta: Mapping[str, Any], arrays: Arrays) -> Self:
        """Rebuild a stored table."""
        what = "steady-state table"
        names = (stored(meta, "input_names", what), stored(meta, "output_names", what))
        points, values = stored(arrays, "points", what), stored(arrays, "values", what)
        return cls(names, points, values, stored(meta, "method", what))


class _Grid:
    def __init__(self, axes: list[Floats], values: Floats, method: Method) -> None:
        self._box = Envelope(
            np.array([axis[0] for axis in axes]), np.array([axis[-1] for axis in axes])
        )
        if method == "pchip":
            fine = _refined(axes[0])
            values = PchipInterpolator(axes[0], values, axis=0)(fine)
            axes = [fine, *axes[1:]]
        self._interpolate = Multilinear.of(axes, values)

    def values(self, inputs: Floats) -> Floats:
        return self._interpolate(inputs)

    def inside(self, inputs: Floats) -> NDArray[np.bool_]:
        return self._box.inside(inputs)


class _Scatter:
    """Linear on simplices, in inputs scaled to their range so that units do not matter."""

    def __init__(self, points: Floats, values: Floats) -> None:
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

    def values(self, inputs: Floats) -> Floats:
        chunks = np.array_split(inputs, max(1, -(-len(inputs) // _CHUNK)))
        return np.concatenate([self._chunk(chunk) for chunk in chunks])

    def _chunk(self, inputs: Floats) -> Floats:
        ray = (inputs - self._low) / self._range - self._centre
        # A facet at distance `depth` from the centre is met after depth / (n . ray) of the ray.
        ratio = (ray @ self._normals.T) / self._depth
        reach = np.maximum(ratio.max(axis=1, initial=0.0), 1.0)[:, None]
        result = np.asarray(self._interpolate(self._centre + ray / reach), dtype=np.float64)
        # Rounding can leave a point on the hull a hair outside all simplices.
        lost = np.isnan(result).any(axis=1)
        if lost.any():
            pulled = self._centre + ray[lost] / reach[lost] * (1.0 - 1e-9)
            result[lost] = self._interpolate(pulled)
        return result

    def inside(self, inputs: Floats) -> NDArray[np.bool_]:
        scaled = (inputs - self._low) / self._range
        held: NDArray[np.bool_] = (scaled @ self._normals.T + self._offsets <= 1e-9).all(axis=1)
        return held


def _grid_axes(points: Floats) -> list[Floats] | None:
    """Sorted values of each input if the (distinct) points fill the whole grid, else None."""
    axes = [np.unique(column) for column in points.T]
    full = int(np.prod([len(axis) for axis in axes], dtype=np.int64)) == len(points)
    return axes if full else None


def _on_grid(points: Floats, values: Floats, axes: list[Floats]) -> Floats:
    places = tuple(
        np.searchsorted(axis, column) for axis, column in zip(axes, points.T, strict=True)
    )
    grid = np.empty((*(len(axis) for axis in axes), values.shape[1]))
    grid[places] = values
    return grid


def _refined(axis: Floats) -> Floats:
    """`axis` with further values between, keeping each of its own exactly."""
    share = np.arange(_REFINE) / _REFINE
    between = axis[:-1, None] + np.diff(axis)[:, None] * share
    return np.append(between.ravel(), axis[-1])


_DELIMITERS = (",", ";", "\t")


def read_steady_table(
    path: str | PathLike[str],
    input_names: Sequence[str] | None = None,
    output_names: Sequence[str] | None = None,
    method: Method = "linear",
) -> SteadyTable:
    """Read a CSV (or .csv.gz) whose header holds canonical channels in canonical units.

    Lines that start with `#` are comments. Where the header is separated by `;` or tabs, numbers
    may have decimal commas. By default the channels with the role of an output
    are the outputs and the others the inputs; name them where one is otherwise (fuel flow as
    the driver). Further columns are ignored.

    Raises `DataError` naming file, row (line of the file) and value, and `ConfigError` for a
    name that is no channel.
    """
    file = Path(path)
    header, rows = _read_rows(file)
    outputs = tuple(output_names or _by_role(header, input_names or (), output=True))
    inputs = tuple(input_names or _by_role(header, outputs, output=False))
    for name in (*inputs, *outputs):
        channel(name)
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
    numbers = _numbers(file, rows, {name: header.index(name) for name in (*inputs, *outputs)})
    try:
        return SteadyTable(
            (inputs, outputs), numbers[:, : len(inputs)], numbers[:, len(inputs) :], method
        )
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


def _read_rows(file: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    if not file.is_file():
        raise DataError("the table does not exist", file=file)
    opener = gzip.open if file.suffix == ".gz" else open
    try:
        with opener(file, "rt", encoding="utf-8-sig", newline="") as stream:
            lines = _cells(stream)
    except (OSError, EOFError, UnicodeDecodeError, csv.Error) as error:
        raise DataError(f"the table cannot be read: {error}", file=file) from None
    if len(lines) < 2:
        raise DataError("the table has no rows", file=file)
    return lines[0][1], lines[1:]


def _cells(stream: Iterable[str]) -> list[tuple[int, list[str]]]:
    """Lines with content, each with its number in the file, in points whatever the decimal mark."""
    text = list(stream)
    header = next((line for line in text if line.strip() and not line.startswith("#")), "")
    delimiter = next((each for each in _DELIMITERS if each in header), ",")
    reader = csv.reader(text, delimiter=delimiter)
    return [
        (reader.line_num, [_in_points(cell.strip(), delimiter) for cell in row])
        for row in reader
        if any(row) and not row[0].startswith("#")
    ]


def _in_points(cell: str, delimiter: str) -> str:
    return cell if delimiter == "," else cell.replace(",", ".")


def _numbers(file: Path, rows: list[tuple[int, list[str]]], columns: Mapping[str, int]) -> Floats:
    result = np.empty((len(rows), len(columns)))
    for index, (line, cells) in enumerate(rows):
        for place, (name, column) in enumerate(columns.items()):
            text = cells[column] if column < len(cells) else ""
            result[index, place] = _number(text, file, name, line)
    return result


def _number(text: str, file: Path, name: str, line: int) -> float:
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise DataError(f"expected a number, got '{text}'", file=file, channel=name, row=line)
    return value
