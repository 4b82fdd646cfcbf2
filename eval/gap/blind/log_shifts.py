"""What steady effects do to the logs of an engine whose control holds N1: their shapes.

Sizes are those of the catalogue; how many degrees or percent belong to one is that of a typical
two-spool turbofan, about what the virtual engine shows. Nothing here has the form that the
diagnosis fits: lags depend on power, and so does every shift in its own way.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from eval.gap.blind.catalogue import Windows
from narxcal.flight_test.sensors import first_order
from narxcal.support.arrays import FloatArray

Channels = dict[str, FloatArray]
_SPOOL_S, _GAS_S = 1.6, 0.8  # after a bleed opens, N2 and exhaust temperature take so long
_SWITCHES: Final = ("NAI", "WAI", "ECS")


class View(NamedTuple):
    """One simulated flight, `(time,)` each; `power` goes from 0 to 1, `windows` are hidden."""

    number: int
    channels: Channels
    dt_s: float
    power: FloatArray
    windows: Windows


def switches_of(channels: Channels) -> tuple[str, ...]:
    """Bleed switches that change in a flight."""
    return tuple(n for n in _SWITCHES if n in channels and np.ptp(channels[n]) > 0.0)


def _bled(view: View, share: FloatArray) -> Channels:
    """A share of the core's air is taken away: hotter, and N2 up a little to keep N1."""
    p = np.clip(view.power, 0.0, 1.2)
    slow = first_order(share, _SPOOL_S, view.dt_s)
    fast = first_order(share, _GAS_S, view.dt_s)
    return {
        "EGT_C": 1100.0 * fast * (0.65 + 0.35 * p**1.5),
        "N2_pct": 16.0 * slow * (1.0 - 0.5 * p),
        "FF_kgph": view.channels.get("FF_kgph", np.zeros(1)) * 1.6 * fast,
    }


def _bleed(view: View, size: float) -> Channels:
    on = sum(view.channels[name] for name in switches_of(view.channels))
    return _bled(view, size * np.minimum(np.asarray(on, np.float64) + 0.0 * view.power, 1.0))


def _hidden(view: View, size: float) -> Channels:
    time_s = np.arange(len(view.power)) * view.dt_s
    on = np.zeros(len(time_s))
    for start, stop in view.windows:
        on[(time_s >= start) & (time_s < stop)] = 1.0
    return _bled(view, size * on)


def _worn(view: View, size: float) -> Channels:
    """Efficiency lost in compressor and turbine: hotter with power, N2 a little down."""
    p = np.clip(view.power, 0.0, 1.2)
    fuel = view.channels.get("FF_kgph", np.zeros(1))
    return {
        "EGT_C": size * (4.0 + 5.0 * p**1.3),
        "N2_pct": -size * (0.05 + 0.12 * p),
        "FF_kgph": fuel * 0.011 * size,
    }


def _day(view: View, size: float) -> Channels:
    """The control's N1 is off by `size` percent per degC of the day, and all else goes along."""
    more = size * view.channels["dT_C"]
    p = np.clip(view.power, 0.0, 1.2)
    return {"N1_pct": more, "N2_pct": more * (0.55 - 0.2 * p), "EGT_C": more * (3.0 + 4.0 * p)}


def _soaked(view: View, size: float) -> Channels:
    """Metal that is colder than the gas cools it; it heats up the faster the higher the power."""
    egt = view.channels["EGT_C"]
    lag_s = 45.0 + 110.0 * (1.0 - np.clip(view.power, 0.0, 1.0))
    keep = np.exp(-view.dt_s / lag_s)
    metal = np.empty_like(egt)
    state = float(egt[0])
    for k, (gas, share) in enumerate(zip(egt.tolist(), keep.tolist(), strict=True)):
        metal[k] = state
        state = gas + (state - gas) * share
    cold = 0.035 * size * (egt - metal)
    return {"EGT_C": -cold, "N2_pct": -0.004 * cold}


SHIFTS: Final[dict[str, Callable[[View, float], Channels]]] = {
    "bleed_extraction": _bleed,
    "unlogged_switch": _hidden,
    "deterioration": _worn,
    "temperature_effect": _day,
    "heat_soak": _soaked,
}
