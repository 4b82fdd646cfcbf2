"""Noise of a model's prediction and of a sensor, estimated from both by maximum likelihood.

Per channel, in channel units; k counts samples of the sampling interval `dt_s`:

    y[k] = p[k] + b[k]                           the model's error is b
    b[k] = phi b[k-1] + w[k]                     var w = q + g a[k]
    a[k] = rho a[k-1] + (1 - rho) (p[k] - p[k-1])^2
    z[k] = y[k] + v[k]                           var v = r

| symbol | field of `NoiseModel` | meaning | unit |
|---|---|---|---|
| p, y, z | | prediction, truth, measurement | channel |
| phi | `bias_decay` | share of the model's error that lasts to the next sample | - |
| q | `process_variance` | variance of its changes in equilibrium | channel^2 |
| g | `transient_gain` | how far that variance grows with the activity a | - |
| rho | `activity_decay` | share of the activity that lasts to the next sample | - |
| r | `measurement_variance` | variance of the sensor's noise | channel^2 |
| p0 | `initial_variance` | mean square of b, where a filter starts | channel^2 |

phi is fitted to means over a second, the rest to samples: over a few samples the error of a free
run is smooth, which samples alone take for a random walk that never returns to the model.

Process noise grows during transients: a dynamic model's error changes while the engine moves and
shortly after, and hardly in equilibrium. With constant process noise a filter either lags a slam or
follows the noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple, Self

import numpy as np
from scipy.optimize import minimize

from narxcal.support.arrays import BoolArray, FloatArray, known_mean
from narxcal.support.compiled import compiled
from narxcal.support.errors import DataError, ModelError

MIN_SAMPLES = 50
_BLOCK_S = 1.0  # as fast as an engine's outputs respond
# Bounds of log(variance / r): outside them one of the two sources carries no information.
_LOG_RATIO = (-25.0, 15.0)
_LOG_ACTIVITY = float(np.log(100.0))  # longest time constant of the activity, in samples
_STARTS = (-1.0, -4.0, -8.0)
# Fields, and their names in a bundle.
STORED = {
    "bias_decay": "retention",
    "process_variance": "process",
    "transient_gain": "motion",
    "activity_decay": "linger",
    "measurement_variance": "measurement",
    "initial_variance": "spread",
}


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """Noise of `n_out` channels (see the module): arrays (n_out,), valid at `dt_s` only.

    Raises `ModelError` for shapes that differ and values out of range.
    """

    dt_s: float
    bias_decay: FloatArray
    process_variance: FloatArray
    transient_gain: FloatArray
    activity_decay: FloatArray
    measurement_variance: FloatArray
    initial_variance: FloatArray

    def __post_init__(self) -> None:
        shape = (len(self.bias_decay),)
        for name in STORED:
            values, words = getattr(self, name), name.replace("_", " ")
            if values.shape != shape:
                raise ModelError(
                    f"the fuser's {words} should have shape {shape}, found {values.shape}"
                )
            if not np.all(np.isfinite(values)) or np.any(values < 0.0):
                raise ModelError(
                    f"the fuser's {words} must be finite and at least 0, found {values}"
                )
        if not np.all(self.measurement_variance > 0.0):
            raise ModelError("the measurement variance of a fuser must be positive")
        if np.any(self.bias_decay > 1.0) or np.any(self.activity_decay > 1.0):
            raise ModelError("the bias decay and activity decay of a fuser must not exceed 1")

    def to_dict(self) -> dict[str, Any]:
        return {
            "dt_s": self.dt_s,
            **{key: getattr(self, name).tolist() for name, key in STORED.items()},
        }

    @classmethod
    def from_dict(cls, table: Mapping[str, Any]) -> Self:
        """Inverse of `to_dict`; raises `ModelError` where a part is missing or no number."""
        missing = [key for key in ("dt_s", *STORED.values()) if key not in table]
        hint = "Train the model again, or let the fuser estimate its noise from the log"
        if missing:
            raise ModelError(f"the fuser's noise model lacks {', '.join(missing)}", hint=hint)
        try:
            arrays = [np.array(table[key], dtype=float).reshape(-1) for key in STORED.values()]
            dt_s = float(table["dt_s"])
        except (TypeError, ValueError) as error:
            problem = f"the fuser's noise model is no table of numbers: {error}"
            raise ModelError(problem, hint=hint) from None
        return cls(dt_s, *arrays)


@compiled
def activity(before: float, change: float, decay: float) -> float:
    """a[k] from a[k-1] and p[k] - p[k-1]."""
    return decay * before + (1.0 - decay) * change * change


@compiled
def updated(x: float, variance: float, z: float, r: float) -> tuple[float, float]:
    """Estimate and variance of a scalar Kalman filter after measurement `z` of variance `r`."""
    total = variance + r
    return x + variance / total * (z - x), variance * r / total


def estimate_noise(
    measured: FloatArray | Sequence[FloatArray],
    predicted: FloatArray | Sequence[FloatArray],
    dt_s: float,
    names: Sequence[str] = (),
) -> NoiseModel:
    """Estimate a `NoiseModel` from noisy measurements and the free run over the same samples.

    Both are `(time, n_out)`, or several such records; NaN marks a missing measurement. Per channel
    the likelihood is that of the innovations of the scalar Kalman filter (Harvey, Forecasting,
    Structural Time Series Models, 1989, section 3.4) with the measurement variance concentrated
    out, so that the mean normalised innovation squared is one on the data of the estimate.
    """
    z, p = _records(measured), _records(predicted)
    shapes = [a.shape for a in z], [a.shape for a in p]
    if shapes[0] != shapes[1] or not z:
        raise DataError(f"measured and predicted differ in shape: {shapes[0]} against {shapes[1]}")
    starts = np.concatenate([np.arange(len(a)) == 0 for a in z])
    change = np.concatenate([np.diff(a, axis=0, prepend=a[:1]) for a in p])
    deviation = np.concatenate(z) - np.concatenate(p)
    columns = [
        _channel(deviation[:, i], change[:, i], starts, dt_s, names[i] if names else f"number {i}")
        for i in range(deviation.shape[1])
    ]
    return NoiseModel(dt_s, *np.array(columns).T)


def _records(values: FloatArray | Sequence[FloatArray]) -> list[FloatArray]:
    listed = [values] if isinstance(values, np.ndarray) else list(values)
    return [np.asarray(v, dtype=float).reshape(len(v), -1) for v in listed]


def _channel(
    deviation: FloatArray, change: FloatArray, starts: BoolArray, dt_s: float, name: str
) -> tuple[float, float, float, float, float, float]:
    """Estimate the fields of a noise model, in their order there, for one channel `(time,)`."""
    known = np.isfinite(deviation)
    if known.sum() < MIN_SAMPLES:
        raise DataError(
            f"the noise of a channel needs {MIN_SAMPLES} measured samples, found {known.sum()}",
            channel=name,
            hint="Leave the channel out of the fuser, or fuse a longer log",
        )
    square = float(np.mean(deviation[known] ** 2)) + np.finfo(float).tiny
    change_square = float(np.mean(change**2)) + np.finfo(float).tiny
    unit = _Scaled(deviation / np.sqrt(square), change / np.sqrt(change_square), starts)
    size = max(1, min(round(_BLOCK_S / dt_s), int(known.sum()) // MIN_SAMPLES))
    # A bias that lasts longer than the record cannot be distinguished from a constant one.
    longest = np.log(max(4.0, known.sum() / size))
    coarse = _fitted(unit.blocks(size), (np.log(2.0), longest)) if size > 1 else None
    lasting = (np.log(2.0), longest)
    if coarse is not None:
        samples = -float(np.log1p(-(coarse[0] ** (1.0 / size))))
        lasting = (samples, samples)
    best = _fitted(unit, lasting)
    phi, q, g, rho = (float(v) for v in best)
    r = max(float(_likelihood(*unit, best)[1]) * square, np.finfo(float).tiny)
    q *= r
    g *= r / change_square
    return phi, q, g, rho, r, max(square - r, q)


class _Scaled(NamedTuple):
    """Deviation and change of the prediction (time,) in units of their RMS; where records start."""

    deviation: FloatArray
    change: FloatArray
    starts: BoolArray

    def blocks(self, size: int) -> _Scaled:
        """Means of `size` samples of one record, of a constant prediction; NaN where unmeasured."""
        edges = [*np.flatnonzero(self.starts).tolist(), len(self.starts)]
        rows = np.concatenate(
            [np.arange(a, a + (b - a) // size * size) for a, b in pairwise(edges)]
        ).reshape(-1, size)
        return _Scaled(
            known_mean(self.deviation[rows], axis=1),
            np.zeros(len(rows)),
            self.starts[rows[:, 0]],
        )


def _fitted(unit: _Scaled, lasting: tuple[float, float]) -> FloatArray:
    """Phi, q, g and rho of most likelihood; `lasting` bounds the logarithm of 1 / (1 - phi)."""

    def cost(theta: FloatArray) -> float:
        return float(_likelihood(*unit, _parameters(theta))[0])

    first = lasting[0] if lasting[0] == lasting[1] else 0.8 * lasting[1]
    bounds = [lasting, _LOG_RATIO, _LOG_RATIO, (0.0, _LOG_ACTIVITY)]
    fits = [
        minimize(cost, (first, start, start, 1.5), method="L-BFGS-B", bounds=bounds)
        for start in _STARTS
    ]
    return _parameters(min(fits, key=lambda fit: float(fit.fun)).x)


def _parameters(theta: FloatArray) -> FloatArray:
    """Phi, q, g and rho from the logarithms in which the search works."""
    lasting, q, g, activity_s = np.exp(theta)
    return np.array([1.0 - 1.0 / lasting, q, g, 1.0 - 1.0 / activity_s])


@compiled
def _likelihood(
    deviation: FloatArray, change: FloatArray, starts: BoolArray, parameters: FloatArray
) -> tuple[float, float]:
    """Mean concentrated negative log-likelihood, and the measurement variance that maximises it.

    All variances are in units of the measurement's; the first sample of a record has a
    diffuse prior: it sets the state and does not count.
    """
    phi, q, g, rho = parameters
    x, variance, logs, squares, count = 0.0, 0.0, 0.0, 0.0, 0
    a = 0.0
    fresh = True
    for k in range(len(deviation)):
        if starts[k]:
            fresh, a = True, 0.0
        else:
            a = activity(a, change[k], rho)
        if not fresh:
            x *= phi
            variance = phi * phi * variance + q + g * a
        z = deviation[k]
        if np.isnan(z):
            continue
        if fresh:
            x, variance, fresh = z, 1.0, False
            continue
        total = variance + 1.0
        innovation = z - x
        logs += np.log(total)
        squares += innovation * innovation / total
        count += 1
        x, variance = updated(x, variance, z, 1.0)
    scale = squares / max(count, 1) + 1e-30
    return logs / max(count, 1) + np.log(scale), scale
