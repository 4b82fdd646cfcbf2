"""Stand-in pilot: seeded lever, altitude and Mach profiles that work the stand-in engine hard.

A flight is compressed into minutes (it climbs several times faster than an aircraft would) but
keeps the order of things: taxi, take-off, climb, cruise with step climbs, descent, approach,
go-around, landing. Phases are shares of the duration, so any length works.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from narxcal.errors import ConfigError
from narxcal.standin import INPUT_NAMES, FloatArray, StandInEngine

SHORTEST_S = 120.0
# One standard deviation: speeds and temperature as recorded in flight tests (FACTS A8).
NOISE = {"N1_pct": 0.05, "N2_pct": 0.05, "EGT_C": 1.0, "FF_kgph": 0.005, "TRA_deg": 0.02}


@dataclass(frozen=True)
class _Phase:
    """Lever moves between `start` and `stop` (shares of the flight) round a `base` angle (deg).

    Each move goes to a drawn angle in `low .. high`; `seconds` is the mean time between moves.
    """

    start: float
    stop: float
    base: float
    low: float
    high: float
    seconds: float


_PHASES = (
    _Phase(0.00, 0.12, base=0.0, low=4.0, high=30.0, seconds=14.0),  # taxi
    _Phase(0.12, 0.18, base=80.0, low=76.0, high=82.0, seconds=20.0),  # take-off
    _Phase(0.18, 0.36, base=70.0, low=40.0, high=80.0, seconds=18.0),  # climb
    _Phase(0.36, 0.62, base=52.0, low=8.0, high=82.0, seconds=17.0),  # cruise
    _Phase(0.62, 0.78, base=4.0, low=0.0, high=45.0, seconds=18.0),  # descent
    _Phase(0.78, 0.88, base=32.0, low=12.0, high=55.0, seconds=15.0),  # approach
    _Phase(0.88, 0.94, base=82.0, low=78.0, high=82.0, seconds=30.0),  # go-around
    _Phase(0.94, 1.00, base=3.0, low=0.0, high=20.0, seconds=14.0),  # landing, roll-out
)
# Share of the flight -> share of the top altitude, Mach.
_ALTITUDE = ((0, 0), (0.16, 0), (0.36, 0.8), (0.45, 0.8), (0.47, 1.0), (0.62, 1.0), (0.80, 0.10))
_ALTITUDE_END = ((0.88, 0.03), (0.93, 0.08), (0.975, 0.0), (1.0, 0.0))
_MACH = ((0, 0.0), (0.12, 0.0), (0.16, 0.24), (0.36, 0.62), (0.62, 0.68), (0.80, 0.34))
_MACH_END = ((0.88, 0.24), (0.93, 0.28), (0.975, 0.21), (1.0, 0.03))
_LIFT_OFF, _TOUCH_DOWN = 0.165, 0.975


def fly(seed: int, duration_s: float = 480.0, rate_hz: float = 32.0) -> dict[str, FloatArray]:
    """Record one flight: `time_s`, the inputs and the noisy outputs, each `(time,)`.

    The same arguments give the same numbers. Raises `ConfigError` for a flight too short to
    hold its phases.
    """
    if duration_s < SHORTEST_S:
        raise ConfigError(
            f"a stand-in flight lasts at least {SHORTEST_S:g} s, got {duration_s:g} s"
        )
    random = np.random.default_rng([20260101, seed])
    time_s = np.arange(round(duration_s * rate_hz)) / rate_hz
    inputs = profile(random, time_s, duration_s)
    outputs = StandInEngine().simulate(inputs, 1.0 / rate_hz)
    flight = {"time_s": time_s, **inputs, **outputs}
    for name, sigma in NOISE.items():
        scale = flight[name] if name == "FF_kgph" else 1.0
        flight[name] = flight[name] + sigma * scale * random.standard_normal(len(time_s))
    return flight


def profile(
    random: np.random.Generator, time_s: FloatArray, duration_s: float
) -> dict[str, FloatArray]:
    """Draw what the pilot and the day do over `time_s`: `INPUT_NAMES`, each `(time,)`."""
    share = time_s / duration_s
    top_ft = random.uniform(12_000.0, 30_000.0)
    stamps, angles = np.array(list(_lever(random, duration_s))).T
    altitude = np.array(_ALTITUDE + _ALTITUDE_END).T
    mach = np.array(_MACH + _MACH_END).T
    columns = {
        "TRA_deg": np.interp(time_s, stamps, angles),
        "ALT_ft": top_ft * _smooth(np.interp(share, *altitude), time_s),
        "Mach": _smooth(np.interp(share, *mach), time_s),
        "dT_C": random.uniform(-10.0, 15.0) + 2.0 * np.sin(2.0 * np.pi * share),
        "WOW": ((share < _LIFT_OFF) | (share >= _TOUCH_DOWN)).astype(float),
        "Approach": ((share >= 0.80) & (share < _TOUCH_DOWN)).astype(float),
        "ECS": (share >= 0.05).astype(float),
        "NAI": ((share >= 0.70) & (share < 0.80)).astype(float),
        "WAI": np.zeros_like(time_s),
    }
    return {name: columns[name] for name in INPUT_NAMES}


def _lever(random: np.random.Generator, duration_s: float) -> Iterator[tuple[float, float]]:
    """Corner points (time, angle) of the lever: fast, slow and small moves, and re-slams."""
    rested, angle = 0.0, 0.0
    yield rested, angle
    for phase in _PHASES:
        # The last move of the phase before may still be under way.
        clock, target = max(rested, phase.start * duration_s), phase.base
        while clock < phase.stop * duration_s - 4.0:
            yield clock, angle
            rested = clock + _move_s(random, abs(target - angle))
            yield rested, target
            angle = target
            hold = phase.seconds * random.uniform(0.6, 1.4)
            if random.random() < 0.12 and phase.seconds < 20.0:
                hold = random.uniform(0.8, 2.5)  # a re-slam: the engine has not settled yet
            clock = rested + hold
            target = _next_angle(random, phase, angle)


def _move_s(random: np.random.Generator, travel_deg: float) -> float:
    """Duration of a move: most large ones are slams, the rest are unhurried."""
    if travel_deg < 10.0:
        return float(random.uniform(0.4, 1.5))
    slam = random.random() < 0.7
    return float(random.uniform(0.4, 1.0) if slam else random.uniform(4.0, 8.0))


def _next_angle(random: np.random.Generator, phase: _Phase, angle: float) -> float:
    """Draw a small correction one time in five, else a new angle a good way off, in range."""
    if random.random() < 0.2:
        step = float(random.choice((-1.0, 1.0)) * random.uniform(3.0, 8.0))
        return min(max(angle + step, phase.low), phase.high)
    drawn = random.uniform(phase.low, phase.high, size=2)
    return float(drawn[np.argmax(np.abs(drawn - angle))])


def _smooth(values: FloatArray, time_s: FloatArray, width_s: float = 6.0) -> FloatArray:
    """Round the corners of a profile: no aircraft changes climb rate in one sample."""
    half = max(1, round(0.5 * width_s / (time_s[1] - time_s[0])))
    padded = np.pad(values, half, mode="edge")
    sums = np.cumsum(np.insert(padded, 0, 0.0))
    return np.asarray((sums[2 * half + 1 :] - sums[: -2 * half - 1]) / (2 * half + 1))
