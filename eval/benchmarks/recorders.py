"""Figures on real recorders, columns and split alone: `python -m eval.bench --recorders`.

Each recording of a set is trained on by itself, and what was not trained on is judged. A figure is
the free-run RMSE of one output, pooled over the judged logs, over that of the best of steady state,
first-order lag, linear ARX and output error. A figure is lost where nothing is left to judge it by.
Before them stand the response times in tolerance, beside those of the best baseline of a division.
Screening is judged by the samples that it masks and the logs with a finding, though nothing is
wrong with them (`KNOWN` says where something is).

The configurations in `columns/` name columns, outputs and inputs, and nothing about the model.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, NamedTuple, Self

import numpy as np
import pandas as pd
from scipy.optimize import minimize

from data_prep.log import Finding, Log, Source
from data_prep.prepare import prepare, with_outputs
from data_prep.reading import read_logs, shared_interval_s
from data_prep.sources.grid import joined
from eval.benchmarks import Row
from eval.benchmarks.flights import Passes, trained_on
from eval.judging.evaluate import evaluate
from eval.judging.free_run import BASELINES
from eval.run_logs import bank_of
from narxcal.channels import channel
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import NarxcalError
from training.config import RunConfig, load_config
from training.screening.masking import cross_screen
from training.screening.redundancy import is_measured
from training.screening.scatter import PRIORS, Priors, ScatterPrior, StepPrior
from training.screening.screen import screened

SETS: Final = ("citation", "a321", "jetcat", "test_cell", "micro_gas_turbine", "agtf30")
_SLACK_S: Final = 5.0
# Recording:engine -> channel and times in s of what is really wrong with it.
KNOWN: Final[Mapping[str, tuple[str, float, float]]] = {
    "citation_20200310_flight2.csv.gz:right": ("FF_kgph", 9.0, 549.0),
}


@dataclass(frozen=True, eq=False)
class Recorder:
    """One set: its configuration, and recording -> raw logs."""

    name: str
    config: RunConfig
    recordings: Mapping[str, Sequence[Log]]

    @classmethod
    def read(cls, name: str, data: Path) -> Recorder:
        """Read a set of `SETS`; raises `DataError` where its files are missing."""
        path = files("eval") / "benchmarks" / "columns" / f"{name}.toml"
        config = load_config(str(path))[0].with_logs_in(data)
        paths = config.logs.resolve(data)
        if name == "micro_gas_turbine":
            logs = _cut(paths[0])
        else:
            logs = read_logs(paths, config.logs)
            dt_s = shared_interval_s(logs)  # as `narxcal train` does
            logs = logs if dt_s is None else read_logs(paths, config.logs.every(dt_s))
        if name == "a321":  # one flight: its halves
            logs = [half for log in logs for half in _halves(log)]
        recordings: dict[str, list[Log]] = {}
        for log in logs:
            recordings.setdefault(log.source.file, []).append(log)
        return cls(name, config, recordings)

    def divisions(self) -> Iterator[tuple[str, list[Log], list[Log]]]:
        """Yield (recording, training logs, judged logs), raw."""
        for name, own in self.recordings.items():
            rest = [log for other, logs in self.recordings.items() if other != name for log in logs]
            yield name, list(own), rest


def _halves(log: Log) -> Iterator[Log]:
    middle = len(log) // 2
    for name, part in (("first", log.part(0, middle)), ("second", log.part(middle, len(log)))):
        source = Source(f"{name} half", f"{log.source.sha256} {name}", log.source.engine)
        yield replace(part, name=f"{name} half:{log.source.engine}", source=source)


def _cut(path: Path) -> list[Log]:
    """The recordings of the micro gas turbine as logs."""
    about = json.loads(path.with_name("micro_gas_turbine.json").read_text())
    table = pd.read_csv(path)
    logs = []
    for name, (start, stop) in {**about["train"], **about["test"]}.items():
        u, y = (table[column].to_numpy(np.float64)[start:stop] for column in ("u", "y"))
        channels = {"TRA_deg": 10.0 * u, "FN_kN": 1e-3 * y}
        time_s = about["dt"] * np.arange(stop - start)
        logs.append(Log(name, time_s, channels, source=Source(name, name)))
    return logs


@dataclass(frozen=True)
class Screened:
    """What screening made of one sound log: hours, samples, those masked, and findings.

    `found` is whether a known fault of the log was masked to within 5 s; None where there is none.
    """

    log: str
    hours: float
    samples: int
    masked: int
    findings: tuple[str, ...]
    found: bool | None = None


@dataclass(frozen=True)
class Figure:
    """One output of one division: RMSE of the free run and of the baselines."""

    output: str
    rmse: float
    baselines: Mapping[str, float] = field(default_factory=dict)
    why: str = ""

    @property
    def best(self) -> float:
        """Lowest RMSE of the baselines."""
        return min((one for one in self.baselines.values() if one > 0.0), default=math.nan)

    @property
    def ratio(self) -> float:
        """RMSE over the best baseline's."""
        return self.rmse / self.best


def screening(
    recorder: Recorder, train: Sequence[Log], judged: Sequence[Log], priors: Priors = PRIORS
) -> list[Screened]:
    """What is masked and found in the logs of one division, without any training."""
    config = recorder.config
    raw = [one.log for one in prepare(train, config)]
    names = (*config.narx.outputs, *config.steady_state.inputs)
    training, bank = cross_screen(raw, names, priors)
    others = screened(bank, [one.log for one in prepare(judged, config)])
    return [_screened(log, names) for log in (*training, *others)]


def _screened(log: Log, names: Sequence[str]) -> Screened:
    after, before = log.without_faults(), log
    lost = {
        name: np.isfinite(before[name]) & ~np.isfinite(after[name])
        for name in names
        if name in log.channels
    }
    findings = log.findings
    known, found = KNOWN.get(log.name.partition("#")[0]), None
    if known is not None and log.time_s[0] < known[2]:
        name, from_s, to_s = known
        times = log.time_s[lost[name]]
        ends = (times[0], times[-1]) if len(times) else (math.inf, math.inf)
        error = max(abs(ends[0] - max(from_s, log.time_s[0])), abs(ends[1] - to_s))
        found = bool(error <= _SLACK_S)
        lost[name] &= (log.time_s > to_s + _SLACK_S) | (log.time_s < from_s - _SLACK_S)
        findings = tuple(each for each in findings if not _is(each, known))
    samples = sum(int(np.isfinite(before[name]).sum()) for name in lost)
    count = sum(int(each.sum()) for each in lost.values())
    hours = len(log) * log.dt_s / 3600.0
    return Screened(log.name, hours, samples, count, tuple(f.caution for f in findings), found)


def _is(one: Finding, known: tuple[str, float, float]) -> bool:
    return one.channels == (known[0],) and (one.end_s or math.inf) < known[2] + _SLACK_S


def trained(
    recorder: Recorder, train: Sequence[Log], judged: Sequence[Log]
) -> tuple[list[Figure], Passes]:
    """Train on `train`, and judge response times and each output on `judged`."""
    config = recorder.config
    try:
        logs = [one.log for one in prepare(train, config)]
        bundle = trained_on(config, Path(), logs)
        whole = joined([one.log for one in prepare(judged, config)])
        others = screened(
            bank_of(bundle), [with_outputs(log, config.narx.outputs) for log in whole]
        )
        found = evaluate(bundle, others)
    except NarxcalError as error:
        lost = [Figure(name, math.nan, why=str(error)) for name in config.narx.outputs]
        return lost, Passes(0, 0, 0)
    extra = _output_error(config, logs, others)
    figures = [
        Figure(
            name,
            pooled.rmse,
            {**pooled.baselines, "output error": extra.get(name, math.nan)},
            "" if math.isfinite(pooled.rmse) else "every sample is masked",
        )
        for name, pooled in found.pooled.items()
    ]
    return figures, Passes.of(found, BASELINES)


def _output_error(
    config: RunConfig, train: Sequence[Log], judged: Sequence[Log]
) -> dict[str, float]:
    """RMSE of output-error fits: the two-spool engine's, else a response of each output."""
    for method in ("output-error", "transfer"):
        try:
            bundle = trained_on(config.having(identify={"method": method}), Path(), train)
            return {name: one.rmse for name, one in evaluate(bundle, judged).pooled.items()}
        except (NarxcalError, ValueError):
            continue
    return {}


@dataclass(frozen=True, eq=False)
class Shown:
    """What logs of one recorder show that are left out of its bank: the evidence for priors."""

    levels: Mapping[str, Sequence[float]]
    delays: Mapping[str, Sequence[float]]
    steps: Mapping[str, Mapping[int, Sequence[float]]]

    @classmethod
    def by(cls, recorder: Recorder) -> Self:
        """Learn the bank of all logs of a recorder, without what they show to be at fault."""
        config = recorder.config
        names = (*config.narx.outputs, *config.steady_state.inputs)
        raw = [log for logs in recorder.recordings.values() for log in logs]
        _, bank = cross_screen([one.log for one in prepare(raw, config)], names)
        if bank is None:
            return cls({}, {}, {})
        levels = {name: each for name, each in bank.level.items() if is_measured(name)}
        return cls(levels, bank.late, bank.heights())


def most_likely(shown: Sequence[Shown]) -> Priors:
    """Maximise the evidence of all recorders, over the logarithms of the priors' parameters."""

    def scatter(x: FloatArray) -> ScatterPrior:
        *medians, other, delay_s, recorders, channels = np.exp(x).tolist()
        units = dict(zip(PRIORS.scatter.median, medians, strict=True))
        return ScatterPrior(units, other, delay_s, recorders, channels)

    def steps(x: FloatArray) -> StepPrior:
        return StepPrior(*np.exp(x).tolist())

    def levels(x: FloatArray) -> float:
        return sum(scatter(x).log_evidence(each.levels, each.delays) for each in shown)

    one = PRIORS.scatter
    start = [*one.median.values(), one.other, one.delay_s, one.recorders, one.channels]
    heights = list(asdict(PRIORS.steps).values())
    return Priors(
        scatter(_maximum(levels, start)),
        steps(_maximum(lambda x: sum(steps(x).log_evidence(e.steps) for e in shown), heights)),
    )


def _maximum(evidence: Callable[[FloatArray], float], start: Sequence[float]) -> FloatArray:
    begin: FloatArray = np.log(np.array(start))

    def loss(x: FloatArray) -> float:
        return -evidence(x)

    found = minimize(
        loss, begin, method="Nelder-Mead",
        options={"maxiter": 4000, "maxfev": 4000, "xatol": 1e-2, "fatol": 1e-3},
    )  # fmt: skip
    return np.asarray(found.x)


def priors_of_others(data: Path) -> dict[str, Priors]:
    """The most likely priors of screening for each recorder by all others.

    None, so that the shipped ones are taken, where the files of a recorder are missing.
    """
    try:
        shown = {name: Shown.by(Recorder.read(name, data)) for name in SETS}
    except NarxcalError:
        return {}
    return {
        name: most_likely([each for other, each in shown.items() if other != name])
        for name in shown
    }


def rows(data: Path, sets: Sequence[str] = SETS, *, screening_only: bool = False) -> Iterator[Row]:
    """Measure the sets whose files are there, then all of them together.

    Screening has the priors by all other recorders; trained models have the shipped ones.
    """
    whole = Measured([], [], [])
    priors = priors_of_others(data)
    for name in sets:
        try:
            recorder = Recorder.read(name, data)
        except NarxcalError as error:
            yield Row(name, "all", math.nan, "", note=f"not measured: {error}")
            continue
        own = Measured([], [], [])
        for recording, train, judged in recorder.divisions():
            own.seen.extend(screening(recorder, train, judged, priors.get(name, PRIORS)))
            if not screening_only:
                figures, passes = trained(recorder, train, judged)
                yield passes.row(name, f"{recording}: Ti and Tt passed", _SOURCE)
                yield from (_row(name, recording, one) for one in figures)
                own.figures.extend(figures)
                own.passes.append(passes)
        yield from _summary(name, own)
        whole.figures.extend(own.figures)
        whole.passes.extend(own.passes)
        whole.seen.extend(own.seen)
    if len(sets) > 1:
        yield from _summary("all recorders", whole)


class Measured(NamedTuple):
    """What was measured of divisions; `seen` are logs."""

    figures: list[Figure]
    passes: list[Passes]
    seen: list[Screened]


_SOURCE: Final = "best of steady state, first-order lag, ARX; of errors also output error"


def _row(name: str, recording: str, one: Figure) -> Row:
    title = f"{recording}: {one.output}"
    unit = channel(one.output).unit
    return Row(name, title, one.rmse, unit, one.best, "at most", _SOURCE, one.why)


_TARGET: Final = "our goal"


def _summary(name: str, found: Measured) -> Iterator[Row]:
    group = f"{name}, together"
    if found.passes:
        total = Passes(*map(sum, zip(*found.passes, strict=True)))
        yield total.row(group, "Ti and Tt passed", _SOURCE)
    ratios = [one.ratio for one in found.figures if math.isfinite(one.ratio)]
    if ratios:
        mean = math.exp(float(np.mean(np.log(ratios))))
        yield Row(group, "geometric mean over the best", mean, "", 0.92, "at most", _TARGET)
        yield Row(group, "worst over the best", max(ratios), "", 1.1, "at most", _TARGET)
    if found.figures:
        lost, note = len(found.figures) - len(ratios), f"of {len(found.figures)}"
        yield Row(group, "figures lost", float(lost), "", 0.0, "at most", _TARGET, note)
    yield from _screening_rows(group, found.seen)


def _screening_rows(group: str, seen: Sequence[Screened]) -> Iterator[Row]:
    samples, hours = sum(one.samples for one in seen), sum(one.hours for one in seen)
    share = 100.0 * sum(one.masked for one in seen) / max(samples, 1)
    yield Row(group, "sound samples masked", share, "%", 0.1, "at most", _TARGET)
    reported = [one for one in seen if one.findings]
    rate = 100.0 * len(reported) / hours if hours else math.nan
    note = f"{len(reported)} of {len(seen)} logs in {hours:.1f} h"
    yield Row(
        group, "sound logs with a finding, per 100 h", rate, "", 1.0, "at most", _TARGET, note
    )
    for text in dict.fromkeys(each for one in reported for each in one.findings):
        yield Row(group, f"found: {text}", math.nan, "")
    known = [one for one in seen if one.found is not None]
    if known:
        found, note = sum(bool(one.found) for one in known), f"of {len(known)}"
        name = "known faults masked within 5 s"
        target = float(len(known))
        yield Row(group, name, float(found), "", target, "at least", _TARGET, note)


def options_of(names: str) -> tuple[str, ...]:
    """Sets of a comma-separated list; raises `ValueError` for one that does not exist."""
    wanted: tuple[Any, ...] = tuple(names.split(","))
    for name in wanted:
        if name not in SETS:
            raise ValueError(f"no set '{name}'; sets are {', '.join(SETS)}")
    return wanted
