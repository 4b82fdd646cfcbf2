"""Draw systems of random physics as sets for `narxcal benchmark`.

    python -m eval.benchmarks.drawn_systems FOLDER --seed 1
    narxcal benchmark --data FOLDER --jax-python PYTHON

No recipe can have been tuned on a seed that was not drawn before. Kind of input, parameters, length
(600 to 4000 samples) and noise (0.3 to 3 % of the output's standard deviation, in training and test
alike) are drawn for each system; training and test are two realisations of the same input.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.signal import lfilter

from narxcal.support.arrays import FloatArray

_TEST = 2000  # samples
_START = 50  # samples that a free run is given
Draw = np.random.Generator
Simulate = Callable[[FloatArray], FloatArray]


def _poles(draw: Draw) -> tuple[FloatArray, FloatArray]:
    """A stable filter of two poles and unit gain: an oscillation or two lags."""
    radius, angle = draw.uniform(0.6, 0.95), draw.uniform(0.0, 0.6)
    if draw.random() < 0.5:
        a = np.array([1.0, -2.0 * radius * np.cos(angle), radius**2])
    else:
        a = np.convolve([1.0, -radius], [1.0, -draw.uniform(0.2, radius)])
    return np.array([0.0, a.sum()]), a


def wiener_hammerstein(draw: Draw) -> Simulate:
    """A curve between two filters."""
    (b, a), (c, d) = _poles(draw), _poles(draw)
    slope, bend = draw.uniform(0.8, 2.5), draw.uniform(-0.4, 0.4)
    return lambda u: lfilter(c, d, np.tanh(slope * lfilter(b, a, u)) + bend * lfilter(b, a, u) ** 2)


def _by_steps(step: Callable[[FloatArray, float], float], states: FloatArray) -> Simulate:
    """Run `step(x, u) -> y`, which moves the states x, from the given ones."""

    def simulate(u: FloatArray) -> FloatArray:
        x = states.copy()
        return np.array([step(x, value) for value in u])

    return simulate


def hysteresis(draw: Draw) -> Simulate:
    """Bouc-Wen: a restoring force that remembers the way, in front of a lag."""
    beta, gamma, lag = draw.uniform(0.4, 0.9), draw.uniform(0.1, 0.5), draw.uniform(0.7, 0.95)
    share = draw.uniform(0.2, 0.5)

    def step(x: FloatArray, u: float) -> float:
        du, x[1] = u - x[1], u
        x[0] += du - abs(x[0]) * (beta * np.sign(du * x[0]) + gamma) * abs(du) * np.sign(x[0] or du)
        x[2] = lag * x[2] + (1.0 - lag) * (share * u + x[0])
        return float(x[2])

    return _by_steps(step, np.zeros(3))


def tanks(draw: Draw) -> Simulate:
    """Two tanks, of which the upper one overflows."""
    k1, k2 = draw.uniform(0.1, 0.4, 2)
    rim = draw.uniform(3.0, 6.0)

    def step(x: FloatArray, u: float) -> float:
        flow, out = k1 * np.sqrt(x[0]), k2 * np.sqrt(x[1])
        x[0] = min(max(x[0] + 0.2 * (u + 1.5) - flow, 0.0), rim)
        x[1] = max(x[1] + flow - out, 0.0)
        return float(x[1])

    return _by_steps(step, np.array([1.0, 1.0]))


def friction(draw: Draw) -> Simulate:
    """A mass with Coulomb friction on a spring that hardens."""
    coulomb, damping, cubic = draw.uniform(0.1, 0.5), draw.uniform(0.2, 0.8), draw.uniform(0.1, 0.8)

    def step(x: FloatArray, u: float) -> float:
        for _ in range(5):
            pull = u - coulomb * np.tanh(20.0 * x[1]) - damping * x[1] - x[0] - cubic * x[0] ** 3
            x[1] += 0.08 * pull
            x[0] += 0.08 * x[1]
        return float(x[0])

    return _by_steps(step, np.zeros(2))


def heater(draw: Draw) -> Simulate:
    """A heated body that radiates, behind a dead time, read through a sensor's lag."""
    rate, radiation, sensor = (
        draw.uniform(0.02, 0.1),
        draw.uniform(0.2, 0.8),
        draw.uniform(0.1, 0.5),
    )
    dead = int(draw.integers(1, 8))

    def step(x: FloatArray, u: float) -> float:
        x[3:], x[2] = x[2:-1].copy(), max(u + 1.0, 0.0)
        x[0] += rate * (x[1 + dead] - x[0] - radiation * ((1.0 + 0.5 * x[0]) ** 4 - 1.0) / 2.0)
        x[1] += sensor * (x[0] - x[1])
        return float(x[1])

    return _by_steps(step, np.zeros(10))


def spool(draw: Draw) -> Simulate:
    """A turbine's spool: torque of burnt fuel against a load in N^2, faster at high power."""
    inertia, lag, idle = draw.uniform(10.0, 40.0), draw.uniform(0.3, 0.8), draw.uniform(0.05, 0.2)

    def step(x: FloatArray, u: float) -> float:
        x[0] += lag * (max(0.5 + 0.35 * u, idle) - x[0])
        x[1] += (x[0] / max(x[1], 0.2) - x[1] ** 2) / inertia * (0.5 + x[1])
        return float(x[1])

    return _by_steps(step, np.array([0.5, 0.7]))


def bilinear(draw: Draw) -> Simulate:
    """A lag whose time constant and gain hang on the input, and a second lag."""
    pole, shift, second = draw.uniform(0.7, 0.93), draw.uniform(0.02, 0.06), draw.uniform(0.3, 0.8)

    def step(x: FloatArray, u: float) -> float:
        x[0] = (pole - shift * np.tanh(u)) * x[0] + (1.0 - pole) * u
        x[1] = second * x[1] + (1.0 - second) * x[0]
        return float(x[1])

    return _by_steps(step, np.zeros(2))


def linear(draw: Draw) -> Simulate:
    """Two filters behind a dead time."""
    (b, a), (c, d), dead = _poles(draw), _poles(draw), int(draw.integers(0, 6))
    return lambda u: lfilter(c, d, lfilter(b, a, np.r_[np.zeros(dead), u[: len(u) - dead]]))


SYSTEMS = (
    wiener_hammerstein, hysteresis, tanks, friction, heater, spool, bilinear, linear,
)  # fmt: skip


def excitation(draw: Draw) -> Callable[[int], FloatArray]:
    """Levels held for a while, many sines, or filtered noise; of unit standard deviation or so."""
    kind, hold, cut = int(draw.integers(3)), int(draw.integers(8, 40)), draw.uniform(0.02, 0.15)

    def levels(n: int) -> FloatArray:
        held = draw.integers(hold // 2, 2 * hold, n)
        return np.repeat(draw.uniform(-1.7, 1.7, n), held)[:n]

    def sines(n: int) -> FloatArray:
        phases = draw.uniform(0.0, 2.0 * np.pi, max(int(cut * n), 3))
        turns = np.outer(np.arange(n) / n, np.arange(1, len(phases) + 1))
        waves = np.cos(2.0 * np.pi * turns + phases).sum(axis=1)
        return np.asarray(waves / np.sqrt(len(phases) / 2.0))

    def noise(n: int) -> FloatArray:
        rough = lfilter([cut], [1.0, cut - 1.0], draw.standard_normal(n + 200))[200:]
        return np.asarray(rough / np.std(rough))

    return (levels, sines, noise)[kind]


def write(folder: Path, seed: int) -> None:
    """A set for every system, each of its own stream of random numbers."""
    folder.mkdir(parents=True, exist_ok=True)
    for number, system in enumerate(SYSTEMS):
        draw = np.random.default_rng([seed, number])
        simulate, drive = system(draw), excitation(draw)
        train, noise = int(draw.integers(600, 4000)), draw.uniform(0.003, 0.03)
        u = [drive(n) for n in (train, _TEST)]
        y = [simulate(one) for one in u]
        spread = noise * np.std(y[0])
        y = [one + spread * draw.standard_normal(len(one)) for one in y]
        table = pd.DataFrame({"u": np.concatenate(u), "y": np.concatenate(y)})
        name = f"{system.__name__}_{seed}"
        table.to_csv(folder / f"{name}.csv.gz", index=False)
        ends = {"train": [0, train], "test": [train, train + _TEST], "init_window": _START}
        (folder / f"{name}.json").write_text(json.dumps(ends), encoding="utf-8")


def main() -> None:
    """Write the sets of one seed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    write(options.folder, options.seed)


if __name__ == "__main__":
    main()
