"""From the fuel that the FADEC demands to the fuel that heats the gas.

In series: the metering valve, a lag whose rate is limited; an optional second lag of its
servo; the transport delay of the lines; and the lag of vaporising, burning and filling the
combustor's volume. The defaults are AGTF30's (FACTS A6: 0.1 s, 40 ms); its slew of 2.25 pps/s
spans 0 to 2.5 pps in about a second, so set `slew_kgps2` to about the engine's largest fuel flow.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from narxcal.support.arrays import FloatArray
from narxcal.support.compiled import compiled, lagged, ramp_lagged, slewed
from narxcal.support.errors import ConfigError

# Where the state keeps what; the samples of the line follow from LINE on, as a ring.
SERVO, METERED, ARRIVING, BURNED, NEWEST, LINE = 0, 1, 2, 3, 4, 5


class FuelValveParameters(NamedTuple):
    """Time constants and limits; zero means none of it, an infinite slew no limit.

    The effect `actuator_lag` is `servo_tau_s` (a further lag in front of the valve), a larger
    `tau_s`, or a smaller `slew_kgps2`.
    """

    tau_s: float = 0.1
    slew_kgps2: float = math.inf
    delay_s: float = 0.04
    volume_tau_s: float = 0.02
    servo_tau_s: float = 0.0


def settled(parameters: FuelValveParameters, fuel_kgps: float, dt_s: float) -> FloatArray:
    """State of a valve through which `fuel_kgps` has long been flowing, for steps of `dt_s`.

    Raises `ConfigError` if a time is negative or not finite, or the slew not above zero.
    """
    for name in ("tau_s", "delay_s", "volume_tau_s", "servo_tau_s"):
        value = getattr(parameters, name)
        if not (value >= 0.0 and math.isfinite(value)):
            raise ConfigError(f"fuel valve: '{name}' has to be zero or more, found {value}")
    if not parameters.slew_kgps2 > 0.0:
        raise ConfigError(
            f"fuel valve: 'slew_kgps2' has to be above zero, found {parameters.slew_kgps2}",
            hint="Use infinity for no limit",
        )
    if not (dt_s > 0.0 and math.isfinite(dt_s)):
        raise ConfigError(f"fuel valve: the step has to be above zero, found {dt_s} s")
    state = np.full(LINE + math.floor(parameters.delay_s / dt_s) + 2, float(fuel_kgps))
    state[NEWEST] = 0.0
    return state


@compiled
def step(
    parameters: FuelValveParameters, state: FloatArray, demand_kgps: float, dt_s: float
) -> float:
    """Advance `state` by `dt_s` at a constant demand; return the fuel burned at its end, kg/s.

    `state` comes from `settled` for the same `dt_s`, and afterwards `state[METERED]` is the flow
    through the valve, which is what a flowmeter feels. Lag and slew are exact; the line between
    two samples of the metered flow is straight, and so is what the volume's lag is fed.
    """
    before = state[SERVO]
    state[SERVO] = lagged(before, demand_kgps, parameters.servo_tau_s, dt_s)
    limits = (parameters.tau_s, parameters.slew_kgps2)
    state[METERED] = slewed(state[METERED], state[SERVO], limits, dt_s)
    arriving = _transported(state, parameters.delay_s / dt_s)
    ends = (state[ARRIVING], arriving)
    state[BURNED] = ramp_lagged(state[BURNED], ends, parameters.volume_tau_s, dt_s)
    state[ARRIVING] = arriving
    return float(state[BURNED])


@compiled
def _transported(state: FloatArray, steps: float) -> float:
    """Put the metered flow into the line and take out what entered it `steps` ago."""
    length = len(state) - LINE
    newest = (int(state[NEWEST]) + 1) % length
    state[NEWEST] = newest
    state[LINE + newest] = state[METERED]
    whole = int(steps)
    share = steps - whole
    young = state[LINE + (newest - whole) % length]
    old = state[LINE + (newest - whole - 1) % length]
    return float(young + share * (old - young))
