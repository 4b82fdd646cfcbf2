"""ARX models: least squares on one step, and the dead time by which a short one predicts best."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from narxcal.narx.config import NarxConfig
from narxcal.narx.network import NarxModel, Scaling, Weights, tap
from narxcal.record import Record
from training.held_out import thinned
from training.latent import Data

_MOST_DEAD = 60  # samples, at most a tenth of the shortest record
_SAMPLES = 20_000  # by which dead times are judged


def dead_times(
    records: Sequence[Record], scalings: tuple[Scaling, Scaling]
) -> list[tuple[int, ...]]:
    """No dead time, and the one by which a short ARX model predicts best, if there is any."""
    inputs = records[0].u.shape[1]
    none = (0,) * inputs
    data = Data.of(thinned(records, _SAMPLES), none, scalings)
    most = min(_MOST_DEAD, min(len(u) for u in data.inputs) // 10)
    found = list(none)
    for j in range(inputs):
        errors = [_short_arx_error(data, (*found[:j], d, *found[j + 1 :])) for d in range(most)]
        # The least within half a percent of the best: too long a one cannot be undone.
        found[j] = int(np.argmax(np.array(errors) <= 1.005 * min(errors))) if errors else 0
    return [none] if not any(found) else [none, tuple(found)]


def _short_arx_error(data: Data, delay: tuple[int, ...]) -> float:
    """One-step error of an ARX model of two past outputs and two inputs behind dead times."""
    rows, targets = [], []
    first = max(delay) + 2
    for u, y in zip(data.inputs, data.measured, strict=True):
        k = np.arange(first, len(y))
        drive = [u[k - d - i, j] for j, d in enumerate(delay) for i in (0, 1)]
        phi = np.column_stack([y[k - 1], y[k - 2], *drive, np.ones(len(k))])
        known = np.isfinite(phi).all(axis=1) & np.isfinite(y[k]).all(axis=1)
        rows.append(phi[known])
        targets.append(y[k][known])
    phi, target = np.concatenate(rows), np.concatenate(targets)
    if len(phi) <= phi.shape[1]:
        return np.inf
    error = target - phi @ np.linalg.lstsq(phi, target, rcond=None)[0]
    return float(np.mean(error**2))


def arx_model(
    records: Sequence[Record], order: int, delay: tuple[int, ...], scalings: tuple[Scaling, Scaling]
) -> NarxModel:
    """Least squares on one step of `order` past outputs and inputs, as a network without any unit.

    One dead time, the shortest, holds for all inputs.
    """
    first = min(delay)
    taps = tuple(range(first, first + order + 1))
    config = NarxConfig(lags=order, taps=taps, hidden=1, margin=1.0)
    p, m = records[0].y.shape[1], records[0].u.shape[1]
    width = order * p + len(taps) * m
    normal, right, count = np.zeros((width + 1, width + 1)), np.zeros((width + 1, p)), 0
    low, high = np.full(p, np.inf), np.full(p, -np.inf)
    for record in records:
        u, y = scalings[0].down(record.u), scalings[1].down(record.y)
        rows = np.arange(min(order, len(y)), len(y))
        if not len(rows):
            continue
        past = np.concatenate([y[rows - i] for i in range(1, order + 1)], axis=1)
        phi = np.concatenate([past, tap(u, taps)[rows], np.ones((len(rows), 1))], axis=1)
        known = np.isfinite(phi).all(axis=1) & np.isfinite(y[rows]).all(axis=1)
        phi, target = phi[known], y[rows][known]
        normal, right = normal + phi.T @ phi, right + phi.T @ target
        count += len(phi)
        low, high = np.fmin(low, np.fmin.reduce(y)), np.fmax(high, np.fmax.reduce(y))
    normal[np.diag_indices(width + 1)] += 1e-9 * max(count, 1)
    solution = np.linalg.solve(normal, right).T
    wide = config.margin * (high - low) + 1e-9
    weights = Weights(
        config=config, w1=np.zeros((1, width)), b1=np.zeros(1), w2=np.zeros((p, 1)),
        b2=solution[:, -1].copy(), a=np.ascontiguousarray(solution[:, :-1]),
        low=low - wide, high=high + wide,
    )  # fmt: skip
    return NarxModel(weights, *scalings)
