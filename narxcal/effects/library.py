"""The library: every effect there is, by its id, and who is easily taken for whom."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from narxcal.effects.base import Effect, Signals
from narxcal.effects.dynamic import (
    AccelDecelAsymmetry,
    AccelLimit,
    ActuatorLag,
    AltitudeLag,
    SpoolCoupling,
    SpoolLag,
)
from narxcal.effects.signal_path import (
    AIR_DATA,
    AirDataBias,
    AirDataDelay,
    AirDataEffect,
    AirDataFrozen,
    DriverGain,
    FlowmeterDynamics,
    SensorBias,
    SensorDrift,
    SensorEffect,
    SensorGain,
    SensorLag,
    ThrottleBacklash,
    ThrottleBias,
    ThrottleDelay,
    ThrottleRateLimit,
    TimeSkew,
)
from narxcal.effects.steady import (
    BleedExtraction,
    Deterioration,
    HeatSoak,
    IdleSchedule,
    TemperatureEffect,
    UnloggedSwitch,
)
from narxcal.support.errors import ConfigError, did_you_mean

ENGINE_WIDE: tuple[type[Effect], ...] = (
    ThrottleBacklash,
    ThrottleDelay,
    ThrottleRateLimit,
    ThrottleBias,
    ActuatorLag,
    SpoolLag,
    AccelDecelAsymmetry,
    AccelLimit,
    AltitudeLag,
    SpoolCoupling,
    HeatSoak,
    BleedExtraction,
    UnloggedSwitch,
    Deterioration,
    TemperatureEffect,
    IdleSchedule,
)
PER_CHANNEL: tuple[type[Effect], ...] = (SensorLag, SensorBias, SensorDrift, TimeSkew)
# In no blind case: how often they are claimed wrongly is known, how often rightly is not.
OF_AIR_DATA: tuple[type[Effect], ...] = (AirDataBias, AirDataDelay, AirDataFrozen)
RARE: tuple[type[Effect], ...] = (DriverGain, SensorGain, *OF_AIR_DATA)
ALL: tuple[type[Effect], ...] = (*ENGINE_WIDE, *PER_CHANNEL, FlowmeterDynamics, *RARE)
LIBRARY: dict[str, type[Effect]] = {kind.id: kind for kind in ALL}


def candidates(signals: Signals) -> tuple[Effect, ...]:
    """Every effect that can act on these signals, sensor effects once per output."""
    wide = [kind() for kind in ENGINE_WIDE]
    each = [kind(channel) for channel in signals.outputs for kind in PER_CHANNEL]
    meter = [FlowmeterDynamics("FF_kgph")]
    # A flow meter lags as any sensor does: of two that are one the more telling name stands.
    return tuple(effect for effect in (*wide, *meter, *each) if effect.applies(signals))


def hypotheses(signals: Signals) -> tuple[Effect, ...]:
    """Every effect that a budget weighs: candidates, scales and air data, a flow meter's lag once.

    Where fuel is the driver there is no lever, and no control that limits anything.
    """
    rare: list[Effect] = [DriverGain(), *(SensorGain(channel) for channel in signals.outputs)]
    air = [kind(channel) for channel in AIR_DATA for kind in OF_AIR_DATA]
    rare += [each for each in air if each.applies(signals)]
    lever = (ThrottleBacklash, ThrottleRateLimit, ThrottleBias, AccelLimit)
    left_out = (UnloggedSwitch, *(() if signals.governed else lever))
    every = [each for each in (*candidates(signals), *rare) if not isinstance(each, left_out)]
    return tuple(each for each in every if each.name != "sensor_lag:FF_kgph")


def name_of(row: Mapping[str, Any]) -> str:
    """Name of an effect of its row in a document: `id`, or `id:channel`."""
    return f"{row['id']}:{row['channel']}" if row.get("channel") else str(row["id"])


def effect(name: str) -> Effect:
    """Effect called `id` or `id:channel`; raises `ConfigError` naming the nearest id."""
    kind, _, channel = name.partition(":")
    if kind not in LIBRARY:
        raise ConfigError(f"unknown effect '{kind}'", hint=did_you_mean(kind, LIBRARY, "Known:"))
    if issubclass(LIBRARY[kind], (SensorEffect, AirDataEffect)) != bool(channel):
        wants = "needs a channel, as in sensor_lag:EGT_C" if not channel else "has no channel"
        raise ConfigError(f"effect '{kind}' {wants}")
    return LIBRARY[kind](channel or None)
