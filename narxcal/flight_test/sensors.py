"""The measurement chain of each channel: from true values to what the recorder writes.

A channel passes, in this order: the lag of its sensor, that of a faulty sensor, the dynamics of the
flow meter; gain error, bias and drift of the flight; the recorder's clock and its sampling slot;
noise and single wild readings; quantisation; lost and frozen intervals. Noise is drawn at the
sampling times: it is stationary, so its distribution is the same before and after the clock, and
interpolation would only smooth it.

The sensor
effects of the library act on one channel of one engine's recording. The lag of the engine's own
probe, which depends on the flow, belongs to the engine (`narxcal.turbofan`).
"""

from __future__ import annotations

import math
import tomllib
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from narxcal.atmosphere import isa
from narxcal.channels import CHANNELS, channel
from narxcal.flight_test.signals import (
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
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError
from narxcal.support.settings import Section
from narxcal.turbofan.unmodelled import Size, Sizes, library_size

Preset = Literal["test_instrumentation", "fdr", "perfect"]


class ChannelSensor(Section):
    """The measurement of one channel; all zero is a perfect sensor.

    tau_s: first-order lag; `meter_reference_kgph`, fuel flow only: the flow at which `tau_s`
        applies, as that of a turbine meter is inverse to the flow (0: constant `tau_s`).
    bias_sigma, gain_sigma, drift_sigma_per_h: of each flight, in the channel's unit, as a share of
        the reading, and in units per hour.
    noise_sigma, noise_share: white noise, in the channel's unit plus as a share of the reading;
        coloured_sigma, coloured_tau_s: AR(1) noise.
    skew_s, skew_sigma_s: delay of the recorder's clock, and its scatter between flights.
    rate_hz, slot_s: sampling rate, and offset into each frame; 0 means every row.
    resolution: the step of the readings.
    dropouts_per_h, dropout_s; freezes_per_h, freeze_s; spikes_per_h, spike_size: intervals without
        readings, intervals of one reading, single wild readings.
    """

    tau_s: float = Field(default=0.0, ge=0)
    meter_reference_kgph: float = Field(default=0.0, ge=0)
    bias_sigma: float = Field(default=0.0, ge=0)
    gain_sigma: float = Field(default=0.0, ge=0)
    drift_sigma_per_h: float = Field(default=0.0, ge=0)
    noise_sigma: float = Field(default=0.0, ge=0)
    noise_share: float = Field(default=0.0, ge=0)
    coloured_sigma: float = Field(default=0.0, ge=0)
    coloured_tau_s: float = Field(default=2.0, gt=0)
    skew_s: float = Field(default=0.0, ge=-2, le=2)
    skew_sigma_s: float = Field(default=0.0, ge=0, le=0.5)
    rate_hz: float = Field(default=0.0, ge=0)
    slot_s: float = Field(default=0.0, ge=0)
    resolution: float = Field(default=0.0, ge=0)
    dropouts_per_h: float = Field(default=0.0, ge=0)
    dropout_s: float = Field(default=1.0, gt=0)
    freezes_per_h: float = Field(default=0.0, ge=0)
    freeze_s: float = Field(default=2.0, gt=0)
    spikes_per_h: float = Field(default=0.0, ge=0)
    spike_size: float = Field(default=0.0, ge=0)


PRESETS: dict[str, dict[str, ChannelSensor]] = {
    preset: {name: ChannelSensor(**keys) for name, keys in channels.items()}
    for preset, channels in tomllib.loads(
        files(__package__).joinpath("sensors.toml").read_text("utf-8")
    ).items()
}
# Time constant of the total temperature probe: about 1 s for a de-iced one (description of the
# T-28's measurements, archive.eol.ucar.edu, 2000).
PROBE_TAU_S: dict[str, float] = {"test_instrumentation": 1.0, "fdr": 1.0, "perfect": 0.0}


# Effects of a sensor. Unit "ch" is that of the channel.
PARAMETERS: dict[str, Sizes] = {
    # Probes have 0.5 to 1.5 s at take-off and 2 to 5 s at idle and altitude (unverified).
    "sensor_lag": {"tau_s": library_size("sensor_lag", "tau_s", high=20.0)},
    "sensor_bias": {"offset": Size("ch", -1000.0, 1000.0, 0.0)},
    "sensor_drift": {"rate_per_h": Size("ch/h", -5000.0, 5000.0, 0.0)},
    # Words of a recorder's frame are sampled up to 1 s apart, in either order.
    "time_skew": {"skew_s": library_size("time_skew", "skew_s", low=-2.0)},
    # `tau_s` at `reference_kgph`; a reference of 0 means at every flow.
    "flowmeter_dynamics": {
        "tau_s": library_size("flowmeter_dynamics", "tau_s", high=10.0),
        "reference_kgph": Size("kg/h", 0.0, 20000.0, 0.0),
    },
}
WINDOWED = ("sensor_bias", "sensor_drift")


def channels_of(effect: str) -> tuple[str, ...]:
    """Channels that a sensor effect may act on."""
    if effect == "flowmeter_dynamics":
        return ("FF_kgph",)
    roles = {"lever", "ambient", "output"} | ({"switch"} if effect == "time_skew" else set())
    return tuple(name for name, each in CHANNELS.items() if each.role in roles)


@dataclass(frozen=True)
class SensorFault:
    """An effect on one channel, limited to `windows_s` where there are any."""

    id: str
    channel: str
    parameters: Mapping[str, float]
    windows_s: tuple[tuple[float, float], ...] = field(default=())

    def __getitem__(self, parameter: str) -> float:
        """Value of a parameter; the neutral one where it was not given."""
        return self.parameters.get(parameter, PARAMETERS[self.id][parameter].neutral)


_WHOLE_LOG = ((-math.inf, math.inf),)


class SensorConfig(Section):
    """TOML table `[sensors]`: a preset, and the differences from it.

    `tat_tau_s` is the lag of the total temperature probe, from whose reading the recorded `dT_C`
    is derived. `[sensors.channels.NAME]` has the keys of `ChannelSensor` that differ from the
    preset. With `inputs` = "exact" the lever, the air data and the switches are recorded without
    error.
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
        """Settings of a channel: those of the preset, replaced where the configuration has some."""
        if self.inputs == "exact" and CHANNELS[name].role in ("lever", "ambient", "switch"):
            return ChannelSensor()
        preset = PRESETS[self.preset].get(name, ChannelSensor())
        given = self.channels.get(name)
        if given is None:
            return preset
        return preset.model_copy(update=given.model_dump(exclude_unset=True))

    @property
    def probe_tau_s(self) -> float:
        if self.inputs == "exact":
            return 0.0
        return PROBE_TAU_S[self.preset] if self.tat_tau_s is None else self.tat_tau_s


class Streams(NamedTuple):
    """Random numbers of a recording: a seed for each flight, engine, channel and purpose.

    So the numbers of one purpose do not depend on what else is switched on. Both engines of a
    flight share the sensors that do not belong to an engine.
    """

    seed: int
    flight: int
    engine: int

    def draw(self, name: str, purpose: str) -> np.random.Generator:
        """Return the generator of one channel for one purpose."""
        own = CHANNELS[name].role in ("lever", "output")
        key = (self.flight, 1 + self.engine if own else 0, _code(name), _code(purpose))
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=key))


class Recording(NamedTuple):
    """Recorded channels `(time,)`, NaN without a reading, and the errors drawn for them.

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

    `truth` may contain `time_s`, which is copied. The same arguments give the same numbers.
    """
    signals = {name: values for name, values in truth.items() if name != "time_s"}
    if {"dT_C", "ALT_ft", "Mach"} <= set(signals):
        signals["dT_C"] = _probed_temperature(signals, config.probe_tau_s, dt_s)
    channels = {name: truth[name] for name in truth if name == "time_s"}
    drawn: dict[str, dict[str, Any]] = {}
    for name, values in signals.items():
        own = [fault for fault in faults if fault.channel == name]
        chain = _Chain(name, config.sensor(name), own, streams, dt_s)
        channels[name], drawn[name] = chain.record(values)
    return Recording(channels, {name: each for name, each in drawn.items() if each})


class _Chain(NamedTuple):
    """The measurement chain of one channel."""

    name: str
    sensor: ChannelSensor
    faults: Sequence[SensorFault]
    streams: Streams
    dt_s: float

    def record(self, truth: FloatArray) -> tuple[FloatArray, dict[str, Any]]:
        drawn = self._flight_errors()
        signal = self._biased(self._lagged(truth), drawn)
        sensor, stepwise = self.sensor, CHANNELS[self.name].role == "switch"
        taken = slots(len(truth), self.dt_s, sensor.rate_hz, sensor.slot_s)
        skew = drawn.get("skew_s", 0.0) + sum(each["skew_s"] for each in self._of("time_skew"))
        values = at_times(signal, self.dt_s, taken.time_s - skew, stepwise=stepwise)
        # Readings are limited to the range of the channel: Mach with a bias is not below 0.
        stops = CHANNELS[self.name].low, CHANNELS[self.name].high
        values = np.clip(values + self._noise(values, taken.time_s), *stops)
        values = self._spiked(values, taken.time_s, drawn)
        values = quantised(values, sensor.resolution)
        return self._interrupted(values, taken.time_s, drawn)[taken.shown], drawn

    def _of(self, effect: str) -> list[SensorFault]:
        return [fault for fault in self.faults if fault.id == effect]

    def _flight_errors(self) -> dict[str, Any]:
        """Draw bias, gain, drift and skew of the flight; those of size 0 are left out."""
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
        """Add gain error, bias and drift of the flight, and those of faults."""
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
        """Add single wild readings, up or down by `spike_size`."""
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
        """Add frozen intervals, then dropouts."""
        sensor = self.sensor
        for kind, per_h, mean_s in (
            ("freezes", sensor.freezes_per_h, sensor.freeze_s),
            ("dropouts", sensor.dropouts_per_h, sensor.dropout_s),
        ):
            if not per_h:
                continue
            spans = windows(self.streams.draw(self.name, kind), time_s, per_h, mean_s)
            if kind == "freezes":
                values = frozen(values, time_s, spans)
            else:
                values = np.where(within(time_s, spans), np.nan, values)
            if spans:
                drawn[f"{kind}_s"] = [list(span) for span in spans]
        return values


def _active(fault: SensorFault, time_s: FloatArray) -> FloatArray:
    spans = list(fault.windows_s or _WHOLE_LOG)
    return within(time_s, spans).astype(np.float64)


def _probed_temperature(signals: Mapping[str, FloatArray], tau_s: float, dt_s: float) -> FloatArray:
    """`dT_C` as derived from a total temperature probe that lags behind the air.

    `TAT = (ISA + dT) (1 + 0.2 M^2)`; the recorder subtracts the present altitude and Mach, so that
    the lag appears as a false `dT` while they change.
    """
    if tau_s <= 0.0:
        return signals["dT_C"]
    rise = 1.0 + 0.2 * signals["Mach"] ** 2
    total = (isa(signals["ALT_ft"])[0] + signals["dT_C"]) * rise
    return np.asarray(signals["dT_C"] + (first_order(total, tau_s, dt_s) - total) / rise)


def _code(name: str) -> int:
    """Number of a name that does not depend on other names."""
    return zlib.crc32(name.encode())
