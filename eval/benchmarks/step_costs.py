"""Measure what a step of Levenberg-Marquardt costs: the rates by which a choice counts its work.

    python -m eval.benchmarks.step_costs

Prints the rates of `training/search.py`, by least squares on the relative error of the microseconds
per accepted step, with all that a fit does around it. Run it on a quiet machine.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np
from scipy.optimize import nnls

from narxcal.narx.latent import Shape
from narxcal.narx.network import Scaling
from narxcal.record import Record
from narxcal.support.arrays import FloatArray
from training.forms import drawn_networks, network_kind, network_size
from training.latent import Data, at_decay, fit_linear, grown
from training.network import Material
from training.search import counted

_SIZES = tuple(product((500, 4000), (1, 9)))  # samples; one in so many rows is scored
_LATENT = (
    (1, 1, 1, 0), (2, 1, 1, 0), (4, 1, 1, 0), (8, 1, 1, 0), (4, 3, 3, 0), (1, 1, 1, 8),
    (2, 1, 1, 4), (2, 1, 1, 16), (3, 2, 2, 8), (4, 1, 1, 8), (6, 1, 1, 8), (8, 1, 1, 16),
    (3, 4, 3, 8), (6, 4, 3, 8),
)  # states, inputs, outputs, hidden units # fmt: skip
_NETWORKS = ((1, 1), (1, 2), (2, 2), (4, 1), (4, 3))  # inputs, outputs

Row = tuple[tuple[float, ...], float]  # what is counted in a step, and its microseconds


def _record(samples: int, inputs: int, outputs: int) -> Record:
    draw = np.random.default_rng(samples + inputs)
    u = np.repeat(draw.standard_normal((samples // 10 + 1, inputs)), 10, axis=0)[:samples]
    y = np.zeros((samples, outputs))
    pull = np.tanh(u @ draw.standard_normal((inputs, outputs)))
    for k in range(1, samples):
        y[k] = 0.9 * y[k - 1] + 0.1 * pull[k - 1] - 0.02 * y[k - 1] * np.abs(y[k - 1])
    return Record(u, y + 0.02 * draw.standard_normal(y.shape), "drawn")


def _latent() -> Iterator[Row]:
    for (n, m, p, h), (samples, every) in product(_LATENT, _SIZES):
        record = _record(samples, m, p)
        data = Data.of([record], (0,) * m, (Scaling.of(record.u), Scaling.of(record.y)), every)
        base = fit_linear(data, Shape(n, m, p, 0, (0,) * m))
        if base is None:
            continue
        start = grown(base, h, seed=0) if h else base
        at_decay(start, data, 1e-4, 1)
        began = time.process_time()
        used = sum(at_decay(start, data, decay, 6)[2] for decay in (1e-3, 1e-5, 1e-7))
        spent = time.process_time() - began
        rows = float(sum(np.count_nonzero(root) for root in data.roots))
        if used:
            yield counted(samples, rows, start.shape.size, (h, n)), 1e6 * spent / used


def _networks() -> Iterator[Row]:
    for (m, p), (samples, every) in product(_NETWORKS, _SIZES):
        learned = Material([_record(samples, m, p)], (), 1.0)
        began = time.process_time()
        steps = drawn_networks(learned, (1e-5, 1e-7), 0, every)[1]
        spent = time.process_time() - began
        rows = samples * p / every
        yield counted(samples, rows, network_size(m, p), network_kind(p)), 1e6 * spent / steps


def rates(rows: Sequence[Row]) -> FloatArray:
    """Rates >= 0 by least squares on relative errors."""
    matrix = np.array([count for count, _ in rows]) / np.array([cost for _, cost in rows])[:, None]
    return np.asarray(nnls(matrix, np.ones(len(matrix)))[0])


if __name__ == "__main__":
    for name, measured in (("LATENT_STEP", _latent()), ("NETWORK_STEP", _networks())):
        found = ", ".join(f"{rate:.2g}" for rate in rates(list(measured)))
        sys.stdout.write(f"{name} = Rates({found})\n")
