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
from training.gap.quadratic import misfit

TIGHT = 0.05  # of the priors of offsets and slopes, so that they cannot take an effect's place
_ZERO_K = 273.15


def offset_fits(
    problem: Problem,
    measured: tuple[FloatArray, FloatArray],
    effects: Sequence[Effect],
    explained: FloatArray,
) -> tuple[list[Fit], FloatArray, FloatArray]:
    """Fit each offset to what `explained` (flights, time, outputs) leaves.

    Returns the fits, best first, Q per flight without them, and the floor of the noise.
    """
    tight = misfit(problem.flights, measured[0], measured[1], TIGHT)
    tight = replace(tight, gap=np.where(tight.weights > 0.0, tight.gap - explained, 0.0))
    own = replace(problem, misfit=tight)
    fits = [fit([effect], own) for effect in effects]
    fits.sort(key=lambda tried: float(tried.held_out.sum()))
    return fits, tight.size(tight.gap), tight.floor


def relative_size(response: FloatArray, flights: Flights) -> float:
    """Largest RMS shift of any output, as a share of its level (temperatures in K)."""
    signals: Signals = flights.signals
    sizes = []
    for c, name in enumerate(signals.outputs):
        level = flights.y[..., c] + (_ZERO_K if name.endswith("_C") else 0.0)
        sizes.append(float(np.sqrt(np.mean((response[..., c] / level) ** 2))))
    return max(sizes)
