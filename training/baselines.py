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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize

from data_prep.log import Log
from narxcal.calibration.calibration import Calibration
from narxcal.calibration.members import Kind, Member
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ModelError

SHORTEST_S, LONGEST_S = 0.02, 60.0
ORDERS = (1, 2, 3)


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
            one.simulate(steady, start_of(steady, start, k))
            for k, one in enumerate(self.members(dt_s))
        ]
        return np.stack(columns, axis=1)

    def members(self, dt_s: float) -> tuple[Member, ...]:
        """The lags of all outputs, each the whole of its output."""
        return tuple(self.member(k, dt_s) for k in range(len(self.push_s)))

    def member(self, k: int, dt_s: float) -> Member:
        """The lag of one output."""
        push, pull = _gain(self.push_s[k], dt_s), _gain(self.pull_s[k], dt_s)
        return Member("first_order", k, push, pull)


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
            self.member(k).simulate(steady, start_of(steady, start, k))
            if len(self.poles[k])
            else np.full(len(steady), np.nan)
            for k in range(steady.shape[1])
        ]
        return np.stack(columns, axis=1)

    def member(self, k: int) -> Member:
        """The model of one output."""
        return Member("arx", k, poles=self.poles[k], gains=self.gains[k], offset=self.offsets[k])


@dataclass(frozen=True)
class Baselines:
    """The fitted baselines and the range of each output, `(low, high)`, in the training logs."""

    lag: FirstOrderLag
    arx: LinearArx
    low: tuple[float, ...]
    high: tuple[float, ...]

    def member(self, kind: Kind, channel: int, dt_s: float, weight: float) -> Member:
        """The fitted model of one output as a member of a mixture."""
        one = Member("steady_state", channel)
        if kind == "first_order":
            one = self.lag.member(channel, dt_s)
        elif kind == "arx":
            one = self.arx.member(channel)
        return replace(one, weight=weight)

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
    arx = [_fit_arx(runs, k, calibration.dt_s) for k in channels]
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
    """Steady-state values of the log's own engine, and what was measured."""
    own = calibration.for_engine(log.source.engine, or_mean=True)
    steady = own.settled(log.matrix(own.input_names))
    return Run(np.asarray(steady, dtype=np.float64), log.matrix(own.output_names))


def _fit_lag(runs: Sequence[Run], k: int, dt_s: float) -> tuple[float, float]:
    """Time constants (push, pull) in s with the least free-run error, by Nelder-Mead."""

    def loss(log_tau: FloatArray) -> float:
        taus = np.exp(np.clip(log_tau, np.log(SHORTEST_S), np.log(LONGEST_S)))
        push, pull = (_gain(tau, dt_s) for tau in taus.tolist())
        lag = Member("first_order", k, push, pull)
        total, count = 0.0, 0
        for run in runs:
            first = start_of(run.steady, run.measured[0], k)
            error = lag.simulate(run.steady, first) - run.measured[:, k]
            known = np.isfinite(error)
            total, count = total + float(error[known] @ error[known]), count + int(known.sum())
        return total / max(count, 1)

    found = minimize(
        loss, np.zeros(2), method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-9}
    )
    push_s, pull_s = np.exp(np.clip(found.x, np.log(SHORTEST_S), np.log(LONGEST_S)))
    return float(push_s), float(pull_s)


def _fit_arx(runs: Sequence[Run], k: int, dt_s: float) -> tuple[FloatArray, FloatArray, float]:
    """Poles (order,), gains (order + 1, n_out) and offset of the order with the best free run.

    Of those that settle with `LONGEST_S` at most.
    """
    n_out = runs[0].steady.shape[1]
    best, least = (np.empty(0), np.empty((0, n_out)), 0.0), np.inf
    for order in ORDERS:
        if all(len(run.measured) <= order for run in runs):
            continue
        poles, gains, offset = arx_of(runs, k, order)
        roots = np.roots(np.concatenate([[1.0], -poles]))
        if not np.all(np.abs(roots) <= np.exp(-dt_s / LONGEST_S)):
            continue
        score = _free_run_error(runs, k, (poles, gains, offset))
        if score < least:
            best, least = (poles, gains, offset), score
    return best


def arx_of(runs: Sequence[Run], k: int, order: int) -> tuple[FloatArray, FloatArray, float]:
    """Poles (order,), gains (order + 1, n_out) and offset of output `k` by least squares.

    Runs of `order` samples or fewer tell nothing; one has to be longer.
    """
    rows, targets = [], []
    for run in (run for run in runs if len(run.measured) > order):
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
    poles, gains, offset = model
    arx = Member("arx", k, poles=tuple(poles), gains=tuple(map(tuple, gains)), offset=offset)
    errors = []
    for run in runs:
        first = start_of(run.steady, run.measured[0], k)
        errors.append(arx.simulate(run.steady, first) - run.measured[:, k])
    error = np.concatenate(errors)
    return float(np.sqrt(np.nanmean(error**2)))


def _gain(tau_s: float, dt_s: float) -> float:
    return float(1.0 - np.exp(-dt_s / tau_s))


def start_of(steady: FloatArray, start: FloatArray, k: int) -> float:
    """Start of a free run: the measured value, or the steady-state value where that is missing."""
    return float(start[k]) if np.isfinite(start[k]) else float(steady[0, k])
