"""Two engines: a small business-jet turbofan and one for a single-aisle airliner.

Sizes are those of the class, from what is published of the JT15D-4 and the CFM56-5B4 (type
certificate data, ICAO emissions databank; from memory, to be checked before they are quoted).
Nothing here is any maker's data, and the maps are generic.
"""

from __future__ import annotations

from dataclasses import dataclass

from narxcal.errors import ConfigError
from narxcal.turbofan.design import DesignPoint
from narxcal.turbofan.maps import CompressorMap, TurbineMap
from narxcal.turbofan.ratings import BUSINESS_JET, SINGLE_AISLE, Ratings
from narxcal.turbofan.stations import GasPath

_UNSIZED = TurbineMap(capacity=0.0, pressure_ratio=0.0, efficiency=0.0, work_speed=0.0)


def _chart(flow_exponent: float, pressure_exponent: float, **shape: float) -> CompressorMap:
    """Shape of a compressor map whose sizes the design point will fill in."""
    return CompressorMap(0.0, 0.0, 0.0, flow_exponent, pressure_exponent, **shape)


@dataclass(frozen=True, kw_only=True)
class Preset:
    """All numbers of one engine; `bleed` are shares of the HPC flow, `inertia` in kg m^2.

    `speed_pct` is what N1 and N2 read at the design point, `speed_radps` how fast that is.
    Times hold at the design point. `margins` are shares of steady fuel that acceleration and
    deceleration schedules leave, at idle and at full speed.
    """

    name: str
    title: str
    point: DesignPoint
    shape: GasPath
    ratings: Ratings
    speed_pct: tuple[float, float]
    speed_radps: tuple[float, float]
    inertia: tuple[float, float]
    ecs_bleed: float = 0.03
    nai_bleed: float = 0.015
    wai_bleed: float = 0.02
    offtake_W: float = 10e3
    probe_tau_s: float = 0.70  # FACTS A3
    metal_tau_s: float = 10.0  # FACTS A4: about 12 s, 6 to 8 % of the heat exchanged
    metal_share: float = 0.055  # of the gas's heat capacity flow, at design
    casing_tau_s: float = 80.0  # FACTS A4: discs and casings 30 to 300 s
    clearance_pK: float = 8e-5
    accel_margins: tuple[float, float] = (0.80, 0.30)
    decel_margins: tuple[float, float] = (0.35, 0.45)
    governor_lag_s: float = 0.22  # valve, lines, burner, sensor and step together
    limits: tuple[float, float] = (102.0, 1150.0)  # of N2 in %, T45 in K


BUSINESS = Preset(
    name="business_jet",
    title="Business-jet turbofan of 11 kN, bypass ratio 2.6",
    point=DesignPoint(
        flow_kgps=36.3,
        bypass_ratio=2.6,
        fan_pressure_ratio=1.52,
        lpc_pressure_ratio=1.95,
        hpc_pressure_ratio=5.2,
        T4_K=1315.0,
        fan_efficiency=0.84,
        lpc_efficiency=0.82,
        hpc_efficiency=0.77,
        hpt_efficiency=0.84,
        lpt_efficiency=0.86,
    ),
    shape=GasPath(
        fan=_chart(1.2, 2.1, best_speed=0.85, speed_loss=0.4, width=0.15, widening=0.5),
        lpc=_chart(1.25, 2.0, best_speed=0.85, width=0.15, widening=0.5),
        hpc=_chart(1.9, 2.5),
        hpt=_UNSIZED,
        lpt=_UNSIZED,
        hpc_reference_K=0.0,
        core_area_m2=0.0,
        bypass_area_m2=0.0,
    ),
    ratings=BUSINESS_JET,
    speed_pct=(94.0, 95.0),
    speed_radps=(1580.0, 3260.0),
    inertia=(0.50, 0.17),
)
AIRLINER = Preset(
    name="single_aisle",
    title="Single-aisle turbofan of 120 kN, bypass ratio 5.7",
    point=DesignPoint(
        flow_kgps=407.0,
        bypass_ratio=5.7,
        fan_pressure_ratio=1.68,
        lpc_pressure_ratio=2.55,
        hpc_pressure_ratio=12.5,
        T4_K=1590.0,
        fan_efficiency=0.90,
        lpc_efficiency=0.88,
        hpc_efficiency=0.86,
        hpt_efficiency=0.89,
        lpt_efficiency=0.905,
    ),
    shape=GasPath(
        fan=_chart(1.2, 2.1, best_speed=0.85, speed_loss=0.4, width=0.15, widening=0.5),
        lpc=_chart(1.3, 2.0, best_speed=0.85, width=0.15, widening=0.5),
        hpc=_chart(3.0, 3.6, best_speed=0.92),
        hpt=_UNSIZED,
        lpt=_UNSIZED,
        hpc_reference_K=0.0,
        core_area_m2=0.0,
        bypass_area_m2=0.0,
        handling_bleed=0.22,
        handling_shut=0.95,
        vane_cooling=0.07,
        rotor_cooling=0.05,
    ),
    ratings=SINGLE_AISLE,
    speed_pct=(91.0, 96.0),
    speed_radps=(476.0, 1454.0),
    inertia=(70.0, 12.0),
    offtake_W=70e3,
    limits=(105.0, 1340.0),
)
PRESETS = {preset.name: preset for preset in (BUSINESS, AIRLINER)}


def preset(name: str) -> Preset:
    """Give the preset called `name`; raises `ConfigError` listing those there are."""
    if name not in PRESETS:
        raise ConfigError(f"unknown engine '{name}'", hint=f"Known engines: {', '.join(PRESETS)}")
    return PRESETS[name]
