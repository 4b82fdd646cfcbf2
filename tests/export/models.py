"""Drawn models of every kind that narxcal exports, and a log that leaves their envelope."""

import numpy as np

from narxcal.calibration.delay import TransportDelay
from narxcal.calibration.dynamic import DynamicCalibration
from narxcal.calibration.identified import (
    EngineDynamics,
    IdentifiedCalibration,
    NoDynamics,
    ResponseDynamics,
    StateSpaceDynamics,
)
from narxcal.calibration.members import Member
from narxcal.intervals import HalfWidths
from narxcal.lumped.engine import LumpedEngine, shapes_of
from narxcal.narx.config import NarxConfig
from narxcal.narx.network import NarxModel, Scaling, Weights
from narxcal.output_error.engine import EngineFromSteady
from narxcal.state_space import StateSpace
from narxcal.steady.fitted import FittedSteadyState, Layout
from narxcal.steady.model import Envelope
from narxcal.steady.table import SteadyTable
from narxcal.transfer import Schedule

INPUTS, OUTPUTS = ("FF_kgph", "ALT_ft", "Mach", "dT_C"), ("N1_pct", "N2_pct", "EGT_C")
LOW, HIGH = np.array([100.0, 0.0, 0.0, -20.0]), np.array([700.0, 30e3, 0.6, 30.0])
DT_S = 0.1


def fitted(**changed):
    """Curves over log fuel flow that rise like those of a small turbofan."""
    rng = np.random.default_rng(1)
    layout = {"blend": ("Mach", "ALT_ft"), "exponents": ("delta", "theta"), **changed}
    layout = Layout(input_names=INPUTS, output_names=OUTPUTS, driver="FF_kgph", **layout)
    knots = np.linspace(4.0, 7.4, 6)
    span = np.array([80.0, 45.0, 500.0])[:, None, None]
    corners = 2 ** len(layout.blend)
    rise = span * rng.uniform(0.05, 0.25, (3, corners, len(knots)))
    base = np.array([15.0, 50.0, 700.0])[:, None, None] * rng.uniform(0.95, 1.05, (3, corners, 1))
    count = len(layout.exponents)
    offset, slope = np.split(rng.normal(size=(2, 3, 2)), 2, axis=2)
    lines = np.concatenate([offset, np.repeat(slope / len(knots), len(knots), axis=2)], axis=2)
    return FittedSteadyState(
        layout=layout,
        envelope=Envelope(LOW, HIGH),
        seen=np.log([110.0, 1500.0]),
        knots=knots,
        curve=np.concatenate([base, rise], axis=2),
        engines=("left", "right"),
        engine_curves=lines,
        switch_lines=rng.normal(size=(len(layout.switches), 3, 2)),
        air_lines=rng.normal(size=(count, 3, 2)),
        air_seen=np.tile([-0.4, 0.1], (count, 1)),
    )


def table(method="linear"):
    """A deck over all inputs."""
    axes = np.linspace(100.0, 700.0, 5), np.array([0.0, 2e4, 3e4]), [0.0, 0.6], [-20.0, 30.0]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 4)
    return SteadyTable((INPUTS, OUTPUTS), points, fitted().outputs(points), method)


def scales():
    return {
        "centre": np.array([60.0, 80.0, 650.0]),
        "half": np.array([40.0, 25.0, 300.0]),
        "limit": np.array([50.0, 30.0, 200.0]),
    }


def lags(*, governed):
    rng = np.random.default_rng(2)
    shapes = shapes_of(3, governed=governed)
    arrays = {name: 0.15 * rng.normal(size=shape) for name, shape in shapes.items()}
    return LumpedEngine.of(OUTPUTS, arrays, scales())


def narx(steady, lag=None, **config):
    """Calibration by a network of drawn weights."""
    rng = np.random.default_rng(3)
    moving = (0 if config.get("moving") == 0 else 1) * (3 if lag is None else 6)
    config = NarxConfig(**{"lags": 2, "taps": (0, 1, 3), "hidden": 6, **config, "moving": moving})
    features = 8 + (0 if lag is None else 3)
    width = config.lags * 3 + len(config.taps) * features
    shapes = {
        "hidden.weight": (6, width), "hidden.bias": (6,), "output.weight": (3, 6),
        "output.bias": (3,), "linear.weight": (3, width),
    }  # fmt: skip
    arrays = {name: 0.2 * rng.normal(size=shape) for name, shape in shapes.items()}
    arrays |= {"low": np.full(3, -2.0), "high": np.full(3, 2.5)}
    deviation = np.array([10.0, 8.0, 60.0])
    centre = np.concatenate([np.zeros(features - 5), [60.0, 80.0, 500.0, 1e4, 0.3]])
    scale = np.concatenate([deviation, deviation, [30.0, 20.0, 100.0, 1e4, 0.2]])[-features:]
    scaling = Scaling(centre, scale), Scaling(np.zeros(3), np.array([2.0, 1.5, 12.0]))
    model = NarxModel(Weights.of(config, arrays), *scaling)
    settle_s = 10.0 if moving else None
    plain = DynamicCalibration(steady, model, DT_S, ("ALT_ft", "Mach"), settle_s)
    return plain.with_lag(lag).with_input_limits(LOW - 50.0, 1.2 * HIGH)


def mixed():
    """A network of which outputs take shares behind lags, and simple models of two of them."""
    gains = ((0.2, 0.1, 0.0), (0.1, 0.0, 0.02), (0.0, 0.05, 0.0))
    arx = Member("arx", 2, poles=(0.5, 0.2), gains=gains, offset=3.0, weight=0.4)
    lag = Member("first_order", 0, push=0.2, pull=0.1, weight=0.3)
    own = narx(fitted(), lags(governed=False)).with_network_share([0.2, 1.0, 0.6])
    return own.with_members([lag, arx, Member("steady_state", 2, weight=0.1)])


def output_error():
    values = {one.name: one.start for one in EngineFromSteady(DT_S).parameters}
    values |= {"tau_M": 0.3, "alpha": 0.4, "beta": 1.7, "square_M": 0.0}
    return EngineDynamics(values, ("tau_H",), "FF_kgph", (120.0, 650.0), (1, 0, 2), DT_S)


def responses():
    rng = np.random.default_rng(4)
    axes = ((20.0, 60.0, 90.0), (0.0, 20e3))
    second = Schedule(axes, np.log(rng.uniform(0.5, 2.0, (3, 2, 2))))
    first = Schedule(axes, np.log(rng.uniform(0.5, 2.0, (3, 2, 1))))
    return ResponseDynamics(("level", "ALT_ft"), (second, first, second), DT_S)


def state_space():
    rng = np.random.default_rng(5)
    A = np.diag([0.95, 0.8, 0.6, 0.9])
    B, C = rng.normal(size=(4, 3)), 0.2 * rng.normal(size=(3, 4))
    return StateSpaceDynamics(StateSpace(A, B, C, np.zeros((3, 3)), DT_S))


def with_interval(model):
    knots = np.array([0.5, 2.0, 2.0, 9.0])
    widths = np.outer(np.linspace(0.5, 3.0, 9), [1.0, 2.0, 2.5, 6.0])
    return model.with_interval(HalfWidths((knots,) * 3, (widths,) * 3, 5, (0.3,) * 3))


def identified(dynamics, steady=None):
    return IdentifiedCalibration(steady or fitted(), dynamics, DT_S)


KINDS = {
    "narx": lambda: narx(fitted()),
    "narx, not anchored": lambda: narx(fitted(exponents=(), switches=("Mach",)), moving=0),
    "narx behind limited lags": lambda: with_interval(narx(fitted(), lags(governed=False))),
    "narx behind governed lags": lambda: narx(table(), lags(governed=True), lags=1, taps=(0,)),
    "mixture": mixed,
    "output-error": lambda: identified(output_error()),
    "output-error over a table": lambda: identified(output_error(), table("pchip")),
    "transfer": lambda: with_interval(identified(responses())),
    "subspace": lambda: identified(state_space()),
    "transfer behind a delay": lambda: late(identified(responses()), 0.33),
    "narx behind a short delay": lambda: late(narx(fitted()), 0.04),
    "no dynamics": lambda: identified(NoDynamics(), table()),
}


def late(model, delay_s):
    """Fuel flow and Mach number act late."""
    return model.with_delay(TransportDelay(("FF_kgph", "Mach"), delay_s, 0.0, 1.0))


def log(samples=600, *, far=True):
    """Inputs that move, partly outside the envelope."""
    rng = np.random.default_rng(6)
    level = np.repeat(rng.uniform(0.0, 1.0, (samples // 30, 4)), 30, axis=0)
    share = np.clip(level + rng.normal(0.0, 0.01, level.shape), 0.0, 1.0)
    inputs = LOW + share * (HIGH - LOW)
    if far:
        inputs[2 * samples // 3 :] += (HIGH - LOW) * 0.4 * np.array([1.0, 1.0, -0.2, 1.0])
    return inputs
