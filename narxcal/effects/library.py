"""The library: every effect there is, by its id, and who is easily taken for whom."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from narxcal.effects import dynamic, signal_path, steady
from narxcal.effects.base import Effect, Signals
from narxcal.effects.signal_path import AIR_DATA
from narxcal.support.errors import ConfigError, did_you_mean

ENGINE_WIDE = (
    signal_path.THROTTLE_BACKLASH,
    signal_path.THROTTLE_DELAY,
    signal_path.THROTTLE_RATE_LIMIT,
    signal_path.THROTTLE_BIAS,
    dynamic.ACTUATOR_LAG,
    dynamic.SPOOL_LAG,
    dynamic.ACCEL_DECEL_ASYMMETRY,
    dynamic.ACCEL_LIMIT,
    dynamic.ALTITUDE_LAG,
    dynamic.SPOOL_COUPLING,
    steady.HEAT_SOAK,
    steady.BLEED_EXTRACTION,
    steady.UNLOGGED_SWITCH,
    steady.DETERIORATION,
    steady.TEMPERATURE_EFFECT,
    steady.IDLE_SCHEDULE,
)
PER_CHANNEL = (
    signal_path.SENSOR_LAG,
    signal_path.SENSOR_BIAS,
    signal_path.SENSOR_DRIFT,
    signal_path.TIME_SKEW,
)
# In no blind case: how often they are claimed wrongly is known, how often rightly is not.
OF_AIR_DATA = (
    signal_path.AIR_DATA_BIAS,
    signal_path.AIR_DATA_DELAY,
    signal_path.AIR_DATA_FROZEN,
)
RARE = (signal_path.DRIVER_GAIN, signal_path.SENSOR_GAIN, *OF_AIR_DATA)
LIBRARY: dict[str, Effect] = {
    each.id: each for each in (*ENGINE_WIDE, *PER_CHANNEL, signal_path.FLOWMETER_DYNAMICS, *RARE)
}
# Where fuel is the driver there is no lever, and no control that limits anything.
_OF_LEVER = ("throttle_backlash", "throttle_rate_limit", "throttle_bias", "accel_limit")


def candidates(signals: Signals) -> tuple[Effect, ...]:
    """Every effect that can act on these signals, sensor effects once per output."""
    each = [kind.of(channel) for channel in signals.outputs for kind in PER_CHANNEL]
    meter = signal_path.FLOWMETER_DYNAMICS.of("FF_kgph")
    return tuple(one for one in (*ENGINE_WIDE, meter, *each) if one.applies(signals))


def hypotheses(signals: Signals) -> tuple[Effect, ...]:
    """Every effect that a budget weighs: candidates, scales and air data."""
    gains = [signal_path.SENSOR_GAIN.of(channel) for channel in signals.outputs]
    air = [kind.of(channel) for channel in AIR_DATA for kind in OF_AIR_DATA]
    rare = [signal_path.DRIVER_GAIN, *gains, *(one for one in air if one.applies(signals))]
    # A flow meter lags as any sensor does: of two that are one the more telling name stands.
    left_out = ("unlogged_switch", "sensor_lag:FF_kgph", *(() if signals.governed else _OF_LEVER))
    return tuple(one for one in (*candidates(signals), *rare) if one.name not in left_out)


def name_of(row: Mapping[str, Any]) -> str:
    """Name of an effect of its row in a document: `id`, or `id:channel`."""
    return f"{row['id']}:{row['channel']}" if row.get("channel") else str(row["id"])


def effect(name: str) -> Effect:
    """Effect called `id` or `id:channel`; raises `ConfigError` naming the nearest id."""
    kind, _, channel = name.partition(":")
    if kind not in LIBRARY:
        raise ConfigError(f"unknown effect '{kind}'", hint=did_you_mean(kind, LIBRARY, "Known:"))
    found = LIBRARY[kind]
    if found.per_channel != bool(channel):
        wants = "needs a channel, as in sensor_lag:EGT_C" if not channel else "has no channel"
        raise ConfigError(f"effect '{kind}' {wants}")
    return found.of(channel) if channel else found
