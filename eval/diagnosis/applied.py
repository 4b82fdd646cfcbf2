"""Found effects added to any simulated log: what `simulate --effects` does, log by log.

A simulator that can be run again is run with inputs that have the effects on them. Effects on
readings act on its outputs. Both are exact, on the log's own raster. What nobody can do to a closed
simulator is change its pace: there, and for everything inside the engine where there are only logs,
the stored emulator says what changes. It runs on the raster of the diagnosis; the change is found
from block means of the log and added to it, on straight lines between the blocks' middles. It is
kept next to `gap.json`: `emulator.json` and `weights.safetensors`, nothing that executes.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load as load_arrays
from safetensors.numpy import save as save_arrays

from data_prep.log import Log
from data_prep.prepare import hold_inputs
from eval.diagnosis.expected import Values, claimed_in, settings, with_effects
from eval.diagnosis.simulators import Simulate
from narxcal.channels import CHANNELS
from narxcal.effects.base import Signals
from narxcal.effects.running import Flights, Setting, acts_inside, arrived, read
from narxcal.effects.steady import UNLOGGED, UNLOGGED_SWITCH
from narxcal.support.arrays import FloatArray, block_means, bridge_gaps, on_lines
from narxcal.support.errors import ConfigError, DataError, ModelError, NarxcalError
from narxcal.two_spool import TwoSpool
from training.diagnosis.emulator import GreyBoxEmulator, SettledModel

INPUTS = "on its inputs, and the simulator run again"
SHIFTED = "by its outputs coming that much later"
EMULATED = "by what it changes in the stored emulator's run"
OUTPUTS = "on its outputs"
_ONE_RASTER = 0.01
_AIR = ("ALT_ft", "Mach", "dT_C")
Windows = Mapping[str, tuple[tuple[float, float], ...]]  # log -> seconds since it began

GAP_SCHEMA = "narxcal.gap/2"


@dataclass(frozen=True, eq=False)
class FoundEffects:
    """Effects with their sizes, the signals they were found on, and the emulator if needed.

    `windows` are those of an unlogged load, by the names of the logs they were found in; `searched`
    are all logs in which they would have been found.
    """

    values: Values
    signals: Signals
    emulator: GreyBoxEmulator | None
    windows: Windows = field(default_factory=dict)
    searched: frozenset[str] = frozenset()

    def load_known(self, name: str) -> bool | None:
        """Whether windows of the unlogged load were searched for in a log; None without one."""
        return name in self.searched if UNLOGGED_SWITCH.id in self.values else None

    def added_to(self, log: Log, name: str | None = None) -> dict[str, FloatArray]:
        """Outputs `(time,)` of a simulated log with the effects in place.

        A load that no channel records is on where it was found in the log called `name`, and off
        in others. A sample of which the simulator says nothing stays NaN, and spoils no other one.
        Raises `DataError` for a log that lacks one of the signals.
        """
        held = self._complete(log, name or log.name, self.signals.outputs)
        said = held.matrix(self.signals.outputs)
        u, y = held.matrix(self.signals.inputs), self._bridged(said, log)
        emulated = EMULATED in self.ways(again=False).values()
        change = self._in_blocks if emulated else self._run
        changed = y + change(self.values, u, y, log.dt_s)
        changed[~np.isfinite(said)] = np.nan
        return dict(zip(self.signals.outputs, changed.T, strict=True))

    def run_again(
        self, log: Log, simulate: Simulate, name: str | None = None
    ) -> dict[str, FloatArray]:
        """Outputs `(time,)` of the simulator itself for the inputs of a log, with the effects.

        With inputs u' as they arrive, `y = simulate(u') + run(u', pace, s) - run(u', 1, 0)`, the
        two runs being the emulator's, and only needed for effects on the engine's pace or on where
        it settles; then y is read.
        Outputs that no effect is known for are given as the simulator has them. Raises `DataError`
        as `added_to`, and `ModelError` where an output is missing.
        """
        held = self._complete(log, name or log.name)
        signals = replace(self.signals, dt_s=log.dt_s)
        found, names = settings(self.values, signals), signals.inputs
        u = held.matrix(names)[None]
        given = arrived(found, signals, u)
        changed = {n: v for n, v in zip(names, given[0].T, strict=True) if n in log.channels}
        outputs = dict(simulate(self._run_on(log.with_channels(changed))))
        said = self._diagnosed(outputs, log)
        y = self._bridged(said, log)
        y += self._change_inside(found, given[0], y, log.dt_s)
        y = np.where(np.isfinite(said), read(found, signals, given, y[None])[0], np.nan)
        return {**outputs, **dict(zip(signals.outputs, y.T, strict=True))}

    def check(self, *, again: bool) -> None:
        """Raise `ConfigError` where an effect needs the stored emulator and there is none."""
        inside = [name for name, way in self.ways(again=again).items() if way == EMULATED]
        if inside and self.emulator is None:
            raise ConfigError(
                f"effect '{inside[0]}' needs the emulator, which is not next to gap.json",
                hint=f"Keep the whole folder that narxcal diagnose wrote, with {EMULATOR}/ in it",
            )

    def ways(self, *, again: bool) -> dict[str, str]:
        """How each effect is applied, in words, if the simulator can be run `again` or not."""
        return {
            effect.name: self._way((effect, theta), again=again)
            for effect, theta in settings(self.values, self.signals)
        }

    def _way(self, setting: Setting, *, again: bool) -> str:
        effect = setting[0]
        if again and effect.arrives is not None:
            return INPUTS
        if effect.shifts is not None:
            return SHIFTED
        inside = effect.arrives is not None or acts_inside(setting, self.signals)
        return EMULATED if inside else OUTPUTS

    def _complete(self, log: Log, name: str, outputs: tuple[str, ...] = ()) -> Log:
        """The log with all inputs, an unlogged load's included, and without holes in them.

        An input that no effect looks at and that never changed in the diagnosis may be missing.
        """
        if UNLOGGED in self.signals.inputs:
            log = log.with_channels({UNLOGGED: self._on(log, name)})
        emulated = EMULATED in self.ways(again=not outputs).values()
        for each in (*self.signals.inputs, *outputs):
            if each in log.channels:
                continue
            still = each in self.signals.inputs and each not in self.signals.active
            if not still or (emulated and each in _AIR):
                raise DataError(
                    "the flights that were diagnosed have it, and this log has not",
                    file=log.name,
                    channel=each,
                    hint=f"It has {', '.join(log.channels)}",
                )
            log = log.with_channels({each: np.zeros(len(log))})
        return hold_inputs(log, self.signals.inputs)

    def _run_on(self, log: Log) -> Log:
        """The log without outputs and without what no simulator knows."""
        names = [
            name
            for name in log.channels
            if name in CHANNELS and (CHANNELS[name].role != "output" or name in self.signals.inputs)
        ]
        return replace(log, channels={name: log[name] for name in names})

    def _diagnosed(self, outputs: Mapping[str, FloatArray], log: Log) -> FloatArray:
        for name in self.signals.outputs:
            if name not in outputs:
                raise ModelError(
                    "the simulator does not give it, and the effects were found on it",
                    file=log.name,
                    channel=name,
                    hint=f"It gives {', '.join(outputs)}",
                )
        return np.column_stack([outputs[name] for name in self.signals.outputs])

    def _bridged(self, said: FloatArray, log: Log) -> FloatArray:
        for name, column in zip(self.signals.outputs, said.T, strict=True):
            if not np.isfinite(column).any():
                raise DataError(
                    "no simulated sample is known",
                    file=log.name,
                    channel=name,
                    hint="Simulate the flight anew, or leave the log out",
                )
        return np.column_stack([bridge_gaps(column) for column in said.T])

    def _change_inside(
        self, found: list[Setting], given: FloatArray, y: FloatArray, dt_s: float
    ) -> FloatArray | float:
        """What effects inside change in the emulator's run of an engine with inputs `given`.

        What is linear in an effect on the pace is none: it is added with the readings.
        """
        inside = {
            effect.name: {
                p.name: self.values[effect.name].get(p.name, p.neutral)
                for p in effect.parameters(self.signals)
                if not p.linear or effect.settled
            }
            for effect, theta in found
            if acts_inside((effect, theta), self.signals)
        }
        return self._in_blocks(inside, given, y, dt_s) if inside else 0.0

    def _on(self, log: Log, name: str) -> FloatArray:
        since, on = log.time_s - log.time_s[0], np.zeros(len(log))
        for start_s, end_s in self.windows.get(name, ()):
            on[(since >= start_s) & (since < end_s)] = 1.0
        return on

    def _in_blocks(self, values: Values, u: FloatArray, y: FloatArray, dt_s: float) -> FloatArray:
        """The change on the raster of the diagnosis, carried over to that of the log."""
        size = max(1, round(self.signals.dt_s / dt_s))
        since, step_s = np.arange(len(u), dtype=np.float64) * dt_s, dt_s
        if abs(size * step_s / self.signals.dt_s - 1.0) > _ONE_RASTER:
            step_s = self.signals.dt_s / size
            at = np.arange(0.0, since[-1] + 0.5 * step_s, step_s)
            u, y = on_lines(at, since, u), on_lines(at, since, y)
        change = self._run(values, block_means(u, size), block_means(y, size), size * step_s)
        middles = ((np.arange(len(change), dtype=np.float64) + 0.5) * size - 0.5) * step_s
        return on_lines(since, middles, change)

    def _run(self, values: Values, u: FloatArray, y: FloatArray, dt_s: float) -> FloatArray:
        flights = Flights(replace(self.signals, dt_s=dt_s), u[None], y[None], np.array([len(u)]))
        return np.asarray(with_effects(values, flights, self.emulator)[0] - y)


def read_effects(file: Path) -> FoundEffects:
    """Read the claimed effects of a `gap.json`, or of the folder it is in, with its emulator.

    Raises `ConfigError` for a file that is none, and `ModelError` for a damaged emulator.
    """
    file = file / "gap.json" if file.is_dir() else file
    document = gap_document(file)
    folder = file.parent / EMULATOR
    emulator = read_emulator(folder) if folder.is_dir() else None
    try:
        return _found(document, emulator)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ConfigError(
            f"a part is missing or damaged: {type(error).__name__}: {error}",
            file=file,
            hint="Name the gap.json that narxcal diagnose wrote, unchanged",
        ) from None


def _found(document: Mapping[str, Any], emulator: GreyBoxEmulator | None) -> FoundEffects:
    values, quality = claimed_in(document), document["quality"]
    signals = signals_from_json(quality["signals"])
    flights, held = (frozenset(quality.get(key, ())) for key in ("flights", "held_out"))
    # Of two flights of one name nobody can say which one is meant.
    searched = flights ^ held
    windows = {name: on for name, on in _windows(document).items() if name in searched}
    return FoundEffects(values, signals, emulator, windows, searched)


def _windows(document: Mapping[str, Any]) -> Windows:
    found: dict[str, tuple[tuple[float, float], ...]] = {}
    for row in document["effects"]:
        for spell in row.get("windows", ()):
            own = tuple(float(spell[key] - spell["log_start_s"]) for key in ("start_s", "end_s"))
            found[spell["log"]] = (*found.get(spell["log"], ()), (own[0], own[1]))
    return found


def gap_document(file: Path) -> Mapping[str, Any]:
    """Read a `gap.json`; raises `ConfigError` for a file that is none, or of another version."""
    hint = "Name the gap.json that narxcal diagnose wrote, or diagnose again"
    return read_document(file, GAP_SCHEMA, ConfigError, hint)


def read_document(file: Path, schema: str, error: type[NarxcalError], hint: str) -> dict[str, Any]:
    """Read a JSON document of a schema; raises `error` with a `hint` for a file that is none."""
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
    except OSError as problem:
        raise error(f"cannot be read: {problem.strerror}", file=file, hint=hint) from None
    except (ValueError, RecursionError) as problem:
        raise error(f"not JSON: {problem}", file=file, hint=hint) from None
    found = document.get("schema") if isinstance(document, dict) else None
    if found != schema:
        raise error(f"expected schema '{schema}', found {found!r}", file=file, hint=hint)
    return dict(document)


SCHEMA = "narxcal.emulator/4"
EMULATOR = "emulator"  # folder next to gap.json
DOCUMENT, WEIGHTS = "emulator.json", "weights.safetensors"
_AGAIN = "Diagnose again, or copy the folder again"


def write_emulator(folder: Path, emulator: GreyBoxEmulator) -> None:
    """Write into an existing folder."""
    settled, engine = emulator.settled, emulator.engine
    arrays = {
        "theta": engine.theta,
        "thermal": engine.thermal,
        "weights": settled.weights,
        "low": settled.low,
        "high": settled.high,
    }
    weights = save_arrays({name: np.array(value, order="C") for name, value in arrays.items()})
    document = {
        "schema": SCHEMA,
        "signals": signals_to_json(settled.signals),
        "conditions": list(settled.conditions),
        "switches": list(settled.switches),
        "core": {"low_pct": engine.low, "span_pct": engine.span},
        "governed": engine.governed,
        "dt_s": engine.dt_s,
        "sha256": hashlib.sha256(weights).hexdigest(),
    }
    (folder / WEIGHTS).write_bytes(weights)
    (folder / DOCUMENT).write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def read_emulator(folder: Path) -> GreyBoxEmulator:
    """Read what `write_emulator` wrote; raises `ModelError` where it is missing or altered."""
    document = read_document(folder / DOCUMENT, SCHEMA, ModelError, _AGAIN)
    arrays = _arrays(folder / WEIGHTS, str(document.get("sha256")))
    try:
        settled = SettledModel(
            signals_from_json(document["signals"]),
            tuple(document["conditions"]),
            tuple(document["switches"]),
            arrays["low"],
            arrays["high"],
            arrays["weights"],
        )
        core = document["core"]
        engine = TwoSpool(
            arrays["theta"],
            arrays["thermal"],
            float(core["low_pct"]),
            float(core["span_pct"]),
            int(document["governed"]),
            float(document["dt_s"]),
        )
    except KeyError as error:
        raise ModelError(
            f"the stored emulator has no {error}", file=folder / DOCUMENT, hint=_AGAIN
        ) from None
    except (TypeError, ValueError, IndexError, OverflowError) as error:
        problem = f"a part of the stored emulator is damaged: {error}"
        raise ModelError(problem, file=folder / DOCUMENT, hint=_AGAIN) from None
    return GreyBoxEmulator(settled, engine)


def signals_to_json(signals: Signals) -> dict[str, Any]:
    return {
        name: value.tolist() if isinstance(value, np.ndarray) else value
        for name, value in asdict(signals).items()
    }


def signals_from_json(stored: Mapping[str, Any]) -> Signals:
    """Rebuild from `signals_to_json`; raises `KeyError` where a part is missing."""
    return Signals(
        inputs=tuple(stored["inputs"]),
        outputs=tuple(stored["outputs"]),
        dt_s=float(stored["dt_s"]),
        driver=stored["driver"],
        low=np.array(stored["low"], dtype=np.float64),
        high=np.array(stored["high"], dtype=np.float64),
        lever=_range(*stored["lever"]),
        active=tuple(stored["active"]),
    )


def _range(low: float, high: float) -> tuple[float, float]:
    return float(low), float(high)


def _arrays(file: Path, sha256: str) -> dict[str, FloatArray]:
    if not file.is_file():
        raise ModelError("the weights are missing", file=file, hint=_AGAIN)
    data = file.read_bytes()
    if hashlib.sha256(data).hexdigest() != sha256:
        raise ModelError("the weights were altered or cut off", file=file, hint=_AGAIN)
    try:
        return load_arrays(data)
    except (SafetensorError, ValueError) as error:
        raise ModelError(f"not safetensors: {error}", file=file, hint=_AGAIN) from None
