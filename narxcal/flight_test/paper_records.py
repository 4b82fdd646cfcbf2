"""The flight conditions of the recorded data sets: how each flies, and where the levers work.

Modelled: corners of altitude, Mach number and temperature deviation over time, and windows of
pushes. The paper of the data sets publishes their ranges, not their conditions: those below are
chosen so that flights 1, 2 and 5 span the envelope and 3 and 4 stay well inside.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from narxcal.flight_test.route import CEILING_FT, DT_HIGH_C, DT_LOW_C, MACH_MAX

_FAST_PUSH = (35.0, 120.0)


@dataclass(frozen=True)
class Window:
    """A stretch of a record with `pushes` of the lever, at equal distances in time.

    Each goes from an angle drawn in `low` to one drawn in `high` (deg), after a pull where one
    is needed. Without pushes the lever is pulled into `low` at the beginning.
    """

    phase: str
    start_s: float
    stop_s: float
    pushes: int
    low: tuple[float, float]
    high: tuple[float, float]

    def later(self, seconds: float) -> Window:
        """The same, `seconds` later."""
        return replace(self, start_s=self.start_s + seconds, stop_s=self.stop_s + seconds)


@dataclass(frozen=True)
class Record:
    """One flight: corners of (time in s, ft, Mach, dT in degC), windows, and both pushes' counts.

    ground, approach: spans in s of weight on wheels and of approach idle. pushes: how many the
    left and the right engine fly; the one with fewer stays where it is meanwhile. Rates of pushes
    and pulls are drawn in `push_deg_s` and `pull_deg_s`, every octave as often.
    """

    corners: tuple[tuple[float, float, float, float], ...]
    windows: tuple[Window, ...]
    pushes: tuple[int, int]
    ground: tuple[tuple[float, float], ...] = ()
    approach: tuple[tuple[float, float], ...] = ()
    push_deg_s: tuple[float, float] = _FAST_PUSH
    pull_deg_s: tuple[float, float] = (6.0, 100.0)
    round_s: float = 30.0


def _record(
    corners: tuple[tuple[float, float, float, float], ...],
    windows: tuple[Window, ...],
    pushes: tuple[int, int],
) -> Record:
    """Build an airborne record that ends on approach."""
    approach = (windows[-1].start_s, corners[-1][0])
    return Record(corners, windows, pushes, approach=(approach,))


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
            Window("climb", 60.0, 1180.0, 7, _LOW, _HIGH),
            Window("cruise", 1240.0, 1960.0, 7, _LOW, (50.0, 82.0)),
            Window("descent", 1990.0, 2760.0, 0, _DESCENT, _DESCENT),
            Window("approach", 2800.0, 3340.0, 4, (4.0, 20.0), (45.0, 84.0)),
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
            Window("climb", 60.0, 900.0, 6, _LOW, _HIGH),
            Window("cruise", 930.0, 1470.0, 6, _LOW, (50.0, 82.0)),
            Window("descent", 1490.0, 1940.0, 0, _DESCENT, _DESCENT),
            Window("approach", 1980.0, 2440.0, 4, (4.0, 20.0), (45.0, 84.0)),
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
            Window("climb", 60.0, 840.0, 5, _INNER_LOW, _INNER_HIGH),
            Window("cruise", 880.0, 1380.0, 5, _INNER_LOW, _INNER_HIGH),
            Window("descent", 1410.0, 1990.0, 0, (8.0, 12.0), (8.0, 12.0)),
            Window("approach", 2040.0, 2420.0, 4, (9.0, 20.0), _INNER_HIGH),
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
            Window("climb", 60.0, 740.0, 5, _INNER_LOW, _INNER_HIGH),
            Window("cruise", 770.0, 1250.0, 6, _INNER_LOW, _INNER_HIGH),
            Window("descent", 1280.0, 1800.0, 0, (8.0, 12.0), (8.0, 12.0)),
            Window("approach", 1840.0, 2260.0, 4, (9.0, 20.0), _INNER_HIGH),
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
            Window("climb", 60.0, 980.0, 6, _LOW, (78.0, 84.0)),
            Window("cruise", 1010.0, 1880.0, 6, _LOW, (50.0, 82.0)),
            Window("descent", 1910.0, 2640.0, 0, _DESCENT, _DESCENT),
            Window("approach", 2680.0, 3100.0, 4, (4.0, 20.0), (45.0, 84.0)),
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
    Window("take-off", 0.0, 40.0, 1, (0.0, 0.0), (72.0, 84.0)),
    Window("climb", 64.0, 160.0, 1, (30.0, 55.0), (70.0, 84.0)),
    Window("downwind", 165.0, 255.0, 1, (12.0, 30.0), (40.0, 60.0)),
    Window("approach", 262.0, 390.0, 2, (4.0, 22.0), (55.0, 84.0)),
    Window("final", 455.0, 549.0, 2, (6.0, 24.0), (40.0, 70.0)),
    Window("landing", 552.0, 575.0, 0, (0.0, 0.0), (0.0, 0.0)),
)
_LIFT_OFF_S, _TOUCH_DOWN_S = 60.0, 576.0
_APPROACHES_S = ((262.0, 395.0), (450.0, _TOUCH_DOWN_S))


def circuits(field_ft: float, dT_C: float, count: int = 4) -> Record:
    """Take-off, approach with a low go-around, second approach and full stop, `count` times."""
    starts = [k * _CIRCUIT_S for k in range(count)]
    return Record(
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
