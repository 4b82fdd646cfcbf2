"""A model with latent states: a linear state space and one hidden layer that acts on all of it.

    v(k) = [x(k), u(k - delay), 1],   t(k) = tanh(W v(k))
    [x(k+1); y(k)] = L v(k) + M t(k)

| symbol | shape | meaning |
|---|---|---|
| n, m, p, h | | states, inputs, outputs, hidden units (0: linear) |
| W | (h, n + m + 1) | slopes and offsets of the hidden units |
| L | (n + p, n + m + 1) | linear part: [A B b; C D d] |
| M | (n + p, h) | nonlinear part |
| theta | (P,) | L, M, W, each by rows |

The states are no measured quantities, so the noise of the outputs never enters the recursion, as
it does where past outputs are the state. Forward sensitivities dx/dtheta and dy/dtheta give
Gauss-Newton's normal equations. Source of the form: Bemporad, An L-BFGS-B approach for linear and
nonlinear system identification, IEEE Trans. Automatic Control 70(4), 2025 (jax-sysid).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np

from narxcal.narx.kernels import tanh_of
from narxcal.narx.network import Scaling, shaped
from narxcal.support.arrays import FloatArray
from narxcal.support.compiled import compiled

Parts = tuple[FloatArray, FloatArray, FloatArray]  # L, M, W


@compiled(exact=False)
def _activate(slopes: FloatArray, v: FloatArray, active: FloatArray) -> None:
    """Fill t = tanh(W v) into `active` (h,)."""
    for i in range(len(slopes)):
        active[i] = 0.0
        for j in range(len(v)):
            active[i] += slopes[i, j] * v[j]
    tanh_of(active, active)


@compiled(exact=False)
def latent_run(
    parts: Parts, u: FloatArray, x0: FloatArray, bounds: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """States (T, n), activations (T, h) and outputs (T, p) from state x0 (n,); the state after.

    States are clipped to `bounds`, low (n,) and high (n,), so that a run cannot diverge.
    """
    linear, bent, slopes = parts
    low, high = bounds
    steps, m = u.shape
    n, h = len(x0), len(slopes)
    p = len(linear) - n
    states, active, y = np.empty((steps, n)), np.empty((steps, h)), np.empty((steps, p))
    v = np.ones(n + m + 1)
    x = x0.copy()
    for k in range(steps):
        v[:n] = x
        v[n : n + m] = u[k]
        states[k] = x
        _activate(slopes, v, active[k])
        for i in range(n + p):
            z = 0.0
            for j in range(n + m + 1):
                z += linear[i, j] * v[j]
            for j in range(h):
                z += bent[i, j] * active[k, j]
            if i < n:
                # Written so that an overflow to NaN, too, ends inside the bounds.
                x[i] = min(z, high[i]) if z > low[i] else low[i]
            else:
                y[k, i - n] = z
    return states, active, y, x


@compiled(exact=False)
def _gains(parts: Parts, active: FloatArray, gain: FloatArray) -> None:
    """Fill d[x(k+1); y(k)]/dx(k) into `gain` (n + p, n)."""
    linear, bent, slopes = parts
    rows, n = gain.shape
    for i in range(rows):
        for j in range(n):
            gain[i, j] = linear[i, j]
    for q in range(len(slopes)):
        slope = 1.0 - active[q] * active[q]
        for i in range(rows):
            c = bent[i, q] * slope
            for j in range(n):
                gain[i, j] += c * slopes[q, j]


@compiled(exact=False, inline=True)
def _passed_on(row: FloatArray, factor: float, gain: FloatArray, sensitivity: FloatArray) -> None:
    """Fill `row` (Q,) with factor times gain (n,) times dx/d(theta, x0) (n, Q).

    Two states at a time: each entry of the row is read and written half as often.
    """
    n = len(gain)
    for q in range(len(row)):
        row[q] = factor * gain[n - 1] * sensitivity[n - 1, q] if n % 2 else 0.0
    for j in range(0, n - 1, 2):
        one, other = factor * gain[j], factor * gain[j + 1]
        for q in range(len(row)):
            row[q] += one * sensitivity[j, q] + other * sensitivity[j + 1, q]


@compiled(exact=False)
def _inner_slopes(inner: FloatArray, v: FloatArray, active: FloatArray) -> None:
    """Fill `inner` (h len(v),) with the slope of every hidden unit by its weights."""
    for q in range(len(active)):
        for j in range(len(v)):
            inner[q * len(v) + j] = (1.0 - active[q] * active[q]) * v[j]


@compiled(exact=False, inline=True)
def _direct(
    row: FloatArray,
    at: tuple[int, float],
    inside: tuple[FloatArray, FloatArray],
    v: FloatArray,
    active: FloatArray,
) -> None:
    """Add the derivative of entry `i` of [x(k+1); y(k)] by theta at a given v to `row`.

    `at` is (i, a factor). `inside` is M with each column repeated len(v) times, (n + p, h len(v)),
    and the slope of every hidden unit by its weights (h len(v),): the slopes of the entry by W.
    """
    i, factor = at
    bent, inner = inside
    rows, r, h = len(bent), len(v), len(active)
    # Slices, since an index that might be negative keeps a loop out of vector registers.
    by_l, by_m, by_w = row[i * r :], row[rows * r + i * h :], row[rows * (r + h) :]
    for j in range(r):
        by_l[j] += factor * v[j]
    for q in range(h):
        by_m[q] += factor * active[q]
    for j in range(len(inner)):
        by_w[j] += factor * bent[i, j] * inner[j]


@compiled(exact=False)
def latent_jacobian(
    parts: Parts,
    run: tuple[FloatArray, FloatArray, FloatArray],
    sensitivity: FloatArray,
    root: FloatArray,
    bounds: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """Rows root dy/d(theta, x0) (count of root > 0, P + n) of a stretch of a run.

    `run` is u, states and activations of the stretch. `sensitivity` (n, P + n) is dx/d(theta, x0)
    at its start, and left at its end, so that long runs are done block by block. With (n, n) the
    rows are root dy/dx0 alone.
    """
    u, states, active = run
    low, high = bounds
    steps, m = u.shape
    n, p = states.shape[1], root.shape[1]
    r, h = n + m + 1, active.shape[1]
    rows = np.empty((np.count_nonzero(root > 0.0), sensitivity.shape[1]))
    now, ahead = sensitivity.copy(), np.empty_like(sensitivity)
    gain, v, inner = np.empty((n + p, n)), np.ones(r), np.empty(h * r)
    inside = np.repeat(parts[1], r).reshape(n + p, h * r), inner
    by_theta = sensitivity.shape[1] > n
    count = 0
    for k in range(steps):
        v[:n] = states[k]
        v[n : n + m] = u[k]
        _inner_slopes(inner, v, active[k])
        _gains(parts, active[k], gain)
        for i in range(n):
            if k + 1 < steps and not low[i] < states[k + 1, i] < high[i]:
                ahead[i] = 0.0
                continue
            _passed_on(ahead[i], 1.0, gain[i], now)
            if by_theta:
                _direct(ahead[i], (i, 1.0), inside, v, active[k])
        for i in range(p):
            if root[k, i] > 0.0:
                _passed_on(rows[count], root[k, i], gain[n + i], now)
                if by_theta:
                    _direct(rows[count], (n + i, root[k, i]), inside, v, active[k])
                count += 1
        now, ahead = ahead, now
    sensitivity[:] = now
    return rows


@dataclass(frozen=True)
class Shape:
    """Sizes of a latent model; `delay` (m,) is the dead time of each input in samples."""

    states: int
    inputs: int
    outputs: int
    hidden: int
    delay: tuple[int, ...]

    @property
    def width(self) -> int:
        return self.states + self.inputs + 1

    @property
    def size(self) -> int:
        rows = self.states + self.outputs
        return rows * (self.width + self.hidden) + self.hidden * self.width

    def parts(self, theta: FloatArray) -> Parts:
        """L, M and W of theta."""
        rows, r, h = self.states + self.outputs, self.width, self.hidden
        a, b = rows * r, rows * (r + h)
        return (
            np.ascontiguousarray(theta[:a]).reshape(rows, r),
            np.ascontiguousarray(theta[a:b]).reshape(rows, h),
            np.ascontiguousarray(theta[b : self.size]).reshape(h, r),
        )


def delayed(u: FloatArray, delay: Sequence[int]) -> FloatArray:
    """Inputs (time, m) behind their dead times in samples, constant before the start."""
    if not any(delay):
        return np.ascontiguousarray(u)
    rows = np.arange(len(u))
    return np.stack([u[np.maximum(rows - d, 0), j] for j, d in enumerate(delay)], axis=1)


def unbounded(n: int) -> tuple[FloatArray, FloatArray]:
    """Bounds of n states that bound nothing."""
    return np.full(n, -np.inf), np.full(n, np.inf)


_SPREAD = 1.0  # states are scaled to unit variance over the training records: the prior of x0
_ITERATIONS = 12  # of the initial state; Gauss-Newton halves its error or better in each


@dataclass(frozen=True, eq=False)
class LatentModel:
    """A latent model with its scaling: simulates records in the units they came in.

    `bounds` clip the states; `noise` (p,) is the standard deviation of the free run's error and
    `persistence` (p,) its correlation from sample to sample, both in scaled units; `memory` counts
    the samples after which a start is forgotten.
    """

    shape: Shape
    theta: FloatArray
    bounds: tuple[FloatArray, FloatArray]
    input_scaling: Scaling
    output_scaling: Scaling
    noise: FloatArray
    persistence: FloatArray
    memory: int

    @property
    def inputs(self) -> int:
        return self.shape.inputs

    @property
    def outputs(self) -> int:
        return self.shape.outputs

    @cached_property
    def parts(self) -> Parts:
        return self.shape.parts(self.theta)

    def _inputs(self, u: FloatArray) -> FloatArray:
        return delayed(self.input_scaling.down(u), self.shape.delay)

    def simulate(self, u: FloatArray, start: FloatArray) -> FloatArray:
        """Free run (time, p) over `u` (time, m); the first rows are `start` (n, p) as given.

        The state before it is the most probable one given `start`, from its equilibrium at the
        first input with the scatter of the training states.
        """
        inputs = self._inputs(u)
        first = self.output_scaling.down(start)
        begin = max(len(first) - self.memory, 0)
        x0 = self.initial_state(inputs[begin : len(first)], first[begin:])
        y = latent_run(self.parts, inputs[begin:], x0, self.bounds)[2]
        free = self.output_scaling.up(y[len(first) - begin :])
        return np.concatenate([start, free])[: len(u)]

    def predict(self, u: FloatArray, y: FloatArray, steps: int = 1) -> FloatArray:
        """`steps` ahead (time, p): the free run, corrected by its last error as AR(1) noise."""
        known = np.flatnonzero(np.isfinite(y).all(axis=1))
        result = np.full(y.shape, np.nan)
        if not len(known) or len(y) <= steps:
            return result
        head = y[known[0] : known[0] + self.memory]
        free = np.full(y.shape, np.nan)
        inputs = self._inputs(u)[known[0] :]
        x0 = self.initial_state(inputs[: len(head)], self.output_scaling.down(head))
        run = latent_run(self.parts, inputs, x0, self.bounds)[2]
        free[known[0] :] = self.output_scaling.up(run)
        result[steps:] = free[steps:] + self.persistence**steps * (y - free)[:-steps]
        return result

    def equilibrium(self, u: FloatArray) -> FloatArray:
        """State (n,) that a constant input (m,) leads to; the mean state where it leads away."""
        zero = np.zeros(self.shape.states)
        held = np.repeat(u[None], self.memory, axis=0)
        x = latent_run(self.parts, held, zero, self.bounds)[3]
        low, high = self.bounds
        inside = np.isfinite(x).all() and bool(np.all((x > low) & (x < high)))
        return np.clip(x, -3.0, 3.0) if inside else zero  # training states have a deviation of 1

    def initial_state(self, u: FloatArray, y: FloatArray) -> FloatArray:
        """Most probable state (n,) at the first row of scaled `u` (time, m) and `y` (time, p)."""
        prior = self.equilibrium(u[0])
        root = np.isfinite(y) / np.maximum(self.noise, 1e-6)
        measured, n = np.nan_to_num(y), self.shape.states

        def cost(x: FloatArray) -> tuple[float, tuple[FloatArray, ...]]:
            run = latent_run(self.parts, u, x, self.bounds)
            error = (run[2] - measured) * root
            far = (x - prior) / _SPREAD
            return float((error**2).sum() + far @ far), (*run[:2], error)

        x, damping = prior.copy(), 1e-3
        value, run = cost(x)
        for _ in range(_ITERATIONS):
            slopes = latent_jacobian(self.parts, (u, run[0], run[1]), np.eye(n), root, self.bounds)
            error = run[2][root > 0.0]
            gradient = slopes.T @ error + (x - prior) / _SPREAD**2
            hessian = slopes.T @ slopes + np.eye(n) / _SPREAD**2
            step = -np.linalg.solve(hessian + damping * np.diag(np.diag(hessian)), gradient)
            after, there = cost(x + step)
            if not after < value:
                damping *= 10.0
                continue
            done = value - after < 1e-6 * value
            x, value, run, damping = x + step, after, there, damping * 0.1
            if done:
                break
        return x

    def to_arrays(self) -> tuple[dict[str, Any], dict[str, FloatArray]]:
        shape = self.shape
        meta = {
            "states": shape.states, "inputs": shape.inputs, "outputs": shape.outputs,
            "hidden": shape.hidden, "delay": list(shape.delay), "memory": self.memory,
        }  # fmt: skip
        low, high = self.bounds
        return meta, {
            "theta": self.theta.copy(), "low": low, "high": high,
            "noise": self.noise, "persistence": self.persistence,
            **self.input_scaling.named("input_scaling"),
            **self.output_scaling.named("output_scaling"),
        }  # fmt: skip

    @classmethod
    def from_arrays(cls, meta: Mapping[str, Any], arrays: Mapping[str, FloatArray]) -> Self:
        """Rebuild from `to_arrays`; `ModelError` where an array is missing or unusable."""
        n, m, p, h = (int(meta[name]) for name in ("states", "inputs", "outputs", "hidden"))
        shape = Shape(n, m, p, h, tuple(int(d) for d in meta["delay"]))
        wanted = {
            "theta": shape.size, "low": n, "high": n, "noise": p, "persistence": p,
            "input_scaling.centre": m, "input_scaling.scale": m,
            "output_scaling.centre": p, "output_scaling.scale": p,
        }  # fmt: skip
        kept = shaped(arrays, {name: (length,) for name, length in wanted.items()}, "array")
        return cls(
            shape, kept["theta"], (kept["low"], kept["high"]),
            Scaling.stored(kept, "input_scaling"), Scaling.stored(kept, "output_scaling"),
            kept["noise"], kept["persistence"], int(meta["memory"]),
        )  # fmt: skip
