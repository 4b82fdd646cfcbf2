"""Effects that a virtual engine may have and its steady-state model and logs do not show.

Each effect of the library that has a physical place in the engine is put there: in the lever, the
fuel valve, the control's schedules, the rotors, the gas path or the metal. Blind cases of the
diagnosis fly this engine, so its effects share no equation with `narxcal.effects` or
`narxcal.lumped`: only the ids and the ranges of parameters that both have come from the library.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from narxcal.effects import LIBRARY
from narxcal.support.errors import ConfigError, did_you_mean
from narxcal.turbofan.cycle import Health
from narxcal.turbofan.fadec import FuelValveParameters
from narxcal.turbofan.lever import LeverParameters
from narxcal.turbofan.ratings import Ratings
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


def with_effects(settings: EngineSettings, effects: Sequence[Unmodelled]) -> EngineSettings:
    """Apply `effects` to the settings of an engine."""
    for effect in effects:
        settings = _APPLY[effect.id](settings, effect)
    return settings


def _lever(settings: EngineSettings, effect: Unmodelled) -> EngineSettings:
    field_, parameter = {
        "throttle_backlash": ("backlash_deg", "width_deg"),
        "throttle_delay": ("delay_s", "delay_s"),
        "throttle_rate_limit": ("rate_limit_degps", "rate_degps"),
        "throttle_bias": ("bias_deg", "bias_deg"),
    }[effect.id]
    return replace(settings, lever=settings.lever._replace(**{field_: effect.value(parameter)}))


def _actuator(settings: EngineSettings, effect: Unmodelled) -> EngineSettings:
    valve = settings.valve._replace(
        servo_tau_s=settings.valve.servo_tau_s + effect.value("tau_s"),
        slew_kgps2=settings.valve.slew_kgps2 * effect.value("slew"),
    )
    return replace(settings, valve=valve)


def _inertia(settings: EngineSettings, effect: Unmodelled) -> EngineSettings:
    """Scale the inertia of both spools, or of the low-pressure spool alone (spool_coupling)."""
    body, factor = settings.body, effect.value("factor")
    second = body.inertia2_J * (factor if effect.id == "spool_lag" else 1.0)
    body = body._replace(inertia1_J=body.inertia1_J * factor, inertia2_J=second)
    return replace(settings, body=body)


def _asymmetry(settings: EngineSettings, effect: Unmodelled) -> EngineSettings:
    ratio = settings.body.asymmetry * effect.value("ratio")
    return replace(settings, body=settings.body._replace(asymmetry=ratio))


def _accel_limit(settings: EngineSettings, effect: Unmodelled) -> EngineSettings:
    return replace(settings, accel_margin=settings.accel_margin * effect.value("factor"))


def _thin_air(settings: EngineSettings, effect: Unmodelled) -> EngineSettings:
    exponent = settings.body.thin_air + effect.value("exponent")
    return replace(settings, body=settings.body._replace(thin_air=exponent))


def _heat_soak(settings: EngineSettings, effect: Unmodelled) -> EngineSettings:
    factor, body = effect.value("factor"), settings.body
    body = body._replace(metal_WpK=body.metal_WpK * factor, clearance_pK=body.clearance_pK * factor)
    return replace(settings, body=body)


def _bleed(settings: EngineSettings, effect: Unmodelled) -> EngineSettings:
    return replace(settings, bleed=settings.bleed + effect.value("share"))


def _switch(settings: EngineSettings, effect: Unmodelled) -> EngineSettings:
    return replace(settings, switches=(*settings.switches, effect))


def _deterioration(settings: EngineSettings, effect: Unmodelled) -> EngineSettings:
    """A loss is positive, in percent of the component's efficiency or flow."""
    h = settings.health
    h = h._replace(
        hpc_efficiency=h.hpc_efficiency * (1.0 - 0.01 * effect.value("hpc_efficiency_pct")),
        hpt_efficiency=h.hpt_efficiency * (1.0 - 0.01 * effect.value("hpt_efficiency_pct")),
        hpc_flow=h.hpc_flow * (1.0 - 0.01 * effect.value("hpc_flow_pct")),
    )
    return replace(settings, health=h)


def _temperature(settings: EngineSettings, effect: Unmodelled) -> EngineSettings:
    bias = settings.ratings.temperature_bias_pct_per_C + effect.value("N1_pct_per_C")
    return replace(settings, ratings=replace(settings.ratings, temperature_bias_pct_per_C=bias))


def _idle(settings: EngineSettings, effect: Unmodelled) -> EngineSettings:
    idle = settings.ratings.approach_idle_pct + effect.value("shift_pct")
    return replace(settings, ratings=replace(settings.ratings, approach_idle_pct=idle))


_APPLY = {
    "throttle_backlash": _lever,
    "throttle_delay": _lever,
    "throttle_rate_limit": _lever,
    "throttle_bias": _lever,
    "actuator_lag": _actuator,
    "spool_lag": _inertia,
    "spool_coupling": _inertia,
    "accel_decel_asymmetry": _asymmetry,
    "accel_limit": _accel_limit,
    "altitude_lag": _thin_air,
    "heat_soak": _heat_soak,
    "bleed_extraction": _bleed,
    "unlogged_switch": _switch,
    "deterioration": _deterioration,
    "temperature_effect": _temperature,
    "idle_schedule": _idle,
}
