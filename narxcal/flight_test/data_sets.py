"""Records in the shape of the calibration paper's data, and of what it left open.

Section 3.1 there: ten fast-acceleration data sets, which hold 152 fast pushes from low to high
thrust in climb, cruise and approach; left and right engine of one flight are two sets; every set
has a length of its own; the ranges of sets 5, 7 and 8 lie inside those of the others. Together
they span 0-12 km, Mach 0.3-0.85 and -30 .. +20 degC. The paper names as open: take-off and
landing, and the rate of the throttle; two further families of records fill those.

Modelled: five airborne records (ten sets) with a push about every 80 s, pulls at any rate in
between. The distribution over sets and angles is not given in the paper and is chosen here. Not
modelled: what comes between the flight conditions of a real test day, and a speed that answers
the lever (it does in `profile`). The paper's split has set 5 to test and 6, the other engine of
the same flight, to train; `flight` tells which belong together, for a split that keeps them so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from narxcal.flight_test.manoeuvres import travel
from narxcal.flight_test.paper_records import PAPER_RECORDS, Record, Window, circuits
from narxcal.flight_test.pilot import ENGINES, LATER_S, Placed, compose, draw_rate
from narxcal.flight_test.plan import seeded
from narxcal.flight_test.route import CHANNEL_NAMES, RATE_HZ, check_between, smoothed
from narxcal.support.arrays import FloatArray

_JITTER_DEG = 0.7
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
    """One engine's record: `channels` as `plan_flight` gives them, and the pushes in it."""

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


def _sets(records: Sequence[Record], seed: int, rate_hz: float) -> tuple[DataSet, ...]:
    check_between("rate_hz", rate_hz, *RATE_HZ)
    random = seeded(seed)
    sets: list[DataSet] = []
    for flight, record in enumerate(records, start=1):
        length = record.corners[-1][0] - random.uniform(0.0, 4.0)
        lengths = (length, length - random.uniform(5.0, 15.0))
        slots = _slots(record, random)
        for engine, count, stop in zip(ENGINES, record.pushes, lengths, strict=True):
            pushes, placed = _work(record, _kept(slots, count, random), random)
            time_s = np.arange(int(stop * rate_hz)) / rate_hz
            channels = _air(record, time_s)
            channels["TRA_deg"] = compose(placed, time_s, _start_deg(record))
            number = len(sets) + 1
            sets.append(DataSet(number, flight, engine, _ordered(channels), tuple(pushes)))
    return tuple(sets)


@dataclass(frozen=True)
class _Slot:
    """One pull and push of both levers; `high` None for a pull alone."""

    window: Window
    start_s: float
    length_s: float
    low: float
    high: float | None
    push_deg_s: float
    pull_deg_s: float


def _slots(record: Record, random: np.random.Generator) -> list[_Slot]:
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
    """Leave out as many pushes as leave `count`; never the first or last one of a window."""
    pushes = [slot for slot in slots if slot.high is not None]
    inner = [
        k
        for k, slot in enumerate(slots)
        if slot.high is not None
        and slot.window.start_s < slot.start_s < slot.window.stop_s - 1.5 * slot.length_s
    ]
    out = set(random.permutation(inner)[: len(pushes) - count].tolist())
    return [slot for k, slot in enumerate(slots) if k not in out]


def _start_deg(record: Record) -> float:
    """Lever at the first sample: in the middle of where the first push ends, idle on the ground."""
    return 0.0 if record.ground else float(np.mean(record.windows[0].high))


def _work(
    record: Record, slots: list[_Slot], random: np.random.Generator
) -> tuple[list[Push], list[Placed]]:
    """Place pulls and pushes of one lever, each a little late and a little off."""
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


def _air(record: Record, time_s: FloatArray) -> dict[str, FloatArray]:
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


def _ordered(channels: dict[str, FloatArray]) -> dict[str, FloatArray]:
    return {name: channels[name] for name in CHANNEL_NAMES}
