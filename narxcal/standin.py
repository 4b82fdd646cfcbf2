"""Stand-in engine: a small two-spool surrogate until the virtual flight test exists.

It has the *kinds* of behaviour that narxcal has to identify (a scheduled governor, asymmetric
fuel limits, spool lags that depend on power and altitude, temperature overshoot behind a slow
probe), at magnitudes from FACTS, part A. It is no model of any engine: use it to try the
commands and to test, never to draw conclusions.

Everything runs in corrected parameters: `theta` and `delta` are total temperature and pressure
over their sea-level standards, speeds are divided by `sqrt(theta)`, fuel by
`delta * sqrt(theta)`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from narxcal.atmosphere import air_state

FloatArray = NDArray[np.float64]

INPUT_NAMES = ("TRA_deg", "ALT_ft", "Mach", "dT_C", "WOW", "Approach", "ECS", "NAI", "WAI")
OUTPUT_NAMES = ("N1_pct", "N2_pct", "EGT_C", "FF_kgph")
TRA_MAX_DEG = 85.0


@dataclass(frozen=True)
class StandInEngine:
    """The constants; `n` below is corrected N1 as a fraction of 100 %.

    Steady state: `N2c = core_offset + core_gain n**core_power`,
    `Wc = fuel_offset + fuel_gain n**fuel_power`.
    """

    idle_ground: float = 0.22
    idle_flight: float = 0.28
    idle_approach: float = 0.36
    n_max: float = 1.0
    core_offset: float = 0.38
    core_gain: float = 0.62
    core_power: float = 0.75
    fuel_offset: float = 190.0
    fuel_gain: float = 3400.0
    fuel_power: float = 2.3
    # Share of its present steady fuel that the governor may add or take away.
    accel_limit: float = 0.62
    decel_limit: float = 0.38
    governor_gain: float = 0.5
    # Open-loop time constants at sea level: idle over maximum is 2.5 (FACTS A2).
    core_tau_idle_s: float = 0.85
    fan_tau_idle_s: float = 0.55
    tau_ratio: float = 2.5
    fuel_tau_s: float = 0.15
    probe_tau_s: float = 0.70
    # Direct response of the gas temperature to fuel above its steady value (FACTS A2).
    overshoot_K: float = 300.0

    def steady_state(self, inputs: ArrayLike) -> FloatArray:
        """Where the outputs settle: `(..., 9)` in `INPUT_NAMES` -> `(..., 4)` in `OUTPUT_NAMES`.

        NaN in, NaN out.
        """
        u = np.asarray(inputs, dtype=np.float64)
        air = air_state(u[..., 1], u[..., 2], u[..., 3])
        theta, delta, root = air.theta2, air.delta2, np.sqrt(air.theta2)
        n = self._command(u)
        bleed_K, bleed_fuel = _bleeds(u)
        return np.stack(
            [
                100.0 * n * root,
                100.0 * self._core(n) * root,
                self._temperature(n) * theta + bleed_K - 273.15,
                self._fuel(n) * delta * root * bleed_fuel,
            ],
            axis=-1,
        )

    def simulate(self, inputs: Mapping[str, FloatArray], dt_s: float) -> dict[str, FloatArray]:
        """Run a whole flight from its settled first sample, without sensor noise.

        `inputs` maps `INPUT_NAMES` to `(time,)`; the result maps `OUTPUT_NAMES` likewise.
        """
        u = np.column_stack([inputs[name] for name in INPUT_NAMES])
        air = air_state(u[:, 1], u[:, 2], u[:, 3])
        theta, delta, root = air.theta2, air.delta2, np.sqrt(air.theta2)
        n, core, fuel = self._run(self._command(u), root / delta, dt_s)
        bleed_K, bleed_fuel = _bleeds(u)
        hot = self._temperature(n) + self.overshoot_K * (fuel / self._fuel(n) - 1.0)
        return {
            "N1_pct": 100.0 * n * root,
            "N2_pct": 100.0 * core * root,
            "EGT_C": _first_order(hot * theta + bleed_K - 273.15, self.probe_tau_s, dt_s),
            "FF_kgph": fuel * delta * root * bleed_fuel,
        }

    def _run(self, command: FloatArray, altitude_factor: FloatArray, dt_s: float) -> FloatArray:
        """Integrate corrected N1, N2 and fuel, `(3, time)`, with explicit Euler steps."""
        states = np.empty((3, len(command)))
        n = float(command[0])
        core, fuel = float(self._core(n)), float(self._fuel(n))
        rows = zip(command.tolist(), altitude_factor.tolist(), strict=True)
        for k, (target, factor) in enumerate(rows):
            states[:, k] = n, core, fuel
            n_rate, core_rate, fuel_rate = self._rates((n, core, fuel), target, factor)
            n += dt_s * n_rate
            core += dt_s * core_rate
            fuel += dt_s * fuel_rate
        return states

    def _rates(
        self, state: tuple[float, float, float], target: float, altitude_factor: float
    ) -> tuple[float, float, float]:
        """Time derivatives of corrected N1, N2 and fuel."""
        n, core, fuel = state
        running = self.fuel_offset + self.fuel_gain * n**self.fuel_power
        wanted = self.fuel_offset + self.fuel_gain * target**self.fuel_power
        wanted += self.governor_gain * self.fuel_gain * (target - n)
        allowed = min(
            max(wanted, running * (1.0 - self.decel_limit)), running * (1.0 + self.accel_limit)
        )
        # The speed that this fuel, and this core, would hold.
        fuel_n = (max(fuel - self.fuel_offset, 1.0) / self.fuel_gain) ** (1.0 / self.fuel_power)
        core_n = (max(core - self.core_offset, 0.01) / self.core_gain) ** (1.0 / self.core_power)
        fuel_core = self.core_offset + self.core_gain * fuel_n**self.core_power
        lag = self._lag(n, altitude_factor)
        return (
            (core_n - n) / (self.fan_tau_idle_s * lag),
            (fuel_core - core) / (self.core_tau_idle_s * lag),
            (allowed - fuel) / self.fuel_tau_s,
        )

    def _lag(self, n: float, altitude_factor: float) -> float:
        """Time constant over its idle value at sea level.

        `tau ~ sqrt(theta) / delta` (NACA TR-1011), bent so that 35 000 ft doubles it at idle
        and takes it to 3.5 times at maximum power (FACTS A2).
        """
        power = (n - self.idle_ground) / (self.n_max - self.idle_ground)
        return math.exp(
            -math.log(self.tau_ratio) * power + math.log(altitude_factor) * (0.75 + 0.55 * power)
        )

    def _command(self, u: FloatArray) -> FloatArray:
        """Corrected N1 that the governor holds; anti-ice lowers it (FACTS A5)."""
        lever, ground, approach = u[..., 0], u[..., 4] > 0.5, u[..., 5] > 0.5
        idle = np.where(approach, self.idle_approach, self.idle_flight)
        idle = np.where(ground, self.idle_ground, idle)
        x = np.clip(lever / TRA_MAX_DEG, 0.0, 1.0)
        anti_ice = 0.007 * x * (u[..., 7] + u[..., 8])
        return np.asarray(idle + (self.n_max - idle) * x**1.15 - anti_ice)

    def _core(self, n: ArrayLike) -> FloatArray:
        return self.core_offset + self.core_gain * np.asarray(n) ** self.core_power

    def _fuel(self, n: ArrayLike) -> FloatArray:
        return self.fuel_offset + self.fuel_gain * np.asarray(n) ** self.fuel_power

    def _temperature(self, n: ArrayLike) -> FloatArray:
        """Corrected exhaust temperature in K: warm at idle, a shallow minimum, hot at maximum."""
        n = np.asarray(n)
        return 600.0 + 520.0 * n**2 + 150.0 * (1.0 - n) ** 4


def maker_model(inputs: ArrayLike) -> FloatArray:
    """Give settled N1, N2 and EGT at `INPUT_NAMES`, as a configuration names the function.

    This is what a maker would hand over: `(..., 9)` -> `(..., 3)`, and not a word on the way
    there.
    """
    return StandInEngine().steady_state(inputs)[..., :3]


def _bleeds(u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Temperature that bleeds add (K) and factor they put on fuel, about FACTS A5."""
    ecs, nai, wai = u[..., 6], u[..., 7], u[..., 8]
    return 5.0 * ecs + 12.0 * nai + 8.0 * wai, 1.0 + 0.004 * ecs + 0.006 * nai + 0.008 * wai


def _first_order(values: FloatArray, tau_s: float, dt_s: float) -> FloatArray:
    share = -math.expm1(-dt_s / tau_s)
    state, lagged = float(values[0]), []
    for value in values.tolist():
        state += share * (value - state)
        lagged.append(state)
    return np.array(lagged)
