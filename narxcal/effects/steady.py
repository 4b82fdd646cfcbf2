"""Effects on where the engine settles: offsets that follow a switch, power, the day or the past.

All are linear in their amplitudes, one per output concerned. Their shapes are what the emulation
of a steady shift needs to be right about; the engine takes about a second to follow a switch.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import numpy as np

from narxcal.effects.base import (
    Effect,
    LoadEffect,
    OutputEffect,
    Pace,
    PacedEffect,
    Parameter,
    Run,
    SettledEffect,
    Side,
    Signals,
    as_simulated,
    unit,
)
from narxcal.effects.operators import lag
from narxcal.support.arrays import FloatArray

UNLOGGED = "unlogged"  # input column that holds the windows found by their change points
FOLLOW_S = 1.0  # how an engine takes up a bleed
SWITCHES = ("ECS", "NAI", "WAI")


class ShapedEffect(Effect):
    """Shapes, each times its amplitude, added up: one amplitude per pair of `terms`."""

    side: ClassVar[Side] = "process"

    @abstractmethod
    def terms(self, signals: Signals) -> tuple[tuple[str, str], ...]:
        """Pairs (name of a shape, output that it moves), one per amplitude; none if not at hand."""

    @abstractmethod
    def shapes(self, run: Run, y: FloatArray) -> dict[str, FloatArray]:
        """Values (batch, time) of each shape for outputs `y`."""

    def parameters(self, signals: Signals) -> tuple[Parameter, ...]:
        """The parameters that bend the shapes, then the amplitudes, within an output's range."""
        return (*self.fixed, *(_amplitude(signals, *term) for term in self.terms(signals)))

    def applies(self, signals: Signals) -> bool:
        """Where there is anything to move."""
        return len(self.terms(signals)) > 0

    def total(self, run: Run, y: FloatArray) -> FloatArray:
        """Amplitudes times shapes, (batch, time, outputs)."""
        shapes, found = self.shapes(run, y), np.zeros_like(y)
        amplitudes = run.theta[:, len(self.fixed) :]
        for j, (shape, output) in enumerate(self.terms(run.signals)):
            found[..., run.signals.y(output)] += amplitudes[:, j, None] * shapes[shape]
        return found


class OffsetEffect(ShapedEffect, OutputEffect):
    """Shifts what is read of the outputs by its shapes."""

    def on_output(self, run: Run, y: FloatArray) -> FloatArray:
        """Outputs plus amplitudes times shapes."""
        return y + self.total(run, y)


def _amplitude(signals: Signals, shape: str, output: str) -> Parameter:
    width = signals.width(output)
    return Parameter(f"{shape}_{output}", unit(output), -width, width, 0.0, linear=True)


def _followed(run: Run, target: FloatArray) -> FloatArray:
    """What the engine takes up of a switch `target` (batch, time)."""
    return lag(target, np.full(len(target), FOLLOW_S), run.signals.dt_s)


class TakingEffect(OffsetEffect, LoadEffect):
    """An offset of what takes power, or gives less: hotter gas, and a core with less to spare.

    Under a control that schedules fuel, `loss` of acceleration where the temperature is off by its
    whole range: what an engine may accelerate with is what its fuel is more than it needs. Where
    fuel is the driver the shifts of the speeds say so.
    """

    taken: ClassVar[Parameter] = Parameter("loss", "%/s", 0.0, 60.0, 0.0, (1.0, 15.0))

    def parameters(self, signals: Signals) -> tuple[Parameter, ...]:
        """What bends the shapes, the amplitudes, and what the core loses under a control."""
        return (*super().parameters(signals), *((self.taken,) if signals.governed else ()))

    def loads(self, theta: FloatArray, signals: Signals) -> bool:
        """Under a control, where anything is lost."""
        return signals.governed and bool((theta[:, -1] != 0.0).any())

    def load(self, run: Run, y: FloatArray) -> FloatArray:
        """The loss times the shift of the temperature, as a share of its range."""
        if not run.signals.governed:
            return np.zeros(y.shape[:-1])
        hot = run.signals.hot
        share = self.total(run, y)[..., hot] / (run.signals.high[hot] - run.signals.low[hot])
        return np.asarray(run.theta[:, -1:] * share)


class BleedExtraction(TakingEffect):
    """Bleed that follows ECS, NAI and WAI shifts temperature and speeds, more at high power."""

    id: ClassVar[str] = "bleed_extraction"
    family: ClassVar[str] = "slow offset"
    meaning: ClassVar[str] = "bleed that follows the logged switches"
    manoeuvre: ClassVar[str] = "anti-ice and bleed on and off at constant throttle"

    def terms(self, signals: Signals) -> tuple[tuple[str, str], ...]:
        """Each switch that is used, on every output."""
        switches = [name for name in SWITCHES if name in signals.active]
        return tuple((name, to) for name in switches for to in signals.outputs)

    def shapes(self, run: Run, y: FloatArray) -> dict[str, FloatArray]:
        """The followed switches, half at idle and whole at full power."""
        power = 0.5 + 0.5 * np.clip(run.signals.power(y), 0.0, 1.0)
        names = [name for name in SWITCHES if name in run.signals.active]
        return {name: power * _followed(run, run.u[..., run.signals.u(name)]) for name in names}


class UnloggedSwitch(TakingEffect):
    """A load or bleed that no channel records is on in some windows."""

    id: ClassVar[str] = "unlogged_switch"
    family: ClassVar[str] = "slow offset"
    meaning: ClassVar[str] = "a load or bleed that no channel records"
    manoeuvre: ClassVar[str] = "record the bleed valves and loads, or hold the throttle longer"

    def terms(self, signals: Signals) -> tuple[tuple[str, str], ...]:
        """Every output, once windows have been found."""
        return tuple(("on", to) for to in signals.outputs) if UNLOGGED in signals.active else ()

    def shapes(self, run: Run, y: FloatArray) -> dict[str, FloatArray]:  # noqa: ARG002 - a load takes the same at any power
        """The followed windows."""
        return {"on": _followed(run, run.u[..., run.signals.u(UNLOGGED)])}


class Deterioration(TakingEffect):
    """Worn components shift temperature and N2 at given power, the same in all flights.

    They need more fuel for the same speed, so that a schedule of fuel leaves less to accelerate by.
    """

    id: ClassVar[str] = "deterioration"
    family: ClassVar[str] = "offset"
    meaning: ClassVar[str] = "shifts of temperature and speed that grow with power"
    manoeuvre: ClassVar[str] = "stabilised points over the whole power range, and both engines"

    def terms(self, signals: Signals) -> tuple[tuple[str, str], ...]:
        """A constant and a slope on every output that no control holds."""
        return tuple((shape, to) for to in signals.free for shape in ("base", "power"))

    def shapes(self, run: Run, y: FloatArray) -> dict[str, FloatArray]:
        """One, and the share of power."""
        return {"base": np.ones(y.shape[:-1]), "power": run.signals.power(y)}


class TemperatureEffect(OffsetEffect):
    """A steady error that goes with the day's deviation from the standard atmosphere, per 10 K."""

    id: ClassVar[str] = "temperature_effect"
    family: ClassVar[str] = "offset"
    meaning: ClassVar[str] = "steady error that follows the temperature of the day"
    manoeuvre: ClassVar[str] = "the same points on a cold and on a hot day"

    def terms(self, signals: Signals) -> tuple[tuple[str, str], ...]:
        """Every output, where days differ."""
        return tuple(("per_10K", to) for to in signals.outputs) if "dT_C" in signals.active else ()

    def shapes(self, run: Run, y: FloatArray) -> dict[str, FloatArray]:  # noqa: ARG002 - the same at any power
        """A tenth of the deviation."""
        return {"per_10K": 0.1 * run.u[..., run.signals.u("dT_C")]}


class IdleSchedule(ShapedEffect, SettledEffect):
    """Another idle while `Approach` is set: full with the lever at its stop, gone well above it.

    An idle is a floor under what the lever asks for, so that the shift falls with the lever until
    the two meet, at the share `meets` of its way. From a higher idle a slam is shorter: where the
    engine settles is shifted, and it moves from there as it does.
    """

    id: ClassVar[str] = "idle_schedule"
    family: ClassVar[str] = "slow offset"
    meaning: ClassVar[str] = "another approach idle"
    manoeuvre: ClassVar[str] = "idle with and without approach idle selected, at one condition"
    fixed = (Parameter("meets", "-", 0.03, 1.0, 0.3, (0.1, 0.6)),)

    def terms(self, signals: Signals) -> tuple[tuple[str, str], ...]:
        """Every output, where the switch is used and a lever asks for the power."""
        present = "Approach" in signals.active and signals.governed
        return tuple(("idle", to) for to in signals.outputs) if present else ()

    def settles(self, run: Run, y: FloatArray) -> FloatArray:
        """Amplitudes times how near to its stop the lever is."""
        return self.total(run, y)

    def shapes(self, run: Run, y: FloatArray) -> dict[str, FloatArray]:  # noqa: ARG002 - the lever says it all
        """The switch, falling with the lever to where the floor is met."""
        signals, (low, high) = run.signals, run.signals.lever
        lever = (run.u[..., signals.u(signals.driver)] - low) / (high - low)
        above = np.clip(1.0 - lever / run.theta[:, :1], 0.0, 1.0)
        return {"idle": run.u[..., signals.u("Approach")] * above}


class HeatSoak(OffsetEffect, PacedEffect):
    """Temperature (and N2) trail power by a slow share: metal still cold, clearances still open.

    The shape is the temperature behind a lag of `rise_s` less that behind one of `tau_s`: 30 to
    300 s for discs and casing (unverified), a third of that for blades and thin walls, where the
    lags of probes end. Blades and discs grow before the casing does: the share may take some
    time to come, and takes longer to go.

    What metal takes from the gas the turbines lack: under a control the core loses `loss` of
    acceleration where the metal trails by the whole range of the temperature, so that slams are
    slower, and fuel makes up for it afterwards. Where fuel is the driver the shares of the speeds
    say so.
    """

    id: ClassVar[str] = "heat_soak"
    family: ClassVar[str] = "slow offset"
    meaning: ClassVar[str] = "slow drift after a change of power"
    manoeuvre: ClassVar[str] = "3 to 5 minutes of hold after a large step, from cold and from hot"
    fixed = (
        Parameter("tau_s", "s", 8.0, 400.0, 20.0, (12.0, 35.0, 80.0, 200.0)),
        Parameter("rise_s", "s", 0.0, 60.0, 0.0, (1.0, 10.0)),
    )
    taken: ClassVar[Parameter] = Parameter("loss", "%/s", 0.0, 30.0, 0.0, (0.5, 3.0))

    def terms(self, signals: Signals) -> tuple[tuple[str, str], ...]:
        """Every output that no control holds."""
        return tuple(("share", to) for to in signals.free)

    def parameters(self, signals: Signals) -> tuple[Parameter, ...]:
        """The time constants, shares of the shape, and what the core loses under a control."""
        names = (f"{shape}_{to}" for shape, to in self.terms(signals))
        shares = (Parameter(name, "-", -2.0, 2.0, 0.0, linear=True) for name in names)
        return (*self.fixed, *shares, *((self.taken,) if signals.governed else ()))

    def pace(self, theta: FloatArray, signals: Signals) -> Pace:
        """The core's loss per degree (or unit of the last output), and the lags of the shape."""
        same = as_simulated(len(theta))
        if not signals.governed:
            return same
        width = float(signals.high[signals.hot] - signals.low[signals.hot])
        there = theta[:, -1] != 0.0
        return same._replace(
            loss=theta[:, -1] / width,
            metal_s=np.where(there, theta[:, 0], same.metal_s),
            rise_s=np.where(there, theta[:, 1], same.rise_s),
        )

    def shapes(self, run: Run, y: FloatArray) -> dict[str, FloatArray]:
        """What the metal lacks, in the unit of the temperature (or of the last output)."""
        hot, dt_s = y[..., run.signals.hot], run.signals.dt_s
        trail = lag(hot, run.theta[:, 1], dt_s) - lag(hot, run.theta[:, 0], dt_s)
        return {"share": trail * (0.5 + 0.5 * np.clip(run.signals.power(y), 0.0, 1.0))}
