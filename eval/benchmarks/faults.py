"""Drawn faults put into sound logs, and what is found of them: `python -m eval.benchmarks.faults`.

Models are trained on other flights than those that the faults are put into. A fault counts if it
moves the free run (an input) or the measurement (an output) by more than three times the held-out
error of the free run in some output. Figures: share detected, share with channel and kind, samples
masked on sound logs, sound logs with any fault, and the delay between the time from which the
effect exceeds that bound for 20 s and the time from which the fault is reported.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.ndimage import uniform_filter1d

from data_prep.log import Finding, Log
from data_prep.prepare import hold_inputs, prepare
from data_prep.reading import read_logs
from eval.benchmarks import Row
from eval.benchmarks.fault_draws import Injection, drawn, flights
from narxcal.calibration.bundle import Bundle
from narxcal.calibration.calibration import Calibration
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import DataError
from training.config import RunConfig, load_config
from training.pipeline import calibrate, configured_files
from training.records import Split
from training.redundancy import Bank
from training.screening import screened

_TIMES = 3.0  # the held-out error that a fault has to move the free run by
_LASTING_S = 20.0


@dataclass(frozen=True)
class Trial:
    """One fault in one log, and what was found."""

    injection: Injection
    found: tuple[Finding, ...]
    counts: bool
    noticeable_s: float

    @property
    def detected(self) -> bool:
        """Whether any fault was found that concerns a channel of it."""
        wanted = {*self.injection.channels}
        return any(wanted & {*each.channels} for each in self.found) or (
            "time_s" in wanted and bool(self.found)
        )

    @property
    def named(self) -> bool:
        """Whether one was found with the channels and the kind of it."""
        wanted = {*self.injection.channels}
        return any(
            {*each.channels} == wanted and each.kind == self.injection.kind for each in self.found
        )

    @property
    def delay_s(self) -> float:
        """From where its effect is noticeable to where it is reported; NaN where it is not."""
        wanted = {*self.injection.channels}
        from_s = [each.start_s or 0.0 for each in self.found if wanted & {*each.channels}]
        return max(0.0, min(from_s) - self.noticeable_s) if from_s else float("nan")


@dataclass(frozen=True)
class Result:
    """All trials of one campaign, and what was found in its sound logs."""

    name: str
    trials: tuple[Trial, ...]
    false_share: float
    sound_logs: int
    accused: int
    reports: tuple[str, ...] = field(default=())


def _measured(
    name: str, config: RunConfig, raw: tuple[Sequence[Log], Sequence[Log]], seed: int, *, show: bool
) -> Result:
    """Train on the first of the raw logs, and put drawn faults into the others."""
    train, test = raw
    config = config.having(train={"choice_s": 0.0})
    logs = tuple(one.log for one in prepare(train, config))
    bundle = calibrate(config, Path(), Split(logs, (), ()))
    bank = Bank.from_json(bundle.record.redundancy or {})
    trials = tuple(
        trial for log in test for trial in _trials(log, config, (bundle, bank), seed, show=show)
    )
    sound = [one.log for one in prepare(test, config)]
    found = [(log, log.findings) for log in screened(bank, sound)]
    reports = tuple(each.caution for _, faults in found for each in faults)
    if show:
        sys.stdout.writelines(f"sound  {each}\n" for each in reports)
    lost = sum(_masked(log, faults) for log, faults in found) / sum(_size(log) for log in sound)
    accused = sum(bool(faults) for _, faults in found)
    return Result(name, trials, lost, len(sound), accused, reports)


_FUEL = {
    "schema": "narxcal.config/1",
    "events": {"driver": "FF_kgph", "condition": ""},
    "steady_state": {
        "inputs": ["FF_kgph", "ALT_ft", "Mach", "dT_C"], "blend": ["Mach"], "switches": [],
        "corrected": True,
    },
    "narx": {"lag": True, "lag_limits": False, "lag_governed": False, "lags": 1, "hidden": 4},
    "train": {"horizons_s": [5.0], "iterations": [6]},
}  # fmt: skip
_LEVER = {
    **_FUEL,
    "events": {"driver": "TRA_deg", "condition": ""},
    "steady_state": {
        "inputs": ["TRA_deg", "ALT_ft", "Mach", "dT_C"], "blend": ["Mach"], "switches": [],
    },
    "logs": {"raster_hz": 8.0},
}  # fmt: skip
_PER_LOG = 24  # faults: about 100 in all, so that a share has a standard error of 2 to 5 points


def results(data: Path, seed: int, *, show: bool = False) -> Iterator[Result]:
    """Measure drawn engines, simulations by others and a real recorder; `data` holds the files.

    No limit of the screening was chosen on the engines and the simulations. What has no files is
    left out.
    """
    fuel, lever = RunConfig.parse(_FUEL), RunConfig.parse(_LEVER)
    for engine, logs in (("business_jet", 4), ("single_aisle", 5), ("business_jet", 3)):
        raw = list(flights(engine, 7000 + 10 * seed + logs, logs))
        name = f"{engine}, {logs - 1} training flights"
        yield _measured(name, fuel, (raw[:-1], raw[-1:]), seed, show=show)
    for case in ("case_A", "case_B"):
        files = sorted((data / "gap_example" / case).glob("real*/*.csv.gz"))
        if files:
            raw = read_logs(files, lever.logs)
            yield _measured(case, lever, (raw[:3], raw[3:4]), seed, show=show)
    config, base = load_config("citation2.toml")
    config = config.with_logs_in(data / "flights")
    try:
        raw = read_logs(configured_files(config, base), config.logs)
    except DataError:
        return
    yield _measured("Citation II", config, (raw[2:], raw[:1]), seed, show=show)


def _size(log: Log) -> int:
    return len(log) * len(log.channels)


def _masked(log: Log, found: Sequence[Finding]) -> float:
    """Samples that faults mask, all channels together."""
    return float(sum(each.rows(log.time_s).sum() for each in found if each.masks))


def _trials(
    raw: Log, config: RunConfig, trained: tuple[Bundle, Bank], seed: int, *, show: bool
) -> Iterator[Trial]:
    bundle, bank = trained
    own = bundle.calibration.for_engine(raw.source.engine, or_mean=True)
    [clean] = prepare([raw], config)
    reference = _run(own, clean.log)
    error = np.sqrt(np.nanmean((reference - clean.log.matrix(own.output_names)) ** 2, axis=0))
    for injection in drawn(raw, seed, _PER_LOG):
        log = prepare([injection.into(raw)], config)[0].log
        moved = _moved(own, (clean.log, log), reference)
        large = np.array([0.0])
        if len(moved) == len(clean.log):
            size = max(1, round(_LASTING_S / log.dt_s))
            smooth = uniform_filter1d(np.abs(np.nan_to_num(moved)), size, axis=0, mode="nearest")
            large = np.flatnonzero((smooth > _TIMES * error).any(axis=1))
        rms = np.sqrt(np.nanmean(moved**2, axis=0))
        counts = bool((rms > _TIMES * error).any())
        noticeable = float(log.time_s[int(large[0])]) if len(large) else float("nan")
        trial = Trial(injection, screened(bank, [log])[0].findings, counts, noticeable)
        if show:
            sys.stdout.write(_line(raw, trial) + "\n")
        yield trial


def _run(own: Calibration, log: Log) -> FloatArray:
    filled = hold_inputs(log, own.input_names)
    return own.simulate(filled.matrix(own.input_names), log.matrix(own.output_names)[0])


def _moved(own: Calibration, logs: tuple[Log, Log], reference: FloatArray) -> FloatArray:
    """By how much a fault moves the free run against the measurement, (time, n_out)."""
    clean, faulty = logs
    if len(faulty) != len(clean):
        return np.full((1, len(own.output_names)), np.inf)
    try:
        moved = _run(own, faulty) - reference
    except DataError:  # nothing is left of an input
        return np.full((len(clean), len(own.output_names)), np.inf)
    outputs = own.output_names
    there = [name for name in outputs if np.isfinite(faulty[name]).any()]
    read = np.where(
        [name in there for name in outputs], faulty.matrix(outputs) - clean.matrix(outputs), np.inf
    )
    return np.asarray(np.where(np.isfinite(read) | np.isinf(read), np.abs(moved) + np.abs(read), 0))


def _line(log: Log, trial: Trial) -> str:
    injection = trial.injection
    words = "ok" if trial.named else "found" if trial.detected else "missed"
    what = f"{injection.kind} of {' and '.join(injection.channels)} {injection.size}"
    found = "; ".join(f"{each.kind} of {' and '.join(each.channels)}" for each in trial.found)
    weight = "" if trial.counts else " (too small to count)"
    return f"{words:7}{log.name}: {what}{weight} -> {found or 'nothing'}"


def rows(data: Path, seed: int = 0, *, show: bool = False) -> Iterator[Row]:
    """Figures of each set and of all together; `data` is the folder of the shared data."""
    found = list(results(data, seed, show=show))
    for result in found:
        yield from _figures(result.name, [result])
    yield from _figures("all", found)


_TARGET = "faults that move the free run by more than 3 times its held-out error"


def _figures(name: str, results: Sequence[Result]) -> Iterator[Row]:
    trials = [each for one in results for each in one.trials if each.counts]
    group, count = f"sensor faults, {name}", len(trials)
    detected = 100.0 * float(np.mean([each.detected for each in trials]))
    named = 100.0 * float(np.mean([each.named for each in trials]))
    delays = np.array([each.delay_s for each in trials if each.detected])
    soon = 100.0 * float(np.mean(delays[np.isfinite(delays)] <= _LASTING_S))
    accused = sum(one.accused for one in results)
    sound = sum(one.sound_logs for one in results)
    lost = 100.0 * float(np.mean([one.false_share for one in results]))
    note = f"{count} faults"
    yield Row(group, "detected", detected, "%", 95.0, "at least", _TARGET, note)
    yield Row(group, "with channel and kind", named, "%", 85.0, "at least", _TARGET)
    yield Row(group, "reported within 20 s of their effect", soon, "%")
    yield Row(group, "samples masked on sound logs", lost, "%", 0.1, "at most", _TARGET)
    note = f"of {sound} sound logs"
    yield Row(group, "sound logs with a fault", accused, "logs", 0.0, "at most", _TARGET, note)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print every trial, then the figures."""
    parser = argparse.ArgumentParser(prog="python -m eval.benchmarks.faults", description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"), help="shared data")
    parser.add_argument("--seed", type=int, default=0, help="of the drawn faults and engines")
    options = parser.parse_args(arguments)
    table = Table("figure", "measured", "target", "reached", title="Sensor faults", box=None)
    for row in rows(options.data, options.seed, show=True):
        bound = f"{row.bound} {row.target:g} {row.unit}" if row.bound else ""
        reached = {True: "yes", False: "no", None: ""}[row.reached]
        measured = f"{row.value:.3g} {row.unit} {row.note}"
        table.add_row(f"{row.group}: {row.name}", measured, bound, reached)
    Console().print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
