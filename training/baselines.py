"""What a calibration has to beat: the simplest dynamic models, fitted to the same training logs.

Both are driven by the same steady-state values `ss` as the calibration and run free, so that a
comparison shows what the network adds and nothing else:

    first order   y(k) = y(k-1) + (1 - exp(-dt / tau)) (ss(k) - y(k-1)),
                  tau of a push while ss > y, tau of a pull otherwise
    ARX           y(k) = sum_i a_i y(k-i) + sum_i B_i ss(k-i) + c   (i from 0 in the second sum)

The lag's two time constants per channel minimise its free-run error. The ARX model is fitted as
everyone fits one, by least squares on the one-step error (Ljung, System Identification, section
4.2); among its orders the one with the best free run over the training logs is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from scipy.optimize import minimize
from scipy.signal import lfilter, lfiltic

from data_prep.log import Log
from narxcal.calibration.calibration import Calibration
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ModelError

SHORTEST_S, LONGEST_S = 0.02, 60.0
ORDERS = (1, 2, 3)
# A pole this close to the unit circle remembers its start for the rest of the flight.
_LARGEST_POLE = 0.9999


@dataclass(frozen=True, eq=False)
class Run:
    """Steady-state values and measurements of one log, both (time, channel); NaN where masked."""

    steady: FloatArray
    measured: FloatArray


@dataclass(frozen=True)
class FirstOrderLag:
    """One lag per channel towards the steady-state value; time constants (n_out,) in s."""

    push_s: tuple[float, ...]
    pull_s: tuple[float, ...]

    def simulate(self, steady: FloatArray, start: FloatArray, dt_s: float) -> FloatArray:
        """Free run (time, n_out) behind `steady` (time, n_out), from `start` (n_out,)."""
        columns = [
            _lag(steady[:, k], _first(steady, start, k), _gain(push, dt_s), _gain(pull, dt_s))
            for k, (push, pull) in enumerate(zip(self.push_s, self.pull_s, strict=True))
        ]
        return np.stack(columns, axis=1)


@dataclass(frozen=True)
class LinearArx:
    """Coefficients per channel: `poles` (n_out, order), `gains` (n_out, order + 1, n_out), offset.

    A channel for which no stable model was found has no poles, and its free run is NaN.
    """

    poles: tuple[tuple[float, ...], ...]
    gains: tuple[tuple[tuple[float, ...], ...], ...]
    offsets: tuple[float, ...]

    def simulate(self, steady: FloatArray, start: FloatArray) -> FloatArray:
        """Free run (time, n_out) on `steady` (time, n_out), from `start` (n_out,)."""
        columns = [
            _arx_run(
                np.array(self.poles[k]),
                np.array(self.gains[k]),
                self.offsets[k],
                (steady, _first(steady, start, k)),
            )
            for k in range(steady.shape[1])
        ]
        return np.stack(columns, axis=1)


@dataclass(frozen=True)
class Baselines:
    """The fitted baselines and the range of each output, `(low, high)`, in the training logs."""

    lag: FirstOrderLag
    arx: LinearArx
    low: tuple[float, ...]
    high: tuple[float, ...]

    @classmethod
    def from_json(cls, params: Mapping[str, Any]) -> Baselines:
        """Rebuild what `fit_baselines` returned; `ModelError` where a part is missing."""
        try:
            lag, arx = params["first_order"], params["arx"]
            return cls(
                FirstOrderLag(tuple(lag["push_s"]), tuple(lag["pull_s"])),
                LinearArx(
                    tuple(map(tuple, arx["poles"])),
                    tuple(tuple(map(tuple, rows)) for rows in arx["gains"]),
                    tuple(arx["offsets"]),
                ),
                tuple(params["low"]),
                tuple(params["high"]),
            )
        except (KeyError, TypeError) as error:
            raise ModelError(
                f"the bundle's baselines cannot be read: {error}", hint="Train it again"
            ) from None


def fit_baselines(calibration: Calibration, logs: Sequence[Log]) -> dict[str, Any]:
    """Fit both baselines to the training logs; returns JSON-able parameters.

    `logs` are prepared as for training: their inputs are complete, masked outputs are NaN.
    """
    runs = [run_of(calibration, log) for log in logs]
    channels = range(len(calibration.output_names))
    lags = [_fit_lag(runs, k, calibration.dt_s) for k in channels]
    arx = [_fit_arx(runs, k) for k in channels]
    every = np.concatenate([run.measured for run in runs])
    low, high = np.nanpercentile(every, (1.0, 99.0), axis=0)
    return {
        "first_order": {"push_s": [one[0] for one in lags], "pull_s": [one[1] for one in lags]},
        "arx": {
            "poles": [poles.tolist() for poles, _, _ in arx],
            "gains": [gains.tolist() for _, gains, _ in arx],
            "offsets": [offset for _, _, offset in arx],
        },
        "low": low.tolist(),
        "high": high.tolist(),
    }


def run_of(calibration: Calibration, log: Log) -> Run:
    """Steady-state values of the log's own engine beside what was measured."""
    own = calibration.for_engine(log.source.engine)
    steady = own.steady.outputs(log.matrix(own.input_names))
    return Run(np.asarray(steady, dtype=np.float64), log.matrix(own.output_names))


def _fit_lag(runs: Sequence[Run], k: int, dt_s: float) -> tuple[float, float]:
    """Time constants (push, pull) in s with the least free-run error, by Nelder-Mead."""

    def loss(log_tau: FloatArray) -> float:
        push, pull = np.exp(np.clip(log_tau, np.log(SHORTEST_S), np.log(LONGEST_S)))
        gains = (_gain(push, dt_s), _gain(pull, dt_s))
        total, count = 0.0, 0
        for run in runs:
            first = _first(run.steady, run.measured[0], k)
            error = _lag(run.steady[:, k], first, *gains) - run.measured[:, k]
            known = np.isfinite(error)
            total, count = total + float(error[known] @ error[known]), count + int(known.sum())
        return total / max(count, 1)

    found = minimize(
        loss, np.zeros(2), method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-9}
    )
    push, pull = np.exp(np.clip(found.x, np.log(SHORTEST_S), np.log(LONGEST_S)))
    return float(push), float(pull)


def _fit_arx(runs: Sequence[Run], k: int) -> tuple[FloatArray, FloatArray, float]:
    """Poles (order,), gains (order + 1, n_out) and offset of the order with the best free run."""
    n_out = runs[0].steady.shape[1]
    best, least = (np.empty(0), np.empty((0, n_out)), 0.0), np.inf
    for order in ORDERS:
        longer = [run for run in runs if len(run.measured) > order]
        if not longer:
            continue
        poles, gains, offset = _least_squares(longer, k, order)
        roots = np.roots(np.concatenate([[1.0], -poles]))
        if not np.all(np.abs(roots) <= _LARGEST_POLE):
            continue
        score = _free_run_error(runs, k, (poles, gains, offset))
        if score < least:
            best, least = (poles, gains, offset), score
    return best


def _least_squares(runs: Sequence[Run], k: int, order: int) -> tuple[FloatArray, FloatArray, float]:
    rows, targets = [], []
    for run in runs:
        y, n = run.measured[:, k], len(run.measured)
        past = [y[order - i : n - i, None] for i in range(1, order + 1)]
        drive = [run.steady[order - i : n - i] for i in range(order + 1)]
        row = np.concatenate([*past, *drive, np.ones((n - order, 1))], axis=1)
        known = np.isfinite(row).all(axis=1) & np.isfinite(y[order:])
        rows.append(row[known])
        targets.append(y[order:][known])
    matrix, target = np.concatenate(rows), np.concatenate(targets)
    size = np.maximum(np.abs(matrix).max(axis=0, initial=0.0), 1e-12)
    found = np.linalg.lstsq(matrix / size, target, rcond=None)[0] / size
    gains = found[order:-1].reshape(order + 1, -1)
    return found[:order], gains, float(found[-1])


def _free_run_error(
    runs: Sequence[Run], k: int, model: tuple[FloatArray, FloatArray, float]
) -> float:
    errors = []
    for run in runs:
        first = _first(run.steady, run.measured[0], k)
        errors.append(_arx_run(*model, (run.steady, first)) - run.measured[:, k])
    error = np.concatenate(errors)
    return float(np.sqrt(np.nanmean(error**2)))


def _arx_run(
    poles: FloatArray, gains: FloatArray, offset: float, drive: tuple[FloatArray, float]
) -> FloatArray:
    """Free run (time,) of one channel, in equilibrium before it but for the output `first`."""
    steady, first = drive
    if not len(poles):
        return np.full(len(steady), np.nan)
    forced = np.full(len(steady), offset)
    for i, gain in enumerate(gains):
        rows = np.maximum(np.arange(len(steady)) - i, 0)
        forced += steady[rows] @ gain
    denominator = np.concatenate([[1.0], -poles])
    state = lfiltic([1.0], denominator, np.full(len(poles), first))
    y = np.empty(len(steady))
    y[0] = first
    y[1:] = lfilter([1.0], denominator, forced[1:], zi=state)[0]
    return y


def _gain(tau_s: float, dt_s: float) -> float:
    return float(1.0 - np.exp(-dt_s / tau_s))


def _first(steady: FloatArray, start: FloatArray, k: int) -> float:
    """Start of a free run: the measured value, or the steady-state value where that is missing."""
    return float(start[k]) if np.isfinite(start[k]) else float(steady[0, k])


def lag_steps(steady: FloatArray, first: float, push: float, pull: float) -> FloatArray:
    """One channel (time,) sample by sample; `push` and `pull` are gains per sample."""
    y = np.empty(len(steady))
    y[0] = first
    for k in range(1, len(steady)):
        ahead = steady[k] - y[k - 1]
        y[k] = y[k - 1] + (push if ahead > 0.0 else pull) * ahead
    return y


_lag: Callable[[FloatArray, float, float, float], FloatArray] = njit(cache=True, nogil=True)(
    lag_steps
)
