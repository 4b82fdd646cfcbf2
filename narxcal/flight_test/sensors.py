"""From what the engine does to what the recorder writes: the measurement chain of every channel.

Each channel goes, in this order, through: the lag of its sensor, the lag of a faulty one (the
effects of `sensor_faults`), the flow meter's dynamics; gain error, bias and drift of the flight;
the recorder's clock and its sampling slot; noise and wild readings; the step of the readings;
lost and frozen stretches. Noise is drawn at the times of the recorder: it is stationary, so that
its law is the same before the clock and behind it, and interpolation would only smooth it.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from narxcal.atmosphere import isa
from narxcal.channels import CHANNELS, channel
from narxcal.errors import ConfigError
from narxcal.flight_test.measurement import (
    FloatArray,
    at_times,
    coloured,
    first_order,
    frozen,
    quantised,
    slots,
    turbine_meter,
    windows,
    within,
)
from narxcal.flight_test.sensor_faults import SensorFault
from narxcal.flight_test.sensor_presets import PRESETS, PROBE_TAU_S, ChannelSensor, Preset
from narxcal.settings import Section

_WHOLE_LOG = ((-math.inf, math.inf),)


class SensorConfig(Section):
    """TOML table `[sensors]`: a preset, and what is different from it.

    `tat_tau_s` is the lag of the total temperature probe, from whose reading the recorded `dT_C`
    is derived. `[sensors.channels.NAME]` holds the keys of `ChannelSensor` that are not the
    preset's. With `inputs` = "exact" the lever, the air data and the switches are recorded as
    they are.
    """

    preset: Preset = "test_instrumentation"
    tat_tau_s: float | None = Field(default=None, ge=0)
    inputs: Literal["measured", "exact"] = "measured"
    channels: dict[str, ChannelSensor] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _known(self) -> SensorConfig:
        for name, sensor in self.channels.items():
            if channel(name).role in ("time", "auxiliary"):
                raise ConfigError(
                    f"[sensors.channels] names '{name}', which no flight records",
                    hint="Name the lever, an ambient channel, a switch or an output",
                )
            if sensor.meter_reference_kgph and name != "FF_kgph":
                raise ConfigError(
                    f"[sensors.channels.{name}] has meter_reference_kgph",
                    hint="Only FF_kgph is measured by a turbine meter",
                )
        return self

    def sensor(self, name: str) -> ChannelSensor:
        """Settings of a channel: the preset's, with the configuration's in their place."""
        if self.inputs == "exact" and CHANNELS[name].role in ("lever", "ambient", "switch"):
            return ChannelSensor()
        preset = PRESETS[self.preset].get(name, ChannelSensor())
        given = self.channels.get(name)
        if given is None:
            return preset
        return preset.model_copy(update=given.model_dump(exclude_unset=True))

    @property
    def probe_tau_s(self) -> float:
        """Lag of the total temperature probe."""
        if self.inputs == "exact":
            return 0.0
        return PROBE_TAU_S[self.preset] if self.tat_tau_s is None else self.tat_tau_s


class Streams(NamedTuple):
    """Where a recording's random numbers come from: a seed for each flight, engine and channel.

    What one channel draws for one purpose depends on nothing else that is switched on or off.
    Both engines of a flight share the sensors that do not belong to an engine.
    """

    seed: int
    flight: int
    engine: int

    def draw(self, name: str, purpose: str) -> np.random.Generator:
        """Give the generator of one channel for one purpose."""
        own = CHANNELS[name].role in ("lever", "output")
        key = (self.flight, 1 + self.engine if own else 0, _code(name), _code(purpose))
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=key))


class Recording(NamedTuple):
    """Recorded channels `(time,)`, NaN where there is no reading, and what was drawn for them.

    `drawn` maps channel -> name -> value: the flight's `bias`, `gain`, `drift_per_h`, `skew_s`,
    and where there are any `dropouts_s`, `freezes_s` (start, end) and `spikes_s`.
    """

    channels: dict[str, FloatArray]
    drawn: dict[str, dict[str, Any]]


def record(
    truth: Mapping[str, FloatArray],
    dt_s: float,
    config: SensorConfig,
    streams: Streams,
    faults: Sequence[SensorFault] = (),
) -> Recording:
    """Measure all channels of one engine's flight, `(time,)` each at `dt_s`.

    `truth` may hold `time_s`, which is taken over. The same arguments give the same numbers.
    """
    signals = {name: values for name, values in truth.items() if name != "time_s"}
    if {"dT_C", "ALT_ft", "Mach"} <= set(signals):
        signals["dT_C"] = _felt_by_probe(signals, config.probe_tau_s, dt_s)
    channels = {name: truth[name] for name in truth if name == "time_s"}
    drawn: dict[str, dict[str, Any]] = {}
    for name, values in signals.items():
        own = [fault for fault in faults if fault.channel == name]
        chain = _Chain(name, config.sensor(name), own, streams, dt_s)
        channels[name], drawn[name] = chain.record(values)
    return Recording(channels, {name: each for name, each in drawn.items() if each})


class _Chain(NamedTuple):
    """One channel's way from the engine to the recorder."""

    name: str
    sensor: ChannelSensor
    faults: Sequence[SensorFault]
    streams: Streams
    dt_s: float

    def record(self, truth: FloatArray) -> tuple[FloatArray, dict[str, Any]]:
        drawn = self._nuisances()
        signal = self._biased(self._lagged(truth), drawn)
        sensor, hold = self.sensor, CHANNELS[self.name].role == "switch"
        taken = slots(len(truth), self.dt_s, sensor.rate_hz, sensor.slot_s)
        skew = drawn.get("skew_s", 0.0) + sum(each["skew_s"] for each in self._of("time_skew"))
        values = at_times(signal, self.dt_s, taken.time_s - skew, hold=hold)
        # An indicator has stops: on the ground, Mach minus a bias still reads 0.
        stops = CHANNELS[self.name].low, CHANNELS[self.name].high
        values = np.clip(values + self._noise(values, taken.time_s), *stops)
        values = self._spiked(values, taken.time_s, drawn)
        values = quantised(values, sensor.resolution)
        return self._interrupted(values, taken.time_s, drawn)[taken.shown], drawn

    def _of(self, effect: str) -> list[SensorFault]:
        return [fault for fault in self.faults if fault.id == effect]

    def _nuisances(self) -> dict[str, Any]:
        """Draw the flight's own errors; those of no size are left out."""
        sensor = self.sensor
        sizes = {
            "bias": sensor.bias_sigma,
            "gain": sensor.gain_sigma,
            "drift_per_h": sensor.drift_sigma_per_h,
            "skew_s": sensor.skew_sigma_s,
        }
        drawn = {
            key: float(sigma * self.streams.draw(self.name, key).standard_normal())
            for key, sigma in sizes.items()
            if sigma > 0.0
        }
        if sensor.skew_s:
            drawn["skew_s"] = sensor.skew_s + drawn.get("skew_s", 0.0)
        return drawn

    def _lagged(self, values: FloatArray) -> FloatArray:
        meter = self.sensor.meter_reference_kgph
        values = turbine_meter(values, self.sensor.tau_s, meter, self.dt_s)
        for fault in self._of("sensor_lag"):
            values = first_order(values, fault["tau_s"], self.dt_s)
        for fault in self._of("flowmeter_dynamics"):
            values = turbine_meter(values, fault["tau_s"], fault["reference_kgph"], self.dt_s)
        return values

    def _biased(self, values: FloatArray, drawn: Mapping[str, Any]) -> FloatArray:
        """Add gain error, bias and drift, those of the flight and those of faults."""
        time_s = np.asarray(np.arange(len(values)) * self.dt_s, dtype=np.float64)
        values = values * (1.0 + drawn.get("gain", 0.0)) + drawn.get("bias", 0.0)
        values = values + drawn.get("drift_per_h", 0.0) * time_s / 3600.0
        for fault in self._of("sensor_bias"):
            values = values + fault["offset"] * _active(fault, time_s)
        for fault in self._of("sensor_drift"):
            hours = np.cumsum(_active(fault, time_s)) * self.dt_s / 3600.0
            values = values + fault["rate_per_h"] * (hours - hours[0])
        return values

    def _noise(self, values: FloatArray, time_s: FloatArray) -> FloatArray:
        sensor, noise = self.sensor, np.zeros(len(values))
        if sensor.noise_sigma or sensor.noise_share:
            white = self.streams.draw(self.name, "noise").standard_normal(len(values))
            noise += white * (sensor.noise_sigma + sensor.noise_share * np.abs(values))
        if sensor.coloured_sigma and len(values) > 1:
            decay = math.exp(-float(time_s[1] - time_s[0]) / sensor.coloured_tau_s)
            random = self.streams.draw(self.name, "coloured")
            noise += sensor.coloured_sigma * coloured(random, len(values), decay)
        return noise

    def _spiked(self, values: FloatArray, time_s: FloatArray, drawn: dict[str, Any]) -> FloatArray:
        """Put single wild readings in, up or down by `spike_size`."""
        sensor = self.sensor
        if not (sensor.spikes_per_h and sensor.spike_size):
            return values
        random = self.streams.draw(self.name, "spikes")
        hours = float(time_s[-1] - time_s[0]) / 3600.0
        rows = np.unique(
            random.integers(0, len(values), random.poisson(sensor.spikes_per_h * hours))
        )
        wild = values.copy()
        wild[rows] += sensor.spike_size * random.choice((-1.0, 1.0), len(rows))
        if len(rows):
            drawn["spikes_s"] = time_s[rows].tolist()
        return wild

    def _interrupted(
        self, values: FloatArray, time_s: FloatArray, drawn: dict[str, Any]
    ) -> FloatArray:
        """Freeze readings, then lose some."""
        sensor = self.sensor
        if sensor.freezes_per_h:
            random = self.streams.draw(self.name, "freezes")
            spans = windows(random, time_s, sensor.freezes_per_h, sensor.freeze_s)
            values = frozen(values, time_s, spans)
            drawn.update({"freezes_s": [list(span) for span in spans]} if spans else {})
        if sensor.dropouts_per_h:
            random = self.streams.draw(self.name, "dropouts")
            spans = windows(random, time_s, sensor.dropouts_per_h, sensor.dropout_s)
            values = np.where(within(time_s, spans), np.nan, values)
            drawn.update({"dropouts_s": [list(span) for span in spans]} if spans else {})
        return values


def _active(fault: SensorFault, time_s: FloatArray) -> FloatArray:
    """1 where a fault acts, else 0."""
    spans = list(fault.windows_s or _WHOLE_LOG)
    return within(time_s, spans).astype(np.float64)


def _felt_by_probe(signals: Mapping[str, FloatArray], tau_s: float, dt_s: float) -> FloatArray:
    """`dT_C` as derived from a total temperature probe that lags behind the air.

    `TAT = (ISA + dT) (1 + 0.2 M^2)`; the recorder takes the altitude and Mach of the moment back
    out, so that a lag shows as a false `dT` while they change.
    """
    if tau_s <= 0.0:
        return signals["dT_C"]
    rise = 1.0 + 0.2 * signals["Mach"] ** 2
    total = (isa(signals["ALT_ft"])[0] + signals["dT_C"]) * rise
    return np.asarray(signals["dT_C"] + (first_order(total, tau_s, dt_s) - total) / rise)


def _code(name: str) -> int:
    """Give a number to a name that stays its own when other names come and go."""
    return zlib.crc32(name.encode())
