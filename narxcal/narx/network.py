"""The NARX network as arrays: structure, weights, scaling, free run and one-step prediction.

Nothing here imports PyTorch, so that a stored model runs without it; `narx.module` is the same
network as an `nn.Module`, `narx.kernels` has the compiled recursion and its equations.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike

from narxcal.narx import kernels
from narxcal.narx.config import NarxConfig
from narxcal.support.arrays import FloatArray, IntArray
from narxcal.support.errors import DataError, ModelError

AT_START: IntArray = np.zeros(1, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Weights:
    """The network's arrays in scaled units; symbols and shapes as in `narx.kernels`.

    `w1` (h, f) and `a` (o, f) act on phi, of which the first m entries are fed back.
    """

    config: NarxConfig
    w1: FloatArray
    b1: FloatArray
    w2: FloatArray
    b2: FloatArray
    a: FloatArray
    low: FloatArray
    high: FloatArray

    @classmethod
    def of(cls, config: NarxConfig, arrays: Mapping[str, FloatArray]) -> Self:
        """Take the arrays by their names in the PyTorch module."""
        return cls(config, *(arrays[name] for name in NAMES))

    def named(self) -> dict[str, FloatArray]:
        arrays = (self.w1, self.b1, self.w2, self.b2, self.a, self.low, self.high)
        return dict(zip(NAMES, arrays, strict=True))

    @property
    def outputs(self) -> int:
        return len(self.b2)

    @property
    def inputs(self) -> int:
        width = int(self.w1.shape[1])
        return (width - self.config.lags * self.outputs) // len(self.config.taps)

    @property
    def theta(self) -> FloatArray:
        """All weights as one vector (P,), in the order of `narx.kernels`."""
        arrays = (self.w1, self.b1, self.w2, self.b2, self.a)
        return np.concatenate([array.ravel() for array in arrays])

    @cached_property
    def layers(self) -> kernels.Layers:
        """The arrays as the kernels take them."""
        m, units = self.config.lags * self.outputs, len(self.b1)
        w1, b1, w2 = (_padded(part) for part in (self.w1.T, self.b1, self.w2))
        au, b2, w1r = self.a[:, m:].T.copy(), self.b2, np.empty((0, len(b1)))
        if len(self.fixed):
            w1r, au, b2 = w1[m:] * self.fixed[:, None], au * (1.0 - self.fixed[:, None]), 0.0 * b2
        return kernels.Layers(w1[:m], w1[m:], w1r, b1, w2, self.a[:, :m].copy(), au, b2, units)

    @cached_property
    def fixed(self) -> FloatArray:
        """1 for each tapped input that is not zero in equilibrium; empty: not anchored."""
        if not self.config.moving:
            return np.empty(0)
        constant = (np.arange(self.inputs) >= self.config.moving).astype(np.float64)
        return np.tile(constant, len(self.config.taps))

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """(low, high) as the kernels take them."""
        return self.low, self.high

    def run(
        self,
        tapped: FloatArray,
        restarts: tuple[IntArray, FloatArray],
        limit: FloatArray | None = None,
        *,
        keep: bool = False,
    ) -> kernels.Run:
        """Free run over tapped inputs (T, taps * inputs) from `restarts` (see kernels).

        `limit` (T, outputs) bounds the magnitude of the outputs step by step. Only with `keep` are
        there activations, which derivatives take.
        """
        bounds = (self.low, self.high, np.empty((0, self.outputs)) if limit is None else limit)
        return kernels.free_run(np.ascontiguousarray(tapped), self.layers, restarts, bounds, keep)

    def adjoint(self, run: kernels.Run, positions: IntArray, outer: FloatArray) -> Adjoint:
        """Back-propagate `outer`, dLoss/d(outputs) (T, o), through a run that kept activations."""
        total, hidden, before = kernels.adjoint(outer, run, self.layers, positions, self.bounds)
        resting = (total @ self.layers.w2) * (run[3] ** 2 - 1.0) if len(self.fixed) else None
        return Adjoint(total, hidden, resting, before)

    def theta_slopes(self, tapped: FloatArray, run: kernels.Run, adjoint: Adjoint) -> FloatArray:
        """Slopes of the loss by theta (P,)."""
        (_, fed, active, at_rest), units = run, self.layers.units
        total, hidden = adjoint.total, adjoint.hidden
        ones = np.ones(len(tapped))  # by a product: sums over columns are slower
        by_w1u, by_b1, by_b2, moving = hidden.T @ tapped, ones @ hidden, ones @ total, tapped
        if adjoint.resting is not None:
            active, moving = active - at_rest, tapped * (1.0 - self.fixed)
            by_w1u += adjoint.resting.T @ (tapped * self.fixed)
            by_b1, by_b2 = by_b1 + ones @ adjoint.resting, 0.0 * by_b2
        by_w1 = np.concatenate([hidden.T @ fed, by_w1u], axis=1)[:units]
        by_a = np.concatenate([total.T @ fed, total.T @ moving], axis=1)
        parts = by_w1, by_b1[:units], (total.T @ active)[:, :units], by_b2, by_a
        return np.concatenate([part.ravel() for part in parts])

    def tapped_slopes(self, adjoint: Adjoint) -> FloatArray:
        """Slopes of the loss by the tapped inputs (T, taps * inputs)."""
        slopes = adjoint.hidden @ self.layers.w1u.T + adjoint.total @ self.layers.au.T
        if adjoint.resting is not None:
            slopes += adjoint.resting @ self.layers.w1r.T
        return slopes


@dataclass(frozen=True, eq=False)
class Adjoint:
    """Slopes of a loss along a run: by outputs, hidden layer (at rest: None without) and histories.

    Shapes (T, o), (T, H), (T, H) and (n, m), with the symbols of `narx.kernels`.
    """

    total: FloatArray
    hidden: FloatArray
    resting: FloatArray | None
    before: FloatArray


def _padded(weights: FloatArray) -> FloatArray:
    """Weights (..., h) with units of zero weight up to a multiple of what the kernels take."""
    units = weights.shape[-1]
    padded = np.zeros((*weights.shape[:-1], units + -units % kernels.PADDING))
    padded[..., :units] = weights
    return padded


NAMES = (
    "hidden.weight", "hidden.bias", "output.weight", "output.bias", "linear.weight", "low", "high",
)  # fmt: skip


# A channel that moves less is constant.
_SMALLEST_SPREAD = 1e-9


def tap(u: FloatArray, taps: Sequence[int]) -> FloatArray:
    """Delay line: (time, inputs) -> (time, taps * inputs); u is constant before its start."""
    tapped = np.empty((len(u), len(taps), u.shape[1]))
    for k, d in enumerate(taps):
        tapped[:d, k], tapped[d:, k] = u[:1], u[: max(len(u) - d, 0)]
    return tapped.reshape(len(u), -1)


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
        scale = np.where(spread > _SMALLEST_SPREAD, spread, 1.0)
        centre = np.nanmean(values, axis=0) if centred else np.zeros(values.shape[1])
        return cls(centre, scale)

    @classmethod
    def stored(cls, arrays: Mapping[str, FloatArray], name: str) -> Scaling:
        """Rebuild from the arrays `name.centre` and `name.scale`.

        Raises `ModelError` for what `of` cannot give: a scale below its smallest, or a centre so
        many scales away that a scaled value has no digit left.
        """
        centre, scale = arrays[f"{name}.centre"], arrays[f"{name}.scale"]
        if not (scale >= _SMALLEST_SPREAD).all():
            found = f"found {scale.min()}"
            raise ModelError(f"'{name}.scale' has to be at least {_SMALLEST_SPREAD}, {found}")
        if (np.abs(centre) > scale / np.finfo(np.float64).eps).any():
            raise ModelError(f"'{name}.centre' is too large for its scale to leave a digit")
        return cls(centre, scale)

    def named(self, name: str) -> dict[str, FloatArray]:
        """Arrays by the names under which a model stores them."""
        return {f"{name}.centre": self.centre, f"{name}.scale": self.scale}

    def down(self, values: FloatArray) -> FloatArray:
        return (values - self.centre) / self.scale

    def up(self, values: FloatArray) -> FloatArray:
        return values * self.scale + self.centre


def checked_inputs(u: ArrayLike, count: int) -> FloatArray:
    """Inputs (time, count) of a free run; raises `DataError` for another shape and for a hole."""
    inputs = np.asarray(u, dtype=np.float64)
    if inputs.ndim != 2 or inputs.shape[1] != count:
        raise DataError(f"expected inputs of shape (time, {count}), found {inputs.shape}")
    unknown = np.flatnonzero(~np.isfinite(inputs).all(axis=1))
    if len(unknown):
        raise DataError(
            "an input is not a finite number",
            row=int(unknown[0]),
            hint="A free run cannot step over a hole: fill it, or cut the record there",
        )
    return inputs


def checked_start(start: ArrayLike, count: int) -> FloatArray:
    """First samples (n, count) of a free run; raises `DataError` for another shape and for NaN."""
    first = np.atleast_2d(np.asarray(start, dtype=np.float64))
    if not len(first):
        raise DataError("a free run needs at least one start sample, found none")
    if first.shape[1] != count or not np.isfinite(first).all():
        raise DataError(
            f"expected finite start values of shape (n, {count}), "
            f"found {first.shape} with {int((~np.isfinite(first)).sum())} not finite"
        )
    return first


class TrainedNetwork(Protocol):
    """A network whose arrays training changes (`narx.module`)."""

    config: NarxConfig
    inputs: int
    outputs: int

    def weights(self) -> Weights: ...


class NarxModel:
    """A network with its scaling: simulates records in the units they came in.

    Inputs (time, inputs) and outputs (time, outputs) may be any; nothing here is about engines.
    """

    def __init__(
        self, network: Weights | TrainedNetwork, inputs: Scaling, outputs: Scaling
    ) -> None:
        self.network = network
        self.input_scaling = inputs
        self.output_scaling = outputs

    @property
    def weights(self) -> Weights:
        return self.network if isinstance(self.network, Weights) else self.network.weights()

    @property
    def config(self) -> NarxConfig:
        return self.network.config

    @property
    def inputs(self) -> int:
        return self.network.inputs

    @property
    def outputs(self) -> int:
        return self.network.outputs

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Guaranteed (low, high) of every output in any free run, in the outputs' units."""
        low, high = self.weights.bounds
        return self.output_scaling.up(low), self.output_scaling.up(high)

    def simulate(self, u: ArrayLike, start: ArrayLike) -> FloatArray:
        """Free run over `u` (time, inputs).

        `start` (n, outputs) or (outputs,) are the first n samples (1 for a vector); they are
        returned as given and everything after is the model's own. Returns (time, outputs).
        """
        inputs, first = checked_inputs(u, self.inputs), checked_start(start, self.outputs)
        scaled = self.output_scaling.down(first)
        tapped = tap(self.input_scaling.down(inputs), self.config.taps)[len(first) :]
        history = history_before(scaled, len(scaled), self.config.lags)
        y = self.weights.run(tapped, (AT_START, history[None]))[0]
        return np.concatenate([first, self.output_scaling.up(y)])[: len(inputs)]

    def predict(self, u: ArrayLike, y: ArrayLike, steps: int = 1) -> FloatArray:
        """Prediction `steps` ahead (one: open loop) from measured `y` (time, outputs).

        The first `steps` samples have no past and are NaN, and so is every sample whose history
        holds a NaN.
        """
        inputs, measured = checked_inputs(u, self.inputs), np.asarray(y, dtype=np.float64)
        if measured.shape != (len(inputs), self.outputs):
            raise DataError(
                f"expected outputs of shape {(len(inputs), self.outputs)}, found {measured.shape}"
            )
        result = np.full(measured.shape, np.nan)
        origins = np.arange(len(measured) - steps)
        if not len(origins):
            return result
        scaled, lags = self.output_scaling.down(measured), self.config.lags
        past = scaled[np.maximum(origins[:, None] - np.arange(lags), 0)].reshape(len(origins), -1)
        tapped = tap(self.input_scaling.down(inputs), self.config.taps)
        known = np.isfinite(past).all(axis=1)
        for step in range(1, steps + 1):
            # A free run of one sample that starts anew from the past of every origin.
            ahead = self.weights.run(tapped[step:][: len(origins)], (origins, past))[0]
            past = np.hstack([ahead, past[:, : -self.outputs]])
        result[steps:][known] = self.output_scaling.up(ahead)[known]
        return result

    def to_arrays(self) -> tuple[dict[str, Any], dict[str, FloatArray]]:
        meta = {
            "config": self.config.model_dump(mode="json"),
            "inputs": self.inputs,
            "outputs": self.outputs,
        }
        arrays = {name: array.copy() for name, array in self.weights.named().items()}
        arrays |= self.input_scaling.named("input_scaling")
        arrays |= self.output_scaling.named("output_scaling")
        return meta, arrays

    @classmethod
    def from_arrays(cls, meta: Mapping[str, Any], arrays: Mapping[str, FloatArray]) -> Self:
        """Rebuild from `to_arrays`; `ModelError` where an array is missing or unusable."""
        config = NarxConfig.parse(meta["config"])
        shapes = _shapes(config, int(meta["inputs"]), int(meta["outputs"]))
        kept = shaped(arrays, shapes, "weight")
        scalings = (Scaling.stored(kept, f"{name}_scaling") for name in ("input", "output"))
        return cls(Weights.of(config, kept), *scalings)


def shaped(
    arrays: Mapping[str, FloatArray],
    shapes: Mapping[str, tuple[int, ...]],
    what: str,
) -> dict[str, FloatArray]:
    """Copy stored arrays; raises `ModelError` for `what` is missing or of another shape."""
    kept = {}
    for name, shape in shapes.items():
        found = arrays.get(name)
        if found is None or found.shape != shape:
            given = None if found is None else found.shape
            problem = f"{what} '{name}' has to be of shape {shape}, found {given}"
            raise ModelError(problem)
        kept[name] = np.array(found, dtype=np.float64)
    return kept


def _shapes(config: NarxConfig, inputs: int, outputs: int) -> dict[str, tuple[int, ...]]:
    width = config.lags * outputs + len(config.taps) * inputs
    return {
        "hidden.weight": (config.hidden, width),
        "hidden.bias": (config.hidden,),
        "output.weight": (outputs, config.hidden),
        "output.bias": (outputs,),
        "linear.weight": (outputs, width),
        "low": (outputs,),
        "high": (outputs,),
        "input_scaling.centre": (inputs,),
        "input_scaling.scale": (inputs,),
        "output_scaling.centre": (outputs,),
        "output_scaling.scale": (outputs,),
    }
