"""Effects between the engine and the recorder: one channel each, nothing else changes."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import numpy as np

from narxcal.channels import SPOOLS
from narxcal.effects.base import OutputEffect, Parameter, Run, Side, Signals, unit
from narxcal.effects.memory import Clock, SmoothDelay, SmoothLag
from narxcal.support.arrays import FloatArray

LONGEST_S = 2.0
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
        """What is recorded (batch, time) for a block of true values."""


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
        lagged = run.memory.setdefault("lag", SmoothLag(own + tau, run.signals.dt_s))(value)
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
        hours = run.memory.setdefault("clock", Clock(run.signals.dt_s))(value) / 3600.0
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
        delay = SmoothDelay(run.theta[:, 0], run.signals.dt_s)
        return run.memory.setdefault("delay", delay)(value)
