"""Compare models in free run on the same rows: errors, Ti/Tt, significant differences.

`compare` takes any models as arrays; `compare_runs` makes these of run folders and their baselines.
`eval.judging.significance` says which differences are significant.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np

from data_prep.events import find_events
from data_prep.log import Log
from eval.judging.free_run import ARX, FIRST_ORDER, MODEL, STEADY_STATE, FreeRun, run_log
from eval.judging.scores import max_relative_percent, nrmse, rmse
from eval.judging.significance import (
    LEVEL,
    Difference,
    PassDifference,
    Recording,
    differences,
    pass_differences,
)
from eval.report.style import number
from eval.run_logs import EvaluateConfig, run_config
from narxcal.calibration.bundle import Bundle
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import DataError
from narxcal.support.files import finite, versions
from training.config import RunConfig
from training.dynamics.baselines import Baselines
from training.responses.transients import (
    Assessment,
    Overlay,
    Tally,
    TransientsConfig,
    assess_events,
    tally,
)

SCHEMA = "narxcal.compare/1"
_NAMES = {STEADY_STATE: "steady state", FIRST_ORDER: "first-order lag", ARX: "ARX"}


@dataclass(frozen=True, eq=False)
class Row:
    """One model: errors per channel, Ti/Tt, and what it took; None where it does not exist."""

    run: str
    method: str
    channels: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    ti_tt: Tally | None = None
    parameters: int | None = None
    aic: float | None = None
    fit_s: float | None = None
    simulate_us: float | None = None
    coverage_90: float | None = None

    def document(self) -> dict[str, Any]:
        return {**vars(self), "ti_tt": None if self.ti_tt is None else self.ti_tt.row()}


@dataclass(frozen=True, eq=False)
class Comparison:
    """Rows of all models on the same rows of the same logs."""

    rows: tuple[Row, ...]
    recordings: tuple[Recording, ...]
    differences: tuple[Difference, ...]
    remarks: tuple[str, ...] = ()
    passes: tuple[PassDifference, ...] = ()

    @property
    def significant(self) -> tuple[Difference, ...]:
        return tuple(one for one in self.differences if one.significant)

    @property
    def channels(self) -> tuple[str, ...]:
        return self.recordings[0].channels

    def errors(self, channel: str) -> dict[str, float]:
        found = {row.run: row.channels.get(channel, {}).get("rmse", math.nan) for row in self.rows}
        return {run: value for run, value in found.items() if math.isfinite(value)}

    @property
    def least(self) -> dict[str, float]:
        """Channel -> least RMSE of any run; NaN where none has one."""
        errors = {name: self.errors(name).values() for name in self.channels}
        return {name: min(of_all, default=math.nan) for name, of_all in errors.items()}

    def summary(self) -> list[str]:
        """Passes of Ti and Tt, then per channel the least RMSE; what differs significantly."""
        lines = [text] if (text := self._passes()) else []
        for name in self.channels:
            known = self.errors(name)
            if len(known) < 2:
                continue
            best = min(known, key=lambda run: known[run])
            own = [one for one in self.differences if (one.channel, one.better) == (name, best)]
            text = f"{name}: least {best} ({number(known[best])})"
            lines.append(text + _others(list(known), best, own, "more", _power(own)))
        return lines

    def _passes(self) -> str:
        judged = {row.run: row.ti_tt for row in self.rows if row.ti_tt and row.ti_tt.assessed}
        if len(judged) < 2:
            return ""
        most = max(judged, key=lambda run: judged[run].passed)
        own = [each for each in self.passes if each.better == most]
        text = f"Ti and Tt: most {most} ({judged[most].passed} of {judged[most].assessed} passed)"
        return text + _others(list(judged), most, own, "fewer")

    def document(self) -> dict[str, Any]:
        """`compare.json`; None where a figure does not exist."""
        found: dict[str, Any] = finite({
            "schema": SCHEMA,
            "rows": [row.document() for row in self.rows],
            "significant": [asdict(one) for one in self.significant],
            "undecided": [asdict(one) for one in self.differences if not one.significant],
            "passes": [asdict(one) for one in self.passes],
            "family_wise": LEVEL,
            "summary": self.summary(),
            "remarks": list(self.remarks),
            "logs": {
                one.name: {"rows": len(one.measured), "scored": int(one.scored.sum())}
                for one in self.recordings
            },
            "versions": versions(),
        })  # fmt: skip
        return found


def _others(
    runs: Sequence[str],
    best: str,
    found: Sequence[Difference | PassDifference],
    how: str,
    power: str = "",
) -> str:
    """Which of the runs do significantly worse than the best one, and which do not."""
    worse = {each.worse for each in found if each.significant}
    named = ", ".join(run for run in runs if run in worse)
    close = ", ".join(run for run in runs if run not in {best, *worse})
    text = f"; significantly {how}: {named}" if worse else ""
    return f"{text}; not significantly different: {close}{power}" if close else text


_TELLING: Final = 1e-3  # models that differ by a thousand need no test


def _power(open_: Sequence[Difference]) -> str:
    """Which ratio would have been found, the least sensitive of the pairs."""
    known = [one.detectable for one in open_ if not one.significant and one.detectable > 0.0]
    if not known or min(known) < _TELLING:
        return " (too few units to decide)"
    return f" (1 : {1.0 / min(known):.2g} would have been found in 8 of 10)"


def compare(
    recordings: Sequence[Recording], rows: Sequence[Row], remarks: Sequence[str] = ()
) -> Comparison:
    """Score every model of `rows` on the rows that all models share.

    Rows of `Recording.scored` at which a model has no value in a channel that it has elsewhere are
    left out for all. Raises `DataError` where no row is left.
    """
    common = tuple(_shared(one) for one in recordings)
    if not any(one.scored.any() for one in common):
        raise DataError("there is no row at which every model has a value: nothing to compare")
    scored = [replace(row, channels=_errors(common, row.run)) for row in rows]
    found = tuple(differences(common, [row.run for row in rows]))
    return Comparison(tuple(scored), common, found, (*remarks, *_units(found)))


def _units(found: Sequence[Difference]) -> list[str]:
    if not found:
        return []
    few, most = min(one.units for one in found), max(one.units for one in found)
    count = f"{few}" if few == most else f"{few} to {most}"
    if found[0].unit == "flights":
        return [f"significance is of {count} flights as units"]
    text = f"significance is of {count} stretches of one flight as units"
    return [f"{text}, as long as errors are correlated: another flight may differ by more"]


def _shared(one: Recording) -> Recording:
    """The recording with only those rows scored at which all models have their values."""
    scored = one.scored.copy()
    for outputs in one.outputs.values():
        known = np.isfinite(outputs)
        scored &= known[:, known.any(axis=0)].all(axis=1)
    return replace(one, scored=scored)


def _errors(recordings: Sequence[Recording], model: str) -> dict[str, dict[str, float]]:
    measured = np.concatenate([one.measured for one in recordings])
    outputs = np.concatenate([one.outputs[model] for one in recordings])
    scored = np.concatenate([one.scored for one in recordings])
    figures = {"rmse": rmse, "nrmse": nrmse, "max_rel_pct": max_relative_percent}
    columns = {name: of(measured, outputs, scored).tolist() for name, of in figures.items()}
    return {
        channel: {name: column[k] for name, column in columns.items()}
        for k, channel in enumerate(recordings[0].channels)
        if math.isfinite(columns["rmse"][k])
    }


@dataclass(frozen=True, eq=False)
class Run:
    """A bundle under the name of its row, with the logs that are held out, prepared for it."""

    name: str
    bundle: Bundle
    logs: tuple[Log, ...]

    @cached_property
    def tables(self) -> tuple[RunConfig, EvaluateConfig]:
        return run_config(self.bundle)


def compare_runs(runs: Sequence[Run]) -> Comparison:
    """Compare runs on the logs that all of them have.

    Events, Ti/Tt rules and the rows of steady state, first-order lag and ARX are those of the run
    with most outputs, the first of several. Raises `DataError` where the runs share no log, or
    sample one differently.
    """
    held_out = [[log.name for log in run.logs] for run in runs]
    names = [name for name in held_out[0] if all(name in own for own in held_out)]
    if not names:
        raise DataError(
            "no log is held out of all runs", hint="Name the logs to compare on by --logs"
        )
    lead = max(runs, key=lambda run: len(run.bundle.calibration.output_names))
    found = {run.name: [_free_run(run, name) for name in names] for run in runs}
    recordings = [
        _recording({run: each[k] for run, each in found.items()}, lead) for k in range(len(names))
    ]
    rows = [_row(run, found[run.name]) for run in runs]
    if lead.bundle.record.baselines is not None:
        rows += _baseline_rows(Baselines.from_json(lead.bundle.record.baselines))
    settings = lead.tables[1].transients
    judged = {row.run: [_assessed(row.run, one, settings) for one in recordings] for row in rows}
    rows = [replace(row, ti_tt=_tally(judged[row.run])) for row in rows]
    passes = pass_differences(_passed(judged, recordings))
    return replace(compare(recordings, rows, _remarks(runs, lead, names)), passes=tuple(passes))


def _free_run(run: Run, name: str) -> FreeRun:
    log = next(log for log in run.logs if log.name == name)
    return run_log(run.bundle, run.tables[0], log.without_faults(), log, one_step=False)


def _recording(found: Mapping[str, FreeRun], lead: Run) -> Recording:
    """One log with the free runs of all runs, and the baselines of `lead`."""
    own = found[lead.name]
    log, names = own.log, [name for one in found.values() for name in one.channels]
    channels = tuple(dict.fromkeys(names))
    for run, other in found.items():
        same = len(other.log) == len(log) and np.allclose(
            other.log.time_s, log.time_s, atol=1e-3 * log.dt_s
        )
        if not same:
            raise DataError(
                f"{lead.name} samples it every {log.dt_s:g} s from {log.time_s[0]:g} s on, {run} "
                f"every {other.log.dt_s:g} s from {other.log.time_s[0]:g} s on",
                file=log.name,
                hint="Identify both with one raster_hz in [logs] and one [running]",
            )
    outputs = {run: _by_channel(one, MODEL, channels) for run, one in found.items()}
    for key, name in _NAMES.items():
        if key in own.outputs:
            outputs[name] = _by_channel(own, key, channels)
    measured = np.column_stack([
        next(one.log.measured([name])[:, 0] for one in found.values() if name in one.channels)
        for name in channels
    ])  # fmt: skip
    known = np.logical_and.reduce([one.inputs_known for one in found.values()])
    events = tuple(find_events(log, lead.tables[0].events.for_log(log, own.channels)))
    flight = Path(log.source.file).name or log.name
    return Recording(log.name, log.time_s, channels, measured, outputs, known, events, flight)


def _by_channel(run: FreeRun, name: str, channels: Sequence[str]) -> FloatArray:
    values = dict(zip(run.channels, run.outputs[name].T, strict=True))
    blank = np.full(len(run.log), np.nan)
    return np.column_stack([values.get(channel, blank) for channel in channels])


def _assessed(model: str, one: Recording, settings: TransientsConfig) -> list[Assessment]:
    outputs = one.outputs[model]
    at = [k for k in range(len(one.channels)) if np.isfinite(outputs[:, k]).any()]
    channels = tuple(one.channels[k] for k in at)
    overlay = Overlay(one.time_s, one.measured[:, at], outputs[:, at], channels, one.scored)
    return assess_events(one.events, overlay, settings)


def _tally(judged: Sequence[Sequence[Assessment]]) -> Tally | None:
    whole = [each for log in judged for each in log]
    return tally(whole) if whole else None


def _passed(
    judged: Mapping[str, Sequence[Sequence[Assessment]]], recordings: Sequence[Recording]
) -> dict[str, list[FloatArray]]:
    """By model and flight 1 or 0 of every transient of any model; NaN where it is not judged."""
    flights: dict[str, dict[tuple[str, float, str], int]] = {}
    known: dict[str, dict[tuple[str, float, str], float]] = {}
    for run, logs in judged.items():
        known[run] = {}
        for recording, found in zip(recordings, logs, strict=True):
            keys = flights.setdefault(recording.unit, {})
            for each in found:
                if each.verdict.ok is not None:
                    key = recording.name, each.start_s, each.channel
                    keys.setdefault(key, len(keys))
                    known[run][key] = float(each.verdict.ok)
    return {
        run: [np.array([own.get(key, np.nan) for key in keys]) for keys in flights.values()]
        for run, own in known.items()
    }


def _row(run: Run, found: Sequence[FreeRun]) -> Row:
    record, size = run.bundle.record, run.bundle.calibration.size
    return Row(
        run=run.name,
        method=record.method,
        parameters=size,
        aic=None if record.free_run is None else record.free_run.aic,
        fit_s=record.training.wall_s if record.training.status else None,
        simulate_us=min(1e6 * one.simulate_s / len(one.log) for one in found),
        coverage_90=_coverage(found),
    )


def _coverage(found: Sequence[FreeRun]) -> float | None:
    inside = [
        (np.abs(error) <= one.half_width[one.scored])[np.isfinite(error)]
        for one in found
        if one.half_width is not None
        for error in ((one.model - one.measured)[one.scored],)
    ]
    return float(np.mean(np.concatenate(inside))) if inside else None


def _baseline_rows(found: Baselines) -> list[Row]:
    arx = sum(np.size(part) for row in (found.arx.poles, found.arx.gains) for part in row)
    sizes = (0, 2 * len(found.lag.push_s), int(arx) + len(found.arx.offsets))
    return [
        Row(name, "baseline", parameters=size)
        for name, size in zip(_NAMES.values(), sizes, strict=True)
    ]


def _remarks(runs: Sequence[Run], lead: Run, names: Sequence[str]) -> list[str]:
    """What a reader has to know: logs that a run was fitted to, and logs not compared on."""
    texts = []
    for run in runs:
        seen = [name for name in names if name in run.bundle.record.logs("train")]
        if seen:
            texts.append(f"{run.name} was identified from {', '.join(seen)}")
        left = [log.name for log in run.logs if log.name not in names]
        if left:
            texts.append(f"{', '.join(left)} of {run.name} is not held out of every run")
    texts.append(f"baselines stand on the steady state of {lead.name}")
    return texts
