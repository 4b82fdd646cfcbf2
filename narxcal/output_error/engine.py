"""The Spey engine with its controls in four chains, each from its inputs to measured outputs.

| chain | inputs | outputs |
|---|---|---|
| `ThrottleLinkage` | delta_c | delta_TM |
| `DuctPressures` | N_H, N_L as measured | P_TM, P_DM |
| `EngineFromFuel` | W_F as measured | N_HM, N_LM, P_TM, P_DM |
| `EngineAndControl` | delta_c | delta_TM, W_FM, N_HM, N_LM, P_TM, P_DM (Table 2) |

The chain of blocks is delta_c -> play -> delta_T -> K_TH -> N_c -> governor -> W_F -> rotors ->
pressures, and the sensors. All are deviations from 100 % power. Units: percent of the
full-power value for N, P, W; degrees for delta; counts for the throttle pickoff; the paper prints
none, these are inferred.

A run starts in the equilibrium of its first input plus N_H_start, N_L_start (and for the linkage
delta_T_start inside the play). A record that starts steady
does not determine those together with offsets.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from narxcal.output_error.blocks import (
    Governor,
    LinearSystem,
    Rotors,
    Values,
    flowmeter,
    lag,
    lag_step,
    play,
)
from narxcal.steady.model import SteadyStateModel
from narxcal.support.arrays import FloatArray
from narxcal.support.compiled import compiled
from narxcal.support.errors import DataError

STEADY_OUTPUTS: Final = ("N2_pct", "N1_pct", "EGT_C")  # N_H, N_L, T of `EngineFromSteady`
Parameters = Mapping[str, complex]


@dataclass(frozen=True)
class Parameter:
    """A named quantity of a model: start value, bounds, unit, and whether it is estimated.

    With `tied_to` it takes the value of that parameter.
    """

    name: str
    start: float
    low: float = -np.inf
    high: float = np.inf
    unit: str = "-"
    meaning: str = ""
    free: bool = True
    tied_to: str = ""


def _fixed(name: str, value: float, unit: str, meaning: str) -> Parameter:
    return Parameter(name, value, -np.inf, np.inf, unit, meaning, free=False)


# Start values and bounds after the paper's nomenclature and the magnitudes of its Table 4.
_LINKAGE: Final = (
    Parameter("a_fixed", 0.3, 0.0, 3.0, "deg", "throttle hysteresis (a0), half width of the play"),
    Parameter("a_prop", 0.0, 0.0, 0.5, "-", "hysteresis per throttle level (a1)", free=False),
    Parameter("b0", 960.0, 0.0, 2000.0, "count", "throttle pickoff bias"),
    Parameter("b1", -25.0, -200.0, 200.0, "count/deg", "throttle pickoff slope"),
    _fixed("delta_T_start", 0.0, "deg", "position in the play before the first sample"),
)
_ROTORS: Final = (
    Parameter("tau_H", 0.3, 0.05, 3.0, "s", "collective time constant"),
    Parameter("tau_L", 0.4, 0.05, 3.0, "s", "differential time constant"),
    Parameter("C_FH", 0.1, 0.01, 1.0, "%/unit", "steady N_H per fuel flow"),
    Parameter("C_HL", 3.0, 0.5, 6.0, "%/%", "steady N_L per N_H"),
    Parameter("alpha", 0.5, 0.0, 1.2, "-", "share of N_L that follows fuel flow directly"),
)
_PRESSURES: Final = (
    Parameter("K_EH", 4.0, 0.3, 12.0, "%/%", "tailpipe pressure per N_H"),
    Parameter("K_DL", 1.3, 0.1, 5.0, "%/%", "duct pressure per N_L"),
    # A free time constant stays positive; 0 is for a fixed one and drops the state.
    Parameter("tau_E", 0.0, 1e-3, 1.0, "s", "tailpipe pressure time constant", free=False),
    Parameter("tau_D", 0.05, 1e-3, 1.0, "s", "duct pressure time constant", free=False),
    Parameter("P_TO", 0.0, -15.0, 15.0, "%", "offset of the tailpipe pressure"),
    Parameter("P_DO", 0.0, -15.0, 15.0, "%", "offset of the duct pressure"),
)
_OFFSETS: Final = (
    Parameter("N_HO", 0.0, -15.0, 15.0, "%", "offset of N_H", free=False),
    Parameter("N_LO", 0.0, -15.0, 15.0, "%", "offset of N_L"),
    _fixed("N_H_start", 0.0, "%", "N_H at the first sample, from its equilibrium"),
    _fixed("N_L_start", 0.0, "%", "N_L at the first sample, from its equilibrium"),
)
_STARTS: Final = ("N_H_start", "N_L_start")  # the order of the first states
_METER_LAG: Final = Parameter("tau_M", 0.0, -1.0, 3.0, "s", "lag of the fuel meter", free=False)
_CONTROL: Final = (
    _fixed("K_TH", 0.7212, "%/deg", "N_H commanded per throttle angle, steady operating line"),
    Parameter("K_AF", 3.0, 0.1, 20.0, "unit/%", "fuel flow per governor error"),
    Parameter(
        "C_FB", 0.1, 0.01, 1.0, "%/unit", "1/C_FB: feedback of the pressure drop", tied_to="C_FH"
    ),
    _fixed("W_F0", 0.0, "unit", "fuel flow offset; with N_HO a single parameter"),
    Parameter("zeta", 0.3, 0.02, 1.5, "-", "damping ratio of the flowmeter"),
    Parameter("omega", 13.0, 2.0, 60.0, "rad/s", "natural frequency of the flowmeter"),
    _fixed("K_SF", 1.0, "-", "scale factor of the flowmeter; with C_FH a single parameter"),
)


@dataclass(frozen=True)
class ThrottleLinkage:
    """delta_c -> play -> delta_T; pickoff delta_TM = b0 + b1 delta_T."""

    parameters: Sequence[Parameter] = _LINKAGE
    input_names: Sequence[str] = ("delta_c",)
    output_names: Sequence[str] = ("delta_TM",)

    def simulate(self, values: Parameters, u: FloatArray) -> Values:
        """Pickoff counts (time, 1) for commanded deflections u (time, 1) in degrees."""
        return (values["b0"] + values["b1"] * deflection(values, u[:, 0]))[:, None]


def deflection(values: Parameters, delta_c: FloatArray) -> Values:
    """Throttle deflection delta_T (time,) behind the play."""
    start = delta_c[0] + values["delta_T_start"]
    return play(delta_c, values["a_fixed"], values["a_prop"], start)


@dataclass(frozen=True)
class DuctPressures:
    """Measured N_H, N_L -> P_T, P_D (equation 2)."""

    dt_s: float
    parameters: Sequence[Parameter] = _PRESSURES
    input_names: Sequence[str] = ("N_HM", "N_LM")
    output_names: Sequence[str] = ("P_TM", "P_DM")

    def simulate(self, values: Parameters, u: FloatArray) -> Values:
        """Pressures (time, 2) for speeds u (time, 2)."""
        tailpipe = lag(values["K_EH"], values["tau_E"]).respond(u[:, :1], self.dt_s)
        duct = lag(values["K_DL"], values["tau_D"]).respond(u[:, 1:], self.dt_s)
        return np.hstack([tailpipe + values["P_TO"], duct + values["P_DO"]])


@dataclass(frozen=True)
class EngineFromFuel:
    """Measured fuel flow -> N_H, N_L and pressures.

    `tau_M` is a first-order lag of the fuel meter, undone by W_F = W_M + tau_M W_M' on the line
    between samples; at low frequency it is 2 zeta / omega of a flowmeter.
    """

    dt_s: float
    parameters: Sequence[Parameter] = (*_ROTORS, *_OFFSETS, _METER_LAG, *_PRESSURES)
    input_names: Sequence[str] = ("W_FM",)
    output_names: Sequence[str] = ("N_HM", "N_LM", "P_TM", "P_DM")

    def simulate(self, values: Parameters, u: FloatArray) -> Values:
        """Outputs (time, 4) for fuel flow u (time, 1)."""
        chain = rotor_block(values).then(speeds_and_pressures(values, 2))
        system = chain.lead(values["tau_M"])
        start = system.equilibrium(u[0]) + _shift(values, len(system.A))
        offsets = np.array([values[name] for name in ("N_HO", "N_LO", "P_TO", "P_DO")])
        return np.asarray(system.respond(u, self.dt_s, start=start) + offsets)


@dataclass(frozen=True)
class EngineAndControl:
    """Commanded deflection -> all measurements of Table 2, with the loop of the governor closed.

    C_FB is tied to C_FH, which makes the steady N_H equal to the commanded one and
    tau_engine = tau_H / (K_AF C_FB).
    """

    dt_s: float
    parameters: Sequence[Parameter] = (*_LINKAGE, *_CONTROL, *_ROTORS, *_PRESSURES, *_OFFSETS)
    input_names: Sequence[str] = ("delta_c",)
    output_names: Sequence[str] = ("delta_TM", "W_FM", "N_HM", "N_LM", "P_TM", "P_DM")

    def simulate(self, values: Parameters, u: FloatArray) -> Values:
        """Outputs (time, 6) for commanded deflections u (time, 1) in degrees."""
        delta_T = deflection(values, u[:, 0])
        N_c = values["K_TH"] * delta_T
        governor = Governor(**{name: values[name] for name in ("K_AF", "C_FB", "W_F0")})
        engine = governor.engine(rotor_block(values))
        fuel = LinearSystem.gain(np.eye(3)[2:])
        meter = fuel.then(flowmeter(*(values[name] for name in ("zeta", "omega", "K_SF"))))
        plant = engine.then(speeds_and_pressures(values, 3).beside(meter))
        shift = _shift(values, len(plant.A))
        N_H, N_L, P_E, P_D, W_m = governor.respond(plant, N_c, self.dt_s, shift=shift).T
        return np.column_stack([
            values["b0"] + values["b1"] * delta_T,
            W_m,
            N_H + values["N_HO"],
            N_L + values["N_LO"],
            P_E + values["P_TO"],
            P_D + values["P_DO"],
        ])  # fmt: skip


_SCHEDULED: Final = (
    Parameter("tau_H", 0.7, 0.02, 10.0, "s", "collective time constant at the reference N_H"),
    Parameter("tau_L", 0.7, 0.02, 10.0, "s", "differential time constant there"),
    Parameter("alpha", 0.5, -2.0, 3.0, "-", "share of N_L that follows fuel flow directly"),
    Parameter("tau_T", 1.0, 0.02, 60.0, "s", "lag of the temperature probe"),
    Parameter("beta", 1.0, -5.0, 10.0, "-", "share of T that follows fuel flow directly"),
    Parameter("rate_H", 0.03, -0.3, 0.3, "1/%", "tau_H falls by exp(-rate_H) per % N_H"),
    Parameter("rate_L", 0.03, -0.3, 0.3, "1/%", "tau_L falls by exp(-rate_L) per % N_H"),
    *_OFFSETS[:2],
    Parameter("T_O", 0.0, -100.0, 100.0, "degC", "offset of the temperature"),
    _METER_LAG,
    Parameter("square_M", 0.0, -2.0, 2.0, "s2", "1/omega^2 of the fuel meter", free=False),
)


@dataclass(frozen=True)
class EngineFromSteady:
    """Steady values -> N_H, N_L, T: equation 1 with steady-state curves for C_FH and C_HL.

    For whole flights, where gains and time constants change with power:

        tau_H N_H' = H - N_H,                 tau_L N_L' = L + (1 - alpha) c_L (N_H - H) - N_L
        tau_T T' = S + (1 - beta) c_T (N_H - H) - T,   tau_{H,L} = tau exp(-rate (N_H - reference))

    Inputs (time, 5): steady N_H, N_L and T of the present fuel flow (H, L, S), and the slopes
    c_L = dL/dH, c_T = dS/dH. On linear curves this is `EngineFromFuel`. The fuel
    meter, whose output is the input here, is undone by W_F = W_M + tau_M W_M' + square_M W_M'',
    with tau_M = 2 zeta / omega and square_M = 1 / omega^2 of a flowmeter.
    """

    dt_s: float
    reference: float = 80.0
    parameters: Sequence[Parameter] = _SCHEDULED
    output_names: Sequence[str] = ("N_HM", "N_LM", "T_M")

    def simulate(self, values: Parameters, u: FloatArray) -> Values:
        """Outputs (time, 3) in the units of the steady values, from equilibrium."""
        outputs = self.run(values, u)[0]
        offsets = np.array([values[name] for name in ("N_HO", "N_LO", "T_O")])
        return np.asarray(outputs + offsets)

    def run(
        self,
        values: Parameters,
        u: FloatArray,
        start: FloatArray | None = None,
        measured: FloatArray | None = None,
    ) -> tuple[Values, Values]:
        """Outputs (time, 3) without offsets, and those (3,) that the next step starts from.

        The run starts at `start` (3,) or in equilibrium. A finite value of `measured` (time, 3)
        replaces an output after its sample.
        """
        curvature = np.gradient(np.gradient(u[:, :3], axis=0), axis=0) if len(u) > 1 else 0.0
        steady = u[:, :3] + values["square_M"] / self.dt_s**2 * curvature
        drive = np.hstack([steady, u[:, 3:]]).astype(np.complex128)
        numbers = np.array([values[name] for name in _IN_STEP], dtype=np.complex128)
        numbers[:4] /= self.dt_s
        known = np.full((len(u), 3), np.nan) if measured is None else measured
        state = drive[0, :3] if start is None else np.asarray(start, dtype=np.complex128)
        outputs, end = _engine(numbers, drive, (state, known, self.reference))
        if any(np.iscomplexobj(value) for value in values.values()):
            return outputs, end
        return outputs.real.copy(), end.real.copy()


_IN_STEP: Final = ("tau_H", "tau_L", "tau_T", "tau_M", "rate_H", "rate_L", "alpha", "beta")


@compiled
def _engine(
    p: NDArray[np.complex128],
    drive: NDArray[np.complex128],
    more: tuple[NDArray[np.complex128], FloatArray, float],
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Step N_H, N_L, T; times in p are in samples, the meter's lead is that of each interval."""
    start, measured, reference = more
    tau_H, tau_L, tau_T, tau_M, rate_H, rate_L, alpha, beta = p
    outputs, y = np.empty((len(drive), 3), dtype=np.complex128), start.copy()
    for k in range(len(drive)):
        if k > 0:
            lead = tau_M * (drive[k, :3] - drive[k - 1, :3])
            before, after = drive[k - 1, :3] + lead, drive[k, :3] + lead
            behind, above = y[0] - before[0], y[0] - reference
            y[0] = lag_step(y[0], (before[0], after[0]), tau_H * np.exp(-rate_H * above))
            c_L, c_T = (1.0 - alpha) * drive[k - 1, 3], (1.0 - beta) * drive[k - 1, 4]
            d_L, d_T = (1.0 - alpha) * drive[k, 3], (1.0 - beta) * drive[k, 4]
            left = y[0] - after[0]
            ends = before[1] + c_L * behind, after[1] + d_L * left
            y[1] = lag_step(y[1], ends, tau_L * np.exp(-rate_L * above))
            ends = before[2] + c_T * behind, after[2] + d_T * left
            y[2] = lag_step(y[2], ends, tau_T)
        outputs[k] = y
        for j in range(3):
            if np.isfinite(measured[k, j]):
                y[j] = complex(measured[k, j])
    return outputs, y


def steady_drive(
    steady: SteadyStateModel, inputs: FloatArray, driver: str, span: tuple[float, float]
) -> FloatArray:
    """Inputs (time, 5) of `EngineFromSteady` at inputs (time, n_in) of a steady-state model.

    The slopes dN1/dN2 and dT/dN2 are those over 1 % of the driver's range `span` to either side,
    within that range; where N2 does not move with the driver they are 0. Raises `DataError` for a
    model without one of the outputs or the driver.
    """
    missing = [name for name in STEADY_OUTPUTS if name not in steady.output_names]
    if missing:
        raise DataError(
            "the steady-state model does not give this output",
            channel=missing[0],
            hint=f"Output error needs {', '.join(STEADY_OUTPUTS)}: choose another method",
        )
    if driver not in steady.input_names:
        raise DataError(
            "output error needs the driver among the inputs of the steady-state model",
            channel=driver,
            hint=f"Inputs are {', '.join(steady.input_names)}: set [steady_state] driver",
        )
    columns = [steady.output_names.index(name) for name in STEADY_OUTPUTS]
    values = steady.outputs(inputs)[:, columns]
    k, step = steady.input_names.index(driver), 0.01 * (span[1] - span[0])
    more, less = inputs.copy(), inputs.copy()
    more[:, k], less[:, k] = (np.clip(inputs[:, k] + d, *span) for d in (step, -step))
    rise = (steady.outputs(more) - steady.outputs(less))[:, columns]
    moves = np.abs(rise[:, :1]) > 1e-6
    slopes = np.where(moves, rise[:, 1:] / np.where(moves, rise[:, :1], 1.0), 0.0)
    return np.hstack([values, slopes])


def _shift(values: Parameters, size: int) -> Values:
    """How far a state of `size` begins from equilibrium: `_STARTS` first, zeros behind them."""
    given = [values.get(name, 0.0) for name in _STARTS][:size]
    return np.array([*given, *[0.0] * (size - len(given))])


def rotor_block(values: Parameters) -> LinearSystem:
    """Rotors W_F -> (N_H, N_L) of named parameters."""
    names = ("tau_H", "tau_L", "C_FH", "C_HL", "alpha")
    return Rotors(**{name: values[name] for name in names}).system()


def speeds_and_pressures(values: Parameters, inputs: int) -> LinearSystem:
    """(N_H, N_L, ...) -> (N_H, N_L, P_E, P_D); further inputs are not used."""
    n_h, n_l = np.eye(inputs)[:1], np.eye(inputs)[1:2]
    tailpipe = LinearSystem.gain(n_h).then(lag(values["K_EH"], values["tau_E"]))
    duct = LinearSystem.gain(n_l).then(lag(values["K_DL"], values["tau_D"]))
    return LinearSystem.gain(np.vstack([n_h, n_l])).beside(tailpipe).beside(duct)
