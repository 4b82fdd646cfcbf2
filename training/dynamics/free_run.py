"""The free-run loss of a NARX network over windows of records, and its derivatives.

The loss is the output error of a simulation, not of a one-step prediction: half the mean of
w * (y_sim - y)^2 in scaled units over all scored samples. Windows never cross two records.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from narxcal.narx import kernels
from narxcal.narx.network import NarxModel, Weights, history_before, tap
from narxcal.record import Record
from narxcal.support.arrays import FloatArray, IntArray, sample_and_hold
from training.dynamics.optimisers import Equations

if TYPE_CHECKING:
    from narxcal.narx.module import NarxNet

T = TypeVar("T")
_BLOCK = 1024  # steps whose Jacobian is held at one time
_BATCHES = 4  # parts of the work; more threads than this do not help


@dataclass(frozen=True, eq=False)
class Window:
    """A stretch to simulate: tapped inputs (T, taps * inputs), targets and root weights (T, o).

    `history` (lags * outputs,) holds the measured outputs just before it, newest first.
    """

    tapped: FloatArray
    target: FloatArray
    root_weight: FloatArray
    history: FloatArray


def cut_windows(
    model: NarxModel,
    records: Sequence[Record],
    horizon: int | None,
    stride: int = 1,
    restarts: int = 1,
) -> list[Window]:
    """Cut records into windows of `horizon` steps (None: each record whole), in scaled units.

    A whole record is run from `restarts` places in it, the beginning first, each to its end. Only
    every `stride`-th sample is scored (neighbours are nearly the same); the scored weights are
    normalised so that the loss is a mean over outputs and samples.
    """
    lags = model.config.lags
    windows: list[Window] = []
    for record in records:
        u, y = model.input_scaling.down(record.u), model.output_scaling.down(record.y)
        # A window may start at a masked sample, even of an output that is never known.
        known = np.nan_to_num(np.column_stack([sample_and_hold(column) for column in y.T]))
        tapped = tap(u, model.config.taps)
        root = _root_weight(record, y, stride)
        target = np.where(root > 0, y, 0.0)
        for first, end in _cuts(len(y), horizon, lags, restarts):
            part = slice(first, end)
            past = history_before(known, first, lags)
            windows.append(Window(tapped[part], target[part], root[part], past))
    scored = sum(float((window.root_weight**2).sum()) for window in windows)
    scale = 1.0 / np.sqrt(max(scored, 1e-12))
    return [Window(w.tapped, w.target, w.root_weight * scale, w.history) for w in windows]


def _cuts(length: int, horizon: int | None, lags: int, restarts: int) -> list[tuple[int, int]]:
    """First sample and end of every window of a record."""
    if horizon is None or horizon >= length:
        later = [length * k // restarts for k in range(1, restarts)]
        return [(first, length) for first in (1, *later) if 1 <= first < length]
    return [(first, min(first + horizon, length)) for first in range(lags, length, horizon)]


def _root_weight(record: Record, y: FloatArray, stride: int) -> FloatArray:
    weight = np.ones(len(y)) if record.weight is None else record.weight
    root = np.sqrt(weight)[:, None] * np.isfinite(y)
    if stride > 1:
        root[np.arange(len(y)) % stride != 0] = 0.0
    return root


@dataclass(frozen=True, eq=False)
class _Batch:
    """Several windows end to end, which the kernels run as one."""

    tapped: FloatArray
    target: FloatArray
    root_weight: FloatArray
    positions: IntArray
    histories: FloatArray

    @classmethod
    def of(cls, windows: Sequence[Window]) -> _Batch:
        lengths = np.array([len(window.tapped) for window in windows])
        return cls(
            np.concatenate([window.tapped for window in windows]),
            np.concatenate([window.target for window in windows]),
            np.concatenate([window.root_weight for window in windows]),
            np.concatenate([[0], np.cumsum(lengths)[:-1]]).astype(np.int64),
            np.stack([window.history for window in windows]),
        )


def _batches(windows: Sequence[Window], count: int) -> list[_Batch]:
    """Share windows among `count` batches of about equal length, longest first."""
    shares: list[list[Window]] = [[] for _ in range(count)]
    sizes = [0] * count
    for window in sorted(windows, key=lambda w: -len(w.tapped)):
        k = sizes.index(min(sizes))
        shares[k].append(window)
        sizes[k] += len(window.tapped)
    return [_Batch.of(share) for share in shares if share]


class FreeRunProblem:
    """Loss of `net` over `windows` as a function of its weight vector theta.

    The windows are shared among a fixed number of batches, so that no sum, and hence no weight,
    depends on how many `threads` compute them.
    """

    def __init__(self, net: NarxNet, windows: Sequence[Window], threads: int = 1) -> None:
        self.net = net
        self.threads = threads
        self.batches = _batches(windows, _BATCHES)

    def loss(self, theta: FloatArray) -> float:
        """Half the weighted mean square of the free-run error."""
        weights = self._weights(theta)
        return float(sum(self._map(partial(_loss, weights=weights))))

    def gradient(self, theta: FloatArray) -> tuple[float, FloatArray]:
        """Loss and its gradient by back-propagation through time (for Adam)."""
        weights = self._weights(theta)
        parts = self._map(partial(_loss_and_gradient, weights=weights))
        return sum(loss for loss, _ in parts), self._trained(np.sum([g for _, g in parts], axis=0))

    def normal_equations(self, theta: FloatArray) -> Equations:
        """Loss, gradient and Gauss-Newton matrix by forward sensitivities (for LM)."""
        weights = self._weights(theta)
        parts = self._map(partial(_normal_equations, weights=weights))
        return Equations(
            sum(part.loss for part in parts),
            self._trained(np.sum([part.gradient for part in parts], axis=0)),
            self._trained(self._trained(np.sum([part.hessian for part in parts], axis=0)).T),
        )

    def _trained(self, slopes: FloatArray) -> FloatArray:
        """Slopes (..., P) by weights, zero by those that training leaves alone."""
        return slopes * self.net.trained() if self.net.config.linear_feedback else slopes

    def _weights(self, theta: FloatArray) -> Weights:
        self.net.set_theta(theta)
        return self.net.weights()

    def _map(self, work: Callable[[_Batch], T]) -> list[T]:
        threads = min(self.threads, len(self.batches))
        if threads == 1:
            return [work(batch) for batch in self.batches]
        with ThreadPoolExecutor(threads) as pool:
            return list(pool.map(work, self.batches))


def _run(batch: _Batch, weights: Weights) -> kernels.Run:
    return weights.run(batch.tapped, (batch.positions, batch.histories), keep=True)


def _loss(batch: _Batch, weights: Weights) -> float:
    y = weights.run(batch.tapped, (batch.positions, batch.histories))[0]
    return 0.5 * float((((y - batch.target) * batch.root_weight) ** 2).sum())


def _loss_and_gradient(batch: _Batch, weights: Weights) -> tuple[float, FloatArray]:
    run = _run(batch, weights)
    error = (run[0] - batch.target) * batch.root_weight**2
    loss = 0.5 * float((error * (run[0] - batch.target)).sum())
    adjoint = weights.adjoint(run, batch.positions, error)
    return loss, weights.theta_slopes(batch.tapped, run, adjoint)


def _features(batch: _Batch, fed: FloatArray, weights: Weights) -> tuple[FloatArray, FloatArray]:
    """Phi along a run (T, f), and at rest (see kernels.jacobian)."""
    phi = np.concatenate([fed, batch.tapped], axis=1)
    if not len(weights.fixed):
        return phi, np.empty((0, phi.shape[1]))
    return phi, np.concatenate([np.zeros_like(fed), batch.tapped * weights.fixed], axis=1)


def _normal_equations(batch: _Batch, weights: Weights) -> Equations:
    run = _run(batch, weights)
    features = _features(batch, run[1], weights)
    units, outputs = weights.w2.T.shape
    width = features[0].shape[1]
    size = (units + outputs) * width + units + outputs * units + outputs
    gradient, hessian = np.zeros(size), np.zeros((size, size))
    loss, memory = 0.0, np.zeros((run[1].shape[1] // outputs, outputs, size))
    for first in range(0, len(run[0]), _BLOCK):
        part = slice(first, first + _BLOCK)
        inside = (batch.positions >= first) & (batch.positions < first + _BLOCK)
        root = batch.root_weight[part]
        phi, rest = features
        y, fed, active, resting = run
        j = kernels.jacobian(
            (phi[part], rest[part]),
            (y[part], fed[part], active[part], resting[part]),
            weights.layers,
            (batch.positions[inside] - first, memory),
            (*weights.bounds, root),
        )
        e = ((run[0][part] - batch.target[part]) * root)[root > 0]
        loss += 0.5 * float(e @ e)
        gradient += j.T @ e
        hessian += j.T @ j
    return Equations(loss, gradient, hessian)
