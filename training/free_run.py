"""The free-run loss of a NARX network over windows of records, and its derivatives.

The loss is the output error of a simulation, not of a one-step prediction: half the mean of
w * (y_sim - y)^2 in scaled units over all scored samples. Windows never cross two records.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from narxcal import kernels
from narxcal.narx import NarxModel, NarxNet, Weights, history_before, tap
from narxcal.records import Record

FloatArray = NDArray[np.float64]
_BLOCK = 1024  # steps whose Jacobian is held at one time


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
    model: NarxModel, records: Sequence[Record], horizon: int | None, stride: int = 1
) -> list[Window]:
    """Cut records into windows of `horizon` steps (None: each record whole), in scaled units.

    Only every `stride`-th sample is scored (neighbours tell nearly the same); the scored
    weights are normalised so that the loss is a mean over outputs and samples.
    """
    lags = model.config.lags
    windows: list[Window] = []
    for record in records:
        u, y = model.input_scaling.down(record.u), model.output_scaling.down(record.y)
        tapped, known = tap(u, model.config.taps), _hold(y)
        root = _root_weight(record, y, stride)
        target = np.where(root > 0, y, 0.0)
        length = horizon or len(y)
        for first in range(1 if length >= len(y) else lags, len(y), length):
            part = slice(first, min(first + length, len(y)))
            past = history_before(known, first, lags)
            windows.append(Window(tapped[part], target[part], root[part], past))
    scored = sum(float((window.root_weight**2).sum()) for window in windows)
    scale = 1.0 / np.sqrt(max(scored, 1e-12))
    return [
        Window(w.tapped, w.target, w.root_weight * scale, w.history) for w in windows
    ]


def _root_weight(record: Record, y: FloatArray, stride: int) -> FloatArray:
    weight = np.ones(len(y)) if record.weight is None else record.weight
    root = np.sqrt(weight)[:, None] * np.isfinite(y)
    if stride > 1:
        root[np.arange(len(y)) % stride != 0] = 0.0
    return root


def _hold(y: FloatArray) -> FloatArray:
    """Carry the last known output over masked samples, so that a window can start there."""
    held = y.copy()
    for column in held.T:
        known = np.flatnonzero(np.isfinite(column))
        if len(known) == 0:
            column[:] = 0.0
            continue
        last = np.searchsorted(known, np.arange(len(column)), side="right") - 1
        column[:] = column[known[np.maximum(last, 0)]]
    return held


@dataclass(frozen=True)
class NormalEquations:
    """Gauss-Newton at one point: loss, gradient (P,) and J'J (P, P)."""

    loss: float
    gradient: FloatArray
    hessian: FloatArray


class FreeRunProblem:
    """Loss of `net` over `windows` as a function of its weight vector theta."""

    def __init__(self, net: NarxNet, windows: Sequence[Window], threads: int = 1) -> None:
        self.net = net
        self.windows = list(windows)
        self.threads = threads

    def loss(self, theta: FloatArray) -> float:
        """Half the weighted mean square of the free-run error."""
        weights = self._weights(theta)
        return float(sum(self._map(partial(_loss, weights=weights))))

    def gradient(self, theta: FloatArray) -> tuple[float, FloatArray]:
        """Loss and its gradient by back-propagation through time (for Adam)."""
        weights = self._weights(theta)
        parts = self._map(partial(_loss_and_gradient, weights=weights))
        return sum(loss for loss, _ in parts), np.sum([g for _, g in parts], axis=0)

    def normal_equations(self, theta: FloatArray) -> NormalEquations:
        """Loss, gradient and Gauss-Newton matrix by forward sensitivities (for LM)."""
        weights = self._weights(theta)
        parts = self._map(partial(_normal_equations, weights=weights))
        return NormalEquations(
            sum(part.loss for part in parts),
            np.sum([part.gradient for part in parts], axis=0),
            np.sum([part.hessian for part in parts], axis=0),
        )

    def _weights(self, theta: FloatArray) -> Weights:
        self.net.set_theta(theta)
        return Weights.of(self.net)

    def _map(self, work: partial) -> list:  # type: ignore[type-arg]
        if self.threads == 1 or len(self.windows) == 1:
            return [work(window) for window in self.windows]
        with ThreadPoolExecutor(self.threads) as pool:
            return list(pool.map(work, self.windows))


def _loss(window: Window, weights: Weights) -> float:
    y, _ = weights.run(window.tapped, window.history.copy())
    return 0.5 * float((((y - window.target) * window.root_weight) ** 2).sum())


def _features(
    window: Window, y: FloatArray, weights: Weights
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Phi along a run (T, f), and phi and activations at rest (see kernels.jacobian)."""
    outputs = y.shape[1]
    lags = weights.w1y.shape[1] // outputs
    start = window.history.reshape(lags, outputs)[::-1]
    longer = np.concatenate([start, y])
    fed = [longer[lags - j : len(longer) - j] for j in range(1, lags + 1)]
    phi = np.concatenate([*fed, window.tapped], axis=1)
    rest_active = weights.at_rest(window.tapped)
    if not len(rest_active):
        return phi, np.empty((0, phi.shape[1])), rest_active
    still = np.zeros((len(y), lags * outputs))
    return phi, np.concatenate([still, window.tapped * weights.fixed], axis=1), rest_active


def _loss_and_gradient(window: Window, weights: Weights) -> tuple[float, FloatArray]:
    y, active = weights.run(window.tapped, window.history.copy())
    error = (y - window.target) * window.root_weight**2
    loss = 0.5 * float((error * (y - window.target)).sum())
    total, hidden, _ = kernels.adjoint(error, (y, active), weights.feedback, weights.bounds)
    phi, rest, rest_active = _features(window, y, weights)
    parts = [hidden.T @ phi, hidden.sum(0), total.T @ active, total.sum(0), total.T @ phi]
    if len(rest):
        back = (total @ weights.w2) * (1.0 - rest_active**2)
        parts[0] = parts[0] - back.T @ rest
        parts[1] = parts[1] - back.sum(0)
        parts[2] = parts[2] - total.T @ rest_active
        parts[3] = np.zeros_like(parts[3])
        parts[4] = parts[4] - total.T @ rest
    return loss, np.concatenate([part.ravel() for part in parts])


def _normal_equations(window: Window, weights: Weights) -> NormalEquations:
    y, active = weights.run(window.tapped, window.history.copy())
    phi, rest, rest_active = _features(window, y, weights)
    units, outputs = weights.w2.T.shape
    size = (units + outputs) * phi.shape[1] + units + outputs * units + outputs
    loss, gradient, hessian = 0.0, np.zeros(size), np.zeros((size, size))
    memory = np.zeros((len(window.history), size))
    for first in range(0, len(y), _BLOCK):
        part = slice(first, first + _BLOCK)
        features = (phi[part], rest[part], rest_active[part])
        jacobian = kernels.jacobian(
            features, (y[part], active[part]), weights.feedback, weights.bounds, memory
        )
        root = window.root_weight[part].ravel()
        scored = root > 0
        j = jacobian.reshape(-1, size)[scored] * root[scored, None]
        e = (y[part] - window.target[part]).ravel()[scored] * root[scored]
        loss += 0.5 * float(e @ e)
        gradient += j.T @ e
        hessian += j.T @ j
    return NormalEquations(loss, gradient, hessian)
