"""Analytical redundancy: each engine channel predicted from each other one, learned from the logs.

`learn` fits one small model per ordered pair of engine channels to the training logs, in corrected
values (`narxcal.atmosphere`), and measures what is left on logs that were left out. `examine`
compares a log with them and says which channel is wrong, since when and how.

    x^_ij = b_ij . phi(x_j, M, ln delta),   e_ij = (x_i - x^_ij) / d_i
    c_i   = sum_j w_ij e_ij, w_ij ~ 1 / s_ij^2
    S_i   = the largest of the means of c_i over 20 s, 100 s and the log, each over its limit times
            sigma_i

A fault of channel k is in every e_kj, and in no residual that does not contain k: the channel is at
fault without which all others agree (structured residuals; Gertler 1998, Fault Detection and
Diagnosis in Engineering Systems, ch. 6). `s_ij` and `sigma_i` are the RMS of e_ij and c_i on
left-out logs, combined with the scatter that engines of one type and their meters have (`_PRIOR`),
as few logs say little about it.

| symbol | meaning | unit |
|---|---|---|
| x_i | corrected channel i, mean of 1 s; temperatures in K | unit of i |
| phi | cubic in x_j, its distance from three lags of itself, also times x_j; M, ln delta | - |
| d_i | half of x^_i and half of the mean of channel i | unit of i |

A hypothesis about a whole log (another unit, two channels exchanged) is accepted where undoing it
brings all |S_i| below 1. Late channels and stretched time show in the dynamics alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter

from data_prep.log import Log
from narxcal.atmosphere import KELVIN, air_state, corrected_scale
from narxcal.channels import CHANNELS
from narxcal.steady.model import ALTERED
from narxcal.support.arrays import BoolArray, FloatArray, IntArray, bridge_gaps, noise_level
from narxcal.support.errors import ModelError
from training.delays import DELAY_STEP_S, block_means, delay_table, delays_between

_STEP_S = 1.0
_LEAST_STEPS = 10  # of a log; fewer show no relation of channels
_LAGS_S = (2.0, 8.0, 30.0)
# Means over short windows of transients scatter more than those over long ones: windows in s, and
# the limits of S_i in them. The largest of left-out flights: 4.3 and 3.3.
WINDOWS_S, LIMITS, _WHOLE_LIMIT = (20.0, 100.0), (6.0, 4.4), 2.7
_RIDGE = 1e-4
# Scatter between engines of a type and their meters, as a share of the level, until left-out logs
# say more; it counts as `PRIOR_LOGS` of them.
_PRIOR = {"%": 0.01, "degC": 0.024, "kg/h": 0.03}
_PRIOR_OTHER, PRIOR_LOGS = 0.03, 1.5
AIR = ("ALT_ft", "Mach", "dT_C")
_MOST_FOLDS = 8

Values = Mapping[str, FloatArray]


@dataclass(frozen=True, eq=False)
class Signals:
    """One log in means over `step_s`: channel -> (time,), in canonical units."""

    time_s: FloatArray
    values: Values
    step_s: float

    @classmethod
    def of(cls, log: Log, step_s: float = _STEP_S) -> Self:
        """Means of the finite samples in each block; NaN where there are none."""
        size = max(1, round(step_s / log.dt_s))
        count = len(log) // size
        names = [name for name in log.channels if name in CHANNELS]
        values = {name: block_means(log[name][: count * size], size) for name in names}
        time_s = log.time_s[: count * size].reshape(count, size).mean(axis=1)
        return cls(time_s, values, size * log.dt_s)

    def having(self, values: Values) -> Signals:
        """Signals with some channels replaced."""
        return replace(self, values={**self.values, **values})


@dataclass(frozen=True, eq=False)
class Corrected:
    """Corrected engine channels, and the air they are in."""

    x: Values
    scale: Mapping[str, FloatArray]
    offset: Mapping[str, float]
    mach: FloatArray
    log_delta: FloatArray
    known: BoolArray

    @classmethod
    def of(cls, signals: Signals, names: Sequence[str]) -> Self:
        """Correct the channels `names`; where air data are missing their neighbours' are taken."""
        zero = np.zeros(len(signals.time_s))
        known = np.all([np.isfinite(signals.values.get(name, zero)) for name in AIR], axis=0)
        air_values = [bridge_gaps(signals.values.get(name, zero)) for name in AIR]
        air_values = [np.where(np.isfinite(each), each, 0.0) for each in air_values]
        # A Mach number in percent, say, must not overflow before it is recognised.
        mach = np.clip(air_values[1], 0.0, 3.0)
        air = air_state(air_values[0], mach, np.clip(air_values[2], -150.0, 150.0))
        x, scale, offset = {}, {}, {}
        for name in names:
            factor, offset[name] = corrected_scale(name, air)
            scale[name] = np.broadcast_to(np.asarray(factor, dtype=np.float64), zero.shape)
            x[name] = (signals.values[name] + offset[name]) / scale[name]
        return cls(x, scale, offset, mach, np.log(air.delta), known)

    def raw(self, name: str, corrected: FloatArray) -> FloatArray:
        """Back to the canonical unit."""
        return corrected * self.scale[name] - self.offset[name]


def _features(z: FloatArray, air: Corrected, step_s: float) -> FloatArray:
    """Phi (time, 18) of a channel scaled to zero mean and unit spread."""
    mach, log_delta = air.mach, air.log_delta
    apart = []
    for lag_s in _LAGS_S:
        a = np.exp(-step_s / lag_s)
        apart.append(z - z[0] - lfilter([1.0 - a], [1.0, -a], z - z[0]))
    columns = [np.ones_like(z), z, z**2, z**3, *apart, *(z * each for each in apart)]
    columns += [mach, mach**2, mach * z, mach * z**2, log_delta, log_delta * z]
    return np.column_stack(columns)


@dataclass(frozen=True, eq=False)
class Bank:
    """The pair models with what they leave on left-out logs; stored with the bundle.

    | field | meaning |
    |---|---|
    | `centre`, `spread` | mean and standard deviation of each corrected channel |
    | `low`, `high` | its range in the training logs, scaled |
    | `air` | ranges of Mach number and ln delta in the training logs |
    | `models` | target -> source -> coefficients b |
    | `pairs` | target -> source -> RMS of e on left-out logs, with the prior |
    | `sigma` | RMS of c on left-out logs, with the prior |
    | `edges`, `regimes` | power limits of the regimes, and RMS of c in each over that in all |
    | `levels` | channel -> median of c on each left-out log |
    | `stretch` | k -> ln r(k), see `_stretched` |
    | `delays` | target -> source -> (mean, standard deviation) of the delay in s |
    | `noise`, `updates` | largest noise level, and update interval in s, of each channel |
    | `logs` | number of logs that were left out |
    | `used` | the channels that the model uses |
    """

    channels: tuple[str, ...]
    centre: Mapping[str, float]
    spread: Mapping[str, float]
    low: Mapping[str, float]
    high: Mapping[str, float]
    air: Mapping[str, tuple[float, float]]
    models: Mapping[str, Mapping[str, tuple[float, ...]]]
    pairs: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    sigma: Mapping[str, float] = field(default_factory=dict)
    edges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    regimes: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    levels: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    stretch: Mapping[str, float] = field(default_factory=dict)
    delays: Mapping[str, Mapping[str, tuple[float, float]]] = field(default_factory=dict)
    noise: Mapping[str, float] = field(default_factory=dict)
    updates: Mapping[str, float] = field(default_factory=dict)
    logs: int = 0
    used: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """For the bundle's document."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}

    @classmethod
    def from_json(cls, stored: Mapping[str, Any]) -> Self:
        """Rebuild from `to_json`, also after a round trip through JSON.

        Raises `ModelError` where a part is missing.
        """
        lacking = [name for name in cls.__dataclass_fields__ if name not in stored]
        if lacking:
            raise ModelError(f"the part 'redundancy' has no '{lacking[0]}'", hint=ALTERED)
        known = {name: stored[name] for name in cls.__dataclass_fields__}
        return cls(**{**known, "channels": tuple(known["channels"])})

    def predict(
        self, air: Corrected, target: str, source: str, step_s: float
    ) -> tuple[FloatArray, FloatArray]:
        """Corrected target (time,) and the side, 1 above and -1 below, that the source is beyond.

        A source beyond its training range counts as at the limit: all engine channels rise with
        power, so that the target is then at least (or at most) the prediction.
        """
        z = (bridge_gaps(air.x[source]) - self.centre[source]) / self.spread[source]
        inside = np.clip(z, self.low[source], self.high[source])
        found = _features(inside, air, step_s) @ np.asarray(self.models[target][source])
        side = np.sign(z - inside)
        return found * self.spread[target] + self.centre[target], side


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals of one log, and the channels that took part; all values (time,)."""

    bank: Bank
    signals: Signals
    channels: tuple[str, ...]
    errors: Mapping[str, Values]  # e: target -> source
    expected: Values  # corrected
    consensus: Values  # c
    smooth: Values  # S
    corrected: Corrected

    @property
    def flagged(self) -> dict[str, BoolArray]:
        """Samples at which |S| exceeds 1."""
        return {name: np.abs(self.smooth[name]) > 1.0 for name in self.channels}

    @property
    def misfit(self) -> float:
        """Mean of S^2, bounded, over samples and channels."""
        found = [np.minimum(each**2, 4.0) for each in self.smooth.values()]
        found = [each[np.isfinite(each)] for each in found]
        return float(np.mean([np.mean(each) if len(each) else 4.0 for each in found]))

    @property
    def extrapolation(self) -> float:
        """Mean factor on the tolerances for air that the training logs have not seen."""
        return float(np.mean(np.clip(margins_outside(self.bank, self.corrected), 1.0, _FAR)))

    @property
    def sound(self) -> bool:
        """Whether hardly any sample is flagged."""
        return all(self.share(name) < _SOUND for name in self.channels)

    def share(self, name: str) -> float:
        """Share of the testable samples of a channel that are flagged."""
        known = np.isfinite(self.smooth[name])
        return float(self.flagged[name].sum() / max(known.sum(), 1))


_SOUND = 0.02


def residuals(
    bank: Bank, signals: Signals, channels: Sequence[str], step_s: float = 0.0
) -> Residuals:
    """Compare the channels of one log with each other; `step_s` replaces that of the signals."""
    step_s = step_s or signals.step_s
    air = Corrected.of(signals, channels)
    far = margins_outside(bank, air)
    testable = air.known & (far < _FAR)
    near = _inside(bank, air)
    errors: dict[str, dict[str, FloatArray]] = {}
    expected, consensus, smooth = {}, {}, {}
    for i in channels:
        others = [j for j in channels if j != i]
        found = {j: bank.predict(near, i, j, step_s) for j in others}
        weights = {j: bank.pairs[i][j] ** -2.0 if bank.pairs else 1.0 for j in others}
        known = {j: np.where(np.isfinite(air.x[j]), found[j][0], np.nan) for j in others}
        expected[i] = _weighted(known, weights)
        scale = 0.5 * np.maximum(expected[i], 0.0) + 0.5 * abs(bank.centre[i])
        errors[i] = {j: _one_sided((air.x[i] - known[j]) / scale, found[j][1]) for j in others}
        consensus[i] = np.where(testable, _weighted(errors[i], weights), np.nan)
        tolerance = _tolerance(bank, i, expected[i], step_s) * _fewer(bank, i, others)
        tolerance = tolerance * np.maximum(far, 1.0)
        smooth[i] = _larger(consensus[i] / tolerance, signals.step_s)
    return Residuals(bank, signals, tuple(channels), errors, expected, consensus, smooth, air)


_LOW_HIGH = (15.0, 85.0)  # percentiles of power
_REGIME_STEPS, _MOST_TOLERANT = 100.0, 3.0


def _regimes(bank: Bank, name: str, expected: FloatArray, step_s: float) -> IntArray:
    """Low, middle or high power (0 to 2), plus 3 while it changes: models are unequally good there.

    Bleeds, valves and idle schedules act at low power, and slams excite what lags leave out.
    """
    z = bridge_gaps((expected - bank.centre[name]) / bank.spread[name])
    z = np.where(np.isfinite(z), z, 0.0)
    level = (z > bank.edges[name][0]).astype(np.int64) + (z > bank.edges[name][1])
    size = max(3, round(30.0 / step_s))
    moving = np.abs(z - uniform_filter1d(z, size, mode="nearest")) > 0.1
    reach = uniform_filter1d(moving.astype(np.float64), size, mode="nearest") > 0.01
    return np.asarray(level + 3 * reach)


def _tolerance(bank: Bank, name: str, expected: FloatArray, step_s: float) -> FloatArray:
    """Sigma (time,) in the regime of each sample."""
    if name not in bank.regimes:
        return np.full(len(expected), bank.sigma.get(name, 1.0))
    ratios = np.asarray(bank.regimes[name])
    return np.asarray(bank.sigma[name] * ratios[_regimes(bank, name, expected, step_s)])


def _fewer(bank: Bank, name: str, others: Sequence[str]) -> float:
    """Factor by which sigma grows with fewer sources: that of independent errors s_ij."""
    if not bank.pairs:
        return 1.0
    every, some = (
        sum(bank.pairs[name][j] ** -2.0 for j in sources) for sources in (bank.pairs[name], others)
    )
    return float(np.sqrt(every / some)) if some else 1.0


def _regime_ratios(name: str, left_out: Sequence[Residuals]) -> tuple[float, ...]:
    """RMS of c in each regime over that of all, at least 1, from the left-out logs."""
    where = [_regimes(one.bank, name, one.expected[name], one.signals.step_s) for one in left_out]
    regime = np.concatenate(where)
    squares = np.concatenate([one.consensus[name] for one in left_out]) ** 2
    known = np.isfinite(squares)
    whole = float(np.mean(squares[known])) if known.any() else 1.0
    ratios = []
    for k in range(6):
        own = squares[known & (regime == k)]
        total = np.sum(own) + _REGIME_STEPS * whole
        ratio = np.sqrt(total / ((len(own) + _REGIME_STEPS) * max(whole, 1e-300)))
        ratios.append(float(np.clip(ratio, 1.0, _MOST_TOLERANT)))
    return tuple(ratios)


def _one_sided(error: FloatArray, side: FloatArray) -> FloatArray:
    error = np.where(side > 0.0, np.minimum(error, 0.0), error)
    return np.where(side < 0.0, np.maximum(error, 0.0), error)


def _weighted(values: Values, weights: Mapping[str, float]) -> FloatArray:
    """Weighted mean of what is finite; NaN where nothing is."""
    stack = np.stack(list(values.values()))
    weight = np.array([weights[name] for name in values])[:, None] * np.isfinite(stack)
    total = np.sum(np.where(weight > 0.0, stack, 0.0) * weight, axis=0)
    size = weight.sum(axis=0)
    return np.where(size > 0.0, total / np.maximum(size, 1e-300), np.nan)


def _larger(deviation: FloatArray, step_s: float) -> FloatArray:
    """S (time,): of the means over the windows, each over its limit, the one of larger size."""
    short, long = (
        moving_mean(deviation, round(window_s / step_s)) / limit
        for window_s, limit in zip(WINDOWS_S, LIMITS, strict=True)
    )
    found = np.where(np.abs(long) > np.abs(np.nan_to_num(short)), long, short)
    known = deviation[np.isfinite(deviation)]
    if len(known) * step_s < _LEAST_WHOLE_S or abs(np.mean(np.sign(known))) < _ONE_SIGN:
        return found
    whole = float(np.mean(known)) / _WHOLE_LIMIT
    return np.where(np.isfinite(found) & (np.abs(found) < abs(whole)), whole, found)


_LEAST_WHOLE_S = 300.0
_ONE_SIGN = 0.6  # surplus of samples of one sign that a wrong level of a whole log has


def moving_mean(values: FloatArray, size: int) -> FloatArray:
    """Centred mean of the finite samples; NaN where fewer than half are."""
    known = np.isfinite(values)
    weight = uniform_filter1d(known.astype(np.float64), size, mode="nearest")
    total = uniform_filter1d(np.where(known, values, 0.0), size, mode="nearest")
    return np.where(weight > 0.5, total / np.maximum(weight, 1e-9), np.nan)


# What air may differ by from that of the training logs without a larger error, and the number of
# such margins from which on nothing is tested; between them the tolerance grows with their number.
_MARGINS = {"mach": 0.04, "log_delta": 0.1}
_FAR = 5.0


def inside_air(bank: Bank, air: Corrected) -> BoolArray:
    """Samples in air like that of the training logs; elsewhere the models extrapolate."""
    return air.known & (margins_outside(bank, air) < 1.0)


def margins_outside(bank: Bank, air: Corrected) -> FloatArray:
    """Largest distance (time,) of Mach number or ln delta from the training logs, in margins."""
    found = np.zeros(len(air.mach))
    for name, margin in _MARGINS.items():
        low, high = bank.air[name]
        values = getattr(air, name)
        found = np.maximum(found, np.maximum(low - values, values - high) / margin)
    return found


def _inside(bank: Bank, air: Corrected) -> Corrected:
    """The same channels in the nearest air of the training logs, for the models to go by."""
    nearest = {
        name: np.clip(getattr(air, name), bank.air[name][0] - margin, bank.air[name][1] + margin)
        for name, margin in _MARGINS.items()
    }
    return replace(air, **nearest)


def learn(logs: Sequence[Log], channels: Sequence[str]) -> Bank | None:
    """Fit the bank to the engine channels that most of the prepared logs record.

    `channels` are those of the model: the others support the comparison, and no fault of them is
    reported. None where there are fewer than two. Each log is left out once to measure `sigma`, of
    more than eight logs groups of them.
    """
    logs = [log for log in logs if _is_informative(log)]
    names = _engine_channels(logs)
    if len(names) < 2:
        return None
    all_signals = [Signals.of(log) for log in logs]
    parts = all_signals if len(all_signals) > 1 else _halves(all_signals[0])
    folds = [parts[k :: min(_MOST_FOLDS, len(parts))] for k in range(min(_MOST_FOLDS, len(parts)))]
    partial = [(_fit(_others(parts, fold), names), fold) for fold in folds]
    plain = [residuals(bank, one, names) for bank, fold in partial for one in fold]
    pairs = {
        i: {j: _rms(i, j, [one.errors[i][j] for one in plain]) for j in names if j != i}
        for i in names
    }
    left_out = [
        residuals(replace(bank, pairs=pairs), one, names) for bank, fold in partial for one in fold
    ]
    whole = replace(_fit(all_signals, names), pairs=pairs)
    ratios = {k: [log_ratio(whole, one, names, k) for one in all_signals] for k in STRETCHES}
    return replace(
        whole,
        stretch={str(k): _finite_mean(values) for k, values in ratios.items()},
        sigma={name: _rms(name, "", [one.consensus[name] for one in left_out]) for name in names},
        regimes={name: _regime_ratios(name, left_out) for name in names},
        levels={name: tuple(_level(one.consensus[name]) for one in left_out) for name in names},
        delays=delay_table([delays_of(log, names) for log in logs], names, PRIOR_LOGS),
        noise={
            name: max(noise_of(log, name) for log in logs if log.recorded([name])) for name in names
        },
        updates=_longest_updates(logs),
        logs=sum(any(np.isfinite(c).any() for c in one.consensus.values()) for one in left_out),
        used=tuple(name for name in names if name in channels),
    )


def _finite_mean(values: Sequence[float]) -> float:
    """Mean of the finite values; 0 where there are none."""
    known = [each for each in values if np.isfinite(each)]
    return float(np.mean(known)) if known else 0.0


def _is_informative(log: Log) -> bool:
    """Whether a log is long enough, and has samples of two engine channels."""
    engine = tuple(name for name in CHANNELS if CHANNELS[name].role in _ENGINE)
    return len(log) * log.dt_s >= _LEAST_STEPS * _STEP_S and len(log.recorded(engine)) > 1


_ENGINE = frozenset({"output", "lever"})


def _others(parts: Sequence[Signals], fold: Sequence[Signals]) -> list[Signals]:
    return [one for one in parts if all(one is not other for other in fold)]


def _engine_channels(logs: Sequence[Log]) -> tuple[str, ...]:
    """Outputs and levers that every log has, most with samples, and that move."""
    return tuple(
        name
        for name in CHANNELS
        if CHANNELS[name].role in _ENGINE
        and all(name in log.channels for log in logs)
        and 2 * sum(bool(log.recorded([name])) for log in logs) > len(logs)
        and np.nanstd(np.concatenate([log[name] for log in logs])) > 0.0
    )


def _halves(signals: Signals) -> list[Signals]:
    middle = len(signals.time_s) // 2
    return [
        Signals(
            signals.time_s[part],
            {name: values[part] for name, values in signals.values.items()},
            signals.step_s,
        )
        for part in (slice(None, middle), slice(middle, None))
    ]


def _fit(logs: Sequence[Signals], names: Sequence[str]) -> Bank:
    air = [_in_known_air(Corrected.of(one, names)) for one in logs]
    joined = {name: np.concatenate([one.x[name] for one in air]) for name in names}
    known = {name: values[np.isfinite(values)] for name, values in joined.items()}
    centre = {name: float(np.mean(each)) if len(each) else 0.0 for name, each in known.items()}
    spread = {
        name: max(float(np.std(each)), 1e-9) if len(each) else 1.0 for name, each in known.items()
    }
    low, high = {}, {}
    for name in names:
        ends = np.array(_percentiles((joined[name] - centre[name]) / spread[name], (0.1, 99.9)))
        low[name], high[name] = (
            float(ends[0] - 0.05 * np.ptp(ends)),
            float(ends[1] + 0.05 * np.ptp(ends)),
        )
    ranges = {
        name: _percentiles(
            np.concatenate([np.where(one.known, getattr(one, name), np.nan) for one in air]),
            (0.1, 99.9),
        )
        for name in ("mach", "log_delta")
    }
    scaled = [{name: (one.x[name] - centre[name]) / spread[name] for name in names} for one in air]
    models: dict[str, dict[str, tuple[float, ...]]] = {name: {} for name in names}
    for j in names:
        phi = np.concatenate(
            [
                _features(np.clip(bridge_gaps(z[j]), low[j], high[j]), one, part.step_s)
                for z, one, part in zip(scaled, air, logs, strict=True)
            ]
        )
        source = np.isfinite(np.concatenate([z[j] for z in scaled]))
        for i in names:
            if i != j:
                target = np.concatenate([z[i] for z in scaled])
                usable = source & np.isfinite(target)
                models[i][j] = tuple(_robust_fit(phi[usable], target[usable]).tolist())
    edges = {
        name: _percentiles(each / spread[name] - centre[name] / spread[name], _LOW_HIGH)
        for name, each in joined.items()
    }
    return Bank(tuple(names), centre, spread, low, high, ranges, models, edges=edges)


def _in_known_air(air: Corrected) -> Corrected:
    """Corrected channels where the air is known: elsewhere they were corrected by a guess."""
    return replace(air, x={name: np.where(air.known, x, np.nan) for name, x in air.x.items()})


def _percentiles(values: FloatArray, shares: tuple[float, float]) -> tuple[float, float]:
    """Percentiles of the finite values; zeros where there are none."""
    known = values[np.isfinite(values)]
    low, high = np.percentile(known, shares) if len(known) else (0.0, 0.0)
    return float(low), float(high)


def _robust_fit(phi: FloatArray, target: FloatArray) -> FloatArray:
    """Ridge regression with soft-L1 weights, by reweighting; NaN where there is too little."""
    if len(target) < phi.shape[1]:
        return np.full(phi.shape[1], np.nan)
    size = np.sqrt(np.mean(phi**2, axis=0)) + 1e-12
    scaled, weight = phi / size, np.ones(len(target))
    ridge = _RIDGE * len(target) * np.eye(phi.shape[1])
    found = np.zeros(phi.shape[1])
    for _ in range(4):
        left = (scaled * weight[:, None]).T
        found = np.linalg.solve(left @ scaled + ridge, left @ target)
        error = target - scaled @ found
        spread = 1.4826 * float(np.median(np.abs(error))) + 1e-12
        weight = 1.0 / np.sqrt(1.0 + (error / (2.0 * spread)) ** 2)
    return np.asarray(found / size)


def prior_scatter(name: str, level: float) -> float:
    """Scatter of a channel between engines of a type and their meters at a level, in its unit."""
    unit = CHANNELS[name].unit if name in CHANNELS else ""
    return _PRIOR.get(unit, _PRIOR_OTHER) * (level + (KELVIN if unit == "degC" else 0.0))


def _rms(target: str, source: str, left_out: Sequence[FloatArray]) -> float:
    """RMS of residuals of the left-out logs and the prior ones, the larger prior of the two."""
    known = [each[np.isfinite(each)] for each in left_out]
    squares = [float(np.mean(each**2)) for each in known if len(each)]
    units = [CHANNELS[name].unit for name in (target, source) if name]
    prior = max(_PRIOR.get(unit, _PRIOR_OTHER) for unit in units)
    count = len(squares)
    # A model of all n logs is nearer to the next log than one of n - 1 is to the one left out.
    nearer = (1.0 + 1.0 / count) / (1.0 + 1.0 / (count - 1)) if count > 1 else 1.0
    total = PRIOR_LOGS * prior**2 + nearer * sum(squares)
    return float(np.sqrt(total / (PRIOR_LOGS + count)))


def _level(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else 0.0


def delays_of(log: Log, names: Sequence[str], stretch: float = 1.0) -> dict[tuple[str, str], float]:
    """Delays between the channels of a log in s, were its time stamps `stretch` times as short."""
    fine = Signals.of(log, DELAY_STEP_S * stretch)
    return delays_between({name: fine.values[name] for name in names}, fine.step_s / stretch)


def noise_of(log: Log, name: str) -> float:
    """White noise of a channel: what smoothing removed, or what is left."""
    return float(np.hypot(np.sqrt(log.noise.get(name, 0.0)), noise_level(log[name])))


def _longest_updates(logs: Sequence[Log]) -> dict[str, float]:
    names = {name for log in logs for name in log.recorded(tuple(log.updates))}
    return {
        name: max(log.updates.get(name, 0.0) for log in logs if log.recorded([name]))
        for name in sorted(names)
    }


STRETCHES = (0.5, 2.0)
_DYNAMIC_S, _MOVING = 150.0, 0.8


def log_ratio(bank: Bank, signals: Signals, channels: Sequence[str], stretch: float) -> float:
    """Ln r(k): mean over the pairs of the log ratio of the RMS residual in the moving samples.

    NaN where nothing moves.
    """
    sizes = []
    for step_s in (signals.step_s / stretch, signals.step_s):
        found = residuals(bank, signals, channels, step_s)
        size = round(_DYNAMIC_S / signals.step_s)
        shown = [x for x in found.corrected.x.values() if np.isfinite(x).any()]
        if not shown:
            return float("nan")
        first = shown[0]
        motion = np.abs(first - moving_mean(first, size // 5))
        moving = motion > np.nanpercentile(motion, 100.0 * _MOVING)
        pairs = [each for errors in found.errors.values() for each in errors.values()]
        rough = [(each - moving_mean(each, size))[moving] for each in pairs]
        if not all(np.isfinite(each).any() for each in rough):
            return float("nan")
        sizes.append([np.sqrt(np.nanmean(each**2) + 1e-12) for each in rough])
    return float(np.mean(np.log(np.array(sizes[0]) / np.array(sizes[1]))))
