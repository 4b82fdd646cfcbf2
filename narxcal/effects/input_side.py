"""Effects between the pilot's lever and what the control receives."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import replace
from typing import ClassVar

import numpy as np

from narxcal.effects.base import InputEffect, Parameter, Run, ShiftEffect, Side, Signals
from narxcal.effects.memory import Delay, Play, RateLimit, SmoothDelay
from narxcal.support.arrays import FloatArray

LONGEST_S = 2.0
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
        """Lever position (batch, time) that arrives, for a block of positions."""


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
        return run.memory.setdefault("play", Play(run.theta[:, 0]))(lever)


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
        delay = Delay(run.theta[:, 0], run.signals.dt_s)
        return run.memory.setdefault("delay", delay)(lever)

    def on_log(self, run: Run, y: FloatArray) -> FloatArray:
        """What the outputs were `delay_s` ago; conditions change little meanwhile."""
        columns = [
            run.memory.setdefault(f"delay {j}", SmoothDelay(run.theta[:, 0], run.signals.dt_s))(
                y[..., j]
            )
            for j in range(y.shape[-1])
        ]
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
        return run.memory.setdefault("limit", RateLimit(rate, run.signals.dt_s))(lever)


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
