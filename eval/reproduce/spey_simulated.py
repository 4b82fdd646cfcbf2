"""Coverage of intervals and level of tests on engines simulated with the paper's parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import binom, norm

from eval.report.tables import Table, figure
from eval.reproduce.study import Claim, Study, Watch, table_of
from narxcal.output_error.engine import EngineAndControl
from narxcal.output_error.experiment import fly
from narxcal.output_error.paper import SAMPLING_S, Side, noise_sd, table_4
from narxcal.support.parallel import in_processes
from training.likelihood_statistics import Combined, compare
from training.output_error import Plan, fit
from training.output_error_result import OutputErrorFit
from training.spey import (
    Identification,
    identify,
    prediction_error,
    repeatability,
    tau_engine,
    tau_engine_of,
)

LEVEL: Final = 0.9
SIDES: Final[tuple[Side, Side]] = ("left", "right")
Estimates = Mapping[str, tuple[float, float]]


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
    start = Plan(start=_inside(found["left"].control), sigma=sigma)
    rms = prediction_error(model, fit(model, used, start).parameters(), unused)
    return Trial(
        {engine: _estimates(one, coloured=False) for engine, one in found.items()},
        {engine: _estimates(one, coloured=True) for engine, one in found.items()},
        {name: one.combined for name, one in repeatability(found["left"].engine).items()},
        max(rms[name] / sigma[name] for name in rms),
    )


def _inside(found: OutputErrorFit) -> dict[str, float]:
    return dict(zip(found.names, found.values.tolist(), strict=True))


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


def simulated_study(seeds: int, jobs: int = 1, watch: Watch | None = None) -> Study:
    """Identify simulated engines for `seeds` seeds and hold intervals and tests to their levels."""
    trials = []
    for one in in_processes(trial, list(range(seeds)), jobs):
        trials.append(one)
        if watch:
            watch("Identifying simulated engines", len(trials), seeds)
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
        Claim("Coverage of 90 % intervals, pooled: distance from 90 %", "88 to 92 %",
              abs(shares["pooled"] - 90.0), "<= 2 %", f"{shares['pooled']:.1f} %", "goal"),
        Claim("Coverage of the parameter covered least", "82 to 97 %", each[low], ">= 82 %", low,
              "goal"),
        Claim("Coverage of the parameter covered most", "82 to 97 %", each[high], "<= 97 %", high,
              "goal"),
    ]  # fmt: skip


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
        Claim("Seeds in which the 35 % of tau_H are significant", "all", 100.0 * float(power),
              ">= 100 %", origin="goal"),
        Claim("Seeds in which any of the equal parameters is called different", "5 %",
              100.0 * float(false), f"<= {limit} %",
              "the bound is the 95 % limit for this many seeds", "goal"),
        Claim("S12 error over a record not used, in sensor deviations, worst output and seed",
              "predicted well", max(one.predicted for one in trials), "< 1.1",
              "1 is the sensor noise alone"),
        Claim("S10 Birge ratio of records that noise and the meter at the input explain",
              "9 to 22 in Table 3", birge, ">= 9",
              "largest of 10 parameters, median of seeds: the meter's lag and noise bias "
              "all records alike and leave the scatter of Table 3 unexplained"),
    ]  # fmt: skip


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
