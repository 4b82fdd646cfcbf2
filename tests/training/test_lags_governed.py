"""Fitting lags behind a control that holds N1: what is known comes back."""

import numpy as np
import pytest

from narxcal.support.errors import DataError, ModelError
from training.dynamics.lag_priors import Form, start_engine
from training.dynamics.lags import fit_engine, scales_of
from training.records import LagSamples

NAMES = (("ALT_ft", "Mach"), ("N1_pct", "N2_pct", "EGT_C"))
CENTRE, HALF = np.array([62.0, 75.0, 520.0]), np.array([35.0, 20.0, 240.0])
DT_S, FORM = 0.1, Form(governed=True)


def steady(seed, moves=14):
    """Inputs and steady-state values: the lever moves every 15 s, at all altitudes."""
    rng = np.random.default_rng(seed)
    part = np.repeat([-1.0, 1.0, *rng.uniform(-1.0, 1.0, moves)], 150)
    part = np.convolve(np.pad(part, 4, "edge"), np.ones(9) / 9, "valid")[:, None]
    height = np.repeat(rng.uniform(0.0, 1.0, moves + 2), 150)
    return np.column_stack([36000.0 * height, 0.8 * height]), CENTRE + HALF * part


def truth():
    """An engine that is not the one the fit starts from."""
    scales = {"centre": CENTRE, "half": HALF, "limit": np.full(3, 1e3)}
    engine, _ = start_engine(NAMES[1], FORM, scales)
    arrays = engine.arrays
    arrays["lines"][0, 0] += 0.3  # a slower core
    arrays["lines"][4, 0] -= 0.4  # that may not accelerate as fast
    arrays["lines"][6, 0] += 0.2  # a heavier fan
    arrays["lines"][8, 0] -= 0.5  # a faster probe
    arrays["heat"][2, 0] = 0.12
    arrays["extra"][1] = 0.5  # where open clearances cost more
    return engine


def log(seed, noise=0.0):
    inputs, ss = steady(seed)
    model = truth()
    lag = model.deviations(model.drive(inputs, NAMES[0], ss), np.zeros(3), DT_S)
    rng = np.random.default_rng(seed)
    return LagSamples(inputs, ss, ss - lag + noise * rng.normal(size=ss.shape) * [1.0, 1.0, 10.0])


def off(model, seed=9):
    """RMS error over a log that it has not seen, as a share of the half range."""
    new = log(seed)
    lag = model.deviations(model.drive(new.inputs, NAMES[0], new.ss), np.zeros(3), DT_S)
    return np.sqrt(np.mean(((new.ss - lag - new.measured) / HALF) ** 2, axis=0))


def test_an_unseen_log_is_followed():
    samples = [log(seed, noise=0.02) for seed in (0, 1)]
    begun, _ = start_engine(NAMES[1], FORM, scales_of(samples, NAMES[0]))
    model = fit_engine(samples, NAMES, DT_S, FORM)
    assert (off(begun) > 0.08).all()
    assert (off(model) < 0.4 * off(begun)).all()
    assert model.arrays["extra"][1] == pytest.approx(0.5, abs=0.2)


def test_threads_change_no_number():
    one, two = (fit_engine([log(1)], NAMES, DT_S, FORM, threads) for threads in (1, 2))
    for name, array in one.to_arrays()[1].items():
        np.testing.assert_array_equal(array, two.to_arrays()[1][name])


def test_masked_samples_are_left_out():
    holed = log(0)
    holed.measured[500:700, 0] = np.nan
    assert np.isfinite(fit_engine([holed], NAMES, DT_S, FORM).theta).all()


def test_engines_that_never_move_are_refused():
    one = log(0)
    still = LagSamples(one.inputs[:300] * 0.0, one.ss[:1].repeat(300, 0), one.ss[:1].repeat(300, 0))
    with pytest.raises(DataError, match="the outputs never move"):
        fit_engine([still], NAMES, DT_S, FORM)


def test_an_engine_without_a_fan_is_refused():
    one = log(0)
    one = LagSamples(one.inputs, one.ss[:, 1:], one.measured[:, 1:])
    with pytest.raises(ModelError, match="the speeds of a fan and a core"):
        fit_engine([one], (NAMES[0], NAMES[1][1:]), DT_S, FORM)


def held_lever(seed, length=600):
    """Samples (1 Hz) of a lever in its detents while an autothrottle moves the engine."""
    random = np.random.default_rng(seed)
    lever = np.repeat(random.choice([0.0, 25.0, 25.0, 35.0, 45.0, 60.0], length // 30), 30)
    altitude = np.interp(np.arange(length), [0, 200, 400, 600], [0.0, 39e3, 39e3, 0.0])
    air = np.stack([lever, altitude, altitude / 5e4, 0.0 * altitude], axis=1)
    ss = np.array([20.0, 55.0, 300.0]) + lever[:, None] / 60.0 * np.array([80.0, 45.0, 600.0])
    measured = np.roll(ss, 50, axis=0) + random.normal(0.0, 30.0, ss.shape)
    return LagSamples(air, ss, measured)


def test_an_engine_that_its_lever_does_not_move_gives_no_overflow():
    """Slopes of unstable trials grow without bound; warnings are errors here."""
    names = (("TRA_deg", "ALT_ft", "Mach", "dT_C"), ("N1_pct", "N2_pct", "EGT_C"))
    found = fit_engine([held_lever(1), held_lever(2)], names, 1.0, Form(governed=True))
    assert np.isfinite(found.theta).all()
