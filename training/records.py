"""Records that lags and network are fitted to, made of prepared logs, and the split of the logs.

**Local trim** removes the static error, so that the network learns dynamics only. A steady-state
model misses a real engine by a few tenths of a per cent (build tolerance, fuel meters, bleeds that
are not recorded), and a network trained on the raw deviation distorts its dynamics to follow that.
Before training, the steady-state values of each log are therefore shifted to agree with the log
wherever it is in equilibrium; between two such places A and B the shift changes as the
steady-state value does:

    shift(k) = shift_A + p(k) (shift_B - shift_A),   p = clip((ss - ss_A) / (ss_B - ss_A), 0, 1)

**Rest records** are synthetic: constant inputs and a deviation that has to vanish. Flights hardly
ever show a large deviation with constant inputs, so a network fitted to flights alone may keep one
for ever. These records ask that it is zero after a while; how it decays is left to the flights.

**Emphasis on motion** weighs samples. Engines are in equilibrium most of the time, where an
anchored network is right by its structure. Relative errors are judged, so a sample weighs the more
the lower the power; and Ti is read off the first tenth of a response, which takes half a second:
onsets weigh more.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatch
from typing import Final

import numpy as np

from data_prep.equilibrium import peak_to_peak, quasi_steady
from data_prep.log import Log
from data_prep.prepare import hold_inputs, with_outputs
from narxcal.calibration.calibration import steady_for_engine
from narxcal.calibration.dynamic import narx_features
from narxcal.channels import spools_of
from narxcal.lumped.engine import LumpedEngine
from narxcal.narx.config import NarxConfig
from narxcal.record import Record
from narxcal.steady.model import SteadyStateModel
from narxcal.support.arrays import BoolArray, FloatArray
from narxcal.support.errors import ConfigError, DataError
from training.config import RunConfig, SplitConfig
from training.dynamics.network import Material

# Narrower ranges of the air say little of how it acts. Over these, a third of the pressure at sea
# level goes, ram adds a tenth to it, and the absolute temperature changes by a tenth.
LEAST_WIDTHS: Final = {"ALT_ft": 10_000.0, "Mach": 0.38, "dT_C": 30.0}

_MOVES, _WITHIN_S = 0.01, 1.0  # share of the largest value that a target moves within this time
_BEFORE_S, _AFTER_S = 1.0, 12.0  # of a move: a response with its settling
_STEADY = 0.4  # weight elsewhere
_QUIET_S, _ONSET_S, _ONSET = 2.0, 1.2, 4.0  # a move out of equilibrium, and the weight of its onset
_LEVEL = (0.3, 1.2)  # shares of the largest value; below and beyond, weights go no further


def largest(targets: list[FloatArray]) -> FloatArray:
    """Largest magnitude (n_out,) of steady-state values (time, n_out) over all records."""
    most = np.stack([np.abs(one).max(axis=0) for one in targets]).max(axis=0)
    return np.asarray(np.maximum(most, 1e-9))


def motion_weight(
    target: FloatArray, actual: FloatArray, scale: FloatArray, dt_s: float
) -> FloatArray:
    """Weights (time,) from steady-state values and outputs (time, n_out), NaN where unknown.

    `scale` (n_out,) are the `largest` values.
    """
    within = round(_WITHIN_S / dt_s) | 1
    moving = peak_to_peak(target / scale, within).max(axis=1) > _MOVES
    rows = np.arange(len(moving))
    never = len(rows) + round(_AFTER_S / dt_s) + 1
    last = np.maximum.accumulate(np.where(moving, rows, -never))
    following = np.minimum.accumulate(np.where(moving, rows, 2 * never)[::-1])[::-1]
    near = (rows - last <= _AFTER_S / dt_s) | (following - rows <= _BEFORE_S / dt_s)
    level = np.mean(np.where(np.isfinite(actual), actual, target) / scale, axis=1)
    weight = np.where(near, 1.0, _STEADY)
    weight = weight * np.where(_onset(moving, dt_s), _ONSET, 1.0)
    return np.asarray(weight / np.clip(level, *_LEVEL))


def _onset(moving: BoolArray, dt_s: float) -> BoolArray:
    """Samples just after a move out of equilibrium; the centred window finds it half too early."""
    quiet, length = round(_QUIET_S / dt_s), round((_ONSET_S + 0.5 * _WITHIN_S) / dt_s)
    seen = np.concatenate([[0], np.cumsum(moving)])
    rows = np.arange(len(moving))
    begins = moving & (seen[rows] == seen[np.maximum(rows - quiet, 0)])
    counted = np.concatenate([[0], np.cumsum(begins)])
    return np.asarray(counted[rows + 1] > counted[np.maximum(rows + 1 - length, 0)])


def locally_trimmed(ss: FloatArray, measured: FloatArray, steady: BoolArray) -> FloatArray:
    """Return `ss` (time, n_out) shifted to agree with `measured` where `steady` (time,) is true.

    A masked measurement counts as not steady. An output that is never steady is unchanged.
    """
    return np.stack(
        [
            column + _shift(column, column - truth, steady & np.isfinite(truth))
            for column, truth in zip(ss.T, measured.T, strict=True)
        ],
        axis=1,
    )


def _shift(ss: FloatArray, error: FloatArray, steady: BoolArray) -> FloatArray:
    known = np.flatnonzero(steady)
    if not len(known):
        return np.zeros_like(ss)
    rows = np.arange(len(ss))
    after = np.searchsorted(known, rows)
    a = known[np.maximum(after - 1, 0)]
    b = known[np.minimum(after, len(known) - 1)]
    rise = ss[b] - ss[a]
    by_value = np.divide(ss - ss[a], rise, out=np.zeros_like(ss), where=rise != 0.0)
    by_time = np.divide(rows - a, b - a, out=np.zeros_like(ss), where=b != a)
    # Where the ends lie close together, the value says little about the way between them.
    close = np.abs(rise) < 0.02 * np.ptp(ss)
    part = np.clip(np.where(close, by_time, by_value), 0.0, 1.0)
    shift: FloatArray = -(error[a] + part * (error[b] - error[a]))
    return shift


_COUNT = {False: 60, True: 300}  # from any deviation, and from far ones
_FREE_SHARE = {False: 0.75, True: 0.5}  # of a record is not scored
_AMPLIFIED = 1.5  # times the deviations that flights show


def rest_records(
    records: Sequence[Record], moving: int, steps: int, seed: int, *, far: bool = False
) -> list[Record]:
    """Draw records of `steps` samples at conditions and deviations found in `records`.

    The first `moving` inputs, the increments, are zero. Outputs start at a drawn deviation, are
    unknown (NaN) for a while and zero at the end. Flights are mostly steady, so that a drawn
    deviation is mostly small; with `far`, one is drawn the more often the larger it is.
    """
    draw = np.random.default_rng(seed)
    u = np.concatenate([record.u for record in records])
    y = np.concatenate([record.y for record in records])
    y = y[np.isfinite(y).all(axis=1)]
    size = np.linalg.norm(y / np.maximum(y.std(axis=0), 1e-12), axis=1) if len(y) else np.empty(0)
    share = size / size.sum() if far and size.sum() > 0.0 else None
    drawn = []
    for _ in range(_COUNT[far] if len(y) else 0):
        inputs = u[draw.integers(len(u))].copy()
        inputs[:moving] = 0.0
        target = np.zeros((steps, y.shape[1]))
        target[: round(_FREE_SHARE[far] * steps)] = np.nan
        first = draw.integers(len(y)) if share is None else draw.choice(len(y), p=share)
        target[0] = _AMPLIFIED * y[first]
        drawn.append(Record(np.tile(inputs, (steps, 1)), target, "at rest"))
    return drawn


def material(
    config: RunConfig,
    steady: SteadyStateModel,
    lag: LumpedEngine | None,
    split: Split,
) -> Material:
    """Records of the logs to fit to and of those to stop by, and rest records if configured."""
    records, validation = (
        [deviation_record(log, steady, config, lag) for log in logs]
        for logs in (split.train, split.validate)
    )
    dt_s = split.train[0].dt_s
    if config.train.emphasis == "motion":
        records = _emphasised(records, dt_s, lagged=lag is not None)
    least = np.zeros(records[0].u.shape[1])
    # A range of uniform values is sqrt(12) standard deviations wide.
    schedule = [LEAST_WIDTHS.get(name, 0.0) / np.sqrt(12.0) for name in config.narx.schedule]
    least[len(least) - len(schedule) :] = schedule
    plain = Material(records, validation, dt_s, least_scale=least)
    return replace(plain, rest=_rest(config, plain, structure_of(config).moving))


def deviation_record(
    log: Log, steady: SteadyStateModel, config: RunConfig, lag: LumpedEngine | None = None
) -> Record:
    """Features and deviations of one log, which the network is fitted to.

    With lags in front of it, the deviations are the residual of the lags.
    """
    heat = None if lag is None or lag.governed else lag
    one = lag_samples(log, steady, config, heat)
    deviation, lagged = one.ss - one.measured, None
    if lag is not None:
        drive = lag.drive(one.inputs, steady.input_names, one.ss)
        lagged = lag.deviations(drive, deviation[0], log.dt_s)
        deviation = deviation - lagged
    columns = [steady.input_names.index(name) for name in config.narx.schedule]
    return Record(narx_features(one.ss, one.inputs[:, columns], lagged), deviation, log.name)


def _emphasised(records: Sequence[Record], dt_s: float, *, lagged: bool) -> list[Record]:
    """The records with their samples weighted by motion; features are those of `narx_features`."""
    parts = []
    for record in records:
        count = record.y.shape[1]
        before = record.u[:, count : 2 * count] if lagged else np.zeros_like(record.y)
        ss = record.u[:, (1 + lagged) * count :][:, :count]
        parts.append((ss, ss - before - record.y))
    scale = largest([ss for ss, _ in parts])
    return [
        replace(record, weight=motion_weight(*part, scale, dt_s))
        for record, part in zip(records, parts, strict=True)
    ]


@dataclass(frozen=True, eq=False)
class LagSamples:
    """One log: inputs (time, n_in), trimmed steady state and measured outputs (time, n_out)."""

    inputs: FloatArray
    ss: FloatArray
    measured: FloatArray

    def rows(self, part: slice) -> LagSamples:
        return LagSamples(self.inputs[part], self.ss[part], self.measured[part])


def lag_samples(
    log: Log, steady: SteadyStateModel, config: RunConfig, lag: LumpedEngine | None = None
) -> LagSamples:
    """Samples that lags are fitted to; remaining motion of the spools of `lag` is no static error.

    For a temperature it counts as one: its slow part takes longer than the stretches that it is
    fitted to, and the effect of a switched load would be taken for such a part.
    """
    inputs = log.matrix(steady.input_names)
    ss = steady_for_engine(steady, log.source.engine).outputs(inputs)
    measured = log.matrix(steady.output_names)
    if config.train.local_trim:
        spools = spools_of(config.narx.outputs)
        rows = quasi_steady(log, config.events.driver, spools, config.train.still)
        settling = np.zeros_like(ss)
        if lag is not None:
            drive = lag.drive(inputs, steady.input_names, ss)
            before = lag.deviations(drive, settling[0], log.dt_s)
            settling = np.where(lag.speeds, before, 0.0)
        ss = locally_trimmed(ss, measured + settling, rows)
    return LagSamples(inputs, ss, measured)


def structure_of(config: RunConfig) -> NarxConfig:
    """Structure of the network by the configuration."""
    section = config.narx
    vanishing = len(section.outputs) * (2 if section.lag else 1)
    return NarxConfig(
        lags=section.lags,
        taps=section.taps,
        hidden=section.hidden,
        margin=section.margin,
        moving=vanishing if section.anchored else 0,
        linear_feedback=section.linear_feedback,
    )


def _rest(config: RunConfig, material: Material, moving: int) -> list[Record]:
    """Rest records of an anchored network; without an anchor its deviation need not vanish."""
    steps = round(config.train.rest_s / material.dt_s)
    if not moving or steps < 2:
        return []
    seed, far = config.train.seed, config.train.rest_far
    return rest_records(material.records, moving, steps, seed, far=far)


@dataclass(frozen=True)
class Split:
    """Whole logs: to fit to, to stop by, and held out."""

    train: tuple[Log, ...]
    validate: tuple[Log, ...]
    test: tuple[Log, ...]

    def held(self, names: Sequence[str]) -> Split:
        """Split with these inputs completed in the logs to learn from."""
        return self.changed(lambda log: hold_inputs(log, names))

    def changed(self, change: Callable[[Log], Log]) -> Split:
        """Split with `change` made to the logs to learn from."""
        parts = (self.train, self.validate)
        train, validate = (tuple(change(log) for log in part) for part in parts)
        return Split(train, validate, self.test)

    def with_outputs(self, outputs: Sequence[str]) -> Split:
        """Split with every output in each log to learn from, NaN where it was not recorded.

        Such an output is learned from the other logs. Raises `DataError` for an output without a
        sample in any training log.
        """
        parts = (self.train, self.validate)
        train, validate = (tuple(with_outputs(log, outputs) for log in part) for part in parts)
        known = {name for log in train for name in log.recorded(outputs)}
        for name in outputs:
            if name not in known:
                masked = [log.audit.masked().get(name, {}) for log in self.train]
                why = {reason for reasons in masked for reason in reasons} - {"missing"}
                raise DataError(
                    "no log to train on has a sample of this output"
                    + (f"; what there was is masked ({', '.join(sorted(why))})" if why else ""),
                    channel=name,
                    hint="Take it out of [narx] outputs, or add logs that hold it to [split] train",
                )
        return Split(train, validate, self.test)


def split_logs(logs: Sequence[Log], config: SplitConfig) -> Split:
    """Sort logs into sets by their names; `ConfigError` where nothing is left to train on."""
    parts: dict[str, list[Log]] = {"test": [], "validate": [], "train": []}
    patterns = {"test": config.test, "validate": config.validate_, "train": config.train}
    for log in logs:
        for part, chosen in parts.items():
            if any(fnmatch(log.name, pattern) for pattern in patterns[part]):
                chosen.append(log)
                break
        else:
            if not config.test:
                parts["test"].append(log)
    if not parts["train"]:
        raise _nothing_to_train_on([log.name for log in logs], config)
    return Split(tuple(parts["train"]), tuple(parts["validate"]), tuple(parts["test"]))


def _nothing_to_train_on(names: Sequence[str], config: SplitConfig) -> ConfigError:
    meant = [name for name in names if any(fnmatch(name, each) for each in config.train)]
    wanted = f"[split] train = {list(config.train)}"
    if not meant:
        return ConfigError(f"no log matches {wanted}", hint=f"Logs are {', '.join(names)}")
    return ConfigError(
        f"{', '.join(meant)} would match {wanted}, but test or validate came first",
        hint="Leave logs for training there",
    )
