"""A steady-state model given as a table: the black box an aircraft maker hands over.

A full grid is interpolated multilinearly (or, along its first input, by a monotone cubic);
scattered points linearly over a Delaunay triangulation (scipy.spatial, Qhull).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Protocol, Self, get_args

import numpy as np
from scipy.interpolate import LinearNDInterpolator, PchipInterpolator
from scipy.spatial import ConvexHull, QhullError

from narxcal.errors import ConfigError, DataError
from narxcal.multilinear import Multilinear
from narxcal.steady_options import Method
from narxcal.steady_state import (
    Arrays,
    Envelope,
    Floats,
    at_known,
    checked_inputs,
    register_steady,
    stored,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import ArrayLike, NDArray

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
