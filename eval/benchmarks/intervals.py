"""Intervals and fuser on virtual fleets: `python -m eval.bench --intervals --seed N`.

Fleets are those of `eval.benchmarks.fleets`. A model is trained on the first few
flights of a fleet, and the share of samples within its 90 % interval is counted on flights that
took no part. Coverage is a mean over fleets, since that of one fleet hangs on its few logs. The
fuser runs over the same flights with every other half minute hidden, and is judged where nothing is
measured: there it has the model, and the model's error from before.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from eval.benchmarks.fleets import read_fleet, trained, write_fleet
from eval.benchmarks.row import Row
from eval.evaluate import evaluate
from eval.free_run import FreeRun
from narxcal.calibration.fuser import FastFuser
from narxcal.calibration.noise import NoiseModel
from narxcal.channels import channel
from narxcal.intervals import LEVEL
from narxcal.support.arrays import FloatArray, known_mean

FLEETS, SIZES, TESTS = 5, (4, 8, 12), 6
_HIDDEN_S: Final = 30.0
_MOST_OFF: Final = 3.0  # percentage points of the coverage


class Covered(NamedTuple):
    """Figures (outputs,) over all test flights of one fleet.

    Coverage, mean half-width, and the fuser's RMS error over that of the free run in hidden parts.
    """

    outputs: tuple[str, ...]
    coverage: FloatArray
    half_width: FloatArray
    hidden: FloatArray


def rows(
    seed: int, fleets: int = FLEETS, sizes: tuple[int, ...] = SIZES, tests: int = TESTS
) -> Iterator[Row]:
    """Measure fleets drawn from `seed`, trained on `sizes` of their flights each."""
    found: dict[int, list[Covered]] = {size: [] for size in sizes}
    for number in range(fleets):
        with tempfile.TemporaryDirectory() as folder:
            write_fleet(Path(folder), (seed, number), max(sizes) + tests)
            for size in sizes:
                found[size].append(covered(Path(folder), size, (max(sizes), tests)))
    for size, each in found.items():
        yield from _rows_of(size, each, tests)


def covered(folder: Path, size: int, tests: tuple[int, int]) -> Covered:
    """Train on `size` flights; `tests` are the number of the first one tested, and how many are."""
    first, count = tests
    case = read_fleet(folder)
    bundle = trained(case, case.logs[:size])
    found = evaluate(bundle, case.logs[first : first + count])
    pooled = found.pooled
    noise = NoiseModel.from_dict(bundle.record.fuser_noise or {})
    return Covered(
        tuple(pooled),
        np.array([one.coverage for one in pooled.values()]),
        np.array([one.half_width for one in pooled.values()]),
        _hidden(noise, [log.run for log in found.logs]),
    )


def _hidden(noise: NoiseModel, runs: Sequence[FreeRun]) -> FloatArray:
    """RMS error of the fuser over that of the free run (outputs,), where nothing is measured."""
    squares = []
    for run in runs:
        hide = (run.log.time_s - run.log.time_s[0]) % (2.0 * _HIDDEN_S) >= _HIDDEN_S
        seen = np.where(hide[:, None], np.nan, run.measured)
        fused = FastFuser(noise).run(run.model, seen)
        errors = np.stack([fused.values, run.model]) - run.measured
        squares.append(known_mean(errors[:, hide] ** 2, axis=1))
    mean = np.mean(squares, axis=0)
    return np.asarray(np.sqrt(mean[0] / mean[1]))


def _rows_of(size: int, fleets: list[Covered], tests: int) -> Iterator[Row]:
    group = f"{100 * LEVEL:.0f} % interval, {len(fleets)} fleets, trained on {size} flights"
    coverage = 100.0 * np.stack([one.coverage for one in fleets])
    for k, name in enumerate(fleets[0].outputs):
        spread = f"by fleet {', '.join(f'{share:.0f}' for share in coverage[:, k])}"
        wide = np.mean([one.half_width[k] for one in fleets])
        note = f"{spread}; mean half-width {wide:.3g} {channel(name).unit}"
        yield Row(group, f"coverage of {name}", float(coverage[:, k].mean()), "%", note=note)
    hidden = np.exp(np.mean(np.log([one.hidden for one in fleets]), axis=0))
    for name, ratio in zip(fleets[0].outputs, hidden.tolist(), strict=True):
        unseen = f"fuser over free run without {name} for {_HIDDEN_S:.0f} s"
        yield Row(group, unseen, ratio, "", 1.0, "at most", "no worse than the model alone")
    yield Row(
        group,
        "mean coverage less its level",
        abs(float(coverage.mean()) - 100.0 * LEVEL),
        "points",
        _MOST_OFF,
        "at most",
        "87 to 93 % covered",
        f"{coverage.mean():.1f} % of the samples of {tests} held-out flights each",
    )
