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
schedule, toppings) are applied before floors (deceleration schedule, lean blow-out, minimum fuel).
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
from numpy.typing import ArrayLike

from narxcal.atmosphere import P0_PA, T0_K
from narxcal.support.arrays import FloatArray
from narxcal.support.compiled import compiled, lagged, ramp_lagged, slewed, table_value
from narxcal.support.errors import ConfigError, ModelError

# The active limiter, as `control_step` returns it.
GOVERNOR, ACCELERATION, DECELERATION, N1_TOPPING, N2_TOPPING, T45_TOPPING, PS3_TOPPING, MINIMUM = (
    range(8)
)
_TOPPINGS = 3  # N2, T45, Ps3, in this order
# State of the control: the governor's reset, those of the toppings, and N1 a step ago.
_RESET, _TOPPING_RESETS, _PAST_N1, SIZE = 0, 1, 4, 5


class FadecParameters(NamedTuple):
    """Tables and limits; all gains and times are those at sea level standard.

    `governor_gain` in kg/s per %, `governor_reset_s` and `governor_lead_s` over sensed corrected
    `governor_N1c_pct`: see `governor`. `gain_exponent` raises the gain by that power of
    `sqrt(theta) / delta`: 0 keeps the response in corrected time, 1 keeps it in real time.
    `accel_ratio`, `decel_ratio` in kg/(s Pa) over `schedule_N2c_pct`: see `schedules`, where the
    effects `accel_limit` and `accel_decel_asymmetry` are margins.
    `topping_limit`, `topping_gain`, `topping_reset_s` (3,): physical limits of N2 (%), T45 (K) and
    Ps3 (Pa), infinite for none, with gains in kg/s per corrected unit. A reset time equal to the
    slow spool's time constant (for T45, to its probe's) keeps a limit without overshoot.
    `N1_max_pct` limits the commanded N1. The fuel is never below `fuel_min_kgps`, nor below
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
    N1_max_pct: float = math.inf
    fuel_min_kgps: float = 0.0
    lean_ratio: float = 0.0
    gain_exponent: float = 0.5


class Sensed(NamedTuple):
    """Command and sensor readings at one step of the control."""

    N1_command_pct: float
    N1_pct: float
    N2_pct: float
    T45_K: float
    Ps3_Pa: float
    P2_Pa: float
    T2_K: float


def schedules(
    N2c_pct: ArrayLike, ratio: ArrayLike, *, accel_margin: ArrayLike, decel_margin: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Acceleration and deceleration limits about the steady line `ratio` over `N2c_pct`.

    `ratio = Wf / (Ps3 sqrt(theta2))` in kg/(s Pa). The limits are `(1 + accel_margin) ratio` and
    `(1 - decel_margin) ratio`; margins are fractions of the steady fuel that may be added or taken
    away, each one number or a value per speed. The effect `accel_limit` scales `accel_margin`,
    `accel_decel_asymmetry` sets them apart.

    Raises `ModelError` if the line is no table, or a margin leaves no room to move.
    """
    line = _table("steady line", N2c_pct, ratio)
    up, down = np.asarray(accel_margin, np.float64), np.asarray(decel_margin, np.float64)
    if not (np.all(up > 0.0) and np.all((down > 0.0) & (down < 1.0))):
        raise ModelError(
            "schedules: expected an acceleration margin above 0 and a deceleration margin between "
            f"0 and 1, found {up} and {down}"
        )
    return (1.0 + up) * line, (1.0 - down) * line


def governor(
    N1c_pct: ArrayLike,
    fuel_kgps: ArrayLike,
    lags_s: tuple[ArrayLike, ArrayLike, ArrayLike],
    *,
    damping: float = 0.9,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Gain (kg/s per %), reset time and lead (s) that govern N1 with the given damping ratio.

    `fuel_kgps` is the steady line of corrected fuel over `N1c_pct`. `lags_s` are the engine's slow
    and fast time constants and the sum of all other lags and delays in the loop, at sea level
    standard, each one number or a value per speed. Reset and lead cancel the first two; of the
    loop `omega / (s (1 + other s))` that is left, `omega = 1 / (4 damping^2 other)` (any text on
    control). A fast constant of 0 means no lead. A reset time that is too long only slows the
    approach; one 1.2 times too short overshoots by 3 % of the change.

    Raises `ModelError` if the line is no table or does not rise, or a lag or the damping is no
    positive number.
    """
    line = _table("steady line", N1c_pct, fuel_kgps)
    slow, fast, other = (np.broadcast_to(np.asarray(t, np.float64), line.shape) for t in lags_s)
    if not (np.all(slow > 0.0) and np.all(fast >= 0.0) and np.all(other > 0.0) and damping > 0.0):
        raise ModelError(
            "governor: expected the slow lag, the other lags and the damping above zero, and the "
            f"fast lag not below, found {lags_s} s and {damping}"
        )
    slope = np.gradient(line, np.asarray(N1c_pct, np.float64))
    if not np.all(slope > 0.0):
        worst = np.asarray(N1c_pct)[int(np.argmin(slope))]
        raise ModelError(
            f"governor: expected fuel to rise with N1, found it falling at {worst:g} % corrected N1"
        )
    return slope * slow / (4.0 * damping**2 * other), slow.copy(), fast.copy()


def steady_control(parameters: FadecParameters, sensed: Sensed, fuel_kgps: float) -> FloatArray:
    """State of a control that has demanded `fuel_kgps` for a long time.

    If `sensed` shows no error (or a topping limit just met) `control_step` keeps that demand.

    Raises `ModelError` if a table of `parameters` is not one, or the fuel is not above zero.
    """
    _check(parameters)
    if not (fuel_kgps > 0.0 and math.isfinite(fuel_kgps)):
        raise ModelError(f"FADEC: expected a fuel flow above zero to start from, found {fuel_kgps}")
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
    gain = table_value(speed, knots, parameters.governor_gain) * stretch**parameters.gain_exponent
    target = min(sensed.N1_command_pct, parameters.N1_max_pct)
    unlimited = state[_RESET] + gain * (target - ahead) / root
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
    active = N1_TOPPING if sensed.N1_command_pct > parameters.N1_max_pct else GOVERNOR
    ratio = table_value(sensed.N2_pct / root, parameters.schedule_N2c_pct, parameters.accel_ratio)
    if ratio * sensed.Ps3_Pa / delta < fuel:
        fuel, active = ratio * sensed.Ps3_Pa / delta, ACCELERATION
    readings = (sensed.N2_pct, sensed.T45_K, sensed.Ps3_Pa)
    corrections = (root, root * root, delta)
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
    least = max(parameters.fuel_min_kgps, parameters.lean_ratio * sensed.Ps3_Pa) / (delta * root)
    return (least, MINIMUM) if least > fuel else (fuel, active)


def _check(parameters: FadecParameters) -> None:
    """Refuse tables that the compiled step, which checks nothing, would misread."""
    speeds = parameters.governor_N1c_pct
    gain = _table("governor_gain", speeds, parameters.governor_gain)
    for name in ("governor_reset_s", "governor_lead_s"):
        _table(name, speeds, getattr(parameters, name))
    speeds = parameters.schedule_N2c_pct
    accel = _table("accel_ratio", speeds, parameters.accel_ratio)
    decel = _table("decel_ratio", speeds, parameters.decel_ratio)
    if not (np.all(gain > 0.0) and np.all(accel > decel)):
        raise ModelError(
            "FADEC: expected governor gains above zero and the acceleration schedule above the "
            "deceleration schedule everywhere"
        )
    for name in ("topping_limit", "topping_gain", "topping_reset_s"):
        values = getattr(parameters, name)
        if values.shape != (_TOPPINGS,) or not np.all(values > 0.0):
            raise ModelError(
                f"FADEC: expected '{name}' to be three numbers above zero (N2, T45, Ps3), "
                f"found {values}"
            )


def _table(name: str, knots: ArrayLike, values: ArrayLike) -> FloatArray:
    """`values`, if they are a finite table over ascending `knots`."""
    at, line = np.asarray(knots, np.float64), np.asarray(values, np.float64)
    if at.ndim != 1 or at.shape != line.shape or len(at) < 2 or not np.all(np.diff(at) > 0.0):
        raise ModelError(
            f"FADEC: '{name}' has to be a table over at least 2 ascending speeds, found "
            f"{line.shape} values over {at.shape} speeds",
            hint="Sort the steady line by speed",
        )
    if not (np.all(np.isfinite(at)) and np.all(np.isfinite(line))):
        raise ModelError(f"FADEC: '{name}' has to be finite")
    return line


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
    """State of a fuel system at a constant flow of `fuel_kgps`, for steps of `dt_s`.

    Raises `ConfigError` if a time is negative or not finite, or the slew not above zero.
    """
    for name in ("tau_s", "delay_s", "volume_tau_s", "servo_tau_s"):
        value = getattr(parameters, name)
        if not (value >= 0.0 and math.isfinite(value)):
            raise ConfigError(f"fuel valve: '{name}' has to be zero or more, found {value}")
    if not parameters.slew_kgps2 > 0.0:
        raise ConfigError(
            f"fuel valve: 'slew_kgps2' has to be above zero, found {parameters.slew_kgps2}",
            hint="Use infinity for no limit",
        )
    if not (dt_s > 0.0 and math.isfinite(dt_s)):
        raise ConfigError(f"fuel valve: the step has to be above zero, found {dt_s} s")
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
