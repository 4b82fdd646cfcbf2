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
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
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
Estimates = Mapping[str, tuple[float, float]]


@dataclass(frozen=True, eq=False)
class Identification:
    """All steps of one engine; `engine` is one fit per record."""

    throttle: OutputErrorFit
    pressures: OutputErrorFit
    engine: tuple[OutputErrorFit, ...]
    control: OutputErrorFit


def identify(
    records: Sequence[FlightRecord], sigma: Mapping[str, float] | None = None
) -> Identification:
    """Run the four steps on records of one engine; `sigma` is the known noise, None estimates it.

    Raises as `fit` does.
    """
    dt_s = records[0].dt_s
    linkage, ducts = ThrottleLinkage(), DuctPressures(dt_s)
    throttle = fit(linkage, [one.of(linkage) for one in records], Plan(sigma=sigma))
    pressures = fit(ducts, [one.of(ducts) for one in records], Plan(sigma=sigma))
    found = {**pressures.parameters(), **throttle.parameters()}
    fuel = EngineFromFuel(dt_s)
    plan = Plan(start=within_bounds(fuel, found), sigma=sigma)
    engine = tuple(fit(fuel, one.of(fuel), plan) for one in records)
    found |= {name: one.combined.value for name, one in repeatability(engine).items()}
    whole = EngineAndControl(dt_s)
    plan = Plan(start=within_bounds(whole, found), sigma=sigma)
    control = fit(whole, [one.of(whole) for one in records], plan)
    return Identification(throttle, pressures, engine, control)


def within_bounds(model: Model, values: Mapping[str, float]) -> dict[str, float]:
    """Values of the model's free parameters, moved inside its bounds: start values of a fit."""
    return {
        one.name: float(np.clip(values[one.name], one.low, one.high))
        for one in model.parameters
        if one.free and one.name in values
    }


@dataclass(frozen=True, eq=False)
class Repeated:
    """One parameter over several records: a row of Table 3, and its combination for Table 4."""

    estimates: tuple[float, ...]
    sd: tuple[float, ...]
    combined: Combined


def repeatability(fits: Sequence[OutputErrorFit]) -> dict[str, Repeated]:
    """Estimates of single records by parameter, and their means weighted by dispersion."""
    found = [one.estimates() for one in fits]
    rows = {}
    for name in found[0]:
        values, sd = zip(*(each[name] for each in found), strict=True)
        rows[name] = Repeated(values, sd, combine(values, sd))
    return rows


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
    places = [control.names.index(name) for name in ("tau_H", "K_AF", "C_FH")]
    covariance = control.covariance if control.white else control.covariance_coloured
    values = {control.names[k]: float(control.values[k]) for k in places}
    return propagate(tau_engine, values, covariance[np.ix_(places, places)])


@dataclass(frozen=True, eq=False)
class Trial:
    """One seed: estimates by engine (engine and control; Cramer-Rao, coloured) and what follows.

    "twin" is the left engine with the right one's tau_H. `runs` are the estimates of the left
    engine from measured fuel flow, by parameter and record; `predicted` is the RMS error over a
    record that was not used, in sensor deviations, at worst.
    """

    plain: Mapping[str, Estimates]
    coloured: Mapping[str, Estimates]
    runs: Mapping[str, Combined]
    predicted: float


ENGINES: Final = ("left", "right", "twin")


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
    left = found["left"].control
    start = Plan(start=dict(zip(left.names, left.values.tolist(), strict=True)), sigma=sigma)
    rms = prediction_error(model, fit(model, used, start).parameters(), unused)
    return Trial(
        {engine: _estimates(one, coloured=False) for engine, one in found.items()},
        {engine: _estimates(one, coloured=True) for engine, one in found.items()},
        {name: one.combined for name, one in repeatability(found["left"].engine).items()},
        max(rms[name] / sigma[name] for name in rms),
    )


def _estimates(found: Identification, *, coloured: bool) -> dict[str, tuple[float, float]]:
    control = found.control
    sd = control.sd_coloured if coloured else control.sd
    pairs = zip(control.names, control.values.tolist(), sd.tolist(), strict=True)
    return {name: (value, s) for name, value, s in pairs} | {"tau_engine": tau_engine_of(control)}


def coverage(trials: Sequence[Trial], *, coloured: bool = False) -> dict[str, float]:
    """Share of 90 % intervals that contain the truth, in percent, by parameter and "pooled".

    Over the left and right engines; tau_engine, which follows from others, is not pooled.
    """
    half = float(norm.ppf(0.5 + LEVEL / 2.0))
    inside: dict[str, list[bool]] = {}
    for one in trials:
        for engine in SIDES:
            known = truth(engine)
            for name, (value, sd) in (one.coloured if coloured else one.plain)[engine].items():
                inside.setdefault(name, []).append(abs(value - known[name]) <= half * sd)
    shares = {name: 100.0 * float(np.mean(hits)) for name, hits in inside.items()}
    pooled = [hit for name, hits in inside.items() if name != "tau_engine" for hit in hits]
    return {**shares, "pooled": 100.0 * float(np.mean(pooled))}


def simulated_study(seeds: int, jobs: int = 1, progress: Progress = silent) -> Study:
    """Identify simulated engines for `seeds` seeds and hold intervals and tests to their levels."""
    trials = []
    for one in in_processes(trial, list(range(seeds)), jobs):
        trials.append(one)
        progress(len(trials), seeds, "simulated engines")
    shares, other = coverage(trials), coverage(trials, coloured=True)
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
        {one.name: one for one in compare(each.plain["left"], each.plain["twin"])}
        for each in trials
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
    rows = []
    for name, true in truth("left").items():
        if name in shares:
            each = np.array([one.plain["left"][name] for one in trials])
            scatter = float(each[:, 0].std(ddof=1)) if len(each) > 1 else math.nan
            rows.append((
                name, figure(true, digits=4), figure(each[:, 0].mean(), digits=4),
                each[:, 1].mean(), scatter, shares[name], other[name],
            ))  # fmt: skip
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
    combined = {row.name: combine(row.estimates, row.sd) for row in TABLE_3}
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
        claims=[*_table_claims(combined), *_difference_claims(differences)],
        tables=[_table_3(combined), _table_4(differences)],
        results={
            "birge": {name: one.birge for name, one in combined.items()},
            "z": {one.name: one.z for one in differences},
        },
    )


def _table_claims(combined: Mapping[str, Combined]) -> list[Claim]:
    agree = [
        name
        for name, one in combined.items()
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
        _claim("S10_records", max(one.birge for one in combined.values())),
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


def _table_3(combined: Mapping[str, Combined]) -> Table:
    head = ("parameter", "record 1", "record 2", "record 3", "mean", "Birge ratio", "Table 4 left")
    rows = [
        (
            row.name,
            *(
                Cell(f"{value:g} ({percent:g} %)", number=True)
                for value, percent in zip(row.estimates, row.sd_percent, strict=True)
            ),
            combined[row.name].value,
            birge_cell(combined[row.name]),
            _ROW[row.name].left,
        )
        for row in TABLE_3
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
            of[row.name].percent if row.name in of else None,
            of[row.name].z if row.name in of else None,
            "yes" if row.name in of and of[row.name].significant else "no",
            row.reading,
        )
        for row in TABLE_4
    ]
    return table_of("Table 4: left against right engine", head, rows)


def birge_cell(one: Combined) -> Cell:
    """Birge ratio, marked above 1.73: the 5 % limit for three records."""
    return figure(one.birge, "bad" if one.birge > 1.73 else "")


def spey_studies(seeds: int = 100, jobs: int = 1, progress: Progress = silent) -> tuple[Study, ...]:
    """Both studies: the paper's tables, and engines simulated with `seeds` seeds."""
    return paper_study(), simulated_study(seeds, jobs, progress)
