"""Words of the gas path: its constants, what it is run at, how worn it is, and what comes out."""

from __future__ import annotations

from typing import NamedTuple

from narxcal.turbofan.maps import CompressorMap, TurbineMap


class GasPath(NamedTuple):
    """Constants of an engine's gas path. Shares are of the flow that enters the compressor."""

    fan: CompressorMap
    lpc: CompressorMap
    hpc: CompressorMap
    hpt: TurbineMap
    lpt: TurbineMap
    hpc_reference_K: float = 0.0  # HPC inlet temperature at the design point
    core_area_m2: float = 0.0  # this, and the two beside it: sized by the design point
    bypass_area_m2: float = 0.0
    burner_efficiency: float = 0.995
    burner_loss: float = 0.05
    core_duct_loss: float = 0.01
    bypass_duct_loss: float = 0.015
    vane_cooling: float = 0.05  # HPC exit air that does work in the HPT
    rotor_cooling: float = 0.04  # HPC exit air that returns behind the HPT
    mechanical_efficiency: float = 0.99
    thrust_coefficient: float = 0.985
    handling_bleed: float = 0.0  # share of the LPC flow dumped at low speed
    handling_shut: float = 0.9  # relative corrected N2 above which the handling bleed is shut
    reynolds_loss: float = 0.012  # efficiency lost where the Reynolds index is zero


class Running(NamedTuple):
    """What the gas path is run at: relative speeds (1 at design), fuel, and what is taken off."""

    n1: float
    n2: float
    fuel_kgps: float
    bleed: float  # customer bleed, share of the HPC flow
    offtake_W: float  # shaft power taken from the HP spool
    soak_W: float  # heat that the metal of the hot section takes out of the gas
    clearance: float  # loss of HPT efficiency by open tip clearances


class Health(NamedTuple):
    """Multipliers of efficiency and flow of the components; 1 as built."""

    fan_efficiency: float = 1.0
    hpc_efficiency: float = 1.0
    hpc_flow: float = 1.0
    hpt_efficiency: float = 1.0
    hpt_area: float = 1.0
    lpt_efficiency: float = 1.0


class Stations(NamedTuple):
    """The solved gas path: K, Pa, kg/s, W, N."""

    W2: float
    W13: float
    W21: float
    W25: float
    W4: float
    W45: float
    far4: float
    far45: float
    T13: float
    T21: float
    T3: float
    T4: float
    T41: float
    T45: float
    T5: float
    P13: float
    P21: float
    P3: float
    P45: float
    P5: float
    fan_W: float
    lpc_W: float
    hpc_W: float
    hpt_W: float
    lpt_W: float
    power1_W: float  # surplus on the low-pressure spool
    power2_W: float
    gross_N: float
    net_N: float
