"""Channels that a recorder lacks and others imply: temperature over ISA, weight on wheels.

Channels are `(rows,)`, in canonical units.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field, PositiveFloat

from narxcal.atmosphere import KELVIN, isa, static_temperature
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError
from narxcal.support.settings import Section

if TYPE_CHECKING:
    from collections.abc import Mapping


class WeightOnWheels(Section):
    """WOW from airspeed: 1 below `below_kt`, 0 from `below_kt + hysteresis_kt` on.

    In between the last decision stands, so that noise around the threshold does not chatter.
    """

    airspeed: Literal["CAS_kt", "TAS_kt"] = "CAS_kt"
    below_kt: PositiveFloat = 60.0
    hysteresis_kt: float = Field(default=10.0, ge=0.0)


class DeriveConfig(Section):
    """TOML table `[logs.derive]`; a channel the file already has is never overwritten.

    `dT_C` names the temperature it comes from; left out, it is derived whenever it is missing
    and SAT_C, or else TAT_C and Mach, are there. `recovery` is that of the TAT probe.
    """

    dT_C: Literal["SAT_C", "TAT_C"] | None = None
    WOW: WeightOnWheels | None = None
    recovery: float = Field(default=1.0, gt=0.0, le=1.0)


def weight_on_wheels(airspeed_kt: FloatArray, rule: WeightOnWheels) -> FloatArray:
    """Decide ground (1) or air (0), `(time,)`; a missing airspeed keeps the last decision.

    Before the first clear decision the nearer side of the threshold's middle counts; with no
    airspeed at all the answer is NaN.
    """
    verdict = np.full(airspeed_kt.shape, np.nan)
    verdict[airspeed_kt < rule.below_kt] = 1.0
    verdict[airspeed_kt >= rule.below_kt + rule.hysteresis_kt] = 0.0
    known = np.isfinite(airspeed_kt)
    if not known.any():
        return verdict
    first = int(known.argmax())
    if np.isnan(verdict[first]):
        verdict[first] = float(airspeed_kt[first] < rule.below_kt + rule.hysteresis_kt / 2.0)
    verdict[0] = verdict[first]
    decided = np.where(np.isfinite(verdict), np.arange(len(verdict)), 0)
    return np.asarray(verdict[np.maximum.accumulate(decided)])


def derive(
    channels: Mapping[str, FloatArray], config: DeriveConfig, file: str
) -> dict[str, FloatArray]:
    """Channels to add to `channels`, all `(time,)` on one raster.

    Raises `ConfigError` when an asked-for derivation lacks a channel.
    """
    added: dict[str, FloatArray] = {}
    if "dT_C" not in channels:
        source = config.dT_C or _temperature_source(channels)
        if source:
            needed = ("SAT_C", "ALT_ft") if source == "SAT_C" else ("TAT_C", "Mach", "ALT_ft")
            _require("dT_C", needed, channels, file)
            static = channels[source]
            if source == "TAT_C":
                static = static_temperature(static, channels["Mach"], config.recovery)
            added["dT_C"] = static + KELVIN - isa(channels["ALT_ft"])[0]
    if "WOW" not in channels and config.WOW is not None:
        _require("WOW", (config.WOW.airspeed,), channels, file)
        added["WOW"] = weight_on_wheels(channels[config.WOW.airspeed], config.WOW)
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
