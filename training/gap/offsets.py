"""Effects that only shift where the engine settles, judged after all that moves.

Build scatter of one or two percent shifts temperature and speed like wear or a wrong sensor
does, so an offset is claimed only where it is the same in all flights, beyond the residuals, and
larger than scatter makes it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from narxcal.effects.base import Effect, FloatArray, Signals
from narxcal.effects.running import Flights
from training.gap.fitting import Fit, Problem, fit
from training.gap.quadratic import Misfit, misfit

TIGHT = 1e-5  # of the priors of offsets and slopes: none, they would take the effect's place
_ZERO_K = 273.15
_GOVERNED = 2.5
_WEIGHTS = {"FF_kgph": 0.5}  # fuel flow scatters twice as much as speed and temperature


def offset_fits(
    problem: Problem, tight: Misfit, effects: Sequence[Effect], explained: FloatArray
) -> tuple[list[Fit], FloatArray]:
    """Fit each offset to what `explained` (flights, time, outputs) leaves.

    Returns the fits, best first, and Q per flight without them.
    """
    left = replace(tight, gap=np.where(tight.weights > 0.0, tight.gap - explained, 0.0))
    own = replace(problem, misfit=left)
    fits = [fit([effect], own) for effect in effects]
    fits = [one for one in fits if not _better_than_new(one, problem.flights.signals)]
    fits.sort(key=lambda tried: float(tried.held_out.sum()))
    return fits, left.size(left.gap)


def whole_gap(flights: Flights, measured: tuple[FloatArray, FloatArray]) -> Misfit:
    """The gap with its offsets: what all effects together have to explain."""
    return misfit(flights, measured[0], measured[1], TIGHT)


def relative_size(response: FloatArray, flights: Flights) -> float:
    """Largest RMS shift of any output, as a share of its level (temperatures in K).

    An output that the control governs counts several times: build scatter does not move it.
    """
    signals: Signals = flights.signals
    sizes = []
    for c, name in enumerate(signals.outputs):
        level = flights.y[..., c] + (_ZERO_K if name.endswith("_C") else 0.0)
        heavy = _GOVERNED if c == 0 and signals.governed else _WEIGHTS.get(name, 1.0)
        sizes.append(heavy * float(np.sqrt(np.mean((response[..., c] / level) ** 2))))
    return max(sizes)


def _better_than_new(tried: Fit, signals: Signals) -> bool:
    """Whether wear would have cooled the engine: that is build scatter, or something else."""
    if tried.effects[0].id != "deterioration" or "EGT_C" not in signals.outputs:
        return False
    return float(np.mean(tried.response[..., signals.y("EGT_C")])) < 0.0
