"""More flights, and a bad one, on virtual fleets: `python -m eval.bench --fleets --seed N`.

Every flight of a fleet is another engine of the type, with a build, a day, a route and sensors of
its own, and a configuration names columns and split alone. Flights that took no part judge a model
of the first few and one of all of them, so that both have the same cases: the natural logarithm of
the ratio of RMS errors, a mean over outputs, is averaged over the flights of a fleet, then over
fleets. Flights of a fleet share the training, so that the standard error is that between fleets.

In a second comparison the first of the training flights is bad: its lever or air temperature reads
too much, while its other channels agree with each other. The error is compared with that of a model
of the same flights before the fault came in.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd

from data_prep.log import Log
from eval.benchmarks import Row
from eval.evaluate import evaluate
from narxcal.calibration.bundle import Bundle
from narxcal.flight_test.fly import fly
from narxcal.flight_test.pilot import SIDES
from narxcal.flight_test.scenario import FlightScenario
from narxcal.support.arrays import FloatArray
from training.config import SCHEMA, RunConfig
from training.pipeline import calibrate, configured_files, prepare_logs
from training.records import Split

FLEETS, SIZES, TESTS = 3, (3, 6, 12, 20), 6
BAD_OF = 6  # flights, one of which is bad
# A lever rigged wrong by a tenth of the way to full power, and a probe in the sun or in ice.
FAULTS: Final[Mapping[str, float]] = {"TRA_deg": 6.0, "dT_C": 15.0}
_ENGINES: Final = ("business_jet", "single_aisle")
_RATE_HZ, _DURATION_S = 8.0, 480.0
_MOST_STANDARD_ERRORS: Final = 2.0


class Case(NamedTuple):
    """Flights of one fleet as they are read, and the configuration that they are read with."""

    config: RunConfig
    folder: Path
    logs: Sequence[Log]


def rows(
    seed: int, fleets: int = FLEETS, sizes: Sequence[int] = SIZES, tests: int = TESTS
) -> Iterator[Row]:
    """Measure fleets drawn from `seed`."""
    grown: list[list[FloatArray]] = []
    spoilt: list[list[FloatArray]] = []
    for number in range(fleets):
        with tempfile.TemporaryDirectory() as folder:
            write_fleet(Path(folder), (seed, number), max(sizes) + tests)
            case = read_fleet(Path(folder))
            judged = case.logs[max(sizes) :]
            grown.append([errors(trained(case, case.logs[:size]), judged) for size in sizes])
            spoilt.append([errors(trained(case, logs), judged) for logs in with_faults(case.logs)])
    words = f"{fleets} virtual fleets"
    for k, size in enumerate(sizes[1:], 1):
        pairs = [(each[k], each[0]) for each in grown]
        yield ratio_row(f"{words}, error of more flights", f"{size} over {sizes[0]}", pairs)
    for k, (name, offset) in enumerate(FAULTS.items(), 1):
        pairs = [(each[k], each[0]) for each in spoilt]
        named = f"{name} reads {offset:g} more in 1 of {BAD_OF} flights, over sound"
        yield ratio_row(f"{words}, error with a bad flight", named, pairs, bounded=False)


def write_fleet(
    folder: Path, draw: tuple[int, int], flights: int, rate_hz: float = _RATE_HZ
) -> None:
    """Fly flights of as many engines of one type; `draw` are the seed and the fleet's number."""
    for flight in range(1, flights + 1):
        table: dict[str, Any] = {
            "engine": _ENGINES[draw[1] % 2],
            "engines": [SIDES[0]],
            "flights": 1,
            "seed": int(np.random.SeedSequence([*draw, flight]).generate_state(1)[0]),
            "plan": {"style": "enriched", "duration_s": _DURATION_S, "rate_hz": rate_hz},
        }
        recorded = fly(FlightScenario.parse(table, "fleet"), 1)[0].recorded
        name = folder / f"flight_{flight:02d}.csv"
        pd.DataFrame(dict(recorded)).to_csv(name, index=False, float_format="%.8g")


def read_fleet(folder: Path) -> Case:
    """Read the flights of a folder; the configuration says nothing about the model."""
    tables: dict[str, Any] = {
        "schema": SCHEMA,
        "logs": {"folder": str(folder), "files": ["flight_*.csv"]},
    }
    config = RunConfig.parse(tables, "fleet")
    return Case(config, folder, prepare_logs(config, configured_files(config, folder)))


def trained(case: Case, logs: Sequence[Log]) -> Bundle:
    """Train on some flights as `narxcal train` does."""
    return calibrate(case.config, case.folder, Split(tuple(logs), (), ()))


def with_faults(logs: Sequence[Log]) -> Iterator[tuple[Log, ...]]:
    """The first flights sound, then with each of the faults in the first of them."""
    first, *others = logs[:BAD_OF]
    yield first, *others
    for name, size in FAULTS.items():
        yield first.with_channels({name: first[name] + size}), *others


def errors(bundle: Bundle, judged: Sequence[Log]) -> FloatArray:
    """RMS errors (flights, outputs) of the free run."""
    found = evaluate(bundle, judged).logs
    return np.array([[score.rmse for score in one.scores.values()] for one in found])


def mean_log_ratio(pairs: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[float, float]:
    """Mean of ln ratio over fleets, and its standard error; a pair is one fleet's errors."""
    means = np.array([np.mean(np.log(new / old)) for new, old in pairs])
    error = np.std(means, ddof=1) / np.sqrt(len(means)) if len(means) > 1 else np.inf
    return float(means.mean()), float(error)


def ratio_row(
    group: str,
    name: str,
    pairs: Sequence[tuple[FloatArray, FloatArray]],
    *,
    bounded: bool = True,
) -> Row:
    """Ratio of the errors of two models over fleets; above 1 by chance alone it is no worse."""
    mean, error = mean_log_ratio(pairs)
    each = ", ".join(f"{np.exp(np.mean(np.log(new / old))):.2f}" for new, old in pairs)
    note = f"each {each}; standard error {100.0 * error:.0f} %"
    if not bounded:
        return Row(group, name, float(np.exp(mean)), "", note=note)
    most = float(np.exp(_MOST_STANDARD_ERRORS * error))
    return Row(
        group, name, float(np.exp(mean)), "", most, "at most", "no worse than by chance", note
    )
