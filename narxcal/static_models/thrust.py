"""Net thrust in steady flight: five laws of the Citation X paper, each usable with a drag term.

| symbol | meaning | unit |
|---|---|---|
| F_0, F_to | rated thrust at sea level, at take-off | kN |
| M, V | flight Mach number, true airspeed | -, m/s |
| sigma, rho | density over that at sea level, density | -, kg/m^3 |
| B | bypass ratio | - |
| G_0 | generator function | - |
| eta_c, eta_t, eta_f, eta_j, eta_i | efficiency of compressor, turbine, fan, nozzle, intake | - |
| S | area of the cold stream (what it means depends on `flow`) | m^2 |
| u | throttle function of the lever, 1 at full travel | - |

The equations 4 to 9 of the paper are lost; the forms are those of the sources named at each model.
None of the first four has a throttle that the text mentions, so u(TRA) is a reconstruction.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from narxcal.atmosphere import P0_PA, T0_K, AirState
from narxcal.static_models.model import (
    CP,
    GAS_R,
    Columns,
    K,
    Parameter,
    StaticModel,
    ambient,
    density,
    registered,
    true_airspeed,
    unpack,
)
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError

_FULL_DEG = 85.0  # resolver angle at full travel
_REFERENCE_MPS = 100.0
_CHOKED_FLOW = 241.0  # kg/s/m^2 through a choked area at sea level standard, gamma = 1.4
_THROTTLE = "the throttle function of the lever is a reconstruction"
Flow = Literal["capture", "corrected", "nozzle"]


@registered("mattingly")
def mattingly(F0_kN: float, throttle_degree: int = 2) -> StaticModel:
    """Lapse law of a high-bypass turbofan (eq. 4; Mattingly, Aircraft Engine Design).

    F_n = F_0 u(TRA) (p_1 + p_2 (1.2 - M)^3) sigma^p_3

    The original gives net thrust at full throttle with 0.568, 0.25 and 0.6.
    """

    def equation(p: FloatArray, columns: Columns) -> FloatArray:
        F0, p1, p2, p3, *a = unpack(p)
        lapse = (p1 + p2 * (1.2 - columns["Mach"]) ** 3) * _sigma(ambient(columns)) ** p3
        return np.asarray(F0 * _throttle(a, columns) * lapse)

    parameters = (
        _rated("F_0", F0_kN),
        Parameter("p_1", 0.568, 0.0, 2.0),
        Parameter("p_2", 0.25, 0.0, 1.0),
        Parameter("p_3", 0.6, 0.3, 1.2),
        *_throttle_parameters(throttle_degree),
    )
    return StaticModel(
        name="Mattingly", output="FN_kN", inputs=_inputs(throttle_degree), parameters=parameters,
        equation=equation, reconstruction=_THROTTLE if throttle_degree else "",
    )  # fmt: skip


@registered("torenbeek")
def torenbeek(
    F_to_kN: float,
    bypass_ratio: float,
    *,
    quadratic: bool = True,
    density_exponent: bool = False,
    throttle_degree: int = 0,
) -> StaticModel:
    """Lapse law with the generator function (eq. 5; Torenbeek 1982, Appendix H).

    F_n = F_to u sigma^p [1 - (1+B) M / sqrt(5 eta_j (1 + eta_tf B) G_0)
                            + (0.6 + 0.1 (eta_i/eta_tf) B / G_0) M^2]

    eta_tf is the take-off value of turbine times fan efficiency, eta_t that of the turbine in G_0.
    The M^2 term (`quadratic`), sigma^p (`density_exponent`) and u are reconstructions.
    """

    def equation(p: FloatArray, columns: Columns) -> FloatArray:
        F_to, eta_tf, B, eta_j, eta_t, eta_c, eta_i, *rest = unpack(p)
        M = columns["Mach"]
        G0 = generator(columns, eta_c, eta_t)
        lapse = 1.0 - (1.0 + B) * M / np.sqrt(5.0 * eta_j * (1.0 + eta_tf * B) * G0)
        if quadratic:
            lapse = lapse + (0.6 + 0.1 * eta_i / eta_tf * B / G0) * M**2
        if density_exponent:
            lapse = lapse * _sigma(ambient(columns)) ** rest.pop(0)
        return np.asarray(F_to * lapse * _throttle(rest, columns))

    parameters = (
        replace(_rated("F_to", F_to_kN), fixed=False),
        _efficiency("eta_tf", 0.75),
        Parameter("B", bypass_ratio, 0.2, 15.0, fixed=True),
        _efficiency("eta_j", 0.97, fixed=True),
        _efficiency("eta_t", 0.88, fixed=True),
        _efficiency("eta_c", 0.85, fixed=True),
        _efficiency("eta_i", 0.97, fixed=True),
        *([Parameter("p", 0.7, 0.0, 1.5)] if density_exponent else ()),
        *_throttle_parameters(throttle_degree),
    )
    added = [
        *(["its M^2 term"] if quadratic else []),
        *(["the factor sigma^p"] if density_exponent else []),
        *(["the throttle function"] if throttle_degree else []),
    ]
    return StaticModel(
        name="Torenbeek", output="FN_kN",
        inputs=(*_inputs(throttle_degree), "EGT_C", "EPR"), parameters=parameters,
        equation=equation, undefined=NO_GENERATOR,
        reconstruction=f"reconstruction: {', '.join(added)}" if added else "",
    )  # fmt: skip


NO_GENERATOR = "the generator function is not above zero (EPR too near one for this ITT)"


def generator(columns: Columns, eta_c: FloatArray, eta_t: FloatArray) -> FloatArray:
    """Generator function at rest, with ITT for T4 and EPR for the pressure ratio (eq. 6).

        G_0 = (phi - chi/eta_c) (1 - 1.01 / (EPR^k (1 - chi/(eta_c eta_t phi)))),
        phi = ITT/T_0,  chi = EPR^k - 1

    NaN where it is not above zero.
    """
    phi = (columns["EGT_C"] + 273.15) / T0_K
    return gas_generator(phi, columns["EPR"], (eta_c, eta_t))


def gas_generator(
    phi: FloatArray,
    pressure_ratio: FloatArray,
    efficiencies: tuple[FloatArray | float, FloatArray | float],
    flight: tuple[FloatArray | float, FloatArray | float] = (0.0, 1.0),
) -> FloatArray:
    """Torenbeek's generator function with flight Mach number and intake efficiency (`flight`).

        G = (phi - chi/eta_c) (1 - 1.01 / (eta_i^k (chi + th) (1 - chi/(phi eta_c eta_t)))),
        th = 1 + 0.2 M^2,  chi = th (eps^k - 1),  phi = T_4/T

    NaN where it is not above zero.
    """
    (eta_c, eta_t), (mach, eta_i) = efficiencies, flight
    th = 1.0 + 0.2 * np.square(mach)
    chi = th * (pressure_ratio**K - 1.0)
    work = 1.0 - chi / (phi * eta_c * eta_t)
    with np.errstate(divide="ignore", invalid="ignore"):
        G = (phi - chi / eta_c) * (1.0 - 1.01 / (np.power(eta_i, K) * (chi + th) * work))
    return np.where((work > 0.0) & (G > 0.0), G, np.nan)


@registered("aerospatiale")
def aerospatiale(
    F0_kN: float, *, k_is_exponent: bool = False, throttle_degree: int = 2
) -> StaticModel:
    """Law of Aerospatiale (eq. 7), from memory of Roux's survey: low confidence.

    F_n = k F_0 u sigma (1 - M + M^2/2),  or sigma^k in place of k sigma
    """

    def equation(p: FloatArray, columns: Columns) -> FloatArray:
        F0, k, *a = unpack(p)
        sigma, M = _sigma(ambient(columns)), columns["Mach"]
        factor = sigma**k if k_is_exponent else k * sigma
        return np.asarray(F0 * factor * (1.0 - M + 0.5 * M**2) * _throttle(a, columns))

    k = Parameter("k", 1.0, 0.2, 3.0)
    return StaticModel(
        name="Aerospatiale", output="FN_kN", inputs=_inputs(throttle_degree),
        parameters=(_rated("F_0", F0_kN), k, *_throttle_parameters(throttle_degree)),
        equation=equation, reconstruction="reconstruction: the paper's equation 7 is lost",
    )  # fmt: skip


@registered("wanner")
def wanner(F0_kN: float, *, free_density: bool = False, throttle_degree: int = 2) -> StaticModel:
    """Wanner's law of flight mechanics (eq. 8).

    F_n = k_f (rho/rho_0)^m (V / 100 m/s)^lambda_f u,  m = 1 unless `free_density`

    Speed and density are divided by references so that k_f (kN) and lambda_f do not trade off.
    """

    def equation(p: FloatArray, columns: Columns) -> FloatArray:
        k_f, lambda_f, m, *a = unpack(p)
        air = ambient(columns)
        speed = true_airspeed(columns, air) / _REFERENCE_MPS
        return np.asarray(k_f * _sigma(air) ** m * speed**lambda_f * _throttle(a, columns))

    parameters = (
        replace(_rated("k_f", F0_kN), fixed=False),
        Parameter("lambda_f", 0.0, -1.0, 2.0),
        Parameter("m", 1.0, 0.3, 1.5, fixed=not free_density),
        *_throttle_parameters(throttle_degree),
    )
    return StaticModel(
        name="Wanner", output="FN_kN", inputs=_inputs(throttle_degree), parameters=parameters,
        equation=equation, undefined="the airspeed is zero",
        reconstruction=_THROTTLE if throttle_degree else "",
    )  # fmt: skip


@registered("cold-thrust")
def cold_thrust(
    S_m2: float = 0.5,
    *,
    variant: Literal["paper", "full"] = "full",
    flow: Flow = "capture",
) -> StaticModel:
    """Thrust of the fan stream, over its share of net thrust (eq. 9; Saravanamuttoo, ch. 3).

    `variant="paper"` uses only the symbols that the paper lists, and no ram rise or choking:
    F_n = W_a (sqrt(2 c_p eta_j (T_a + (T_a/eta_f)(FPR^k - 1))(1 - FPR^-k)) - C_a) / share.
    `variant="full"` adds the ram rise, a choked nozzle and its pressure thrust:
    F_n = (W_a (C_8 - C_a) + A_8 (P_8 - P_a)) / share.

    The air flow W_a is rho S C_a (`flow="capture"`, the paper's, zero at rest), that of a fixed
    corrected flow through S (`"corrected"`), or what a fan nozzle of the fixed area A_8 = S
    passes (`"nozzle"`, full variant only; not in the paper).
    """
    if variant == "paper" and flow != "capture":
        raise ConfigError(f"Cold Thrust: variant 'paper' has flow 'capture' only, found '{flow}'")

    def equation(p: FloatArray, columns: Columns) -> FloatArray:
        S, eta_f, eta_j, eta_i, share = unpack(p)
        if variant == "paper":
            stream = _simple_stream(columns, S, (eta_f, eta_j))
        else:
            stream = _nozzle_stream(columns, S, (eta_f, eta_j, eta_i), flow)
        return np.asarray(1e-3 * stream / share)

    parameters = (
        Parameter("S", S_m2, 0.2 * S_m2, 3.0 * S_m2, "m2"),
        Parameter("eta_f", 0.88, 0.6, 1.0),
        Parameter("eta_j", 0.95, 0.7, 1.0),
        _efficiency("eta_i", 1.0, fixed=True),
        Parameter("share", 0.75, 0.5, 1.0, fixed=True),
    )
    return StaticModel(
        name="Cold Thrust", output="FN_kN", inputs=("ALT_ft", "Mach", "FPR"),
        parameters=parameters, equation=equation,
        undefined="the fan pressure ratio is below one",
        reconstruction="reconstruction: the paper's equation 9 is lost"
        + ("; the flow through a fixed nozzle area is ours" if flow == "nozzle" else ""),
    )  # fmt: skip


def _simple_stream(
    columns: Columns, S: FloatArray, eta: tuple[FloatArray, FloatArray]
) -> FloatArray:
    (eta_f, eta_j), air, FPR = eta, ambient(columns), columns["FPR"]
    C_a = true_airspeed(columns, air)
    rise = air.T_K * (1.0 + (FPR**K - 1.0) / eta_f)
    with np.errstate(invalid="ignore"):
        C_8 = np.sqrt(2.0 * CP * eta_j * rise * (1.0 - FPR**-K))
    return np.asarray(density(air) * S * C_a * (C_8 - C_a))


def _nozzle_stream(
    columns: Columns, S: FloatArray, eta: tuple[FloatArray, FloatArray, FloatArray], flow: Flow
) -> FloatArray:
    """Thrust in N of a converging nozzle behind the fan, choked or not."""
    (eta_f, eta_j, eta_i), air, FPR = eta, ambient(columns), columns["FPR"]
    P_a, C_a = air.P_Pa, true_airspeed(columns, air)
    P01 = P_a * (1.0 + 0.2 * eta_i * np.square(columns["Mach"])) ** 3.5
    T02, P02 = air.T2_K * (1.0 + (FPR**K - 1.0) / eta_f), FPR * P01
    critical = P02 * (1.0 - 1.0 / (6.0 * eta_j)) ** 3.5
    choked = critical > P_a
    with np.errstate(invalid="ignore"):
        drop = eta_j * T02 * (1.0 - (P_a / P02) ** K)
        T8 = np.where(choked, T02 / 1.2, T02 - drop)
        C8 = np.where(choked, np.sqrt(1.4 * GAS_R * T02 / 1.2), np.sqrt(2.0 * CP * drop))
    P8 = np.where(choked, critical, P_a)
    flux = P8 * C8 / (GAS_R * T8)  # kg/s/m^2 through the nozzle
    if flow == "nozzle":
        W_a = S * flux
    elif flow == "corrected":
        W_a = S * _CHOKED_FLOW * (P01 / P0_PA) / np.sqrt(air.T2_K / T0_K)
    else:
        W_a = density(air) * S * C_a
    return np.asarray(W_a * (C8 - C_a) + W_a / flux * (P8 - P_a))


@registered("drag")
def with_drag(base: StaticModel, terms: int = 1, area_m2: float = 1.0) -> StaticModel:
    """Subtract the drag 0.5 rho V^2 (c_0 + c_1 M) from `base` (reconstruction, areas in m^2).

    One term is the ram drag W_a V of a capture area c_0/2. A third term is nearly collinear with
    the Mach terms of the models, so two is the most. `area_m2` sets the bounds, +-`area_m2`.
    """
    count, names = len(base.parameters), ("c_0", "c_1")[:terms]

    def equation(p: FloatArray, columns: Columns) -> FloatArray:
        air = ambient(columns)
        pressure = 0.5e-3 * density(air) * np.square(true_airspeed(columns, air))
        drag = sum(c * columns["Mach"] ** n for n, c in enumerate(unpack(p[..., count:])))
        return np.asarray(base.equation(p[..., :count], columns) - pressure * drag)

    added = tuple(Parameter(name, 0.0, -area_m2, area_m2, "m2") for name in names)
    form = "the form of the drag correction is a reconstruction"
    return replace(
        base, name=f"{base.name} - drag", parameters=(*base.parameters, *added),
        equation=equation, design=None,
        reconstruction="; ".join(part for part in (base.reconstruction, form) if part),
    )  # fmt: skip


def _sigma(air: AirState) -> FloatArray:
    return np.asarray(air.delta / air.theta)


def _inputs(throttle_degree: int) -> tuple[str, ...]:
    return ("ALT_ft", "Mach", *(("TRA_deg",) if throttle_degree else ()))


def _rated(name: str, kN: float) -> Parameter:
    return Parameter(name, kN, 0.2 * kN, 3.0 * kN, "kN", fixed=True)


def _efficiency(name: str, start: float, *, fixed: bool = False) -> Parameter:
    return Parameter(name, start, 0.5, 1.0, fixed=fixed)


def _throttle_parameters(degree: int) -> tuple[Parameter, ...]:
    """Coefficients a_n of u; the start u = TRA / 85 deg is a lever proportional to thrust."""
    return tuple(
        Parameter(f"a_{n}", 1.0 if n == 1 else 0.0, -10.0, 10.0) for n in range(1, degree + 1)
    )


def _throttle(a: list[FloatArray], columns: Columns) -> FloatArray:
    """U = 1 + sum_n a_n (TRA/85 - 1)^n."""
    if not a:
        return np.ones(1)
    x = columns["TRA_deg"] / _FULL_DEG - 1.0
    return np.asarray(1.0 + sum(c * x**n for n, c in enumerate(a, start=1)))
