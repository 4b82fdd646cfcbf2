"""State-dependent lags: how each output follows its steady-state value, in physical parameters.

A spool is a first-order lag whose time constant depends on its speed and on the air (NACA
TR-1011: coefficients are corrected for altitude like steady-state data; FACTS A2), behind a control
that limits how fast it may move. This is a state-dependent parameter model (Young, McKenna and
Bruun 2001, Int. J. Control 74); `narxcal.lumped.lag` has its equations. The deviation that it gives
decays wherever the inputs stand still, so the steady state is an exact equilibrium.

The lags of `narxcal.lumped.lag` step by step, compiled, with the equations that they follow.

With the deviation d = ss - y, the time constant tau and the increment D of ss over a step dt

    fast(k)   = a fast(k-1) + (1 - a) ((tau - lead) D / dt + c d_core(k) + e Dy_core(k) / dt)
    soak(k)   = b (soak(k-1) + share D),      casing(k) likewise, with its own share and time
    d(k)      = fast(k) + soak(k) + casing(k),       a = exp(-dt / tau),      b = exp(-dt / tau_s)
    tau       = tau0 sqrt(1 + ((w - v) / (tau0 r))^2)
    log tau0  = p . [1, thin, v, w, v^2, v w, w^2, hot]
    log r     = q . [1, thin, v, v^2, u, v u, u^2, hot]    one q to speed up, another to slow down
    thin      = log(sqrt(theta2) / delta2),      hot = log(sqrt(theta2))
    c         = core + core_speed (v_core + w_core)
    e         = rate exp(rate_air thin + rate_speed v_core)

where v and w are the spool's corrected speed as it is and as it would settle, scaled to [-1, 1]
over what training has seen, and u is the v of the other spool. `lead` is the lag of the meter that
ss is computed from, c how far an output follows the core spool, whose d is known first: what it is
at w_core less what it is at v_core, if a parabola says so. Soak and casing are the metal's heat,
which blades take up in seconds and casings in minutes. However far v is from w, it does not move
faster than r: a control's schedules of acceleration and deceleration say so. They hold the ratio of
fuel to the pressure behind the compressor, and that pressure goes by both spools: behind a fan that
is still slow the core accelerates less than in step with it. A temperature answers to the core's
acceleration by e, for that takes fuel. Without `limits` (q of `UNLIMITED`; core_speed, rate and
share of the casing zero) the equations are those of lags alone.

With `heat` the metal's heat drives the spool instead of showing at once, and it counts the more the
less fuel there is beside it, in a time that goes by the flow over the metal:

    soak(k)   = b (s(k) / s(k-1) soak(k-1) + s(k) share D),      s = exp(heat_speed w)
    fast      is also drawn to   -heat tau (soak(k) - soak(k-1)) / dt
    log tau_s = p_s - heat_rate w + heat_air thin
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from narxcal.atmosphere import air_state
from narxcal.narx.network import AT_START
from narxcal.support.arrays import FloatArray, IntArray
from narxcal.support.compiled import compiled
from narxcal.support.errors import ModelError

STATES = ("fast", "soak", "casing")
FAST, SOAK, CASING = range(3)
LAG_PARAMETERS = (
    "log_tau", "air", "speed", "target", "speed_speed", "speed_target", "target_target",
    "lead_s", "core", "slow_share", "log_slow_tau",
)  # fmt: skip
LIMIT_PARAMETERS = (
    "log_up", "up_air", "up_speed", "up_speed_speed",
    "up_other", "up_speed_other", "up_other_other", "up_hot",
    "log_down", "down_air", "down_speed", "down_speed_speed",
    "down_other", "down_speed_other", "down_other_other", "down_hot",
)  # fmt: skip
FUEL_PARAMETERS = ("core_speed", "rate", "rate_air", "rate_speed")
CASING_PARAMETERS = ("casing_share", "log_casing_tau")
HEAT_PARAMETERS = ("heat", "heat_speed", "heat_rate", "heat_air")
PARAMETERS = (
    *LAG_PARAMETERS, *LIMIT_PARAMETERS, *FUEL_PARAMETERS, *CASING_PARAMETERS, "hot",
    *HEAT_PARAMETERS,
)  # fmt: skip
UNLIMITED = 20.0  # `log_up` and `log_down` of a spool as fast as its time constant lets it be
_UP, _DOWN, _FUEL, _CASING, _HOT, _HEAT = (
    PARAMETERS.index(name)
    for name in ("log_up", "log_down", "core_speed", "casing_share", "hot", "heat")
)


@compiled
def within(value: float, most: float) -> float:
    """`value`, but no further from zero than `most`."""
    return min(max(value, -most), most)


@compiled
def time_constant(
    p: FloatArray, air: tuple[float, float], speeds: tuple[float, float, float], limited: bool
) -> float:
    """Seconds; the longer the more of a step a `limited` spool still has before it.

    `air` are thin and hot of the module, `speeds` v, w and u.
    """
    thin, hot = air
    v, w, u = speeds
    log_tau = p[0] + p[1] * thin + p[2] * v + p[3] * w + p[_HOT] * hot
    log_tau += p[4] * v * v + p[5] * v * w + p[6] * w * w
    tau = math.exp(min(max(log_tau, -2.5), 3.0))
    if limited:
        q = _UP if w > v else _DOWN
        log_most = p[q] + p[q + 1] * thin + p[q + 2] * v + p[q + 3] * v * v + p[q + 7] * hot
        log_most += p[q + 4] * u + p[q + 5] * v * u + p[q + 6] * u * u
        ratio = (w - v) / (tau * math.exp(min(max(log_most, -5.0), UNLIMITED)))
        tau *= math.sqrt(1.0 + ratio * ratio)
    return tau


@compiled
def drawn_by_core(
    p: FloatArray, core: float, rate: float, thin: float, speeds: tuple[float, float]
) -> float:
    """What the core's deviation `core` and its speed's `rate` per second draw an output to.

    `speeds` are the core's v and w.
    """
    v, w = speeds
    drawn: float = (p[8] + p[_FUEL] * (v + w)) * core
    if p[_FUEL + 1] != 0.0:
        strength = math.exp(within(p[_FUEL + 2] * thin + p[_FUEL + 3] * v, 3.0))
        drawn += p[_FUEL + 1] * strength * rate
    return drawn


@compiled
def decays(parameters: FloatArray, dt_s: float) -> FloatArray:
    """What a step leaves of soak and casing, (2, o)."""
    left = np.empty((2, len(parameters)))
    for o in range(len(parameters)):
        soak = min(max(parameters[o, 10], 0.0), 4.0)
        casing = min(max(parameters[o, _CASING + 1], 2.0), 5.0)
        left[0, o] = math.exp(-dt_s / math.exp(soak))
        left[1, o] = math.exp(-dt_s / math.exp(casing))
    return left


@compiled
def heated(
    p: FloatArray, soak: float, step: float, where: tuple[float, float, float], dt_s: float
) -> float:
    """Soak after a `step` of ss, from `soak` before it; `where` are w before, w and thin."""
    before, w, thin = where
    log_tau = p[10] - p[_HEAT + 2] * w + p[_HEAT + 3] * thin
    left = math.exp(-dt_s / math.exp(min(max(log_tau, 0.0), 4.0)))
    kept, taken = math.exp(p[_HEAT + 1] * (w - before)), math.exp(p[_HEAT + 1] * w)
    after: float = left * (kept * soak + taken * p[9] * step)
    return after


@compiled
def fan_of(per_unit: FloatArray) -> int:
    """Column of the first spool beside the core; 0 where there is none."""
    for o in range(1, per_unit.shape[1]):
        if per_unit[len(per_unit) - 1, o] > 0.0:
            return o
    return 0


@compiled
def _begin(
    k: int,
    past: FloatArray,
    measured: FloatArray,
    settled: tuple[FloatArray, FloatArray],
    found: tuple[FloatArray, FloatArray],
) -> None:
    """Fill `found` with the fast deviations (o,) before row `k`, and the scaled speeds (o,) there.

    `past` (3, o) are the states then and `settled` the columns `target` and `per_unit` (T, o);
    `measured` is as of `run_lags`.
    """
    target, per_unit = settled
    before, v = found
    for o in range(len(v)):
        before[o] = past[0, o]
        if len(measured) > 0 and math.isfinite(measured[k - 1, o]):
            before[o] = measured[k - 1, o] - past[1, o] - past[2, o]
        mine = before[o] if per_unit[k, o] > 0.0 else before[0]
        v[o] = within(target[k - 1, o] - mine * abs(per_unit[k, o]), 1.5)


@compiled
def _metal(
    p: FloatArray,
    states: tuple[FloatArray, FloatArray],
    step: float,
    at: tuple[FloatArray, tuple[float, float, float]],
    dt_s: float,
) -> None:
    """Soak and casing of one output after a `step` of ss; `states` (3,) are those before and now.

    `at` are what a step leaves of both, see `decays`, and w before, w and thin, see `heated`.
    """
    past, state = states
    left, where = at
    state[1] = left[0] * (past[1] + p[9] * step)
    if p[_HEAT] != 0.0:
        state[1] = heated(p, past[1], step, where, dt_s)
    state[2] = left[1] * (past[2] + p[_CASING] * step)


@compiled
def run_lags(
    drive: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    lags: tuple[FloatArray, FloatArray],
    starts: tuple[IntArray, FloatArray],
    measured: FloatArray,
    dt_s: float,
) -> FloatArray:
    """States (T, 3, o), see `STATES`, whose sum is the deviation; the module has the equations.

    `drive` are the columns of `Drive` with the core spool first (see `LagModel.run`); where an
    output is no speed, its columns but ss hold the core's, and `per_unit` is negative. `lags` are
    `parameters` and `limit` of the model, sorted alike; the sum is kept within +-`limit`.
    `starts` are (positions (n,), states (n, 3, o)): rows at which a window begins, and the states
    there. `measured` (T, o), if it has rows, replaces the deviation before each step where it is
    finite (one-step prediction).
    """
    ss, target, per_unit, air = drive
    parameters, limit = lags
    states = np.zeros((len(ss), 3, ss.shape[1]))
    before, v = np.zeros(ss.shape[1]), np.zeros(ss.shape[1])
    left, fan, window = decays(parameters, dt_s), fan_of(per_unit), 0
    for k in range(len(ss)):
        if window < len(starts[0]) and starts[0][window] == k:
            states[k] = starts[1][window]
            window += 1
            continue
        past, state = states[k - 1], states[k]
        _begin(k, past, measured, (target, per_unit), (before, v))
        core, rate = 0.0, 0.0
        for o in range(len(v)):
            p, step = parameters[o], ss[k, o] - ss[k - 1, o]
            w, other = within(target[k, o], 1.5), v[fan] if o == 0 else v[0]
            here = (air[k, 0], air[k, 1])
            tau = time_constant(p, here, (v[o], w, other), per_unit[k, o] > 0.0)
            drawn = (tau - p[7]) * step / dt_s
            if o > 0:
                speeds = (v[0], within(target[k, 0], 1.5))
                drawn += drawn_by_core(p, core, rate, air[k, 0], speeds)
            a = math.exp(-dt_s / tau)
            where = (within(target[k - 1, o], 1.5), w, air[k, 0])
            _metal(p, (past[:, o], state[:, o]), step, (left[:, o], where), dt_s)
            if p[_HEAT] != 0.0:
                drawn -= p[_HEAT] * tau * (state[1, o] - past[1, o]) / dt_s
            slow = state[1, o] + state[2, o]
            state[0, o] = within(a * before[o] + (1.0 - a) * drawn + slow, limit[o]) - slow
            if o == 0:
                core = state[0, 0] + slow
                rate = (step - core + before[0] + past[1, 0] + past[2, 0]) / dt_s
    return states


_ARRAYS = ("parameters", "centre", "half", "limit")
_COLD = list(PARAMETERS[: -len(HEAT_PARAMETERS)])  # of folders from before there was `heat`


class Drive(NamedTuple):
    """What the lags follow, row by row; row 0 is the sample before the first step.

    `ss` (T, o) are the steady-state values, `target` (T, o) the same, corrected and scaled to
    [-1, 1], `per_unit` (T, o) the scaled speed per unit of the output, `air` (T, 2) the logarithms
    of sqrt(theta2) / delta2 and of sqrt(theta2).
    """

    ss: FloatArray
    target: FloatArray
    per_unit: FloatArray
    air: FloatArray

    def rows(self, part: slice | IntArray) -> Drive:
        """Some of the rows."""
        return Drive(*(np.ascontiguousarray(column[part]) for column in self))

    def after(self, before: Drive) -> Drive:
        """These rows behind those of `before`."""
        pairs = zip(before, self, strict=True)
        return Drive(*(np.concatenate(pair) for pair in pairs))


class Wiring(NamedTuple):
    """What goes by which speed.

    `order` (o,) are the columns with the core spool first. Column k goes by speed `own[k]`, and
    `sign[k]` is -1 where it is no speed itself.
    """

    order: IntArray
    own: IntArray
    sign: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class LagModel:
    """The lags of all outputs.

    `parameters` (n_out, 38) are named by `PARAMETERS`. `centre` and `half` (n_out,) scale the
    corrected outputs; `limit` (n_out,) bounds the magnitude of each deviation. The core spool is
    the last output that is a speed, or the first output of an engine without one.
    """

    output_names: tuple[str, ...]
    parameters: FloatArray
    centre: FloatArray
    half: FloatArray
    limit: FloatArray

    @property
    def core(self) -> int:
        """Column of the core spool."""
        return core_of(self.output_names)

    @cached_property
    def wiring(self) -> Wiring:
        """What goes by which speed."""
        columns = np.arange(len(self.output_names))
        speeds = speeds_of(self.output_names)
        own = np.where(speeds, columns, self.core)
        sign = np.where(speeds | (columns == self.core), 1.0, -1.0)
        return Wiring(core_first(self.output_names), own, sign)

    def of(self, columns: IntArray) -> LagModel:
        """Some of the outputs; the core spool has to be among them."""
        return LagModel(
            output_names=tuple(self.output_names[k] for k in columns),
            parameters=self.parameters[columns],
            centre=self.centre[columns],
            half=self.half[columns],
            limit=self.limit[columns],
        )

    def drive(self, inputs: FloatArray, names: Sequence[str], ss: FloatArray) -> Drive:
        """What the lags follow, from inputs (T, n_in) called `names` and ss (T, n_out)."""
        root, air = thickness(inputs, names)
        scale = root[:, None] * self.half
        target = (ss / root[:, None] - self.centre) / self.half
        _, own, sign = self.wiring
        return Drive(ss, target[:, own], sign / scale[:, own], air)

    def run(
        self,
        drive: Drive,
        starts: tuple[IntArray, FloatArray],
        dt_s: float,
        measured: FloatArray | None = None,
    ) -> FloatArray:
        """States (T, 3, n_out), whose sum is the deviation; arguments as of `run_lags`."""
        order = self.wiring.order
        back = np.argsort(order)
        ss, target, per_unit = (np.ascontiguousarray(part[:, order]) for part in drive[:3])
        forced = np.empty((0, len(order))) if measured is None else measured[:, order]
        states = run_lags(
            (ss, target, per_unit, drive.air),
            (self.parameters[order], self.limit[order]),
            (starts[0], np.ascontiguousarray(starts[1][:, :, order])),
            np.ascontiguousarray(forced),
            dt_s,
        )
        return states[:, :, back]

    def deviations(
        self, drive: Drive, start: FloatArray, dt_s: float, measured: FloatArray | None = None
    ) -> FloatArray:
        """Deviations (T, n_out) from `start` (n_out,) on; a NaN there counts as zero."""
        first = self.start(np.nan_to_num(start))
        states = self.run(drive, (AT_START, first[None]), dt_s, measured)
        deviation: FloatArray = states.sum(axis=1)
        return deviation

    def start(self, deviation: FloatArray) -> FloatArray:
        """States (..., 3, n_out) where a run begins with `deviation` (..., n_out).

        Engines are mostly found at rest. What is left then is the metal's heat, where the model
        knows of it, and it goes in minutes.
        """
        states = np.zeros((*deviation.shape[:-1], len(STATES), deviation.shape[-1]))
        warm = self.parameters[:, PARAMETERS.index("casing_share")] != 0.0
        states[..., FAST, :] = np.where(warm, 0.0, deviation)
        states[..., CASING, :] = np.where(warm, deviation, 0.0)
        return states

    def to_arrays(self) -> tuple[dict[str, Any], dict[str, FloatArray]]:
        """Split into JSON-able structure and named arrays, for the bundle."""
        meta = {"output_names": list(self.output_names), "parameter_names": list(PARAMETERS)}
        return meta, {name: getattr(self, name) for name in _ARRAYS}

    @classmethod
    def from_arrays(cls, meta: Mapping[str, Any], arrays: Mapping[str, FloatArray]) -> Self:
        """Rebuild from `to_arrays`; `ModelError` where an array is missing or misshapen.

        Parameters of before there was `heat` are completed: they had none.
        """
        names = tuple(meta["output_names"])
        shapes: dict[str, tuple[int, ...]] = dict.fromkeys(_ARRAYS, (len(names),))
        cold = meta.get("parameter_names") == _COLD
        shapes["parameters"] = (len(names), len(_COLD if cold else PARAMETERS))
        kept = arrays_of(shapes, arrays)
        missing = len(PARAMETERS) - kept["parameters"].shape[1]
        kept["parameters"] = np.pad(kept["parameters"], ((0, 0), (0, missing)))
        return cls(output_names=names, **kept)


def arrays_of(
    shapes: Mapping[str, tuple[int, ...]], arrays: Mapping[str, FloatArray]
) -> dict[str, FloatArray]:
    """Copies of the arrays named in `shapes`; `ModelError` where one is missing or misshapen."""
    kept = {}
    for name, shape in shapes.items():
        found = arrays.get(name)
        if found is None or found.shape != shape:
            given = None if found is None else found.shape
            raise ModelError(
                f"lag array '{name}' has to be of shape {shape}, found {given}",
                hint="Train again if another version of narxcal wrote the folder",
            )
        kept[name] = np.array(found, dtype=np.float64)
    return kept


def speeds_of(names: Sequence[str]) -> NDArray[np.bool_]:
    """Which outputs are spool speeds."""
    return np.array([name.endswith("_pct") for name in names])


def core_of(names: Sequence[str]) -> int:
    """Column of the core spool: the last speed, or 0."""
    speeds = np.flatnonzero(speeds_of(names))
    return int(speeds[-1]) if len(speeds) else 0


def core_first(names: Sequence[str]) -> IntArray:
    """Columns with the core spool first."""
    columns = np.arange(len(names))
    core = core_of(names)
    return np.concatenate([[core], columns[columns != core]])


def thickness(inputs: FloatArray, names: Sequence[str]) -> tuple[FloatArray, FloatArray]:
    """Return sqrt(theta2) (T,) and logarithms (T, 2) of sqrt(theta2) / delta2 and sqrt(theta2).

    What is missing is zero.
    """
    zero = np.zeros(len(inputs))
    air = air_state(*(zero if k < 0 else inputs[:, k] for k in air_columns(names)))
    root = np.sqrt(air.theta2)
    return root, np.log(np.stack([root / air.delta2, root], axis=1))


def air_columns(names: Sequence[str]) -> IntArray:
    """Columns of altitude, Mach number and temperature deviation; -1 for one that is missing."""
    wanted = ("ALT_ft", "Mach", "dT_C")
    return np.array([list(names).index(name) if name in names else -1 for name in wanted])
