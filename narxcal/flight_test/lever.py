"""The two throttle levers on a raster: where manoeuvres are placed, and how the levers differ.

Modelled: stops at 0 (idle) and 85 deg (take-off), the rate of a hand, levers that are rigged
and set up to a degree apart. Not modelled: play and friction (effects of the engine's linkage),
reverse thrust.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from narxcal.errors import ConfigError
from narxcal.flight_test.manoeuvre_pieces import Manoeuvre, Switched

FloatArray = NDArray[np.float64]

IDLE_DEG, TAKE_OFF_DEG = 0.0, 85.0
_ROUNDING_DEG = 1e-9
# Lever difference: half of it on either lever, drawn anew along the lever's path, and none at
# the stops, which both levers touch.
_APART_DEG, _PATH_DEG, _STOP_DEG = 0.5, 30.0, 10.0


@dataclass(frozen=True)
class Placed:
    """A manoeuvre that begins at `start_s`."""

    start_s: float
    manoeuvre: Manoeuvre

    @property
    def stop_s(self) -> float:
        """When it is over."""
        return self.start_s + self.manoeuvre.duration_s


def compose(
    placed: Iterable[Placed], time_s: FloatArray, start_deg: float, hand_deg_s: float | None = None
) -> FloatArray:
    """Lever angle at `time_s` `(time,)`: held but for the manoeuvres, each from where it stands.

    With `hand_deg_s` no sample differs from the one before by more than a hand moves; what is
    faster lags behind. Raises `ConfigError` where manoeuvres overlap or pass a stop.
    """
    in_order = sorted(placed, key=lambda item: item.start_s)
    _check_apart(in_order)
    swings, nets = np.zeros_like(time_s), np.zeros(len(time_s) + 1)
    for item in in_order:
        first, last = np.searchsorted(time_s, (item.start_s, item.stop_s))
        swings[first:last] = item.manoeuvre.swing_deg(time_s[first:last] - item.start_s)
        nets[last] += item.manoeuvre.net_deg
    angle = start_deg + swings + np.cumsum(nets[:-1])
    _check_stops(angle, time_s)
    angle = np.clip(angle, IDLE_DEG, TAKE_OFF_DEG)
    if hand_deg_s is None or len(angle) < 2:
        return angle
    return rate_limited(angle, hand_deg_s * float(time_s[1] - time_s[0]))


def rate_limited(angle_deg: FloatArray, most_deg: float) -> FloatArray:
    """Follow `angle_deg` `(time,)` by at most `most_deg` from one sample to the next."""
    if np.abs(np.diff(angle_deg)).max(initial=0.0) <= most_deg:
        return angle_deg
    state, followed = float(angle_deg[0]), []
    for wanted in angle_deg.tolist():
        state += min(max(wanted - state, -most_deg), most_deg)
        followed.append(state)
    return np.array(followed)


def set_apart(angle_deg: FloatArray, random: np.random.Generator) -> FloatArray:
    """Set a lever `(time,)` a little off the angle meant, by at most half a degree.

    The error is a function of the path that the lever has covered: it changes only while the
    lever moves, and is 0 at either stop.
    """
    path = np.concatenate(([0.0], np.cumsum(np.abs(np.diff(angle_deg)))))
    knots = np.arange(0.0, path[-1] + 2.0 * _PATH_DEG, _PATH_DEG)
    error = np.interp(path, knots, random.uniform(-_APART_DEG, _APART_DEG, len(knots)))
    room = np.minimum(angle_deg - IDLE_DEG, TAKE_OFF_DEG - angle_deg)
    return np.asarray(angle_deg + error * np.clip(room / _STOP_DEG, 0.0, 1.0))


def flips(placed: Iterable[Placed]) -> list[Switched]:
    """What the manoeuvres flip, on the common time axis."""
    return [flip.later(item.start_s) for item in placed for flip in item.manoeuvre.switched]


def _check_apart(placed: Sequence[Placed]) -> None:
    for item, after in itertools.pairwise(placed):
        if after.start_s < item.stop_s - _ROUNDING_DEG:
            raise ConfigError(
                f"a manoeuvre begins at {after.start_s:.2f} s, before the one from "
                f"{item.start_s:.2f} s has ended at {item.stop_s:.2f} s",
                hint="Place it later",
            )


def _check_stops(angle_deg: FloatArray, time_s: FloatArray) -> None:
    beyond = (angle_deg < IDLE_DEG - _ROUNDING_DEG) | (angle_deg > TAKE_OFF_DEG + _ROUNDING_DEG)
    if beyond.any():
        worst = int(np.argmax(beyond))
        raise ConfigError(
            f"the lever would go to {angle_deg[worst]:.2f} deg at {time_s[worst]:.2f} s, and its "
            f"stops are at {IDLE_DEG:g} and {TAKE_OFF_DEG:g} deg"
        )
