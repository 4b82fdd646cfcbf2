"""What to say of a log that the steady-state model was not made for."""

from __future__ import annotations

import numpy as np

from eval.runs import Runs
from narxcal.steady_state import Envelope, SteadyStateModel

_MANY = 0.1  # share of a log's samples


def outside_envelope(runs: Runs, steady: SteadyStateModel) -> str:
    """How much of a log lies outside the model's envelope, and by which inputs; empty for little.

    `steady` is that of the log's engine. There the model stays bounded, but does not know the
    engine.
    """
    out = runs.known & ~runs.inside
    if out.sum() <= _MANY * runs.known.sum():
        return ""
    return (
        f"{runs.log.name}: {100.0 * out.sum() / runs.known.sum():.0f} % of the samples are outside "
        f"what the steady-state model knows{_by_what(runs, steady)}"
    )


def _by_what(runs: Runs, steady: SteadyStateModel) -> str:
    """Ranges of the inputs that leave the envelope, where it is a box."""
    box = getattr(steady, "envelope", None)
    if not isinstance(box, Envelope):
        return ""
    told = []
    for name, low, high in zip(steady.input_names, box.low, box.high, strict=True):
        values = runs.log[name][runs.known]
        if np.mean((values < low) | (values > high)) > _MANY:
            told.append(
                f"{name} is {values.min():.5g} to {values.max():.5g}, known {low:.5g} to {high:.5g}"
            )
    return f" ({'; '.join(told)})" if told else ""
