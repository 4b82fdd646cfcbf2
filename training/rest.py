"""Synthetic records in which nothing moves: wherever it starts, the engine comes to rest.

Flights hardly ever show a large deviation while the inputs stand still, so a network fitted to
flights alone may keep one for ever, or settle at a wrong value. These records say that it has
to be gone after a while; how it goes is left to the flights.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from narxcal.records import Record

_COUNT = {False: 60, True: 300}  # from any deviation, and from far ones
_FREE_SHARE = {False: 0.75, True: 0.5}  # of a record is not scored
_AMPLIFIED = 1.5  # times the deviations that flights show


def rest_records(
    records: Sequence[Record], moving: int, steps: int, seed: int, *, far: bool = False
) -> list[Record]:
    """Draw records of `steps` samples at conditions and deviations found in `records`.

    The first `moving` inputs, the increments, are zero. Outputs start at a drawn deviation, are
    unknown (NaN) for a while and zero at the end. Flights mostly stand still, so that a drawn
    deviation is mostly small; with `far`, one is drawn the more often the larger it is.
    """
    draw = np.random.default_rng(seed)
    u = np.concatenate([record.u for record in records])
    y = np.concatenate([record.y for record in records])
    y = y[np.isfinite(y).all(axis=1)]
    size = np.linalg.norm(y / np.maximum(y.std(axis=0), 1e-12), axis=1) if len(y) else np.empty(0)
    share = size / size.sum() if far and size.sum() > 0.0 else None
    drawn = []
    for _ in range(_COUNT[far] if len(y) else 0):
        still = u[draw.integers(len(u))].copy()
        still[:moving] = 0.0
        target = np.zeros((steps, y.shape[1]))
        target[: round(_FREE_SHARE[far] * steps)] = np.nan
        first = draw.integers(len(y)) if share is None else draw.choice(len(y), p=share)
        target[0] = _AMPLIFIED * y[first]
        drawn.append(Record(np.tile(still, (steps, 1)), target, "at rest"))
    return drawn
