"""Drawn faults put into sound logs, and what is found of them: rows of `python -m eval.bench`.

Kind, channel, size, begin and length are drawn. Lags, delays, gains, offsets and drifts are the
sensor models of `narxcal.effects`, by which `diagnose` explains such errors.

Models are trained on other flights than those that the faults are put into. A fault counts if it
moves the free run (an input) or the measurement (an output) by more than three times the held-out
error of the free run in some output. Figures: share detected, share with channel and kind, samples
masked on sound logs, sound logs with any fault, and the delay between the time from which the
effect exceeds that bound for 20 s and the time from which the fault is reported.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter

from data_prep.log import Finding, Kind, Log, Source
from data_prep.plausibility import conversions
from data_prep.prepare import hold_inputs, prepare
from data_prep.reading import read_logs
from eval.benchmarks import Row
from narxcal.atmosphere import KELVIN, isa
from narxcal.calibration.bundle import Bundle
from narxcal.calibration.calibration import Calibration
from narxcal.effects import effect
from narxcal.effects.base import Run, Signals
from narxcal.effects.signal_path import SensorEffect
from narxcal.flight_test.fly import fly
from narxcal.flight_test.scenario import FlightScenario
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import DataError
from training.config import RunConfig, load_config
from training.pipeline import calibrate, configured_files
from training.records import Split
from training.redundancy import Bank
from training.screening import screened

ENGINE = ("N1_pct", "N2_pct", "EGT_C", "FF_kgph")
AIR = ("ALT_ft", "Mach", "SAT_C", "CAS_kt")
Draw = np.random.Generator
Apply = Callable[[FloatArray, FloatArray], FloatArray]


@dataclass(frozen=True, eq=False)
class Injection:
    """A fault as it is put into a raw log: `channels`, `kind`, size, and `change(values, time_s)`.

    `begins` is the share of the log at which it begins, `ends` at which it ends.
    """

    kind: Kind
    channels: tuple[str, ...]
    size: str
    change: Apply
    begins: float = 0.0
    ends: float = 1.0

    def into(self, log: Log) -> Log:
        """The log with the fault; channels that the reader derives follow."""
        if self.channels == ("time_s",):
            return self._stretched(log)
        changed = {}
        first, last = (round(share * len(log)) for share in (self.begins, self.ends))
        part = slice(first, last)
        if self.kind == "exchanged":
            a, b = self.channels
            changed = {a: log[b], b: log[a]}
        else:
            for name in self.channels:
                changed[name] = log[name].copy()
                changed[name][part] = self.change(log[name][part], log.time_s[part])
        return _derived(log.with_channels(changed))

    def _stretched(self, log: Log) -> Log:
        """Time stamps times a factor, on the log's sampling grid."""
        factor = float(self.change(np.ones(1), np.ones(1))[0])
        time_s = np.arange(0.0, log.time_s[-1] * factor - log.time_s[0] * factor, log.dt_s)
        channels = {
            name: np.interp(time_s / factor + log.time_s[0], log.time_s, values)
            for name, values in log.channels.items()
        }
        return replace(log, time_s=time_s + log.time_s[0], channels=channels, interpolated={})


def _derived(log: Log) -> Log:
    """Temperature deviation anew from the temperature and altitude of the log."""
    if not {"SAT_C", "ALT_ft", "dT_C"} <= log.channels.keys():
        return log
    deviation = log["SAT_C"] + KELVIN - isa(log["ALT_ft"])[0]
    return log.with_channels({"dT_C": deviation})


def drawn(log: Log, seed: int, count: int) -> list[Injection]:
    """Draw `count` faults of channels that the log has."""
    draw = np.random.default_rng(seed)
    engine = [name for name in ENGINE if name in log.channels]
    found: list[Injection] = []
    while len(found) < count:
        make = _KINDS[int(draw.integers(len(_KINDS)))]
        one = make(draw, log, str(draw.choice(engine)))
        if one is not None and all(each in {*log.channels, "time_s"} for each in one.channels):
            found.append(one)
    return found


def sensor(name: str, channel: str, *theta: float) -> Apply:
    """A sensor effect of the library with its parameters, as a change of one channel."""
    found = effect(f"{name}:{channel}")
    if not isinstance(found, SensorEffect):
        raise TypeError(f"{name} is no effect of a sensor")

    def change(values: FloatArray, time_s: FloatArray) -> FloatArray:
        limits = np.array([np.nanmin(values)]), np.array([np.nanmax(values)])
        dt_s = float(time_s[-1] - time_s[0]) / (len(time_s) - 1)
        signals = Signals((), (channel,), dt_s, "", *limits)
        run = Run(signals, np.array([theta], dtype=np.float64), np.empty((1, len(values), 0)))
        known = np.where(np.isfinite(values), values, np.nanmedian(values))
        read = np.asarray(found.reading(run, known[None]))[0]
        return np.where(np.isfinite(values), read, np.nan)

    return change


def _span(draw: Draw) -> tuple[float, float]:
    """Begin and end as shares of the log: half of the faults last from the start to the end."""
    if draw.random() < 0.5:
        return 0.0, 1.0
    begins = float(draw.uniform(0.05, 0.7))
    return begins, float(min(1.0, begins + draw.uniform(0.15, 1.0)))


def _sign(draw: Draw) -> float:
    return float(draw.choice([-1.0, 1.0]))


def _scale(draw: Draw, _log: Log, channel: str) -> Injection:
    gain_pct = _sign(draw) * float(np.exp(draw.uniform(np.log(3.0), np.log(20.0))))
    change = sensor("sensor_gain", channel, gain_pct)
    return Injection("scale", (channel,), f"{gain_pct:+.3g} %", change, *_span(draw))


def _bias(draw: Draw, log: Log, channel: str) -> Injection | None:
    if channel == "FF_kgph":
        return None
    size = _sign(draw) * float(draw.uniform(0.05, 0.25)) * _range(log, channel)
    change = sensor("sensor_bias", channel, size)
    return Injection("bias", (channel,), f"{size:+.3g}", change, *_span(draw))


def _range(log: Log, channel: str) -> float:
    low, high = np.nanpercentile(log[channel], (1.0, 99.0))
    return float(high - low)


def _drift(draw: Draw, log: Log, channel: str) -> Injection:
    begins = float(draw.uniform(0.0, 0.6))
    hours = (1.0 - begins) * float(log.time_s[-1] - log.time_s[0]) / 3600.0
    end = _sign(draw) * float(draw.uniform(0.1, 0.5)) * _range(log, channel)
    change = sensor("sensor_drift", channel, end / hours)
    return Injection("drift", (channel,), f"to {end:+.3g}", change, begins)


def _late(draw: Draw, _log: Log, channel: str) -> Injection:
    if draw.random() < 0.5:
        delay_s = float(draw.uniform(0.6, 8.0))
        change: Apply = lambda x, t: np.interp(t - delay_s, t, x)  # noqa: E731
        return Injection("late", (channel,), f"delay {delay_s:.2g} s", change)
    tau_s = float(draw.uniform(1.0, 6.0))
    change = sensor("sensor_lag", channel, tau_s, 0.0)
    return Injection("late", (channel,), f"lag {tau_s:.2g} s", change)


def _stuck(draw: Draw, log: Log, channel: str) -> Injection:
    air = [name for name in AIR if name in log.channels]
    name = str(draw.choice([channel, *air]))
    begins = float(draw.uniform(0.05, 0.7))
    ends = float(min(1.0, begins + draw.uniform(0.1, 0.9)))
    return Injection("stuck", (name,), "", lambda x, _t: np.full_like(x, x[0]), begins, ends)


def _dead(draw: Draw, _log: Log, channel: str) -> Injection:
    level, share = float(draw.uniform(10.0, 90.0)), float(draw.uniform(0.002, 0.03))
    memory = float(draw.uniform(0.0, 0.9))
    seed = int(draw.integers(2**31))

    def change(x: FloatArray, _t: FloatArray) -> FloatArray:
        white = np.random.default_rng(seed).standard_normal(len(x)) * np.sqrt(1.0 - memory**2)
        noise = np.asarray(lfilter([1.0], [1.0, -memory], white))
        return np.asarray(np.nanpercentile(x, level) * (1.0 + share * noise))

    return Injection("stuck", (channel,), f"{level:.0f} %", change, *_span(draw))


def _held(draw: Draw, _log: Log, channel: str) -> Injection:
    every_s, phase = float(draw.uniform(1.6, 12.0)), float(draw.random())

    def change(x: FloatArray, t: FloatArray) -> FloatArray:
        count = np.floor((t - t[0]) / every_s + phase)
        first = np.searchsorted(count, count, side="left")
        return np.asarray(x[first])

    return Injection("held", (channel,), f"{every_s:.2g} s", change)


def _noise(draw: Draw, _log: Log, channel: str) -> Injection:
    share, seed = float(draw.uniform(0.08, 0.5)), int(draw.integers(2**31))

    def change(x: FloatArray, _t: FloatArray) -> FloatArray:
        heavy = np.random.default_rng(seed).standard_t(5.0, len(x))
        return np.asarray(x + share * np.nanstd(x) * heavy / np.sqrt(5.0 / 3.0))

    return Injection("noise", (channel,), f"{share:.2g} sd", change)


def _unit(draw: Draw, log: Log, channel: str) -> Injection | None:
    name = str(draw.choice([channel, *(each for each in AIR if each in log.channels)]))
    units = [(word, scale, offset) for word, scale, offset in conversions(name) if "," not in word]
    if not units:
        return None
    word, scale, offset = units[int(draw.integers(len(units)))]
    return Injection("unit", (name,), word, lambda x, _t: (x - offset) / scale)


def _swapped(_draw: Draw, _log: Log, _channel: str) -> Injection:
    return Injection("exchanged", ("N1_pct", "N2_pct"), "", lambda x, _t: x)


def _mach(draw: Draw, _log: Log, _channel: str) -> Injection:
    gain = float(np.exp(_sign(draw) * draw.uniform(np.log(1.25), np.log(2.0))))
    return Injection("scale", ("Mach",), f"x {gain:.2g}", lambda x, _t: gain * x)


def _stretched(draw: Draw, _log: Log, _channel: str) -> Injection:
    factor = float(draw.choice([0.5, 2.0]))
    return Injection("stretched", ("time_s",), f"x {factor:g}", lambda x, _t: factor * x)


_KINDS: Sequence[Callable[[Draw, Log, str], Injection | None]] = (
    _scale, _scale, _bias, _bias, _drift, _drift, _late, _late, _stuck, _dead, _held, _noise, _unit,
    _swapped, _mach, _stretched,
)  # fmt: skip


def flights(engine: str, seed: int, count: int) -> Iterator[Log]:
    """Raw logs of virtual flights of one engine with a build of its own."""
    scenario = FlightScenario.parse(
        {
            "engine": engine, "seed": seed, "flights": count, "engines": ["left"],
            "outputs": list(ENGINE), "plan": {"duration_s": 1500.0, "rate_hz": 5.0},
        }
    )  # fmt: skip
    for number in range(1, count + 1):
        (flown,) = fly(scenario, number)
        channels = {name: values for name, values in flown.recorded.items() if name != "time_s"}
        name = f"{engine}_{seed}_{number}.csv"
        source = Source(name, name, "")
        yield replace(Log(name, flown.recorded["time_s"], channels), source=source)


_TIMES = 3.0  # the held-out error that a fault has to move the free run by
_LASTING_S = 20.0


@dataclass(frozen=True)
class Trial:
    """One fault in one log, and what was found."""

    injection: Injection
    found: tuple[Finding, ...]
    counts: bool
    noticeable_s: float

    @property
    def detected(self) -> bool:
        """Whether any fault was found that concerns a channel of it."""
        wanted = {*self.injection.channels}
        return any(wanted & {*each.channels} for each in self.found) or (
            "time_s" in wanted and bool(self.found)
        )

    @property
    def named(self) -> bool:
        """Whether one was found with the channels and the kind of it."""
        wanted = {*self.injection.channels}
        return any(
            {*each.channels} == wanted and each.kind == self.injection.kind for each in self.found
        )

    @property
    def delay_s(self) -> float:
        """From where its effect is noticeable to where it is reported; NaN where it is not."""
        wanted = {*self.injection.channels}
        from_s = [each.start_s or 0.0 for each in self.found if wanted & {*each.channels}]
        return max(0.0, min(from_s) - self.noticeable_s) if from_s else float("nan")


@dataclass(frozen=True)
class Result:
    """All trials of one campaign, and what was found in its sound logs."""

    name: str
    trials: tuple[Trial, ...]
    false_share: float
    sound_logs: int
    with_findings: int


def _measured(
    name: str, config: RunConfig, raw: tuple[Sequence[Log], Sequence[Log]], seed: int
) -> Result:
    """Train on the first of the raw logs, and put drawn faults into the others."""
    train, test = raw
    config = config.having(train={"choice_s": 0.0})
    logs = tuple(one.log for one in prepare(train, config))
    bundle = calibrate(config, Path(), Split(logs, (), ()))
    bank = Bank.from_json(bundle.record.redundancy or {})
    trials = tuple(trial for log in test for trial in _trials(log, config, (bundle, bank), seed))
    sound = [one.log for one in prepare(test, config)]
    found = screened(bank, sound)
    lost = sum(map(_masked, found)) / sum(len(log) * len(log.channels) for log in sound)
    return Result(name, trials, lost, len(sound), sum(bool(log.findings) for log in found))


_FUEL = {
    "schema": "narxcal.config/1",
    "events": {"driver": "FF_kgph", "condition": ""},
    "steady_state": {
        "inputs": ["FF_kgph", "ALT_ft", "Mach", "dT_C"], "blend": ["Mach"], "switches": [],
        "corrected": True,
    },
    "narx": {"lag": True, "lag_limits": False, "lag_governed": False, "lags": 1, "hidden": 4},
    "train": {"horizons_s": [5.0], "iterations": [6]},
}  # fmt: skip
_LEVER = {
    **_FUEL,
    "events": {"driver": "TRA_deg", "condition": ""},
    "steady_state": {
        "inputs": ["TRA_deg", "ALT_ft", "Mach", "dT_C"], "blend": ["Mach"], "switches": [],
    },
    "logs": {"raster_hz": 8.0},
}  # fmt: skip
_PER_LOG = 24  # faults: about 100 in all, so that a share has a standard error of 2 to 5 points


def results(data: Path, seed: int) -> Iterator[Result]:
    """Measure drawn engines, simulations by others and a real recorder; `data` holds the files.

    No limit of the screening was chosen on the engines and the simulations. What has no files is
    left out.
    """
    fuel, lever = RunConfig.parse(_FUEL), RunConfig.parse(_LEVER)
    for engine, logs in (("business_jet", 4), ("single_aisle", 5), ("business_jet", 3)):
        raw = list(flights(engine, 7000 + 10 * seed + logs, logs))
        name = f"{engine}, {logs - 1} training flights"
        yield _measured(name, fuel, (raw[:-1], raw[-1:]), seed)
    for case in ("case_A", "case_B"):
        files = sorted((data / "gap_example" / case).glob("real*/*.csv.gz"))
        if files:
            raw = read_logs(files, lever.logs)
            yield _measured(case, lever, (raw[:3], raw[3:4]), seed)
    config, base = load_config("citation2.toml")
    config = config.with_logs_in(data / "flights")
    try:
        raw = read_logs(configured_files(config, base), config.logs)
    except DataError:
        return
    yield _measured("Citation II", config, (raw[2:], raw[:1]), seed)


def _masked(log: Log) -> float:
    """Samples that faults mask, all channels together."""
    return float(sum(each.rows(log.time_s).sum() for each in log.findings if each.masks))


def _trials(
    raw: Log, config: RunConfig, trained: tuple[Bundle, Bank], seed: int
) -> Iterator[Trial]:
    bundle, bank = trained
    own = bundle.calibration.for_engine(raw.source.engine, or_mean=True)
    [clean] = prepare([raw], config)
    reference = _run(own, clean.log)
    error = np.sqrt(np.nanmean((reference - clean.log.matrix(own.output_names)) ** 2, axis=0))
    for injection in drawn(raw, seed, _PER_LOG):
        log = prepare([injection.into(raw)], config)[0].log
        moved = _moved(own, (clean.log, log), reference)
        large = np.array([0.0])
        if len(moved) == len(clean.log):
            size = max(1, round(_LASTING_S / log.dt_s))
            smooth = uniform_filter1d(np.abs(np.nan_to_num(moved)), size, axis=0, mode="nearest")
            large = np.flatnonzero((smooth > _TIMES * error).any(axis=1))
        rms = np.sqrt(np.nanmean(moved**2, axis=0))
        counts = bool((rms > _TIMES * error).any())
        noticeable = float(log.time_s[int(large[0])]) if len(large) else float("nan")
        yield Trial(injection, screened(bank, [log])[0].findings, counts, noticeable)


def _run(own: Calibration, log: Log) -> FloatArray:
    filled = hold_inputs(log, own.input_names)
    return own.simulate(filled.matrix(own.input_names), log.matrix(own.output_names)[0])


def _moved(own: Calibration, logs: tuple[Log, Log], reference: FloatArray) -> FloatArray:
    """By how much a fault moves the free run against the measurement, (time, n_out)."""
    clean, faulty = logs
    if len(faulty) != len(clean):
        return np.full((1, len(own.output_names)), np.inf)
    try:
        moved = _run(own, faulty) - reference
    except DataError:  # nothing is left of an input
        return np.full((len(clean), len(own.output_names)), np.inf)
    outputs = own.output_names
    there = [name for name in outputs if np.isfinite(faulty[name]).any()]
    read = np.where(
        [name in there for name in outputs], faulty.matrix(outputs) - clean.matrix(outputs), np.inf
    )
    return np.asarray(np.where(np.isfinite(read) | np.isinf(read), np.abs(moved) + np.abs(read), 0))


def rows(data: Path, seed: int = 0) -> Iterator[Row]:
    """Figures of each set and of all together; `data` is the folder of the shared data."""
    found = list(results(data, seed))
    for result in found:
        yield from _figures(result.name, [result])
    yield from _figures("all", found)


_TARGET = "faults that move the free run by more than 3 times its held-out error"


def _figures(name: str, results: Sequence[Result]) -> Iterator[Row]:
    trials = [each for one in results for each in one.trials if each.counts]
    group, count = f"sensor faults, {name}", len(trials)
    detected = 100.0 * float(np.mean([each.detected for each in trials]))
    named = 100.0 * float(np.mean([each.named for each in trials]))
    delays = np.array([each.delay_s for each in trials if each.detected])
    soon = 100.0 * float(np.mean(delays[np.isfinite(delays)] <= _LASTING_S))
    with_findings = sum(one.with_findings for one in results)
    sound = sum(one.sound_logs for one in results)
    lost = 100.0 * float(np.mean([one.false_share for one in results]))
    note = f"{count} faults"
    yield Row(group, "detected", detected, "%", 95.0, "at least", _TARGET, note)
    yield Row(group, "with channel and kind", named, "%", 85.0, "at least", _TARGET)
    yield Row(group, "reported within 20 s of their effect", soon, "%")
    yield Row(group, "samples masked on sound logs", lost, "%", 0.1, "at most", _TARGET)
    note = f"of {sound} sound logs"
    yield Row(
        group, "sound logs with a fault", with_findings, "logs", 0.0, "at most", _TARGET, note
    )
