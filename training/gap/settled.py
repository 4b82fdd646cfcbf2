"""Where a simulator settles, fitted to its own logs: smooth curves, and what switches add.

The curves over lever and flight condition are those of the product. Switches (weight on wheels,
approach idle, bleeds) shift them by a quadratic in the lever's position each, found by ridge
regression on what the curves leave at rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from data_prep.log import Log
from data_prep.quasi_steady import QuasiSteadyConfig, quasi_steady
from narxcal.effects.base import FloatArray, Signals
from narxcal.effects.running import Flights
from narxcal.steady_state import SteadyStateModel
from training.config import RunConfig
from training.pipeline import steady_state

CURVES = ("ALT_ft", "Mach", "dT_C")
SWITCHES = ("WOW", "Approach", "ECS", "NAI", "WAI")
_STILL = QuasiSteadyConfig(window_s=5.0, speed_pct=0.8, driver_fraction=0.01)
_RIDGE = 1e-3


@dataclass(frozen=True, eq=False)
class SettledModel:
    """Curves over `columns` of the inputs, plus `shifts` (3 per switch, outputs)."""

    signals: Signals
    curves: SteadyStateModel
    columns: tuple[int, ...]
    switches: tuple[int, ...]
    shifts: FloatArray

    def outputs(self, u: FloatArray) -> FloatArray:
        """Settled outputs (time, outputs) at inputs `u` (time, inputs)."""
        base = self.curves.outputs(u[:, list(self.columns)])
        return base + _terms(self.signals, u, self.switches) @ self.shifts


def _terms(signals: Signals, u: FloatArray, switches: tuple[int, ...]) -> FloatArray:
    """Each switch times 1, x and x^2 of the lever's position x, (time, 3 per switch)."""
    low, high = signals.lever
    x = np.clip((u[:, signals.u(signals.driver)] - low) / max(high - low, 1e-9), 0.0, 1.0)
    powers = np.stack([np.ones_like(x), x, x * x], axis=1)
    each = [u[:, s, None] * powers for s in switches]
    return np.concatenate(each, axis=1) if each else np.zeros((len(u), 0))


def fit_settled(flights: Flights) -> SettledModel:
    """Fit to the quasi-steady samples of the simulated flights.

    Raises `DataError` where they hold too few of them.
    """
    signals = flights.signals
    inputs = [signals.driver, *(name for name in CURVES if name in signals.inputs)]
    logs = [_log(flights, f) for f in range(len(flights.u))]
    curves, _ = steady_state(_config(signals, inputs), Path(), logs)
    columns = tuple(signals.u(name) for name in inputs)
    switches = tuple(signals.u(name) for name in SWITCHES if name in signals.active)
    shifts = np.zeros((3 * len(switches), len(signals.outputs)))
    blank = SettledModel(signals, curves, columns, switches, shifts)
    return SettledModel(signals, curves, columns, switches, _shifts(blank, flights, logs))


def _shifts(blank: SettledModel, flights: Flights, logs: list[Log]) -> FloatArray:
    signals = blank.signals
    names = tuple(name for name in signals.outputs if name.endswith("_pct"))
    rows, targets = [], []
    for f, log in enumerate(logs):
        still = quasi_steady(log, signals.driver, names, _STILL)
        u, y = flights.u[f, : len(log)][still], flights.y[f, : len(log)][still]
        rows.append(_terms(signals, u, blank.switches))
        targets.append(y - blank.outputs(u))
    x, target = np.concatenate(rows), np.concatenate(targets)
    if not len(x):
        return blank.shifts
    gram = x.T @ x / len(x) + _RIDGE * np.eye(x.shape[1])
    return np.asarray(np.linalg.solve(gram, x.T @ target / len(x)))


def _config(signals: Signals, inputs: list[str]) -> RunConfig:
    blend = [name for name in inputs if name in ("ALT_ft", "Mach") and name in signals.active]
    return RunConfig.parse(
        {
            "schema": "narxcal.config/1",
            "events": {"driver": signals.driver, "condition": ""},
            "steady_state": {"inputs": inputs, "blend": blend},
            "narx": {"outputs": list(signals.outputs), "schedule": blend},
        }
    )


def _log(flights: Flights, f: int) -> Log:
    n, signals = int(flights.lengths[f]), flights.signals
    channels = dict(zip(signals.inputs, flights.u[f, :n].T.copy(), strict=True))
    channels |= dict(zip(signals.outputs, flights.y[f, :n].T.copy(), strict=True))
    return Log(f"simulated {f + 1}", np.arange(n, dtype=np.float64) * signals.dt_s, channels)
