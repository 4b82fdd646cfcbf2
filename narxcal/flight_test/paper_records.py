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

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from typing import Any, NamedTuple

import numpy as np

from narxcal.flight_test.manoeuvres import travel
from narxcal.flight_test.pilot import LATER_S, SIDES, Placed, compose, draw_rate
from narxcal.flight_test.plan import seeded
from narxcal.flight_test.route import CHANNEL_NAMES, smoothed
from narxcal.support.arrays import FloatArray

_FAST_PUSH = (35.0, 120.0)


@dataclass(frozen=True)
class PushWindow:
    """Part of a record with `pushes` of the lever at equal intervals.

    Each goes from an angle drawn in `low` to one drawn in `high` (deg), after a pull where one
    is needed. Without pushes the lever is pulled into `low` at the beginning.
    """

    start_s: float
    stop_s: float
    pushes: int
    low: tuple[float, float]
    high: tuple[float, float]

    def later(self, seconds: float) -> PushWindow:
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


_TABLES = tomllib.loads(files(__package__).joinpath("paper_records.toml").read_text("utf-8"))


def _windows(rows: Sequence[Sequence[Any]]) -> tuple[PushWindow, ...]:
    return tuple(
        PushWindow(start_s, stop_s, pushes, tuple(low), tuple(high))
        for _, start_s, stop_s, pushes, low, high in rows
    )


def _record(table: Mapping[str, Any]) -> FlownRecord:
    """An airborne record that ends on approach."""
    windows = _windows(table["windows"])
    corners = tuple(map(tuple, table["corners"]))
    approach = ((windows[-1].start_s, corners[-1][0]),)
    return FlownRecord(corners, windows, tuple(table["pushes"]), approach=approach)


PAPER_RECORDS = tuple(_record(table) for table in _TABLES["flights"])
_CIRCUIT: list[tuple[float, float, float]] = _TABLES["circuit"]["corners"]
_CIRCUIT_WINDOWS = _windows(_TABLES["circuit"]["windows"])
_CIRCUIT_S, _CIRCUITS = _CIRCUIT[-1][0], 4
_LIFT_OFF_S, _TOUCH_DOWN_S = 60.0, 576.0
_APPROACHES_S = ((262.0, 395.0), (450.0, _TOUCH_DOWN_S))


def circuits(field_ft: float, dT_C: float) -> FlownRecord:
    """Plan take-off, approach with a low go-around, and approach to a full stop, four times."""
    starts = [k * _CIRCUIT_S for k in range(_CIRCUITS)]
    return FlownRecord(
        corners=tuple(
            (start + time, field_ft + height, mach, dT_C)
            for start in starts
            for time, height, mach in _CIRCUIT
        ),
        windows=tuple(window.later(start) for start in starts for window in _CIRCUIT_WINDOWS),
        pushes=(7 * _CIRCUITS, 7 * _CIRCUITS),
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


class DataSet(NamedTuple):
    """One engine's record: `channels` (time,) as `plan_flight` returns them."""

    flight: int
    engine: str
    channels: dict[str, FloatArray]


def fast_push_sets(seed: int, rate_hz: float) -> tuple[DataSet, ...]:
    """Record the ten fast-acceleration data sets of the paper's section 3.1: 152 pushes."""
    return _sets(PAPER_RECORDS, seed, rate_hz)


def throttle_rate_sets(seed: int, rate_hz: float) -> tuple[DataSet, ...]:
    """Record the same flights with pushes and pulls from 3 deg/s to slam."""
    rates = (3.0, 120.0)
    varied = [replace(one, push_deg_s=rates, pull_deg_s=rates) for one in PAPER_RECORDS]
    return _sets(varied, seed, rate_hz)


def take_off_approach_sets(seed: int, rate_hz: float) -> tuple[DataSet, ...]:
    """Record take-offs, approaches, go-arounds and landings: five flights of four circuits."""
    return _sets([circuits(field_ft, dT_C) for field_ft, dT_C in _FIELDS], seed, rate_hz)


def _sets(records: Sequence[FlownRecord], seed: int, rate_hz: float) -> tuple[DataSet, ...]:
    random = seeded(seed)
    sets: list[DataSet] = []
    for flight, record in enumerate(records, start=1):
        length = record.corners[-1][0] - random.uniform(0.0, 4.0)
        lengths = (length, length - random.uniform(5.0, 15.0))
        slots = _slots(record, random)
        for engine, count, stop in zip(SIDES, record.pushes, lengths, strict=True):
            placed = _placed(record, _kept(slots, count, random), random)
            time_s = np.arange(int(stop * rate_hz)) / rate_hz
            channels = _air(record, time_s)
            channels["TRA_deg"] = compose(placed, time_s, _start_deg(record))
            sets.append(DataSet(flight, engine, {name: channels[name] for name in CHANNEL_NAMES}))
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


def _placed(record: FlownRecord, slots: list[_Slot], random: np.random.Generator) -> list[Placed]:
    """Place pulls and pushes of one lever, each with a small random error of time and angle."""
    angle, placed = _start_deg(record), []
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
        placed.append(Placed(start, travel(high - angle, rate)))
        angle = high
    return placed


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
