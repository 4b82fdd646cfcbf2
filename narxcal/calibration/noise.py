"""How far a model's prediction and a sensor may be trusted, estimated from both by likelihood."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Self

import numba
import numpy as np
from scipy.optimize import minimize

from narxcal.support.arrays import BoolArray, FloatArray
from narxcal.support.errors import DataError, ModelError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


MIN_SAMPLES = 50
# Bounds of log(variance / R): outside them one of the two sources carries no information.
_LOG_RATIO = (-25.0, 15.0)
_LOG_LINGER = np.log(100.0)  # samples that a move may be felt
_STARTS = (-1.0, -4.0, -8.0)


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """Noise of `n_out` channels: prediction `p`, truth `y`, measurement `z`, all in channel units.

    ```
    y[k] = p[k] + b[k]                       the model is off by b
    b[k] = retention * b[k-1] + w[k]         var w = process + motion * a[k]
    a[k] = linger * a[k-1] + (1 - linger) * (p[k] - p[k-1])**2
    z[k] = y[k] + v[k]                       var v = measurement
    ```

    The error of a dynamic model grows while the engine moves, and a little after, and hardly
    changes while it is settled; `motion` and the activity `a` say so. Without them a filter
    either lags a slam or follows the noise.
    `spread` is the mean square of `b`, where a filter starts. `correlation` `(n_out, n_out)` is
    that of `w` between channels. All others are `(n_out,)`, and hold at the raster `dt_s` only.
    """

    dt_s: float
    retention: FloatArray
    process: FloatArray
    motion: FloatArray
    linger: FloatArray
    measurement: FloatArray
    spread: FloatArray
    correlation: FloatArray

    def __post_init__(self) -> None:
        n_out = len(self.retention)
        for name in ("retention", "process", "motion", "linger", "measurement", "spread"):
            _check(name, getattr(self, name), (n_out,))
        _check("correlation", self.correlation, (n_out, n_out), low=-1.0)
        if not np.all(self.measurement > 0.0):
            raise ModelError("the measurement variance of a fuser must be positive")
        if np.any(self.retention > 1.0) or np.any(self.linger > 1.0):
            raise ModelError("the retention and linger of a fuser must not exceed 1")

    def activity(self, before: FloatArray, moved: FloatArray) -> FloatArray:
        """a[k] `(n_out,)` from a[k-1] and the prediction's move since then."""
        return self.linger * before + (1.0 - self.linger) * moved * moved

    def process_covariance(self, activity: FloatArray) -> FloatArray:
        """Q `(n_out, n_out)` of a step at which the activity is `activity` `(n_out,)`."""
        deviation = np.sqrt(self.process + self.motion * activity)
        covariance: FloatArray = self.correlation * np.outer(deviation, deviation)
        return covariance

    def to_dict(self) -> dict[str, Any]:
        """Plain lists and numbers, for a bundle's JSON."""
        return {f.name: np.asarray(getattr(self, f.name)).tolist() for f in fields(self)}

    @classmethod
    def from_dict(cls, table: Mapping[str, Any]) -> Self:
        """Inverse of `to_dict`; raises `ModelError` where a part is missing."""
        missing = [f.name for f in fields(cls) if f.name not in table]
        if missing:
            raise ModelError(
                f"the fuser's noise model lacks {', '.join(missing)}",
                hint="Train the model again, or let the fuser estimate its noise from the log",
            )
        arrays = [np.asarray(table[f.name], dtype=float) for f in fields(cls)[1:]]
        return cls(float(table["dt_s"]), *arrays)


def _check(name: str, values: FloatArray, shape: tuple[int, ...], low: float = 0.0) -> None:
    if values.shape != shape:
        raise ModelError(f"the fuser's {name} should have shape {shape}, found {values.shape}")
    if not np.all(np.isfinite(values)) or np.any(values < low):
        raise ModelError(f"the fuser's {name} must be finite and at least {low:g}, found {values}")


def estimate_noise(
    measured: FloatArray | Sequence[FloatArray],
    predicted: FloatArray | Sequence[FloatArray],
    dt_s: float,
    names: Sequence[str] = (),
) -> NoiseModel:
    """Maximum-likelihood `NoiseModel` from the noisy measurement and the free run beside it.

    Both are `(time, n_out)`, or several such records; NaN marks a missing measurement. Per channel
    the likelihood is that of the innovations of the scalar Kalman filter (Harvey, Forecasting,
    Structural Time Series Models, 1989, section 3.4) with the measurement variance concentrated
    out, so that the mean normalised innovation squared is one on the data it was estimated from.
    Correlations between the channels follow in `correlate`.

    Raises `DataError` where a channel has too few measured samples.
    """
    z, p = _records(measured), _records(predicted)
    shapes = [a.shape for a in z], [a.shape for a in p]
    if shapes[0] != shapes[1] or not z:
        raise DataError(f"measured and predicted differ in shape: {shapes[0]} against {shapes[1]}")
    starts = np.concatenate([np.arange(len(a)) == 0 for a in z])
    moved = np.concatenate([np.diff(a, axis=0, prepend=a[:1]) for a in p])
    deviation = np.concatenate(z) - np.concatenate(p)
    columns = [
        _channel(deviation[:, i], moved[:, i], starts, names[i] if names else f"number {i}")
        for i in range(deviation.shape[1])
    ]
    retention, process, motion, linger, measurement, spread = np.array(columns).T
    unrelated = np.eye(deviation.shape[1])
    return NoiseModel(dt_s, retention, process, motion, linger, measurement, spread, unrelated)


def _records(values: FloatArray | Sequence[FloatArray]) -> list[FloatArray]:
    listed = [values] if isinstance(values, np.ndarray) else list(values)
    return [np.asarray(v, dtype=float).reshape(len(v), -1) for v in listed]


def _channel(
    deviation: FloatArray, moved: FloatArray, starts: BoolArray, name: str
) -> tuple[float, float, float, float, float, float]:
    """Find the parts of a noise model, in their order there, for one channel `(time,)`."""
    known = np.isfinite(deviation)
    if known.sum() < MIN_SAMPLES:
        raise DataError(
            f"the noise of a channel needs {MIN_SAMPLES} measured samples, found {known.sum()}",
            channel=name,
            hint="Leave the channel out of the fuser, or fuse a longer log",
        )
    square = float(np.mean(deviation[known] ** 2)) + np.finfo(float).tiny
    motion_square = float(np.mean(moved**2)) + np.finfo(float).tiny
    unit = deviation / np.sqrt(square), moved / np.sqrt(motion_square), starts

    def cost(theta: FloatArray) -> float:
        return float(_likelihood(*unit, _parameters(theta))[0])

    # A bias that lives longer than the record cannot be told from a constant one.
    memory = np.log(max(4.0, float(known.sum())))
    bounds = [(np.log(2.0), memory), _LOG_RATIO, _LOG_RATIO, (0.0, _LOG_LINGER)]
    fits = [
        minimize(cost, (0.8 * memory, start, start, 1.5), method="L-BFGS-B", bounds=bounds)
        for start in _STARTS
    ]
    best = _parameters(min(fits, key=lambda fit: float(fit.fun)).x)
    retention, process, motion, linger = (float(v) for v in best)
    measurement = max(float(_likelihood(*unit, best)[1]) * square, np.finfo(float).tiny)
    process *= measurement
    motion *= measurement / motion_square
    return retention, process, motion, linger, measurement, max(square - measurement, process)


def _parameters(theta: FloatArray) -> FloatArray:
    """Retention, process, motion and linger from what the search works in: logarithms."""
    memory, process, motion, lasting = np.exp(theta)
    return np.array([1.0 - 1.0 / memory, process, motion, 1.0 - 1.0 / lasting])


def _likelihood_loop(
    deviation: FloatArray, moved: FloatArray, starts: BoolArray, parameters: FloatArray
) -> tuple[float, float]:
    """Mean concentrated negative log-likelihood, and the measurement variance that maximises it.

    All variances are in units of the measurement's; the first sample of a record has a
    diffuse prior: it sets the state and does not count.
    """
    retention, process, motion, linger = parameters
    state, variance, logs, squares, count = 0.0, 0.0, 0.0, 0.0, 0
    activity = 0.0
    fresh = True
    for k in range(len(deviation)):
        if starts[k]:
            fresh, activity = True, 0.0
        else:
            activity = linger * activity + (1.0 - linger) * moved[k] * moved[k]
        if not fresh:
            state *= retention
            variance = retention * retention * variance + process + motion * activity
        z = deviation[k]
        if np.isnan(z):
            continue
        if fresh:
            state, variance, fresh = z, 1.0, False
            continue
        total = variance + 1.0
        innovation = z - state
        logs += np.log(total)
        squares += innovation * innovation / total
        count += 1
        state += variance / total * innovation
        variance /= total
    scale = squares / max(count, 1) + 1e-30
    return logs / max(count, 1) + np.log(scale), scale


_likelihood = numba.njit(cache=True)(_likelihood_loop)
