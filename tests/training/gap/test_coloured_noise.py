"""Coloured noise: whitened by its own model, and back; its components recovered."""

import numpy as np
import pytest
from scipy.signal import lfilter

from training.gap.coloured_noise import Noise, colour, fit_noise, gains, whiten
from training.gap.switching import best_path

PHI = float(np.exp(-1.0 / 12.0))


def made(seed, blocks=600, channels=2, flights=3):
    """Markov noise of variance 1 and 12 blocks, and white noise of variance 0.25."""
    random = np.random.default_rng(seed)
    drive = np.sqrt(1.0 - PHI**2) * random.standard_normal((flights, blocks, channels))
    markov = lfilter([1.0], [1.0, -PHI], drive, axis=1)
    return markov + 0.5 * random.standard_normal(markov.shape)


def model(values):
    """The noise that `made` makes, without a walk."""
    ones = np.ones(values.shape[2])
    parts = (PHI * ones, (1.0 - PHI**2) * ones, 1e-9 * ones, 0.25 * ones)
    return Noise(*parts, np.eye(len(ones)), np.ones(values.shape[:2]))


def test_what_is_whitened_can_be_coloured_again():
    values = made(0)
    share = np.ones_like(values)
    share[1, 100:140] = 0.0
    noise = fit_noise(values, share)
    found = gains(noise, share)
    back = colour(whiten(values, found, noise), found, noise)
    known = share > 0.0
    np.testing.assert_allclose(back[known], values[known], atol=1e-9)
    assert (back[~known] == 0.0).all()


def test_innovations_of_the_true_noise_are_white_and_of_unit_size():
    values = made(1, blocks=4000)
    noise = model(values)
    innovations = whiten(values, gains(noise, np.ones_like(values)), noise)[:, 50:]
    assert np.std(innovations) == pytest.approx(1.0, abs=0.02)
    together = np.mean(innovations[:, 1:] * innovations[:, :-1])
    assert together == pytest.approx(0.0, abs=0.02)


def test_components_are_recovered():
    noise = fit_noise(made(2, blocks=6000), np.ones((3, 6000, 2)))
    np.testing.assert_allclose(noise.white, 0.25, rtol=0.3)
    np.testing.assert_allclose(noise.markov / (1.0 - noise.phi**2), 1.0, rtol=0.4)
    np.testing.assert_allclose(-1.0 / np.log(noise.phi), 12.0, rtol=0.5)


def test_the_best_path_is_that_of_the_shift():
    values, shift = made(3, blocks=200, flights=1), np.array([6.0, -6.0])
    values[0, 60:120] += shift
    noise = model(values)
    found = gains(noise, np.ones_like(values))
    price, path = best_path(values, shift, found, noise, 20.0)
    on = np.flatnonzero(path == 1)
    np.testing.assert_allclose(on[[0, -1]], [60, 119], atol=4)
    assert (np.diff(on) == 1).all()
    quiet_price, quiet = best_path(values, np.zeros(2), found, noise, 20.0)
    assert price < quiet_price
    assert not (quiet == 1).any()
