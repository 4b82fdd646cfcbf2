"""The Kalman fuser: merges a model's free run with a noisy measurement, sample by sample.

The Kalman fuser compiled for streams: the same numbers as `KalmanFuser`, a tenth of the time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from filterpy.kalman import KalmanFilter
from numpy.typing import NDArray
from scipy.special import gammaincinv

from narxcal.calibration.fuser_config import FuserConfig
from narxcal.calibration.noise import NoiseModel, estimate_noise
from narxcal.support.arrays import BoolArray, FloatArray
from narxcal.support.errors import DataError, ModelError

if TYPE_CHECKING:
    from collections.abc import Sequence
from collections.abc import Callable
from typing import NamedTuple, TypeVar, cast

from numba import njit

__all__ = [
    "Consistency",
    "FusedRun",
    "FusedStep",
    "Fuser",
    "FuserConfig",
    "KalmanFuser",
    "NoiseModel",
    "estimate_noise",
]


def chi2_quantile(probability: float, dof: float) -> float:
    """Quantile of the chi-squared distribution with `dof` degrees of freedom."""
    return 2.0 * float(gammaincinv(0.5 * dof, probability))


@dataclass(frozen=True, eq=False)
class FusedStep:
    """One fused sample, all arrays `(n_out,)` in channel units.

    `innovation` is measurement minus what was expected before it (NaN where none), `variance`
    that of `value`. `nis` is the normalised innovation squared of the `used` channels taken
    together. `gated` channels were measured but left out; `relocked` ones started again.
    """

    value: FloatArray
    innovation: FloatArray
    variance: FloatArray
    gated: BoolArray
    relocked: BoolArray
    nis: float
    used: int


@dataclass(frozen=True, eq=False)
class FusedRun:
    """A whole fused record: `(time, n_out)` arrays, and `nis` and `used` `(time,)`."""

    values: FloatArray
    innovations: FloatArray
    variances: FloatArray
    gated: BoolArray
    relocked: BoolArray
    nis: FloatArray
    used: NDArray[np.int64]

    def consistency(self, probability: float = 0.95) -> Consistency:
        """Chi-square check of the normalised innovation squared over the whole run.

        Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation,
        2001, section 5.4: the sum over a run of a correct filter is chi-square distributed with
        as many degrees of freedom as measurements were used. The first sample has no history and
        is left out. Raises `DataError` where nothing was measured.
        """
        dof = int(self.used[1:].sum())
        if dof == 0:
            raise DataError("the consistency of a fuser cannot be checked: nothing was measured")
        tail = 0.5 * (1.0 - probability)
        low, high = (chi2_quantile(part, dof) / dof for part in (tail, 1.0 - tail))
        mean = float(np.nansum(self.nis[1:])) / dof
        return Consistency(mean, low, high, dof, int(self.gated.sum()))


@dataclass(frozen=True)
class Consistency:
    """Mean NIS per measurement, which a correct filter keeps within `low` and `high`."""

    mean_nis: float
    low: float
    high: float
    measurements: int
    gated: int

    @property
    def consistent(self) -> bool:
        """Whether R and Q describe the innovations; a mean above `high` says they are too small."""
        return self.low <= self.mean_nis <= self.high


class Fuser(Protocol):
    """What `KalmanFuser` and its compiled twin `narxcal.calibration.fuser.FastFuser` both do.

    A sample is `(outputs,)`, a record `(time, outputs)`, NaN where nothing was measured;
    `gated_samples` `(outputs,)` counts the measurements that were left out.
    """

    gated_samples: NDArray[np.int64]

    def reset(self, prediction: FloatArray, measurement: FloatArray) -> FusedStep:
        """Start a record with its first sample."""
        ...

    def step(self, prediction: FloatArray, measurement: FloatArray) -> FusedStep:
        """Fuse the next sample."""
        ...

    def extend(self, predictions: FloatArray, measurements: FloatArray) -> FusedRun:
        """Fuse further samples."""
        ...

    def run(self, predictions: FloatArray, measurements: FloatArray) -> FusedRun:
        """Fuse a whole record."""
        ...


class KalmanFuser:
    """Kalman filter (filterpy) whose process model is the prediction of a dynamic model.

    State: the `n_out` output channels. With F = diag(`retention`) and input p[k] - F p[k-1],

        x[k|k-1] = p[k] + F (x[k-1] - p[k-1]),     P[k|k-1] = F P F' + Q[k]

    so a slow static error of the model is learned and taken off, and while nothing is measured
    the estimate returns to the model's own prediction. Paper: section 2.6; noise: `NoiseModel`.
    The covariance update is filterpy's, in Joseph form. Channels without a measurement
    have their rows of H and R left out.
    """

    def __init__(self, noise: NoiseModel, config: FuserConfig | None = None) -> None:
        config = config or FuserConfig()
        self.noise = noise
        self.n_out = len(noise.retention)
        self.gated_samples = np.zeros(self.n_out, dtype=np.int64)
        self._gate = chi2_quantile(config.gate_probability, 1)
        self._patience = max(1, round(config.relock_s / noise.dt_s))
        self._eye = np.eye(self.n_out)
        self._R = np.diag(noise.measurement)
        self._filter = KalmanFilter(dim_x=self.n_out, dim_z=self.n_out, dim_u=self.n_out)
        self._filter.F = np.diag(noise.retention)
        self._filter.B = self._eye
        self._last: FloatArray | None = None
        self._activity = np.zeros(self.n_out)
        # Rejections in a row: how many, signed by the side on which the measurement lies.
        self._streak = np.zeros(self.n_out)

    def reset(self, prediction: FloatArray, measurement: FloatArray) -> FusedStep:
        """Start a record: the first sample, expected at `prediction` within the model's spread."""
        prediction, measurement = check_sample(prediction, measurement, self.n_out)
        self._filter.x = prediction[:, None].copy()
        self._filter.P = np.diag(self.noise.spread)
        self._last = prediction
        self._streak[:] = self._activity[:] = 0.0
        return self._update(measurement)

    def step(self, prediction: FloatArray, measurement: FloatArray) -> FusedStep:
        """Fuse the next sample: `prediction` and `measurement` `(n_out,)`, NaN where not measured.

        Raises `ModelError` before the first `reset` and where the prediction is not finite.
        """
        prediction, measurement = check_sample(prediction, measurement, self.n_out)
        if self._last is None:
            raise ModelError("the fuser has no past", hint="Call reset with the first sample")
        last, self._last = self._last, prediction
        self._activity = self.noise.activity(self._activity, prediction - last)
        self._filter.predict(
            u=(prediction - self.noise.retention * last)[:, None],
            Q=self.noise.process_covariance(self._activity),
        )
        return self._update(measurement)

    def extend(self, predictions: FloatArray, measurements: FloatArray) -> FusedRun:
        """Fuse further samples `(time, n_out)` of the record in hand, one `step` each."""
        check_record(predictions, measurements, self.n_out)
        return stack([self.step(p, z) for p, z in zip(predictions, measurements, strict=True)])

    def run(self, predictions: FloatArray, measurements: FloatArray) -> FusedRun:
        """Fuse one record, `(time, n_out)` each: `reset` with the first row, `step` with the rest.

        Raises `DataError` where the shapes differ or there is no sample.
        """
        check_record(predictions, measurements, self.n_out)
        first = self.reset(predictions[0], measurements[0])
        rest = [self.step(p, z) for p, z in zip(predictions[1:], measurements[1:], strict=True)]
        return stack([first, *rest])

    def _update(self, measurement: FloatArray) -> FusedStep:
        kf = self._filter
        innovation = measurement - kf.x[:, 0]
        # An infinite reading is no measurement either.
        measured = np.isfinite(innovation)
        outside = innovation**2 > self._gate * (kf.P.diagonal() + self.noise.measurement)
        gated = measured & outside
        relocked = self._relock(measurement, np.where(gated, np.sign(innovation), 0.0))
        rows = np.flatnonzero(measured & ~outside)
        nis = self._correct(measurement, rows)
        return FusedStep(
            value=kf.x[:, 0].copy(),
            innovation=np.where(measured, innovation, np.nan),
            variance=kf.P.diagonal().copy(),
            gated=gated,
            relocked=relocked,
            nis=nis,
            used=len(rows),
        )

    def _correct(self, measurement: FloatArray, rows: NDArray[np.intp]) -> float:
        """Measurement update with the `rows` of H and R; the normalised innovation squared."""
        kf = self._filter
        if not len(rows):
            return float("nan")
        kf.update(measurement[rows, None], R=self._R[rows[:, None], rows], H=self._eye[rows])
        return float((kf.y.T @ kf.SI @ kf.y)[0, 0])

    def _relock(self, measurement: FloatArray, side: FloatArray) -> BoolArray:
        """Count rejections in a row on one side, and start a channel again after too many."""
        self.gated_samples += side != 0.0
        self._streak = np.where(side * self._streak > 0.0, self._streak + side, side)
        relocked: BoolArray = np.abs(self._streak) >= self._patience
        for i in np.flatnonzero(relocked):
            self._filter.x[i, 0] = measurement[i]
            self._filter.P[i, :] = self._filter.P[:, i] = 0.0
            self._filter.P[i, i] = self.noise.measurement[i]
            self._streak[i] = 0.0
        return relocked


def check_sample(
    prediction: FloatArray, measurement: FloatArray, n_out: int
) -> tuple[FloatArray, FloatArray]:
    """Both as float `(n_out,)`.

    Raises `DataError` for another shape, `ModelError` for a prediction that is not finite.
    """
    prediction = np.asarray(prediction, dtype=float)
    measurement = np.asarray(measurement, dtype=float)
    if prediction.shape != (n_out,) or measurement.shape != (n_out,):
        raise DataError(
            f"expected a prediction and a measurement of {n_out} channels, "
            f"found shapes {prediction.shape} and {measurement.shape}"
        )
    if not np.isfinite(prediction).all():
        raise ModelError(f"the prediction to fuse is not finite: {prediction}")
    return prediction, measurement


def check_record(predictions: FloatArray, measurements: FloatArray, n_out: int) -> None:
    """Refuse records that are not both `(time, n_out)`, and empty ones, with a `DataError`."""
    if predictions.shape != measurements.shape or predictions.shape[1:] != (n_out,):
        raise DataError(
            f"expected predictions and measurements (time, {n_out}), "
            f"found {predictions.shape} and {measurements.shape}"
        )
    if not len(predictions):
        raise DataError("there is no sample to fuse")


def stack(steps: Sequence[FusedStep]) -> FusedRun:
    """Put single steps together."""
    return FusedRun(
        values=np.array([s.value for s in steps]),
        innovations=np.array([s.innovation for s in steps]),
        variances=np.array([s.variance for s in steps]),
        gated=np.array([s.gated for s in steps]),
        relocked=np.array([s.relocked for s in steps]),
        nis=np.array([s.nis for s in steps]),
        used=np.array([s.used for s in steps], dtype=np.int64),
    )


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
