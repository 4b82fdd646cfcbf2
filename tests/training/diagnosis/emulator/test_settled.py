"""Settled values follow the corners of a control, hold beyond what was flown, and ignore motion."""

from dataclasses import replace

import numpy as np
import pytest

from narxcal.effects import Flights, Signals
from training.diagnosis.emulator import corrected, fit_settled

INPUTS = ("TRA_deg", "ALT_ft", "Mach", "dT_C", "Approach", "NAI")
OUTPUTS = ("N1_pct", "N2_pct", "EGT_C")
DT = 0.25


def rest(u):
    """An idle floor, higher on approach; a rating that bends over the lever; bleed."""
    floor = 30.0 + 8.0 * u[..., 4]
    n1 = np.maximum(floor, 20.0 + 0.95 * u[..., 0] + 2e-4 * u[..., 1])
    egt = 300.0 + 5.0 * n1 + 2.0 * u[..., 3] + 12.0 * u[..., 5]
    return np.stack([n1, 50.0 + 0.45 * n1, egt], axis=-1)


def flown(flights=5, steps=1600, seed=0):
    random = np.random.default_rng(seed)
    u = np.zeros((flights, steps, len(INPUTS)))
    for f in range(flights):
        u[f, :, 0] = np.repeat(random.uniform(0.0, 80.0, steps // 40), 40)
        u[f, :, 1] = random.uniform(0, 30000) + np.linspace(0, 4000, steps)
        u[f, :, 2] = 0.2 + 0.1 * f
        u[f, :, 3] = random.uniform(-15, 15)
        u[f, :, 4] = np.repeat(random.integers(0, 2, steps // 200), 200)
        u[f, :, 5] = np.repeat(random.integers(0, 2, steps // 160), 160)
    y = rest(u)
    for k in range(1, steps):  # a lag of 1 s: in motion the outputs are elsewhere
        y[:, k] = y[:, k] + np.exp(-DT / 1.0) * (y[:, k - 1] - y[:, k])
    return u, y


def signals(y):
    low, high = y.min(axis=(0, 1)), y.max(axis=(0, 1))
    return Signals(INPUTS, OUTPUTS, DT, "TRA_deg", low, high, (0.0, 80.0), INPUTS)


@pytest.fixture(scope="module")
def model():
    u, y = flown()
    return fit_settled(Flights(signals(y), u, y, np.full(len(u), u.shape[1])))


def test_the_corners_of_a_control_are_followed(model):
    u, _ = flown(seed=0)
    wrong = model.outputs(u) - rest(u)
    assert np.sqrt(np.mean(wrong**2, axis=(0, 1)))[0] < 0.6
    assert np.median(np.abs(wrong[..., 0])) < 0.15


def test_what_a_run_misses_at_rest_is_taken_into_the_settled_values(model):
    """Holds that end before the engine has settled: the run knows what is still to come."""
    u, y = flown()
    flights = Flights(signals(y), u, y, np.full(len(u), u.shape[1]))
    off = np.array([0.4, -0.2, 3.0]) * (1.0 + u[..., :1] / 80.0)
    short = replace(model, weights=model.weights - _weights_of(off, model, u))
    run = y - off
    found = corrected(short, flights, y - run)
    before, after = (np.abs(m.outputs(u) - model.outputs(u)).mean((0, 1)) for m in (short, found))
    assert (after < 0.1 * before).all()


def _by_features(model, u):
    scales, zeros = model.scales(u)
    return model.features(u) @ model.weights * scales - zeros


def _weights_of(values, model, u):
    features = model.features(u)
    rows = features.reshape(-1, features.shape[-1])
    corrected_values = values / model.scales(u)[0]
    return np.linalg.lstsq(rows, corrected_values.reshape(len(rows), -1), rcond=None)[0]


def test_outputs_are_features_times_weights(model):
    u, _ = flown(seed=3)
    np.testing.assert_allclose(model.outputs(u), _by_features(model, u), atol=1e-9)
    # Products of one row and of many may be summed in another order.
    np.testing.assert_allclose(model.outputs(u[2, 7]), model.outputs(u)[2, 7], rtol=1e-12)


def test_beyond_what_was_flown_it_holds(model):
    u = flown()[0][0, :1].repeat(2, axis=0)
    u[0, 0], u[1, 0] = 80.0, 120.0
    u[0, 1], u[1, 1] = u[:, 1].max() + 1e5, u[:, 1].max() + 2e5
    np.testing.assert_array_equal(*model.outputs(u))


def test_what_fills_a_flight_up_counts_nothing():
    u, y = flown()
    full = fit_settled(Flights(signals(y), u[:, :1200], y[:, :1200], np.full(len(u), 1200)))
    filled, wrong = u.copy(), y.copy()
    wrong[:, 1200:] = 7.0
    filled[:, 1200:] = u[:, :400]
    of = Flights(signals(y), filled, wrong, np.full(len(u), 1200))
    here = np.abs(fit_settled(of).outputs(u[:, :1100]) - full.outputs(u[:, :1100]))
    assert here.max() < 0.5


def test_a_condition_that_never_changes_is_none():
    u, y = flown(flights=2)
    u[..., 2] = 0.4
    active = tuple(name for name in INPUTS if name != "Mach")
    limits = (y.min(axis=(0, 1)), y.max(axis=(0, 1)))
    of = Signals(INPUTS, OUTPUTS, DT, "TRA_deg", *limits, (0.0, 80.0), active)
    found = fit_settled(Flights(of, u, y, np.full(2, u.shape[1])))
    assert found.conditions == (1, 3)
    assert np.isfinite(found.outputs(u)).all()


def test_flights_without_any_switch_settle_too():
    u, y = flown()
    u[..., 4:] = 0.0
    y[:] = rest(u)
    still = replace(signals(y), active=INPUTS[:4])
    model = fit_settled(Flights(still, u, y, np.full(len(u), u.shape[1])))
    assert model.switches == ()
    np.testing.assert_allclose(model.outputs(u), _by_features(model, u), atol=1e-9)


def test_a_test_bench_has_no_conditions():
    u, y = flown(flights=2)
    u[..., 1:4] = 0.0
    bench = replace(signals(y), active=("TRA_deg", *INPUTS[4:]))
    model = fit_settled(Flights(bench, u, y, np.full(2, u.shape[1])))
    assert model.conditions == ()
    assert np.isfinite(model.outputs(u)).all()
