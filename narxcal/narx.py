"""The NARX network: tapped delay lines, one tanh layer, a linear output and a linear path.

Source: papers/narx calibration, section 2.2, equations (1)-(3); the linear path beside the
hidden layer is that of Billings (2013), Nonlinear System Identification, section 3.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from narxcal import kernels
from narxcal.narx_config import NarxConfig

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
AT_START: IntArray = np.zeros(1, dtype=np.int64)
PARAMETER_ORDER = ("hidden.weight", "hidden.bias", "output.weight", "output.bias", "linear.weight")


class NarxNet(nn.Module):
    """One step of the network in scaled units; `low` and `high` (outputs,) bound its output.

    The clamp is the bounded-output guarantee: whatever the input and the history, a free run
    of any length stays inside [low, high].
    """

    low: Tensor
    high: Tensor

    def __init__(self, config: NarxConfig, inputs: int, outputs: int) -> None:
        super().__init__()
        self.config = config
        self.inputs = inputs
        self.outputs = outputs
        width = config.lags * outputs + len(config.taps) * inputs
        self.hidden = nn.Linear(width, config.hidden, dtype=torch.float64)
        self.output = nn.Linear(config.hidden, outputs, dtype=torch.float64)
        self.linear = nn.Linear(width, outputs, bias=False, dtype=torch.float64)
        if config.linear_feedback:
            with torch.no_grad():
                self.hidden.weight[:, : config.lags * outputs] = 0.0
        self.register_buffer("low", torch.full((outputs,), -torch.inf, dtype=torch.float64))
        self.register_buffer("high", torch.full((outputs,), torch.inf, dtype=torch.float64))

    def forward(self, past_y: Tensor, past_u: Tensor) -> Tensor:
        """Predict `(batch, outputs)` from `past_y` (batch, lags, outputs), newest first, and
        `past_u` (batch, taps, inputs), in the order of `config.taps`.
        """  # noqa: D205
        phi = torch.cat([past_y.flatten(1), past_u.flatten(1)], dim=1)
        y = self._unbounded(phi)
        if self.config.moving:
            still_u = past_u.clone()
            still_u[..., : self.config.moving] = 0.0
            rest = torch.cat([torch.zeros_like(past_y).flatten(1), still_u.flatten(1)], dim=1)
            y = y - self._unbounded(rest)
        return torch.clamp(y, self.low, self.high)

    def _unbounded(self, phi: Tensor) -> Tensor:
        value: Tensor = self.output(torch.tanh(self.hidden(phi))) + self.linear(phi)
        return value

    def get_theta(self) -> FloatArray:
        """All weights as one vector (P,), in the order of `PARAMETER_ORDER`."""
        weights = dict(self.named_parameters())
        flat = [weights[name].detach().numpy().ravel() for name in PARAMETER_ORDER]
        return np.concatenate(flat)

    def trained(self) -> FloatArray:
        """1 for each of `get_theta` that training may move (P,), 0 for the others."""
        shares = {name: np.ones(weights.shape) for name, weights in self.named_parameters()}
        if self.config.linear_feedback:
            shares["hidden.weight"][:, : self.config.lags * self.outputs] = 0.0
        return np.concatenate([shares[name].ravel() for name in PARAMETER_ORDER])

    def set_theta(self, theta: FloatArray) -> None:
        """Write the vector of `get_theta` back."""
        weights, at = dict(self.named_parameters()), 0
        with torch.no_grad():
            for name in PARAMETER_ORDER:
                size = weights[name].numel()
                part = torch.from_numpy(np.array(theta[at : at + size]))
                weights[name].copy_(part.reshape(weights[name].shape))
                at += size


def simulate_slowly(net: NarxNet, y_start: Tensor, u: Tensor) -> Tensor:
    """Free run by one PyTorch call a step: the exact twin that tests the compiled kernels.

    `y_start` (batch, n, outputs) are the first n samples, `u` (batch, time, inputs); returns
    (batch, time, outputs) whose first n samples are `y_start`. Before its first sample a
    recording is taken to have stood still.
    """
    lags, taps = net.config.lags, net.config.taps
    y = [y_start[:, k] for k in range(y_start.shape[1])]
    for k in range(len(y), u.shape[1]):
        past_y = torch.stack([y[max(k - j, 0)] for j in range(1, lags + 1)], dim=1)
        past_u = torch.stack([u[:, max(k - d, 0)] for d in taps], dim=1)
        y.append(net(past_y, past_u))
    return torch.stack(y, dim=1)


@dataclass(frozen=True)
class Weights:
    """The network's arrays, split into the feedback and the drive part (see kernels)."""

    w1y: FloatArray
    w1u: FloatArray
    b1: FloatArray
    w2: FloatArray
    b2: FloatArray
    ay: FloatArray
    au: FloatArray
    low: FloatArray
    high: FloatArray
    fixed: FloatArray

    @classmethod
    def of(cls, net: NarxNet) -> Weights:
        """Copy them out of the module."""
        m = net.config.lags * net.outputs
        w1, a = (layer.weight.detach().numpy() for layer in (net.hidden, net.linear))
        return cls(
            w1[:, :m].copy(),
            w1[:, m:].copy(),
            net.hidden.bias.detach().numpy().copy(),
            net.output.weight.detach().numpy().copy(),
            net.output.bias.detach().numpy().copy(),
            a[:, :m].copy(),
            a[:, m:].copy(),
            net.low.numpy().copy(),
            net.high.numpy().copy(),
            _fixed_at_rest(net.config, net.inputs),
        )

    @property
    def feedback(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(W1y, W2, Ay) as the kernels take them."""
        return self.w1y, self.w2, self.ay

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """(low, high) as the kernels take them."""
        return self.low, self.high

    def run(
        self,
        tapped: FloatArray,
        restarts: tuple[IntArray, FloatArray],
        limit: FloatArray | None = None,
    ) -> kernels.Run:
        """Free run over tapped inputs (T, taps * inputs) from `restarts` (see kernels).

        `limit` (T, outputs) bounds the magnitude of the outputs step by step.
        """
        hidden = self.b1 + tapped @ self.w1u.T
        linear = self.b2 + tapped @ self.au.T
        if len(self.fixed):
            rest = tapped * self.fixed
            linear -= self.b2 + self.at_rest(tapped) @ self.w2.T + rest @ self.au.T
        bounds = (self.low, self.high, np.empty((0, len(self.b2))) if limit is None else limit)
        run: kernels.Run = kernels.free_run(hidden, linear, self.feedback, restarts, bounds)
        return run

    def at_rest(self, tapped: FloatArray) -> FloatArray:
        """Tanh activations (T, h) at rest; no rows if the network is not anchored."""
        if not len(self.fixed):
            return np.empty((0, len(self.b1)))
        return np.tanh(self.b1 + (tapped * self.fixed) @ self.w1u.T)


def _fixed_at_rest(config: NarxConfig, inputs: int) -> FloatArray:
    """1 for each tapped input that stays at rest, 0 for one that moves; empty: not anchored."""
    if not config.moving:
        return np.empty(0)
    return np.tile((np.arange(inputs) >= config.moving).astype(np.float64), len(config.taps))


def tap(u: FloatArray, taps: Sequence[int]) -> FloatArray:
    """Delay line: (time, inputs) -> (time, taps * inputs); before its start u stood still."""
    rows = np.arange(len(u))
    return np.concatenate([u[np.maximum(rows - d, 0)] for d in taps], axis=1)


def history_before(y: FloatArray, at: int, lags: int) -> FloatArray:
    """The `lags` outputs before sample `at`, newest first, as one vector (lags * outputs,)."""
    rows = np.maximum(np.arange(at - 1, at - 1 - lags, -1), 0)
    return np.ascontiguousarray(y[rows]).ravel()
