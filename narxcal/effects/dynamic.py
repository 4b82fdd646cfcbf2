"""Effects on how fast the engine moves; where it settles does not change."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from narxcal.effects.base import (
    UNLIMITED,
    OutputEffect,
    Pace,
    Parameter,
    RateEffect,
    Run,
    Side,
    Signals,
    as_simulated,
)
from narxcal.effects.operators import lag
from narxcal.support.arrays import FloatArray

SPEEDS = ("N1_pct", "N2_pct")
FASTEST_PCTPS = 30.0  # of core speed: no control allows more
_EITHER = 0.5  # of a share that is all or nothing


class _Transit(RateEffect):
    """An effect on the rates of the rotors, or on what the control lets them do."""

    side: ClassVar[Side] = "process"
    family: ClassVar[str] = "transit"

    def applies(self, signals: Signals) -> bool:
        """Wherever there is a spool speed."""
        return any(name in signals.outputs for name in SPEEDS)


class SpoolLag(_Transit):
    """Both rotors are `factor` times as heavy: the same surplus of power moves them less.

    Under a governor the fan follows its demand where fuel allows it; core and temperature then
    overshoot more.
    """

    id: ClassVar[str] = "spool_lag"
    meaning: ClassVar[str] = "time constants of both spools scaled"
    manoeuvre: ClassVar[str] = "steps of three sizes, both ways: its transit time is independent"
    fixed = (Parameter("factor", "-", 0.4, 4.0, 1.0, (0.8, 1.3, 2.0)),)

    def pace(self, theta: FloatArray, signals: Signals) -> Pace:  # noqa: ARG002 - of any engine
        """`1 / factor` of every rate."""
        slower, same = 1.0 / theta[:, 0], as_simulated(len(theta))
        return same._replace(fan_up=slower, fan_down=slower, core_up=slower, core_down=slower)


class SpoolCoupling(_Transit):
    """The low-pressure rotor alone is `factor` times as heavy: it trails the other differently."""

    id: ClassVar[str] = "spool_coupling"
    meaning: ClassVar[str] = "low-pressure spool follows the high-pressure spool differently"
    manoeuvre: ClassVar[str] = "fast steps: N1 against N2 in the transit, up and down"
    fixed = (Parameter("factor", "-", 0.4, 4.0, 1.0, (0.8, 1.3, 2.0)),)

    def applies(self, signals: Signals) -> bool:
        """Where both spool speeds are known."""
        return all(name in signals.outputs for name in SPEEDS)

    def pace(self, theta: FloatArray, signals: Signals) -> Pace:  # noqa: ARG002 - of any engine
        """`1 / factor` of the fan's rate; the core as it was."""
        slower = 1.0 / theta[:, 0]
        return as_simulated(len(theta))._replace(fan_up=slower, fan_down=slower)


class AccelDecelAsymmetry(_Transit):
    """Pushes take `ratio` times as long, against pulls, as they do in the simulator.

    Time constants are longer while the spools speed up; or (`by_control`, 0 or 1) the control lets
    the core slow down `ratio` times as fast, where its schedule of deceleration holds.
    """

    id: ClassVar[str] = "accel_decel_asymmetry"
    meaning: ClassVar[str] = "pushes slower (or faster) than pulls"
    manoeuvre: ClassVar[str] = "pushes and pulls of one size, at low and at high altitude"
    fixed = (
        Parameter("ratio", "-", 0.4, 4.0, 1.0, (0.8, 1.3, 2.0)),
        Parameter("by_control", "-", 0.0, 1.0, 0.0, (0.0, 1.0)),
    )

    def parameters(self, signals: Signals) -> tuple[Parameter, ...]:
        """The ratio alone where fuel is the driver: no control schedules it."""
        return self.fixed if signals.governed else self.fixed[:1]

    def pace(self, theta: FloatArray, signals: Signals) -> Pace:
        """`1 / ratio` of every rising rate, or `ratio` of the limit of deceleration."""
        ratio, same = theta[:, 0], as_simulated(len(theta))
        control = theta[:, 1] >= _EITHER if signals.governed else np.zeros(len(theta), bool)
        slower = np.where(control, 1.0, 1.0 / ratio)
        return same._replace(fan_up=slower, core_up=slower, fall=np.where(control, ratio, 1.0))


class AccelLimit(_Transit):
    """The control allows `share` of the acceleration that the simulator's allows.

    The limit keeps the shape of the simulator's own over speed and air. Where that never was
    reached, it is the greatest acceleration of the logs, and goes with `delta / sqrt(theta)`. Or it
    allows no more than `most_pctps`, at any speed and altitude.
    """

    id: ClassVar[str] = "accel_limit"
    meaning: ClassVar[str] = "acceleration limited by the control"
    manoeuvre: ClassVar[str] = "slams of three sizes: only the large ones are slower"
    fixed = (
        Parameter("share", "-", 0.1, 2.0, 1.0, (0.8, 0.5, 0.3)),
        Parameter("most_pctps", "%/s", 0.3, FASTEST_PCTPS, FASTEST_PCTPS, (8.0,)),
    )

    def nodes(self, signals: Signals) -> tuple[tuple[float, ...], ...]:  # noqa: ARG002 - of any engine
        """A share alone, or an absolute limit alone."""
        shares = tuple((share, FASTEST_PCTPS) for share in self.fixed[0].starts)
        return (*shares, *((1.0, most) for most in (8.0, 4.0, 2.0)))

    def pace(self, theta: FloatArray, signals: Signals) -> Pace:  # noqa: ARG002 - of any engine
        """`share` of the limit of acceleration, and the absolute one."""
        bounded = np.where(theta[:, 1:] < FASTEST_PCTPS, theta[:, 1:], UNLIMITED)
        most = bounded.min(axis=1, initial=UNLIMITED)
        return as_simulated(len(theta))._replace(limit=theta[:, 0], most=most)


class AltitudeLag(_Transit):
    """Time constants go with air density by an `exponent` more than the simulator has it.

    `tau ~ (sqrt(theta) / delta)^exponent` (NACA TR-1011).
    """

    id: ClassVar[str] = "altitude_lag"
    meaning: ClassVar[str] = "time constants grow with altitude"
    manoeuvre: ClassVar[str] = "the same slam at low and at high altitude"
    fixed = (Parameter("exponent", "-", -1.5, 2.0, 0.0, (-0.3, 0.3, 0.8)),)

    def applies(self, signals: Signals) -> bool:
        """Where the altitude changes."""
        return super().applies(signals) and "ALT_ft" in signals.active

    def pace(self, theta: FloatArray, signals: Signals) -> Pace:  # noqa: ARG002 - of any engine
        """Rates scaled by the power of what the air is."""
        return as_simulated(len(theta))._replace(thin_air=theta[:, 0])


class ActuatorLag(_Transit, OutputEffect):
    """A further lag of `tau_s` between what the control asks for and the fuel that burns.

    An accelerating engine needs ever more fuel, so that fuel which is late is fuel that is missing
    all along. How much, goes with the core's own time constant `core_s`, which is fitted with it.
    So it is where the control closes a loop over the lag. Where it lies `outside` any loop (0 or 1:
    a lever that asks for fuel), as where fuel is the driver, it commutes with the engine, and all
    outputs follow the simulator's with the one lag.
    """

    id: ClassVar[str] = "actuator_lag"
    family: ClassVar[str] = "initiation"
    meaning: ClassVar[str] = "lag of the fuel metering valve"
    manoeuvre: ClassVar[str] = "fast small steps: a lag bends the start, a delay only shifts it"
    fixed = (
        Parameter("tau_s", "s", 0.0, 3.0, 0.0, (0.1, 0.3, 0.8)),
        Parameter("core_s", "s", 0.3, 5.0, 1.0, (0.7, 2.0)),
        Parameter("outside", "-", 0.0, 1.0, 0.0, (0.0, 1.0)),
    )

    def parameters(self, signals: Signals) -> tuple[Parameter, ...]:
        """The lag alone where fuel is the driver: no loop is closed over it."""
        return self.fixed if signals.governed else self.fixed[:1]

    def pace(self, theta: FloatArray, signals: Signals) -> Pace:
        """The valve's lag inside the loop, and how the core answers fuel."""
        same = as_simulated(len(theta))
        if not signals.governed:
            return same
        inside = theta[:, 2] < _EITHER
        return same._replace(valve_s=theta[:, 0] * inside, core_s=theta[:, 1])

    def on_output(self, run: Run, y: FloatArray) -> FloatArray:
        """Outside a loop, all outputs behind one and the same lag."""
        outside = run.theta[:, 2] >= _EITHER if run.signals.governed else 1.0
        tau_s = run.theta[:, 0] * outside
        dt_s = run.signals.dt_s
        return np.stack([lag(y[..., j], tau_s, dt_s) for j in range(y.shape[-1])], axis=-1)
