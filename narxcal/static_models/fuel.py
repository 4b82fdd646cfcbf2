"""Fuel flow in steady flight from thrust, air and gas path: Torenbeek, BADA 3, Yoder, Yoder+.

| symbol | meaning | unit |
|---|---|---|
| W_f, f | fuel flow | kg/h, kg/min |
| F_n | net thrust | kN |
| theta, delta | static temperature and pressure over those at sea level | - |
| TSFC | thrust-specific fuel consumption | lb/lbf/h = kg/kgf/h |
| V, H | true airspeed, pressure altitude | kt, ft |
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from narxcal.atmosphere import T0_K
from narxcal.static_models.model import (
    Columns,
    K,
    Parameter,
    StaticModel,
    ambient,
    registered,
    true_airspeed,
    unpack,
)
from narxcal.static_models.thrust import NO_GENERATOR, gas_generator
from narxcal.support.arrays import FloatArray

KGPH_PER_KN = 1e3 / 9.80665  # kg/h of fuel at 1 kN and a TSFC of 1 kg/kgf/h
_KNOT_MPS = 1852.0 / 3600.0
Phase = Literal["cruise", "nominal", "powered", "idle"]


@registered("torenbeek-fuel")
def torenbeek_fuel(
    bypass_ratio: float,
    *,
    reference: Literal["ambient", "sea level"] = "ambient",
    fan: bool = False,
) -> StaticModel:
    """Torenbeek's specific fuel consumption times thrust (eq. 10; Torenbeek 1982, Appendix H).

    TSFC = 0.697 sqrt(T/T_0) (phi - th - chi/eta_c)
             / (sqrt(5 eta_j (1 + eta_tf B) (G + 0.2 M^2 B e)) - M (1+B))

    phi is ITT over ambient (the source) or sea-level temperature (the paper's G_0), eta_tf turbine
    times fan efficiency, `e` is eta_i/eta_tf, or eta_c/eta_tf with `fan` (one public code). ITT
    and EPR stand for T4 and the compressor's pressure ratio, so the numerator is not the heat of
    the burner: with a measured EPR free k (TSFC times k) and B, or expect no value at all.
    """

    def equation(p: FloatArray, columns: Columns) -> FloatArray:
        k, eta_c, eta_tf, B, eta_j, eta_t, eta_i = unpack(p)
        air, M = ambient(columns), columns["Mach"]
        hot = columns["EGT_C"] + 273.15
        phi = hot / (air.T_K if reference == "ambient" else T0_K)
        th = 1.0 + 0.2 * M**2
        chi = th * (columns["EPR"] ** K - 1.0)
        G = gas_generator(phi, columns["EPR"], (eta_c, eta_t), (M, 1.0))
        e = (eta_c if fan else eta_i) / eta_tf
        speed = np.sqrt(5.0 * eta_j * (1.0 + eta_tf * B) * (G + 0.2 * M**2 * B * e)) - M * (1.0 + B)
        tsfc = 0.697 * np.sqrt(air.theta) * (phi - th - chi / eta_c)
        tsfc = tsfc / np.where(speed > 0.0, speed, np.nan)
        return np.asarray(k * KGPH_PER_KN * tsfc * columns["FN_kN"])

    parameters = (
        Parameter("k", 1.0, 0.02, 5.0, fixed=True),
        Parameter("eta_c", 0.85, 0.5, 1.0),
        Parameter("eta_tf", 0.75, 0.5, 1.0),
        Parameter("B", bypass_ratio, 0.2, 15.0, fixed=True),
        Parameter("eta_j", 0.97, 0.5, 1.0),
        Parameter("eta_t", 0.88, 0.5, 1.0, fixed=True),
        Parameter("eta_i", 0.97, 0.5, 1.0, fixed=True),
    )
    return StaticModel(
        name="Torenbeek fuel", output="FF_kgph",
        inputs=("ALT_ft", "Mach", "EGT_C", "EPR", "FN_kN"), parameters=parameters,
        equation=equation, undefined=f"{NO_GENERATOR} or the jet is slower than the flight",
    )  # fmt: skip


@registered("bada3")
def bada3(phase: Phase = "cruise") -> StaticModel:
    """BADA 3 (eqs 11 and 12; EUROCONTROL, pyBADA).

    f_nom = C_f1 (1 + V/C_f2) F_n [kg/min],  f_min = C_f3 (1 - H/C_f4),  f_cr = C_fcr f_nom

    `powered` (approach, landing, climb) is max(f_nom, f_min), `idle` is f_min. Thrust and fuel
    of one engine or of all: C_f1 is the same, C_f3 is not. C_fcr is fixed: C_f1 C_fcr is one
    parameter in cruise.
    """

    def equation(p: FloatArray, columns: Columns) -> FloatArray:
        C_f1, C_f2, C_fcr, C_f3, C_f4 = unpack(p)
        speed_kt = true_airspeed(columns, ambient(columns)) / _KNOT_MPS
        nominal = C_f1 * (1.0 + speed_kt / C_f2) * columns["FN_kN"]
        least = C_f3 * (1.0 - columns["ALT_ft"] / C_f4)
        flow = {
            "cruise": lambda: C_fcr * nominal,
            "nominal": lambda: nominal,
            "powered": lambda: np.maximum(nominal, least),
            "idle": lambda: least,
        }[phase]()
        return np.asarray(60.0 * flow)

    thrust, least = phase != "idle", phase in ("powered", "idle")
    parameters = (
        Parameter("C_f1", 0.7, 0.1, 3.0, "kg/min/kN", fixed=not thrust),
        Parameter("C_f2", 1e3, 100.0, 1e5, "kt", fixed=not thrust),
        Parameter("C_fcr", 1.0, 0.7, 1.3, fixed=True),
        Parameter("C_f3", 5.0, 0.1, 50.0, "kg/min", fixed=not least),
        Parameter("C_f4", 8e4, 4.5e4, 1e6, "ft", fixed=not least),
    )  # fmt: skip
    return StaticModel(
        name="BADA 3", output="FF_kgph", inputs=("ALT_ft", "Mach", "FN_kN"),
        parameters=parameters, equation=equation,
    )  # fmt: skip


@registered("yoder")
def yoder(F0_kN: float) -> StaticModel:
    """Yoder's part-throttle law on that of Hill and Peterson (eq. 13; form read in GRAPE).

    W_f = F_n sqrt(theta) (alpha + beta_1 M + beta_2 exp(-beta_3 F_n / (delta F_0)))

    The coefficients are in lb/lbf/h. Without rows below F_n/(delta F_0) = 0.5, beta_2 and beta_3
    are nearly collinear.
    """
    return _yoder(F0_kN, "Yoder", ())


@registered("yoder-plus")
def yoder_plus(F0_kN: float) -> StaticModel:
    """Yoder's law with a free exponent, M^2 and FPR (eq. 14; reconstruction).

    W_f = F_n theta^n (alpha + beta_1 M + beta_2 exp(-beta_3 F_n/(delta F_0))
                         + beta_4 M^2 + beta_5 (FPR - 1))

    The paper's equation is lost; it names FPR as a variable. Nested: beta_4 = beta_5 = 0 and
    n = 1/2 are Yoder's law. These terms were fixed before a validation flight was looked at.
    """
    added = (
        Parameter("beta_4", 0.0, -2.0, 2.0, "lb/lbf/h"),
        Parameter("beta_5", 0.0, -3.0, 3.0, "lb/lbf/h"),
        Parameter("n", 0.5, 0.0, 1.0),
    )
    return _yoder(F0_kN, "Yoder+", added)


def _yoder(F0_kN: float, name: str, added: tuple[Parameter, ...]) -> StaticModel:
    def equation(p: FloatArray, columns: Columns) -> FloatArray:
        alpha, beta_1, beta_2, beta_3, *rest = unpack(p)
        air, M, F_n = ambient(columns), columns["Mach"], columns["FN_kN"]
        tsfc = alpha + beta_1 * M + beta_2 * np.exp(-beta_3 * F_n / (air.delta * F0_kN))
        n: FloatArray | float = 0.5
        if rest:
            beta_4, beta_5, n = rest
            tsfc = tsfc + beta_4 * M**2 + beta_5 * (columns["FPR"] - 1.0)
        return np.asarray(KGPH_PER_KN * F_n * air.theta**n * tsfc)

    parameters = (
        Parameter("alpha", 0.4, -2.0 if added else 0.0, 1.0, "lb/lbf/h"),
        Parameter("beta_1", 0.45, -1.5 if added else 0.0, 1.5, "lb/lbf/h"),
        Parameter("beta_2", 0.5, 0.0, 5.0, "lb/lbf/h"),
        Parameter("beta_3", 6.0, 0.5, 30.0),
        *added,
    )
    return StaticModel(
        name=name, output="FF_kgph",
        inputs=("ALT_ft", "Mach", "FN_kN", *(("FPR",) if added else ())),
        parameters=parameters, equation=equation,
        reconstruction="reconstruction: the paper's equation 14 is lost" if added else "",
    )  # fmt: skip
