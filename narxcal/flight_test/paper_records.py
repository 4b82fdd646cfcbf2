"""Records in the shape of the calibration paper's data, and two families for what it left open.

Section 3.1 of the paper: ten data sets with 152 fast pushes from low to high thrust in climb,
cruise and approach. The left and the right engine of one flight are two sets, and each set has a
length of its own. Together they span 0-12 km, Mach 0.3-0.85 and -30 .. +20 degC off the standard
day; the ranges of sets 5, 7 and 8 lie inside those of the others. The paper leaves take-off and
landing and the rate of the throttle open; the two further families are for these.

The paper publishes ranges, not conditions. The conditions below and the distribution of the pushes
over sets and angles are chosen here, so that flights 1, 2 and 5 span the envelope and 3 and 4 stay
well inside. Modelled: corners of altitude, Mach number and temperature deviation over time, and a
push about every 80 s with pulls at any rate in between. Not modelled: what lies between the flight
conditions of a real test day, and a speed that follows the lever (`plan_flight` has it).

The paper tests on set 5 and trains on set 6, the other engine of the same flight; `flight` says
which sets belong together, for a split that keeps them so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from narxcal.flight_test.manoeuvres import travel
from narxcal.flight_test.pilot import LATER_S, SIDES, Placed, compose, draw_rate
from narxcal.flight_test.plan import seeded
from narxcal.flight_test.route import (
    CEILING_FT,
    CHANNEL_NAMES,
    DT_HIGH_C,
    DT_LOW_C,
    MACH_MAX,
    RATE_HZ,
    check_between,
    smoothed,
)
from narxcal.support.arrays import FloatArray

_FAST_PUSH = (35.0, 120.0)


@dataclass(frozen=True)
class PushWindow:
    """Part of a record with `pushes` of the lever at equal intervals.

    Each goes from an angle drawn in `low` to one drawn in `high` (deg), after a pull where one
    is needed. Without pushes the lever is pulled into `low` at the beginning.
    """

    phase: str
    start_s: float
    stop_s: float
    pushes: int
    low: tuple[float, float]
    high: tuple[float, float]

    def later(self, seconds: float) -> PushWindow:
        """Return the same window, `seconds` later."""
        return replace(self, start_s=self.start_s + seconds, stop_s=self.stop_s + seconds)


@dataclass(frozen=True)
class FlownRecord:
    """One flight: corners of (time in s, ft, Mach, dT in degC), and windows of pushes.

    ground, approach: spans in s of weight on wheels and of approach idle. pushes: how many the
    left and the right engine fly; a lever that leaves one out does not move meanwhile. Rates of
    pushes and pulls are drawn from `push_deg_s` and `pull_deg_s`, log-uniformly. round_s: time
    over which corners are rounded.
    """

    corners: tuple[tuple[float, float, float, float], ...]
    windows: tuple[PushWindow, ...]
    pushes: tuple[int, int]
    ground: tuple[tuple[float, float], ...] = ()
    approach: tuple[tuple[float, float], ...] = ()
    push_deg_s: tuple[float, float] = _FAST_PUSH
    pull_deg_s: tuple[float, float] = (6.0, 100.0)
    round_s: float = 30.0


def _record(
    corners: tuple[tuple[float, float, float, float], ...],
    windows: tuple[PushWindow, ...],
    pushes: tuple[int, int],
) -> FlownRecord:
    """An airborne record that ends on approach."""
    approach = (windows[-1].start_s, corners[-1][0])
    return FlownRecord(corners, windows, pushes, approach=(approach,))


_LOW, _HIGH = (2.0, 30.0), (60.0, 84.0)
_INNER_LOW, _INNER_HIGH = (13.0, 30.0), (52.0, 73.0)
_DESCENT = (2.0, 6.0)

# Corners: time in s, pressure altitude in ft, Mach, degC off the standard day.
PAPER_RECORDS = (
    _record(
        (
            (0.0, 0.0, 0.30, DT_LOW_C),
            (70.0, 0.0, 0.30, DT_LOW_C),
            (340.0, 15_000.0, 0.55, -27.0),
            (1240.0, CEILING_FT, 0.80, -24.0),
            (1420.0, CEILING_FT, MACH_MAX, -24.0),
            (1960.0, CEILING_FT, MACH_MAX, -24.0),
            (2080.0, CEILING_FT, 0.78, -24.0),
            (2800.0, 4000.0, 0.40, -28.0),
            (3400.0, 300.0, 0.32, -29.0),
        ),
        (
            PushWindow("climb", 60.0, 1180.0, 7, _LOW, _HIGH),
            PushWindow("cruise", 1240.0, 1960.0, 7, _LOW, (50.0, 82.0)),
            PushWindow("descent", 1990.0, 2760.0, 0, _DESCENT, _DESCENT),
            PushWindow("approach", 2800.0, 3340.0, 4, (4.0, 20.0), (45.0, 84.0)),
        ),
        (18, 17),
    ),
    _record(
        (
            (0.0, 500.0, 0.32, DT_HIGH_C),
            (60.0, 500.0, 0.32, DT_HIGH_C),
            (420.0, 14_000.0, 0.52, 14.0),
            (900.0, 26_000.0, 0.70, 4.0),
            (1000.0, 26_000.0, 0.74, 4.0),
            (1480.0, 26_000.0, 0.74, 4.0),
            (1560.0, 26_000.0, 0.70, 4.0),
            (1960.0, 3500.0, 0.42, 15.0),
            (2060.0, 3500.0, 0.36, 17.0),
            (2500.0, 400.0, 0.31, 19.0),
        ),
        (
            PushWindow("climb", 60.0, 900.0, 6, _LOW, _HIGH),
            PushWindow("cruise", 930.0, 1470.0, 6, _LOW, (50.0, 82.0)),
            PushWindow("descent", 1490.0, 1940.0, 0, _DESCENT, _DESCENT),
            PushWindow("approach", 1980.0, 2440.0, 4, (4.0, 20.0), (45.0, 84.0)),
        ),
        (16, 15),
    ),
    _record(
        (
            (0.0, 4000.0, 0.36, 0.0),
            (60.0, 4000.0, 0.36, 0.0),
            (360.0, 16_000.0, 0.56, -4.0),
            (860.0, 33_000.0, 0.72, -10.0),
            (960.0, 33_000.0, 0.76, -10.0),
            (1400.0, 33_000.0, 0.76, -10.0),
            (1480.0, 33_000.0, 0.72, -10.0),
            (2000.0, 6000.0, 0.44, -3.0),
            (2080.0, 6000.0, 0.40, -3.0),
            (2480.0, 3000.0, 0.37, 0.0),
        ),
        (
            PushWindow("climb", 60.0, 840.0, 5, _INNER_LOW, _INNER_HIGH),
            PushWindow("cruise", 880.0, 1380.0, 5, _INNER_LOW, _INNER_HIGH),
            PushWindow("descent", 1410.0, 1990.0, 0, (8.0, 12.0), (8.0, 12.0)),
            PushWindow("approach", 2040.0, 2420.0, 4, (9.0, 20.0), _INNER_HIGH),
        ),
        (14, 13),
    ),
    _record(
        (
            (0.0, 6000.0, 0.38, 10.0),
            (60.0, 6000.0, 0.38, 10.0),
            (400.0, 18_000.0, 0.58, 6.0),
            (760.0, 29_000.0, 0.70, -2.0),
            (840.0, 29_000.0, 0.72, -2.0),
            (1260.0, 29_000.0, 0.72, -2.0),
            (1340.0, 29_000.0, 0.70, 0.0),
            (1800.0, 7000.0, 0.45, 6.0),
            (1880.0, 7000.0, 0.41, 6.0),
            (2320.0, 4000.0, 0.37, 9.0),
        ),
        (
            PushWindow("climb", 60.0, 740.0, 5, _INNER_LOW, _INNER_HIGH),
            PushWindow("cruise", 770.0, 1250.0, 6, _INNER_LOW, _INNER_HIGH),
            PushWindow("descent", 1280.0, 1800.0, 0, (8.0, 12.0), (8.0, 12.0)),
            PushWindow("approach", 1840.0, 2260.0, 4, (9.0, 20.0), _INNER_HIGH),
        ),
        (15, 14),
    ),
    _record(
        (
            (0.0, 3000.0, 0.36, 2.0),
            (60.0, 3000.0, 0.36, 2.0),
            (400.0, 17_000.0, 0.58, -10.0),
            (1000.0, 36_000.0, 0.78, -20.0),
            (1150.0, 36_000.0, 0.82, -20.0),
            (1500.0, 36_000.0, 0.82, -20.0),
            (1640.0, 38_500.0, 0.82, -18.0),
            (1900.0, 38_500.0, 0.82, -18.0),
            (1980.0, 38_500.0, 0.78, -18.0),
            (2640.0, 5000.0, 0.42, -8.0),
            (2760.0, 5000.0, 0.36, -6.0),
            (3160.0, 1500.0, 0.31, -2.0),
        ),
        (
            PushWindow("climb", 60.0, 980.0, 6, _LOW, (78.0, 84.0)),
            PushWindow("cruise", 1010.0, 1880.0, 6, _LOW, (50.0, 82.0)),
            PushWindow("descent", 1910.0, 2640.0, 0, _DESCENT, _DESCENT),
            PushWindow("approach", 2680.0, 3100.0, 4, (4.0, 20.0), (45.0, 84.0)),
        ),
        (16, 14),
    ),
)

_CIRCUIT_S = 640.0
# Time in s, height above the field in ft, Mach.
_CIRCUIT = (
    (0.0, 0.0, 0.0),
    (30.0, 0.0, 0.0),
    (66.0, 0.0, 0.21),
    (160.0, 2500.0, 0.30),
    (260.0, 2500.0, 0.30),
    (382.0, 400.0, 0.22),
    (450.0, 1500.0, 0.24),
    (560.0, 50.0, 0.21),
    (570.0, 0.0, 0.20),
    (615.0, 0.0, 0.0),
    (_CIRCUIT_S, 0.0, 0.0),
)
_CIRCUIT_WINDOWS = (
    PushWindow("take-off", 0.0, 40.0, 1, (0.0, 0.0), (72.0, 84.0)),
    PushWindow("climb", 64.0, 160.0, 1, (30.0, 55.0), (70.0, 84.0)),
    PushWindow("downwind", 165.0, 255.0, 1, (12.0, 30.0), (40.0, 60.0)),
    PushWindow("approach", 262.0, 390.0, 2, (4.0, 22.0), (55.0, 84.0)),
    PushWindow("final", 455.0, 549.0, 2, (6.0, 24.0), (40.0, 70.0)),
    PushWindow("landing", 552.0, 575.0, 0, (0.0, 0.0), (0.0, 0.0)),
)
_LIFT_OFF_S, _TOUCH_DOWN_S = 60.0, 576.0
_APPROACHES_S = ((262.0, 395.0), (450.0, _TOUCH_DOWN_S))


def circuits(field_ft: float, dT_C: float, count: int = 4) -> FlownRecord:
    """Plan take-off, approach with a low go-around, and approach to a full stop, `count` times."""
    starts = [k * _CIRCUIT_S for k in range(count)]
    return FlownRecord(
        corners=tuple(
            (start + time, field_ft + height, mach, dT_C)
            for start in starts
            for time, height, mach in _CIRCUIT
        ),
        windows=tuple(window.later(start) for start in starts for window in _CIRCUIT_WINDOWS),
        pushes=(7 * count, 7 * count),
        ground=tuple(
            span
            for start in starts
            for span in (
                (start, start + _LIFT_OFF_S),
                (start + _TOUCH_DOWN_S, start + _CIRCUIT_S),
            )
        ),
        approach=tuple(
            (start + first, start + last) for start in starts for first, last in _APPROACHES_S
        ),
        round_s=10.0,
    )


_JITTER_DEG = 0.7  # random error of an angle
# Of the circuits: pressure altitude of the field in ft, temperature deviation in degC.
_FIELDS = ((300.0, -12.0), (1500.0, 3.0), (2500.0, 16.0), (4500.0, 19.0), (100.0, -27.0))


@dataclass(frozen=True)
class Push:
    """A push of one engine's lever: when it begins, in which phase, and how."""

    start_s: float
    phase: str
    before_deg: float
    after_deg: float
    rate_deg_s: float


@dataclass(frozen=True, eq=False)
class DataSet:
    """One engine's record: `channels` (time,) as `plan_flight` returns them, and its pushes."""

    number: int
    flight: int
    engine: str
    channels: dict[str, FloatArray]
    pushes: tuple[Push, ...]


def fast_push_sets(seed: int, rate_hz: float = 32.0) -> tuple[DataSet, ...]:
    """Record the ten fast-acceleration data sets of the paper's section 3.1: 152 pushes."""
    return _sets(PAPER_RECORDS, seed, rate_hz)


def throttle_rate_sets(seed: int, rate_hz: float = 32.0) -> tuple[DataSet, ...]:
    """Record the same flights with pushes and pulls from 3 deg/s to slam."""
    rates = (3.0, 120.0)
    varied = [replace(one, push_deg_s=rates, pull_deg_s=rates) for one in PAPER_RECORDS]
    return _sets(varied, seed, rate_hz)


def take_off_approach_sets(seed: int, rate_hz: float = 32.0) -> tuple[DataSet, ...]:
    """Record take-offs, approaches, go-arounds and landings: five flights of four circuits.

    Fields and days of the last two enclose those of the others.
    """
    return _sets([circuits(field_ft, dT_C) for field_ft, dT_C in _FIELDS], seed, rate_hz)


def _sets(records: Sequence[FlownRecord], seed: int, rate_hz: float) -> tuple[DataSet, ...]:
    check_between("rate_hz", rate_hz, *RATE_HZ)
    random = seeded(seed)
    sets: list[DataSet] = []
    for flight, record in enumerate(records, start=1):
        length = record.corners[-1][0] - random.uniform(0.0, 4.0)
        lengths = (length, length - random.uniform(5.0, 15.0))
        slots = _slots(record, random)
        for engine, count, stop in zip(SIDES, record.pushes, lengths, strict=True):
            pushes, placed = _placed(record, _kept(slots, count, random), random)
            time_s = np.arange(int(stop * rate_hz)) / rate_hz
            channels = _air(record, time_s)
            channels["TRA_deg"] = compose(placed, time_s, _start_deg(record))
            ordered = {name: channels[name] for name in CHANNEL_NAMES}
            sets.append(DataSet(len(sets) + 1, flight, engine, ordered, tuple(pushes)))
    return tuple(sets)


@dataclass(frozen=True)
class _Slot:
    """One pull and push of both levers; `high` is None for a pull alone."""

    window: PushWindow
    start_s: float
    length_s: float
    low: float
    high: float | None
    push_deg_s: float
    pull_deg_s: float


def _slots(record: FlownRecord, random: np.random.Generator) -> list[_Slot]:
    slots = []
    for window in record.windows:
        length = (window.stop_s - window.start_s) / max(1, window.pushes)
        for k in range(max(1, window.pushes)):
            slot = _Slot(
                window=window,
                start_s=window.start_s + k * length,
                length_s=length,
                low=random.uniform(*window.low),
                high=random.uniform(*window.high) if window.pushes else None,
                push_deg_s=draw_rate(random, *record.push_deg_s),
                pull_deg_s=draw_rate(random, *record.pull_deg_s),
            )
            slots.append(slot)
    return slots


def _kept(slots: list[_Slot], count: int, random: np.random.Generator) -> list[_Slot]:
    """Drop pushes until `count` are left; never the first or the last one of a window."""
    pushes = [slot for slot in slots if slot.high is not None]
    inner = [
        k
        for k, slot in enumerate(slots)
        if slot.high is not None
        and slot.window.start_s < slot.start_s < slot.window.stop_s - 1.5 * slot.length_s
    ]
    out = set(random.permutation(inner)[: len(pushes) - count].tolist())
    return [slot for k, slot in enumerate(slots) if k not in out]


def _start_deg(record: FlownRecord) -> float:
    """Lever at the first sample: where the first push ends on average, idle on the ground."""
    return 0.0 if record.ground else float(np.mean(record.windows[0].high))


def _placed(
    record: FlownRecord, slots: list[_Slot], random: np.random.Generator
) -> tuple[list[Push], list[Placed]]:
    """Place pulls and pushes of one lever, each with a small random error of time and angle."""
    angle, pushes, placed = _start_deg(record), [], []
    for slot in slots:
        clock = slot.start_s + random.uniform(*LATER_S)
        off = random.uniform(-_JITTER_DEG, _JITTER_DEG)
        low = max(0.0, slot.low + off) if slot.low > 0.0 else 0.0
        if low < angle - 3.0:
            pull = travel(low - angle, max(slot.pull_deg_s, (angle - low) / (0.35 * slot.length_s)))
            placed.append(Placed(clock, pull))
            angle = low
        if slot.high is None:
            continue
        start = slot.start_s + slot.length_s * 0.58 + random.uniform(*LATER_S)
        high = slot.high + random.uniform(-_JITTER_DEG, _JITTER_DEG)
        rate = max(slot.push_deg_s, (high - angle) / (0.25 * slot.length_s))
        pushes.append(Push(start, slot.window.phase, angle, high, rate))
        placed.append(Placed(start, travel(high - angle, rate)))
        angle = high
    return pushes, placed


def _air(record: FlownRecord, time_s: FloatArray) -> dict[str, FloatArray]:
    times, *columns = np.array(record.corners).T
    names = ("ALT_ft", "Mach", "dT_C")
    channels = {
        name: smoothed(np.interp(time_s, times, column), time_s, record.round_s)
        for name, column in zip(names, columns, strict=True)
    }
    channels |= {"time_s": time_s, "ECS": np.ones_like(time_s)}
    for name, spans in (("WOW", record.ground), ("Approach", record.approach)):
        channels[name] = np.zeros_like(time_s)
        for start, stop in spans:
            channels[name][(time_s >= start) & (time_s < stop)] = 1.0
    return channels | {"NAI": np.zeros_like(time_s), "WAI": np.zeros_like(time_s)}
