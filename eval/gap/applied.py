"""Found effects added to any simulated log: what `simulate --effects` does, log by log.

Effects on readings act on the log's own raster. Those inside the engine need the emulator, which
runs on the raster of the diagnosis: there the change they make is found, from block means of the
log, and the change is added to the log, on straight lines between the blocks' middles.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from data_prep.hold import hold_inputs
from data_prep.log import Log
from eval.gap.blocks import block_means
from eval.gap.claimed import Values, claimed_in, settings, with_effects
from eval.gap.data import FloatArray
from eval.gap.document import SCHEMA
from eval.gap.stored_emulator import read_emulator, signals_from_json
from eval.gap.summary import EMULATOR
from narxcal.effects.base import InputEffect, RateEffect, Signals
from narxcal.effects.running import Flights
from narxcal.effects.steady import UNLOGGED, UnloggedSwitch
from narxcal.errors import ConfigError, DataError
from training.gap.emulator import GreyBoxEmulator

Windows = Mapping[str, tuple[tuple[float, float], ...]]  # log -> seconds since it began


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

    @property
    def has_load(self) -> bool:
        """Whether a load that no channel records is among the effects."""
        return UnloggedSwitch.id in self.values

    def knows(self, name: str) -> bool:
        """Whether the log of that name was searched for windows of the load."""
        return name in self.searched

    def added_to(self, log: Log, name: str | None = None) -> dict[str, FloatArray]:
        """Outputs `(time,)` of a simulated log with the effects in place.

        A load that no channel records is on where it was found in the log called `name`, and off
        in others. Raises `DataError` for a log that lacks one of the signals, or whose rate is no
        multiple of the diagnosis'.
        """
        if UNLOGGED in self.signals.inputs:
            log = log.with_channels({UNLOGGED: self._on(log, name or log.name)})
        for each in (*self.signals.inputs, *self.signals.outputs):
            if each not in log.channels:
                raise DataError("the effects need it", file=log.name, channel=each)
        held = hold_inputs(log, self.signals.inputs)
        u, y = held.matrix(self.signals.inputs), held.matrix(self.signals.outputs)
        changed = y + (self._change(u, y, log) if self.values else 0.0)
        return dict(zip(self.signals.outputs, changed.T, strict=True))

    def _on(self, log: Log, name: str) -> FloatArray:
        """1 within the windows, by seconds since the log began."""
        since, on = log.time_s - log.time_s[0], np.zeros(len(log))
        for start_s, end_s in self.windows.get(name, ()):
            on[(since >= start_s) & (since < end_s)] = 1.0
        return on

    def _change(self, u: FloatArray, y: FloatArray, log: Log) -> FloatArray:
        found = settings(self.values, self.signals)
        if not any(isinstance(effect, (InputEffect, RateEffect)) for effect, _ in found):
            return self._run(u, y, log.dt_s)
        size = round(self.signals.dt_s / log.dt_s)
        if size < 1 or abs(size * log.dt_s / self.signals.dt_s - 1.0) > 0.01:
            raise DataError(
                f"the log is at {1 / log.dt_s:.4g} Hz, which is no multiple of the diagnosis' "
                f"{1 / self.signals.dt_s:.4g} Hz",
                file=log.name,
                hint="Put it on the raster of the flights that were diagnosed",
            )
        change = self._run(block_means(u, size), block_means(y, size), size * log.dt_s)
        middles = (np.arange(len(change)) + 0.5) * size - 0.5
        rows = np.arange(len(u))
        return np.column_stack([np.interp(rows, middles, column) for column in change.T])

    def _run(self, u: FloatArray, y: FloatArray, dt_s: float) -> FloatArray:
        flights = Flights(replace(self.signals, dt_s=dt_s), u[None], y[None], np.array([len(u)]))
        return np.asarray(with_effects(self.values, flights, self.emulator)[0] - y)


def read_effects(file: Path) -> FoundEffects:
    """Read the claimed effects of a `gap.json`, or of the folder it is in, with its emulator.

    Raises `ConfigError` for a file that is none, and `ModelError` for a damaged emulator.
    """
    file = file / "gap.json" if file.is_dir() else file
    document = _document(file)
    values = claimed_in(document)
    signals = signals_from_json(document["quality"]["signals"])
    folder = file.parent / EMULATOR
    emulator = read_emulator(folder) if folder.is_dir() else None
    quality = document["quality"]
    searched = frozenset((*quality.get("flights", ()), *quality.get("held_out", ())))
    return FoundEffects(values, signals, emulator, _windows(document), searched)


def _windows(document: Mapping[str, Any]) -> Windows:
    """Seconds since the beginning of the log, for every log in which a load was on."""
    found: dict[str, tuple[tuple[float, float], ...]] = {}
    for row in document["effects"]:
        for spell in row.get("windows", ()):
            own = tuple(float(spell[key] - spell["log_start_s"]) for key in ("start_s", "end_s"))
            found[spell["log"]] = (*found.get(spell["log"], ()), (own[0], own[1]))
    return found


def _document(file: Path) -> Mapping[str, Any]:
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror}", file=file) from None
    except ValueError as error:
        raise ConfigError(f"not JSON: {error}", file=file) from None
    found = document.get("schema") if isinstance(document, dict) else None
    if found != SCHEMA:
        raise ConfigError(
            f"expected schema '{SCHEMA}', found {found!r}",
            file=file,
            hint="Name the gap.json that narxcal diagnose wrote",
        )
    return dict(document)
