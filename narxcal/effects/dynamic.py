"""Effects on how fast the engine moves; where it settles does not change."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import numpy as np

from narxcal.effects.base import (
    FloatArray,
    OutputEffect,
    Parameter,
    RateEffect,
    Run,
    Side,
    Signals,
)
from narxcal.effects.memory import Lag

SPEEDS = ("N1_pct", "N2_pct")
UNLIMITED_PCTPS = 80.0  # faster than any spool


def _speeds(signals: Signals) -> list[int]:
    return [signals.y(name) for name in SPEEDS if name in signals.outputs]


class _Spools(RateEffect):
    """An effect on the rates of the spool speeds."""

    side: ClassVar[Side] = "process"
    family: ClassVar[str] = "transit"

    def applies(self, signals: Signals) -> bool:
        """Wherever there is a spool speed."""
        return any(name in signals.outputs for name in SPEEDS)

    def on_rate(self, run: Run, rate: FloatArray, air: FloatArray) -> FloatArray:
        """Rates with those of the spools changed; the other outputs move as they did."""
        speeds, changed = _speeds(run.signals), rate.copy()
        changed[:, speeds] = self.spool_rate(run, rate[:, speeds], air)
        return changed

    @abstractmethod
    def spool_rate(self, run: Run, rate: FloatArray, air: FloatArray) -> FloatArray:
        """Rates (batch, speeds) of the spools, in %/s."""


class SpoolLag(_Spools):
    """All time constants of the spools are `factor` times as long."""

    id: ClassVar[str] = "spool_lag"
    meaning: ClassVar[str] = "time constants of both spools scaled"
    manoeuvre: ClassVar[str] = "steps of three sizes, both ways: its transit time is independent"
    fixed = (Parameter("factor", "-", 0.4, 4.0, 1.0, (0.8, 1.3, 2.0)),)

    def spool_rate(self, run: Run, rate: FloatArray, air: FloatArray) -> FloatArray:  # noqa: ARG002 - the same in any air
        """`1 / factor` of the rate."""
        return rate / run.theta[:, :1]


class SpoolCoupling(_Spools):
    """The low-pressure spool alone is `factor` times as slow: it trails the other differently."""

    id: ClassVar[str] = "spool_coupling"
    meaning: ClassVar[str] = "low-pressure spool follows the high-pressure spool differently"
    manoeuvre: ClassVar[str] = "fast steps: N1 against N2 in the transit, up and down"
    fixed = (Parameter("factor", "-", 0.4, 4.0, 1.0, (0.8, 1.3, 2.0)),)

    def applies(self, signals: Signals) -> bool:
        """Where both spool speeds are known."""
        return all(name in signals.outputs for name in SPEEDS)

    def spool_rate(self, run: Run, rate: FloatArray, air: FloatArray) -> FloatArray:  # noqa: ARG002 - the same in any air
        """`1 / factor` of the rate of N1; N2 as it was."""
        changed = rate.copy()
        changed[:, 0] /= run.theta[:, 0]
        return changed


class AccelDecelAsymmetry(_Spools):
    """Time constants are `ratio` times as long while the spools speed up."""

    id: ClassVar[str] = "accel_decel_asymmetry"
    meaning: ClassVar[str] = "pushes slower (or faster) than pulls"
    manoeuvre: ClassVar[str] = "pushes and pulls of one size, at low and at high altitude"
    fixed = (Parameter("ratio", "-", 0.4, 4.0, 1.0, (0.8, 1.3, 2.0)),)

    def spool_rate(self, run: Run, rate: FloatArray, air: FloatArray) -> FloatArray:  # noqa: ARG002 - the same in any air
        """`1 / ratio` of every rising rate."""
        return np.where(rate > 0.0, rate / run.theta[:, :1], rate)


class AccelLimit(RateEffect):
    """No spool speeds up faster than `limit_pctps`, in the thick air of sea level.

    The limit goes with `delta / sqrt(theta)`, as the power that drives the spools does. What limits
    is the fuel, so where it binds all outputs are held back alike: the engine passes through the
    same states, later.
    """

    id: ClassVar[str] = "accel_limit"
    family: ClassVar[str] = "transit"
    side: ClassVar[Side] = "process"
    meaning: ClassVar[str] = "acceleration limited by the control"
    manoeuvre: ClassVar[str] = "slams of three sizes: only the large ones are slower"
    fixed = (
        Parameter("limit_pctps", "%/s", 0.5, UNLIMITED_PCTPS, UNLIMITED_PCTPS, (25.0, 12.0, 6.0)),
    )

    def applies(self, signals: Signals) -> bool:
        """Wherever there is a spool speed."""
        return any(name in signals.outputs for name in SPEEDS)

    def on_rate(self, run: Run, rate: FloatArray, air: FloatArray) -> FloatArray:
        """Rates scaled down so that the fastest spool's is at the limit; none at the neutral."""
        limit = np.where(run.theta[:, :1] < UNLIMITED_PCTPS, run.theta[:, :1] * air, np.inf)
        fastest = rate[:, _speeds(run.signals)].max(axis=1, keepdims=True)
        return np.asarray(rate * np.minimum(limit / np.maximum(fastest, 1e-9), 1.0))


class AltitudeLag(_Spools):
    """Time constants go with air density by an `exponent` more than the simulator has it.

    `tau ~ (sqrt(theta) / delta)^exponent` (NACA TR-1011, FACTS A2).
    """

    id: ClassVar[str] = "altitude_lag"
    meaning: ClassVar[str] = "time constants grow with altitude"
    manoeuvre: ClassVar[str] = "the same slam at low and at high altitude"
    fixed = (Parameter("exponent", "-", -1.5, 2.0, 0.0, (-0.3, 0.3, 0.8)),)

    def applies(self, signals: Signals) -> bool:
        """Where the altitude changes."""
        return super().applies(signals) and "ALT_ft" in signals.active

    def spool_rate(self, run: Run, rate: FloatArray, air: FloatArray) -> FloatArray:
        """Rates scaled by the power of what the air is."""
        return rate * air ** run.theta[:, :1]


class ActuatorLag(OutputEffect):
    """A further lag of `tau_s` between the control and the fuel that burns.

    A lag in series with an engine may as well stand behind it as long as the engine does not
    change much within `tau_s`: all outputs follow the simulator's with the one lag. What the
    control does about it (some overshoot) is left out.
    """

    id: ClassVar[str] = "actuator_lag"
    family: ClassVar[str] = "initiation"
    side: ClassVar[Side] = "process"
    meaning: ClassVar[str] = "lag of the fuel metering valve"
    manoeuvre: ClassVar[str] = "fast small steps: a lag bends the start, a delay only shifts it"
    fixed = (Parameter("tau_s", "s", 0.0, 3.0, 0.0, (0.1, 0.3, 0.8)),)

    def on_output(self, run: Run, y: FloatArray) -> FloatArray:
        """All outputs behind one and the same lag."""
        tau_s = run.theta[:, 0]
        columns = [
            run.memory.setdefault(f"lag {j}", Lag(tau_s, run.signals.dt_s))(y[..., j])
            for j in range(y.shape[-1])
        ]
        return np.stack(columns, axis=-1)
