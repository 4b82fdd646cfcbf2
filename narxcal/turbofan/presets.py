"""Two engines: a small business-jet turbofan and one for a single-aisle airliner.

Thrust, bypass and pressure ratio are those of the class, and so is the fuel flow at the four
settings of the landing and take-off cycle: JT15D-4 (1PW036) and CFM56-5B4/3 (8CM055) of the ICAO
emissions databank, as OpenAP 2.6.2 carries it. The numbers of the maps were fitted to these fuel
flows, to an idle of the class and to the time constants of FACTS A2 (`docs/virtual_engine.md` has
the table); they belong to no maker's engine.
"""

from __future__ import annotations

from dataclasses import dataclass

from narxcal.errors import ConfigError
from narxcal.turbofan.design import DesignPoint
from narxcal.turbofan.maps import CompressorMap, TurbineMap
from narxcal.turbofan.ratings import BUSINESS_JET, SINGLE_AISLE, Ratings
from narxcal.turbofan.stations import GasPath


def _chart(flow_exponent: float, pressure_exponent: float, **shape: float) -> CompressorMap:
    """Shape of a compressor map whose sizes the design point will fill in."""
    return CompressorMap(0.0, 0.0, 0.0, flow_exponent, pressure_exponent, **shape)


def _turbine(**shape: float) -> TurbineMap:
    """Shape of a turbine map, likewise."""
    return TurbineMap(0.0, 0.0, 0.0, 0.0, **shape)


@dataclass(frozen=True, kw_only=True)
class Preset:
    """All numbers of one engine; `bleed` are shares of the HPC flow, `inertia` in kg m^2.

    `speed_pct` is what N1 and N2 read at the design point, `speed_radps` how fast that is.
    Times hold at the design point. `margins` are shares of steady fuel that acceleration and
    deceleration schedules leave, at idle and at full speed; `limits` lie beyond all settled points,
    so that the steady-state model is what the engine comes to rest at.
    """

    name: str
    title: str
    point: DesignPoint
    shape: GasPath
    ratings: Ratings
    speed_pct: tuple[float, float]
    speed_radps: tuple[float, float]
    inertia: tuple[float, float]
    accel_margins: tuple[float, float]
    decel_margins: tuple[float, float]
    clearance_pK: float  # share of HPT efficiency lost per K by which the casing trails
    limits: tuple[float, float]  # of N2 in %, T45 in K
    ecs_bleed: float = 0.025
    nai_bleed: float = 0.022
    wai_bleed: float = 0.02
    offtake_W: float = 10e3
    probe_tau_s: float = 0.70  # FACTS A3
    metal_tau_s: float = 10.0  # FACTS A4: about 12 s, 6 to 8 % of the heat exchanged
    metal_share: float = 0.055  # of the gas's heat capacity flow, at design
    casing_tau_s: float = 80.0  # FACTS A4: discs and casings 30 to 300 s
    governor_lag_s: float = 0.22  # valve, lines, burner, sensor and step together


BUSINESS = Preset(
    name="business_jet",
    title="Business-jet turbofan of 11 kN, bypass ratio 2.7",
    point=DesignPoint(
        flow_kgps=37.85,
        bypass_ratio=2.68,
        fan_pressure_ratio=1.62,
        lpc_pressure_ratio=2.10,
        hpc_pressure_ratio=4.84,
        T4_K=1268.0,
        fan_efficiency=0.827,
        lpc_efficiency=0.82,
        hpc_efficiency=0.798,
        hpt_efficiency=0.878,
        lpt_efficiency=0.84,
    ),
    shape=GasPath(
        fan=_chart(1.26, 2.06, best_speed=0.99, speed_loss=0.59, width=0.15, widening=0.5),
        lpc=_chart(1.025, 1.80, best_speed=0.99, speed_loss=0.49, width=0.15, widening=0.5),
        hpc=_chart(1.50, 2.25, best_speed=0.84, speed_loss=0.0, width=0.068, angle_loss=0.31),
        hpt=_turbine(choking=2.03, speed_loss=0.11),
        lpt=_turbine(choking=3.72, speed_loss=0.11),
        handling_bleed=0.07,
        handling_shut=0.71,
    ),
    ratings=BUSINESS_JET,
    speed_pct=(94.0, 95.0),
    speed_radps=(1580.0, 3260.0),
    inertia=(1.35, 0.105),
    accel_margins=(0.68, 0.27),
    decel_margins=(0.18, 0.60),
    clearance_pK=8e-5,
    limits=(102.0, 1130.0),
)
AIRLINER = Preset(
    name="single_aisle",
    title="Single-aisle turbofan of 120 kN, bypass ratio 5.7",
    point=DesignPoint(
        flow_kgps=380.7,
        bypass_ratio=5.7,
        fan_pressure_ratio=1.72,
        lpc_pressure_ratio=2.514,
        hpc_pressure_ratio=10.88,
        T4_K=1560.0,
        fan_efficiency=0.92,
        lpc_efficiency=0.88,
        hpc_efficiency=0.88,
        hpt_efficiency=0.91,
        lpt_efficiency=0.92,
    ),
    shape=GasPath(
        fan=_chart(1.0, 1.80, best_speed=1.0, speed_loss=0.123, width=0.15, widening=0.5),
        lpc=_chart(1.10, 1.70, best_speed=0.955, speed_loss=0.577, width=0.15, widening=0.5),
        hpc=_chart(2.82, 3.29, best_speed=0.97, speed_loss=0.0, width=0.05, angle_loss=0.40),
        hpt=_turbine(choking=2.0, speed_loss=0.765),
        lpt=_turbine(choking=1.574, speed_loss=0.433),
        handling_bleed=0.238,
        handling_shut=1.0,
        vane_cooling=0.07,
        rotor_cooling=0.05,
    ),
    ratings=SINGLE_AISLE,
    speed_pct=(91.0, 96.0),
    speed_radps=(476.0, 1454.0),
    inertia=(60.0, 14.0),
    offtake_W=70e3,
    accel_margins=(1.30, 0.38),
    decel_margins=(0.13, 0.55),
    clearance_pK=5e-5,
    limits=(105.0, 1340.0),
)
PRESETS = {preset.name: preset for preset in (BUSINESS, AIRLINER)}


def preset(name: str) -> Preset:
    """Give the preset called `name`; raises `ConfigError` listing those there are."""
    if name not in PRESETS:
        raise ConfigError(f"unknown engine '{name}'", hint=f"Known engines: {', '.join(PRESETS)}")
    return PRESETS[name]
