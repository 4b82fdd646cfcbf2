"""Effects on the way of signals: from lever to control, and from a sensor to the recorder.

Those of a lever change the driving input alone, those of a sensor one channel each.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import replace
from typing import ClassVar

import numpy as np

from narxcal.channels import SPOOLS
from narxcal.effects.base import (
    InputEffect,
    OutputEffect,
    Parameter,
    Run,
    ShiftEffect,
    Side,
    Signals,
    unit,
)
from narxcal.effects.operators import delay, play, rate_limit, smooth_delay, smooth_lag
from narxcal.support.arrays import FloatArray

LONGEST_S = 2.0
AIR_DATA = {"ALT_ft": (3000.0, "ft"), "Mach": (0.2, "-")}  # largest error, and its unit
FROZEN_S = 10.0  # that a record stands still
FASTEST_DEGPS = 400.0  # faster than any hand: no limit at all


class _Lever(InputEffect):
    """An effect on the driving input alone."""

    side: ClassVar[Side] = "input"

    def on_input(self, run: Run, u: FloatArray) -> FloatArray:
        """Inputs with the driver as it arrives; the others are passed on."""
        column, changed = run.signals.u(run.signals.driver), u.copy()
        changed[..., column] = self.arrived(run, u[..., column])
        return changed

    @abstractmethod
    def arrived(self, run: Run, lever: FloatArray) -> FloatArray:
        """Lever position (batch, time) that arrives."""


class ThrottleBacklash(_Lever):
    """Play in the linkage, `width_deg` wide: the far end moves only while it is pushed.

    Rests in the middle of its play before the first sample.
    """

    id: ClassVar[str] = "throttle_backlash"
    family: ClassVar[str] = "lever"
    meaning: ClassVar[str] = "play in the throttle linkage"
    manoeuvre: ClassVar[str] = "small lever reversals, slow and fast, about one trim"
    fixed = (Parameter("width_deg", "deg", 0.0, 15.0, 0.0, (0.7, 2.0, 5.0)),)

    def arrived(self, run: Run, lever: FloatArray) -> FloatArray:
        """The play operator, at any rate alike."""
        return play(lever, run.theta[:, 0])


class ThrottleDelay(_Lever, ShiftEffect):
    """Transport delay between lever and control, of any length.

    Where fuel is the driver it may be negative: a meter that is late makes the engine early.
    """

    id: ClassVar[str] = "throttle_delay"
    family: ClassVar[str] = "initiation"
    meaning: ClassVar[str] = "transport delay between throttle and control"
    manoeuvre: ClassVar[str] = "fast steps recorded at 4 Hz or more, on all channels"
    fixed = (Parameter("delay_s", "s", 0.0, LONGEST_S, 0.0, (0.1, 0.3, 0.8)),)

    def parameters(self, signals: Signals) -> tuple[Parameter, ...]:
        """The delay, of both signs where fuel is the driver."""
        if signals.governed:
            return self.fixed
        starts = (-0.3, -0.1, *self.fixed[0].starts)
        return (replace(self.fixed[0], low=-LONGEST_S, starts=starts),)

    def arrived(self, run: Run, lever: FloatArray) -> FloatArray:
        """Where the lever was `delay_s` ago."""
        return delay(lever, run.theta[:, 0], run.signals.dt_s)

    def on_log(self, run: Run, y: FloatArray) -> FloatArray:
        """What the outputs were `delay_s` ago; conditions change little meanwhile."""
        delay_s, dt_s = run.theta[:, 0], run.signals.dt_s
        columns = [smooth_delay(y[..., j], delay_s, dt_s) for j in range(y.shape[-1])]
        return np.stack(columns, axis=-1)


class ThrottleRateLimit(_Lever):
    """The control follows the lever no faster than `rate_degps`."""

    id: ClassVar[str] = "throttle_rate_limit"
    family: ClassVar[str] = "transit"
    meaning: ClassVar[str] = "limit on how fast the control follows the throttle"
    manoeuvre: ClassVar[str] = "slams of three sizes: its transit time grows with the step"
    fixed = (
        Parameter("rate_degps", "deg/s", 1.0, FASTEST_DEGPS, FASTEST_DEGPS, (60.0, 20.0, 8.0)),
    )

    def arrived(self, run: Run, lever: FloatArray) -> FloatArray:
        """The lever through a limit of rate; none at all at the neutral rate."""
        rate = np.where(run.theta[:, 0] < FASTEST_DEGPS, run.theta[:, 0], np.inf)
        return rate_limit(lever, rate, run.signals.dt_s)


class DriverGain(_Lever):
    """What drives the engine is read `gain_pct` too large: a lever's scale, or a fuel meter's.

    Where fuel is the driver, fuel of another heating value gives the same signals.
    """

    id: ClassVar[str] = "driver_gain"
    family: ClassVar[str] = "offset"
    meaning: ClassVar[str] = "scale of the lever or fuel meter (or the fuel's heating value)"
    manoeuvre: ClassVar[str] = "holds over the whole range of the driver, on both engines"
    fixed = (Parameter("gain_pct", "%", -15.0, 15.0, 0.0, (-2.5, 2.5)),)

    def arrived(self, run: Run, lever: FloatArray) -> FloatArray:
        """The driver times a constant."""
        return lever * (1.0 + 0.01 * run.theta[:, :1])


class ThrottleBias(_Lever):
    """The control reads the lever `bias_deg` too high."""

    id: ClassVar[str] = "throttle_bias"
    family: ClassVar[str] = "offset"
    meaning: ClassVar[str] = "offset of the throttle position"
    manoeuvre: ClassVar[str] = "holds at several lever positions, idle stop and full power included"
    fixed = (Parameter("bias_deg", "deg", -8.0, 8.0, 0.0, (-2.0, 2.0)),)

    def arrived(self, run: Run, lever: FloatArray) -> FloatArray:
        """The lever plus a constant."""
        return lever + run.theta[:, :1]


class AirDataEffect(InputEffect):
    """An error of the recorded altitude or Mach number: the simulator flew it, the engine did not.

    What the record lost is looked up where it goes on, so that no more of it is known than that.
    """

    side: ClassVar[Side] = "input"
    family: ClassVar[str] = "air data"

    def applies(self, signals: Signals) -> bool:
        """Where the channel is flown through more than one value."""
        return self.channel in AIR_DATA and self.channel in signals.active

    def on_input(self, run: Run, u: FloatArray) -> FloatArray:
        """Inputs with the channel as it was; the others are passed on."""
        column, changed = run.signals.u(self.channel or ""), u.copy()
        changed[..., column] = self.true(run, u[..., column])
        return changed

    @abstractmethod
    def true(self, run: Run, recorded: FloatArray) -> FloatArray:
        """What it was (batch, time) where this is recorded."""


class AirDataBias(AirDataEffect):
    """The channel reads `bias` too much."""

    id: ClassVar[str] = "air_data_bias"
    meaning: ClassVar[str] = "one channel recorded with an offset"
    manoeuvre: ClassVar[str] = "holds at one lever position, at low and at high altitude and Mach"

    def parameters(self, signals: Signals) -> tuple[Parameter, ...]:  # noqa: ARG002 - the channel says it
        """An offset of up to 3000 ft, or of 0.2 in Mach."""
        most, text = AIR_DATA[self.channel or ""]
        return (Parameter("bias", text, -most, most, 0.0, (-0.15 * most, 0.15 * most)),)

    def true(self, run: Run, recorded: FloatArray) -> FloatArray:
        """The record less its offset, no Mach number below 0."""
        low = 0.0 if self.channel == "Mach" else -np.inf
        return np.where(
            run.theta[:, :1] == 0.0, recorded, np.maximum(recorded - run.theta[:, :1], low)
        )


class AirDataDelay(AirDataEffect):
    """The channel is recorded `late_s` late."""

    id: ClassVar[str] = "air_data_delay"
    meaning: ClassVar[str] = "one channel of the air data recorded late"
    manoeuvre: ClassVar[str] = "fast climbs and descents at one lever position"
    fixed = (Parameter("late_s", "s", 0.0, 60.0, 0.0, (3.0, 15.0)),)

    def true(self, run: Run, recorded: FloatArray) -> FloatArray:
        """What is recorded `late_s` from now."""
        return delay(recorded, -run.theta[:, 0], run.signals.dt_s)


class AirDataFrozen(AirDataEffect):
    """While the record stands still to the digit, the channel goes on to where it goes on.

    By `share` of the way, straight. A level flight stands still as well: the record then goes on
    where it stood.
    """

    id: ClassVar[str] = "air_data_frozen"
    meaning: ClassVar[str] = "one channel frozen in the record for a while"
    manoeuvre: ClassVar[str] = "climbs and descents with a second source of the air data"
    fixed = (Parameter("share", "-", 0.0, 1.0, 0.0, (0.5,)),)

    def true(self, run: Run, recorded: FloatArray) -> FloatArray:
        """The record, with straight lines in the place of what stands still."""
        found, time = recorded.copy(), np.arange(recorded.shape[1])
        for k, row in enumerate(recorded):
            starts = np.flatnonzero(np.diff(row, prepend=np.nan) != 0.0)
            lengths = np.diff(np.append(starts, len(row)))
            held = np.repeat(lengths * run.signals.dt_s >= FROZEN_S, lengths)
            held[starts] = False
            corners = time[~held]
            found[k] += run.theta[k, 0] * (np.interp(time, corners, row[corners]) - row)
        return found


_COUNTED = Parameter("own_s", "s", 0.0, 0.5, 0.0, (0.05, 0.3))  # of a speed


class SensorEffect(OutputEffect):
    """An effect on the reading of `channel` alone."""

    side: ClassVar[Side] = "sensor"

    def on_output(self, run: Run, y: FloatArray) -> FloatArray:
        """Outputs with one channel as it is read; the others are passed on."""
        column, read = run.signals.y(self.channel or ""), y.copy()
        read[..., column] = self.reading(run, y[..., column])
        return read

    @abstractmethod
    def reading(self, run: Run, value: FloatArray) -> FloatArray:
        """What is recorded (batch, time) of true values."""


class SensorLag(SensorEffect):
    """The sensor's time constant is `tau_s` longer than the simulator has it.

    The simulator's channel may be behind a lag of its own, `own_s`, which is then replaced:
    `(1 + own s) / (1 + (own + tau) s)`. With `own_s` = 0 it is one more lag in series. A probe
    takes some 5 s at most, at idle and altitude (unverified): what is slower is the metal round it.
    A speed is counted from pulses, in a fraction of a second: where a lag of seconds is replaced by
    a longer one, that is a rotor which follows the other more slowly, and no sensor.
    """

    id: ClassVar[str] = "sensor_lag"
    family: ClassVar[str] = "channel lag"
    meaning: ClassVar[str] = "lag of one sensor"
    manoeuvre: ClassVar[str] = "fast steps: a lag rounds one channel off, a delay only shifts it"
    fixed = (
        Parameter("tau_s", "s", 0.0, 6.0, 0.0, (0.2, 0.8, 3.0)),
        Parameter("own_s", "s", 0.0, 2.5, 0.0, (0.05, 0.6)),
    )

    def parameters(self, signals: Signals) -> tuple[Parameter, ...]:  # noqa: ARG002 - the channel says it
        """How much longer, and the simulator's own lag, which of a speed is short."""
        counted = self.channel in SPOOLS
        return (self.fixed[0], _COUNTED) if counted else self.fixed

    def reading(self, run: Run, value: FloatArray) -> FloatArray:
        """The lagged channel, settled at its first value."""
        tau, own = run.theta[:, 0], run.theta[:, 1]
        passed = (own / np.maximum(own + tau, 1e-9))[:, None]
        lagged = smooth_lag(value, own + tau, run.signals.dt_s)
        # Without an added lag, or without a lag at all, nothing may change, to the bit.
        same = (tau == 0.0)[:, None]
        return np.asarray(np.where(same, value, lagged + passed * (value - lagged)))


class FlowmeterDynamics(SensorLag):
    """The fuel flowmeter follows with a first-order lag."""

    id: ClassVar[str] = "flowmeter_dynamics"
    meaning: ClassVar[str] = "lag of the fuel flowmeter"


class SensorBias(SensorEffect):
    """The sensor reads a constant too much, in all flights alike."""

    id: ClassVar[str] = "sensor_bias"
    family: ClassVar[str] = "offset"
    meaning: ClassVar[str] = "constant offset of one sensor"
    manoeuvre: ClassVar[str] = "holds at idle and at full power, on both engines"

    def parameters(self, signals: Signals) -> tuple[Parameter, ...]:
        """One offset, within half of the channel's range."""
        half, text = 0.5 * signals.width(self.channel or ""), unit(self.channel or "")
        return (Parameter("bias", text, -half, half, 0.0, linear=True),)

    def reading(self, run: Run, value: FloatArray) -> FloatArray:
        """The channel plus a constant."""
        return value + run.theta[:, :1]


class SensorGain(SensorEffect):
    """The sensor reads `gain_pct` too much of its value, in all flights alike."""

    id: ClassVar[str] = "sensor_gain"
    family: ClassVar[str] = "offset"
    meaning: ClassVar[str] = "scale of one sensor"
    manoeuvre: ClassVar[str] = "holds over the whole range, on both engines"
    fixed = (Parameter("gain_pct", "%", -20.0, 20.0, 0.0, linear=True),)

    def reading(self, run: Run, value: FloatArray) -> FloatArray:
        """The channel times a constant."""
        return value * (1.0 + 0.01 * run.theta[:, :1])


class SensorDrift(SensorEffect):
    """The sensor's offset grows with time, from nothing at the start of each flight."""

    id: ClassVar[str] = "sensor_drift"
    family: ClassVar[str] = "slow offset"
    meaning: ClassVar[str] = "drift of one sensor"
    manoeuvre: ClassVar[str] = "a long hold at constant throttle: a drift goes on"

    def parameters(self, signals: Signals) -> tuple[Parameter, ...]:
        """One slope, up to the channel's range in three minutes."""
        most, text = 20.0 * signals.width(self.channel or ""), unit(self.channel or "")
        return (Parameter("rate_per_h", f"{text}/h", -most, most, 0.0, linear=True),)

    def reading(self, run: Run, value: FloatArray) -> FloatArray:
        """The channel plus what has gathered since the start."""
        hours = np.arange(value.shape[1]) * run.signals.dt_s / 3600.0
        return value + run.theta[:, :1] * hours


class TimeSkew(SensorEffect):
    """The channel is recorded `skew_s` late."""

    id: ClassVar[str] = "time_skew"
    family: ClassVar[str] = "channel lag"
    meaning: ClassVar[str] = "one channel recorded late"
    manoeuvre: ClassVar[str] = "fast steps: a delay shifts one channel, a lag rounds it off"
    fixed = (Parameter("skew_s", "s", 0.0, LONGEST_S, 0.0, (0.1, 0.3, 0.8)),)

    def reading(self, run: Run, value: FloatArray) -> FloatArray:
        """What the channel was `skew_s` ago."""
        return smooth_delay(value, run.theta[:, 0], run.signals.dt_s)
