"""Effects on where the engine settles: offsets that follow a switch, power, the day or the past.

All are linear in their amplitudes, one per output concerned. Their shapes are what the emulation
of a steady shift needs to be right about; the engine takes about a second to follow a switch.
"""

from __future__ import annotations

from functools import partial
from typing import Final

import numpy as np

from narxcal.effects.base import Effect, Pace, Parameter, Run, Signals, Terms, as_simulated
from narxcal.effects.operators import lag
from narxcal.support.arrays import FloatArray

UNLOGGED = "unlogged"  # input column that holds the windows found by their change points
FOLLOW_S = 1.0  # how an engine takes up a bleed
SWITCHES = ("ECS", "NAI", "WAI")
TAKEN: Final = Parameter("loss", "%/s", 0.0, 60.0, 0.0, (1.0, 15.0))
Shapes = dict[str, FloatArray]

_shaped = partial(Effect, side="process")
# What takes power, or gives less: hotter gas, and a core with less to spare. Under a control that
# schedules fuel, `loss` of acceleration where the temperature is off by its whole range: what an
# engine may accelerate with is what its fuel is more than it needs. Where fuel is the driver the
# shifts of the speeds say so.
_taking = partial(_shaped, taken=TAKEN)


def _followed(run: Run, target: FloatArray) -> FloatArray:
    """What the engine takes up of a switch `target` (batch, time)."""
    return lag(target, np.full(len(target), FOLLOW_S), run.signals.dt_s)


def _used(signals: Signals) -> list[str]:
    return [name for name in SWITCHES if name in signals.active]


def _bled(run: Run, y: FloatArray) -> Shapes:
    """The followed switches, half at idle and whole at full power."""
    power = 0.5 + 0.5 * np.clip(run.signals.power(y), 0.0, 1.0)
    return {
        name: power * _followed(run, run.u[..., run.signals.u(name)]) for name in _used(run.signals)
    }


BLEED_EXTRACTION: Final = _taking(
    id="bleed_extraction",
    family="slow offset",
    meaning="bleed that follows the logged switches",
    manoeuvre="anti-ice and bleed on and off at constant throttle",
    apart=True,
    terms=lambda signals: tuple((name, to) for name in _used(signals) for to in signals.outputs),
    shapes=_bled,
)


def _where_active(name: str, shape: str, signals: Signals) -> Terms:
    """The shape on every output, where an input is active."""
    return tuple((shape, to) for to in signals.outputs) if name in signals.active else ()


# A load or bleed is on in some windows, once these have been found; it takes the same at any power.
UNLOGGED_SWITCH: Final = _taking(
    id="unlogged_switch",
    family="slow offset",
    meaning="a load or bleed that no channel records",
    manoeuvre="record the bleed valves and loads, or hold the throttle longer",
    terms=partial(_where_active, UNLOGGED, "on"),
    shapes=lambda run, _y: {"on": _followed(run, run.u[..., run.signals.u(UNLOGGED)])},
)

# Worn components need more fuel for the same speed, so that a schedule of fuel leaves less to
# accelerate by: a constant and a slope on every output that no control holds, in all flights alike.
DETERIORATION: Final = _taking(
    id="deterioration",
    family="offset",
    meaning="shifts of temperature and speed that grow with power",
    manoeuvre="stabilised points over the whole power range, and both engines",
    terms=lambda signals: tuple((shape, to) for to in signals.free for shape in ("base", "power")),
    shapes=lambda run, y: {"base": np.ones(y.shape[:-1]), "power": run.signals.power(y)},
)

TEMPERATURE_EFFECT: Final = _shaped(
    id="temperature_effect",
    family="offset",
    meaning="steady error that follows the temperature of the day",
    manoeuvre="the same points on a cold and on a hot day",
    terms=partial(_where_active, "dT_C", "per_10K"),
    shapes=lambda run, _y: {"per_10K": 0.1 * run.u[..., run.signals.u("dT_C")]},
)


def _floor(run: Run, _y: FloatArray) -> Shapes:
    """The switch, falling with the lever to where the floor is met."""
    signals, (low, high) = run.signals, run.signals.lever
    lever = (run.u[..., signals.u(signals.driver)] - low) / (high - low)
    above = np.clip(1.0 - lever / run.theta[:, :1], 0.0, 1.0)
    return {"idle": run.u[..., signals.u("Approach")] * above}


# Another idle while `Approach` is set: full with the lever at its stop, gone well above it. An idle
# is a floor under what the lever asks for, so that the shift falls with the lever until the two
# meet, at the share `meets` of its way. From a higher idle a slam is shorter: where the engine
# settles is shifted, and it moves from there as it does.
IDLE_SCHEDULE: Final = _shaped(
    id="idle_schedule",
    family="slow offset",
    meaning="another approach idle",
    manoeuvre="idle with and without approach idle selected, at one condition",
    fixed=(Parameter("meets", "-", 0.03, 1.0, 0.3, (0.1, 0.6)),),
    settled=True,
    terms=lambda signals: _where_active("Approach", "idle", signals) if signals.governed else (),
    shapes=_floor,
)


def _share(_signals: Signals, shape: str, output: str) -> Parameter:
    return Parameter(f"{shape}_{output}", "-", -2.0, 2.0, 0.0, linear=True)


def _soaked(theta: FloatArray, signals: Signals) -> Pace:
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


def _trailed(run: Run, y: FloatArray) -> Shapes:
    """What the metal lacks, in the unit of the temperature (or of the last output)."""
    hot, dt_s = y[..., run.signals.hot], run.signals.dt_s
    trail = lag(hot, run.theta[:, 1], dt_s) - lag(hot, run.theta[:, 0], dt_s)
    return {"share": trail * (0.5 + 0.5 * np.clip(run.signals.power(y), 0.0, 1.0))}


# Temperature (and N2) trail power by a slow share: metal still cold, clearances still open. The
# shape is the temperature behind a lag of `rise_s` less that behind one of `tau_s`: 30 to 300 s for
# discs and casing (unverified), a third of that for blades and thin walls, where the lags of probes
# end. Blades and discs grow before the casing does: the share may take some time to come, and takes
# longer to go. What metal takes from the gas the turbines lack: under a control the core loses
# `loss` of acceleration where the metal trails by the whole range of the temperature, so that slams
# are slower, and fuel makes up for it afterwards. Where fuel is the driver the shares of the speeds
# say so.
HEAT_SOAK: Final = _shaped(
    id="heat_soak",
    family="slow offset",
    meaning="slow drift after a change of power",
    manoeuvre="3 to 5 minutes of hold after a large step, from cold and from hot",
    fixed=(
        Parameter("tau_s", "s", 8.0, 400.0, 20.0, (12.0, 35.0, 80.0, 200.0)),
        Parameter("rise_s", "s", 0.0, 60.0, 0.0, (1.0, 10.0)),
    ),
    amplitude=_share,
    taken=Parameter("loss", "%/s", 0.0, 30.0, 0.0, (0.5, 3.0)),
    pace=_soaked,
    terms=lambda signals: tuple(("share", to) for to in signals.free),
    shapes=_trailed,
)
