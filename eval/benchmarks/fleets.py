"""More flights, and a bad one, on virtual fleets: `python -m eval.bench --fleets --seed N`.

Every flight of a fleet is another engine of the type, with a build, a day, a route and sensors of
its own, and a configuration names columns and split alone. Flights that took no part judge a model
of the first few and one of all of them, so that both have the same cases: the natural logarithm of
the ratio of RMS errors, a mean over outputs, is averaged over the flights of a fleet, then over
fleets. Flights of a fleet share the training, so that the standard error is that between fleets.

The same models show how many samples of the judged flights lie in the 90 % intervals, and how wide
these are. The offsets b of the judged flights, in tolerances of a level, are a draw of their
fleet's scatter: they give the prior of `narxcal.intervals`, m recordings of scatter s_0, which
maximises over the fleets and outputs

    sum ln t_m(b_1 .. b_n; 0, s_0^2 I)        (multivariate t: s^2 inverse-gamma)

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
from scipy.optimize import minimize
from scipy.special import gammaln

from data_prep.log import Log
from eval.benchmarks import Row
from eval.evaluate import evaluate
from narxcal.calibration.bundle import Bundle
from narxcal.flight_test.fly import fly
from narxcal.flight_test.pilot import SIDES
from narxcal.flight_test.scenario import FlightScenario
from narxcal.support.arrays import FloatArray
from training.config import SCHEMA, RunConfig
from training.levels import prior_scatter
from training.pipeline import calibrate, configured_files, prepare_logs
from training.records import Split

FLEETS, SIZES, TESTS = 3, (1, 2, 3, 6, 12), 6
_FIRST = 3  # flights: to it models of more are compared
_LEAST_COVERAGE: Final = 0.87
BAD_OF = 6  # flights, one of which is bad
# A lever rigged wrong by a tenth of the way to full power, and a probe in the sun or in ice.
FAULTS: Final[Mapping[str, float]] = {"TRA_deg": 6.0, "dT_C": 15.0}
_ENGINES: Final = ("business_jet", "single_aisle")
_RATE_HZ, _DURATION_S = 8.0, 480.0
_MOST_STANDARD_ERRORS: Final = 2.0


class Judged(NamedTuple):
    """Free runs over judged flights, (flights, outputs) each; `offset` in tolerances of a level."""

    rmse: FloatArray
    coverage: FloatArray
    half_width: FloatArray
    offset: FloatArray
    names: tuple[str, ...]


class Case(NamedTuple):
    """Flights of one fleet as they are read, and the configuration that they are read with."""

    config: RunConfig
    folder: Path
    logs: Sequence[Log]


def rows(
    seed: int, fleets: int = FLEETS, sizes: Sequence[int] = SIZES, tests: int = TESTS
) -> Iterator[Row]:
    """Measure fleets drawn from `seed`."""
    grown: list[dict[int, Judged]] = []
    spoilt: list[list[FloatArray]] = []
    for number in range(fleets):
        with tempfile.TemporaryDirectory() as folder:
            write_fleet(Path(folder), (seed, number), max(sizes) + tests)
            case = read_fleet(Path(folder))
            new = case.logs[max(sizes) :]
            grown.append({n: judged(trained(case, case.logs[:n]), new) for n in sizes})
            spoilt.append(
                [judged(trained(case, logs), new).rmse for logs in with_faults(case.logs)]
            )
    words = f"{fleets} virtual fleets"
    for size in sizes[sizes.index(_FIRST) + 1 :]:
        pairs = [(each[size].rmse, each[_FIRST].rmse) for each in grown]
        yield ratio_row(f"{words}, error of more flights", f"{size} over {_FIRST}", pairs)
    for size in sizes:
        yield from interval_rows(f"{words}, 90 % intervals", size, [one[size] for one in grown])
    prior = fitted_prior([column for one in grown for column in one[max(sizes)].offset.T])
    for name, value in zip(("recordings m", "scatter s_0 in tolerances"), prior, strict=True):
        yield Row(f"{words}, prior of intervals", name, value, "")
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


def judged(bundle: Bundle, logs: Sequence[Log]) -> Judged:
    """Judge the free run over flights that took no part."""
    found = evaluate(bundle, logs).logs
    names = tuple(found[0].scores)
    rmse, coverage, half_width = (
        np.array([[getattr(one.scores[name], key) for name in names] for one in found])
        for key in ("rmse", "coverage", "half_width")
    )
    level = [
        [prior_scatter(name, float(np.nanmean(one.log[name]))) for name in names] for one in found
    ]
    offset = np.array([[each.error for each in one.levels] for one in found]) / np.array(level)
    return Judged(rmse, coverage, half_width, offset, names)


def interval_rows(group: str, size: int, found: Sequence[Judged]) -> Iterator[Row]:
    """Share of samples within the interval of models of `size` flights, by output."""
    for k, name in enumerate(found[0].names):
        coverage = np.array([one.coverage[:, k] for one in found])
        half = np.mean([one.half_width[:, k] for one in found])
        rmse = np.sqrt(np.mean([one.rmse[:, k] ** 2 for one in found]))
        note = f"half-width {half:.3g}, {half / rmse:.1f} times the RMSE"
        value, words = float(coverage.mean()), f"{name} of {size} flights"
        yield Row(group, words, value, "", _LEAST_COVERAGE, "at least", "0.87 to 0.93", note)


def fitted_prior(offsets: Sequence[FloatArray]) -> tuple[float, float]:
    """The m and s_0 of the largest marginal likelihood; `offsets` are those of one fleet each."""

    def loss(logs: FloatArray) -> float:
        m, square = np.exp(logs[0]), np.exp(2.0 * logs[1])
        total = 0.0
        for b in offsets:
            n = len(b)
            total += gammaln(0.5 * (m + n)) - gammaln(0.5 * m) - 0.5 * n * np.log(m * square)
            total -= 0.5 * (m + n) * np.log1p(b @ b / (m * square))
        return float(-total)

    bounds = [(np.log(0.2), np.log(50.0)), (np.log(1e-3), np.log(1e3))]
    m, scale = np.exp(minimize(loss, np.zeros(2), method="L-BFGS-B", bounds=bounds).x)
    return float(m), float(scale)


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
