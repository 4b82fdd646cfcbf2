"""The effects that cases are made of: one size each, and the parameters that go with it.

Those in an engine act in the physics of the virtual engine, those of a sensor in its measurement
chain: neither is a form that the diagnosis fits.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from narxcal.effects.library import LIBRARY
from narxcal.flight_test.sensors import SENSOR_EFFECTS, SensorFault
from narxcal.turbofan import Unmodelled

Windows = tuple[tuple[float, float], ...]
# Fuel flow (kg/h) at which the flow meter's time constant holds, about half of take-off.
_METER_KGPH: Final = {"single_aisle": 2000.0}
_SMALL_KGPH: Final = 300.0


class Scale(NamedTuple):
    """One effect by one size: each parameter is `neutral + factor * size`.

    `first` is the size to try first, `most` the largest, in the unit of the first parameter;
    `signed` effects go both ways. `inverse` is a limit that gets narrower as the size grows.
    """

    id: str
    factors: Mapping[str, float]
    first: float
    most: float
    channel: str | None = None
    neutral: float = 0.0
    signed: bool = False
    inverse: bool = False

    @property
    def name(self) -> str:
        """`id`, or `id:channel`."""
        return self.id if self.channel is None else f"{self.id}:{self.channel}"

    @property
    def family(self) -> str:
        """The group of effects that are easily taken for each other."""
        return LIBRARY[self.id].family

    def parameters(self, size: float) -> dict[str, float]:
        """Parameters of the effect at a size."""
        if self.inverse:
            return {name: factor / size for name, factor in self.factors.items()}
        return {name: self.neutral + factor * size for name, factor in self.factors.items()}


CATALOGUE: Final = (
    Scale("throttle_backlash", {"width_deg": 1.0}, 1.0, 8.0),
    Scale("throttle_delay", {"delay_s": 1.0}, 0.15, 2.0),
    # The size is the time that 10 degrees take.
    Scale("throttle_rate_limit", {"rate_degps": 10.0}, 1.0, 6.0, inverse=True),
    Scale("throttle_bias", {"bias_deg": 1.0}, 0.7, 6.0, signed=True),
    Scale("actuator_lag", {"tau_s": 1.0}, 0.3, 3.0),
    Scale("spool_lag", {"factor": 1.0}, 0.25, 2.5, neutral=1.0),
    Scale("accel_decel_asymmetry", {"ratio": 1.0}, 0.3, 2.5, neutral=1.0),
    Scale("accel_limit", {"factor": -1.0}, 0.3, 0.8, neutral=1.0),
    Scale("altitude_lag", {"exponent": 1.0}, 0.4, 1.9),
    Scale("spool_coupling", {"factor": 1.0}, 0.3, 2.5, neutral=1.0),
    Scale("heat_soak", {"factor": 1.0}, 1.0, 4.0, neutral=1.0),
    Scale("bleed_extraction", {"share": 1.0}, 0.01, 0.12),
    Scale("unlogged_switch", {"bleed": 1.0}, 0.015, 0.12),
    Scale("deterioration", {"hpt_efficiency_pct": 1.0, "hpc_efficiency_pct": 0.6}, 1.0, 5.0),
    Scale("temperature_effect", {"N1_pct_per_C": 1.0}, 0.05, 0.28, signed=True),
    Scale("idle_schedule", {"shift_pct": 1.0}, 2.0, 12.0),
    Scale("sensor_lag", {"tau_s": 1.0}, 0.5, 6.0, channel="EGT_C"),
    Scale("sensor_lag", {"tau_s": 1.0}, 0.3, 4.0, channel="N2_pct"),
    Scale("sensor_lag", {"tau_s": 1.0}, 0.3, 4.0, channel="N1_pct"),
    Scale("sensor_bias", {"offset": 1.0}, 6.0, 60.0, channel="EGT_C", signed=True),
    Scale("sensor_bias", {"offset": 1.0}, 0.6, 6.0, channel="N2_pct", signed=True),
    Scale("sensor_drift", {"rate_per_h": 1.0}, 80.0, 900.0, channel="EGT_C", signed=True),
    Scale("sensor_drift", {"rate_per_h": 1.0}, 8.0, 90.0, channel="N2_pct", signed=True),
    Scale("sensor_bias", {"offset": 1.0}, 0.6, 6.0, channel="N1_pct", signed=True),
    Scale("time_skew", {"skew_s": 1.0}, 0.15, 1.5, channel="N2_pct"),
    Scale("time_skew", {"skew_s": 1.0}, 0.3, 1.5, channel="EGT_C"),
    Scale("flowmeter_dynamics", {"tau_s": 1.0}, 0.4, 4.0, channel="FF_kgph"),
)


class Dose(NamedTuple):
    """An effect of a size."""

    scale: Scale
    size: float

    @property
    def parameters(self) -> dict[str, float]:
        """Parameters at this size."""
        return self.scale.parameters(self.size)

    @property
    def on_sensor(self) -> bool:
        """Whether it acts on a recording; else it acts on an engine."""
        return self.scale.id in SENSOR_EFFECTS

    def unmodelled(self, windows: Windows) -> Unmodelled:
        """Give it as an engine's effect; `windows` are those of a hidden switch."""
        own = windows if self.scale.id == "unlogged_switch" else ()
        return Unmodelled(self.scale.id, self.parameters, own)

    def row(self) -> dict[str, Any]:
        """Give it as a row of the key."""
        return {
            "id": self.scale.id,
            "channel": self.scale.channel,
            "family": self.scale.family,
            "parameters": self.parameters,
        }

    def fault(self, engine: str) -> SensorFault:
        """Give it as a sensor's fault."""
        more = {}
        if self.scale.id == "flowmeter_dynamics":
            more = {"reference_kgph": _METER_KGPH.get(engine, _SMALL_KGPH)}
        return SensorFault(self.scale.id, self.scale.channel or "", {**self.parameters, **more})
