"""Derive channels that a recorder lacks from others: Mach, temperature over ISA, weight on wheels.

Channels are `(rows,)`, in canonical units.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field, PositiveFloat

from narxcal.atmosphere import (
    KELVIN,
    SOUND_KT,
    T0_K,
    cas_of_mach,
    isa,
    mach_of_cas,
    static_temperature,
)
from narxcal.support.arrays import FloatArray, sample_and_hold
from narxcal.support.errors import ConfigError
from narxcal.support.settings import Section

if TYPE_CHECKING:
    from collections.abc import Mapping


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

    Mach is derived whenever it is missing and CAS_kt and ALT_ft, or else TAS_kt and SAT_C, are
    there. `dT_C` names the temperature it comes from; left out, it is derived whenever it is
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
    if "Mach" not in channels and (mach := _mach(channels)) is not None:
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
        name, speeds = config.WOW.airspeed, dict(channels)
        if name == "CAS_kt" and name not in channels and {"Mach", "ALT_ft"} <= channels.keys():
            speeds[name] = cas_of_mach(channels["Mach"], channels["ALT_ft"])
        _require("WOW", (name,), speeds, file)
        added["WOW"] = weight_on_wheels(speeds[name], config.WOW)
    return added


def _mach(channels: Mapping[str, FloatArray]) -> FloatArray | None:
    if {"CAS_kt", "ALT_ft"} <= channels.keys():
        return mach_of_cas(channels["CAS_kt"], channels["ALT_ft"])
    if {"TAS_kt", "SAT_C"} <= channels.keys():
        with np.errstate(divide="ignore", invalid="ignore"):  # of a failed temperature probe
            sound_kt = SOUND_KT * np.sqrt((channels["SAT_C"] + KELVIN) / T0_K)
            return channels["TAS_kt"] / sound_kt
    return None


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
