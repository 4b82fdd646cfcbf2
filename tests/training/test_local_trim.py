"""The static error leaves the training data, the dynamics stay."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from training.records import locally_trimmed


def lagged(steady, pole=0.9):
    y = steady.copy()
    for k in range(1, len(y)):
        y[k] = pole * y[k - 1] + (1 - pole) * steady[k]
    return y


def step_record():
    truth = np.where(np.arange(600) < 300, 40.0, 90.0)
    y = lagged(truth)
    still = np.ones(600, dtype=bool)
    still[290:500] = False
    return truth[:, None], y[:, None], still


def test_a_static_error_that_differs_before_and_after_a_step_is_taken_out():
    truth, y, still = step_record()
    wrong = truth + np.where(truth < 50, 3.0, -2.0)
    np.testing.assert_allclose(locally_trimmed(wrong, y, still), truth, atol=1e-6)


def test_a_perfect_steady_state_model_is_left_alone():
    truth, y, still = step_record()
    np.testing.assert_allclose(locally_trimmed(truth, y, still), truth, atol=1e-6)


def test_the_shift_follows_the_steady_value_and_not_the_clock():
    truth = np.interp(np.arange(600), [250, 450], [40.0, 90.0])[:, None]
    error = (truth - 40.0) * 0.1
    still = (np.arange(600) < 240) | (np.arange(600) > 520)
    np.testing.assert_allclose(locally_trimmed(truth + error, truth, still), truth, atol=1e-9)


def test_without_a_still_sample_or_a_measurement_nothing_is_shifted():
    truth, y, _ = step_record()
    never = np.zeros(600, dtype=bool)
    np.testing.assert_array_equal(locally_trimmed(truth, y, never), truth)
    unknown = np.full_like(y, np.nan)
    np.testing.assert_array_equal(locally_trimmed(truth, unknown, ~never), truth)


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 10_000), share=st.floats(0.01, 0.9))
def test_at_still_samples_steady_value_and_measurement_agree(seed, share):
    rng = np.random.default_rng(seed)
    ss = np.cumsum(rng.normal(size=(200, 2)), axis=0)
    y = ss + rng.normal(size=(200, 2))
    still = rng.random(200) < share
    trimmed = locally_trimmed(ss, y, still)
    np.testing.assert_allclose(trimmed[still], y[still], atol=1e-9)
    assert np.isfinite(trimmed).all()
