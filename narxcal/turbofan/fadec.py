"""Electronic engine control: which fuel to ask for, given the speed commanded and what is sensed.

All of it works in corrected quantities, with `theta`, `delta` the total temperature and pressure
at the engine's face over their sea-level standards: speeds over `sqrt(theta)`, temperature over
`theta`, pressure over `delta`, fuel over `delta sqrt(theta)`, `Wf/Ps3` over `sqrt(theta)`. A gas
turbine's dynamics are alike in them if time is stretched by `sqrt(theta) / delta` (NACA TR-1011,
FACTS A2), and so is the control's, whose reset times are stretched as well.

Governor and topping loops are each proportional plus reset:

    demand = gain error + reset,    tau d(reset)/dt = (fuel demanded by the loop that rules) - reset

The loop that rules therefore has an integrator of rate `gain / tau`; all others follow the fuel
that is really demanded, and cannot wind up (external reset, Shinskey, *Process Control Systems*).
With `tau` the engine's slow time constant a governor's `reset` is the fuel that holds the present
speed, so after a slam it takes over in its proportional band and approaches without overshoot.
Its error is taken `lead` ahead, along the sensed speed's rate, which makes up for the fast spool.
Ceilings (acceleration schedule, toppings) are applied before floors (deceleration schedule, lean
blow-out, least fuel); each hand-over is a minimum or maximum of continuous signals, hence bumpless.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from narxcal.atmosphere import P0_PA, T0_K
from narxcal.support.arrays import FloatArray
from narxcal.support.compiled import compiled, lagged, table_value
from narxcal.support.errors import ModelError

# What rules the fuel, as `step` reports it.
GOVERNOR, ACCELERATION, DECELERATION, N1_TOPPING, N2_TOPPING, T45_TOPPING, PS3_TOPPING, MINIMUM = (
    range(8)
)
LIMITERS = ("governor", "acceleration", "deceleration", "N1", "N2", "T45", "Ps3", "minimum")
_TOPPINGS = 3  # N2, T45, Ps3, in this order
# Where the state keeps what: the governor's reset, those of the toppings, and N1 a step ago.
_RESET, _TOPPING_RESETS, _PAST_N1, SIZE = 0, 1, 4, 5


class FadecParameters(NamedTuple):
    """Tables and limits; all gains and times hold at sea level standard.

    `governor_gain` in kg/s per %, `governor_reset_s` and `governor_lead_s` over sensed corrected
    `governor_N1c_pct`: see `governor`. `gain_exponent` raises the gain by that power of
    `sqrt(theta) / delta`: 0 leaves the response alike in corrected time, 1 keeps its speed in real
    time.
    `accel_ratio`, `decel_ratio` in kg/(s Pa) over `schedule_N2c_pct`: see `schedules`, where the
    effects `accel_limit` and `accel_decel_asymmetry` are margins.
    `topping_limit`, `topping_gain`, `topping_reset_s` (3,): physical limits of N2 (%), T45 (K) and
    Ps3 (Pa), infinite for none, with gains in kg/s per corrected unit. A reset time of the slow
    spool's constant (for T45, of its probe's) holds a limit without overshoot. `N1_max_pct` is the
    most that the governor will follow.
    The fuel is never below `fuel_min_kgps`, nor `lean_ratio` (kg/(s Pa)) times Ps3.
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
    """What the control is told at one step: the command, and the sensors' readings."""

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
    control). A fast constant of 0 means no lead. Rather take the engine for too slow than for too
    quick: a reset far too long only creeps, one 1.2 times too short overshoots by 3 % of the move.

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


def settled(parameters: FadecParameters, sensed: Sensed, fuel_kgps: float) -> FloatArray:
    """State of a control that has long been asking for `fuel_kgps`.

    If `sensed` shows no error (or a topping limit just met) `step` goes on asking for it.

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
def step(
    parameters: FadecParameters, state: FloatArray, sensed: Sensed, dt_s: float
) -> tuple[float, int]:
    """Fuel to ask for during the next `dt_s`, kg/s, and which limiter ruled it.

    `state` comes from `settled` and is advanced by `dt_s`, exactly, as the demand is constant
    meanwhile.
    """
    delta, root = sensed.P2_Pa / P0_PA, math.sqrt(sensed.T2_K / T0_K)
    scale, stretch = delta * root, root / delta
    speed, knots = sensed.N1_pct / root, parameters.governor_N1c_pct
    lead_s = table_value(speed, knots, parameters.governor_lead_s) * stretch
    ahead = sensed.N1_pct + lead_s * (sensed.N1_pct - state[_PAST_N1]) / dt_s
    gain = table_value(speed, knots, parameters.governor_gain) * stretch**parameters.gain_exponent
    target = min(sensed.N1_command_pct, parameters.N1_max_pct)
    wanted = state[_RESET] + gain * (target - ahead) / root
    fuel, active = _under_ceilings(parameters, state, sensed, (wanted, delta, root))
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
    """Least of the corrected `demand` (fuel, delta, root) and what the ceilings allow."""
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
    """Greatest of the corrected `demand` (fuel, delta, root) and what keeps the flame alight."""
    fuel, delta, root = demand
    ratio = table_value(sensed.N2_pct / root, parameters.schedule_N2c_pct, parameters.decel_ratio)
    if ratio * sensed.Ps3_Pa / delta > fuel:
        fuel, active = ratio * sensed.Ps3_Pa / delta, DECELERATION
    least = max(parameters.fuel_min_kgps, parameters.lean_ratio * sensed.Ps3_Pa) / (delta * root)
    return (least, MINIMUM) if least > fuel else (fuel, active)


def _check(parameters: FadecParameters) -> None:
    """Refuse parameters that the compiled step, which checks nothing, would read wrongly."""
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
