"""Effects that a virtual engine may have and its steady-state model and logs do not show.

Each effect of the library that has a physical place in the engine is put there: in the lever, the
fuel valve, the control's schedules, the rotors, the gas path or the metal. Blind cases of the
diagnosis fly this engine, so its effects share no equation with `narxcal.effects` or
`narxcal.lumped`: only the ids and the ranges of parameters that both have come from the library.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from operator import add, mul
from typing import Any, Final, NamedTuple

from narxcal.effects import LIBRARY
from narxcal.support.errors import ConfigError, did_you_mean
from narxcal.turbofan.cycle import Health
from narxcal.turbofan.fadec import FuelValveParameters
from narxcal.turbofan.lever import LeverParameters, Ratings
from narxcal.turbofan.transient import Body


class Size(NamedTuple):
    """Range of a parameter, and the value at which the effect does nothing."""

    unit: str
    low: float
    high: float
    neutral: float


def library_size(effect: str, name: str, low: float = math.inf, high: float = -math.inf) -> Size:
    """Range that the library fits this parameter in, widened to `low` and `high`.

    So an engine or sensor can have every size that the diagnosis can find.
    """
    fitted = {each.name: each for each in LIBRARY[effect].fixed}[name]
    return Size(fitted.unit, min(fitted.low, low), max(fitted.high, high), fitted.neutral)


Sizes = Mapping[str, Size]
PARAMETERS: dict[str, Sizes] = {
    "throttle_backlash": {"width_deg": library_size("throttle_backlash", "width_deg")},
    "throttle_delay": {"delay_s": library_size("throttle_delay", "delay_s", high=3.0)},
    "throttle_rate_limit": {"rate_degps": library_size("throttle_rate_limit", "rate_degps")},
    "throttle_bias": {"bias_deg": library_size("throttle_bias", "bias_deg", -10.0, 10.0)},
    "actuator_lag": {
        "tau_s": library_size("actuator_lag", "tau_s", high=5.0),
        "slew": Size("-", 0.02, 1.0, 1.0),
    },
    "spool_lag": {"factor": library_size("spool_lag", "factor", low=0.3)},
    "spool_coupling": {"factor": library_size("spool_coupling", "factor", low=0.3)},
    "accel_decel_asymmetry": {"ratio": library_size("accel_decel_asymmetry", "ratio", low=0.3)},
    "accel_limit": {"factor": Size("-", 0.1, 2.0, 1.0)},
    "altitude_lag": {"exponent": library_size("altitude_lag", "exponent")},
    "heat_soak": {"factor": Size("-", 0.0, 6.0, 1.0)},
    "bleed_extraction": {"share": Size("-", 0.0, 0.15, 0.0)},
    "unlogged_switch": {
        "bleed": Size("-", 0.0, 0.15, 0.0),
        "power_kW": Size("kW", 0.0, 500.0, 0.0),
    },
    "deterioration": {
        "hpc_efficiency_pct": Size("%", -6.0, 6.0, 0.0),
        "hpt_efficiency_pct": Size("%", -6.0, 6.0, 0.0),
        "hpc_flow_pct": Size("%", -6.0, 6.0, 0.0),
    },
    "temperature_effect": {"N1_pct_per_C": Size("%/degC", -0.3, 0.3, 0.0)},
    "idle_schedule": {"shift_pct": Size("%", -10.0, 15.0, 0.0)},
}


def check_sizes(
    effect: str, parameters: Mapping[str, float], table: Mapping[str, Sizes] = PARAMETERS
) -> None:
    """Refuse an effect or parameter that `table` lacks, or a size out of range.

    Raises `ConfigError`.
    """
    if effect not in table:
        raise ConfigError(f"unknown effect '{effect}'", hint=_nearest(effect, table))
    sizes = table[effect]
    for name, value in parameters.items():
        if name not in sizes:
            raise ConfigError(
                f"effect '{effect}' has no parameter '{name}'", hint=_nearest(name, sizes)
            )
        unit, low, high, _ = sizes[name]
        if not low <= value <= high:
            raise ConfigError(
                f"effect '{effect}': {name} has to lie in {low:g} .. {high:g}"
                f"{'' if unit == '-' else f' {unit}'}, found {value:g}"
            )


def _nearest(name: str, known: Iterable[str]) -> str:
    return did_you_mean(name, sorted(known), "Known are", cutoff=0.5)


@dataclass(frozen=True)
class Unmodelled:
    """One effect with its parameters; one left out is neutral.

    `windows` are (start, stop) in s of the log, for `unlogged_switch` alone.

    Raises `ConfigError` for an unknown effect or parameter, and for a size out of range.
    """

    id: str
    parameters: Mapping[str, float] = field(default_factory=dict)
    windows: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        check_sizes(self.id, self.parameters)
        if self.windows and self.id != "unlogged_switch":
            raise ConfigError(f"effect '{self.id}' has no windows; unlogged_switch has")
        if any(not start < stop for start, stop in self.windows):
            raise ConfigError(f"effect '{self.id}': a window has to start before it stops")

    def value(self, name: str) -> float:
        """Value of the parameter, neutral where it was left out."""
        return float(self.parameters.get(name, PARAMETERS[self.id][name].neutral))


@dataclass(frozen=True)
class EngineSettings:
    """Everything of an engine that an effect can change.

    `accel_margin` multiplies the margins of the acceleration schedule. `bleed` is added to the
    customer bleed wherever ECS, NAI or WAI is on. `switches` add bleed and load in their windows.
    """

    lever: LeverParameters
    valve: FuelValveParameters
    ratings: Ratings
    body: Body
    health: Health
    accel_margin: float = 1.0
    bleed: float = 0.0
    switches: tuple[Unmodelled, ...] = ()


def _given(_: float, size: float) -> float:
    return size


def _lost(nominal: float, percent: float) -> float:
    return nominal * (1.0 - 0.01 * percent)


# Effect -> (place in the settings, its new value by the one before and the parameter, parameter).
_CHANGES: Final[Mapping[str, Sequence[tuple[str, Callable[[float, float], float], str]]]] = {
    "throttle_backlash": [("lever.backlash_deg", _given, "width_deg")],
    "throttle_delay": [("lever.delay_s", _given, "delay_s")],
    "throttle_rate_limit": [("lever.rate_limit_degps", _given, "rate_degps")],
    "throttle_bias": [("lever.bias_deg", _given, "bias_deg")],
    "actuator_lag": [("valve.servo_tau_s", add, "tau_s"), ("valve.slew_kgps2", mul, "slew")],
    "spool_lag": [("body.inertia1_J", mul, "factor"), ("body.inertia2_J", mul, "factor")],
    "spool_coupling": [("body.inertia1_J", mul, "factor")],  # the low-pressure spool alone
    "accel_decel_asymmetry": [("body.asymmetry", mul, "ratio")],
    "accel_limit": [("accel_margin", mul, "factor")],
    "altitude_lag": [("body.thin_air", add, "exponent")],
    "heat_soak": [("body.metal_WpK", mul, "factor"), ("body.clearance_pK", mul, "factor")],
    "bleed_extraction": [("bleed", add, "share")],
    "deterioration": [
        (f"health.{name}", _lost, f"{name}_pct")
        for name in ("hpc_efficiency", "hpt_efficiency", "hpc_flow")
    ],
    "temperature_effect": [("ratings.temperature_bias_pct_per_C", add, "N1_pct_per_C")],
    "idle_schedule": [("ratings.approach_idle_pct", add, "shift_pct")],
}


def with_effects(settings: EngineSettings, effects: Sequence[Unmodelled]) -> EngineSettings:
    """Apply `effects` to the settings of an engine."""
    for effect in effects:
        for place, change, parameter in _CHANGES.get(effect.id, ()):
            settings = _changed(settings, place, change, effect.value(parameter))
    switches = tuple(effect for effect in effects if effect.id == "unlogged_switch")
    return replace(settings, switches=switches)


def _changed(
    settings: EngineSettings, place: str, change: Callable[[float, float], float], size: float
) -> EngineSettings:
    part, _, name = place.rpartition(".")
    own: Any = getattr(settings, part) if part else settings
    new = {name: change(getattr(own, name), size)}
    replaced: Callable[..., Any] = getattr(own, "_replace", partial(replace, own))
    changed: Any = replaced(**new)
    found: EngineSettings = replace(settings, **{part: changed}) if part else changed
    return found
