"""The engine of a virtual flight: its preset, its build, and what its model leaves out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from narxcal.flight_test.scenario import FlightScenario, FlownEffect
from narxcal.turbofan import Unmodelled, VirtualEngine, build_scatter
from narxcal.turbofan.cycle import Health


def flown_engine(
    scenario: FlightScenario, side: str, effects: Sequence[FlownEffect] = ()
) -> VirtualEngine:
    """Build the engine on one side of the aircraft, with those `effects` that sit in an engine.

    It is the same engine on every flight of the scenario, but for its effects.
    """
    unmodelled = [
        Unmodelled(effect.id, effect.parameters, effect.windows_s)
        for effect in effects
        if not effect.on_sensor
    ]
    return VirtualEngine(scenario.engine, _build(scenario, side), unmodelled)


def build_facts(scenario: FlightScenario, side: str) -> dict[str, Any]:
    """Say how the engine on one side was built: multipliers of efficiencies and flows."""
    return _build(scenario, side)._asdict()


def _build(scenario: FlightScenario, side: str) -> Health:
    random = np.random.default_rng(scenario.stream(0, f"build {side}"))
    return build_scatter(random, scenario.build_scatter_pct)
