"""What no effect of the library is: mimics, which look like one, and others, which do not.

Each changes inputs before the engine or outputs behind it, by one size. A size of zero changes
nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

import numpy as np

from narxcal.support.arrays import FloatArray
from narxcal.support.compiled import compiled

Channels = dict[str, FloatArray]
_FULL_DEG = 85.0
_PERIOD_S, _ON_S = 90.0, 30.0  # an ECS load for 30 s in every 90 s
_OUTPUTS: Final = ("N1_pct", "N2_pct", "EGT_C", "FF_kgph")
_NONE: Final = np.zeros(1)  # in the place of an output that a log lacks
_CELSIUS_PCT = 7.0  # degC of exhaust temperature that go with one percent of N2, roughly


class Strange(NamedTuple):
    """Something out of the library: where it acts, its first and largest size, and what it does.

    `change` takes channels and size and gives the channels that change, `(time,)` each. `like`
    names the effects that it looks like; none for what is no mimic.
    """

    id: str
    on: str  # "input" or "output"
    change: Callable[[Mapping[str, FloatArray], float], Channels]
    first: float
    most: float
    like: tuple[str, ...] = ()


def applied(what: Strange, on: str, channels: Mapping[str, FloatArray], size: float) -> Channels:
    """`channels` `(time,)` with the change, if it acts on this side; without it otherwise.

    Outputs that are not there are left out.
    """
    if what.on != on or size == 0.0:
        return dict(channels)
    changed = what.change({**dict.fromkeys(_OUTPUTS, _NONE), **channels}, size)
    return {**channels, **{name: values for name, values in changed.items() if name in channels}}


def _deadband(channels: Mapping[str, FloatArray], size: float) -> Channels:
    """The lever is followed only once it has left its last followed place by `size` degrees.

    Without a lever it is the fuel flow, by that part of its median.
    """
    if "TRA_deg" in channels:
        return {"TRA_deg": _jumping(np.ascontiguousarray(channels["TRA_deg"]), size)}
    fuel = np.ascontiguousarray(channels["FF_kgph"])
    return {"FF_kgph": _jumping(fuel, size / _FULL_DEG * float(np.median(fuel)))}


@compiled
def _jumping(angle: FloatArray, width: float) -> FloatArray:
    followed = np.empty_like(angle)
    state = angle[0]
    for k in range(len(angle)):
        if abs(angle[k] - state) > width:
            state = angle[k]
        followed[k] = state
    return followed


def _kink(channels: Mapping[str, FloatArray], size: float) -> Channels:
    """A bump of `size` percent in the settled map of N2, at three quarters of the N1 range."""
    bump = size * np.exp(-(((channels["N1_pct"] - 75.0) / 7.0) ** 2))
    return {
        "N2_pct": channels["N2_pct"] + bump,
        "EGT_C": channels["EGT_C"] - _CELSIUS_PCT * bump,
    }


def _cyclic(channels: Mapping[str, FloatArray], size: float) -> Channels:
    """A load that comes for 30 s in every 90 s: `size` percent of N2 less, EGT and fuel more."""
    time_s = channels["time_s"]
    on = (np.mod(time_s, _PERIOD_S) < _ON_S).astype(np.float64)
    return {
        "N2_pct": channels["N2_pct"] - size * on,
        "EGT_C": channels["EGT_C"] + 2.0 * _CELSIUS_PCT * size * on,
        "FF_kgph": channels["FF_kgph"] * (1.0 + 0.02 * size * on),
    }


def _step(channels: Mapping[str, FloatArray], size: float) -> Channels:
    """The exhaust temperature reads `size` degC more from mid-flight on."""
    time_s = channels["time_s"]
    return {"EGT_C": channels["EGT_C"] + size * (time_s > 0.5 * time_s[-1])}


def _hunting(channels: Mapping[str, FloatArray], size: float) -> Channels:
    """A limit cycle of 6 s whose amplitude is `size` percent of N1, whatever the lever does."""
    wave = np.sin(2.0 * np.pi * channels["time_s"] / 6.0)
    return {
        "N1_pct": channels["N1_pct"] + size * wave,
        "N2_pct": channels["N2_pct"] + 0.5 * size * wave,
        "EGT_C": channels["EGT_C"] + _CELSIUS_PCT * size * wave,
    }


def _altimeter(channels: Mapping[str, FloatArray], size: float) -> Channels:
    """EGT and fuel flow off with altitude, but back again at the top: a wrong correction."""
    high = np.sin(np.pi * np.clip(channels["ALT_ft"] / 30e3, 0.0, 1.0))
    return {
        "EGT_C": channels["EGT_C"] + size * high,
        "FF_kgph": channels["FF_kgph"] * (1.0 - 0.001 * size * high),
    }


def _crosstalk(channels: Mapping[str, FloatArray], size: float) -> Channels:
    """N2 hears the rate of the exhaust temperature: `size` percent per degC/s."""
    time_s = channels["time_s"]
    rate = np.gradient(channels["EGT_C"], time_s[1] - time_s[0])
    return {"N2_pct": channels["N2_pct"] + size * rate}


def _surging(channels: Mapping[str, FloatArray], size: float) -> Channels:
    """Every half minute all speeds sag by `size` percent for three seconds, and come back."""
    sag = np.exp(-(((np.mod(channels["time_s"], 30.0) - 15.0) / 1.5) ** 2))
    return {
        "N1_pct": channels["N1_pct"] - size * sag,
        "N2_pct": channels["N2_pct"] - 0.6 * size * sag,
        "EGT_C": channels["EGT_C"] + _CELSIUS_PCT * size * sag,
    }


DEADBAND: Final = Strange(
    "deadband", "input", _deadband, 1.0, 8.0, ("throttle_backlash", "throttle_delay")
)
KINK: Final = Strange("map_kink", "output", _kink, 0.6, 6.0, ("deterioration",))
CYCLE: Final = Strange(
    "cyclic_load", "output", _cyclic, 0.5, 5.0, ("unlogged_switch", "bleed_extraction")
)
STEP: Final = Strange(
    "step_in_flight", "output", _step, 6.0, 60.0, ("sensor_drift", "unlogged_switch")
)
MIMICS: Final = (DEADBAND, KINK, CYCLE, STEP)
OTHERS: Final = (
    Strange("hunting", "output", _hunting, 0.5, 5.0),
    Strange("altitude_error", "output", _altimeter, 6.0, 60.0),
    Strange("crosstalk", "output", _crosstalk, 0.02, 0.3),
    Strange("sagging", "output", _surging, 1.0, 8.0),
)
# What the real engine of a case with another structure has on top, too small to be an answer.
MISFIT: Final = ((DEADBAND, 0.3), (KINK, 0.12), (CYCLE, 0.05))
