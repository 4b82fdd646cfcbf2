"""An unlogged load in the flights of a diagnosis: looked for, told, and found again in others."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any, NamedTuple

import numpy as np

from eval.gap.claimed import Values, with_effects
from eval.gap.data import GapData, Pair
from narxcal.effects.base import Signals
from narxcal.effects.running import Emulator, Flights, with_load
from narxcal.effects.steady import UNLOGGED, UnloggedSwitch
from narxcal.support.arrays import FloatArray
from training.gap.finding import Finding
from training.gap.quadratic import misfit
from training.gap.unlogged import Load, find_known_load, find_load

_SIDE = re.compile(r"(?i)left|right|lh|rh|port|starboard|(eng|engine)[1-4]|l|r")
_SPLIT = re.compile(r"[^A-Za-z0-9]+")
_AMBIENT = ("ALT_ft", "Mach", "dT_C")
_SAME = 1e-3  # of the range of an ambient channel


class Spell(NamedTuple):
    """One window in the log it is in: seconds of its own clock, and sizes with intervals.

    `log_start_s` is the clock's first reading; `held_out` says that the flight took no part.
    """

    log: str
    log_start_s: float
    start_s: float
    end_s: float
    start_span_s: tuple[float, float]
    end_span_s: tuple[float, float]
    shift: Mapping[str, Mapping[str, float]]
    held_out: bool

    def row(self) -> dict[str, Any]:
        """Give it as a row of the document."""
        return {
            **self._asdict(),
            "start_span_s": list(self.start_span_s),
            "end_span_s": list(self.end_span_s),
        }


def look_for_load(data: GapData) -> tuple[GapData, Load]:
    """The data with the windows of an unlogged load as one more input, if there are any."""
    load = _search(data, data.flights)
    return replace(data, flights=with_load(data.flights, load.on, load.price)), load


def look_beside(finding: Finding, data: GapData, emulator: Emulator | None) -> tuple[GapData, Load]:
    """The same in what the best model leaves: an effect of lever moves may hide a load.

    Only where there is a gap and something in it that was found.
    """
    values = {
        name: {key: each.value for key, each in sizes.items()}
        for model in finding.tried[:1]
        for name, sizes in model.parameters.items()
    }
    if finding.kind == "none" or not values:
        return data, _no_load(data)
    beside = replace(data.flights, y=with_effects(values, data.flights, emulator))
    load = _search(data, beside)
    return replace(data, flights=with_load(data.flights, load.on, load.price)), load


def _search(data: GapData, flights: Flights) -> Load:
    measure = misfit(flights, data.real, data.noise)
    # A channel whose gap is nothing correlates with none: that is no reason for a warning.
    with np.errstate(divide="ignore", invalid="ignore"):
        return find_load(flights, measure, aircraft(data))


def _no_load(data: GapData) -> Load:
    return Load(np.zeros(data.flights.u.shape[:2]), (), np.zeros(len(data.names)))


def look_again(values: Values, data: GapData, emulator: Emulator | None) -> tuple[GapData, Load]:
    """Flights that took no part, with the windows in which the claimed load was on there.

    Their own gap tells when, the claim how large: no size is fitted to them. `data` are in terms
    of the flights of the diagnosis, the load's input (off throughout) included.
    """
    flights, shift = data.flights, shift_of(values, data.flights.signals)
    column = flights.signals.u(UNLOGGED)
    others = {name: each for name, each in values.items() if name != UnloggedSwitch.id}
    beside = replace(flights, y=with_effects(others, flights, emulator))
    load = find_known_load(beside, misfit(beside, data.real, data.noise), shift, aircraft(data))
    u = flights.u.copy()
    u[..., column] = load.on
    return replace(data, flights=replace(flights, u=u)), load


def shift_of(values: Values, signals: Signals) -> FloatArray:
    """What the claimed load shifts each output by, (outputs,)."""
    sizes = values[UnloggedSwitch.id]
    return np.array([sizes.get(f"on_{name}", 0.0) for name in signals.outputs])


def aircraft(data: GapData) -> tuple[tuple[int, ...], ...]:
    """Rows of flights that are engines of one aircraft on one flight.

    Their names differ in the side alone (`_left`, `_rh`, `_eng2`), and all that is the same for
    both, altitude, Mach and temperature, is the same.
    """
    groups: dict[tuple[str, ...], list[int]] = {}
    for f, name in enumerate(data.names):
        words = [word for word in _SPLIT.split(name) if word]
        side = [k for k, word in enumerate(words) if _SIDE.fullmatch(word)][-1:]
        rest = tuple(word for k, word in enumerate(words) if k not in side)
        if side:
            groups.setdefault(rest, []).append(f)
    return tuple(tuple(rows) for rows in groups.values() if len(rows) > 1 and _together(data, rows))


def _together(data: GapData, rows: Sequence[int]) -> bool:
    """Whether these flights were flown at one place."""
    flights, first = data.flights, rows[0]
    names = [name for name in _AMBIENT if name in flights.signals.inputs]
    if not names or len({int(flights.lengths[f]) for f in rows}) > 1:
        return False
    columns = [flights.signals.u(name) for name in names]
    ambient = flights.u[..., columns]
    span = np.maximum(np.ptp(ambient, axis=(0, 1)), 1e-9)
    return all(bool((np.abs(ambient[f] - ambient[first]) < _SAME * span).all()) for f in rows)


def spells(
    load: Load, data: GapData, pairs: Sequence[Pair], *, held_out: bool = False
) -> tuple[Spell, ...]:
    """The windows in terms of the logs; `pairs` are those that the data were made of."""
    found = []
    whole = {_whole(pair.name): float(pair.time_s[0]) for pair in reversed(pairs)}
    for window in load.windows:
        pair = pairs[window.flight]
        name, since = _whole(pair.name), float(pair.time_s[0])
        sizes = zip(data.flights.signals.outputs, window.shift, strict=True)
        low, high = window.start_span_s, window.stop_span_s
        found.append(
            Spell(
                name,
                whole[name],
                since + window.start_s,
                since + window.stop_s,
                (since + low[0], since + low[1]),
                (since + high[0], since + high[1]),
                {output: asdict(size) for output, size in sizes},
                held_out,
            )
        )
    return tuple(found)


def _whole(name: str) -> str:
    """Name of the log that a part belongs to."""
    return name.partition("#")[0]
