"""Compiled kernels against PyTorch, both on this machine and in this run: ratios, not promises.

The network is that of the public comparison: one input, one output, 30 tanh units, here with
two lags. PyTorch runs eagerly on one thread, a step per call, as the exact twin in
`narxcal.narx` does.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import torch
from numpy.typing import NDArray

from eval.benchmarks.row import Row
from narxcal.narx import simulate_slowly
from narxcal.narx_config import NarxConfig
from narxcal.narx_model import NarxModel
from narxcal.records import Record
from training.free_run import FreeRunProblem, cut_windows
from training.warm_start import new_model

FloatArray = NDArray[np.float64]
_GROUP = "speed"
_NETWORK = NarxConfig(lags=2, taps=(0, 1), hidden=30)


def record_of(samples: int) -> Record:
    """A stable non-linear system driven by filtered noise, the same every time."""
    random = np.random.default_rng(0)
    u, y = random.standard_normal(samples), np.zeros(samples)
    for k in range(2, samples):
        y[k] = 1.2 * y[k - 1] - 0.4 * y[k - 2] + 0.2 * np.tanh(u[k - 1])
    return Record(u, y)


def rows(samples: int = 20000, slow_samples: int = 2000) -> list[Row]:
    """Free run and training steps; the twin runs over `slow_samples` of the same record."""
    record, short = record_of(samples), record_of(slow_samples)
    model = new_model([record], _NETWORK, seed=0)
    with _one_thread():
        return [*_simulation(model, record, short), *_training(model, record, short)]


def _simulation(model: NarxModel, record: Record, short: Record) -> list[Row]:
    fast = _seconds(lambda: model.simulate(record.u, record.y[:1])) / len(record)
    start = torch.from_numpy(model.output_scaling.down(short.y[:1]))[None]
    u = torch.from_numpy(model.input_scaling.down(short.u))[None]

    def twin() -> None:
        with torch.no_grad():
            simulate_slowly(model.net, start, u)

    slow = _seconds(twin, repeats=1) / len(short)
    note = "2 lags, 30 tanh units, one thread"
    return [
        Row(_GROUP, "free run, kernel", 1e6 * fast, "us/sample", note=note),
        Row(_GROUP, "free run, eager PyTorch twin", 1e6 * slow, "us/sample", note=note),
        Row(_GROUP, "free run, twin over kernel", slow / fast, "x", note="same run"),
    ]


def _training(model: NarxModel, record: Record, short: Record) -> list[Row]:
    theta = model.net.get_theta()
    full = FreeRunProblem(model.net, cut_windows(model, [record], 100))
    adam = _seconds(lambda: full.gradient(theta)) / len(record)
    lm = _seconds(lambda: full.normal_equations(theta)) / len(record)
    model.net.set_theta(theta)
    slow = _seconds(lambda: autograd_loss(model, short, 100), repeats=1) / len(short)
    note = "windows of 100 samples; loss and derivatives of one step"
    return [
        Row(_GROUP, "gradient (Adam), kernel", 1e6 * adam, "us/sample", note=note),
        Row(_GROUP, "J'J and gradient (LM), kernel", 1e6 * lm, "us/sample", note=note),
        Row(_GROUP, "gradient, autograd", 1e6 * slow, "us/sample", note=note),
        Row(_GROUP, "Adam step, autograd over kernel", slow / adam, "x", note="same run"),
        Row(_GROUP, "LM step, autograd gradient over kernel", slow / lm, "x", note="same run"),
    ]


def autograd_loss(model: NarxModel, record: Record, horizon: int) -> float:
    """Free-run loss over windows one after the other, and its gradient by autograd."""
    u, y = model.input_scaling.down(record.u), model.output_scaling.down(record.y)
    model.net.zero_grad()
    total = 0.0
    for first in range(1, len(y) - 1, horizon):
        part = slice(first - 1, min(first + horizon, len(y)))
        drive, target = torch.from_numpy(u[part])[None], torch.from_numpy(y[part])[None]
        run = simulate_slowly(model.net, target[:, :1], drive)
        loss = 0.5 * ((run - target) ** 2).sum() / (len(y) - 1)
        torch.autograd.backward(loss)
        total += float(loss.detach())
    return total


def _seconds(work: Callable[[], object], repeats: int = 5) -> float:
    """Least of several runs, after one that compiles."""
    if repeats > 1:
        work()
    took = []
    for _ in range(repeats):
        began = time.perf_counter()
        work()
        took.append(time.perf_counter() - began)
    return min(took)


@contextmanager
def _one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
