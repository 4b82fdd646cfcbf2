"""Puts recorded and simulated logs side by side, and refuses what does not belong together.

File names pair the logs of two folders; `.csv` may meet `.csv.gz`. Rows are paired by number from
the first. The rates have to agree within 0.1 %; one log may end up to 2 s after the other, and
what is over is cut and counted. Inputs recorded in both have to be the same but for rounding.

A simulator that runs on held inputs is compared with nothing while they are held for long (longer
than the gap that divides a recording), nor for as long again afterwards: of the error that a lag of
any time constant T gathers in a time t, (1 - exp(-t / T)) exp(-t / T) <= 1/4 is left by then.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from types import MappingProxyType

import numpy as np

from data_prep.cleaning.clean import clean
from data_prep.cleaning.faults import out_of_range
from data_prep.config import LogsConfig
from data_prep.log import AuditEntry, Finding, Log
from data_prep.prepare import hold_inputs
from data_prep.reading import read_logs
from data_prep.sources.log_file import open_table
from eval.diagnosis.simulators import Simulate
from narxcal.channels import CHANNELS, SPOOLS, described
from narxcal.support.arrays import FloatArray, bridge_gaps, long_runs, spans
from narxcal.support.errors import DataError
from training.config import RunConfig


@dataclass(frozen=True, eq=False)
class Pair:
    """One flight of one engine, recorded and simulated on the same raster.

    `inputs`, `real` and `sim` map channels to `(time,)`; `real` is NaN where nothing was recorded.
    `others` holds recorded and simulated outputs, `(time, 2)`, that are compared but not diagnosed.
    `counts` says what was changed: reason -> samples; `lone` says of channels that cannot be used
    why: channel -> where it is missing.
    """

    name: str
    time_s: FloatArray
    inputs: Mapping[str, FloatArray]
    real: Mapping[str, FloatArray]
    sim: Mapping[str, FloatArray]
    others: Mapping[str, FloatArray] = field(default_factory=dict)
    counts: Mapping[str, int] = field(default_factory=dict)
    lone: Mapping[str, str] = field(default_factory=dict)

    @property
    def dt_s(self) -> float:
        """Raster interval in seconds."""
        return float(self.time_s[-1] - self.time_s[0]) / (len(self.time_s) - 1)

    @property
    def driver(self) -> str:
        """The input that pushes and pulls: the lever, or the fuel flow where there is none."""
        return "TRA_deg" if "TRA_deg" in self.inputs else "FF_kgph"


_FILE = re.compile(r"([^.].*)\.csv(\.gz)?", re.IGNORECASE | re.DOTALL)
_NO_SPLIT_S = 1e7  # a gap is masked, not the end of a log


def read_folder(folder: Path, config: RunConfig | None = None) -> dict[str, Log]:
    """Read every CSV file of a folder; names without ending -> log, in order of name.

    Hidden files, which some systems leave beside copied ones, are no logs. A file with several
    engines gives `NAME_ENGINE` for each. Raises `DataError`.
    """
    found: dict[str, Log] = {}
    for file in files_in(folder):
        for log in read_logs(file, _reading(file, config)):
            name = log_name(file, log.source.engine)
            if name in found:
                raise DataError("two files have one name", file=file, hint="Remove one of them")
            found[name] = log
    return found


def log_name(file: Path, engine: str) -> str:
    return _FILE.sub(r"\1", file.name) + (f"_{engine}" if engine else "")


def files_in(folder: Path) -> list[Path]:
    """The logs of a folder, in order of name; raises `DataError` where there are none."""
    if not folder.is_dir():
        what = "is a file" if folder.exists() else "does not exist"
        raise DataError(f"the folder of the logs {what}", file=folder)
    files = sorted(file for file in folder.iterdir() if _FILE.fullmatch(file.name))
    if not files:
        raise DataError("the folder holds no .csv or .csv.gz", file=folder)
    return files


def pair_up(
    flown: Mapping[str, Log], simulated: Mapping[str, Log], folders: tuple[Path, Path]
) -> Mapping[str, Log]:
    """Check that both folders hold the same names; returns the simulated logs."""
    for here, there, folder in (
        (flown, simulated, folders[1]),
        (simulated, flown, folders[0]),
    ):
        lone = [name for name in here if name not in there]
        if lone:
            raise DataError(
                f"'{lone[0]}' has no partner here ({len(lone)} of {len(here)} logs have none)",
                file=folder,
                hint="Recorded and simulated logs are paired by their file names",
            )
    return simulated


def _reading(file: Path, config: RunConfig | None) -> LogsConfig:
    """Canonical headers are read as such, others by the configuration."""
    logs = LogsConfig() if config is None else config.logs
    header = set(open_table(file, logs).header)
    if {"time_s", "N1_pct"} <= header or not logs.columns:
        own = {"bridge_s", "delimiter", "decimal", "channels"}
        logs = LogsConfig(**{key: getattr(logs, key) for key in own})
    return logs.model_copy(update={"max_gap_s": _NO_SPLIT_S, "raster_hz": logs.raster_hz})


# Samples of an input may differ by this part of the channel's range, and few of them by more.
_ROUNDING, _FEW = 2e-3, 1e-3
_ROLES = ("lever", "ambient", "switch")


def inputs_of(name: str, real: Log, sim: Log, counts: dict[str, int]) -> dict[str, FloatArray]:
    """Inputs of either log; where both have one, the simulator's, for these are what it ran on.

    Samples that were held over a hole are added to `counts`. Raises `DataError` where there is
    nothing to drive the engine, and where recorded and simulated inputs differ.
    """
    has = {**real.channels, **sim.channels}
    wanted = [each for each in CHANNELS if each in has and is_input(each, has)]
    if not {"TRA_deg", "FF_kgph"} & set(wanted):
        raise DataError(
            "there is no TRA_deg, and no FF_kgph to take for the driver",
            file=name,
            hint="Map the throttle's column, or the fuel flow's",
        )
    found = {}
    for each in wanted:
        if each in real.channels and each in sim.channels:
            _check_same(name, real, sim, each)
        source = sim if each in sim.channels else real
        counts[f"{each} held"] = int(np.count_nonzero(~np.isfinite(source[each])))
        found[each] = hold_inputs(source, [each])[each]
    return found


def _check_same(name: str, real: Log, sim: Log, channel: str) -> None:
    a, b = real[channel], sim[channel]
    known = np.isfinite(a) & np.isfinite(b)
    if not known.any():
        return
    row = CHANNELS[channel]
    span = min(row.high - row.low, 2.0 * float(np.ptp(b[known])) + float(np.abs(b[known]).max()))
    apart = np.zeros(len(a), dtype=np.bool_)
    apart[known] = np.abs(a[known] - b[known]) > _ROUNDING * span
    if apart.sum() <= _FEW * len(a):
        return
    first = int(np.argmax(apart))
    raise DataError(
        f"the inputs differ: recorded {a[first]:g}, simulated with {b[first]:g} "
        f"({int(apart.sum())} of {len(a)} samples differ by more than rounding)",
        file=name,
        channel=channel,
        row=first + 1,
        hint="Simulate with the inputs that were recorded",
    )


def is_input(name: str, channels: Container[str]) -> bool:
    """Whether a simulator takes it of these channels; fuel flow only where there is no lever."""
    if name == "FF_kgph":
        return "TRA_deg" not in channels
    return described(name).role in _ROLES


DIAGNOSED = (*SPOOLS, "EGT_C", "FF_kgph")
_MOST_MISSING = 0.2


def outputs_of(
    name: str, real: Log, sim: Log, inputs: Mapping[str, FloatArray]
) -> tuple[list[str], dict[str, str]]:
    """Outputs that are compared, those on both sides; and of others on which one they are.

    Raises `DataError` where no spool speed is on both.
    """
    candidates = [each for each in DIAGNOSED if each not in inputs]
    both = [each for each in candidates if each in real.channels and each in sim.channels]
    if not any(each in both for each in SPOOLS):
        raise DataError(
            f"recorded and simulated log share neither {' nor '.join(SPOOLS)}",
            file=name,
            hint=f"A spool speed has to be on both sides; recorded are {_named(real, candidates)}, "
            f"simulated are {_named(sim, candidates)}",
        )
    one, other = "recorded but not simulated", "simulated but not recorded"
    lone = {
        each: one if each in real.channels else other
        for each in candidates
        if (each in real.channels) != (each in sim.channels)
    }
    return both, lone


def _named(log: Log, outputs: Sequence[str]) -> str:
    return ", ".join(each for each in outputs if each in log.channels) or "none of the outputs"


def complete(name: str, sim: Log, channel: str, counts: dict[str, int]) -> FloatArray:
    """A simulated channel (time,) with its holes bridged, and these added to `counts`.

    Raises `DataError` where too much is missing or the channel is constant.
    """
    values = sim[channel]
    missing = int(np.count_nonzero(~np.isfinite(values)))
    if missing > _MOST_MISSING * len(values):
        raise DataError(
            f"{missing} of {len(values)} simulated samples are missing",
            file=name,
            channel=channel,
            hint="Simulate the whole flight, or leave the log or the channel out",
        )
    counts[f"{channel} simulated missing"] = missing
    _check_varies(name, values, channel, "simulated")
    return bridge_gaps(values)


def check_recorded(name: str, real: Log, channel: str, counts: dict[str, int]) -> None:
    """Add the unknown samples of a recorded channel to `counts`.

    Raises `DataError` where nothing is known or the channel is constant.
    """
    values = real[channel]
    missing = int(np.count_nonzero(~np.isfinite(values)))
    if missing == len(values):
        raise DataError(
            "no recorded sample is known",
            file=name,
            channel=channel,
            hint="Leave the channel out of all logs, or this log out",
        )
    counts[f"{channel} unknown"] = missing
    _check_varies(name, values, channel, "recorded")


def _check_varies(name: str, values: FloatArray, channel: str, what: str) -> None:
    known = values[np.isfinite(values)]
    if np.ptp(known) <= 1e-9 * max(1.0, float(np.abs(known).max())):
        raise DataError(
            f"the {what} channel is constant ({known[0]:g} throughout)",
            file=name,
            channel=channel,
            hint="Its sensor is stuck, or another column is meant; leave the channel or log out",
        )


COMPARED = ("FN_kN", "FPR", "EPR")
_RATE = 1e-3
RATES = 0.01  # by which those of flights may differ: clocks of recorders do by a few in 1000
_LONGER_S = 2.0


def read_pairs(
    real: Path,
    sim: Path | Simulate,
    config: RunConfig | None = None,
    faults: Mapping[str, Sequence[Finding]] = MappingProxyType({}),
) -> list[Pair]:
    """Read all logs of `real` with those of `sim`, or with what `sim` makes of their inputs.

    `config` maps the columns of files whose headers are not canonical, and cleans the recorded
    logs; without one only values that no engine can have are taken for unknown. `faults` of logs
    mask the inputs that `sim` runs on. Raises `DataError` for files without a partner, and as
    `pair_logs`.
    """
    flown = {
        name: _plausible(log) if config is None else clean(log, config.clean)
        for name, log in read_folder(real, config).items()
    }
    if isinstance(sim, Path):
        simulated = pair_up(flown, read_folder(sim, config), (real, sim))
        return alike([pair_logs(name, log, simulated[name]) for name, log in flown.items()])
    longest_s = (LogsConfig() if config is None else config.logs).max_gap_s
    driven = [
        (name, with_known_inputs(log, faults.get(name, ()), longest_s))
        for name, log in flown.items()
    ]
    return alike([pair_logs(name, log, simulated_log(log, sim)) for name, log in driven])


def with_known_inputs(log: Log, faults: Sequence[Finding], longest_s: float) -> Log:
    """The log without outputs where an input is unknown for longer than `longest_s`, and counted.

    An input that `faults` mask is unknown there, as one of which the log has no sample.
    """
    inputs = {n: values for n, values in log.channels.items() if is_input(n, log.channels)}
    for each in faults:
        if each.masks and each.channel in inputs:
            known = ~each.rows(log.time_s)
            inputs[each.channel] = np.where(known, inputs[each.channel], np.nan)
    unknown = np.zeros(len(log), dtype=np.bool_)
    for values in inputs.values():
        for start, stop in spans(long_runs(~np.isfinite(values), round(longest_s / log.dt_s))):
            unknown[start : 2 * stop - start] = True
    if not unknown.any():
        return log.with_channels(inputs)
    outputs = {
        name: np.where(unknown, np.nan, values)
        for name, values in log.channels.items()
        if name not in inputs
    }
    count = int(unknown.sum())
    return log.with_channels(inputs | outputs, AuditEntry("inputs", "masked", "unknown", count))


def match_simulated(name: str, log: Log, sim: Mapping[str, Log] | Simulate) -> Log:
    """The simulated log for the inputs of `log`: of that name in `sim`, or made by `sim` now.

    Inputs that only `log` has are taken from there. Raises `DataError` as `pair_logs`.
    """
    if not isinstance(sim, Mapping):
        return simulated_log(log, sim)
    if name not in sim:
        raise DataError(
            "there is no simulated log of this name",
            file=name,
            hint=f"There are {', '.join(list(sim)[:5])}",
        )
    samples = _common_length(name, log, sim[name])
    log, found = log.part(0, samples), sim[name].part(0, samples)
    inputs = inputs_of(name, log, found, {})
    return replace(found, channels={**found.channels, **inputs})


def pair_logs(name: str, real: Log, sim: Log) -> Pair:
    """Put one recorded and one simulated log side by side.

    Raises `DataError` for other rates, lengths or inputs, for a driver or an output that is
    missing, constant or mostly unknown.
    """
    samples = _common_length(name, real, sim)
    counts = _counts(real, sim, samples)
    real, sim = real.part(0, samples), sim.part(0, samples)
    inputs = inputs_of(name, real, sim, counts)
    outputs, lone = outputs_of(name, real, sim, inputs)
    measured, modelled = {}, {}
    for output in outputs:
        modelled[output] = complete(name, sim, output, counts)
        measured[output] = np.where(np.isfinite(sim[output]), real[output], np.nan)
        check_recorded(name, real, output, counts)
    both = [each for each in COMPARED if each in real.channels and each in sim.channels]
    others = {each: np.column_stack([real[each], sim[each]]) for each in both}
    counted = {reason: count for reason, count in counts.items() if count}
    return Pair(name, real.time_s, inputs, measured, modelled, others, counted, lone)


def check_apart(pairs: Sequence[Pair], held: Sequence[Pair]) -> None:
    """Raise `DataError` for a held-out flight that is one of the diagnosis under any name."""
    for other, pair in product(held, pairs):
        if _same_record(pair, other):
            raise DataError(
                f"the held-out flight is '{pair.name}' of the diagnosis: nothing could be checked "
                "on it",
                file=other.name,
                hint="Hold flights out that are not among those of --real",
            )


def _same_record(one: Pair, other: Pair) -> bool:
    return one.real.keys() == other.real.keys() and all(
        np.array_equal(values, other.real[name], equal_nan=True)
        for name, values in one.real.items()
    )


def _plausible(log: Log) -> Log:
    """The log with values beyond what any engine or atmosphere shows masked and counted."""
    changed, entries = {}, []
    for name, values in log.channels.items():
        wrong = out_of_range(log.channel(name), values)
        if wrong.any():
            changed[name] = np.where(wrong, np.nan, values)
            entries.append(AuditEntry(name, "masked", "out of range", int(wrong.sum())))
    return log.with_channels(changed, *entries)


def simulated_log(log: Log, simulate: Simulate) -> Log:
    """The log's inputs, complete, with the outputs that the simulator gives for them."""
    inputs = [name for name in log.channels if is_input(name, log.channels)]
    held = hold_inputs(log, inputs)
    outputs = {name: values for name, values in simulate(held).items() if name in CHANNELS}
    return replace(held, channels={name: held[name] for name in inputs} | outputs)


def _common_length(name: str, real: Log, sim: Log) -> int:
    if abs(real.dt_s / sim.dt_s - 1.0) > _RATE:
        raise DataError(
            f"the rates differ: recorded at {1 / real.dt_s:.4g} Hz, simulated at "
            f"{1 / sim.dt_s:.4g} Hz",
            file=name,
            hint="Put both on one raster first",
        )
    over_s = abs(len(real) - len(sim)) * real.dt_s
    if over_s > _LONGER_S:
        raise DataError(
            f"the lengths differ: recorded {len(real)} samples, simulated {len(sim)}, which is "
            f"{over_s:.3g} s",
            file=name,
            hint=f"Up to {_LONGER_S:g} s are cut at the end; simulate the whole flight",
        )
    return min(len(real), len(sim))


def _counts(real: Log, sim: Log, samples: int) -> dict[str, int]:
    counts = Counter({"cut at the end": max(len(real), len(sim)) - samples})
    if abs(real.time_s[0] - sim.time_s[0]) > 0.5 * real.dt_s:
        counts["paired by row, for the clocks start apart"] = samples
    for entry in real.audit.entries:
        if entry.action != "repaired" or entry.channel != "*":
            counts[f"{entry.channel} {entry.action}: {entry.reason}"] += entry.samples
    return counts


def alike(pairs: Sequence[Pair]) -> list[Pair]:
    """Keep what all pairs have, and check that they are of one rate."""
    first = pairs[0]
    for pair in pairs[1:]:
        if abs(pair.dt_s / first.dt_s - 1.0) > RATES:
            raise DataError(
                f"recorded at {1 / pair.dt_s:.4g} Hz, but {first.name} at {1 / first.dt_s:.4g} Hz",
                file=pair.name,
                hint="Put all flights on one raster",
            )
        if pair.driver != first.driver:
            raise DataError(
                f"is driven by {pair.driver}, but {first.name} by {first.driver}", file=pair.name
            )
    inputs = [name for name in first.inputs if all(name in pair.inputs for pair in pairs)]
    outputs = [name for name in first.sim if all(name in pair.sim for pair in pairs)]
    return [
        replace(
            pair,
            inputs={name: pair.inputs[name] for name in inputs},
            real={name: pair.real[name] for name in outputs},
            sim={name: pair.sim[name] for name in outputs},
            lone={**pair.lone, **_lost(pairs, (*inputs, *outputs))},
        )
        for pair in pairs
    ]


def _lost(pairs: Sequence[Pair], kept: Sequence[str]) -> dict[str, str]:
    has = [(pair.name, (*pair.inputs, *pair.sim)) for pair in pairs]
    some = {name for _, names in has for name in names if name not in kept}
    return {
        name: f"missing in {next(flight for flight, names in has if name not in names)}"
        for name in sorted(some)
    }
