"""Slopes of the lumped engine's free run by its parameters: differences of runs are the oracle."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from narxcal.lumped.engine import LumpedEngine, Slopes
from narxcal.lumped.limited import LIMITED
from narxcal.narx.network import AT_START
from training.dynamics.lag_priors import Form, start_engine

INPUTS = ("ALT_ft", "Mach", "dT_C")
CENTRE, HALF = np.array([62.0, 75.0, 520.0]), np.array([35.0, 20.0, 240.0])
DT_S, ALL = 0.1, np.arange(3)


def engine(seed, governed=True, limit=60.0, names=("N1_pct", "N2_pct", "EGT_C")):
    """A governed engine drawn about the start of a fit, or any limited one."""
    rng = np.random.default_rng(seed)
    scales = {"centre": CENTRE, "half": HALF, "limit": np.full(3, limit)}
    if not governed:
        parameters = rng.normal(scale=0.4, size=(3, len(LIMITED)))
        return LumpedEngine.of(names, {"parameters": parameters}, scales)
    model, _ = start_engine(names, Form(governed=True), scales)
    return replace(model, theta=model.theta + rng.normal(scale=0.2, size=len(model.theta)))


def course(model, seed):
    """What drives a run over slams at all altitudes, and where it starts."""
    rng = np.random.default_rng(seed)
    ss = CENTRE + HALF * np.repeat(rng.uniform(-1.1, 1.1, (6, 1)), 15, axis=0)
    inputs = np.repeat(rng.uniform([0.0, 0.0, -20.0], [39000.0, 0.8, 15.0], (6, 3)), 15, axis=0)
    return model.drive(inputs, INPUTS, ss), (AT_START, model.start(rng.normal(size=3))[None]), DT_S


def slopes(model, seed, free=None, columns=ALL, every=1):
    free = np.arange(len(model.theta)) if free is None else free
    return model.slopes(Slopes(free, columns, every), *course(model, seed))


def differences(model, seed, step=1e-6):
    def run(theta):
        return replace(model, theta=theta).run(*course(model, seed))[0]

    moves = step * np.eye(len(model.theta))
    found = [run(model.theta + move) - run(model.theta - move) for move in moves]
    return np.stack(found, axis=2) / (2.0 * step)


@settings(max_examples=20)
@given(seed=st.integers(0, 29), governed=st.booleans())
def test_slopes_are_what_differences_of_runs_tend_to(seed, governed):
    model = engine(seed, governed)
    expected = differences(model, seed)
    got = slopes(model, seed)
    assert np.abs(got - expected).max() < 1e-5 * np.abs(expected).max()
    scale = 1.0 + np.abs(expected).max(axis=(0, 1))
    assert (np.abs(got - expected).max(axis=(0, 1)) < 1e-4 * scale).all()


@pytest.mark.parametrize("change", ["limit", "valve", "clearance", "log_tau", "lines"])
def test_where_a_bound_applies_slopes_are_those_of_the_bounded_run(change):
    model = engine(3)
    if change == "limit":
        model = engine(3, limit=4.0)
    elif change == "valve":
        model.arrays["extra"][0] = 1.5
    elif change == "clearance":
        model.arrays["extra"][1] = 40.0
    elif change == "log_tau":
        model.arrays["heat"][:, 1], model.arrays["heat"][:, 5] = 6.0, 1.0
    else:
        model.arrays["lines"][[0, 6], 0] = 7.0
    expected, got = differences(model, 3), slopes(model, 3)
    assert np.abs(got - expected).max() < 1e-4 * (1.0 + np.abs(expected).max())


@pytest.mark.parametrize("governed", [True, False])
def test_some_slopes_are_a_part_of_all(governed):
    model, rng = engine(1, governed), np.random.default_rng(1)
    free = np.flatnonzero(rng.random(len(model.theta)) < 0.3)
    part = slopes(model, 1, free, np.array([2, 0]), 4)
    whole = slopes(model, 1)[::4, [2, 0]][:, :, free]
    np.testing.assert_allclose(part, whole, rtol=1e-9, atol=1e-9 * np.abs(whole).max())


@pytest.mark.slow
def test_the_order_of_the_outputs_does_not_matter():
    model = engine(2)
    turned = engine(2, names=("EGT_C", "N1_pct", "N2_pct"))
    order = [2, 0, 1]
    scales = {name: getattr(turned, name)[order] for name in ("centre", "half", "limit")}
    turned = replace(turned, **scales)
    drive, (rows, states), dt_s = course(model, 2)
    other = drive._replace(
        ss=drive.ss[:, order], target=drive.target[:, order], per_unit=drive.per_unit[:, order]
    )
    wanted = Slopes(np.arange(len(model.theta)), ALL)
    got = turned.slopes(wanted, other, (rows, states[:, :, order]), dt_s)
    np.testing.assert_allclose(got, slopes(model, 2)[:, order], rtol=1e-9, atol=1e-9)
