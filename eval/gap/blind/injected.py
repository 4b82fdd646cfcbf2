"""Effects inside the engine put onto recorded flights: what they change in a lumped engine.

GAP section 2, tier P: the record plus `sim(with) - sim(without)`, a lumped engine being flown with
the flight's own inputs. Its fuel flow, or its lever, is stretched to the flight's range, and so are
the differences to the ranges of the outputs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from eval.gap.blind.catalogue import Dose, Windows
from eval.gap.blind.lumped import LumpedEngine
from narxcal.support.arrays import FloatArray

Channels = dict[str, FloatArray]
EFFECTS: Final = (
    "actuator_lag",
    "spool_lag",
    "spool_coupling",
    "accel_decel_asymmetry",
    "altitude_lag",
    "heat_soak",
    "unlogged_switch",
    "deterioration",
)
_FUEL: Final = (75.0, 1060.0)  # kg/h of the lumped engine from idle to full power
_LEVER: Final = (0.0, 85.0)
_COMMON: Final = ("ALT_ft", "Mach", "dT_C")
_ENOUGH: Final = ("N1_pct", "N2_pct", "EGT_C")


def possible(driver: str, outputs: Sequence[str], effect: str) -> bool:
    """Whether the lumped engine can say what an effect changes in such flights."""
    known = sum(name in outputs for name in _ENOUGH)
    return effect in EFFECTS and known >= 2 and driver in ("TRA_deg", "FF_kgph")


class Injector:
    """Says what effects change on one flight: `channels` (time,) every `dt_s`, complete."""

    def __init__(self, channels: Mapping[str, FloatArray], driver: str, dt_s: float) -> None:
        low, high = _FUEL if driver == "FF_kgph" else _LEVER
        moved = np.asarray(channels[driver], np.float64)
        share = (moved - moved.min()) / max(float(np.ptp(moved)), 1e-9)
        zero = np.zeros_like(moved)
        self._kind = "lumped_fuel" if driver == "FF_kgph" else "lumped_n1"
        self._dt_s = dt_s
        names = LumpedEngine(self._kind).input_names
        self._inputs = dict.fromkeys(names, zero) | {driver: low + (high - low) * share}
        self._inputs |= {name: np.asarray(channels[name]) for name in _COMMON if name in channels}
        self._without = self._flown(None, ())

    def change(self, dose: Dose, windows: Windows, spans: Mapping[str, float]) -> Channels:
        """What the dose changes, (time,) each, for outputs whose ranges are `spans`."""
        with_it = self._flown(dose, windows)
        found = {}
        for name, span in spans.items():
            if name in _ENOUGH:
                own = max(float(np.ptp(self._without[name])), 1e-9)
                found[name] = (with_it[name] - self._without[name]) * span / own
        return found

    def _flown(self, dose: Dose | None, windows: Windows) -> Channels:
        effects = [] if dose is None else [dose.unmodelled(windows)]
        return LumpedEngine(self._kind, unmodelled=effects).simulate(self._inputs, self._dt_s)
