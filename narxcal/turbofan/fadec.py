"""Electronic engine control and fuel system: from commanded N1 and sensor readings to burned fuel.

**Control.** All quantities are corrected by `theta` and `delta`, total temperature and pressure at
the fan face over their sea-level standards: speeds over `sqrt(theta)`, temperature over `theta`,
pressure over `delta`, fuel over `delta sqrt(theta)`, `Wf/Ps3` over `sqrt(theta)`. In corrected
quantities a gas turbine's dynamics are the same in all conditions if time is stretched by
`sqrt(theta) / delta` (NACA TR-1011); reset times of the control are stretched likewise.

Governor and topping loops are each proportional plus reset:

    demand = gain error + reset,    tau d(reset)/dt = (fuel demanded by the active loop) - reset

The active loop thus has an integrator of rate `gain / tau`; all others track the fuel demanded and
do not wind up (external reset, Shinskey, *Process Control Systems*). With `tau` the engine's slow
time constant, `reset` is the fuel that keeps the present speed, so after a slam the governor takes
over in its proportional band and approaches without overshoot. Its error is extrapolated by `lead`
along the rate of the sensed speed, which compensates the fast spool. Ceilings (acceleration
schedule, toppings) are applied before floors (deceleration schedule, lean blow-out).
Each switch of the active loop is a minimum or maximum of continuous signals, hence bumpless.

**Fuel system**, in series: an optional lag of the servo; the metering valve, a lag whose rate is
limited; the transport delay of the lines; and the lag of vaporising, burning and filling the
combustor's volume. The defaults are AGTF30's (0.1 s, 40 ms); its slew of 2.25 pps/s
spans 0 to 2.5 pps in about a second, so `slew_kgps2` is about the engine's largest fuel flow.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from narxcal.atmosphere import P0_PA, T0_K
from narxcal.support.arrays import FloatArray
from narxcal.support.compiled import compiled, lagged, ramp_lagged, slewed, table_value

# The active limiter, as `control_step` returns it and logs of the truth have it.
GOVERNOR, ACCELERATION, DECELERATION, N2_TOPPING, T45_TOPPING, MINIMUM = 0, 1, 2, 4, 5, 7
_TOPPINGS = 2  # N2, T45, in this order
_DAMPING = 0.9  # of the governor
# Power of `sqrt(theta) / delta` by which the gain rises: 0 keeps the response in corrected time,
# 1 keeps it in real time.
_GAIN_EXPONENT = 0.5
# State of the control: the governor's reset, those of the toppings, and N1 a step ago.
_RESET, _TOPPING_RESETS, _PAST_N1, SIZE = 0, 1, 3, 4


class FadecParameters(NamedTuple):
    """Tables and limits; all gains and times are those at sea level standard.

    `governor_gain` in kg/s per %, `governor_reset_s` and `governor_lead_s` over sensed corrected
    `governor_N1c_pct`: see `governor`.
    `accel_ratio`, `decel_ratio`: limits of `Wf / (Ps3 sqrt(theta2))` in kg/(s Pa) over
    `schedule_N2c_pct`; the effect `accel_limit` scales the margin of the former.
    `topping_limit`, `topping_gain`, `topping_reset_s` (2,): physical limits of N2 (%) and T45 (K),
    infinite for none, with gains in kg/s per corrected unit. A reset time equal to the slow spool's
    time constant (for T45, to its probe's) keeps a limit without overshoot. The fuel is never below
    `lean_ratio` (kg/(s Pa)) times Ps3.
    """

    governor_N1c_pct: FloatArray
    governor_gain: FloatArray
    governor_reset_s: FloatArray
    governor_lead_s: FloatArray
    schedule_N2c_pct: FloatArray
    accel_ratio: FloatArray
    decel_ratio: FloatArray
    topping_limit: FloatArray
    topping_gain: FloatArray
    topping_reset_s: FloatArray
    lean_ratio: float = 0.0


class Sensed(NamedTuple):
    """Command and sensor readings at one step of the control."""

    N1_command_pct: float
    N1_pct: float
    N2_pct: float
    T45_K: float
    Ps3_Pa: float
    P2_Pa: float
    T2_K: float


def governor(
    N1c_pct: FloatArray, fuel_kgps: FloatArray, lags_s: tuple[FloatArray, FloatArray, float]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Gain (kg/s per %), reset time and lead (s) that govern N1 with a damping ratio of 0.9.

    `fuel_kgps` is the steady line of corrected fuel over `N1c_pct`. `lags_s` are the engine's slow
    and fast time constants (n,) and the sum of all other lags and delays in the loop, at sea level
    standard. Reset and lead cancel the first two; of the loop `omega / (s (1 + other s))` that is
    left, `omega = 1 / (4 damping^2 other)` (any text on control). A fast constant of 0 means no
    lead. A reset time that is too long only slows the approach; one 1.2 times too short overshoots
    by 3 % of the change.
    """
    slow, fast, other = lags_s
    return np.gradient(fuel_kgps, N1c_pct) * slow / (4.0 * _DAMPING**2 * other), slow, fast


def steady_control(sensed: Sensed, fuel_kgps: float) -> FloatArray:
    """State of a control that has demanded `fuel_kgps` for a long time.

    If `sensed` shows no error (or a topping limit just met) `control_step` keeps that demand.
    """
    delta, root = sensed.P2_Pa / P0_PA, math.sqrt(sensed.T2_K / T0_K)
    state = np.full(SIZE, fuel_kgps / (delta * root))
    state[_PAST_N1] = sensed.N1_pct
    return state


@compiled
def control_step(
    parameters: FadecParameters, state: FloatArray, sensed: Sensed, dt_s: float
) -> tuple[float, int]:
    """Fuel demanded during the next `dt_s`, kg/s, and the active limiter.

    `state` comes from `steady_control` and is advanced by `dt_s`, exactly, as the demand is
    constant meanwhile.
    """
    delta, root = sensed.P2_Pa / P0_PA, math.sqrt(sensed.T2_K / T0_K)
    scale, stretch = delta * root, root / delta
    speed, knots = sensed.N1_pct / root, parameters.governor_N1c_pct
    lead_s = table_value(speed, knots, parameters.governor_lead_s) * stretch
    ahead = sensed.N1_pct + lead_s * (sensed.N1_pct - state[_PAST_N1]) / dt_s
    gain = table_value(speed, knots, parameters.governor_gain) * stretch**_GAIN_EXPONENT
    unlimited = state[_RESET] + gain * (sensed.N1_command_pct - ahead) / root
    fuel, active = _under_ceilings(parameters, state, sensed, (unlimited, delta, root))
    fuel, active = _over_floors(parameters, sensed, (fuel, delta, root), active)
    state[_PAST_N1] = sensed.N1_pct
    reset_s = table_value(speed, knots, parameters.governor_reset_s) * stretch
    state[_RESET] = lagged(state[_RESET], fuel, reset_s, dt_s)
    for j in range(_TOPPING_RESETS, _TOPPING_RESETS + _TOPPINGS):
        reset_s = parameters.topping_reset_s[j - _TOPPING_RESETS] * stretch
        state[j] = lagged(state[j], fuel, reset_s, dt_s)
    return fuel * scale, active


@compiled
def _under_ceilings(
    parameters: FadecParameters,
    state: FloatArray,
    sensed: Sensed,
    demand: tuple[float, float, float],
) -> tuple[float, int]:
    """Minimum of the corrected `demand` (fuel, delta, root) and the ceilings."""
    fuel, delta, root = demand
    active = GOVERNOR
    ratio = table_value(sensed.N2_pct / root, parameters.schedule_N2c_pct, parameters.accel_ratio)
    if ratio * sensed.Ps3_Pa / delta < fuel:
        fuel, active = ratio * sensed.Ps3_Pa / delta, ACCELERATION
    readings, corrections = (sensed.N2_pct, sensed.T45_K), (root, root * root)
    for j in range(_TOPPINGS):
        room = (parameters.topping_limit[j] - readings[j]) / corrections[j]
        allowed = state[_TOPPING_RESETS + j] + parameters.topping_gain[j] * room
        if allowed < fuel:
            fuel, active = allowed, N2_TOPPING + j
    return fuel, active


@compiled
def _over_floors(
    parameters: FadecParameters, sensed: Sensed, demand: tuple[float, float, float], active: int
) -> tuple[float, int]:
    """Maximum of the corrected `demand` (fuel, delta, root) and the floors."""
    fuel, delta, root = demand
    ratio = table_value(sensed.N2_pct / root, parameters.schedule_N2c_pct, parameters.decel_ratio)
    if ratio * sensed.Ps3_Pa / delta > fuel:
        fuel, active = ratio * sensed.Ps3_Pa / delta, DECELERATION
    least = parameters.lean_ratio * sensed.Ps3_Pa / (delta * root)
    return (least, MINIMUM) if least > fuel else (fuel, active)


# State of the fuel system; the samples in the line follow from LINE on, as a ring buffer.
SERVO, METERED, ARRIVING, BURNED, NEWEST, LINE = 0, 1, 2, 3, 4, 5


class FuelValveParameters(NamedTuple):
    """Time constants and limits; zero means none, an infinite slew no limit.

    The effect `actuator_lag` is `servo_tau_s` (a further lag in front of the valve), a larger
    `tau_s`, or a smaller `slew_kgps2`.
    """

    tau_s: float = 0.1
    slew_kgps2: float = math.inf
    delay_s: float = 0.04
    volume_tau_s: float = 0.02
    servo_tau_s: float = 0.0


def steady_valve(parameters: FuelValveParameters, fuel_kgps: float, dt_s: float) -> FloatArray:
    """State of a fuel system at a constant flow of `fuel_kgps`, for steps of `dt_s`."""
    state = np.full(LINE + math.floor(parameters.delay_s / dt_s) + 2, float(fuel_kgps))
    state[NEWEST] = 0.0
    return state


@compiled
def valve_step(
    parameters: FuelValveParameters, state: FloatArray, demand_kgps: float, dt_s: float
) -> float:
    """Advance `state` by `dt_s` at a constant demand; return the fuel burned at its end, kg/s.

    `state` comes from `steady_valve` for the same `dt_s`; afterwards `state[METERED]` is the flow
    through the valve, which a flowmeter measures. Lag and slew are exact; the metered flow and the
    input of the volume's lag are straight between two samples.
    """
    before = state[SERVO]
    state[SERVO] = lagged(before, demand_kgps, parameters.servo_tau_s, dt_s)
    limits = (parameters.tau_s, parameters.slew_kgps2)
    state[METERED] = slewed(state[METERED], state[SERVO], limits, dt_s)
    arriving = _transport(state, parameters.delay_s / dt_s)
    ends = (state[ARRIVING], arriving)
    state[BURNED] = ramp_lagged(state[BURNED], ends, parameters.volume_tau_s, dt_s)
    state[ARRIVING] = arriving
    return float(state[BURNED])


@compiled
def _transport(state: FloatArray, steps: float) -> float:
    """Put the metered flow into the line and take out what entered it `steps` ago."""
    length = len(state) - LINE
    newest = (int(state[NEWEST]) + 1) % length
    state[NEWEST] = newest
    state[LINE + newest] = state[METERED]
    whole = int(steps)
    share = steps - whole
    young = state[LINE + (newest - whole) % length]
    old = state[LINE + (newest - whole - 1) % length]
    return float(young + share * (old - young))
