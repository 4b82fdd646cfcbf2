"""The NARX network as a PyTorch module: what training changes, the twin of the compiled kernels.

Source: the calibration paper, section 2.2, equations (1)-(3); the linear path parallel to the
hidden layer is that of Billings (2013), Nonlinear System Identification, section 3.3.
"""

from __future__ import annotations

from typing import Any, Self

import numpy as np
import torch
from torch import Tensor, nn

from narxcal.narx.config import NarxConfig
from narxcal.narx.network import NAMES, Weights
from narxcal.support.arrays import FloatArray

PARAMETER_ORDER = NAMES[:5]  # without the bounds


class NarxNet(nn.Module):
    """One step of the network in scaled units; `low` and `high` (outputs,) bound its output.

    The clamp guarantees a bounded output: whatever the input and the history, a free run of any
    length stays inside [low, high].
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

    @classmethod
    def drawn(cls, config: NarxConfig, width: tuple[int, int], seed: int) -> Self:
        """Draw the weights of `width` (inputs, outputs) by PyTorch's own initialisation.

        The caller's random state is left alone.
        """
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            return cls(config, *width)

    @classmethod
    def of(cls, weights: Weights) -> Self:
        net = cls.drawn(weights.config, (weights.inputs, weights.outputs), seed=0)
        state = {name: torch.from_numpy(array.copy()) for name, array in weights.named().items()}
        net.load_state_dict(state)
        return net

    def weights(self) -> Weights:
        state = {name: value.numpy().copy() for name, value in self.state_dict().items()}
        return Weights.of(self.config, state)

    def forward(self, past_y: Tensor, past_u: Tensor) -> Tensor:
        """Predict `(batch, outputs)` from the past.

        `past_y` is (batch, lags, outputs), newest first, and `past_u` (batch, taps, inputs), in the
        order of `config.taps`.
        """
        phi = torch.cat([past_y.flatten(1), past_u.flatten(1)], dim=1)
        y = self._unbounded(phi)
        if self.config.moving:
            constant_u = past_u.clone()
            constant_u[..., : self.config.moving] = 0.0
            zero_y = torch.zeros_like(past_y).flatten(1)
            y = y - self._unbounded(torch.cat([zero_y, constant_u.flatten(1)], dim=1))
        return torch.clamp(y, self.low, self.high)

    def _unbounded(self, phi: Tensor) -> Tensor:
        value: Tensor = self.output(torch.tanh(self.hidden(phi))) + self.linear(phi)
        return value

    def free_run(self, start: Tensor, u: Tensor) -> Tensor:
        """Run the network on its own outputs; differentiable, for any optimiser and loss.

        `start` (batch, n, outputs) are the first n samples, `u` (batch, time, inputs); returns
        (batch, time, outputs) whose first n samples are `start`. Inputs and outputs are constant
        before their first sample. In double precision on a CPU it is the compiled kernels, forward
        and back; elsewhere it is `free_run_by_steps`.
        """
        if u.device.type != "cpu" or u.dtype != torch.float64:
            return self.free_run_by_steps(start, u)
        (batch, time, _), first = u.shape, start.shape[1]
        rows = torch.arange(first, time)
        tapped = torch.cat([u[:, torch.clamp(rows - d, min=0)] for d in self.config.taps], dim=2)
        past = [max(first - j, 0) for j in range(1, self.config.lags + 1)]
        theta = torch.cat([weights.flatten() for weights in self._ordered()])
        y: Tensor = _FreeRun.apply(  # type: ignore[no-untyped-call]
            theta, tapped.flatten(0, 1), start[:, past].flatten(1), self.weights()
        )
        return torch.cat([start, y.reshape(batch, time - first, -1)], dim=1)

    def _ordered(self) -> list[Tensor]:
        weights = dict(self.named_parameters())
        return [weights[name] for name in PARAMETER_ORDER]

    def free_run_by_steps(self, start: Tensor, u: Tensor) -> Tensor:
        """As `free_run`, by one PyTorch call a step: on any device, in any precision."""
        y = [start[:, k] for k in range(start.shape[1])]
        for k in range(len(y), u.shape[1]):
            past_y = torch.stack([y[max(k - j, 0)] for j in range(1, self.config.lags + 1)], dim=1)
            past_u = torch.stack([u[:, max(k - d, 0)] for d in self.config.taps], dim=1)
            y.append(self(past_y, past_u))
        return torch.stack(y, dim=1)

    def get_theta(self) -> FloatArray:
        """All weights as one vector (P,), in the order of `PARAMETER_ORDER`."""
        return self.weights().theta

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


class _FreeRun(torch.autograd.Function):
    """The compiled free run of windows of equal length, end to end, and its adjoint."""

    @staticmethod
    def forward(ctx: Any, *given: Any) -> Tensor:
        _, tapped, histories, weights = given
        positions = np.arange(len(histories)) * (len(tapped) // max(len(histories), 1))
        restarts = positions, np.ascontiguousarray(histories.numpy())
        run = weights.run(tapped.numpy(), restarts, keep=True)
        ctx.given = weights, tapped.numpy(), run, positions
        return torch.from_numpy(run[0])

    @staticmethod
    def backward(ctx: Any, *outer: Tensor) -> tuple[Tensor | None, ...]:
        weights, tapped, run, positions = ctx.given
        adjoint = weights.adjoint(run, positions, np.ascontiguousarray(outer[0].numpy()))
        found = (
            weights.theta_slopes(tapped, run, adjoint),
            weights.tapped_slopes(adjoint),
            adjoint.before,
        )
        return (*(torch.from_numpy(slope) for slope in found), None)
