"""What a calibration has to beat: the simplest dynamic models, fitted to the same training logs.

All are driven by the same steady-state values `ss` as the calibration and run free, so that a
comparison shows what the network adds and nothing else. With d = y - ss, output by output:

    first order   y(k) = y(k-1) + (1 - exp(-dt / tau)) (ss(k) - y(k-1)),
                  tau of a push while ss > y, tau of a pull otherwise
    linear        d(k) = sum_i a_i d(k-i) + sum_i c_i (ss(k-i+1) - ss(k-i)),      i = 1 .. order

At rest a linear model is the steady state: its gain is one by construction, and with poles inside
the unit circle it settles there whatever the inputs. Steady values of several outputs, which follow
one driver, are collinear; only the output's own is taken.

The lag's two time constants minimise its free-run error. A linear model is fitted to the next
sample by least squares (ARX: Ljung, System Identification, section 4.2), and from there to the free
run by Gauss-Newton steps (output error: the same, section 10.2). A level of its own in each run, as
a day or a sensor has it, is profiled out of both: it is no slow pole. Among the orders the one
with the best free run over the training logs is taken.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple, Self

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

from data_prep.log import Log
from narxcal.calibration.calibration import Calibration
from narxcal.calibration.members import Kind, Member
from narxcal.steady.model import ALTERED
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ModelError
from narxcal.support.settings import read_stored

SHORTEST_S, LONGEST_S = 0.02, 60.0
ORDERS = (1, 2, 3)
_STEPS: Final = 20  # of Gauss-Newton, each tried at once and at up to `_HALVINGS` halves
_HALVINGS: Final = 4
_CONVERGED: Final = 1e-4  # of the mean square
_CLOSE: Final = 1e-3  # of ln(time constant)


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

    def member(self, k: int, dt_s: float) -> Member:
        """The lag of one output."""
        push, pull = _gain(self.push_s[k], dt_s), _gain(self.pull_s[k], dt_s)
        return Member("first_order", k, push, pull)


@dataclass(frozen=True)
class Linear:
    """Coefficients per channel: `poles` (n_out, order), `gains` (n_out, order + 1, n_out), offset.

    Those of `narxcal.calibration.members`. A channel without a stable model has no poles.
    """

    kind: Kind
    poles: tuple[tuple[float, ...], ...]
    gains: tuple[tuple[tuple[float, ...], ...], ...]
    offsets: tuple[float, ...]

    def member(self, k: int) -> Member:
        """The model of one output."""
        return Member(
            self.kind, k, poles=self.poles[k], gains=self.gains[k], offset=self.offsets[k]
        )

    @classmethod
    def of(cls, kind: Kind, found: Sequence[Member]) -> Self:
        """Models of all outputs; a member without poles is none."""
        return cls(
            kind,
            tuple(one.poles for one in found),
            tuple(one.gains for one in found),
            tuple(one.offset for one in found),
        )

    def to_json(self) -> dict[str, Any]:
        """JSON-able, without the kind."""
        return {"poles": self.poles, "gains": self.gains, "offsets": self.offsets}


@dataclass(frozen=True)
class Baselines:
    """The fitted baselines and the range of each output, `(low, high)`, in the training logs."""

    lag: FirstOrderLag
    arx: Linear
    output_error: Linear
    low: tuple[float, ...]
    high: tuple[float, ...]

    def member(self, kind: Kind, channel: int, dt_s: float, weight: float = 1.0) -> Member:
        """The fitted model of one output as a member of a mixture."""
        one = Member("steady_state", channel)
        if kind == "first_order":
            one = self.lag.member(channel, dt_s)
        elif kind != "steady_state":
            one = self._linear[kind].member(channel)
        return replace(one, weight=weight)

    @property
    def _linear(self) -> dict[Kind, Linear]:
        return {"arx": self.arx, "output_error": self.output_error}

    def has(self, kind: Kind, channel: int) -> bool:
        """Whether a stable model of this kind was found for the output."""
        return kind not in self._linear or len(self._linear[kind].poles[channel]) > 0

    def simulate(
        self, kind: Kind, steady: FloatArray, start: FloatArray, dt_s: float
    ) -> FloatArray:
        """Free run (time, n_out) of one kind behind `steady` (time, n_out), from `start` (n_out,).

        NaN where there is no such model.
        """
        if kind == "steady_state":
            return steady
        columns = [
            self.member(kind, k, dt_s).simulate(steady, start_of(steady, start, k))
            if self.has(kind, k)
            else np.full(len(steady), np.nan)
            for k in range(steady.shape[1])
        ]
        return np.stack(columns, axis=1)

    def lags(self, dt_s: float) -> tuple[Member, ...]:
        """The first-order lags of all outputs, each the whole of its output."""
        return tuple(self.lag.member(k, dt_s) for k in range(len(self.low)))

    @classmethod
    def from_json(cls, params: Mapping[str, Any]) -> Baselines:
        """Rebuild what `fit_baselines` returned; `ModelError` for parts that do not fit."""
        table = {"lag": params.get("first_order"), **params}
        for kind in ("arx", "output_error"):
            if isinstance(table.get(kind), Mapping):
                table[kind] = {"kind": kind, **table[kind]}
        return read_stored(cls, table, "baselines")

    def __post_init__(self) -> None:
        count = len(self.low)
        parts: list[Sequence[object]] = [self.high, self.lag.push_s, self.lag.pull_s]
        for one in self._linear.values():
            parts += [one.poles, one.gains, one.offsets]
        fits = all(len(part) == count for part in parts) and all(
            one.member(k).fits(count) for one in self._linear.values() for k in range(count)
        )
        if not fits:
            raise ModelError("'baselines' are no models of the same outputs", hint=ALTERED)


def fit_baselines(calibration: Calibration, logs: Sequence[Log]) -> dict[str, Any]:
    """Fit all baselines to the training logs; returns JSON-able parameters.

    `logs` are prepared as for training: their inputs are complete, masked outputs are NaN.
    """
    runs = [run_of(calibration, log) for log in logs]
    channels = range(len(calibration.output_names))
    lags = [_fit_lag(runs, k, calibration.dt_s) for k in channels]
    linear = [_fit_linear(runs, k, lags[k], calibration.dt_s) for k in channels]
    every = np.concatenate([run.measured for run in runs])
    low, high = np.nanpercentile(every, (1.0, 99.0), axis=0)
    return {
        "first_order": {"push_s": [one[0] for one in lags], "pull_s": [one[1] for one in lags]},
        "arx": Linear.of("arx", [one[0] for one in linear]).to_json(),
        "output_error": Linear.of("output_error", [one[1] for one in linear]).to_json(),
        "low": low.tolist(),
        "high": high.tolist(),
    }


def run_of(calibration: Calibration, log: Log) -> Run:
    """Steady-state values of the log's own engine, and what was measured."""
    own = calibration.for_engine(log.source.engine, or_mean=True)
    steady = own.settled(log.matrix(own.input_names))
    return Run(np.asarray(steady, dtype=np.float64), log.matrix(own.output_names))


def _fit_lag(runs: Sequence[Run], k: int, dt_s: float) -> tuple[float, float]:
    """Time constants (push, pull) in s with the least free-run error, from 1 s each."""

    def errors(log_tau: FloatArray) -> FloatArray:
        push, pull = (_gain(tau, dt_s) for tau in np.exp(log_tau).tolist())
        lag = Member("first_order", k, push, pull)
        found = []
        for run in runs:
            first = start_of(run.steady, run.measured[0], k)
            error = lag.simulate(run.steady, first) - run.measured[:, k]
            found.append(error[np.isfinite(error)])
        return np.concatenate(found)

    bounds = np.log([SHORTEST_S, LONGEST_S])
    found = least_squares(errors, np.zeros(2), bounds=tuple(bounds), ftol=_CONVERGED, xtol=_CLOSE)
    push_s, pull_s = np.exp(found.x).tolist()
    return push_s, pull_s


def lag_errors(fitted: Sequence[Run], judged: Sequence[Run], dt_s: float) -> list[FloatArray]:
    """Free-run errors (time, n_out) of first-order lags over other runs than those fitted to."""
    outputs = range(fitted[0].steady.shape[1])
    times = [_fit_lag(fitted, k, dt_s) for k in outputs]
    both = FirstOrderLag(tuple(push for push, _ in times), tuple(pull for _, pull in times))
    lags = [both.member(k, dt_s) for k in outputs]
    found = []
    for run in judged:
        firsts = [start_of(run.steady, run.measured[0], k) for k in outputs]
        free = [lag.simulate(run.steady, first) for lag, first in zip(lags, firsts, strict=True)]
        found.append(np.stack(free, axis=1) - run.measured)
    return found


class _Deviation(NamedTuple):
    """Deviation (time,) of an output from its steady value, NaN where masked, and its start.

    `moved` (time,) are the increments of the steady value, the first of them 0.
    """

    measured: FloatArray
    moved: FloatArray
    first: float

    @classmethod
    def of(cls, run: Run, k: int) -> Self:
        """The deviation of output `k`."""
        steady = run.steady[:, k]
        first = start_of(run.steady, run.measured[0], k) - float(steady[0])
        return cls(run.measured[:, k] - steady, np.diff(steady, prepend=steady[:1]), first)

    def past(self, values: FloatArray, order: int, before: float) -> FloatArray:
        """The `order` samples before each of `values` (time,): (order, time), newest first."""
        padded = np.concatenate([np.full(order, before), values])
        return np.stack([padded[order - i : len(padded) - i] for i in range(1, order + 1)])

    def moves(self, order: int) -> FloatArray:
        """Increments (order, time) at each sample and before it, newest first."""
        return np.concatenate([self.moved[None], self.past(self.moved, order, 0.0)[: order - 1]])


def arx_of(runs: Sequence[Run], k: int, order: int) -> FloatArray:
    """Coefficients (2 order,) of output `k`, a then c, by least squares on the next sample.

    Runs of `order` samples or fewer tell nothing; one has to be longer.
    """
    rows, targets = [], []
    for run in (run for run in runs if len(run.measured) > order):
        one = _Deviation.of(run, k)
        row = np.concatenate([one.past(one.measured, order, np.nan), one.moves(order)]).T
        known = np.isfinite(row).all(axis=1) & np.isfinite(one.measured)
        rows.append(_levelled(row[known]))
        targets.append(_levelled(one.measured[known]))
    matrix, target = np.concatenate(rows), np.concatenate(targets)
    size = np.maximum(np.abs(matrix).max(axis=0, initial=0.0), 1e-12)
    return np.asarray(np.linalg.lstsq(matrix / size, target, rcond=None)[0] / size)


def _levelled(rows: FloatArray) -> FloatArray:
    """Rows (samples, ...) less their mean: what a level of the run's own leaves of them."""
    return rows - rows.mean(axis=0) if len(rows) else rows


def linear(kind: Kind, k: int, found: FloatArray, outputs: int) -> Member:
    """The model of output `k` of so many, from its coefficients (2 order,), a then c."""
    poles, moves = np.split(found, 2)
    gains = np.zeros((len(poles) + 1, outputs))
    gains[:, k] = np.concatenate([[1.0], -poles])
    gains[:-1, k] += moves
    gains[1:, k] -= moves
    rows = tuple(map(tuple, gains.tolist()))
    return Member(kind, k, poles=tuple(poles.tolist()), gains=rows)


def _fit_linear(
    runs: Sequence[Run], k: int, lag_s: tuple[float, float], dt_s: float
) -> tuple[Member, Member]:
    """ARX and output-error model of output `k`, each of the order with the best free run.

    Of those that settle with `LONGEST_S` at most; without poles where there is none. Where ARX does
    not, output error starts from the first-order lag with time constants `lag_s`.
    """
    outputs, furthest = runs[0].steady.shape[1], float(np.exp(-dt_s / LONGEST_S))
    parts = [_Deviation.of(run, k) for run in runs]
    kept = float(np.exp(-dt_s / np.sqrt(lag_s[0] * lag_s[1])))
    arx, free = (Member("arx", k), np.inf), (Member("output_error", k), np.inf)
    for order in ORDERS:
        if all(len(run.measured) <= order for run in runs):
            continue
        found = arx_of(runs, k, order)
        settles = _settles(found, furthest)
        if not settles:
            found = np.zeros(2 * order)
            found[0], found[order] = kept, -kept
        left = _FreeRunError.of(parts, found)
        if settles and left.square < arx[1]:
            arx = linear("arx", k, found, outputs), left.square
        found, left = _to_free_run(parts, (found, left), furthest)
        if left.square < free[1]:
            free = linear("output_error", k, found, outputs), left.square
    return arx[0], free[0]


def _settles(found: FloatArray, furthest: float) -> bool:
    """Whether all poles lie within a circle of this radius."""
    poles = found[: len(found) // 2]
    return bool((np.abs(np.roots(np.concatenate([[1.0], -poles]))) <= furthest).all())


class _FreeRunError(NamedTuple):
    """Mean square of the free-run error, and its normal equations J'J, J'e in the coefficients."""

    square: float
    matrix: FloatArray
    slope: FloatArray

    @classmethod
    def of(cls, parts: Sequence[_Deviation], found: FloatArray) -> Self:
        """Of a model with coefficients `found` (2 order,), without the level of each run."""
        order, size = len(found) // 2, len(found)
        poles, moves = np.split(found, 2)
        fed_back = np.concatenate([[1.0], -poles])
        total, count = np.zeros((size + 1, size + 1)), 0
        for one in parts:
            driven = lfilter(moves, [1.0], one.moved) + (poles.sum() - 1.0) * one.first
            driven[0] = 0.0  # the run starts where it was measured
            free = one.first + lfilter([1.0], fed_back, driven)
            causes = np.concatenate([one.past(free, order, one.first), one.moves(order)])
            causes[:, 0] = 0.0
            rows = np.vstack([lfilter([1.0], fed_back, causes, axis=1), one.measured - free])
            known = np.isfinite(one.measured)
            rows = rows if known.all() else rows[:, known]
            mean = rows.sum(axis=1) / max(rows.shape[1], 1)
            total += rows @ rows.T - rows.shape[1] * np.outer(mean, mean)
            count += rows.shape[1]
        return cls(float(total[-1, -1]) / max(count, 1), total[:-1, :-1], total[:-1, -1])


def _to_free_run(
    parts: Sequence[_Deviation], begun: tuple[FloatArray, _FreeRunError], furthest: float
) -> tuple[FloatArray, _FreeRunError]:
    """Coefficients with the least free-run error near those `begun` with, by Gauss-Newton."""
    found, left = begun
    for _ in range(_STEPS):
        step = np.linalg.lstsq(left.matrix, left.slope, rcond=None)[0]
        for _ in range(_HALVINGS):
            trial = found + step
            if _settles(trial, furthest):
                less = _FreeRunError.of(parts, trial)
                if less.square < left.square:
                    break
            step = 0.5 * step
        else:
            break
        done = less.square > (1.0 - _CONVERGED) * left.square
        found, left = trial, less
        if done:
            break
    return found, left


def _gain(tau_s: float, dt_s: float) -> float:
    return float(1.0 - np.exp(-dt_s / tau_s))


def start_of(steady: FloatArray, start: FloatArray, k: int) -> float:
    """Start of a free run: the measured value, or the steady-state value where that is missing."""
    return float(start[k]) if np.isfinite(start[k]) else float(steady[0, k])
