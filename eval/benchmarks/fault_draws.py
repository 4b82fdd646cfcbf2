"""Sensor faults drawn at random, and flights of drawn engines to put them into.

Kind, channel, size, begin and length are drawn. Lags, delays, gains, offsets and drifts are the
sensor models of `narxcal.effects`, by which `diagnose` explains such errors.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from data_prep.log import Kind, Log, Source
from data_prep.plausibility import conversions
from narxcal.atmosphere import KELVIN, isa
from narxcal.effects import effect
from narxcal.effects.base import Run, Signals
from narxcal.effects.sensor_side import SensorEffect
from narxcal.flight_test.fly import fly
from narxcal.flight_test.scenario import FlightScenario
from narxcal.support.arrays import FloatArray

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
