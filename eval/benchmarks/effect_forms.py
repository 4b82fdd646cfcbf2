"""How much of what an effect does to a physical engine its form in the library explains.

`python -m eval.benchmarks.effect_forms` flies the virtual engine with and without each effect in
its physics, fits the library's form to the difference, and prints the table of `docs/effects.md`.
The kind of control is that which these flights suit, as in a diagnosis.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from narxcal.effects import Flights, Signals, effect
from narxcal.flight_test.plan import FlightPlan, plan_flight
from narxcal.support.arrays import FloatArray
from narxcal.turbofan import Unmodelled, VirtualEngine
from training.gap.control import suited
from training.gap.emulator import GreyBoxEmulator, fit_emulators
from training.gap.fitting import Problem, fit
from training.gap.quadratic import misfit

ENGINES = ("business_jet", "single_aisle")
OUTPUTS = ("N1_pct", "N2_pct", "EGT_C")
NOISE = np.array([0.03, 0.03, 0.5])
TRUTHS: Mapping[str, Mapping[str, float]] = {
    "throttle_delay": {"delay_s": 0.3},
    "throttle_backlash": {"width_deg": 3.0},
    "throttle_rate_limit": {"rate_degps": 15.0},
    "actuator_lag": {"tau_s": 0.5},
    "spool_lag": {"factor": 1.4},
    "spool_coupling": {"factor": 1.6},
    "accel_decel_asymmetry": {"ratio": 1.6},
    "accel_limit": {"factor": 0.5},
    "altitude_lag": {"exponent": 0.5},
    "heat_soak": {"factor": 3.0},
    "bleed_extraction": {"share": 0.03},
    "idle_schedule": {"shift_pct": 5.0},
}
_NO_SIZE = ("heat_soak", "bleed_extraction")  # whose sizes here and in the engine differ in kind
_BLOCK, _FLIGHTS, _DURATION_S = 4, 4, 480.0


class Explained(NamedTuple):
    """Share of the squared difference that the form explains, and its first parameter."""

    name: str
    truth: float
    share: float
    found: float


def main() -> int:
    """Print one row per effect."""
    found = {engine: explained(engine) for engine in ENGINES}
    sys.stdout.write("| effect (truth) |" + " explained | found |" * len(ENGINES) + "\n")
    sys.stdout.write("|---|" + "---|---|" * len(ENGINES) + "\n")
    for rows in zip(*found.values(), strict=True):
        sized = rows[0].name not in _NO_SIZE
        cells = "".join(f" {r.share:.2f} | {f'{r.found:.3g}' if sized else ''} |" for r in rows)
        sys.stdout.write(f"| `{rows[0].name}` {rows[0].truth:g} |{cells}\n")
    return 0


def explained(engine: str, names: tuple[str, ...] = tuple(TRUTHS)) -> list[Explained]:
    """Every effect of `names` in the physics of `engine`, and what the library makes of it."""
    plans = [_plan(engine, seed) for seed in range(_FLIGHTS)]
    flights = _flights(plans, _flown(engine, plans))
    emulators = fit_emulators(flights)
    return [_explained(engine, plans, (flights, emulators), name) for name in names]


def _explained(
    engine: str,
    plans: list[dict[str, FloatArray]],
    simulator: tuple[Flights, tuple[GreyBoxEmulator, ...]],
    name: str,
) -> Explained:
    flights, emulators = simulator
    truth = TRUTHS[name]
    flown = _flown(engine, plans, Unmodelled(name, truth))
    emulator, measure = suited(emulators, flights, (flown, NOISE)), misfit(flights, flown, NOISE)
    before = float(measure.size(measure.gap).sum())
    found = fit([effect(name)], Problem(flights, emulator, measure))
    share = 1.0 - float(found.left.sum()) / before
    return Explained(name, next(iter(truth.values())), share, float(found.theta[0]))


def _plan(engine: str, seed: int) -> dict[str, FloatArray]:
    plan = FlightPlan(style="enriched", aircraft=engine, duration_s=_DURATION_S)
    return dict(plan_flight(plan, seed)["left"])


def _flown(engine: str, plans: list[dict[str, FloatArray]], *changed: Unmodelled) -> FloatArray:
    """Outputs (flights, time, outputs) at 8 Hz."""
    virtual = VirtualEngine(engine, unmodelled=changed)
    runs = []
    for plan in plans:
        inputs = {name: plan[name] for name in virtual.input_names}
        dt_s = float(plan["time_s"][1] - plan["time_s"][0])
        found = virtual.simulate(inputs, dt_s)
        runs.append(_blocks(np.column_stack([found[name] for name in OUTPUTS])))
    return np.stack(runs)


def _flights(plans: list[dict[str, FloatArray]], y: FloatArray) -> Flights:
    names = VirtualEngine.input_names
    u = np.stack([_blocks(np.column_stack([plan[name] for name in names])) for plan in plans])
    dt_s = _BLOCK * float(plans[0]["time_s"][1] - plans[0]["time_s"][0])
    active = tuple(name for j, name in enumerate(names) if np.ptp(u[..., j]) > 0.0)
    lever = (float(u[..., 0].min()), float(u[..., 0].max()))
    limits = (y.min(axis=(0, 1)), y.max(axis=(0, 1)))
    signals = Signals(tuple(names), OUTPUTS, dt_s, "TRA_deg", *limits, lever, active)
    return Flights(signals, u, y, np.full(len(y), y.shape[1]))


def _blocks(values: FloatArray) -> FloatArray:
    rows = len(values) // _BLOCK * _BLOCK
    return np.asarray(values[:rows].reshape(-1, _BLOCK, values.shape[1]).mean(axis=1))


if __name__ == "__main__":
    sys.exit(main())
