"""Noise estimated from data, and what a noise model refuses to be."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from narxcal.calibration.fuser import KalmanFuser
from narxcal.calibration.noise import NoiseModel, _likelihood, estimate_noise
from narxcal.support.errors import DataError, ModelError


def record(time, seed, *, linger=0.8, measurement=0.3):
    retention, process, motion = 0.99, 0.01, 0.5
    rng = np.random.default_rng(seed)
    moving = (np.arange(time) // 50) % 4 == 0
    p = 60.0 + np.cumsum(rng.normal(size=time) * moving)
    a = lfilter([1.0 - linger], [1.0, -linger], np.diff(p, prepend=p[0]) ** 2)
    w = rng.normal(size=time) * np.sqrt(process + motion * a)
    b = np.zeros(time)
    for k in range(1, time):
        b[k] = retention * b[k - 1] + w[k]
    return p, p + b, p + b + rng.normal(size=time) * np.sqrt(measurement)


@pytest.mark.parametrize("measurement", [0.003, 0.3, 30.0])
def test_true_parameters_are_found_at_every_noise_level(measurement):
    p, _, z = record(20_000, 1, measurement=measurement)
    found = estimate_noise(z, p, 0.1)
    assert found.measurement_variance[0] == pytest.approx(measurement, rel=0.1)
    assert found.transient_gain[0] == pytest.approx(0.5, rel=0.35)
    if measurement < 1.0:
        assert found.process_variance[0] == pytest.approx(0.01, rel=0.25)
        assert found.bias_decay[0] == pytest.approx(0.99, abs=0.004)
        assert found.activity_decay[0] == pytest.approx(0.8, abs=0.12)


def test_estimated_noise_makes_the_innovations_consistent():
    p, _, z = record(8_000, 2)
    noise = estimate_noise(z, p, 0.1)
    check = KalmanFuser(noise).run(p[:, None], z[:, None]).consistency()
    assert check.low < check.mean_nis < check.high


def test_missing_samples_do_not_bias_the_estimate():
    p, _, z = record(20_000, 3)
    z[np.random.default_rng(4).random(len(z)) < 0.4] = np.nan
    z[5_000:7_000] = np.nan
    found = estimate_noise(z, p, 0.1)
    assert found.measurement_variance[0] == pytest.approx(0.3, rel=0.1)
    assert found.process_variance[0] == pytest.approx(0.01, rel=0.4)


def test_records_are_never_joined_across_their_border():
    first, second = record(6_000, 5), record(6_000, 6)
    far = (second[0] + 500.0, second[2] + 470.0)
    found = estimate_noise([first[2], far[1]], [first[0], far[0]], 0.1)
    alone = estimate_noise(first[2], first[0], 0.1)
    assert found.measurement_variance[0] == pytest.approx(alone.measurement_variance[0], rel=0.1)
    joined = estimate_noise(
        np.concatenate([first[2], far[1]]), np.concatenate([first[0], far[0]]), 0.1
    )
    assert (
        found.process_variance[0]
        < 2.0 * alone.process_variance[0]
        < joined.process_variance[0] + joined.transient_gain[0]
    )


def test_an_error_that_is_smooth_from_sample_to_sample_still_returns_to_the_model():
    """At 16 Hz a smooth error that lasts 10 s looks like a random walk, its means over 1 s do not.

    A fuser that took it for one would keep the last error for as long as nothing is measured.
    """
    draw, time, dt_s = np.random.default_rng(7), 16_000, 1.0 / 16.0
    lasting = np.exp(-dt_s / 10.0)
    b = lfilter([np.sqrt(1.0 - lasting**2)], [1.0, -lasting], draw.normal(size=time))
    b = np.convolve(b, np.ones(8) / 8.0, mode="same")
    p = 60.0 + np.zeros(time)
    z = p + b + 0.003 * draw.normal(size=time)
    noise = estimate_noise(z, p, dt_s)
    assert 5.0 < -dt_s / np.log(noise.bias_decay[0]) < 20.0
    hidden = np.arange(time) * dt_s % 60.0 >= 30.0
    seen = np.where(hidden, np.nan, z)
    fused = KalmanFuser(noise).run(p[:, None], seen[:, None])
    assert np.std((fused.values[:, 0] - p - b)[hidden]) < np.std(b[hidden])


def test_channels_are_estimated_one_by_one():
    a, b = record(4_000, 7), record(4_000, 8, measurement=3.0)
    both = estimate_noise(np.column_stack([a[2], b[2]]), np.column_stack([a[0], b[0]]), 0.1)
    for i, each in enumerate((a, b)):
        one = estimate_noise(each[2], each[0], 0.1)
        assert both.measurement_variance[i] == pytest.approx(one.measurement_variance[0])
        assert both.process_variance[i] == pytest.approx(one.process_variance[0])


def test_scale_of_a_channel_does_not_matter():
    p, _, z = record(4_000, 9)
    one, other = estimate_noise(z, p, 0.1), estimate_noise(1e3 * z, 1e3 * p, 0.1)
    assert other.measurement_variance[0] == pytest.approx(
        1e6 * one.measurement_variance[0], rel=1e-2
    )
    assert other.transient_gain[0] == pytest.approx(one.transient_gain[0], rel=2e-2)


def test_a_perfect_sensor_and_a_perfect_model_give_finite_noise():
    p, y, _ = record(2_000, 10)
    exact = estimate_noise(y, p, 0.1)
    assert exact.measurement_variance[0] < 1e-3
    same = estimate_noise(p, p, 0.1)
    assert np.isfinite(same.process_variance).all()
    still = estimate_noise(np.full(200, 5.0), np.full(200, 4.0), 0.1)
    run = KalmanFuser(still).run(np.full((200, 1), 4.0), np.full((200, 1), 5.0))
    assert run.values[-1, 0] == pytest.approx(5.0, abs=0.05)


def test_compiled_likelihood_is_the_plain_one():
    p, _, z = record(400, 11)
    z[100:130] = np.nan
    starts = np.arange(400) % 200 == 0
    arguments = (z - p, np.diff(p, prepend=p[0]), starts, np.array([0.97, 0.2, 0.5, 0.8]))
    np.testing.assert_allclose(_likelihood(*arguments), _likelihood.py_func(*arguments), rtol=1e-12)


def test_too_few_samples_are_refused_by_name():
    z = np.full((100, 2), np.nan)
    z[:, 0] = np.arange(100.0)
    z[:49, 1] = 1.0
    with pytest.raises(DataError) as error:
        estimate_noise(z, np.zeros((100, 2)), 0.1, names=("N1_pct", "N2_pct"))
    assert str(error.value) == (
        "channel N2_pct: the noise of a channel needs 50 measured samples, found 49. "
        "Leave the channel out of the fuser, or fuse a longer log"
    )


def test_records_of_different_shape_are_refused():
    with pytest.raises(DataError) as error:
        estimate_noise(np.zeros((60, 2)), np.zeros((61, 2)), 0.1)
    assert str(error.value) == (
        "measured and predicted differ in shape: [(60, 2)] against [(61, 2)]"
    )


@pytest.fixture
def model():
    p, _, z = record(1_000, 12)
    return estimate_noise(z, p, 0.1)


def test_a_noise_model_survives_json(model):
    again = NoiseModel.from_dict(json.loads(json.dumps(model.to_dict())))
    assert again.to_dict() == model.to_dict()


def test_a_noise_model_that_is_no_table_of_numbers_is_refused(model):
    message = (
        "the fuser's noise model is no table of numbers: could not convert string to float: 'x'. "
        "Train the model again, or let the fuser estimate its noise from the log"
    )
    with pytest.raises(ModelError) as error:
        NoiseModel.from_dict({**model.to_dict(), "motion": ["x"]})
    assert str(error.value) == message


def test_an_incomplete_noise_model_is_refused(model):
    table = model.to_dict()
    del table["motion"], table["spread"]
    with pytest.raises(ModelError) as error:
        NoiseModel.from_dict(table)
    assert str(error.value) == (
        "the fuser's noise model lacks motion, spread. "
        "Train the model again, or let the fuser estimate its noise from the log"
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"measurement_variance": np.zeros(1)},
            "the measurement variance of a fuser must be positive",
        ),
        (
            {"bias_decay": np.array([1.5])},
            "the bias decay and activity decay of a fuser must not exceed 1",
        ),
        (
            {"activity_decay": np.array([2.0])},
            "the bias decay and activity decay of a fuser must not exceed 1",
        ),
        (
            {"process_variance": np.zeros(2)},
            "the fuser's process variance should have shape (1,), found (2,)",
        ),
        (
            {"transient_gain": np.array([-1.0])},
            "the fuser's transient gain must be finite and at least 0, found [-1.]",
        ),
        (
            {"initial_variance": np.array([np.nan])},
            "the fuser's initial variance must be finite and at least 0, found [nan]",
        ),
    ],
)
def test_an_impossible_noise_model_is_refused(model, change, message):
    with pytest.raises(ModelError) as error:
        replace(model, **change)
    assert str(error.value) == message
