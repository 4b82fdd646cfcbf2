"""Puts recorded and simulated logs side by side, and refuses what does not belong together.

File names pair the logs of two folders; `.csv` may meet `.csv.gz`. Rows are paired by number from
the first. The rates have to agree within 0.1 %; one log may end up to 2 s after the other, and
what is over is cut and counted. Inputs recorded in both have to be the same but for rounding.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from data_prep.clean import clean
from data_prep.faults import out_of_range
from data_prep.log import AuditEntry, Log
from data_prep.prepare import hold_inputs
from eval.gap.data import Pair
from eval.gap.log_folders import pair_up, read_folder
from eval.gap.pair_inputs import inputs_of, is_input
from eval.gap.pair_outputs import DIAGNOSED, check_recorded, complete, lone, outputs_of
from eval.gap.simulators import Simulate
from narxcal.channels import CHANNELS
from narxcal.support.errors import DataError
from training.config import RunConfig

__all__ = ["DIAGNOSED", "check_apart", "match_simulated", "pair_logs", "read_folder", "read_pairs"]

COMPARED = ("FN_kN", "FPR", "EPR")
_RATE = 1e-3
_LONGER_S = 2.0


def read_pairs(real: Path, sim: Path | Simulate, config: RunConfig | None = None) -> list[Pair]:
    """Read all logs of `real` with those of `sim`, or with what `sim` makes of their inputs.

    `config` maps the columns of files whose headers are not canonical, and cleans the recorded
    logs; without one only values that no engine can have are taken for unknown. Raises `DataError`
    for files without a partner, and as `pair_logs`.
    """
    flown = {
        name: _plausible(log) if config is None else clean(log, config.clean)
        for name, log in read_folder(real, config).items()
    }
    if isinstance(sim, Path):
        simulated = pair_up(flown, read_folder(sim, config), (real, sim))
    else:
        simulated = {name: simulated_log(log, sim) for name, log in flown.items()}
    return alike([pair_logs(name, log, simulated[name]) for name, log in flown.items()])


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
    outputs = outputs_of(name, real, sim, inputs)
    measured, modelled = {}, {}
    for output in outputs:
        modelled[output] = complete(name, sim, output, counts)
        measured[output] = np.where(np.isfinite(sim[output]), real[output], np.nan)
        check_recorded(name, real, output, counts)
    both = [each for each in COMPARED if each in real.channels and each in sim.channels]
    others = {each: np.column_stack([real[each], sim[each]]) for each in both}
    alone = lone(real, sim, [each for each in DIAGNOSED if each not in inputs])
    return Pair(name, real.time_s, inputs, measured, modelled, others, counts, alone)


def check_apart(pairs: Sequence[Pair], held: Sequence[Pair]) -> None:
    """Raise `DataError` for a held-out flight that is one of the diagnosis under any name."""
    for other in held:
        for pair in pairs:
            if _same_record(pair, other):
                raise DataError(
                    f"the held-out flight is '{pair.name}' of the diagnosis: nothing could be "
                    "checked on it",
                    file=other.name,
                    hint="Hold flights out that are not among those of --real",
                )


def _same_record(one: Pair, other: Pair) -> bool:
    if len(one.time_s) != len(other.time_s) or set(one.real) != set(other.real):
        return False
    return all(np.array_equal(v, other.real[k], equal_nan=True) for k, v in one.real.items())


def _plausible(log: Log) -> Log:
    """The log with values beyond what any engine or atmosphere shows masked and counted."""
    changed, entries = {}, []
    for name, values in log.channels.items():
        wrong = out_of_range(name, values)
        if wrong.any():
            changed[name] = np.where(wrong, np.nan, values)
            entries.append(AuditEntry(name, "masked", "out of range", int(wrong.sum())))
    return log.with_channels(changed, *entries)


def simulated_log(log: Log, simulate: Simulate) -> Log:
    """The log's inputs, complete, with the outputs that the simulator gives for them."""
    inputs = [name for name in log.channels if is_input(name, log)]
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
    counts = {"cut at the end": max(len(real), len(sim)) - samples}
    if abs(real.time_s[0] - sim.time_s[0]) > 0.5 * real.dt_s:
        counts["paired by row, for the clocks start apart"] = samples
    for entry in real.audit.entries:
        if entry.action != "repaired" or entry.channel != "*":
            key = f"{entry.channel} {entry.action}: {entry.reason}"
            counts[key] = counts.get(key, 0) + entry.samples
    return {reason: count for reason, count in counts.items() if count}


def alike(pairs: Sequence[Pair]) -> list[Pair]:
    """Keep what all pairs have, and check that they are of one rate."""
    first = pairs[0]
    for pair in pairs[1:]:
        if abs(pair.dt_s / first.dt_s - 1.0) > _RATE:
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
    """Channels that not all pairs have: channel -> which flight lacks them."""
    has = [(pair.name, (*pair.inputs, *pair.sim)) for pair in pairs]
    some = {name for _, names in has for name in names if name not in kept}
    return {
        name: f"missing in {next(flight for flight, names in has if name not in names)}"
        for name in sorted(some)
    }
