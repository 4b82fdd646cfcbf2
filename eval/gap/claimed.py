"""Found effects as settings that run: from a finding, or from the `gap.json` it was written to."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from eval.gap.data import GapData
from narxcal.effects.base import Signals
from narxcal.effects.library import effect
from narxcal.effects.running import Emulator, Flights, Setting, respond
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError
from training.gap.diagnosis import OFFSETS
from training.gap.finding import Finding, Tried

_MOST_OF_ALL = 0.9  # of the whole gap
Values = Mapping[str, Mapping[str, float]]  # effect -> parameter -> value


def claimed(finding: Finding) -> Values:
    """Parameters of what is claimed; nothing where the verdict names no effect.

    Each effect's are those of the best model with it: claimed together, they stand first.
    """
    if finding.kind not in ("effects", "ambiguous"):
        return {}
    return {
        name: {key: found.value for key, found in model.parameters[name].items()}
        for name in finding.effects
        for model in [next(one for one in finding.tried if name in one.effects)]
    }


def is_offset(name: str) -> bool:
    """Whether an effect, `id` or `id:channel`, only shifts where the engine settles."""
    return name.partition(":")[0] in OFFSETS


def of_offsets(model: Tried) -> bool:
    """Whether a model is of offsets alone."""
    return all(map(is_offset, model.effects))


def offset_leads(finding: Finding) -> bool:
    """Whether an offset is most of the gap though nothing is claimed: within scatter, but there.

    It comes before all that moves then.
    """
    gains = [one.gain for one in finding.tried if of_offsets(one)]
    return not finding.effects and bool(gains) and gains[0] > _MOST_OF_ALL


def claimed_in(document: Mapping[str, Any]) -> Values:
    """Read the same from a document of schema narxcal.gap/1; raises `ConfigError`."""
    rows = {}
    for row in document.get("effects", ()):
        name = row["id"] if row.get("channel") is None else f"{row['id']}:{row['channel']}"
        rows[name] = {key: float(found["value"]) for key, found in row["parameters"].items()}
    wanted = document.get("verdict", {}).get("effects", ())
    lost = [name for name in wanted if name not in rows]
    if lost:
        raise ConfigError(f"the verdict names '{lost[0]}', which is not among the effects")
    return {name: rows[name] for name in wanted}


def settings(values: Values, signals: Signals) -> list[Setting]:
    """Effects with their parameters as one run, for signals that hold what they act on.

    A parameter that is not given is neutral. Raises `ConfigError` for an unknown parameter, and
    for an effect that cannot act on these signals.
    """
    return [(effect(name), _theta(name, given, signals)) for name, given in values.items()]


def _theta(name: str, given: Mapping[str, float], signals: Signals) -> FloatArray:
    found = effect(name)
    if not found.applies(signals):
        raise ConfigError(
            f"effect '{name}' cannot act on these logs",
            hint=f"They have {', '.join((*signals.inputs, *signals.outputs))}; what it acts on "
            "is missing or never changes",
        )
    known = {parameter.name: parameter.neutral for parameter in found.parameters(signals)}
    lost = [key for key in given if key not in known]
    if lost:
        raise ConfigError(
            f"effect '{name}' has no parameter '{lost[0]}'", hint=f"It has {', '.join(known)}"
        )
    return np.array([[given.get(key, neutral) for key, neutral in known.items()]])


def with_effects(values: Values, flights: Flights, emulator: Emulator | None) -> FloatArray:
    """Outputs (flights, time, outputs) of the simulator with effects of these values."""
    if not values:
        return flights.y
    return np.asarray(respond(settings(values, flights.signals), flights, emulator)[0])


def changes(values: Values, data: GapData, emulator: Emulator | None) -> FloatArray:
    """What the effects add to the simulated outputs, (flights, time, outputs)."""
    return np.asarray(with_effects(values, data.flights, emulator) - data.flights.y)
