"""What lags and network are fitted to: the dynamics without the static error, motion, rest."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from narxcal.narx.config import NarxConfig
from narxcal.record import Record
from training.config import TrainConfig
from training.dynamics.network import Material, fit_narx
from training.records import largest, locally_trimmed, motion_weight, rest_records

DT_S = 0.1


def slam(level=50.0, top=100.0, steps=600, at=300):
    """Outputs that jump at once: steady state and engine alike."""
    return np.where(np.arange(steps)[:, None] < at, level, top) * np.ones((1, 2))


def test_motion_counts_more_than_rest_and_its_beginning_most():
    one = slam()
    weight = motion_weight(one, one, largest([one]), DT_S)
    rest, onset, settling = weight[100] * 0.5, weight[305] * 1.0, weight[400] * 1.0
    assert onset == pytest.approx(4.0)
    assert settling == pytest.approx(1.0)
    assert rest == pytest.approx(0.4)
    # One second before the move counts as motion, and twelve behind it.
    assert weight[292] * 0.5 >= 1.0
    assert weight[280] * 0.5 == pytest.approx(0.4)
    assert weight[440] == pytest.approx(0.4)


def test_what_follows_another_move_at_once_is_no_beginning():
    one = slam()
    one[320:] = 60.0
    weight = motion_weight(one, one, largest([one]), DT_S)
    assert weight[322] * 0.6 == pytest.approx(1.0)


def test_low_power_counts_by_what_a_share_of_it_is_but_not_without_end():
    low, high = slam(20.0, 30.0), slam(90.0, 100.0)
    scale = largest([low, high])
    assert motion_weight(high, high, scale, DT_S)[400] == pytest.approx(1.0)
    assert motion_weight(low, low, scale, DT_S)[400] == pytest.approx(1.0 / 0.3)


def test_an_output_that_is_not_known_counts_as_its_steady_state():
    one = slam()
    holed = np.where(np.arange(600)[:, None] % 7 == 0, np.nan, one)
    scale = largest([one])
    known = motion_weight(one, one, scale, DT_S)
    np.testing.assert_allclose(motion_weight(one, holed, scale, DT_S), known)


def test_an_engine_that_never_moves_is_at_rest_throughout():
    one = np.full((50, 2), 80.0)
    np.testing.assert_allclose(motion_weight(one, one, largest([one]), DT_S), 0.4)


def test_far_rest_records_begin_at_large_deviations_and_are_scored_for_half():
    deviation = np.where(np.arange(1000) % 100 == 0, 5.0, 0.01)[:, None]
    record = Record(np.zeros((1000, 2)), deviation)
    near, far = (rest_records([record], 1, 40, seed=3, far=far) for far in (False, True))
    assert len(far) == 300
    share = np.mean([abs(rest.y[0, 0]) > 1.0 for rest in far])
    assert share > 0.7
    assert share > 5.0 * np.mean([abs(rest.y[0, 0]) > 1.0 for rest in near])
    assert all(np.isnan(rest.y[1:20]).all() and (rest.y[20:] == 0.0).all() for rest in far)


def moving_record(seed=0, steps=600):
    rng = np.random.default_rng(seed)
    ss = np.repeat(rng.uniform(0, 1, steps // 30), 30)
    y = np.zeros(steps)
    rise = np.diff(ss, prepend=ss[0])
    for k in range(1, steps):
        y[k] = 0.9 * (y[k - 1] + rise[k])
    return Record(np.column_stack([rise, ss]), y)


def test_a_rest_record_stands_still_starts_displaced_and_ends_at_zero():
    record = moving_record()
    drawn = rest_records([record], moving=1, steps=40, seed=3)
    assert len(drawn) == 60
    for rest in drawn:
        assert (rest.u[:, 0] == 0.0).all()
        assert (rest.u == rest.u[0]).all()
        assert np.isfinite(rest.y[0]).all()
        assert np.isnan(rest.y[1:30]).all()
        assert (rest.y[30:] == 0.0).all()
    assert any(abs(rest.y[0, 0]) > 0.1 for rest in drawn)


def test_the_same_seed_draws_the_same_records():
    record = moving_record()
    one, other = (rest_records([record], 1, 20, seed=7) for _ in range(2))
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a.u, b.u)
        np.testing.assert_array_equal(a.y, b.y)


def test_rest_records_take_part_only_where_the_horizon_holds_them():
    record = moving_record()
    material = Material([record], [], 1.0, rest_records([record], 1, 40, seed=0))
    assert len(material.within(20.0)) == 1
    assert len(material.within(40.0)) == 61
    assert len(material.within(0.0)) == 61


def test_a_network_shown_rest_comes_to_rest_from_a_deviation_no_flight_had():
    record = moving_record()
    rest = rest_records([record], 1, 60, seed=0)
    config = TrainConfig(horizons_s=(60.0,), iterations=(15,), score_every_s=1.0)
    structure = NarxConfig(lags=1, taps=(0,), hidden=4, moving=1)
    model = fit_narx(Material([record], [], 1.0, rest), structure, config).model
    low, high = model.bounds
    for start in (0.9 * low, 0.9 * high):
        for level in (0.0, 0.5, 1.0):
            y = model.simulate(np.tile([0.0, level], (300, 1)), start)
            assert abs(y[-1, 0]) < 0.02


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


@given(seed=st.integers(0, 10_000), share=st.floats(0.01, 0.9))
def test_at_still_samples_steady_value_and_measurement_agree(seed, share):
    rng = np.random.default_rng(seed)
    ss = np.cumsum(rng.normal(size=(200, 2)), axis=0)
    y = ss + rng.normal(size=(200, 2))
    still = rng.random(200) < share
    trimmed = locally_trimmed(ss, y, still)
    np.testing.assert_allclose(trimmed[still], y[still], atol=1e-9)
    assert np.isfinite(trimmed).all()
