"""The NARX network: tapped delay lines, one tanh layer, a linear output and a linear path.

Source: papers/narx calibration, section 2.2, equations (1)-(3); the linear path beside the
hidden layer is that of Billings (2013), Nonlinear System Identification, section 3.3.

A NARX network with its scaling: it simulates and predicts in the units of the records.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor, nn

from narxcal.narx import kernels
from narxcal.narx.config import NarxConfig
from narxcal.support.arrays import FloatArray, IntArray
from narxcal.support.errors import DataError, ModelError

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


@dataclass(frozen=True)
class Scaling:
    """Affine scaling per channel: scaled = (value - centre) / scale."""

    centre: FloatArray
    scale: FloatArray

    @classmethod
    def of(cls, values: FloatArray, *, centred: bool = True) -> Scaling:
        """Fit to (time, channel), NaN left out; a constant channel gets scale 1."""
        spread = np.nanstd(values, axis=0)
        scale = np.where(spread > 1e-9, spread, 1.0)
        centre = np.nanmean(values, axis=0) if centred else np.zeros(values.shape[1])
        return cls(centre, scale)

    def down(self, values: FloatArray) -> FloatArray:
        """To scaled units."""
        return (values - self.centre) / self.scale

    def up(self, values: FloatArray) -> FloatArray:
        """Back to the channel's units."""
        return values * self.scale + self.centre


class NarxModel:
    """A network with its scaling: simulates records in the units they came in.

    Knows nothing of engines: any inputs (time, inputs) and outputs (time, outputs).
    """

    def __init__(self, net: NarxNet, inputs: Scaling, outputs: Scaling) -> None:
        self.net = net
        self.input_scaling = inputs
        self.output_scaling = outputs

    @property
    def config(self) -> NarxConfig:
        """Structure of the network."""
        return self.net.config

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Guaranteed (low, high) of every output in any free run, in the outputs' units."""
        low, high = self.net.low.numpy(), self.net.high.numpy()
        return self.output_scaling.up(low), self.output_scaling.up(high)

    def simulate(self, u: ArrayLike, start: ArrayLike) -> FloatArray:
        """Free run over `u` (time, inputs).

        `start` (n, outputs) or (outputs,) are the first n samples (1 for a vector); they are
        returned as given and everything after is the model's own. Returns (time, outputs).
        """
        inputs, first = self._inputs(u), self._start(start)
        weights = Weights.of(self.net)
        scaled = self.output_scaling.down(first)
        tapped = tap(self.input_scaling.down(inputs), self.config.taps)[len(first) :]
        history = history_before(scaled, len(scaled), self.config.lags)
        y, _, _ = weights.run(tapped, (AT_START, history[None]))
        return np.concatenate([first, self.output_scaling.up(y)])[: len(inputs)]

    def predict(self, u: ArrayLike, y: ArrayLike) -> FloatArray:
        """One-step-ahead prediction (open loop) from measured `y` (time, outputs).

        Sample 0 has no past and is NaN, and so is every sample whose history holds a NaN.
        """
        inputs, measured = self._inputs(u), np.asarray(y, dtype=np.float64)
        if measured.shape != (len(inputs), self.net.outputs):
            raise DataError(
                f"expected outputs of shape {(len(inputs), self.net.outputs)}, "
                f"found {measured.shape}"
            )
        unknown = np.full((1, self.net.outputs), np.nan)
        if len(measured) < 2:
            return unknown[: len(measured)]
        scaled = self.output_scaling.down(measured)
        lags = [history_before(scaled, k, self.config.lags) for k in range(1, len(scaled))]
        past = torch.from_numpy(np.array(lags).reshape(len(lags), self.config.lags, -1))
        tapped = tap(self.input_scaling.down(inputs), self.config.taps)[1:]
        past_u = torch.from_numpy(tapped.reshape(len(lags), len(self.config.taps), -1))
        with torch.no_grad():
            steps = self.net(past, past_u).numpy()
        return np.concatenate([unknown, self.output_scaling.up(steps)])

    def _inputs(self, u: ArrayLike) -> FloatArray:
        inputs = np.asarray(u, dtype=np.float64)
        if inputs.ndim != 2 or inputs.shape[1] != self.net.inputs:
            raise DataError(
                f"expected inputs of shape (time, {self.net.inputs}), found {inputs.shape}"
            )
        unknown = np.flatnonzero(~np.isfinite(inputs).all(axis=1))
        if len(unknown):
            raise DataError(
                "an input is not a finite number",
                row=int(unknown[0]),
                hint="A free run cannot step over a hole: fill it, or cut the record there",
            )
        return inputs

    def _start(self, start: ArrayLike) -> FloatArray:
        first = np.atleast_2d(np.asarray(start, dtype=np.float64))
        if not len(first):
            raise DataError("a free run needs at least one start sample, found none")
        if first.shape[1] != self.net.outputs or not np.isfinite(first).all():
            raise DataError(
                f"expected finite start values of shape (n, {self.net.outputs}), "
                f"found {first.shape} with {int((~np.isfinite(first)).sum())} not finite"
            )
        return first

    def to_arrays(self) -> tuple[dict[str, Any], dict[str, FloatArray]]:
        """Split into JSON-able structure and named arrays, for the bundle."""
        meta = {
            "config": self.config.model_dump(mode="json"),
            "inputs": self.net.inputs,
            "outputs": self.net.outputs,
        }
        arrays = {name: value.numpy().copy() for name, value in self.net.state_dict().items()}
        for name, scaling in (("input", self.input_scaling), ("output", self.output_scaling)):
            arrays[f"{name}_scaling.centre"] = scaling.centre
            arrays[f"{name}_scaling.scale"] = scaling.scale
        return meta, arrays

    @classmethod
    def from_arrays(cls, meta: Mapping[str, Any], arrays: Mapping[str, FloatArray]) -> Self:
        """Rebuild from `to_arrays`; `ModelError` where an array is missing or misshapen."""
        net = NarxNet(NarxConfig.parse(meta["config"]), meta["inputs"], meta["outputs"])
        state = {}
        for name, value in net.state_dict().items():
            found = arrays.get(name)
            if found is None or found.shape != tuple(value.shape):
                shape = None if found is None else found.shape
                raise ModelError(
                    f"weight '{name}' has to be of shape {tuple(value.shape)}, found {shape}"
                )
            state[name] = torch.from_numpy(np.array(found, dtype=np.float64))
        net.load_state_dict(state)
        scalings = [
            Scaling(arrays[f"{name}_scaling.centre"], arrays[f"{name}_scaling.scale"])
            for name in ("input", "output")
        ]
        return cls(net, *scalings)
