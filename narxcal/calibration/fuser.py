"""The Kalman fuser: merges a model's free run with a noisy measurement, sample by sample.

`KalmanFuser` is filterpy's Kalman filter, the reference; `FastFuser` its compiled twin for whole
records and streams. Both have the methods of `Fuser`. State: the `n_out` output channels. With
F = diag(phi) and input p[k] - F p[k-1] (symbols of `calibration.noise`),

    x[k|k-1] = p[k] + F (x[k-1] - p[k-1]),     P[k|k-1] = F P F' + Q[k],     Q = diag(q + g a[k])

so a slow static error of the model is estimated and removed, and while nothing is measured the
estimate returns to the model's own prediction. Paper: section 2.6. A channel without a measurement
has its rows of H and R left out.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from filterpy.kalman import KalmanFilter
from scipy.special import gammaincinv

from narxcal.calibration.fuser_config import FuserConfig
from narxcal.calibration.noise import NoiseModel, activity, updated
from narxcal.record import LARGEST
from narxcal.support.arrays import BoolArray, FloatArray, IntArray
from narxcal.support.compiled import compiled
from narxcal.support.errors import DataError, ModelError


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
    used: IntArray

    @classmethod
    def empty(cls, time: int, n_out: int) -> FusedRun:
        shape = (time, n_out)
        return cls(
            values=np.empty(shape),
            innovations=np.empty(shape),
            variances=np.empty(shape),
            gated=np.zeros(shape, dtype=np.bool_),
            relocked=np.zeros(shape, dtype=np.bool_),
            nis=np.full(time, np.nan),
            used=np.zeros(time, dtype=np.int64),
        )

    @property
    def first(self) -> FusedStep:
        return FusedStep(
            value=self.values[0],
            innovation=self.innovations[0],
            variance=self.variances[0],
            gated=self.gated[0],
            relocked=self.relocked[0],
            nis=float(self.nis[0]),
            used=int(self.used[0]),
        )

    def consistency(self) -> Consistency:
        """Check the normalised innovation squared over the whole run by its distribution.

        Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation,
        2001, section 5.4: the sum over a run of a correct filter is chi-square distributed with
        as many degrees of freedom as measurements were used. The first sample has no history and
        is left out. Raises `DataError` where nothing was measured.
        """
        dof = int(self.used[1:].sum())
        if dof == 0:
            raise DataError("the consistency of a fuser cannot be checked: nothing was measured")
        low, high = (chi2_quantile(part, dof) / dof for part in (0.025, 0.975))
        mean = float(np.nansum(self.nis[1:])) / dof
        return Consistency(mean, low, high, dof, int(self.gated.sum()))


@dataclass(frozen=True)
class Consistency:
    """Mean NIS per measurement, which 95 % of correct filters have within `low` and `high`."""

    mean_nis: float
    low: float
    high: float
    measurements: int
    gated: int


class Fuser(ABC):
    """Methods of both fusers; a sample is `(n_out,)`, a record `(time, n_out)`.

    NaN is a missing measurement, and so is an infinite one. `gated_samples` `(n_out,)` counts the
    measurements that were left out.
    """

    def __init__(self, noise: NoiseModel, config: FuserConfig | None = None) -> None:
        config = config or FuserConfig()
        self.noise = noise
        self.n_out = len(noise.bias_decay)
        self.gated_samples = np.zeros(self.n_out, dtype=np.int64)
        self._gate = chi2_quantile(config.gate_probability, 1)
        self._patience = max(1, round(config.relock_s / noise.dt_s))
        self._started = False

    def reset(self, prediction: FloatArray, measurement: FloatArray) -> FusedStep:
        """Start a record: the first sample, expected at `prediction` within p0."""
        return self.run(*self._sample(prediction, measurement)).first

    def step(self, prediction: FloatArray, measurement: FloatArray) -> FusedStep:
        """Fuse the next sample."""
        return self.extend(*self._sample(prediction, measurement)).first

    def run(self, predictions: FloatArray, measurements: FloatArray) -> FusedRun:
        """Fuse a whole record, as by `reset` with the first row and `step` with the others.

        Raises `DataError` where the shapes differ, there is no sample, or a value is too large to
        be squared, `ModelError` where a prediction is not finite.
        """
        self._check(predictions, measurements)
        self._start(predictions[0])
        self._started = True
        return self._counted(self._fuse(predictions, measurements, fresh=True))

    def extend(self, predictions: FloatArray, measurements: FloatArray) -> FusedRun:
        """Fuse further samples of the record, as by `step`."""
        self._check(predictions, measurements)
        if not self._started:
            raise ModelError("the fuser was not started", hint="Call reset with the first sample")
        return self._counted(self._fuse(predictions, measurements, fresh=False))

    @abstractmethod
    def _start(self, prediction: FloatArray) -> None:
        """Begin a record at its first prediction."""

    @abstractmethod
    def _fuse(self, predictions: FloatArray, measurements: FloatArray, *, fresh: bool) -> FusedRun:
        """Fuse rows; `fresh`: the first one starts a record, so that no step leads to it."""

    def _counted(self, run: FusedRun) -> FusedRun:
        self.gated_samples += run.gated.sum(axis=0)
        return run

    def _sample(
        self, prediction: FloatArray, measurement: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        p, z = np.asarray(prediction, dtype=float), np.asarray(measurement, dtype=float)
        if p.shape != (self.n_out,) or z.shape != (self.n_out,):
            raise DataError(
                f"expected a prediction and a measurement of {self.n_out} channels, "
                f"found shapes {p.shape} and {z.shape}"
            )
        return p[None], z[None]

    def _check(self, predictions: FloatArray, measurements: FloatArray) -> None:
        if predictions.shape != measurements.shape or predictions.shape[1:] != (self.n_out,):
            raise DataError(
                f"expected predictions and measurements (time, {self.n_out}), "
                f"found {predictions.shape} and {measurements.shape}"
            )
        if not len(predictions):
            raise DataError("there is no sample to fuse")
        finite = np.isfinite(predictions).all(axis=1)
        if not finite.all():
            raise ModelError(f"the prediction to fuse is not finite: {predictions[~finite][0]}")
        for what, values in (("prediction", predictions), ("measurement", measurements)):
            large = np.abs(values) > LARGEST
            if large.any() and (large := large & np.isfinite(values)).any():
                raise DataError(
                    f"a {what} to fuse is {values[large][0]:g}, beyond {LARGEST:g}",
                    row=int(np.flatnonzero(large.any(axis=1))[0]),
                    hint="Scale the channel, or mask by NaN what is no measurement",
                )


class KalmanFuser(Fuser):
    """The fuser by filterpy, whose covariance update is in Joseph form: the reference."""

    def __init__(self, noise: NoiseModel, config: FuserConfig | None = None) -> None:
        super().__init__(noise, config)
        self._eye = np.eye(self.n_out)
        self._R = np.diag(noise.measurement_variance)
        self._filter = KalmanFilter(dim_x=self.n_out, dim_z=self.n_out, dim_u=self.n_out)
        self._filter.F = np.diag(noise.bias_decay)
        self._filter.B = self._eye

    def _start(self, prediction: FloatArray) -> None:
        self._filter.x = prediction[:, None].copy()
        self._filter.P = np.diag(self.noise.initial_variance)
        self._last = prediction.copy()
        self._activity = np.zeros(self.n_out)
        # Samples since the first rejection in a row, signed by the side of the measurements.
        self._streak = np.zeros(self.n_out)

    def _fuse(self, predictions: FloatArray, measurements: FloatArray, *, fresh: bool) -> FusedRun:
        out = FusedRun.empty(*predictions.shape)
        for k, (prediction, measurement) in enumerate(zip(predictions, measurements, strict=True)):
            if k or not fresh:
                self._predict(prediction)
            self._update(measurement, out, k)
        return out

    def _predict(self, prediction: FloatArray) -> None:
        noise, change = self.noise, prediction - self._last
        decay = noise.activity_decay
        self._activity = decay * self._activity + (1.0 - decay) * change**2
        self._filter.predict(
            u=(prediction - noise.bias_decay * self._last)[:, None],
            Q=np.diag(noise.process_variance + noise.transient_gain * self._activity),
        )
        self._last = prediction.copy()

    def _update(self, measurement: FloatArray, out: FusedRun, k: int) -> None:
        kf = self._filter
        innovation = measurement - kf.x[:, 0]
        measured = np.isfinite(innovation)
        total = kf.P.diagonal() + self.noise.measurement_variance
        gated = measured & (innovation**2 > self._gate * total)
        out.innovations[k] = np.where(measured, innovation, np.nan)
        out.gated[k] = gated
        out.relocked[k] = self._relock(measurement, np.where(gated, np.sign(innovation), 0.0))
        rows = np.flatnonzero(measured & ~gated)
        if len(rows):
            kf.update(measurement[rows, None], R=self._R[rows[:, None], rows], H=self._eye[rows])
            out.nis[k] = float((kf.y.T @ kf.SI @ kf.y)[0, 0])
        out.used[k] = len(rows)
        out.values[k], out.variances[k] = kf.x[:, 0], kf.P.diagonal()

    def _relock(self, measurement: FloatArray, side: FloatArray) -> BoolArray:
        """Count samples since the first rejection on one side, and start again after too many.

        Samples without a measurement count, and end no row of rejections.
        """
        counted = np.where(side * self._streak > 0.0, self._streak + side, side)
        waited = self._streak + np.sign(self._streak)
        self._streak = np.where(np.isfinite(measurement), counted, waited)
        relocked: BoolArray = (side != 0.0) & (np.abs(self._streak) >= self._patience)
        for i in np.flatnonzero(relocked):
            self._filter.x[i, 0] = measurement[i]
            self._filter.P[i, :] = self._filter.P[:, i] = 0.0
            self._filter.P[i, i] = self.noise.measurement_variance[i]
            self._streak[i] = 0.0
        return relocked


class FastFuser(Fuser):
    """Compiled twin of `KalmanFuser`, for replays at hundreds of times real time.

    F, Q, R and the initial P are diagonal, so P stays diagonal and each channel is a scalar filter.
    """

    def _start(self, prediction: FloatArray) -> None:
        """Keep x, P, the last prediction, the activity and the streak of rejections: (5, n_out)."""
        zero = np.zeros(self.n_out)
        self._state = np.stack([prediction, self.noise.initial_variance, prediction, zero, zero])

    def _fuse(self, predictions: FloatArray, measurements: FloatArray, *, fresh: bool) -> FusedRun:
        noise, out = self.noise, FusedRun.empty(*predictions.shape)
        _fuse_rows(
            (predictions, measurements),
            self._state,
            (
                noise.bias_decay,
                noise.process_variance,
                noise.transient_gain,
                noise.activity_decay,
                noise.measurement_variance,
            ),
            (
                out.values,
                out.innovations,
                out.variances,
                out.gated,
                out.relocked,
                out.nis,
                out.used,
            ),
            (self._gate, float(self._patience), fresh),
        )
        return out


_Out = tuple[FloatArray, FloatArray, FloatArray, BoolArray, BoolArray, FloatArray, IntArray]


@compiled
def _fuse_rows(
    rows: tuple[FloatArray, FloatArray],
    state: FloatArray,
    noise: tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray],
    out: _Out,
    rules: tuple[float, float, bool],
) -> None:
    """Fuse `rows` channel by channel into `out`, the arrays of a `FusedRun`.

    `rules` are the gate, the samples that rejections in a row may last, and whether the first row
    starts a record.
    """
    x, P, last, a, streak = state
    phi, q, g, rho, r = noise
    values, innovations, variances, gated, relocked, nis, used = out
    gate, patience, fresh = rules
    for k in range(len(rows[0])):
        for i in range(len(x)):
            p, z = rows[0][k, i], rows[1][k, i]
            if k > 0 or not fresh:
                a[i] = activity(a[i], p - last[i], rho[i])
                x[i] = p + phi[i] * (x[i] - last[i])
                P[i] = phi[i] * phi[i] * P[i] + q[i] + g[i] * a[i]
                last[i] = p
            innovation = z - x[i]
            measured = np.isfinite(innovation)
            total = P[i] + r[i]
            gated[k, i] = measured and innovation * innovation > gate * total
            innovations[k, i] = innovation if measured else np.nan
            side = np.sign(innovation) if gated[k, i] else 0.0
            if not measured:
                streak[i] += np.sign(streak[i])
            else:
                streak[i] = streak[i] + side if side * streak[i] > 0.0 else side
            if side != 0.0 and abs(streak[i]) >= patience:
                x[i], P[i], streak[i] = z, r[i], 0.0
                relocked[k, i] = True
            elif measured and not gated[k, i]:
                x[i], P[i] = updated(x[i], P[i], z, r[i])
                nis[k] = innovation * innovation / total + (nis[k] if used[k] else 0.0)
                used[k] += 1
            values[k, i], variances[k, i] = x[i], P[i]
