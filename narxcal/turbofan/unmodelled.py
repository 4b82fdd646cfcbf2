"""What can be wrong with a virtual engine that its steady-state model and its logs do not tell.

Each effect of the library that has a physical place in the engine sits there: in the lever, the
fuel valve, the control's schedules, the rotors, the gas path or the metal. Ids are those of the
effect library; sizes are the engine's own, not those of the forms that the diagnosis fits.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from narxcal.errors import ConfigError
from narxcal.turbofan.fuel_valve import FuelValveParameters
from narxcal.turbofan.lever import LeverParameters
from narxcal.turbofan.ratings import Ratings
from narxcal.turbofan.stations import Health
from narxcal.turbofan.transient import Body


class Size(NamedTuple):
    """Range of a parameter, and the value at which the effect is not there."""

    unit: str
    low: float
    high: float
    neutral: float


PARAMETERS: dict[str, dict[str, Size]] = {
    "throttle_backlash": {"width_deg": Size("deg", 0.0, 10.0, 0.0)},
    "throttle_delay": {"delay_s": Size("s", 0.0, 3.0, 0.0)},
    "throttle_rate_limit": {"rate_degps": Size("deg/s", 1.0, 400.0, 400.0)},
    "throttle_bias": {"bias_deg": Size("deg", -10.0, 10.0, 0.0)},
    "actuator_lag": {"tau_s": Size("s", 0.0, 5.0, 0.0), "slew": Size("-", 0.02, 1.0, 1.0)},
    "spool_lag": {"factor": Size("-", 0.3, 4.0, 1.0)},
    "spool_coupling": {"factor": Size("-", 0.3, 4.0, 1.0)},
    "accel_decel_asymmetry": {"ratio": Size("-", 0.3, 4.0, 1.0)},
    "accel_limit": {"factor": Size("-", 0.1, 2.0, 1.0)},
    "altitude_lag": {"exponent": Size("-", -1.0, 2.0, 0.0)},
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
        known = PARAMETERS.get(self.id)
        if known is None:
            raise ConfigError(f"unknown effect '{self.id}'", hint=_nearest(self.id, PARAMETERS))
        for name, value in self.parameters.items():
            if name not in known:
                raise ConfigError(
                    f"effect '{self.id}' has no parameter '{name}'", hint=_nearest(name, known)
                )
            size = known[name]
            if not size.low <= value <= size.high:
                raise ConfigError(
                    f"effect '{self.id}': {name} has to be within {size.low:g} .. {size.high:g} "
                    f"{size.unit}, found {value:g}"
                )
        if self.windows and self.id != "unlogged_switch":
            raise ConfigError(f"effect '{self.id}' has no windows; unlogged_switch has")
        if any(not start < stop for start, stop in self.windows):
            raise ConfigError(f"effect '{self.id}': a window has to start before it stops")

    def value(self, name: str) -> float:
        """Value of the parameter, neutral where it was left out."""
        return float(self.parameters.get(name, PARAMETERS[self.id][name].neutral))


def _nearest(name: str, known: Mapping[str, object]) -> str:
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.4)
    return f"Did you mean '{near[0]}'?" if near else f"Known: {', '.join(known)}"


@dataclass(frozen=True)
class Fit:
    """Everything of an engine that an effect can change; `margins` multiply those of the control.

    `bleed` is added to the customer bleed wherever ECS, NAI or WAI is on.
    """

    lever: LeverParameters
    valve: FuelValveParameters
    ratings: Ratings
    body: Body
    health: Health
    accel_margin: float = 1.0
    bleed: float = 0.0
    switches: tuple[Unmodelled, ...] = ()


def fitted_with(fit: Fit, effects: Sequence[Unmodelled]) -> Fit:
    """`fit` with every one of `effects` in its place."""
    for effect in effects:
        fit = _PLACES[effect.id](fit, effect)
    return fit


def _lever(fit: Fit, effect: Unmodelled) -> Fit:
    key = {
        "throttle_backlash": ("backlash_deg", "width_deg"),
        "throttle_delay": ("delay_s", "delay_s"),
        "throttle_rate_limit": ("rate_limit_degps", "rate_degps"),
        "throttle_bias": ("bias_deg", "bias_deg"),
    }
    to, source = key[effect.id]
    return replace(fit, lever=fit.lever._replace(**{to: effect.value(source)}))


def _actuator(fit: Fit, effect: Unmodelled) -> Fit:
    valve = fit.valve._replace(
        servo_tau_s=fit.valve.servo_tau_s + effect.value("tau_s"),
        slew_kgps2=fit.valve.slew_kgps2 * effect.value("slew"),
    )
    return replace(fit, valve=valve)


def _inertia(fit: Fit, effect: Unmodelled) -> Fit:
    """Both spools heavier, or the low-pressure spool alone, which then trails the other."""
    body, factor = fit.body, effect.value("factor")
    second = body.inertia2_J * (factor if effect.id == "spool_lag" else 1.0)
    body = body._replace(inertia1_J=body.inertia1_J * factor, inertia2_J=second)
    return replace(fit, body=body)


def _asymmetry(fit: Fit, effect: Unmodelled) -> Fit:
    ratio = fit.body.asymmetry * effect.value("ratio")
    return replace(fit, body=fit.body._replace(asymmetry=ratio))


def _accel_limit(fit: Fit, effect: Unmodelled) -> Fit:
    return replace(fit, accel_margin=fit.accel_margin * effect.value("factor"))


def _thin_air(fit: Fit, effect: Unmodelled) -> Fit:
    exponent = fit.body.thin_air + effect.value("exponent")
    return replace(fit, body=fit.body._replace(thin_air=exponent))


def _soak(fit: Fit, effect: Unmodelled) -> Fit:
    factor, body = effect.value("factor"), fit.body
    body = body._replace(metal_WpK=body.metal_WpK * factor, clearance_pK=body.clearance_pK * factor)
    return replace(fit, body=body)


def _bleed(fit: Fit, effect: Unmodelled) -> Fit:
    return replace(fit, bleed=fit.bleed + effect.value("share"))


def _switch(fit: Fit, effect: Unmodelled) -> Fit:
    return replace(fit, switches=(*fit.switches, effect))


def _deterioration(fit: Fit, effect: Unmodelled) -> Fit:
    """A loss is positive, in percent of the part's efficiency or flow."""
    h = fit.health
    h = h._replace(
        hpc_efficiency=h.hpc_efficiency * (1.0 - 0.01 * effect.value("hpc_efficiency_pct")),
        hpt_efficiency=h.hpt_efficiency * (1.0 - 0.01 * effect.value("hpt_efficiency_pct")),
        hpc_flow=h.hpc_flow * (1.0 - 0.01 * effect.value("hpc_flow_pct")),
    )
    return replace(fit, health=h)


def _temperature(fit: Fit, effect: Unmodelled) -> Fit:
    bias = fit.ratings.temperature_bias_pct_per_C + effect.value("N1_pct_per_C")
    return replace(fit, ratings=replace(fit.ratings, temperature_bias_pct_per_C=bias))


def _idle(fit: Fit, effect: Unmodelled) -> Fit:
    idle = fit.ratings.approach_idle_pct + effect.value("shift_pct")
    return replace(fit, ratings=replace(fit.ratings, approach_idle_pct=idle))


_PLACES = {
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
    "heat_soak": _soak,
    "bleed_extraction": _bleed,
    "unlogged_switch": _switch,
    "deterioration": _deterioration,
    "temperature_effect": _temperature,
    "idle_schedule": _idle,
}
