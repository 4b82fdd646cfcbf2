"""Effects on how fast the engine moves; where it settles does not change."""

from __future__ import annotations

from functools import partial
from typing import Final

import numpy as np

from narxcal.channels import SPOOLS
from narxcal.effects.base import UNLIMITED, Effect, Pace, Parameter, Run, Signals, as_simulated
from narxcal.effects.operators import lag
from narxcal.support.arrays import FloatArray

FASTEST_PCTPS = 30.0  # of core speed: no control allows more
_EITHER = 0.5  # of a share that is all or nothing

# Effects on the rates of the rotors, or on what the control lets them do.
_transit = partial(
    Effect,
    side="process",
    family="transit",
    acts=lambda signals, _channel: any(name in signals.outputs for name in SPOOLS),
)


def _heavier(theta: FloatArray, _signals: Signals) -> Pace:
    slower, same = 1.0 / theta[:, 0], as_simulated(len(theta))
    return same._replace(fan_up=slower, fan_down=slower, core_up=slower, core_down=slower)


# Both rotors are `factor` times as heavy: the same surplus of power moves them less. Under a
# governor the fan follows its demand where fuel allows it; core and temperature overshoot more.
SPOOL_LAG: Final = _transit(
    id="spool_lag",
    meaning="time constants of both spools scaled",
    manoeuvre="steps of three sizes, both ways: its transit time is independent",
    fixed=(Parameter("factor", "-", 0.4, 4.0, 1.0, (0.8, 1.3, 2.0)),),
    pace=_heavier,
)


def _heavier_fan(theta: FloatArray, _signals: Signals) -> Pace:
    slower = 1.0 / theta[:, 0]
    return as_simulated(len(theta))._replace(fan_up=slower, fan_down=slower)


# The low-pressure rotor alone is `factor` times as heavy: it trails the other differently.
SPOOL_COUPLING: Final = _transit(
    id="spool_coupling",
    meaning="low-pressure spool follows the high-pressure spool differently",
    manoeuvre="fast steps: N1 against N2 in the transit, up and down",
    fixed=SPOOL_LAG.fixed,
    acts=lambda signals, _channel: all(name in signals.outputs for name in SPOOLS),
    pace=_heavier_fan,
)

_RATIO: Final = (
    Parameter("ratio", "-", 0.4, 4.0, 1.0, (0.8, 1.3, 2.0)),
    Parameter("by_control", "-", 0.0, 1.0, 0.0, (0.0, 1.0)),
)


def _one_way(theta: FloatArray, signals: Signals) -> Pace:
    """`1 / ratio` of every rising rate, or `ratio` of the limit of deceleration."""
    ratio, same = theta[:, 0], as_simulated(len(theta))
    control = theta[:, 1] >= _EITHER if signals.governed else np.zeros(len(theta), bool)
    slower = np.where(control, 1.0, 1.0 / ratio)
    return same._replace(fan_up=slower, core_up=slower, fall=np.where(control, ratio, 1.0))


# Pushes take `ratio` times as long, against pulls, as they do in the simulator: time constants are
# longer while the spools speed up; or (`by_control`, 0 or 1) the control lets the core slow down
# `ratio` times as fast, where its schedule of deceleration holds; where fuel drives there is none.
ACCEL_DECEL_ASYMMETRY: Final = _transit(
    id="accel_decel_asymmetry",
    meaning="pushes slower (or faster) than pulls",
    manoeuvre="pushes and pulls of one size, at low and at high altitude",
    fixed=_RATIO,
    bounds=lambda signals, _channel: _RATIO if signals.governed else _RATIO[:1],
    pace=_one_way,
)

_LIMITS: Final = (
    Parameter("share", "-", 0.1, 2.0, 1.0, (0.8, 0.5, 0.3)),
    Parameter("most_pctps", "%/s", 0.3, FASTEST_PCTPS, FASTEST_PCTPS, (8.0,)),
)


def _limited(theta: FloatArray, _signals: Signals) -> Pace:
    most = np.where(theta[:, 1] < FASTEST_PCTPS, theta[:, 1], UNLIMITED)
    return as_simulated(len(theta))._replace(limit=theta[:, 0], most=most)


# The control allows `share` of the acceleration that the simulator's allows. The limit keeps the
# shape of the simulator's own over speed and air. Where that never was reached, it is the greatest
# acceleration of the logs, and goes with `delta / sqrt(theta)`. Or it allows no more than
# `most_pctps`, at any speed and altitude. It begins with a share alone or an absolute limit alone.
ACCEL_LIMIT: Final = _transit(
    id="accel_limit",
    meaning="acceleration limited by the control",
    manoeuvre="slams of three sizes: only the large ones are slower",
    fixed=_LIMITS,
    starts=(
        *((share, FASTEST_PCTPS) for share in _LIMITS[0].starts),
        *((1.0, most) for most in (8.0, 4.0, 2.0)),
    ),
    pace=_limited,
)

# Time constants go with air density by an `exponent` more than the simulator has it:
# `tau ~ (sqrt(theta) / delta)^exponent` (NACA TR-1011).
ALTITUDE_LAG: Final = _transit(
    id="altitude_lag",
    meaning="time constants grow with altitude",
    manoeuvre="the same slam at low and at high altitude",
    fixed=(Parameter("exponent", "-", -1.5, 2.0, 0.0, (-0.3, 0.3, 0.8)),),
    acts=lambda signals, _channel: (
        "ALT_ft" in signals.active and any(name in signals.outputs for name in SPOOLS)
    ),
    pace=lambda theta, _signals: as_simulated(len(theta))._replace(thin_air=theta[:, 0]),
)

_VALVE: Final = (
    Parameter("tau_s", "s", 0.0, 3.0, 0.0, (0.1, 0.3, 0.8)),
    Parameter("core_s", "s", 0.3, 5.0, 1.0, (0.7, 2.0)),
    Parameter("outside", "-", 0.0, 1.0, 0.0, (0.0, 1.0)),
)


def _in_the_loop(theta: FloatArray, signals: Signals) -> Pace:
    """The valve's lag inside the loop, and how the core answers fuel."""
    same = as_simulated(len(theta))
    if not signals.governed:
        return same
    inside = theta[:, 2] < _EITHER
    return same._replace(valve_s=theta[:, 0] * inside, core_s=theta[:, 1])


def _behind_it(run: Run, y: FloatArray) -> FloatArray:
    """Outside a loop, all outputs behind one and the same lag."""
    outside = run.theta[:, 2] >= _EITHER if run.signals.governed else 1.0
    tau_s, dt_s = run.theta[:, 0] * outside, run.signals.dt_s
    return np.stack([lag(y[..., j], tau_s, dt_s) for j in range(y.shape[-1])], axis=-1)


# A further lag of `tau_s` between what the control asks for and the fuel that burns. An
# accelerating engine needs ever more fuel, so that fuel which is late is fuel that is missing all
# along. How much, goes with the core's own time constant `core_s`, which is fitted with it. So it
# is where the control closes a loop over the lag. Where it lies `outside` any loop (0 or 1: a lever
# that asks for fuel), as where fuel is the driver, it commutes with the engine, and all outputs
# follow the simulator's with the one lag.
ACTUATOR_LAG: Final = _transit(
    id="actuator_lag",
    family="initiation",
    meaning="lag of the fuel metering valve",
    manoeuvre="fast small steps: a lag bends the start, a delay only shifts it",
    fixed=_VALVE,
    bounds=lambda signals, _channel: _VALVE if signals.governed else _VALVE[:1],
    pace=_in_the_loop,
    reads=_behind_it,
)
