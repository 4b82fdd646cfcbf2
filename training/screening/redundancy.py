"""Analytical redundancy: each engine channel predicted from each other one, learned from the logs.

A bank has one small model per ordered pair of engine channels, in corrected values
(`narxcal.atmosphere`), fitted to training logs by `training.screening.redundancy_fit`. With x_i the
corrected channel i in means of `STEP_S`, temperatures in K,

    x^_ij = b_ij . phi(x_j, M, ln delta),   e_ij = (x_i - x^_ij) / d_i
    r_i   = what the e_ij of all sources j agree on: their median; of two the smaller one if both
            have one sign, else 0

with d_i half of x^_i and half of the mean of channel i, and phi a cubic in x_j, its distance from
three lags of itself, also times x_j, M and ln delta. A fault of channel k is in every e_kj, hence
in r_k; of the sources of another channel it is one only, hence not in r_i (structured residuals;
Gertler 1998, Fault Detection and Diagnosis in Engineering Systems, ch. 6).

On a sound log r_i is a random effect of the log plus wander within it
(`training.screening.scatter`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, Self

import numpy as np
from scipy.signal import lfilter

from data_prep.log import Log
from narxcal.atmosphere import air_state, corrected_scale
from narxcal.channels import CHANNELS
from narxcal.steady.model import ALTERED
from narxcal.support.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    bridge_gaps,
    known_mean,
    noise_level,
)
from narxcal.support.errors import ModelError
from narxcal.support.settings import read_stored
from training.screening.levels import DELAY_STEP_S, delays_between
from training.screening.scatter import BLOCK_S, LEAST_STRETCH_S, PRIORS, Blocks, Priors, Scatter

STEP_S = 1.0
_LAGS_S = (2.0, 8.0, 30.0)
AIR = ("ALT_ft", "Mach", "dT_C")

Values = Mapping[str, FloatArray]
Delays = Mapping[tuple[str, str], float]  # of a channel behind another one, in s


@dataclass(frozen=True, eq=False)
class Signals:
    """One log in means over `step_s`: channel -> (time,), in canonical units."""

    time_s: FloatArray
    values: Values
    step_s: float

    @classmethod
    def of(cls, log: Log, step_s: float = STEP_S) -> Self:
        """Means of the finite samples in each block; NaN where there are none."""
        size = max(1, round(step_s / log.dt_s))
        count = len(log) // size
        names = [name for name in log.channels if name in CHANNELS]
        values = {
            name: known_mean(log[name][: count * size].reshape(count, size), axis=1)
            for name in names
        }
        time_s = log.time_s[: count * size].reshape(count, size).mean(axis=1)
        return cls(time_s, values, size * log.dt_s)

    def having(self, values: Values) -> Signals:
        return replace(self, values={**self.values, **values})

    def part(self, rows: slice) -> Signals:
        values = {name: each[rows] for name, each in self.values.items()}
        return Signals(self.time_s[rows], values, self.step_s)


@dataclass(frozen=True, eq=False)
class Corrected:
    """Corrected engine channels, and the air they are in; `known` (time,) where it is."""

    signals: Signals
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
        return cls(signals, x, scale, offset, mach, np.log(air.delta), known)

    def raw(self, name: str, corrected: FloatArray) -> FloatArray:
        return corrected * self.scale[name] - self.offset[name]


FEATURES = 16


def _features(z: FloatArray, air: Corrected, step_s: float) -> FloatArray:
    """Phi (time, 16) of a channel scaled to zero mean and unit spread."""
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
    | `cells` | source -> codes of the cells in which the training logs have been |
    | `models` | target -> source -> coefficients b |
    | `level` | u of the logs that were left out |
    | `steps` | octave -> heights of the strongest steps of these logs (`scatter`) |
    | `apart` | likewise, without what the other engine of the flight shows; empty without one |
    | `stretch` | k -> (mean, scatter) of ln r(k), see `log_ratio` |
    | `delays`, `late` | mean delay in s, target -> source; how much later logs were |
    | `noise` | of each channel in the noisiest minute of each log |
    | `updates` | largest update interval of each channel in s |
    | `rounding` | coarsest steps of the values of each channel |
    | `logs` | number of recordings of one engine |
    | `used` | the channels that the model uses |
    | `priors` | what sound logs show in general; not stored, it is that of the version |
    """

    channels: tuple[str, ...] = ()
    centre: Mapping[str, float] = field(default_factory=dict)
    spread: Mapping[str, float] = field(default_factory=dict)
    low: Mapping[str, float] = field(default_factory=dict)
    high: Mapping[str, float] = field(default_factory=dict)
    cells: Mapping[str, Sequence[int]] = field(default_factory=dict)
    models: Mapping[str, Mapping[str, tuple[float, ...]]] = field(default_factory=dict)
    level: Mapping[str, Sequence[float]] = field(default_factory=dict)
    steps: Mapping[str, Mapping[str, Sequence[float]]] = field(default_factory=dict)
    apart: Mapping[str, Mapping[str, Sequence[float]]] = field(default_factory=dict)
    stretch: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    delays: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    late: Mapping[str, Sequence[float]] = field(default_factory=dict)
    noise: Mapping[str, Sequence[float]] = field(default_factory=dict)
    updates: Mapping[str, float] = field(default_factory=dict)
    rounding: Mapping[str, float] = field(default_factory=dict)
    logs: int = 0
    used: tuple[str, ...] = ()
    priors: Priors = PRIORS

    def to_json(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in self._stored()}

    @classmethod
    def _stored(cls) -> list[str]:
        return [name for name in cls.__dataclass_fields__ if name != "priors"]

    @classmethod
    def from_json(cls, stored: Mapping[str, Any]) -> Self:
        """Rebuild from `to_json`, also after a round trip through JSON.

        Raises `ModelError` where a part is missing, of another type, or does not fit the channels.
        """
        names = cls._stored()
        if lacking := next((name for name in names if name not in stored), ""):
            raise ModelError(f"the part 'redundancy' has no '{lacking}'", hint=ALTERED)
        found = read_stored(cls, {name: stored[name] for name in names}, "redundancy")
        if not found.complete:
            raise ModelError("the part 'redundancy' does not fit its channels", hint=ALTERED)
        return found

    @property
    def complete(self) -> bool:
        """Whether every channel has its entries, of the lengths that the formulas take."""
        names = set(self.channels)
        own = (self.centre, self.spread, self.low, self.high, self.level, self.steps, self.late)
        every = all(names <= set(part) for part in (*own, self.cells, self.models))
        steps = [*self.steps.values(), *self.apart.values()]
        return (
            every
            and names | set(self.used) <= set(CHANNELS)
            and all(size > 0.0 for size in self.spread.values())
            and all(k.isdecimal() and x for by in steps for k, x in by.items())
            and all({*filter(is_measured, names - {i})} <= set(self.models[i]) for i in names)
            and all(len(b) == FEATURES for row in self.models.values() for b in row.values())
            and set(map(str, STRETCHES)) <= set(self.stretch)
        )

    def predict(self, design: Design, target: str, source: str) -> FloatArray:
        """Corrected target (time,) by the model of one source."""
        found = design.phi[source] @ np.asarray(self.models[target][source])
        return np.asarray(found * self.spread[target] + self.centre[target])

    def unit(self, name: str, expected: FloatArray) -> FloatArray:
        """D (time,): half of what is expected of a channel, and half of its mean, corrected."""
        return np.asarray(0.5 * np.maximum(expected, 0.0) + 0.5 * abs(self.centre[name]))

    def covers(self, design: Design, source: str) -> BoolArray:
        """Whether training logs have been in or next to the cell of each sample (time,)."""
        return np.isin(design.cells[source], self._covered[source])

    @cached_property
    def scatter(self) -> dict[str, Scatter]:
        """What is known of the level of one more log in each channel."""
        return self.priors.scatter.of_levels(
            {name: self.level.get(name, ()) for name in self.channels if is_measured(name)}
        )

    @cached_property
    def late_scatter(self) -> dict[str, Scatter]:
        return self.priors.scatter.of_delays(
            {name: self.late.get(name, ()) for name in self.channels}
        )

    def heights(self, *, apart: bool = False) -> dict[str, dict[int, Sequence[float]]]:
        """Channel -> octave -> heights of the strongest steps of left-out logs."""
        steps, measured = self.apart if apart else self.steps, filter(is_measured, self.channels)
        return {n: {int(k): each for k, each in steps.get(n, {}).items()} for n in measured}

    def step_limits(self, share: float, *, apart: bool = False) -> dict[str, dict[int, float]]:
        """Channel -> octave -> height of a step that one more log exceeds with `share`.

        `apart` is of what the other engine of the flight does not show: it is less than all that a
        log shows, and is as in other flights.
        """
        limits = self.priors.steps.limits
        found = limits(self.heights(), share)
        if apart and any(self.apart.values()):
            less = limits(self.heights(apart=True), share)
            for name, own in found.items():
                own |= {k: min(limit, less[name].get(k, limit)) for k, limit in own.items()}
        return found

    def noise_limits(self, share: float) -> dict[str, float]:
        """Channel -> noise that the noisiest minute of one more log exceeds with `share`.

        It scatters as the heights of steps do, about what the logs show.
        """
        seen = {name: {0: each} for name, each in self.noise.items() if each}
        found = replace(self.priors.steps, logs=0.0).limits(seen, share)
        return {name: each[0] for name, each in found.items()}

    @cached_property
    def _covered(self) -> dict[str, IntArray]:
        """Source -> codes of its cells and of those next to them."""
        seen = {name: np.asarray(each, dtype=np.int64) for name, each in self.cells.items()}
        return {name: np.unique((each[:, None] + _NEXT).ravel()) for name, each in seen.items()}


@dataclass(frozen=True, eq=False)
class Design:
    """What models are applied to: corrected channels of one log, features and cells of each."""

    air: Corrected
    phi: Values  # (time, 16)
    cells: Mapping[str, IntArray]

    @classmethod
    def of(cls, bank: Bank, air: Corrected, step_s: float = 0.0) -> Self:
        """Scale channels as the bank does; `step_s` replaces that of the signals."""
        phi, cells = {}, {}
        for name, x in air.x.items():
            z = (x - bank.centre[name]) / bank.spread[name]
            inside = np.clip(np.nan_to_num(bridge_gaps(z)), bank.low[name], bank.high[name])
            phi[name] = _features(inside, air, step_s or air.signals.step_s)
            cells[name] = _cells(air, z)
        return cls(air, phi, cells)


# Cells of (source in its spread, Mach number, ln delta) in which, or next to which, training logs
# have to have been: elsewhere the models extrapolate, and nothing is compared.
_CELL = np.array([0.25, 0.06, 0.24])
_CODE = np.array([9_000_000, 3_000, 1])
_NEXT = (np.indices((3, 3, 3)).reshape(3, -1).T - 1) @ _CODE  # differences of codes


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals of one log; all values (time,), in units of `Residuals.scale`."""

    bank: Bank
    errors: Mapping[str, Values]  # e: target -> source
    expected: Values  # corrected
    agreed: Values  # r
    corrected: Corrected

    @property
    def signals(self) -> Signals:
        return self.corrected.signals

    def scale(self, name: str) -> FloatArray:
        """Unit of r of a channel: d, corrected."""
        return self.bank.unit(name, self.expected[name])

    def apart_from(self, mate: Residuals | None) -> Residuals:
        """R without what the other engine of the flight shows, too: air, manoeuvre and clock.

        It is zero where the other engine is further from what its channels say.
        """
        if mate is None:
            return self
        apart = dict(self.agreed)
        for name in apart.keys() & mate.agreed.keys():
            own, other = self.agreed[name], mate.agreed[name]
            apart[name] = np.where(abs(own) < abs(other), 0.0, agreement([own, own - other]))
        return replace(self, agreed=apart)

    def level(self, name: str) -> float:
        """U of a channel: the median of r; NaN where nothing can be compared."""
        known = self.agreed[name][np.isfinite(self.agreed[name])]
        return float(np.median(known)) if len(known) else float("nan")


def residuals(bank: Bank, signals: Signals, channels: Sequence[str]) -> Residuals:
    return compared(bank, Design.of(bank, Corrected.of(signals, channels)))


def compared(bank: Bank, design: Design) -> Residuals:
    """Compare the channels of a design with each other."""
    air, channels = design.air, tuple(design.phi)
    sources = [j for j in channels if is_measured(j)]
    testable = {j: air.known & bank.covers(design, j) for j in sources}
    errors: dict[str, dict[str, FloatArray]] = {name: {} for name in channels}
    expected: dict[str, FloatArray] = {}
    agreed: dict[str, FloatArray] = {}
    for i in channels:
        found = {j: bank.predict(design, i, j) for j in sources if j != i}
        known = {j: np.where(np.isfinite(air.x[j]), each, np.nan) for j, each in found.items()}
        if not known:
            expected[i] = agreed[i] = np.full(len(air.mach), np.nan)
            continue
        expected[i] = _middle(list(known.values()))
        unit = bank.unit(i, expected[i])
        errors[i] = {j: np.where(testable[j], (air.x[i] - known[j]) / unit, np.nan) for j in known}
        agreed[i] = agreement(list(errors[i].values()))
    return Residuals(bank, errors, expected, agreed, air)


def is_measured(name: str) -> bool:
    """Whether a sensor measures a channel; a lever is a command, which an engine may not follow."""
    return CHANNELS[name].role != "lever"


def agreement(parts: Sequence[FloatArray]) -> FloatArray:
    """What signals (time,) agree on: the median; of two the smaller one of one sign, else 0.

    NaN where a single one of several is known: it cannot be said which side is wrong.
    """
    if len(parts) == 1:
        return parts[0]
    stack = np.stack(parts)
    count = np.isfinite(stack).sum(axis=0)
    low = np.min(np.where(np.isfinite(stack), stack, np.inf), axis=0)
    high = np.max(np.where(np.isfinite(stack), stack, -np.inf), axis=0)
    smaller = np.where(np.abs(low) < np.abs(high), low, high)
    both = np.where(np.sign(low) == np.sign(high), smaller, 0.0)
    return np.where(count > 2, _middle(parts), np.where(count == 2, both, np.nan))


def _middle(parts: Sequence[FloatArray]) -> FloatArray:
    """Median of the finite values (time,); NaN where there is none."""
    ordered = np.sort(np.stack(parts), axis=0)  # NaN last
    count = np.isfinite(ordered).sum(axis=0)
    rows = np.arange(ordered.shape[1])
    low, high = ordered[np.maximum(count - 1, 0) // 2, rows], ordered[count // 2 % len(parts), rows]
    return np.asarray(np.where(count % 2 == 1, low, 0.5 * (low + high)))


def _cells(air: Corrected, z: FloatArray) -> IntArray:
    found = np.column_stack([np.nan_to_num(z), air.mach, air.log_delta]) / _CELL
    cells = np.clip(np.floor(found), -1000.0, 1000.0).astype(np.int64)
    return np.asarray((cells + 1500) @ _CODE)


def blocks_of(found: Residuals, name: str) -> Blocks:
    """Medians of r of a channel; blocks without half of their values are left out."""
    size = max(1, round(BLOCK_S / found.signals.step_s))
    count = len(found.signals.time_s) // size
    shape = (count, size)
    r = found.agreed[name][: count * size].reshape(shape)
    known = np.isfinite(r).sum(axis=1) * 2 > size
    time_s = found.signals.time_s[: count * size].reshape(shape).mean(axis=1)[known]
    return Blocks(time_s, _middle(list(r[known].T)))


def recording_of(log: Log) -> tuple[str, str]:
    """File and engine, which parts of one recording have in common."""
    return log.source.file or log.name, log.source.engine


def mate_of(log: Log, logs: Sequence[Log]) -> Log | None:
    """The log of another engine at the same times."""
    for one in logs:
        apart = one.source.engine != log.source.engine and one.source.file == log.source.file
        if apart and len(one) == len(log) and one.time_s[0] == log.time_s[0]:
            return one
    return None


def excess(usual: Mapping[str, float], found: Delays, name: str) -> float:
    """By how much a channel is later than the `usual` s behind others, as these agree; else NaN."""
    parts = [np.array([found[name, j] - each]) for j, each in usual.items() if (name, j) in found]
    return float(agreement(parts)[0]) if len(parts) > 1 else float("nan")


def delays_of(log: Log, names: Sequence[str]) -> dict[tuple[str, str], float]:
    fine = Signals.of(log, DELAY_STEP_S)
    return delays_between({name: fine.values[name] for name in names}, fine.step_s)


def minutes_of(log: Log) -> IntArray:
    """Rows at which stretches of `LEAST_STRETCH_S` begin, and the end of the last."""
    count = max(1, int(len(log) * log.dt_s / LEAST_STRETCH_S))
    return np.linspace(0, len(log), count + 1).astype(np.int64)


def noise_of(log: Log, name: str) -> FloatArray:
    """White noise of a channel by minute: what smoothing removed, and what is left of it.

    What is left is seen between samples half a second apart, which no average joins.
    """
    every, rows, values = max(1, round(0.5 / log.dt_s)), minutes_of(log), log[name]
    left = [noise_level(values[a:b:every]) for a, b in pairwise(rows.tolist())]
    return np.hypot(np.sqrt(log.noise.get(name, 0.0)), left)


STRETCHES = (0.5, 2.0)
_DYNAMIC_S, _MOVING = 150.0, 0.8


def log_ratio(found: Residuals, stretch: float) -> float:
    """Ln r(k): mean over the pairs of the log ratio of the RMS residual in the moving samples.

    r(k) is what the residual would be, were the stamps stretched by k, over what it is. NaN where
    nothing moves.
    """
    step_s = found.signals.step_s / stretch
    stretched = compared(found.bank, Design.of(found.bank, found.corrected, step_s))
    size = round(_DYNAMIC_S / found.signals.step_s)
    shown = [x for x in found.corrected.x.values() if np.isfinite(x).any()]
    motion = np.abs(shown[0] - moving_mean(shown[0], size // 5)) if shown else np.full(1, np.nan)
    if not np.isfinite(motion).any():
        return float("nan")
    moving = motion > np.nanpercentile(motion, 100.0 * _MOVING)
    sizes = []
    for one in (stretched, found):
        pairs = [e for name, each in one.errors.items() if is_measured(name) for e in each.values()]
        rough = [(each - moving_mean(each, size))[moving] for each in pairs]
        if not rough or not all(np.isfinite(each).any() for each in rough):
            return float("nan")
        sizes.append([np.sqrt(np.nanmean(each**2) + 1e-12) for each in rough])
    return float(np.mean(np.log(np.array(sizes[0]) / np.array(sizes[1]))))


def moving_mean(values: FloatArray, size: int) -> FloatArray:
    """Centred mean of the finite samples; NaN where fewer than half are."""
    size = min(size, len(values))
    known = np.isfinite(values)
    kernel = np.ones(max(size, 1))
    total = np.convolve(np.where(known, values, 0.0), kernel, "same")
    count = np.convolve(known.astype(np.float64), kernel, "same")
    whole = np.convolve(np.ones(len(values)), kernel, "same")
    return np.where(count > 0.5 * whole, total / np.maximum(count, 1e-9), np.nan)
