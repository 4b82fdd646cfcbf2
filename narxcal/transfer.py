"""Dynamics behind a steady state: first- and second-order responses.

    first    tau y' = u - y
    second   y'' + 2 xi w y' + w^2 y = w^2 u

u is the steady value of the output, linear between samples; within a step the parameters are those
of its first sample, and the response is exact. Their logarithms are interpolated over the nodes of
a `Schedule`.

| symbol | meaning | unit |
|---|---|---|
| u, y, v | steady value, output, its rate | channel, channel/s |
| tau, xi, w | time constant, damping ratio, natural frequency | s, -, rad/s |
| W | weight (time, nodes) of each node | - |
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import RegularGridInterpolator

from narxcal.output_error.blocks import as_complex, lag_step
from narxcal.output_error.engine import Parameter
from narxcal.support.arrays import FloatArray
from narxcal.support.compiled import compiled
from narxcal.support.errors import DataError

Order = Literal["first", "second"]
_SERIES = 1e-8  # (a h)^2 below which two terms of cosh(a h) and sinh(a h)/a are exact to 1e-17
ComplexArray = NDArray[np.complex128]


def respond(
    u: ArrayLike,
    logs: ArrayLike,
    dt_s: float,
    state: tuple[complex, complex] | None = None,
    measured: FloatArray | None = None,
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Response (time,) to u (time,) and the state (y, v) at its end; complex where `logs` are.

    `logs` (time, 1) are ln tau, (time, 2) ln xi and ln w. Without `state` the run starts in
    equilibrium. A finite value of `measured` (time,) replaces y after its sample.
    """
    goal, p = as_complex(u), np.exp(as_complex(logs))
    start = (goal[0], 0j) if state is None else state
    known = np.full(len(goal), np.nan) if measured is None else measured
    run = _first if p.shape[1] == 1 else _second
    y, end = run(goal, p, (complex(start[0]), complex(start[1])), (known, dt_s))
    return (y, end) if np.iscomplexobj(logs) else (y.real.copy(), end.real.copy())


@compiled
def _first(
    u: ComplexArray,
    p: ComplexArray,
    state: tuple[complex, complex],
    more: tuple[FloatArray, float],
) -> tuple[ComplexArray, ComplexArray]:
    measured, dt_s = more
    found, y = np.empty_like(u), state[0]
    for k in range(len(u)):
        if k > 0:
            y = lag_step(y, (u[k - 1], u[k]), p[k - 1, 0] / dt_s)
        found[k] = y
        if np.isfinite(measured[k]):
            y = complex(measured[k])
    return found, np.array([y, 0j])


@compiled
def _second(
    u: ComplexArray,
    p: ComplexArray,
    state: tuple[complex, complex],
    more: tuple[FloatArray, float],
) -> tuple[ComplexArray, ComplexArray]:
    measured, dt_s = more
    found, (y, v) = np.empty_like(u), state
    for k in range(len(u)):
        if k > 0:
            xi, w = p[k - 1, 0], p[k - 1, 1]
            decay, fall = xi * w, np.exp(-xi * w * dt_s)
            square = w * w * (xi * xi - 1.0) * dt_s * dt_s
            if abs(square) < _SERIES:
                even, odd = 1.0 + square / 2.0, dt_s * (1.0 + square / 6.0)
            else:
                root = np.sqrt(square)
                even, odd = np.cosh(root), dt_s * np.sinh(root) / root
            even, odd = fall * even, fall * odd
            rate = (u[k] - u[k - 1]) / dt_s
            behind = 2.0 * xi / w * rate  # of a ramp that lasts
            e, r = y - u[k - 1] + behind, v - rate
            y = u[k] - behind + (even + decay * odd) * e + odd * r
            v = rate - w * w * odd * e + (even - decay * odd) * r
        found[k] = y
        if np.isfinite(measured[k]):
            y = complex(measured[k])
    return found, np.array([y, v])


@dataclass(frozen=True)
class ResponseFromSteady:
    """One output behind its steady value, as a model for `training.papers.output_error.fit`.

    Inputs (time, 1 + nodes) are u and W. Parameters are NAME_OUTPUT@NODE; `start_s` is the time
    constant to start from.
    """

    output: str
    order: Order
    nodes: Sequence[str]
    dt_s: float
    start_s: float = 1.0

    @property
    def names(self) -> tuple[str, ...]:
        return ("tau",) if self.order == "first" else ("xi", "w")

    @property
    def output_names(self) -> Sequence[str]:
        return (self.output,)

    @property
    def parameters(self) -> Sequence[Parameter]:
        """Node by node; bounds keep a response between one sample and two minutes."""
        low, high, start = self.dt_s, 120.0, max(self.start_s, 2.0 * self.dt_s)
        rows = {
            "tau": (start, low, high, "s", "time constant"),
            "xi": (1.0, 0.05, 20.0, "-", "damping ratio"),
            "w": (2.0 / start, 1.0 / high, 2.0 / low, "rad/s", "natural frequency"),
        }
        return [
            Parameter(f"{name}_{self._at(node)}", *rows[name])
            for node in self.nodes
            for name in self.names
        ]

    def _at(self, node: str) -> str:
        return f"{self.output}@{node}" if node else self.output

    def logs(self, values: Mapping[str, complex]) -> NDArray[Any]:
        """Logarithms (nodes, P) of the parameters by name."""
        numbers = [
            [values[f"{name}_{self._at(node)}"] for name in self.names] for node in self.nodes
        ]
        found: NDArray[Any] = np.log(np.array(numbers))
        return found

    def simulate(self, values: Mapping[str, complex], u: FloatArray) -> NDArray[Any]:
        y, _ = respond(u[:, 0], u[:, 1:] @ self.logs(values), self.dt_s)
        return y[:, None]


@dataclass(frozen=True, eq=False)
class Schedule:
    """Parameters over a complete grid of conditions, for example altitude x amplitude.

    `axes` are the ascending grid values of each condition, `values` (.., P) the parameters there:
    those of a step response, or the coordinates of a state-space model.
    """

    axes: tuple[tuple[float, ...], ...]
    values: FloatArray

    def __post_init__(self) -> None:
        shape = tuple(map(len, self.axes))
        if self.values.shape[:-1] != shape or not np.isfinite(self.values).all():
            raise DataError(
                f"a schedule over {' x '.join(map(str, shape))} conditions needs finite "
                f"parameters at each, found {self.values.shape[:-1]} of which "
                f"{int((~np.isfinite(self.values)).any(axis=-1).sum())} are not: the mesh has holes"
            )

    def at(self, conditions: ArrayLike) -> FloatArray:
        """Parameters (.., P) at conditions (.., axes), linear between, constant beyond nodes."""
        return np.asarray(_between(self.axes, conditions, self.values))


def node_weights(axes: Sequence[Sequence[float]], conditions: ArrayLike) -> FloatArray:
    """Weights (.., nodes) of the nodes of a grid at conditions (.., axes); they sum to one."""
    shape = tuple(map(len, axes))
    return _between(axes, conditions, np.eye(int(np.prod(shape))).reshape(*shape, -1))


def _between(
    axes: Sequence[Sequence[float]], conditions: ArrayLike, values: FloatArray
) -> FloatArray:
    """Multilinear interpolation of values (grid.., P) at conditions (.., axes)."""
    at = np.asarray(conditions, dtype=np.float64)
    if not axes:
        return np.broadcast_to(values, (*at.shape[:-1], values.shape[-1]))
    inside = np.stack([np.clip(at[..., k], a[0], a[-1]) for k, a in enumerate(axes)], axis=-1)
    found = RegularGridInterpolator(tuple(axes), values)(inside)
    return np.asarray(found).reshape(*at.shape[:-1], values.shape[-1])
