"""Black-box models that are linear in their coefficients, and the correction of any other model.

    y(x) = sum over (i, j, ...) of c_ij.. b_i(x_1) b_j(x_2) ...

One basis per column: Chebyshev polynomials on [-1, 1] (`Chebyshev`, orthogonal, so that degree 5
stays well conditioned) or the interpolating splines that are 1 at one node and 0 at the others
(`Spline`). A polynomial of the paper (eqs 18 and 19) is Chebyshev in every column; its table of
polynomials in Mach over lever and altitude (Table 7) is Spline x Spline x Chebyshev, and c is then
the table. Which index of the paper belongs to which input is not stated; here they are named.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import product
from typing import Any

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from narxcal.static_models.model import Columns, Parameter, StaticModel, registered
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError, DataError

_SPREAD = 10.0  # bounds of a coefficient in units of the output's scale, for bounded searches


@dataclass(frozen=True, kw_only=True)
class Chebyshev:
    """Chebyshev polynomials T_0 .. T_degree of `column` scaled from low .. high to -1 .. 1."""

    column: str
    degree: int
    low: float
    high: float

    def __post_init__(self) -> None:
        if self.degree < 0 or not self.low < self.high:
            raise ConfigError(
                f"polynomial in {self.column}: expected degree >= 0 and low < high, found degree "
                f"{self.degree} over {self.low:g} .. {self.high:g}"
            )

    @property
    def size(self) -> int:
        return self.degree + 1

    def values(self, x: FloatArray) -> FloatArray:
        """Functions (rows, size) at x (rows,)."""
        scaled = (2.0 * x - self.low - self.high) / (self.high - self.low)
        return np.asarray(chebvander(scaled, self.degree))


@dataclass(frozen=True, kw_only=True)
class Spline:
    """Cardinal functions of the spline through ascending `nodes` of `column`; degree 1 is linear.

    A table of fewer nodes than degree + 1 has a lower degree. Beyond the end nodes the value at
    the end node is kept.
    """

    column: str
    nodes: tuple[float, ...]
    degree: int = 3

    def __post_init__(self) -> None:
        if len(self.nodes) < 2 or not np.all(np.diff(self.nodes) > 0.0):
            raise ConfigError(
                f"table over {self.column}: expected two or more ascending nodes, "
                f"found {self.nodes}"
            )

    @property
    def low(self) -> float:
        return self.nodes[0]

    @property
    def high(self) -> float:
        return self.nodes[-1]

    @property
    def size(self) -> int:
        return len(self.nodes)

    def values(self, x: FloatArray) -> FloatArray:
        """Functions (rows, size) at x (rows,)."""
        # Odd degrees only: an even spline needs knots between the nodes.
        degree = min(self.degree, 3 if self.size > 3 else 1)
        spline = make_interp_spline(self.nodes, np.eye(self.size), k=degree)
        known = np.where(np.isfinite(x), np.clip(x, self.low, self.high), self.low)
        return np.where(np.isfinite(x)[:, np.newaxis], spline(known), np.nan)


Axis = Chebyshev | Spline


@registered("tensor")
def tensor(
    output: str, axes: Sequence[Axis | Mapping[str, Any]], *, unit: str = "", scale: float = 1.0
) -> StaticModel:
    """Tensor product of `axes` (or their documents) as a model of `output` of magnitude `scale`."""
    bases = [axis if isinstance(axis, Chebyshev | Spline) else _axis(axis) for axis in axes]

    def design(columns: Columns) -> FloatArray:
        parts = [axis.values(np.asarray(columns[axis.column])) for axis in bases]
        return reduce(_outer, parts)

    def equation(p: FloatArray, columns: Columns) -> FloatArray:
        return np.asarray(p @ design(columns).T)

    limit = _SPREAD * scale
    parameters = tuple(
        Parameter(
            name="c_" + "_".join(map(str, index)), unit=unit, start=0.0, low=-limit, high=limit
        )
        for index in product(*(range(axis.size) for axis in bases))
    )
    return StaticModel(
        name=_name(bases), output=output, inputs=tuple(axis.column for axis in bases),
        parameters=parameters, equation=equation, design=design,
    )  # fmt: skip


def polynomial(columns: Columns, output: str, degrees: Mapping[str, int]) -> StaticModel:
    """Polynomial of the given degree in each column, scaled over the range of `columns`."""
    axes = [
        Chebyshev(column=name, degree=degree, low=low, high=high)
        for name, degree in degrees.items()
        for low, high in [_range(columns, name)]
    ]
    return tensor(output, axes, scale=_scale(columns, output))


def spline_table(
    columns: Columns,
    output: str,
    nodes: Mapping[str, Sequence[float]],
    *,
    mach_degree: int = 2,
    degree: int = 3,
) -> StaticModel:
    """Table over `nodes` (two columns) of polynomials in Mach, interpolated by splines.

    Raises `DataError` naming the nodes at which `columns` have fewer than `mach_degree + 1`
    different Mach numbers: holes of the mesh.
    """
    axes = [
        Spline(column=name, nodes=tuple(map(float, at)), degree=degree)
        for name, at in nodes.items()
    ]
    _refuse_holes(columns, axes, mach_degree + 1)
    low, high = _range(columns, "Mach")
    mach = Chebyshev(column="Mach", degree=mach_degree, low=low, high=high)
    return tensor(output, [*axes, mach], scale=_scale(columns, output))


def outside(model: StaticModel, columns: Columns) -> NDArray[np.bool_]:
    """Rows (rows,) that a black-box model extrapolates: beyond the range of one of its axes."""
    found: NDArray[np.bool_] = np.zeros(len(columns[model.inputs[0]]), dtype=bool)
    for document in model.recipe["axes"]:
        axis = _axis(document)
        found |= (columns[axis.column] < axis.low) | (columns[axis.column] > axis.high)
    return found


@registered("corrected")
def corrected(base: StaticModel, correction: StaticModel) -> StaticModel:
    """Add a black-box model to `base` (eq. 20): F = F_th + sum p_ij x_1^i x_2^j."""
    count = len(base.parameters)

    def equation(p: FloatArray, columns: Columns) -> FloatArray:
        theory = base.equation(p[..., :count], columns)
        return np.asarray(theory + correction.equation(p[..., count:], columns))

    return replace(
        base, name=f"{base.name} + {correction.name}", equation=equation, design=None,
        inputs=tuple(dict.fromkeys((*base.inputs, *correction.inputs))),
        parameters=(*base.parameters, *correction.parameters),
    )  # fmt: skip


def _outer(left: FloatArray, right: FloatArray) -> FloatArray:
    """Row-wise tensor product (rows, a) x (rows, b) -> (rows, a b)."""
    return (left[:, :, np.newaxis] * right[:, np.newaxis, :]).reshape(len(left), -1)


def _range(columns: Columns, name: str) -> tuple[float, float]:
    if name not in columns:
        raise DataError(f"the black-box model needs {name}, which is missing", channel=name)
    low, high = float(np.nanmin(columns[name])), float(np.nanmax(columns[name]))
    if not low < high:
        raise DataError(
            f"every row is {low:g}: no polynomial can be fitted in it", channel=name,
            hint="Leave it out or set its degree to 0",
        )  # fmt: skip
    return low, high


def _scale(columns: Columns, output: str) -> float:
    return float(np.nanmax(np.abs(columns[output])))


def _refuse_holes(columns: Columns, axes: Sequence[Spline], least: int) -> None:
    at = np.column_stack([columns[axis.column] for axis in axes])
    holes = []
    for node in product(*(axis.nodes for axis in axes)):
        here = np.isclose(at, node).all(axis=1)
        if len(np.unique(np.round(columns["Mach"][here], 6))) < least:
            holes.append(node)
    if holes:
        names = " x ".join(axis.column for axis in axes)
        some = "; ".join(" x ".join(f"{v:g}" for v in node) for node in holes[:3])
        raise DataError(
            f"the table over {names} has {len(holes)} holes: fewer than {least} Mach numbers at "
            f"{some}",
            hint="Fly the missing nodes, leave their row out, or fit a polynomial",
        )


def _name(axes: Sequence[Axis]) -> str:
    kind = "spline table" if any(isinstance(axis, Spline) for axis in axes) else "polynomial"
    return f"{kind} ({', '.join(axis.column for axis in axes)})"


def _axis(document: Mapping[str, Any]) -> Axis:
    if "nodes" in document:
        return Spline(**{**document, "nodes": tuple(document["nodes"])})
    return Chebyshev(**document)
