"""The Spey paper (DeHoff et al.): its claims against its own tables and simulated flights.

The paper's records are not available: `paper_study` recomputes what follows from its tables.

Its procedure identifies part by part (section IV): throttle; pressures from measured speeds; engine
from measured fuel flow, record by record (Table 3); engine and control from the command, all
records at once. Each step starts from the one before. Measured inputs carry noise, which output
error does not model: the first three steps are biased by it (docs/reproduce.md), the last is not,
since its input is the command.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import product
from typing import Final, NamedTuple

import numpy as np
import pandas as pd
from scipy.stats import binom, norm

from eval.report.tables import Cell, Table, figure
from eval.reproduce.study import Claim, Study, claim, table_of
from narxcal.output_error.engine import (
    DuctPressures,
    EngineAndControl,
    EngineFromFuel,
    ThrottleLinkage,
)
from narxcal.output_error.paper import (
    SAMPLING_S,
    TABLE_3,
    TABLE_4,
    TAU_ENGINE,
    FlightRecord,
    Side,
    fly,
    noise_sd,
    table_4,
    throttle_programme,
)
from narxcal.record import Record
from narxcal.support.parallel import in_processes
from narxcal.support.progress import Progress, silent
from training.papers.likelihood_statistics import Combined, Difference, combine, compare, propagate
from training.papers.output_error import Model, Plan, fit
from training.papers.output_error_result import OutputErrorFit

LEVEL: Final = 0.9
_claim = partial(claim, "spey")
SIDES: Final[tuple[Side, Side]] = ("left", "right")
ENGINES: Final = (*SIDES, "twin")


def identify(
    records: Sequence[FlightRecord], sigma: Mapping[str, float] | None = None
) -> tuple[dict[str, Combined], OutputErrorFit]:
    """Run the four steps on records of one engine; `sigma` is the known noise, None estimates it.

    Returns the weighted means of the engine's parameters over single records, and the joint fit of
    engine and control. Raises as `fit` does.
    """
    dt_s = records[0].dt_s
    found: dict[str, float] = {}
    for chain in (DuctPressures(dt_s), ThrottleLinkage()):
        found |= fit(chain, [one.of(chain) for one in records], Plan(sigma=sigma)).parameters()
    fuel, whole = EngineFromFuel(dt_s), EngineAndControl(dt_s)
    plan = Plan(start=within_bounds(fuel, found), sigma=sigma)
    means = combined([fit(fuel, one.of(fuel), plan) for one in records])
    found |= {name: one.value for name, one in means.items()}
    plan = Plan(start=within_bounds(whole, found), sigma=sigma)
    return means, fit(whole, [one.of(whole) for one in records], plan)


def within_bounds(model: Model, values: Mapping[str, float]) -> dict[str, float]:
    """Values of the model's free parameters, moved inside its bounds: start values of a fit."""
    return {
        one.name: float(np.clip(values[one.name], one.low, one.high))
        for one in model.parameters
        if one.free and one.name in values
    }


def combined(fits: Sequence[OutputErrorFit]) -> dict[str, Combined]:
    """Means of single records, weighted by dispersion: a row of Table 3 for Table 4."""
    found = [one.estimates() for one in fits]
    return {name: combine(*zip(*(each[name] for each in found), strict=True)) for name in found[0]}


def prediction_error(model: Model, values: Mapping[str, float], record: Record) -> dict[str, float]:
    """RMS error of each output over a record, simulated with `OutputErrorFit.parameters()`."""
    error = record.y - np.asarray(model.simulate(values, record.u))
    rms = np.sqrt(np.nanmean(error**2, axis=0))
    return dict(zip(model.output_names, rms.tolist(), strict=True))


def tau_engine(values: Mapping[str, complex]) -> complex:
    """Time constant of engine and governor with C_FB = C_FH, tau_H / (K_AF C_FB), in s.

    Put the governor's law into the row of N_H: tau_H N_H' = C_FH K_AF (N_c - N_H), as the positive
    feedback cancels the engine's own restoring force.
    """
    return values["tau_H"] / (values["K_AF"] * values["C_FH"])


def tau_engine_of(control: OutputErrorFit) -> tuple[float, float]:
    """tau_engine and its standard deviation, s, with the correlations of the fit."""
    names = ("tau_H", "K_AF", "C_FH")
    places = [control.names.index(name) for name in names]
    covariance = control.covariance if control.white else control.covariance_coloured
    estimates = control.estimates()
    values = {name: estimates[name][0] for name in names}
    return propagate(tau_engine, values, covariance[np.ix_(places, places)])


class Trial(NamedTuple):
    """One seed: what was identified, and what it predicts.

    `estimates` has rows (engine, name) with the value by engine and control, its deviation by
    Cramer and Rao and for coloured residuals; "twin" is the left engine with the right one's tau_H.
    `runs` are those of the left engine from measured fuel flow; `predicted` is the RMS error over a
    record that was not used, in sensor deviations, at worst.
    """

    estimates: pd.DataFrame
    runs: Mapping[str, Combined]
    predicted: float

    def of(self, engine: str) -> dict[str, tuple[float, float]]:
        """Values and deviations of one engine."""
        own = self.estimates.loc[engine]
        return dict(zip(own.index, zip(own["value"], own["sd"], strict=True), strict=True))


def truth(engine: str) -> dict[str, float]:
    """Parameters of a simulated engine, tau_engine among them."""
    values = table_4("right" if engine == "right" else "left")
    if engine == "twin":
        values["tau_H"] = table_4("right")["tau_H"]
    return {**values, "tau_engine": tau_engine(values).real}


def trial(seed: int) -> Trial:
    """Fly and identify the three engines, each with noise of its own."""
    sigma = noise_sd()
    flown = {engine: fly(truth(engine), 3 * seed + k) for k, engine in enumerate(ENGINES)}
    found = {engine: identify(records, sigma) for engine, records in flown.items()}
    model = EngineAndControl(SAMPLING_S)
    *used, unused = (one.of(model) for one in flown["left"])
    runs, left = found["left"]
    start = Plan(start={name: one[0] for name, one in left.estimates().items()}, sigma=sigma)
    rms = prediction_error(model, fit(model, used, start).parameters(), unused)
    rows = pd.concat({engine: _estimates(control) for engine, (_, control) in found.items()})
    return Trial(rows, runs, max(rms[name] / sigma[name] for name in rms))


def _estimates(control: OutputErrorFit) -> pd.DataFrame:
    found = control.values, control.sd, control.sd_coloured  # noqa: PD011 -- no data frame
    rows = pd.DataFrame(np.transpose(found), list(control.names), ["value", "sd", "coloured"])
    value, sd = tau_engine_of(control)
    rows.loc["tau_engine"] = value, sd, sd
    return rows


def coverage(trials: Sequence[Trial], sd: str = "sd") -> dict[str, float]:
    """Share of 90 % intervals that contain the truth, in percent, by parameter and "pooled".

    Over the left and right engines; tau_engine, which follows from others, is not pooled.
    """
    half = float(norm.ppf(0.5 + LEVEL / 2.0))
    inside = []
    for one, engine in product(trials, SIDES):
        own, known = one.estimates.loc[engine], truth(engine)
        inside.append(abs(own["value"] - [known[name] for name in own.index]) <= half * own[sd])
    hits = pd.concat(inside, axis=1)
    pooled = hits.drop(index="tau_engine").to_numpy().mean()
    return {**(100.0 * hits.mean(axis=1)).to_dict(), "pooled": 100.0 * float(pooled)}


def simulated_study(seeds: int, jobs: int = 1, progress: Progress = silent) -> Study:
    """Identify simulated engines for `seeds` seeds and hold intervals and tests to their levels."""
    trials = []
    for one in in_processes(trial, list(range(seeds)), jobs):
        trials.append(one)
        progress(len(trials), seeds, "simulated engines")
    shares, other = coverage(trials), coverage(trials, "coloured")
    return Study(
        key="spey-simulated",
        title="Engines simulated with the paper's parameters",
        source="tables 1 and 4; records of 3000, 3000 and 2000 points every 0.05 s (assumed)",
        text=f"{seeds} seeds, left and right engine by Table 4, 5 deg of throttle; the command is "
        "known exactly, all else has Table 1's noise. Intervals of 90 % from the joint fit of "
        "engine and control. A twin engine differs from the left one only in tau_H.",
        claims=[*_coverage_claims(shares), *_test_claims(trials)],
        tables=[_coverage_table(trials, shares, other), _runs_table(trials)],
        results={"seeds": seeds, "coverage": shares, "coverage_coloured": other},
    )


def _coverage_claims(shares: Mapping[str, float]) -> list[Claim]:
    each = {name: share for name, share in shares.items() if name not in ("pooled", "tau_engine")}
    low, high = min(each, key=each.__getitem__), max(each, key=each.__getitem__)
    return [
        _claim("pooled", abs(shares["pooled"] - 90.0), share=shares["pooled"]),
        _claim("least", each[low], name=low),
        _claim("most", each[high], name=high),
    ]


def _test_claims(trials: Sequence[Trial]) -> list[Claim]:
    found = [
        {one.name: one for one in compare(each.of("left"), each.of("twin"))} for each in trials
    ]
    equal = [name for name in found[0] if name not in ("tau_H", "tau_engine")]
    power = np.mean([one["tau_H"].significant for one in found])
    false = np.mean([any(one[name].significant for name in equal) for one in found])
    limit = 100.0 * float(binom.ppf(0.95, len(trials), 0.05) / len(trials))
    birge = float(np.median([max(one.birge for one in each.runs.values()) for each in trials]))
    return [
        _claim("power", 100.0 * float(power)),
        _claim("false", 100.0 * float(false), limit=limit),
        _claim("S12", max(one.predicted for one in trials)),
        _claim("S10_meter", birge),
    ]


def _coverage_table(
    trials: Sequence[Trial], shares: Mapping[str, float], other: Mapping[str, float]
) -> Table:
    head = ("parameter", "true left", "mean", "sd reported", "sd observed", "coverage [%]",
            "coverage, corrected sd [%]")  # fmt: skip
    every = pd.concat([one.estimates.loc["left"] for one in trials]).groupby(level=0)
    means, scatter = every.mean(), every["value"].std()
    rows = [
        (
            name, figure(true, digits=4), figure(means["value"][name], digits=4),
            means["sd"][name], scatter[name], shares[name], other[name],
        )
        for name, true in truth("left").items()
        if name in shares
    ]  # fmt: skip
    return table_of("Joint fit of engine and control; coverage over both engines", head, rows)


def _runs_table(trials: Sequence[Trial]) -> Table:
    """Bias of the paper's step "fuel flow as input", whose input is measured."""
    head = ("parameter", "true", "mean of weighted means", "bias [%]", "bias / sd", "Birge, median")
    rows = []
    for name in trials[0].runs:
        true = truth("left")[name]
        values = np.array([[one.runs[name].value, one.runs[name].sd] for one in trials])
        bias = float(values[:, 0].mean() - true)
        rows.append((
            name, true, float(values[:, 0].mean()), 100.0 * bias / abs(true),
            bias / float(values[:, 1].mean()),
            float(np.median([one.runs[name].birge for one in trials])),
        ))  # fmt: skip
    return table_of("Left engine from measured fuel flow, record by record", head, rows)


_ROW = {row.name: row for row in TABLE_4}


def paper_study() -> Study:
    """Claims that follow from the printed tables; contradictions carry their reason."""
    means = {row.name: combine(row.estimates, row.sd) for row in TABLE_3}
    differences = compare(
        {row.name: row.side("left") for row in TABLE_4},
        {row.name: row.side("right") for row in TABLE_4},
    )
    return Study(
        key="spey-tables",
        title="The paper's tables, recomputed",
        source="DeHoff et al., tables 3 and 4",
        text="Table 3 is of the left engine. Means are weighted by 1/sd^2; the Birge ratio is the "
        "scatter between records over the reported standard deviation. The +- of Table 4 is taken "
        "as one standard deviation; significance at 5 % over all parameters together (Holm).",
        claims=[*_table_claims(means), *_difference_claims(differences)],
        tables=[_table_3(means), _table_4(differences)],
        results={
            "birge": {name: one.birge for name, one in means.items()},
            "z": {one.name: one.z for one in differences},
        },
    )


def _table_claims(means: Mapping[str, Combined]) -> list[Claim]:
    agree = [
        name
        for name, one in means.items()
        if abs(one.value - _ROW[name].left) <= _ROW[name].left_sd
    ]
    closed = max(abs(tau_engine(table_4(side)).real - TAU_ENGINE.side(side)[0]) for side in SIDES)
    ratio = [_ratio(_ROW["tau_L"].side(side), _ROW["tau_H"].side(side)) for side in SIDES]
    worst = max(abs(value - 1.5) / sd for value, sd in ratio)
    return [
        _claim("S3", closed),
        _claim("S5", len(agree), listed=", ".join(agree)),
        _claim("S6_ratio", worst, left=ratio[0][0], right=ratio[1][0]),
        _claim("S9", _effect_of_duct_lag()),
        _claim("S10_records", max(one.birge for one in means.values())),
    ]


def _ratio(a: tuple[float, float], b: tuple[float, float]) -> tuple[float, float]:
    value = a[0] / b[0]
    return value, value * math.hypot(a[1] / a[0], b[1] / b[0])


def _effect_of_duct_lag() -> float:
    """RMS change of the duct pressure when its lag is left out, in sensor deviations."""
    command = throttle_programme("doublets", 3000, 5.0)[:, None]
    engine = EngineAndControl(SAMPLING_S)
    base = {one.name: one.start for one in engine.parameters} | table_4("left")
    with_lag, without = (
        engine.simulate({**base, "tau_D": tau}, command)[:, -1] for tau in (0.05, 0.0)
    )
    return float(np.sqrt(np.mean((with_lag - without) ** 2)) / noise_sd()["P_DM"])


def _difference_claims(differences: Sequence[Difference]) -> list[Claim]:
    of = {one.name: one for one in differences}
    far = [one for one in differences if abs(one.percent) > 10.0 and one.name != "tau_H"]
    listed = ", ".join(
        f"{one.name} {one.percent:+.0f} % ({'' if one.significant else 'not '}significant)"
        for one in far
    )
    tau_H = of["tau_H"]
    equal = (("S6_same", "tau_L"), ("S7", "a_fixed"), ("S8", "C_FH"))
    return [
        _claim("S2", tau_H.p_holm, percent=tau_H.percent, z=tau_H.z),
        _claim("S4", len(far), listed=listed),
        *(_claim(key, abs(of[name].z)) for key, name in equal),
    ]


def _table_3(means: Mapping[str, Combined]) -> Table:
    head = ("parameter", "record 1", "record 2", "record 3", "mean", "Birge ratio", "Table 4 left")
    rows = [
        (
            row.name,
            *(
                Cell(f"{value:g} ({percent:g} %)", number=True)
                for value, percent in zip(row.estimates, row.sd_percent, strict=True)
            ),
            one.value,
            # 1.73: the 5 % limit for three records
            figure(one.birge, "bad" if one.birge > 1.73 else ""),
            _ROW[row.name].left,
        )
        for row, one in zip(TABLE_3, means.values(), strict=True)
    ]
    return table_of("Table 3: three records, standard deviations in percent", head, rows)


def _table_4(differences: Sequence[Difference]) -> Table:
    head = ("parameter", "left", "right", "difference [%]", "z", "significant", "read as")
    of = {one.name: one for one in differences}
    rows = [
        (
            row.name,
            Cell(f"{row.left:g} ± {row.left_sd:g}", number=True),
            Cell(f"{row.right:g} ± {row.right_sd:g}", number=True),
            one and one.percent,
            one and one.z,
            "yes" if one and one.significant else "no",
            row.reading,
        )
        for row, one in ((row, of.get(row.name)) for row in TABLE_4)
    ]
    return table_of("Table 4: left against right engine", head, rows)


def spey_studies(seeds: int = 100, jobs: int = 1, progress: Progress = silent) -> tuple[Study, ...]:
    """Both studies: the paper's tables, and engines simulated with `seeds` seeds."""
    return paper_study(), simulated_study(seeds, jobs, progress)
