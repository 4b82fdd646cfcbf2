r"""A grey-box two-spool engine under its control, in rate form: what lies between two logs of it.

State: fan speed n1 and core speed n2 (%), the power p (in %/s of core speed) that the core has to
spare, the governor's reset r, and temperatures and flows y behind lags of their own. With the
settled values s that the inputs ask for, x the core's speed and z the settled one as shares of its
range R, and L = ln(delta / sqrt(theta)),

    w      = s1 + F(n2) - F(s2) + c p - n1        what the core's gas would make of the fan
    dn1/dt = w exp(k w / R) / tau1                which follows it, faster from far below
    dn2/dt = p - m                                the core what power it has to spare
    dp/dt  = (v - p) / tau_f,                     behind the fuel valve,
    q      = g exp(l (z - x)) (s - n + r) - d dn1/dt + u,    d >= 0
    v      = soft(q; up, down)                    which the control opens and limits
    dr/dt  = reset^2 (s - n) / (1 + (q / limit)^4)
    du/dt  = (p0 - dn2/dt - u) / 3 s, where the reset holds fuel; else u = 0
    dy/dt  = (s_y + Y(n2) - Y(s2) + b p - y) / tau_y
    m      = loss exp(L) (1 + x) / 2 (T_blades - T_metal)
    up     = U(x, L, fan) - load exp(L) (1 + x) / 2,    down likewise and more

F and Y are cubics in the core's speed, for engines settle on curves: between idle and full power
chords count, not slopes. The governor acts on the error of the speed it holds, n1 or n2, is damped
by the fan's rate, and its reset waits while a limit holds. A turbine's torque goes with the square
of speeds, which makes the k and the l. Limits of acceleration and deceleration are parabolas in x
and go with the fan's lag behind its settled match: the pressure to which a control schedules fuel
is that of both spools. A further lag tau of the valve acts on fuel, of which the core needs n2 /
core_s more as it speeds up: dv/dt = (soft - v) / tau - (dn2/dt) / core_s. Metal that trails the gas
takes heat from it and keeps clearances open: T_blades and T_metal are one temperature of y behind a
lag each, and what the core lacks goes with power and with the density of the air; the fan follows
p - m. A bleed or a load is held against by more fuel, which the settled values have; but a schedule
of fuel leaves as much less to accelerate with, and more to decelerate. A control that holds the
core's acceleration itself makes up for rotors that answer differently, for heat and for loads: v
is then so many times the fuel as they are slower, and m more. A reset that holds fuel, and follows
the demand about as slowly as the rotors, is the fuel that holds the present speed: it shows nothing
as long as the core makes of p0, the power demanded behind the valve, what it makes of it in the
simulator. With slower rotors, or a valve that lags, fuel runs ahead of them by u, and the
engine overshoots. Other coefficients are lines in x and L, the positive ones as logarithms.
Sources: rotor equations and min-max control in Walsh & Fletcher, *Gas Turbine Performance*, ch. 8;
Jaw & Mattingly, *Aircraft Engine Controls*, ch. 5-6; external reset in Shinskey, *Process Control
Systems*, ch. 6; state-variable form in Sugiyama, *J. Propulsion* 10 (1994).
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Final

import numpy as np

from narxcal.support.arrays import FloatArray, IntArray
from narxcal.support.compiled import compiled

# Where each coefficient begins in theta: a constant, a slope over x and one over L each, then what
# is said; the last three are constants.
GAIN: Final = 0  # ln g; and l
DAMP: Final = 4  # d
UP: Final = 7  # ln of the limit of acceleration, %/s; and a slope over x^2, one over the fan's lag
DOWN: Final = 12  # ln of the limit of deceleration, %/s; likewise
FAN: Final = 17  # ln tau1; and k
LINE: Final = 21  # dF/dn2; and a slope over x^2
VALVE: Final = 25  # ln tau_f
PUSH: Final = 26  # c
RESET: Final = 27  # root of the rate of the reset, 1/s
SIZE: Final = 28
FLOW: Final = 9  # dY/dn2: a constant, slopes over x, x^2 and L; b: likewise; tau_y
HOLDS_RATE: Final = 2  # added to the speed that is governed
HOLDS_FUEL: Final = 4  # likewise
_RESET_S: Final = 3.0  # of a reset that holds fuel: about the slow time constant of rotors
_STEP_S: Final = 0.0625  # integration step, at most
_WIDEST: Final = 4.0  # of any logarithm
_FASTEST_S: Final = 0.05  # shortest lag that a step resolves
_SPARED: Final = 0.05  # of a limit: what any load leaves of it


@compiled(inline=True)
def _line(theta: FloatArray, at: int, x: float, air: float) -> float:
    found: float = theta[at] + theta[at + 1] * x + theta[at + 2] * air
    return found


@compiled(inline=True)
def _positive(logarithm: float) -> float:
    found: float = np.exp(min(max(logarithm, -_WIDEST), _WIDEST))
    return found


@compiled(inline=True)
def _chord(flat: float, slope: float, bend: float, x: float, z: float) -> float:
    """Mean of `flat + slope x + bend x^2` between x and z."""
    return flat + 0.5 * slope * (x + z) + bend / 3.0 * (x * x + x * z + z * z)


@compiled(inline=True)
def soft(demand: float, limit: float) -> float:
    """`demand` while it is small against `limit` (positive), and no more than that in size."""
    square = (demand / limit) ** 2
    found: float = demand / np.sqrt(np.sqrt(1.0 + square * square))
    return found


Flown = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
Setting = tuple[float, float, float, int, int]


def run(
    theta: FloatArray, thermal: FloatArray, flown: Flown, which: IntArray, setting: Setting
) -> FloatArray:
    """Free runs of many rows, `(rows, time, 2 + flows)`.

    `theta` (rows, SIZE + 13) holds the coefficients and the row's `Pace`; `thermal` (flows, FLOW)
    those of Y, b and tau_y. `flown` are the settled values (blocks, time, 2 + flows), L and the
    load in %/s (blocks, time) and the first row (rows, 2 + flows); `which` (rows,) the block of
    each row. `setting` is the raster in s, the bottom and the range of core speed, the speed that
    is governed, and the column of the temperature that metal follows. Every thread has some rows.
    """
    steady, air, load, start = flown
    cuts = np.array_split(np.arange(len(theta)), min(len(theta), os.cpu_count() or 1))
    parts = [slice(rows[0], rows[-1] + 1) for rows in cuts]

    def part(rows: slice) -> FloatArray:
        return _run(theta[rows], thermal, (steady, air, load, start[rows]), which[rows], setting)

    with ThreadPoolExecutor(len(parts)) as pool:  # compiled runs release Python's lock
        return np.concatenate(list(pool.map(part, parts)))


@compiled
def _run(
    theta: FloatArray, thermal: FloatArray, flown: Flown, which: IntArray, setting: Setting
) -> FloatArray:
    steady, air, load, start = flown
    dt_s, low, span, governed, hot = setting
    steps = max(1, int(np.ceil(dt_s / _STEP_S - 1e-9)))
    inner = (dt_s / steps, low, span, governed, hot)
    count = steady.shape[2]
    out = np.empty((len(theta), steady.shape[1], count))
    wanted, state, kept = np.empty(count), np.empty(count + 7), np.empty(count + 4)
    for r in range(len(theta)):
        # n1, n2, flows; p, v, r; blades, metal; p0, u
        state[:count], state[count:] = start[r], 0.0
        state[count + 3 : count + 5] = start[r, hot]
        _keep(theta[r], thermal, inner[0], kept)
        out[r, 0] = start[r]
        at = steady[which[r]]
        for k in range(steady.shape[1] - 1):
            day = air[which[r], k], np.exp(air[which[r], k]), load[which[r], k]
            for i in range(steps):
                for c in range(count):
                    wanted[c] = at[k, c] + i / steps * (at[k + 1, c] - at[k, c])
                _advance(state, wanted, day, (theta[r], thermal, kept), inner)
            for c in range(count):
                out[r, k + 1, c] = state[c]
    return out


@compiled
def _keep(theta: FloatArray, thermal: FloatArray, h: float, kept: FloatArray) -> None:
    """What each lag keeps of its state over a step: flows, valve, a further lag, blades, metal."""
    flows = len(thermal)
    for j in range(flows):
        kept[2 + j] = np.exp(-h / max(thermal[j, FLOW - 1], _FASTEST_S))
    kept[2 + flows] = np.exp(-h / max(np.exp(theta[VALVE]), _FASTEST_S))
    kept[3 + flows] = np.exp(-h / max(theta[SIZE + 6], 1e-9))
    kept[4 + flows] = np.exp(-h / max(theta[SIZE + 11], 1e-9))
    kept[5 + flows] = np.exp(-h / max(theta[SIZE + 10], 1e-9))


@compiled(inline=True)
def _advance(
    state: FloatArray,
    wanted: FloatArray,
    day: tuple[float, float, float],
    coefficients: tuple[FloatArray, FloatArray, FloatArray],
    setting: tuple[float, float, float, int, int],
) -> None:
    """One explicit step of the speeds, and an exact one of every lag for a constant input."""
    (theta, thermal, kept), (air, density, load) = coefficients, day
    h, low, span, governed, hot = setting
    flows, holds_rate = len(wanted), governed // 2 == 1
    n1, n2, p = state[0], state[1], state[flows]
    thin = 1.0 if theta[SIZE + 4] == 0.0 else np.exp(air * theta[SIZE + 4])
    x = min(max((n2 - low) / span, -0.2), 1.2)
    z = min(max((wanted[1] - low) / span, -0.2), 1.2)
    match = _chord(theta[LINE] + theta[LINE + 2] * air, theta[LINE + 1], theta[LINE + 3], x, z)
    behind = (wanted[0] + match * (n2 - wanted[1]) - n1) / span
    power = density * 0.5 * (1.0 + x)
    taken = theta[SIZE + 9] * power * (state[flows + 3] - state[flows + 4])
    spare = p - taken
    way = behind + theta[PUSH] * spare / span
    fan = way * span / _positive(_line(theta, FAN, x, air) - theta[FAN + 3] * way)
    fan *= thin * (theta[SIZE] if fan > 0.0 else theta[SIZE + 1])
    core = spare * thin * (theta[SIZE + 2] if spare > 0.0 else theta[SIZE + 3])
    error = wanted[0] - n1 if governed % 2 == 0 else wanted[1] - n2
    gain = _positive(_line(theta, GAIN, x, air) + theta[GAIN + 3] * (z - x))
    demand = gain * (error + state[flows + 2]) - max(_line(theta, DAMP, x, air), 0.0) * fan
    demand += state[flows + 6]
    limit = _limit(theta, UP if demand > 0.0 else DOWN, (x, air, behind))
    limit *= theta[SIZE + 5 if demand > 0.0 else SIZE + 8]
    if demand > 0.0:
        limit = min(limit, theta[SIZE + 12])
    if not holds_rate:
        limit = max(limit - (load if demand > 0.0 else -load) * power, _SPARED * limit)
    state[flows + 2] += h * theta[RESET] ** 2 * error / (1.0 + (demand / limit) ** 4)
    demand = soft(demand, limit)
    if holds_rate:
        demand = demand / (thin * (theta[SIZE + 2] if demand > 0.0 else theta[SIZE + 3])) + taken
    if governed >= HOLDS_FUEL:
        state[flows + 6] += h / _RESET_S * (state[flows + 5] - core - state[flows + 6])
        state[flows + 5] = demand + kept[flows] * (state[flows + 5] - demand)
    demand -= theta[SIZE + 6] * core / theta[SIZE + 7]
    state[flows + 1] = demand + kept[flows + 1] * (state[flows + 1] - demand)
    state[flows] = state[flows + 1] + kept[flows] * (p - state[flows + 1])
    state[0] = min(max(n1 + h * fan, -50.0), 200.0)
    state[1] = min(max(n2 + h * core, -50.0), 200.0)
    for j in range(2, flows):
        own = thermal[j - 2]
        to = wanted[j] + _chord(own[0] + own[3] * air, own[1], own[2], x, z) * (n2 - wanted[1])
        to += (own[4] + own[5] * x + own[6] * x * x + own[7] * air) * p
        state[j] = to + kept[j] * (state[j] - to)
    for j in range(flows + 3, flows + 5):
        state[j] = state[hot] + kept[j - 1] * (state[j] - state[hot])


@compiled(inline=True)
def _limit(theta: FloatArray, at: int, place: tuple[float, float, float]) -> float:
    """A limit, positive, in %/s, at x, L and what the fan is behind its match, over R."""
    x, air, behind = place
    return _positive(_line(theta, at, x, air) + theta[at + 3] * x * x + theta[at + 4] * behind)


@dataclass(frozen=True, eq=False)
class TwoSpool:
    """Coefficients of one engine: `theta` (SIZE,), `thermal` (flows, FLOW).

    `low` and `span` are the bottom and the range of core speed in %, `governed` the speed that the
    control holds: 0 the fan's, 1 the core's (or that which the fuel asks for); 2 more if it holds
    the core's acceleration on the way there, 4 more if its reset holds fuel.
    """

    theta: FloatArray
    thermal: FloatArray
    low: float
    span: float
    governed: int
    dt_s: float

    def free_run(
        self,
        flown: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
        which: IntArray,
        pace: FloatArray,
        hot: int = -1,
    ) -> FloatArray:
        """Runs (rows, time, 2 + flows) of `flown` and `which` (see `run`) at `pace` (rows, 13).

        Metal follows the temperature in column `hot`.
        """
        theta = np.concatenate([np.tile(self.theta, (len(pace), 1)), pace], axis=1)
        columns = flown[0].shape[-1]
        setting = (self.dt_s, self.low, self.span, self.governed, hot % columns)
        return np.asarray(run(theta, self.thermal, flown, which, setting))
