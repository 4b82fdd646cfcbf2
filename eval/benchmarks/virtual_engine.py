"""The virtual engine against published figures: `python -m eval.benchmarks.virtual_engine`.

Prints a table of what manoeuvres, time constants, bleeds, ratings and wear give.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from eval.benchmarks import Row
from narxcal.atmosphere import air_state
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ModelError
from narxcal.turbofan import Unmodelled, VirtualEngine
from narxcal.turbofan.cycle import Health
from narxcal.turbofan.design import PRESETS
from narxcal.turbofan.engine import COMPRESSORS, HIGH, INPUT_NAMES, LOW
from narxcal.turbofan.maps import SURGE

HZ = 32
CONDITIONS = {
    "ground": {"WOW": 1.0},
    "sea level": {},
    "10 kft": {"ALT_ft": 10000.0, "Mach": 0.4},
    "35 kft": {"ALT_ft": 35000.0, "Mach": 0.8},
}
_UP_S, _DOWN_S, _END_S = 2.0, 42.0, 82.0
_N1, _N2, _EGT, _FF, _FN = range(5)


class Slam(NamedTuple):
    """Idle to take-off at once, and back 40 s later; seconds from the lever's move."""

    idle_share: float  # net thrust of idle over that of take-off
    rise_s: float  # to 95 % of take-off thrust
    fall_s: float  # back to idle N1 + 5 %
    overshoot_pct: float  # of N1, over its command
    bloom_C: float  # EGT 15 s after the push, above its settled value
    surge_share: float  # largest HPC angle over that of surge


def log(angle: FloatArray, condition: str) -> dict[str, FloatArray]:
    """Inputs (time,) with the lever at `angle` (time,) in one of the `CONDITIONS`."""
    fixed = CONDITIONS[condition]
    found = {name: np.full(len(angle), fixed.get(name, 0.0)) for name in INPUT_NAMES}
    return found | {"TRA_deg": angle}


def weaving(duration_s: float) -> FloatArray:
    """A lever that always moves, at 32 Hz: (time,)."""
    t = np.arange(int(duration_s * HZ)) / HZ
    return np.asarray(42.5 - 42.5 * np.cos(0.25 * t) * np.cos(0.031 * t))


def at(engine: VirtualEngine, **inputs: float) -> FloatArray:
    """Settled outputs (7,) at take-off lever, sea level static, but for `inputs`."""
    return engine.outputs(np.array([inputs.get(n, 85.0 * (n == "TRA_deg")) for n in INPUT_NAMES]))


def slam(engine: VirtualEngine, condition: str) -> Slam:
    """Fly the slam in one of the `CONDITIONS`."""
    t = np.arange(int(_END_S * HZ)) / HZ
    angle = np.where((t >= _UP_S) & (t < _DOWN_S), 85.0, 0.0)
    run = engine.simulate(log(angle, condition), 1.0 / HZ)
    idle, top = (at(engine, TRA_deg=a, **CONDITIONS[condition]) for a in (0.0, 85.0))
    pushed = (t >= _UP_S) & (t < _DOWN_S)
    return Slam(
        idle_share=idle[_FN] / top[_FN],
        rise_s=float(t[np.argmax(pushed & (run["FN_kN"] >= 0.95 * top[_FN]))]) - _UP_S,
        fall_s=float(t[np.argmax((t >= _DOWN_S) & (run["N1_pct"] <= idle[_N1] + 5.0))]) - _DOWN_S,
        overshoot_pct=float(run["N1_pct"][pushed].max()) - top[_N1],
        bloom_C=float(np.interp(_UP_S + 15.0, t, run["EGT_C"])) - top[_EGT],
        surge_share=float(run["hpc_angle"].max()) / SURGE,
    )


def at_thrust(
    engine: VirtualEngine, place: tuple[float, float], shares: tuple[float, ...]
) -> FloatArray:
    """Inputs (n, 9) that give these shares of full thrust at `place` (altitude in ft, Mach).

    The ground idle reaches furthest down; a share that the lever cannot reach is taken at idle.
    """
    u = np.zeros((300, 9))
    u[:, 0], u[:, 1], u[:, 2], u[:, 4] = np.linspace(0.0, 85.0, len(u)), *place, 1.0
    thrust = engine.outputs(u)[:, _FN]
    found = u[: len(shares)].copy()
    found[:, 0] = np.interp(np.array(shares) * thrust[-1], thrust, u[:, 0])
    return found


def similarity(engine: VirtualEngine, altitude_ft: float) -> float:
    """Slow lag at altitude over that at sea level, both static, over `sqrt(theta) / delta`.

    At equal corrected N1 the law of NACA TR-1011 makes this one.
    """
    air = air_state(altitude_ft)
    up = np.zeros((1, 9))
    up[0, :2] = 40.0, altitude_ft
    wanted = float(engine.outputs(up)[0, _N1] / np.sqrt(air.theta2))
    u = np.zeros((300, 9))
    u[:, 0] = np.linspace(0.0, 85.0, len(u))
    low = u[:1].copy()
    low[0, 0] = np.interp(wanted, engine.outputs(u)[:, _N1], u[:, 0])
    ratio = engine.linearised(up)[0].lags_s[0] / engine.linearised(low)[0].lags_s[0]
    return float(ratio * air.delta2 / np.sqrt(air.theta2))


GROUP = "virtual engine"


class PublishedFigure(NamedTuple):
    """A published figure and that of each engine, in the order of `PRESETS`."""

    name: str
    unit: str
    published: str
    source: str
    ours: tuple[float, ...]


def rows(duration_s: float = 600.0, points: int = 1000) -> list[Row]:
    """Speed, and what has to hold exactly; the table of figures is this module's own command."""
    found = []
    for name in PRESETS:
        engine = VirtualEngine(name)
        ratio, note = _speed(engine, duration_s)
        pushed = slam(engine, "sea level")
        ours = "our goal: a flight of 10 minutes in 2 s"
        rule = "14 CFR 33.73: flight idle to 95 % of take-off thrust"
        found += [
            Row(GROUP, f"{name}, simulated", ratio, "x real time", 300.0, "at least", ours, note),
            Row(GROUP, f"{name}, slam to 95 % thrust", pushed.rise_s, "s", 5.0, "at most", rule),
            Row(
                GROUP,
                f"{name}, settled points without solution",
                float(_lost(engine, points)),
                "",
                0.0,
                "at most",
                "",
                f"{points} random points of the envelope",
            ),
        ]
    return found


def _speed(engine: VirtualEngine, duration_s: float) -> tuple[float, str]:
    """Simulated over wall time of a lever that always moves, after a run that compiles."""
    u = log(weaving(duration_s), "sea level")
    engine.simulate({name: value[:64] for name, value in u.items()}, 1.0 / 32.0)
    wall, busy = time.perf_counter(), time.process_time()
    engine.simulate(u, 1.0 / 32.0)
    wall, busy = time.perf_counter() - wall, time.process_time() - busy
    note = f"{duration_s:.0f} s at 32 Hz in {wall:.2f} s ({busy:.2f} s of one processor), "
    return duration_s / wall, note + "gas path solved at each step"


def _lost(engine: VirtualEngine, points: int) -> int:
    """How many of as many random points of the envelope have no settled solution."""
    u = np.random.default_rng(0).uniform(LOW, HIGH, (points, 9))
    u[:, 4:] = np.round(u[:, 4:])
    return sum(not _settles(engine, row) for row in u)


def _settles(engine: VirtualEngine, u: FloatArray) -> bool:
    try:
        engine.outputs(u)
    except ModelError:
        return False
    return True


def figures() -> list[PublishedFigure]:
    """All figures, measured now."""
    columns = [_column(VirtualEngine(name)) for name in PRESETS]
    return [
        PublishedFigure(*head, tuple(column[k] for column in columns))
        for k, head in enumerate(_PUBLISHED)
    ]


def markdown(found: Sequence[PublishedFigure]) -> str:
    """Format the figures as one table."""
    lines = [f"| figure | unit | published | source | {' | '.join(PRESETS)} |", "|---" * 6 + "|"]
    for row in found:
        ours = " | ".join(f"{value:.3g}" for value in row.ours)
        lines.append(f"| {row.name} | {row.unit} | {row.published} | {row.source} | {ours} |")
    return "\n".join(lines) + "\n"


# In the order of `_column`: name, unit, published, source.
_PUBLISHED = (
    ("flight idle over take-off thrust, sea level", "%", "<= 15", "14 CFR 33.73"),
    ("slam to 95 % thrust, sea level", "s", "<= 5", "14 CFR 33.73; AGTF30 4.9"),
    ("the same at 10 kft, Mach 0.4", "s", "5.8", "AGTF30"),
    ("the same at 35 kft, Mach 0.8", "s", "10.2", "AGTF30"),
    ("the same from ground idle", "s", "up to 8", "USA Today 2018"),
    ("chop, N1 to idle + 5 %, from flight idle", "s", "10 to 11.5", "AGTF30"),
    ("the same, ground idle", "s", "10 to 11.5", "AGTF30"),
    ("N1 over its command in a slam", "%", "<= 1", "own"),
    ("HPC angle of a slam over surge", "-", "< 1", "own"),
    (
        "slow time constant, max, sea level",
        "s",
        "0.30; 0.5 to 1.5",
        "AGTF30; unverified",
    ),
    ("the same at 10 % thrust", "s", "0.76; 2 to 4", "AGTF30; unverified"),
    ("idle over max, sea level", "-", "2.5", "AGTF30"),
    ("35 kft over sea level, max", "-", "3.5", "AGTF30"),
    ("the same at 10 % thrust", "-", "2", "AGTF30"),
    ("lags at 35 kft static, over the law of similarity", "-", "1", "NACA TR-1011"),
    ("EGT at once over final, max and 10 %", "-", "1.1 to 2.6", "AGTF30"),
    ("the same at 10 % thrust", "-", "1.1 to 2.6", "AGTF30"),
    ("EGT 15 s after a slam, above settled", "degC", "10 to 30", "unverified"),
    (
        "6 % bleed at constant N1, EGT",
        "degC",
        "18; 5 to 10 per %",
        "AGTF30; unverified",
    ),
    ("ECS, EGT at its lowered rating", "degC", "-", "-"),
    ("nacelle anti-ice, the same", "degC", "10 to 20", "unverified"),
    ("nacelle anti-ice, N1", "%", "-0.6 to -0.8", "A32NX"),
    ("+1 degC outside, EGT at flat rating", "degC", "3", "CFM56-7"),
    ("HPC efficiency -1 %, EGT at take-off N1", "degC", "7.0", "AGTF30"),
    ("the same, N2", "%", "-0.17", "AGTF30"),
    ("HPT efficiency -1 %, EGT", "degC", "9.7", "AGTF30"),
    ("the same, N2", "%", "-0.23", "AGTF30"),
    ("LPT efficiency -1 %, EGT", "degC", "6.5", "AGTF30"),
    ("the same, N2", "%", "+0.14", "AGTF30"),
    ("HPC flow -1 %, EGT", "degC", "1.6", "AGTF30"),
    ("the same, N2", "%", "+0.21", "AGTF30"),
    ("ground idle N1", "%", "20", "A320"),
    ("ground idle N2", "%", "60", "A320"),
    ("ground idle EGT", "degC", "400", "A320"),
    ("ground idle fuel", "kg/h", "300", "A320"),
    ("take-off thrust", "kN", "11.12; 120.1", "ICAO databank"),
    ("take-off fuel", "kg/s", "0.1697; 1.142", "ICAO databank"),
    ("largest map angle in equilibrium over surge", "-", "< 1", "own"),
)


def _column(engine: VirtualEngine) -> list[float]:
    return [*_manoeuvres(engine), *_lags(engine), *_shifts(engine), *_wear(engine), *_class(engine)]


def _manoeuvres(engine: VirtualEngine) -> list[float]:
    found = {name: slam(engine, name) for name in CONDITIONS}
    sea, ground = found["sea level"], found["ground"]
    return [
        100.0 * sea.idle_share,
        sea.rise_s,
        found["10 kft"].rise_s,
        found["35 kft"].rise_s,
        ground.rise_s,
        sea.fall_s,
        ground.fall_s,
        max(slam.overshoot_pct for slam in found.values()),
        max(slam.surge_share for slam in found.values()),
    ]


def _lags(engine: VirtualEngine) -> list[float]:
    """Time constants at sea level static and at 35 kft, 10 % and full thrust; EGT's overshoot."""
    low = engine.linearised(at_thrust(engine, (0.0, 0.0), (0.1, 1.0)))
    high = engine.linearised(at_thrust(engine, (35000.0, 0.78), (0.1, 1.0)))
    idle, top = (point.lags_s[0] for point in low)
    idle_up, top_up = (point.lags_s[0] for point in high)
    similar = similarity(engine, 35000.0)
    ratios = [idle / top, top_up / top, idle_up / idle, similar]
    return [top, idle, *ratios, low[1].overshoot, low[0].overshoot]


def _shifts(engine: VirtualEngine) -> list[float]:
    """EGT's bloom, bleeds, anti-ice and outside temperature."""
    effect = Unmodelled("bleed_extraction", {"share": 0.06})
    bled = VirtualEngine(engine.preset.name, unmodelled=[effect])
    plain, ecs, nai, warm = (at(engine, **on) for on in ({}, {"ECS": 1}, {"NAI": 1}, {"dT_C": 10}))
    return [
        slam(engine, "sea level").bloom_C,
        (at(bled, ECS=1) - ecs)[_EGT],
        (ecs - plain)[_EGT],
        (nai - plain)[_EGT],
        (nai - plain)[_N1],
        (warm - plain)[_EGT] / 10.0,
    ]


def _wear(engine: VirtualEngine) -> list[float]:
    """EGT and N2 by 1 % of each part, at take-off N1."""
    new, found = at(engine), []
    for part in ("hpc_efficiency", "hpt_efficiency", "lpt_efficiency", "hpc_flow"):
        worn = at(VirtualEngine(engine.preset.name, build=Health(**{part: 0.99})))
        found += [(worn - new)[_EGT], 100.0 * (worn / new - 1.0)[_N2]]
    return found


def _class(engine: VirtualEngine) -> list[float]:
    """Ground idle, take-off, and the equilibrium nearest to surge."""
    idle, top = at(engine, TRA_deg=0.0, WOW=1), at(engine)
    return [*idle[[_N1, _N2, _EGT, _FF]], top[_FN], top[_FF] / 3600.0, surge_share(engine)]


def surge_share(engine: VirtualEngine, points: int = 1000) -> float:
    """Largest map angle over that of surge, at random settled points of the envelope."""
    u = np.random.default_rng(0).uniform(LOW, HIGH, (points, 9))
    u[:, 4:] = np.round(u[:, 4:])
    u[: points // 3, 0] = 0.0
    u[:, 4] *= (u[:, 2] < 0.3) & (u[:, 1] < 12000.0)  # wheels on the ground
    solved = engine.gas_path(u)
    return float(max(solved[f"{part}_angle"].max() for part in COMPRESSORS) / SURGE)


if __name__ == "__main__":
    sys.stdout.write(markdown(figures()))
