"""Fit latent models: a linear state space by output error, then a hidden layer grown on it.

The linear model starts from a realisation (Ho and Kalman) of a long ARX model, whose impulse
response a singular value decomposition reduces to n states; the best of several lengths is polished
on the free run, with the initial state of every record free. States are then scaled to zero mean
and unit variance over the records.

The nonlinear model starts at the linear one: M = 0, W drawn. Half the mean squared free-run error
in scaled units plus decay/2 |theta - theta_linear|^2 is minimised for a decay that falls by a
factor at every level, each from the solution of the one before. So the model leaves the linear one
only as far as the data pay for, and a path of levels is one fit with every strength of the prior.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from narxcal.narx.latent import (
    LatentModel,
    Shape,
    delayed,
    latent_jacobian,
    latent_run,
    unbounded,
)
from narxcal.narx.network import Scaling
from narxcal.record import Record
from narxcal.support.arrays import FloatArray, known_mean
from training.dynamics.network import regression
from training.dynamics.optimisers import Damping, Equations, Late, minimise, unlimited

_BLOCK = 256  # rows of a Jacobian that are kept at one time
_STATE_DECAY = 1e-6  # on initial states: where a record does not show them, they stay at the mean
_LINEAR_DECAY = 1e-9  # on linear models: keeps a change of state coordinates where it is
_LINEAR_STEPS = 40
_LENGTHS = (1, 2, 3, 5, 8, 15, 30, 60)
_STABLE = 0.9995  # largest pole of an ARX model that is realised
_SETTLED = 5.0  # time constants in the longest record, after which 1 % of a start is left


@dataclass(frozen=True, eq=False)
class Data:
    """Records in scaled units: delayed inputs (T, m), outputs (T, p) and root weights (T, p).

    `measured` are the outputs with NaN where masked; in `outputs` they are 0 there. `slowest` is
    the largest pole of a linear model: a mode that does not settle within the longest record can't
    be distinguished from drift there, and drifts in other records. Fits end where they are `late`.
    """

    inputs: tuple[FloatArray, ...]
    outputs: tuple[FloatArray, ...]
    roots: tuple[FloatArray, ...]
    measured: tuple[FloatArray, ...]
    slowest: float
    late: Late = unlimited

    @classmethod
    def of(
        cls,
        records: Sequence[Record],
        delay: tuple[int, ...],
        scalings: tuple[Scaling, Scaling],
        every: float = 1.0,
        longest: int = 0,
    ) -> Data:
        """Scale, delay, and normalise the weights to a mean over outputs and samples.

        `longest` is the length of the longest record of which these are parts. One row in `every`
        is scored, drawn at random: at regular rows a mode that alternates between them would not be
        seen.
        """
        inputs, outputs, roots, measured = [], [], [], []
        draw = np.random.default_rng(0)
        for record in records:
            y = scalings[1].down(record.y)
            weight = np.ones(len(y)) if record.weight is None else record.weight
            inputs.append(delayed(scalings[0].down(record.u), delay))
            outputs.append(np.nan_to_num(y))
            measured.append(y)
            scored = draw.random(len(y)) < 1.0 / every
            roots.append(np.sqrt(weight * scored)[:, None] * np.isfinite(y))
        total = np.sqrt(max(sum(float((root**2).sum()) for root in roots), 1e-12))
        weights = tuple(root / total for root in roots)
        slowest = float(np.exp(-_SETTLED / max(longest, *map(len, inputs))))
        return cls(tuple(inputs), tuple(outputs), weights, tuple(measured), slowest)


@dataclass(frozen=True, eq=False)
class LatentProblem:
    """Penalised free-run loss over z = (theta, x0 of every record), for Levenberg-Marquardt.

    `penalty` (Q,) is the decay of each entry towards `centre` (Q,).
    """

    shape: Shape
    data: Data
    centre: FloatArray
    penalty: FloatArray

    def loss(self, z: FloatArray) -> float:
        """Half the weighted mean square of the free-run error, and the penalty.

        Infinite where the run diverges or a linear model is slower than the records show.
        """
        parts, total, n = self.shape.parts(z), 0.0, self.shape.states
        if not self.shape.hidden:
            poles = np.linalg.eigvals(parts[0][:n, :n])
            if np.abs(poles).max() > self.data.slowest:
                return np.inf
        for k, (u, y, root) in enumerate(zip(*self._columns(), strict=True)):
            with np.errstate(over="ignore", invalid="ignore"):
                run = latent_run(parts, u, self.start(z, k), unbounded(n))
                total += float((((run[2] - y) * root) ** 2).sum())
            if not np.isfinite(total):
                return np.inf
        away = z - self.centre
        return 0.5 * total + 0.5 * float(self.penalty @ away**2)

    def normal_equations(self, z: FloatArray) -> Equations:
        """Loss, gradient and Gauss-Newton matrix."""
        shape, parts = self.shape, self.shape.parts(z)
        n, size, count = shape.states, shape.size, len(z)
        gradient, hessian, total = np.zeros(count), np.zeros((count, count)), 0.0
        for k, (u, y, root) in enumerate(zip(*self._columns(), strict=True)):
            states, active, free, _ = latent_run(parts, u, self.start(z, k), unbounded(n))
            sensitivity = np.zeros((n, size + n))
            sensitivity[:, size:] = np.eye(n)
            own, slopes = np.zeros((size + n, size + n)), np.zeros(size + n)
            block = len(u) * _BLOCK // max(int((root > 0.0).sum()), 1) + 1
            for a in range(0, len(u), block):
                part = slice(a, a + block)
                rows = latent_jacobian(
                    parts, (u[part], states[part], active[part]), sensitivity, root[part],
                    unbounded(n),
                )  # fmt: skip
                error = ((free[part] - y[part]) * root[part])[root[part] > 0.0]
                with np.errstate(over="ignore", invalid="ignore"):
                    total += float(error @ error)
                    slopes += rows.T @ error
                    own += rows.T @ rows
            at = np.concatenate([np.arange(size), size + k * n + np.arange(n)])
            gradient[at] += slopes
            hessian[np.ix_(at, at)] += own
        away = z - self.centre
        gradient += self.penalty * away
        hessian[np.diag_indices(count)] += self.penalty
        return Equations(0.5 * total + 0.5 * float(self.penalty @ away**2), gradient, hessian)

    def start(self, z: FloatArray, k: int) -> FloatArray:
        """Initial state of record `k`."""
        n = self.shape.states
        return z[self.shape.size + k * n :][:n]

    def _columns(self) -> tuple[tuple[FloatArray, ...], ...]:
        return self.data.inputs, self.data.outputs, self.data.roots


@dataclass(frozen=True, eq=False)
class Fitted:
    """A latent model on the way: z = (theta, x0 of every record), its loss without penalty.

    `centre` (P,) is the theta that the decay pulls towards: the linear model with M = 0.
    """

    shape: Shape
    z: FloatArray
    loss: float
    centre: FloatArray

    @property
    def theta(self) -> FloatArray:
        """Parameters without the initial states."""
        return self.z[: self.shape.size]


def descend(
    problem: LatentProblem, z: FloatArray, steps: int, damping: Damping | None = None
) -> tuple[FloatArray, float, Damping, int]:
    """Levenberg-Marquardt until the loss falls by less than 0.01 % a step, at most `steps`."""
    before, used = problem.loss(z), 0
    damping = damping or Damping()
    for step in islice(minimise(problem, z, 0.0, damping), steps):
        z, used, damping = step.theta, used + 1, step.damping
        fallen, before = before - step.loss, step.loss
        if fallen < 1e-4 * before or problem.data.late():
            break
    return z, before, damping, used


def fit_linear(data: Data, shape: Shape, starts: Starts | None = None) -> Fitted | None:
    """Linear model of `shape` (hidden 0) by output error; None where no start is stable."""
    starts = starts or Starts.of(data)
    count = shape.size + shape.states * len(data.inputs)
    penalty = np.full(count, _STATE_DECAY)
    penalty[: shape.size] = _LINEAR_DECAY
    problem = LatentProblem(shape, data, np.zeros(count), penalty)
    best, least = None, np.inf
    for linear in starts.of_order(shape.states):
        z = np.concatenate([linear.ravel(), np.zeros(count - shape.size)])
        loss = problem.loss(z)
        if loss < least:
            best, least = z, loss
    if best is None:
        return None
    z, loss, _, _ = descend(problem, best, _LINEAR_STEPS)
    return normalised(Fitted(shape, z, loss, z[: shape.size]), data)


@dataclass(frozen=True, eq=False)
class Realisation:
    """Factors of a Hankel matrix of impulse responses, cut to any order (Ho and Kalman 1966)."""

    left: FloatArray
    singular: FloatArray
    right: FloatArray
    shifted: FloatArray
    direct: FloatArray
    constant: FloatArray

    def of_order(self, n: int, slowest: float) -> FloatArray | None:
        """Linear part L (n + p, n + m + 1); None where the data show fewer than n states.

        No pole is above `slowest`.
        """
        p, m = self.direct.shape
        if len(self.singular) < n or self.singular[n - 1] <= 1e-10 * self.singular[0]:
            return None
        root = np.sqrt(self.singular[:n])
        left, right = self.left[:, :n], self.right[:n]
        matrix = (left / root).T @ self.shifted @ (right / root[:, None]).T
        size = float(np.abs(np.linalg.eigvals(matrix)).max())
        if size >= slowest:
            matrix *= 0.9999 * slowest / size
        top = np.hstack([matrix, (root[:, None] * right)[:, :m], np.zeros((n, 1))])
        bottom = np.hstack([(left * root)[:p], self.direct, self.constant[:, None]])
        return np.concatenate([top, bottom])


@dataclass(frozen=True, eq=False)
class Starts:
    """Realisations of stable ARX models of several lengths, by which a linear fit starts."""

    found: tuple[Realisation, ...]
    outputs: int
    inputs: int
    slowest: float

    @classmethod
    def of(cls, data: Data) -> Starts:
        """Fit ARX models of 1 to 60 samples to the records, and realise those that are stable."""
        shortest = min(len(u) for u in data.inputs)
        fits = (_arx(data, length) for length in _LENGTHS if length < shortest)
        found = tuple(one for fit in fits if fit and (one := _realised(*fit)) is not None)
        return cls(found, data.outputs[0].shape[1], data.inputs[0].shape[1], data.slowest)

    def of_order(self, n: int) -> Iterator[FloatArray]:
        """Linear parts of n states; without any, independent lags of 2 to 64 samples."""
        parts = [part for one in self.found if (part := one.of_order(n, self.slowest)) is not None]
        yield from parts
        if not parts:
            top = np.zeros((n, n + self.inputs + 1))
            poles = np.exp(-1.0 / np.geomspace(2.0, 64.0, n))
            top[:, :n] = np.diag(np.minimum(poles, 0.9999 * self.slowest))
            yield np.concatenate([top, np.full((self.outputs, n + self.inputs + 1), 1e-3)])


def _arx(data: Data, length: int) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """A (length, p, p), B (length + 1, p, m) and offset (p,) by least squares over known rows."""
    p, m = data.outputs[0].shape[1], data.inputs[0].shape[1]
    width = length * p + (length + 1) * m + 1
    normal, right, count = 1e-30 * np.eye(width), np.zeros((width, p)), 0
    for u, y in zip(data.inputs, data.measured, strict=True):
        phi, target = regression(u, y, length, range(length + 1))
        phi = np.column_stack([phi, np.ones(len(phi))])
        normal += phi.T @ phi
        right += phi.T @ target
        count += len(phi)
    if count < width:
        return None
    normal[np.diag_indices(width)] += 1e-8 * count
    solution = np.asarray(np.linalg.solve(normal, right), dtype=np.float64).T
    a = solution[:, : length * p].reshape(p, length, p).transpose(1, 0, 2)
    b = solution[:, length * p : -1].reshape(p, length + 1, m).transpose(1, 0, 2)
    return a, b, solution[:, -1]


def _realised(a: FloatArray, b: FloatArray, offset: FloatArray) -> Realisation | None:
    """Impulse response of an ARX model in a Hankel matrix, decomposed; None if unstable."""
    length, (p, m) = len(a), b.shape[1:]
    companion = np.zeros((length * p, length * p))
    companion[:p] = a.transpose(1, 0, 2).reshape(p, -1)
    companion[p:, :-p] = np.eye((length - 1) * p)
    poles = np.abs(np.linalg.eigvals(companion))
    largest = float(poles.max())
    if not largest <= _STABLE:
        return None
    memory = int(np.clip(np.log(0.01) / np.log(max(largest, 1e-3)), 20, 400))
    markov = np.zeros((2 * memory + 2, p, m))
    state = np.zeros((length * p, m))
    for k in range(len(markov)):
        state = companion @ state
        if k <= length:
            state[:p] += b[k]
        markov[k] = state[:p]
    index = np.arange(0, memory, max(memory // 60, 1))
    at = index[:, None] + index[None, :] + 1
    shape = (len(index) * p, len(index) * m)
    flat, shifted = (markov[k].transpose(0, 2, 1, 3).reshape(shape) for k in (at, at + 1))
    left, singular, right = np.linalg.svd(flat, full_matrices=False)
    if not singular[0] > 0.0:
        return None
    constant = np.linalg.solve(np.eye(p) - a.sum(axis=0), offset)
    return Realisation(left, singular, right, shifted, markov[0], constant)


def normalised(fitted: Fitted, data: Data) -> Fitted:
    """The same linear model with states of zero mean and unit, uncorrelated variance."""
    shape, n = fitted.shape, fitted.shape.states
    linear = shape.parts(fitted.z)[0]
    problem = LatentProblem(shape, data, fitted.z, 0.0 * fitted.z)
    runs = [
        latent_run(shape.parts(fitted.z), u, problem.start(fitted.z, k), unbounded(n))[0]
        for k, u in enumerate(data.inputs)
    ]
    states = np.concatenate(runs)
    mean = states.mean(axis=0)
    spread, axes = np.linalg.eigh(np.cov(states.T).reshape(n, n))
    root = np.sqrt(np.maximum(spread, 1e-9 * spread.max() + 1e-30))
    back = axes * root  # x = mean + back z
    there = (axes / root).T
    A, B, b = linear[:n, :n], linear[:n, n:-1], linear[:n, -1]
    C, D, d = linear[n:, :n], linear[n:, n:-1], linear[n:, -1]
    top = np.hstack([there @ A @ back, there @ B, (there @ (A @ mean + b - mean))[:, None]])
    bottom = np.hstack([C @ back, D, (C @ mean + d)[:, None]])
    starts = [there @ (problem.start(fitted.z, k) - mean) for k in range(len(data.inputs))]
    z = np.concatenate([top.ravel(), bottom.ravel(), *starts])
    return replace(fitted, z=z, centre=z[: shape.size])


def grown(linear: Fitted, hidden: int, seed: int) -> Fitted:
    """A nonlinear model that is the linear one as yet: M = 0, hidden units drawn."""
    shape = replace(linear.shape, hidden=hidden)
    rows, r = shape.states + shape.outputs, shape.width
    draw = np.random.default_rng(seed)
    slopes = draw.standard_normal((hidden, r))
    # Each unit bends within the data: unit slope along a random direction, offset inside it.
    slopes[:, :-1] /= np.linalg.norm(slopes[:, :-1], axis=1, keepdims=True)
    size = linear.shape.size
    z = np.concatenate([linear.z[:size], np.zeros(rows * hidden), slopes.ravel(), linear.z[size:]])
    return Fitted(shape, z, linear.loss, z[: shape.size])


def path(
    start: Fitted, data: Data, decays: Sequence[float], steps: int
) -> Iterator[tuple[Fitted, int]]:
    """Fits along falling decays, each from the one before, with the steps it took."""
    fitted, damping = start, Damping()
    for decay in decays:
        fitted, damping, used = at_decay(fitted, data, decay, steps, damping)
        yield fitted, used


def at_decay(
    start: Fitted, data: Data, decay: float, steps: int, damping: Damping | None = None
) -> tuple[Fitted, Damping, int]:
    """Descend from `start` at one decay; the fit, the damping to go on with and steps taken."""
    damping = damping or Damping()
    if data.late():
        return start, damping, 0
    size = start.shape.size
    states = len(start.z) - size
    penalty = np.concatenate([np.full(size, decay), np.full(states, _STATE_DECAY)])
    centre = np.concatenate([start.centre, np.zeros(states)])
    problem = LatentProblem(start.shape, data, centre, penalty)
    z, _, damping, used = descend(problem, start.z, steps, damping)
    loss = replace(problem, penalty=0.0 * penalty).loss(z)
    return replace(start, z=z, loss=loss), damping, used


def moved(fitted: Fitted, model: LatentModel, data: Data) -> Fitted:
    """The same parameters on other records, whose initial states are estimated."""
    starts = []
    for u, y in zip(data.inputs, data.measured, strict=True):
        starts.append(model.initial_state(u[: model.memory], y[: model.memory]))
    z = np.concatenate([fitted.theta, *starts])
    problem = LatentProblem(fitted.shape, data, z, 0.0 * z)
    return replace(fitted, z=z, loss=problem.loss(z))


def model_of(
    fitted: Fitted, data: Data, scalings: tuple[Scaling, Scaling], margin: float = 1.0
) -> LatentModel:
    """The model that a fit describes, with its noise, memory and bounds from the records."""
    shape, n = fitted.shape, fitted.shape.states
    problem = LatentProblem(shape, data, fitted.z, 0.0 * fitted.z)
    parts = shape.parts(fitted.z)
    states, errors = [], []
    for k, u in enumerate(data.inputs):
        run = latent_run(parts, u, problem.start(fitted.z, k), unbounded(n))
        states.append(run[0])
        errors.append(np.where(data.roots[k] > 0.0, run[2] - data.outputs[k], np.nan))
    seen, error = np.concatenate(states), np.concatenate(errors)
    square, product = error**2, error[1:] * error[:-1]
    noise = np.sqrt(np.nan_to_num(known_mean(square)))
    lagged = np.nan_to_num(known_mean(product)) / np.maximum(noise**2, 1e-30)
    bounds = unbounded(n)
    if shape.hidden:
        low, high = seen.min(axis=0), seen.max(axis=0)
        wide = margin * (high - low) + 1e-9
        bounds = low - wide, high + wide
    pole = float(np.abs(np.linalg.eigvals(parts[0][:n, :n])).max())
    memory = int(np.clip(np.log(0.1) / np.log(np.clip(pole, 1e-3, 0.9999)), 20, 500))
    return LatentModel(
        shape, fitted.theta.copy(), bounds, *scalings, noise, np.clip(lagged, 0, 1),
        memory + max(shape.delay, default=0),
    )  # fmt: skip
