"""Does a model settle at constant inputs: what is known to settle does, what hunts is found."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from narxcal.calibration.bundle import Bundle
from narxcal.calibration.certificate import Certificate, certify, settling
from narxcal.calibration.dynamic import DynamicCalibration
from narxcal.calibration.identified import (
    EngineDynamics,
    IdentifiedCalibration,
    ResponseDynamics,
    StateSpaceDynamics,
)
from narxcal.calibration.members import Member
from narxcal.calibration.run_record import RunRecord
from narxcal.narx.config import NarxConfig
from narxcal.narx.module import NarxNet
from narxcal.narx.network import NarxModel, Scaling
from narxcal.output_error.engine import EngineFromSteady
from narxcal.state_space import StateSpace
from narxcal.steady.table import SteadyTable
from narxcal.support.errors import ModelError
from narxcal.support.settings import read_stored
from narxcal.transfer import Schedule
from training.dynamics.lag_priors import Form, start_engine

INPUTS, OUTPUTS = ("TRA_deg", "ALT_ft", "Mach"), ("N1_pct", "N2_pct", "EGT_C")
CENTRE, HALF = np.array([62.0, 75.0, 520.0]), np.array([35.0, 20.0, 200.0])
DT_S = 0.1


def steady():
    corners = np.array(np.meshgrid([0.0, 80.0], [0.0, 40e3], [0.0, 0.85])).T.reshape(-1, 3)
    return SteadyTable((INPUTS, OUTPUTS), corners, CENTRE + HALF * (corners[:, :1] / 40.0 - 1.0))


def lags(form, seed=None, spread=0.3):
    scales = {"centre": CENTRE, "half": HALF, "limit": 0.8 * HALF}
    engine, table = start_engine(OUTPUTS, form, scales)
    if seed is not None:
        drawn = np.random.default_rng(seed).normal(size=len(engine.theta))
        engine.theta[:] += spread * np.where(table.fitted, drawn, 0.0)
    return engine


def network(lag, settle_s, feedback=0.3, seed=0, *, anchored=True):
    """A drawn network whose linear feedback is `feedback` times one; inputs saturate."""
    torch.manual_seed(seed)
    width = 6 if lag is None else 9
    moving = (width - 3) * anchored
    net = NarxNet(NarxConfig(lags=1, taps=(0,), hidden=4, moving=moving), width, 3)
    net.low[:], net.high[:] = -0.3, 0.3
    weights = net.weights()
    weights.w1[:, :3], weights.a[:, :3] = 0.0, feedback * np.eye(3)
    scalings = (Scaling(np.zeros(n), np.full(n, 50.0)) for n in (width, 3))
    narx = NarxModel(weights, *scalings)
    model = DynamicCalibration(steady(), narx, DT_S, (), settle_s).with_lag(lag)
    return model.with_input_limits([-10.0, 0.0, 0.0], [90.0, 42e3, 0.9])


def engine():
    values = {one.name: one.start for one in EngineFromSteady(DT_S).parameters}
    return EngineDynamics(values, ("tau_H",), "TRA_deg", (10.0, 70.0), (1, 0, 2), DT_S)


def responses(damping=0.7):
    second = Schedule((), np.log([damping, 2.0]))
    return ResponseDynamics((), (second, Schedule((), np.log([1.3])), second), DT_S)


def state_space(pole=0.95):
    rng = np.random.default_rng(0)
    matrices = np.diag([pole, 0.8]), rng.normal(size=(2, 3)), rng.normal(size=(3, 2))
    return StateSpaceDynamics(StateSpace(*matrices, np.zeros((3, 3)), DT_S))


@settings(max_examples=9, phases=[Phase.explicit, Phase.generate])
@given(
    st.integers(0, 2**31),
    st.sampled_from([Form(governed=True), Form(), Form(limited=True)]),
    st.floats(-1.5, 1.5),
)
def test_lags_with_a_bounded_network_settle_on_the_steady_state(seed, form, feedback):
    found = certify(network(lags(form, seed, 0.1), 30.0, feedback, seed % 1000))
    assert found.settled, found.words
    assert max(found.offset.values()) < 0.002


@pytest.mark.parametrize("dynamics", [engine(), responses(), state_space()])
def test_identified_models_settle_on_the_steady_state(dynamics):
    found = certify(IdentifiedCalibration(steady(), dynamics, DT_S))
    assert found.settled, found.words
    assert max(found.offset.values()) < 1e-6


def test_the_largest_pole_is_that_of_the_model():
    found = certify(IdentifiedCalibration(steady(), state_space(0.97), DT_S))
    assert found.pole == pytest.approx(0.97, rel=1e-6)
    assert found.slowest_s == pytest.approx(-DT_S / np.log(0.97), rel=1e-5)
    arx = Member("arx", 1, poles=(1.71, -0.71), gains=((0.0,) * 3,) * 3, offset=0.7)
    own = certify(network(None, 20.0).with_members([arx]))
    assert own.pole == pytest.approx(1.0, abs=1e-9)  # z^2 - 1.71 z + 0.71
    assert not own.settled


def test_a_model_that_diverges_is_found():
    found = certify(IdentifiedCalibration(steady(), state_space(1.01), DT_S))
    assert not found.settled
    assert found.slowest_s == np.inf
    assert found.row()["slowest_s"] is None
    assert found.words.startswith("does not settle at constant inputs: ")


@pytest.mark.parametrize("tau_s", [100.0, 300.0, 1000.0])
def test_a_pole_slower_than_a_stay_settles(tau_s):
    """As the control of a sound engine may at a corner of its box: far out, thin air, idle."""
    found = certify(IdentifiedCalibration(steady(), state_space(np.exp(-DT_S / tau_s)), DT_S))
    assert found.slowest_s == pytest.approx(tau_s, rel=1e-3)
    assert found.settled


def test_a_response_without_damping_hunts():
    found = certify(IdentifiedCalibration(steady(), responses(1e-4), DT_S))
    assert found.pole < 1.0
    assert not found.settled
    name = max(found.swing, key=found.swing.get)
    where = ", ".join(f"{key} {value:.4g}" for key, value in found.at.items())
    assert found.words == (
        f"does not settle at constant inputs: {name} still swings by "
        f"{100.0 * found.swing[name]:.3g} % of full scale after 1500 s at {where}"
    )


def test_a_network_that_does_not_settle_is_bounded():
    wild = network(lags(Form()), None, feedback=1.2)
    assert not certify(wild).settled
    mended, found, lost = settling(wild, ())
    assert found.settled
    assert mended.settle_s == 30.0
    assert lost == (f"the network {certify(wild).words}: it has a decay bound of 30 s now",)


def test_what_no_decay_bounds_gives_way_to_first_order_lags():
    model = network(lags(Form()), None, feedback=1.2, anchored=False)
    simple = [Member("first_order", k, 0.1, 0.2) for k in range(3)]
    left, found, lost = settling(model, simple)
    assert found.settled
    assert left.members.members == tuple(simple)
    assert lost == (f"the model {certify(model).words}: first-order lags take its place",)


def test_what_settles_stays_as_it_is():
    model = network(lags(Form(governed=True)), 30.0)
    left, _, lost = settling(model, ())
    assert left is model
    assert lost == ()


def test_a_certificate_comes_back_from_its_row():
    model = network(lags(Form()), 30.0)
    found = certify(model)
    assert read_stored(Certificate, found.row(), "certificate") == found
    assert Bundle(model).certificate == found
    stored = replace(found, points=1)
    assert Bundle(model, RunRecord(certificate=stored)).certificate == stored
    with pytest.raises(ModelError, match="the part 'certificate' has no 'swing'"):
        read_stored(
            Certificate, {k: v for k, v in found.row().items() if k != "swing"}, "certificate"
        )
