"""The lags of `narxcal.lag` step by step, compiled, with the equations that they follow.

With the deviation d = ss - y, the time constant tau and the increment D of ss over a step dt

    fast(k) = a fast(k-1) + (1 - a) ((tau - lead) D / dt + c d_core(k) + e Dy_core(k) / dt)
    slow(k) = b (slow(k-1) + share D)
    d(k)    = fast(k) + slow(k),         a = exp(-dt / tau),      b = exp(-dt / tau_s)
    tau     = tau0 sqrt(1 + ((w - v) / (tau0 r))^2)
    log tau0 = p . [1, air, v, w, v^2, v w, w^2],              air = log(sqrt(theta2) / delta2)
    log r   = q . [1, air, v, v^2]       one q to speed up, another to slow down
    c       = core (1 + core_speed v),   e = rate exp(rate_air air + rate_speed v)

where v and w are the spool's corrected speed as it is and as it would settle, scaled to [-1, 1]
over what training has seen. `lead` is the lag of the meter that ss is computed from, c how far an
output follows the core spool, whose d is known first; the slow part is the heat soak. However far
v is from w, it does not move faster than r: a control's schedules of acceleration and deceleration
say so. A temperature answers to the core's acceleration by e, for that takes fuel. Without `limits`
(q of `UNLIMITED`, core_speed and rate of zero) the equations are those of lags alone.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from narxcal.kernels import compiled

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
LAG_PARAMETERS = (
    "log_tau", "air", "speed", "target", "speed_speed", "speed_target", "target_target",
    "lead_s", "core", "slow_share", "log_slow_tau",
)  # fmt: skip
LIMIT_PARAMETERS = (
    "log_up", "up_air", "up_speed", "up_speed_speed",
    "log_down", "down_air", "down_speed", "down_speed_speed",
)  # fmt: skip
FUEL_PARAMETERS = ("core_speed", "rate", "rate_air", "rate_speed")
PARAMETERS = (*LAG_PARAMETERS, *LIMIT_PARAMETERS, *FUEL_PARAMETERS)
UNLIMITED = 20.0  # `log_up` and `log_down` of a spool as fast as its time constant lets it be
_UP, _DOWN, _FUEL = (PARAMETERS.index(name) for name in ("log_up", "log_down", "core_speed"))


@compiled
def time_constant(p: FloatArray, air: float, v: float, w: float, limited: bool) -> float:
    """Seconds; the longer the more of a step a `limited` spool still has before it."""
    log_tau = p[0] + p[1] * air + p[2] * v + p[3] * w
    log_tau += p[4] * v * v + p[5] * v * w + p[6] * w * w
    tau = math.exp(min(max(log_tau, -2.5), 3.0))
    if limited:
        q = _UP if w > v else _DOWN
        log_most = p[q] + p[q + 1] * air + p[q + 2] * v + p[q + 3] * v * v
        ratio = (w - v) / (tau * math.exp(min(max(log_most, -5.0), UNLIMITED)))
        tau *= math.sqrt(1.0 + ratio * ratio)
    return tau


@compiled
def drawn_by_core(p: FloatArray, core: float, rate: float, air: float, v: float) -> float:
    """What the core's deviation `core` and its speed's `rate` per second draw an output to."""
    strength = math.exp(min(max(p[_FUEL + 2] * air + p[_FUEL + 3] * v, -3.0), 3.0))
    drawn: float = p[8] * core * (1.0 + p[_FUEL] * v) + p[_FUEL + 1] * strength * rate
    return drawn


@compiled
def run_lags(
    drive: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    lags: tuple[FloatArray, FloatArray],
    starts: tuple[IntArray, FloatArray],
    measured: FloatArray,
    dt_s: float,
) -> tuple[FloatArray, FloatArray]:
    """Fast and slow part (T, o) of the deviation; see the module for the equations.

    `drive` are the columns of `Drive` with the core spool first (see `LagModel.run`); where an
    output is no speed, its columns but ss hold the core's, and `per_unit` is negative. `lags` are
    `parameters` and `limit` of the model, sorted alike; their sum is kept within +-`limit`.
    `starts` are (positions (n,), parts (n, 2, o)): rows at which a window begins, and fast and
    slow part there. `measured` (T, o), if it has rows, replaces the deviation before each step
    where it is finite (one-step prediction).
    """
    ss, target, per_unit, air = drive
    parameters, limit = lags
    positions, parts = starts
    steps, outputs = ss.shape
    fast = np.zeros((steps, outputs))
    slow = np.zeros((steps, outputs))
    before = np.zeros(outputs)
    window = 0
    for k in range(steps):
        if window < len(positions) and positions[window] == k:
            fast[k] = parts[window, 0]
            slow[k] = parts[window, 1]
            window += 1
            continue
        for o in range(outputs):
            before[o] = fast[k - 1, o]
            if len(measured) > 0 and math.isfinite(measured[k - 1, o]):
                before[o] = measured[k - 1, o] - slow[k - 1, o]
        core_before = ss[k - 1, 0] - before[0] - slow[k - 1, 0]
        for o in range(outputs):
            p = parameters[o]
            w = min(max(target[k, o], -1.5), 1.5)
            mine = before[o] if per_unit[k, o] > 0.0 else before[0]
            v = target[k - 1, o] - mine * abs(per_unit[k, o])
            v = min(max(v, -1.5), 1.5)
            tau = time_constant(p, air[k], v, w, per_unit[k, o] > 0.0)
            a = math.exp(-dt_s / tau)
            step = ss[k, o] - ss[k - 1, o]
            drawn = (tau - p[7]) * step / dt_s
            if o > 0:
                core = fast[k, 0] + slow[k, 0]
                rate = (ss[k, 0] - core - core_before) / dt_s
                drawn += drawn_by_core(p, core, rate, air[k], v)
            b = math.exp(-dt_s / math.exp(min(max(p[10], 0.0), 4.0)))
            soak = b * (slow[k - 1, o] + p[9] * step)
            followed = a * before[o] + (1.0 - a) * drawn
            fast[k, o] = min(max(followed, -limit[o] - soak), limit[o] - soak)
            slow[k, o] = soak
    return fast, slow
