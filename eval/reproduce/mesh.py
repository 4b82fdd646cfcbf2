"""Virtual flights over the Citation X mesh: steady points, and steps, impulses, ramps of the lever.

Section 2.3 of the paper: accelerated cruise at constant altitude and throttle lever angle (TLA) for
the static models; disturbances of the TLA from trim for the dynamic ones; identification and
validation flights apart; low and high altitudes apart, because the range of TLA differs.

The paper's tables of cases (1 to 4, 7) are lost. Known from its text: TLA 50 is the climb position,
35 the least at the highest altitude; accelerations start at TLA 25 (low) and 35 (high). Chosen
here, before a model was fitted to it: the nodes of identification, validation in the middle of
every cell of them, `TRA = 85/60 TLA` (the climb position is at 71 of 85 deg), a ceiling of
40,000 ft (the virtual engine's), T_s = 0.1 s and a ramp of 5 s. The paper gives the onset both
as t = 1 s (eqs 1 to 3) and as t = 0: `Disturbance.onset_s` is explicit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Literal

import numpy as np

from narxcal.atmosphere import P0_PA, SOUND_KT, isa
from narxcal.support.arrays import FloatArray
from narxcal.turbofan import VirtualEngine

Kind = Literal["step", "impulse", "ramp"]
Role = Literal["identification", "validation"]
KINDS: tuple[Kind, ...] = ("step", "impulse", "ramp")
TRA_PER_TLA = 85.0 / 60.0
TLA_MOST = 50.0
T_S = 0.1
RAMP_S, ONSET_S, DYNAMIC_S = 5.0, 1.0, 30.0
_POINTS = 24  # Mach numbers of a cruise
_SLOW_KT, _FAST_KT, _MACH_MOST = 200.0, 330.0, 0.85
DRIVERS = ("TRA_deg", "ALT_ft", "Mach", "dT_C", "ECS")
OUTPUTS = ("FPR", "EPR", "EGT_C", "FN_kN", "FF_kgph")


@dataclass(frozen=True)
class Region:
    """Nodes of identification of one of the two meshes."""

    name: str
    altitudes_ft: tuple[float, ...]
    tla_deg: tuple[float, ...]

    def nodes(self, role: Role) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Altitudes and lever angles of the flights of `role`."""
        if role == "identification":
            return self.altitudes_ft, self.tla_deg
        return _middles(self.altitudes_ft), _middles(self.tla_deg)

    def conditions(self, role: Role) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Altitudes and amplitudes (of the TLA, from the least) of the disturbances of `role`."""
        altitudes, _ = self.nodes(role)
        amplitudes = tuple(tla - self.least_tla for tla in self.tla_deg[1:])
        return altitudes, amplitudes if role == "identification" else _middles(amplitudes)

    @property
    def least_tla(self) -> float:
        """Where the disturbances start."""
        return self.tla_deg[0]


LOW = Region("low", (5e3, 10e3, 15e3, 20e3, 25e3), (25.0, 30.0, 35.0, 40.0, 45.0, 50.0))
HIGH = Region("high", (30e3, 32.5e3, 35e3, 37.5e3, 40e3), (35.0, 40.0, 45.0, 50.0))
REGIONS = (LOW, HIGH)


@dataclass(frozen=True, eq=False)
class Disturbance:
    """One flight with a disturbed lever; `columns` (time,) every T_S, disturbed at `onset_s`."""

    kind: Kind
    altitude_ft: float
    amplitude_deg: float  # of the TLA
    time_s: FloatArray
    columns: Mapping[str, FloatArray]
    onset_s: float = ONSET_S

    @property
    def onset(self) -> int:
        """Index of the first sample at which the lever has moved."""
        return int(np.argmax(self.time_s > self.onset_s))


def static_flights(engine: VirtualEngine, region: Region, role: Role) -> dict[str, FloatArray]:
    """Steady points of all accelerated cruises of `region`; `flight` numbers the flights.

    A cruise takes 50 s to change its speed, the engine about one to follow: its samples are taken
    for steady.
    """
    altitudes, levers = region.nodes(role)
    found: list[dict[str, FloatArray]] = []
    for number, (alt_ft, tla) in enumerate(product(altitudes, levers)):
        mach = np.linspace(*mach_range(region, alt_ft, tla), _POINTS)
        inputs = _inputs(engine, alt_ft, mach, np.full(_POINTS, tla))
        outputs = engine.outputs(np.column_stack(list(inputs.values())))
        columns = dict(zip(engine.output_names, outputs.T, strict=True))
        found.append(_columns(inputs, columns) | {"flight": np.full(_POINTS, float(number))})
    return {name: np.concatenate([part[name] for part in found]) for name in found[0]}


def disturbances(
    engine: VirtualEngine, region: Region, role: Role, kind: Kind
) -> list[Disturbance]:
    """All flights of one kind, from the least TLA at the Mach number that it sustains.

    In row-major order of `region.conditions(role)`.
    """
    return [_disturbance(engine, region, node, kind) for node in product(*region.conditions(role))]


def lever(kind: Kind, time_s: FloatArray, start: float, amplitude: float) -> FloatArray:
    """Lever (time,) of equations 1 to 3; the ramp is a reconstruction and lasts 5 s."""
    late = time_s - ONSET_S
    share = {
        "step": (late > 0.0).astype(np.float64),
        "impulse": ((late > 0.0) & (late < 1.5 * T_S)).astype(np.float64),
        "ramp": np.clip(late / RAMP_S, 0.0, 1.0),
    }[kind]
    return np.asarray(start + amplitude * share)


def mach_range(region: Region, alt_ft: float, tla_deg: float) -> tuple[float, float]:
    """Mach at which an accelerated cruise begins, and the one that the lever sustains.

    From 200 kt calibrated to a speed that grows with the lever, at most 330 kt and Mach 0.85.
    """
    slow = _mach(_SLOW_KT, alt_ft)
    most = min(_mach(_FAST_KT, alt_ft), _MACH_MOST)
    share = (tla_deg - region.least_tla) / (TLA_MOST - region.least_tla)
    return slow, slow + (0.4 + 0.6 * share) * (most - slow)


def _mach(cas_kt: float, alt_ft: float) -> float:
    impact = P0_PA * ((1.0 + 0.2 * (cas_kt / SOUND_KT) ** 2) ** 3.5 - 1.0)
    return float(np.sqrt(5.0 * ((1.0 + impact / isa(alt_ft)[1]) ** (2.0 / 7.0) - 1.0)))


def _disturbance(
    engine: VirtualEngine, region: Region, node: tuple[float, float], kind: Kind
) -> Disturbance:
    alt_ft, amplitude = node
    time_s: FloatArray = T_S * np.arange(round(DYNAMIC_S / T_S), dtype=np.float64)
    mach = np.full_like(time_s, mach_range(region, alt_ft, region.least_tla)[1])
    tla = lever(kind, time_s, region.least_tla, amplitude)
    inputs = _inputs(engine, alt_ft, mach, tla)
    columns = _columns(inputs, engine.simulate(inputs, T_S))
    return Disturbance(kind, alt_ft, amplitude, time_s, columns)


def _inputs(
    engine: VirtualEngine, alt_ft: float, mach: FloatArray, tla_deg: FloatArray
) -> dict[str, FloatArray]:
    """Inputs of the engine, in its order; packs on, standard day."""
    given = {
        "TRA_deg": TRA_PER_TLA * tla_deg,
        "ALT_ft": np.full_like(mach, alt_ft),
        "Mach": mach,
        "ECS": np.ones_like(mach),
    }
    return {name: given.get(name, np.zeros_like(mach)) for name in engine.input_names}


def _columns(
    inputs: Mapping[str, FloatArray], outputs: Mapping[str, FloatArray]
) -> dict[str, FloatArray]:
    return {name: inputs[name] for name in DRIVERS} | {name: outputs[name] for name in OUTPUTS}


def _middles(nodes: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(0.5 * (a + b) for a, b in pairwise(nodes))
