"""Effects of the library that sit in a sensor: what they are, their parameters, their bounds.

They act on one channel of one engine's recording, behind the engine. What an engine's own probe
does (its lag depends on the mass flow) belongs to the engine.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from narxcal.channels import CHANNELS

# Effect -> parameter -> (unit, low, high, neutral). "-" as unit of the channel is written "ch".
PARAMETERS: dict[str, dict[str, tuple[str, float, float, float]]] = {
    # FACTS A3: probes have 0.5 to 1.5 s at take-off and 2 to 5 s at idle and altitude.
    "sensor_lag": {"tau_s": ("s", 0.0, 20.0, 0.0)},
    "sensor_bias": {"offset": ("ch", -1000.0, 1000.0, 0.0)},
    "sensor_drift": {"rate_per_h": ("ch/h", -5000.0, 5000.0, 0.0)},
    # GAP section 3: words of a recorder's frame are sampled up to 1 s apart.
    "time_skew": {"skew_s": ("s", -2.0, 2.0, 0.0)},
    # `tau_s` at `reference_kgph`; a reference of 0 means at every flow.
    "flowmeter_dynamics": {
        "tau_s": ("s", 0.0, 10.0, 0.0),
        "reference_kgph": ("kg/h", 0.0, 20000.0, 0.0),
    },
}
WINDOWED = ("sensor_bias", "sensor_drift")
SENSOR_EFFECTS = tuple(PARAMETERS)


def channels_of(effect: str) -> tuple[str, ...]:
    """Channels on which a sensor effect may sit."""
    if effect == "flowmeter_dynamics":
        return ("FF_kgph",)
    roles = {"lever", "ambient", "output"} | ({"switch"} if effect == "time_skew" else set())
    return tuple(name for name, each in CHANNELS.items() if each.role in roles)


@dataclass(frozen=True)
class SensorFault:
    """An effect of a size on a channel, in the windows (s) only where there are any."""

    id: str
    channel: str
    parameters: Mapping[str, float]
    windows_s: tuple[tuple[float, float], ...] = field(default=())

    def __getitem__(self, parameter: str) -> float:
        """Size of a parameter; the neutral one where it was not given."""
        return self.parameters.get(parameter, PARAMETERS[self.id][parameter][3])
