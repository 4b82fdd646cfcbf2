"""Where the free-run training of a NARX network starts: a stable linear model.

The open-loop least-squares ARX model is one candidate; first-order lags are the others, since
the ARX fit of a smooth recording is often an integrator that a free run cannot use.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from narxcal.narx import NarxNet, history_before, tap
from narxcal.narx_config import NarxConfig
from narxcal.narx_model import NarxModel, Scaling
from narxcal.records import Record
from training.free_run import FreeRunProblem

FloatArray = NDArray[np.float64]
_POLES = (0.0, 0.5, 0.8, 0.9, 0.95, 0.98, 0.995)
_RIDGE = 1e-6


def new_model(records: Sequence[Record], config: NarxConfig, seed: int) -> NarxModel:
    """Scale to the records, bound to their envelope, draw the hidden layer, silence the output.

    Deviations and increments are zero at rest, so an anchored network scales without centring.
    """
    u = np.concatenate([record.u for record in records])
    y = np.concatenate([record.y for record in records])
    outputs = Scaling.of(y, centred=not config.moving)
    inputs = Scaling.of(u)
    inputs.centre[: config.moving] = 0.0
    with torch.random.fork_rng(devices=[]):  # the caller's random numbers are not ours
        torch.manual_seed(seed)
        net = NarxNet(config, u.shape[1], y.shape[1])
    low, high = np.nanmin(y, axis=0), np.nanmax(y, axis=0)
    if config.moving:
        low, high = np.minimum(low, 0.0), np.maximum(high, 0.0)
    margin = config.margin * np.maximum(high - low, 1e-9)
    net.low.copy_(torch.from_numpy(outputs.down(low - margin)))
    net.high.copy_(torch.from_numpy(outputs.down(high + margin)))
    with torch.no_grad():
        for layer in (net.output, net.linear):
            layer.weight.zero_()
        net.output.bias.zero_()
    return NarxModel(net, inputs, outputs)


def start_linear(model: NarxModel, records: Sequence[Record], problem: FreeRunProblem) -> None:
    """Give the linear path of `model` the candidate with the least free-run loss."""
    net, losses, thetas = model.net, [], []
    for linear, bias in _candidates(model, records):
        with torch.no_grad():
            net.linear.weight.copy_(torch.from_numpy(linear))
            net.output.bias.copy_(torch.from_numpy(bias))
        thetas.append(net.get_theta())
        losses.append(problem.loss(thetas[-1]))
    net.set_theta(thetas[int(np.argmin(losses))])


def _candidates(model: NarxModel, records: Sequence[Record]) -> list[tuple[FloatArray, FloatArray]]:
    phi, target = _regression(model, records)
    arx = _least_squares(phi, target, model.config.moving > 0)
    found = [arx]
    outputs = model.net.outputs
    for pole in _POLES:
        lagged = target - pole * phi[:, :outputs]
        rest = phi.copy()
        rest[:, : model.config.lags * outputs] = 0.0
        linear, bias = _least_squares(rest, lagged, model.config.moving > 0)
        linear[:, :outputs] = pole * np.eye(outputs)
        found.append((linear, bias))
    return found


def _regression(model: NarxModel, records: Sequence[Record]) -> tuple[FloatArray, FloatArray]:
    """Phi (n, f) and the next outputs (n, o) over all rows whose history is known."""
    lags, taps, moving = model.config.lags, model.config.taps, model.config.moving
    rows, targets = [], []
    for record in records:
        u, y = model.input_scaling.down(record.u), model.output_scaling.down(record.y)
        if moving:
            u = np.where(np.arange(u.shape[1]) < moving, u, 0.0)
        past = np.array([history_before(y, k, lags) for k in range(lags, len(y))])
        phi = np.concatenate([past, tap(u, taps)[lags:]], axis=1)
        known = np.isfinite(phi).all(axis=1) & np.isfinite(y[lags:]).all(axis=1)
        rows.append(phi[known])
        targets.append(y[lags:][known])
    return np.concatenate(rows), np.concatenate(targets)


def _least_squares(
    phi: FloatArray, target: FloatArray, anchored: bool
) -> tuple[FloatArray, FloatArray]:
    ones = np.zeros((len(phi), 1)) if anchored else np.ones((len(phi), 1))
    matrix = np.concatenate([phi, ones], axis=1)
    normal = matrix.T @ matrix + _RIDGE * len(phi) * np.eye(matrix.shape[1])
    solution = np.linalg.solve(normal, matrix.T @ target).T
    return np.ascontiguousarray(solution[:, :-1]), solution[:, -1].copy()
