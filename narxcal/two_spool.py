r"""A grey-box two-spool engine under its control, in rate form: what lies between two logs of it.

State: fan speed n1 and core speed n2 (%), the power p (in %/s of core speed) that the core has to
spare, and temperatures and flows y behind lags of their own. With the settled values s that the
inputs ask for, x the core's speed as a share of its range and L = ln(delta / sqrt(theta)),

    dn1/dt = (s1 + m (n2 - s2) + c p - n1) / tau1        the fan follows the core's gas
    dn2/dt = p                                           and the core what power it has to spare
    dp/dt  = (v - p) / tau_f                             behind the fuel valve,
    q      = soft(g (s - n) - d dn1/dt; up, down)        which the control opens and limits
    dy/dt  = (s_y + a (n2 - s2) + b p - y) / tau_y

A further lag tau of the valve acts on fuel, of which the core needs n2 / core_s more as it speeds
up: dv/dt = (q - v) / tau - (dn2/dt) / core_s; without it v = q. The governor acts on the error of
the speed it holds, n1 or n2, and is damped by the fan's rate; `soft` passes small demands and
saturates at the limits of acceleration and deceleration. All coefficients are lines in x and L, the
positive ones as logarithms. Sources: rotor equations and min-max control in Walsh & Fletcher, *Gas
Turbine Performance*, ch. 8; Jaw & Mattingly, *Aircraft Engine Controls*, ch. 5-6; state-variable
form in Sugiyama, *J. Propulsion* 10 (1994).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Where each coefficient begins in theta: a constant, a slope over x and one over L each, but for
# the last two, which are constants.
GAIN: Final = 0  # ln g
DAMP: Final = 3  # d
UP: Final = 6  # ln of the limit of acceleration, %/s
DOWN: Final = 9  # ln of the limit of deceleration, %/s
FAN: Final = 12  # ln tau1
LINE: Final = 15  # m
VALVE: Final = 18  # ln tau_f
PUSH: Final = 19  # c
SIZE: Final = 20
_STEP_S: Final = 0.0625  # integration step, at most
_WIDEST: Final = 4.0  # of any logarithm
_FASTEST_S: Final = 0.05  # shortest lag that a step resolves


@njit(cache=True, inline="always")
def _line(theta: FloatArray, at: int, x: float, air: float) -> float:
    found: float = theta[at] + theta[at + 1] * x + theta[at + 2] * air
    return found


@njit(cache=True, inline="always")
def _positive(theta: FloatArray, at: int, x: float, air: float) -> float:
    found: float = np.exp(min(max(_line(theta, at, x, air), -_WIDEST), _WIDEST))
    return found


@njit(cache=True, inline="always")
def soft(demand: float, limit: float) -> float:
    """`demand` while it is small against `limit` (positive), and no more than that in size."""
    square = (demand / limit) ** 2
    found: float = demand / np.sqrt(np.sqrt(1.0 + square * square))
    return found


@njit(cache=True)
def run(
    theta: FloatArray,
    thermal: FloatArray,
    flown: tuple[FloatArray, FloatArray, FloatArray],
    which: IntArray,
    setting: tuple[float, float, float, int],
) -> FloatArray:
    """Free runs of many rows, `(rows, time, 2 + flows)`.

    `theta` (rows, SIZE + 8) holds the coefficients and the row's `Pace`; `thermal` (flows, 7) those
    of a, b and tau_y. `flown` are the settled values (blocks, time, 2 + flows), L (blocks, time)
    and the first row (rows, 2 + flows); `which` (rows,) the block of each row. `setting` is the
    raster in s, the bottom and the range of core speed, and the speed that is governed (0 or 1).
    """
    steady, air, start = flown
    dt_s, low, span, governed = setting
    steps = max(1, int(np.ceil(dt_s / _STEP_S - 1e-9)))
    inner = (dt_s / steps, low, span, governed)
    count = steady.shape[2]
    out = np.empty((len(theta), steady.shape[1], count))
    wanted, state, kept = np.empty(count), np.empty(count + 2), np.empty(count + 2)
    for r in range(len(theta)):
        state[:count], state[count:] = start[r], 0.0  # n1, n2, flows; p and what the valve is told
        _keep(theta[r], thermal, inner[0], kept)
        out[r, 0] = start[r]
        at = steady[which[r]]
        for k in range(steady.shape[1] - 1):
            for i in range(steps):
                for c in range(count):
                    wanted[c] = at[k, c] + i / steps * (at[k + 1, c] - at[k, c])
                _advance(state, wanted, air[which[r], k], (theta[r], thermal, kept), inner)
            for c in range(count):
                out[r, k + 1, c] = state[c]
    return out


@njit(cache=True)
def _keep(theta: FloatArray, thermal: FloatArray, h: float, kept: FloatArray) -> None:
    """What each lag keeps of its state over a step: of the flows, the valve, a further lag."""
    flows = len(thermal)
    for j in range(flows):
        kept[2 + j] = np.exp(-h / max(thermal[j, 6], _FASTEST_S))
    kept[2 + flows] = np.exp(-h / max(np.exp(theta[VALVE]), _FASTEST_S))
    kept[3 + flows] = np.exp(-h / max(theta[SIZE + 6], 1e-9))


@njit(cache=True, inline="always")
def _advance(
    state: FloatArray,
    wanted: FloatArray,
    air: float,
    coefficients: tuple[FloatArray, FloatArray, FloatArray],
    setting: tuple[float, float, float, int],
) -> None:
    """One explicit step of the speeds, and an exact one of every lag for a constant input."""
    theta, thermal, kept = coefficients
    h, low, span, governed = setting
    flows = len(wanted)
    n1, n2, p = state[0], state[1], state[flows]
    thin = 1.0 if theta[SIZE + 4] == 0.0 else np.exp(air * theta[SIZE + 4])
    x = min(max((n2 - low) / span, -0.2), 1.2)
    follow = _line(theta, LINE, x, air) * (n2 - wanted[1]) + theta[PUSH] * p
    fan = (wanted[0] + follow - n1) / _positive(theta, FAN, x, air)
    fan *= thin * (theta[SIZE] if fan > 0.0 else theta[SIZE + 1])
    core = p * thin * (theta[SIZE + 2] if p > 0.0 else theta[SIZE + 3])
    error = wanted[0] - n1 if governed == 0 else wanted[1] - n2
    asked = _positive(theta, GAIN, x, air) * error - _line(theta, DAMP, x, air) * fan
    if asked > 0.0:
        limit = _positive(theta, UP, x, air) * theta[SIZE + 5]
    else:
        limit = _positive(theta, DOWN, x, air)
    asked = soft(asked, limit)
    asked -= theta[SIZE + 6] * core / theta[SIZE + 7]
    state[flows + 1] = asked + kept[flows + 1] * (state[flows + 1] - asked)
    state[flows] = state[flows + 1] + kept[flows] * (p - state[flows + 1])
    state[0] = min(max(n1 + h * fan, -50.0), 200.0)
    state[1] = min(max(n2 + h * core, -50.0), 200.0)
    for j in range(2, flows):
        own = thermal[j - 2]
        to = wanted[j] + _line(own, 0, x, air) * (n2 - wanted[1]) + _line(own, 3, x, air) * p
        state[j] = to + kept[j] * (state[j] - to)


@dataclass(frozen=True, eq=False)
class TwoSpool:
    """Coefficients of one engine: `theta` (SIZE,), `thermal` (flows, 7).

    `low` and `span` are the bottom and the range of core speed in %, `governed` the speed that the
    control holds: 0 the fan's, 1 the core's (or that which the fuel asks for).
    """

    theta: FloatArray
    thermal: FloatArray
    low: float
    span: float
    governed: int
    dt_s: float

    def free_run(
        self, flown: tuple[FloatArray, FloatArray, FloatArray], which: IntArray, pace: FloatArray
    ) -> FloatArray:
        """Runs (rows, time, 2 + flows) of `flown` and `which` (see `run`) at `pace` (rows, 8)."""
        theta = np.concatenate([np.tile(self.theta, (len(pace), 1)), pace], axis=1)
        setting = (self.dt_s, self.low, self.span, self.governed)
        return np.asarray(run(theta, self.thermal, flown, which, setting))
