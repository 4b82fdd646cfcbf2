"""A NARX network with its scaling: it simulates and predicts in the units of the records."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from narxcal.errors import DataError, ModelError
from narxcal.narx import AT_START, NarxNet, Weights, history_before, tap
from narxcal.narx_config import NarxConfig

FloatArray = NDArray[np.float64]


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
