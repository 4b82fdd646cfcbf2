"""The Kalman fuser compiled for streams: the same numbers as `KalmanFuser`, a tenth of the time."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

from narxcal.errors import ModelError
from narxcal.fuser import FusedRun, FusedStep, check_record, check_sample, chi2_quantile
from narxcal.fuser_config import FuserConfig
from narxcal.fuser_noise import NoiseModel

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
_F = TypeVar("_F", bound=Callable[..., object])


def _compile(function: _F) -> _F:
    return cast("_F", njit(cache=True, nogil=True)(function))


class _State(NamedTuple):
    """What a step changes in place; `streak` counts rejections in a row."""

    x: FloatArray
    P: FloatArray
    last: FloatArray
    activity: FloatArray
    streak: FloatArray


class _Settings(NamedTuple):
    """The noise model, the gate in chi-square units and the rejections in a row it may last."""

    retention: FloatArray
    process: FloatArray
    motion: FloatArray
    linger: FloatArray
    measurement: FloatArray
    correlation: FloatArray
    gate: float
    patience: float


class _Out(NamedTuple):
    """The arrays of a `FusedRun`, to be filled."""

    values: FloatArray
    innovations: FloatArray
    variances: FloatArray
    gated: BoolArray
    relocked: BoolArray
    nis: FloatArray
    used: NDArray[np.int64]


class FastFuser:
    """Compiled twin of `KalmanFuser`, for replays at hundreds of times real time.

    R is diagonal, so the measured channels are taken in one after the other; that is the joint
    update exactly (Bar-Shalom et al., 2001, section 5.2), and needs no inverse.
    """

    def __init__(self, noise: NoiseModel, config: FuserConfig | None = None) -> None:
        config = config or FuserConfig()
        self.noise = noise
        self.n_out = len(noise.retention)
        self.gated_samples = np.zeros(self.n_out, dtype=np.int64)
        self._settings = _Settings(
            noise.retention,
            noise.process,
            noise.motion,
            noise.linger,
            noise.measurement,
            noise.correlation,
            chi2_quantile(config.gate_probability, 1),
            float(max(1, round(config.relock_s / noise.dt_s))),
        )
        self._state: _State | None = None

    def reset(self, prediction: FloatArray, measurement: FloatArray) -> FusedStep:
        """See `KalmanFuser.reset`."""
        prediction, measurement = check_sample(prediction, measurement, self.n_out)
        self._start(prediction)
        return _first(self._fuse(prediction[None], measurement[None], fresh=True))

    def step(self, prediction: FloatArray, measurement: FloatArray) -> FusedStep:
        """See `KalmanFuser.step`."""
        prediction, measurement = check_sample(prediction, measurement, self.n_out)
        return _first(self._fuse(prediction[None], measurement[None], fresh=False))

    def extend(self, predictions: FloatArray, measurements: FloatArray) -> FusedRun:
        """See `KalmanFuser.extend`."""
        check_record(predictions, measurements, self.n_out)
        return self._fuse(predictions, measurements, fresh=False)

    def run(self, predictions: FloatArray, measurements: FloatArray) -> FusedRun:
        """See `KalmanFuser.run`."""
        check_record(predictions, measurements, self.n_out)
        self._start(predictions[0])
        return self._fuse(predictions, measurements, fresh=True)

    def _start(self, prediction: FloatArray) -> None:
        self._state = _State(
            prediction.copy(),
            np.diag(self.noise.spread),
            prediction.copy(),
            np.zeros(self.n_out),
            np.zeros(self.n_out),
        )

    def _fuse(self, predictions: FloatArray, measurements: FloatArray, fresh: bool) -> FusedRun:
        if self._state is None:
            raise ModelError("the fuser has no past", hint="Call reset with the first sample")
        if not np.isfinite(predictions).all():
            bad = predictions[~np.isfinite(predictions).all(axis=1)][0]
            raise ModelError(f"the prediction to fuse is not finite: {bad}")
        time, shape = len(predictions), predictions.shape
        out = _Out(
            np.empty(shape),
            np.empty(shape),
            np.empty(shape),
            np.zeros(shape, dtype=np.bool_),
            np.zeros(shape, dtype=np.bool_),
            np.empty(time),
            np.zeros(time, dtype=np.int64),
        )
        _fuse_rows((predictions, measurements), self._state, self._settings, out, fresh)
        self.gated_samples += out.gated.sum(axis=0)
        return FusedRun(*out)


def _first(run: FusedRun) -> FusedStep:
    return FusedStep(
        value=run.values[0],
        innovation=run.innovations[0],
        variance=run.variances[0],
        gated=run.gated[0],
        relocked=run.relocked[0],
        nis=float(run.nis[0]),
        used=int(run.used[0]),
    )


@_compile
def _fuse_rows(
    rows: tuple[FloatArray, FloatArray],
    state: _State,
    settings: _Settings,
    out: _Out,
    fresh: bool,
) -> None:
    """Fuse `rows`; `fresh`: the first one starts a record, so that nothing leads up to it."""
    predictions, measurements = rows
    for k in range(predictions.shape[0]):
        if k > 0 or not fresh:
            _predict(predictions[k], state, settings)
        _update(measurements[k], state, settings, out, k)
        for i in range(predictions.shape[1]):
            out.values[k, i] = state.x[i]
            out.variances[k, i] = state.P[i, i]


@_compile
def _predict(prediction: FloatArray, state: _State, settings: _Settings) -> None:
    n_out = prediction.shape[0]
    x, P, last, f = state.x, state.P, state.last, settings.retention
    moved = prediction - last
    state.activity[:] = settings.linger * state.activity + (1.0 - settings.linger) * moved * moved
    w = np.sqrt(settings.process + settings.motion * state.activity)
    for i in range(n_out):
        x[i] = prediction[i] + f[i] * (x[i] - last[i])
        last[i] = prediction[i]
        for j in range(n_out):
            P[i, j] = f[i] * f[j] * P[i, j] + settings.correlation[i, j] * w[i] * w[j]


@_compile
def _update(
    z: FloatArray,
    state: _State,
    settings: _Settings,
    out: _Out,
    k: int,
) -> None:
    x, P, streak = state.x, state.P, state.streak
    n_out = x.shape[0]
    accepted = np.zeros(n_out, dtype=np.bool_)
    # All innovations are judged before the first one changes the state.
    for i in range(n_out):
        innovation = z[i] - x[i]
        out.innovations[k, i] = innovation if np.isfinite(innovation) else np.nan
        side = 0.0
        if np.isfinite(innovation):
            total = P[i, i] + settings.measurement[i]
            accepted[i] = innovation * innovation <= settings.gate * total
            out.gated[k, i] = not accepted[i]
            side = 0.0 if accepted[i] else np.sign(innovation)
        streak[i] = streak[i] + side if side * streak[i] > 0.0 else side
    for i in range(n_out):
        if abs(streak[i]) >= settings.patience:
            x[i] = z[i]
            P[i, :] = 0.0
            P[:, i] = 0.0
            P[i, i] = settings.measurement[i]
            streak[i] = 0.0
            out.relocked[k, i] = True
    nis = 0.0
    for i in range(n_out):
        if accepted[i]:
            nis += _take_in(z[i], i, state, settings.measurement[i])
            out.used[k] += 1
    out.nis[k] = nis if out.used[k] > 0 else np.nan


@_compile
def _take_in(z: float, i: int, state: _State, measurement: float) -> float:
    """Update with channel `i` alone, Joseph form written out; the squared normalised innovation."""
    x, P = state.x, state.P
    total = P[i, i] + measurement
    innovation = z - x[i]
    gain = P[:, i] / total
    row = P[i, :].copy()
    for a in range(len(x)):
        x[a] += gain[a] * innovation
        for b in range(len(x)):
            P[a, b] += gain[a] * gain[b] * total - gain[a] * row[b] - row[a] * gain[b]
    return float(innovation * innovation / total)
