"""Forward sensitivities of lags behind a control: differences of runs are their slow twin."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from narxcal.lumped.lag_governed import FITTED, GovernedLags
from narxcal.narx.network import AT_START
from training.lag_priors import governed_start

INPUTS = ("ALT_ft", "Mach", "dT_C")
CENTRE, HALF = np.array([62.0, 75.0, 520.0]), np.array([35.0, 20.0, 240.0])
DT_S, ALL = 0.1, (0, 1, 2)


def lags(seed, limit=60.0, names=("N1_pct", "N2_pct", "EGT_C")):
    """Lags drawn about those that a fit starts from."""
    rng = np.random.default_rng(seed)
    arrays = {
        name: v + rng.normal(scale=0.2, size=v.shape) for name, v in governed_start(3).items()
    }
    scales = {"centre": CENTRE, "half": HALF, "limit": np.full(3, limit)}
    return GovernedLags(output_names=names, **arrays, **scales)


def course(model, seed):
    """What drives a run over slams at all altitudes, and where it starts."""
    rng = np.random.default_rng(seed)
    ss = CENTRE + HALF * np.repeat(rng.uniform(-1.1, 1.1, (6, 1)), 15, axis=0)
    inputs = np.repeat(rng.uniform([0.0, 0.0, -20.0], [39000.0, 0.8, 15.0], (6, 3)), 15, axis=0)
    return model.drive(inputs, INPUTS, ss), model.start(rng.normal(size=3))[None]


def everything(model):
    return {name: np.ones(getattr(model, name).shape, dtype=bool) for name in FITTED}


def slopes(model, seed, wanted=None, scored=(ALL, 1)):
    drive, start = course(model, seed)
    states = model.run(drive, (AT_START, start), DT_S)
    return model.sensitivities(drive, (states, DT_S), wanted or everything(model), scored)


def deviations(model, seed, theta):
    changed, at = {}, 0
    for name in FITTED:
        array = getattr(model, name)
        changed[name] = theta[at : at + array.size].reshape(array.shape)
        at += array.size
    drive, start = course(model, seed)
    return replace(model, **changed).run(drive, (AT_START, start), DT_S)[:, :3].sum(axis=1)


def differences(model, seed, step=1e-6):
    theta = np.concatenate([getattr(model, name).ravel() for name in FITTED])
    found = [
        deviations(model, seed, theta + move) - deviations(model, seed, theta - move)
        for move in step * np.eye(len(theta))
    ]
    return np.stack(found, axis=2) / (2.0 * step)


@settings(deadline=None, max_examples=12)
@given(seed=st.integers(0, 29))
def test_slopes_are_what_differences_of_runs_tend_to(seed):
    model = lags(seed)
    expected = differences(model, seed)
    got = slopes(model, seed)
    assert np.abs(got - expected).max() < 1e-5 * np.abs(expected).max()
    scale = 1.0 + np.abs(expected).max(axis=(0, 1))
    assert (np.abs(got - expected).max(axis=(0, 1)) < 1e-4 * scale).all()


@pytest.mark.parametrize("change", ["limit", "valve", "clearance", "log_tau", "lines"])
def test_where_a_bound_holds_slopes_are_those_of_a_run_that_is_held(change):
    model = lags(3)
    if change == "limit":
        model = lags(3, limit=4.0)
    elif change == "valve":
        model.extra[0] = 1.5
    elif change == "clearance":
        model.extra[1] = 40.0
    elif change == "log_tau":
        model.heat[:, 1], model.heat[:, 5] = 6.0, 1.0
    else:
        model.lines[[0, 6], 0] = 7.0
    expected, got = differences(model, 3), slopes(model, 3)
    assert np.abs(got - expected).max() < 1e-4 * (1.0 + np.abs(expected).max())


def test_some_of_them_are_a_part_of_all():
    model, rng = lags(1), np.random.default_rng(1)
    wanted = {name: rng.random(mask.shape) < 0.3 for name, mask in everything(model).items()}
    part = slopes(model, 1, wanted, ([2, 0], 4))
    columns = np.concatenate([wanted[name].ravel() for name in FITTED])
    whole = slopes(model, 1)[::4, [2, 0]][:, :, columns]
    np.testing.assert_allclose(part, whole, rtol=1e-9, atol=1e-9 * np.abs(whole).max())


def test_the_order_of_the_outputs_does_not_matter():
    model = lags(2)
    turned = lags(2, names=("EGT_C", "N1_pct", "N2_pct"))
    order = [2, 0, 1]
    scales = {name: getattr(model, name)[order] for name in ("centre", "half", "limit")}
    turned = replace(turned, **scales)
    drive, start = course(model, 2)
    other = drive._replace(
        ss=drive.ss[:, order], target=drive.target[:, order], per_unit=drive.per_unit[:, order]
    )
    states = turned.run(other, (AT_START, start[:, :, order]), DT_S)
    got = turned.sensitivities(other, (states, DT_S), everything(turned), (ALL, 1))
    np.testing.assert_allclose(got, slopes(model, 2)[:, order], rtol=1e-9, atol=1e-9)
