"""Metal and clearances of lags behind a control that holds N1, and how a calibration steps them."""

import math

import numpy as np
import pytest
import torch

from narxcal.calibration.dynamic import DynamicCalibration
from narxcal.narx.config import NarxConfig
from narxcal.narx.module import NarxNet
from narxcal.narx.network import NarxModel, Scaling
from narxcal.steady.table import SteadyTable
from training.dynamics.lag_priors import Form, start_engine

NAMES, INPUTS = ("N1_pct", "N2_pct", "EGT_C"), ("TRA_deg", "ALT_ft", "Mach", "dT_C")
CENTRE, HALF = np.array([62.0, 75.0, 520.0]), np.array([35.0, 20.0, 240.0])
DT_S = 0.1


def lags(clearance):
    """The lags that a fit starts from, with no heat but what clearances cost the core."""
    scales = {"centre": CENTRE, "half": HALF, "limit": np.full(3, 1000.0)}
    engine, _ = start_engine(NAMES, Form(governed=True), scales)
    engine.arrays["heat"][:, [0, 4]], engine.arrays["extra"][1] = 0.0, clearance
    return engine


def outputs(model, levels, hold_s):
    """Outputs of an engine at sea level whose settled ones step from level to level."""
    ss = CENTRE + HALF * np.repeat(levels, round(hold_s / DT_S))[:, None]
    drive = model.drive(np.zeros((len(ss), 4)), INPUTS, ss)
    return ss - model.deviations(drive, np.zeros(3), DT_S)


def slams(model):
    """How the core moves in slams out of a minute's idle and out of a long one, (time,) each."""
    late = outputs(model, [-0.9, 0.9, -0.9, -0.9, 0.9], 30.0)[1200:1300, 1]
    return late, outputs(model, [-0.9, 0.9], 30.0)[300:400, 1]


@pytest.mark.parametrize("clearance", [0.1, 0.3])
def test_a_core_that_has_idled_for_long_accelerates_less(clearance):
    soon, long = slams(lags(clearance))
    between = (soon > CENTRE[1] - 0.5 * HALF[1]) & (soon < CENTRE[1] + 0.5 * HALF[1])
    assert (long[between] < soon[between]).all()
    assert (soon - long)[between].max() > 0.7 * clearance


def test_clearances_that_cost_nothing_change_nothing():
    soon, long = slams(lags(0.0))
    np.testing.assert_allclose(soon, long, atol=0.01)


def paces(clearance):
    """Speed of a core that is held to very little acceleration, scaled, and its pace."""
    model = lags(clearance)
    model.arrays["lines"][[0, 4, 5]] = 0.0
    model.arrays["lines"][[0, 4, 5], 0] = math.log(0.4), math.log(0.02), math.log(0.02)
    v = (outputs(model, [-1.0, 1.0], 90.0)[:, 1] - CENTRE[1]) / HALF[1]
    return v, np.gradient(v, DT_S)


def test_what_open_clearances_cost_is_missing_in_the_acceleration():
    # So slow that the fuel is nearly the speed; metal and casing follow it as lags do.
    (v, pace), (_, free) = paces(0.2), paces(0.0)
    fuel, metal, casing, opened = v + 0.4 * pace, v[0], v[0], []
    for k in range(len(v)):
        metal += DT_S / math.exp(2.85 - 0.5 * v[k]) * (fuel[k] - metal)
        casing += DT_S / 80.0 * (metal - casing)
        opened.append(metal - casing)
    held = slice(950, 1500)
    assert max(opened) > 0.2
    np.testing.assert_allclose(
        pace[held] / free[held], np.exp(-0.2 * np.array(opened))[held], rtol=0.01
    )


def test_where_the_control_holds_n1_open_clearances_show_until_the_casing_is_warm():
    model = lags(0.0)
    model.arrays["heat"][0, 4] = 0.05
    found, plain = (outputs(one, [-0.9, 0.9], 600.0)[:, 1] for one in (model, lags(0.0)))
    found -= plain
    soon, later = found[6800], found[7600]
    # Of the casing's 1.8 half ranges, what is left after 80 s behind metal of 11 s.
    metal_s = math.exp(2.85 - 0.5 * 0.9)
    behind = 1.8 * 80.0 / (80.0 - metal_s) * math.exp(-80.0 / 80.0)
    assert soon == pytest.approx(-0.05 * HALF[1] * behind, rel=0.05)
    assert later / soon == pytest.approx(math.exp(-1.0), rel=0.02)
    assert abs(found[-1]) < 0.01


def test_after_a_pull_the_casing_is_the_warmer_and_nothing_is_open():
    model = lags(0.3)
    model.arrays["heat"][0, 4] = 0.05
    drawn, plain = (outputs(one, [0.9, -0.9], 60.0) for one in (model, lags(0.0)))
    np.testing.assert_allclose(drawn, plain, atol=0.02)


def calibration():
    torch.manual_seed(0)
    net = NarxNet(NarxConfig(lags=2, taps=(0,), hidden=2, moving=6), 9, 3)
    net.low[:], net.high[:] = -2.0, 2.0
    network = NarxModel(net, Scaling(np.zeros(9), np.full(9, 50.0)), Scaling(np.zeros(3), HALF))
    corners = np.array(np.meshgrid([0, 85], [0, 40000], [0, 0.85], [-30, 20])).T.reshape(-1, 4)
    settled = CENTRE + HALF * (corners[:, :1] / 42.5 - 1.0)
    steady = SteadyTable((INPUTS, NAMES), corners.astype(float), settled)
    return DynamicCalibration(steady, network, DT_S, INPUTS[:0], 10.0).with_lag(lags(0.3))


def test_a_calibration_steps_as_it_simulates():
    model, rng, start = calibration(), np.random.default_rng(0), [30.0, 60.0, 300.0]
    low, high = [0.0, 0.0, 0.0, -20.0], [85.0, 39000.0, 0.8, 15.0]
    inputs = np.repeat(rng.uniform(low, high, (8, 4)), 40, axis=0)
    whole = model.simulate(inputs, start)
    first = model.reset(inputs[0], start)
    np.testing.assert_allclose([first, *map(model.step, inputs[1:])], whole, rtol=1e-10)
    model.reset(inputs[0], start)
    parts = [model.extend(inputs[1:150]), model.extend(inputs[150:])]
    np.testing.assert_allclose(np.concatenate(parts), whole[1:], rtol=1e-10)
