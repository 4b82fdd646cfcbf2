"""Derive channels that a recorder lacks from others: Mach, temperature over ISA, weight on wheels.

Airspeed with altitude, true airspeed with temperature, and the rise of temperature in a probe each
give the Mach number; altitude gives the usual temperature of the air. So air data also show their
own units (`units_that_agree`). Channels are `(rows,)`, in canonical units unless said otherwise.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Literal

import numpy as np
from pydantic import Field, PositiveFloat

from data_prep.sources.units import find_unit, to_canonical
from narxcal.atmosphere import (
    KELVIN,
    SOUND_KT,
    T0_K,
    cas_of_mach,
    isa,
    mach_of_cas,
    static_temperature,
)
from narxcal.support.arrays import FloatArray, bridge_gaps, sample_and_hold
from narxcal.support.errors import ConfigError
from narxcal.support.settings import Section

# To find units: rows of a recording that are looked at, and of them in flight, at least.
_ROWS, _FEWEST = 400, 10
_FLYING = 0.3  # Mach number above which an airspeed is exact
_SAME_MACH = 0.04  # relative; a wrong unit changes the Mach number by a tenth or more
_MOST_FROM_ISA_C = 40.0


class WeightOnWheels(Section):
    """WOW from airspeed: 1 below `below_kt`, 0 from `below_kt + hysteresis_kt` on.

    CAS_kt follows from Mach and ALT_ft where it is not there.

    In between the last decision is kept, so that noise around the threshold does not switch it.
    """

    airspeed: Literal["CAS_kt", "TAS_kt"] = "CAS_kt"
    below_kt: PositiveFloat = 60.0
    hysteresis_kt: float = Field(default=10.0, ge=0.0)


class DeriveConfig(Section):
    """TOML table `[logs.derive]`; a channel the file already has is never overwritten.

    Mach is derived whenever it is missing and CAS_kt and ALT_ft, or else TAS_kt and SAT_C or TAT_C,
    are there. `dT_C` names the temperature it comes from; left out, it is derived whenever it is
    missing and SAT_C, or else TAT_C and Mach, are there. `recovery` is that of the TAT probe.
    """

    dT_C: Literal["SAT_C", "TAT_C"] | None = None
    WOW: WeightOnWheels | None = None
    recovery: float = Field(default=1.0, gt=0.0, le=1.0)


def weight_on_wheels(airspeed_kt: FloatArray, rule: WeightOnWheels) -> FloatArray:
    """Decide ground (1) or air (0), `(time,)`; a missing airspeed keeps the last decision.

    Before the first clear decision the nearer side of the threshold's middle counts; with no
    airspeed at all the answer is NaN.
    """
    on_ground = np.full(airspeed_kt.shape, np.nan)
    on_ground[airspeed_kt < rule.below_kt] = 1.0
    on_ground[airspeed_kt >= rule.below_kt + rule.hysteresis_kt] = 0.0
    known = np.isfinite(airspeed_kt)
    if not known.any():
        return on_ground
    first = int(known.argmax())
    if np.isnan(on_ground[first]):
        on_ground[first] = float(airspeed_kt[first] < rule.below_kt + rule.hysteresis_kt / 2.0)
    return sample_and_hold(on_ground)


def derive(
    channels: Mapping[str, FloatArray], config: DeriveConfig, file: str
) -> dict[str, FloatArray]:
    """Return the channels to add to `channels`, all `(time,)` on one grid.

    Raises `ConfigError` where a configured derivation lacks a channel.
    """
    added: dict[str, FloatArray] = {}
    if "Mach" not in channels:
        with np.errstate(divide="ignore", invalid="ignore"):  # of a failed temperature probe
            mach = next(_machs_of_speed(channels, config.recovery), None)
        if mach is not None:
            added["Mach"] = mach
    known = {**channels, **added}
    if "dT_C" not in channels:
        source = config.dT_C or _temperature_source(known)
        if source:
            needed = ("SAT_C", "ALT_ft") if source == "SAT_C" else ("TAT_C", "Mach", "ALT_ft")
            _require("dT_C", needed, known, file)
            static = known[source]
            if source == "TAT_C":
                static = static_temperature(static, known["Mach"], config.recovery)
            added["dT_C"] = static + KELVIN - isa(known["ALT_ft"])[0]
    if "WOW" not in channels and config.WOW is not None:
        name = config.WOW.airspeed
        if name == "CAS_kt" and name not in known and {"Mach", "ALT_ft"} <= known.keys():
            known[name] = cas_of_mach(known["Mach"], known["ALT_ft"])
        _require("WOW", (name,), known, file)
        added["WOW"] = weight_on_wheels(known[name], config.WOW)
    return added


def _temperature_source(channels: Mapping[str, FloatArray]) -> str | None:
    if {"SAT_C", "ALT_ft"} <= channels.keys():
        return "SAT_C"
    return "TAT_C" if {"TAT_C", "Mach", "ALT_ft"} <= channels.keys() else None


def _require(
    name: str, needed: tuple[str, ...], channels: Mapping[str, FloatArray], file: str
) -> None:
    missing = [each for each in needed if each not in channels]
    if missing:
        raise ConfigError(
            f"it cannot be derived without {' and '.join(missing)}",
            file=file,
            channel=name,
            hint="Map it under [logs.columns] or take the derivation out of [logs.derive]",
        )


def units_that_agree(
    air: Mapping[str, FloatArray], possible: Mapping[str, Sequence[str]]
) -> dict[str, str]:
    """Return the units in which alone air data `(rows,)` agree, by channel.

    `possible` are the units of each channel but Mach, which has none. A channel with several units
    that agree with some units of the others, or cannot be tested with them, is left out.
    """
    most = max(map(len, air.values()), default=1)
    rows = np.linspace(0, most - 1, _ROWS)
    raw = {name: filled(values, rows) for name, values in air.items()}
    agreeing = []
    for units in product(*possible.values()):
        chosen = dict(zip(possible, units, strict=True))
        canonical = {
            name: to_canonical(values, find_unit(chosen.get(name, "-"), name))
            for name, values in raw.items()
        }
        if _agree(canonical):
            agreeing.append(units)
    found = {name: {units[k] for units in agreeing} for k, name in enumerate(possible)}
    return {name: each.pop() for name, each in found.items() if len(each) == 1}


def _agree(air: Mapping[str, FloatArray]) -> bool:
    """Whether air data `(rows,)` give one Mach number, in each way that there is, and usual air.

    Without flight at a Mach number at which they show it nothing contradicts them.
    """
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        machs = [*([air["Mach"]] if "Mach" in air else []), *_machs(air)]
        flying = machs[0] > _FLYING if machs else np.zeros(0, dtype=np.bool_)
        if len(machs) < 2 or flying.sum() < _FEWEST:
            return True
        apart = [float(np.median(np.abs(each / machs[0] - 1.0)[flying])) for each in machs[1:]]
    if not max(apart) < _SAME_MACH:  # NaN is none
        return False
    if not {"SAT_C", "ALT_ft"} <= air.keys():
        return True
    away = air["SAT_C"] + KELVIN - isa(air["ALT_ft"])[0]
    return bool(np.median(np.abs(away[flying])) < _MOST_FROM_ISA_C)


def _machs(air: Mapping[str, FloatArray]) -> Iterator[FloatArray]:
    """The Mach number `(rows,)` in each way in which air data give it."""
    yield from _machs_of_speed(air)
    if {"SAT_C", "TAT_C"} <= air.keys():
        rise = (air["TAT_C"] + KELVIN) / (air["SAT_C"] + KELVIN) - 1.0
        yield np.sqrt(5.0 * np.maximum(rise, 0.0))


def _machs_of_speed(air: Mapping[str, FloatArray], recovery: float = 1.0) -> Iterator[FloatArray]:
    if {"CAS_kt", "ALT_ft"} <= air.keys():
        yield mach_of_cas(air["CAS_kt"], air["ALT_ft"])
    if {"TAS_kt", "SAT_C"} <= air.keys():
        yield _mach_of_tas(air["TAS_kt"], air["SAT_C"])
    elif {"TAS_kt", "TAT_C"} <= air.keys():
        mach = _mach_of_tas(air["TAS_kt"], air["TAT_C"])
        yield mach / np.sqrt(1.0 - 0.2 * recovery * mach**2)


def _mach_of_tas(tas_kt: FloatArray, temperature_c: FloatArray) -> FloatArray:
    return tas_kt / (SOUND_KT * np.sqrt((temperature_c + KELVIN) / T0_K))


def filled(values: FloatArray, rows: FloatArray) -> FloatArray:
    """Interpolate a column at fractional `rows`, over its blanks."""
    return np.interp(rows, np.arange(len(values)), bridge_gaps(values))
