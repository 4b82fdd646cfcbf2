"""The step-wise Kalman fuser and its compiled twin."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from narxcal.calibration.fuser import (
    FastFuser,
    FusedRun,
    Fuser,
    FuserConfig,
    KalmanFuser,
)
from narxcal.calibration.noise import NoiseModel
from narxcal.support.errors import DataError, ModelError

BOTH = pytest.mark.parametrize("kind", [KalmanFuser, FastFuser])


def noise(n_out=3, **parts):
    values = {
        "bias_decay": 0.98,
        "process_variance": 0.04,
        "transient_gain": 0.3,
        "activity_decay": 0.6,
        "measurement_variance": 0.25,
        "initial_variance": 1.0,
    } | parts
    arrays = {name: np.full(n_out, value, dtype=float) for name, value in values.items()}
    return NoiseModel(dt_s=0.1, **arrays)


def simulated(model, time, seed):
    """A prediction, the truth and a measurement that obey `model` exactly."""
    rng = np.random.default_rng(seed)
    n_out = len(model.bias_decay)
    p = np.cumsum(rng.normal(size=(time, n_out)) * (rng.random((time, 1)) < 0.2), axis=0)
    b = rng.normal(size=n_out) * np.sqrt(model.initial_variance)
    y, a = [p[0] + b], np.zeros(n_out)
    for k in range(1, time):
        a = model.activity_decay * a + (1.0 - model.activity_decay) * (p[k] - p[k - 1]) ** 2
        q = model.process_variance + model.transient_gain * a
        b = model.bias_decay * b + rng.normal(size=n_out) * np.sqrt(q)
        y.append(p[k] + b)
    y = np.array(y)
    return p, y, y + rng.normal(size=y.shape) * np.sqrt(model.measurement_variance)


def textbook(model, p, z):
    """Kalman filter as in the textbooks: full matrices, dense inverse, P = (I - K H) P."""
    n = p.shape[1]
    x, P, F = p[0].copy(), np.diag(model.initial_variance), np.diag(model.bias_decay)
    a = np.zeros(n)
    values, variances = [], []
    for k in range(len(p)):
        if k:
            x = F @ x + p[k] - F @ p[k - 1]
            a = model.activity_decay * a + (1.0 - model.activity_decay) * (p[k] - p[k - 1]) ** 2
            P = F @ P @ F.T + np.diag(model.process_variance + model.transient_gain * a)
        seen = ~np.isnan(z[k])
        if seen.any():
            H = np.eye(n)[seen]
            S = H @ P @ H.T + np.diag(model.measurement_variance[seen])
            K = P @ H.T @ np.linalg.inv(S)
            x = x + K @ (z[k][seen] - H @ x)
            P = (np.eye(n) - K @ H) @ P
        values.append(x)
        variances.append(np.diag(P))
    return np.array(values), np.array(variances)


def with_holes(z, seed, share=0.3):
    rng = np.random.default_rng(seed)
    z = z.copy()
    z[rng.random(z.shape) < share] = np.nan
    return z


def assert_same(one: FusedRun, other: FusedRun):
    for name in ("values", "innovations", "variances", "nis"):
        np.testing.assert_allclose(
            getattr(one, name), getattr(other, name), rtol=1e-9, atol=1e-9, err_msg=name
        )
    for name in ("gated", "relocked", "used"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


@BOTH
def test_equals_a_textbook_filter_with_samples_missing_per_channel(kind):
    model = noise()
    p, _, z = simulated(model, 300, seed=1)
    z = with_holes(z, 2)
    run = kind(model, FuserConfig(gate_probability=1.0 - 1e-15)).run(p, z)
    values, variances = textbook(model, p, z)
    np.testing.assert_allclose(run.values, values, atol=1e-10)
    np.testing.assert_allclose(run.variances, variances, atol=1e-10)


def test_equals_statsmodels_state_space_filter():
    tsa = pytest.importorskip("statsmodels.tsa.statespace.kalman_filter")
    model = noise(transient_gain=0.0)
    p, _, z = simulated(model, 200, seed=3)
    z = with_holes(z, 4)
    other = tsa.KalmanFilter(k_endog=3, k_states=3)
    other.bind(np.asfortranarray((z - p).T))
    other["design"] = other["selection"] = np.eye(3)
    other["transition"] = np.diag(model.bias_decay)
    other["state_cov"] = np.diag(model.process_variance)
    other["obs_cov"] = np.diag(model.measurement_variance)
    other.initialize_known(np.zeros(3), np.diag(model.initial_variance))
    theirs = other.filter().filtered_state.T + p
    run = KalmanFuser(model, FuserConfig(gate_probability=1.0 - 1e-15)).run(p, z)
    np.testing.assert_allclose(run.values, theirs, atol=1e-8)


@given(
    n_out=st.integers(1, 4),
    time=st.integers(1, 60),
    seed=st.integers(0, 2**16),
    share=st.floats(0.0, 1.0),
    spikes=st.floats(0.0, 0.2),
)
def test_compiled_twin_shows_the_same_numbers_with_holes_spikes_and_steps(
    n_out, time, seed, share, spikes
):
    model = noise(n_out)
    p, _, z = simulated(model, time, seed)
    rng = np.random.default_rng(seed)
    z = with_holes(z, seed, share)
    z[rng.random(z.shape) < spikes] += 40.0
    z[time // 2 :, 0] -= 30.0
    assert_same(
        KalmanFuser(model, FuserConfig(relock_s=0.5)).run(p, z),
        FastFuser(model, FuserConfig(relock_s=0.5)).run(p, z),
    )


@BOTH
@given(cut=st.integers(1, 39))
@settings(max_examples=15)
def test_run_is_reset_then_steps_however_it_is_cut(kind, cut):
    model = noise()
    p, _, z = simulated(model, 40, seed=5)
    whole = kind(model).run(p, z)
    fuser: Fuser = kind(model)
    first = fuser.reset(p[0], z[0])
    steps = [first] + [fuser.step(p[k], z[k]) for k in range(1, cut)]
    rest = fuser.extend(p[cut:], z[cut:])
    np.testing.assert_array_equal(
        whole.values, np.concatenate([[s.value for s in steps], rest.values])
    )
    np.testing.assert_array_equal(whole.nis, np.concatenate([[s.nis for s in steps], rest.nis]))


@BOTH
def test_a_channel_never_measured_follows_the_prediction_and_harms_no_other(kind):
    model = noise()
    p, _, z = simulated(model, 100, seed=6)
    alone = kind(model).run(p, z)
    z[:, 1] = np.nan
    run = kind(model).run(p, z)
    np.testing.assert_allclose(run.values[:, 1], p[:, 1], atol=1e-12)
    np.testing.assert_allclose(run.values[:, [0, 2]], alone.values[:, [0, 2]], atol=1e-12)
    assert np.isnan(run.innovations[:, 1]).all()
    assert np.isfinite(run.values).all()


@BOTH
def test_an_infinite_reading_counts_as_missing(kind):
    model = noise()
    p, _, z = simulated(model, 10, seed=7)
    z[4, 0] = np.inf
    holed = z.copy()
    holed[4, 0] = np.nan
    np.testing.assert_array_equal(kind(model).run(p, z).values, kind(model).run(p, holed).values)


@BOTH
def test_a_static_error_of_the_model_is_taken_off(kind):
    p = np.full((400, 1), 70.0)
    z = p + 1.5
    run = kind(noise(1, bias_decay=0.9999, process_variance=1e-6)).run(p, z)
    assert run.values[-1, 0] == pytest.approx(71.5, abs=0.05)


@BOTH
def test_single_spikes_are_gated_counted_and_leave_no_trace(kind):
    model = noise(1)
    p, _, z = simulated(model, 200, seed=9)
    holed = z.copy()
    z[[50, 51, 120]] += 30.0
    holed[[50, 51, 120]] = np.nan
    fuser = kind(model)
    run = fuser.run(p, z)
    assert np.flatnonzero(run.gated[:, 0]).tolist() == [50, 51, 120]
    assert fuser.gated_samples.tolist() == [3]
    np.testing.assert_array_equal(run.values, kind(model).run(p, holed).values)


@BOTH
def test_a_real_step_is_rejected_for_the_stated_time_only(kind):
    model = noise(1, bias_decay=1.0, process_variance=1e-6, transient_gain=0.0)
    p, z = np.zeros((100, 1)), np.zeros((100, 1))
    z[50:] = 20.0
    run = kind(model, FuserConfig(relock_s=0.8)).run(p, z)
    assert np.flatnonzero(run.gated[:, 0]).tolist() == list(range(50, 58))
    assert np.flatnonzero(run.relocked[:, 0]).tolist() == [57]
    np.testing.assert_allclose(run.values[50:57], 0.0, atol=1e-9)
    np.testing.assert_allclose(run.values[57:], 20.0, atol=0.1)


@BOTH
@pytest.mark.parametrize("every", [2, 7, 40])
def test_a_real_step_of_a_slow_channel_is_rejected_for_the_stated_time_only(kind, every):
    model = noise(1, bias_decay=1.0, process_variance=1e-6, transient_gain=0.0)
    p, z = np.zeros((400, 1)), np.full((400, 1), np.nan)
    z[::every] = np.where(np.arange(0, 400, every) < 100, 0.0, 20.0)[:, None]
    run = kind(model, FuserConfig(relock_s=0.8)).run(p, z)
    first = -(-100 // every) * every
    later = max(1, -(-7 // every)) * every  # the first measurement when 0.8 s have gone by
    assert np.flatnonzero(run.relocked[:, 0]).tolist() == [first + later]
    np.testing.assert_allclose(run.values[first + later :], 20.0, atol=0.1)


@BOTH
def test_spikes_to_both_sides_never_relock(kind):
    model = noise(1, bias_decay=1.0, process_variance=1e-6, transient_gain=0.0)
    p, z = np.zeros((100, 1)), np.zeros((100, 1))
    z[50:] = 20.0 * (-1.0) ** np.arange(50)[:, None]
    run = kind(model, FuserConfig(relock_s=0.5)).run(p, z)
    assert not run.relocked.any()
    np.testing.assert_allclose(run.values, 0.0, atol=1e-9)


@BOTH
def test_innovations_of_a_true_model_are_consistent(kind):
    model = noise()
    p, y, z = simulated(model, 4000, seed=10)
    z = with_holes(z, 11)
    run = kind(model).run(p, z)
    check = run.consistency()
    assert check.low < check.mean_nis < check.high
    assert check.measurements == np.isfinite(z[1:]).sum()
    assert kind(noise(measurement_variance=0.1)).run(p, z).consistency().mean_nis > check.high
    # The variance it states is the error it makes.
    assert np.mean((run.values - y) ** 2 / run.variances) == pytest.approx(1.0, abs=0.05)


@BOTH
def test_the_fused_value_beats_both_sources(kind):
    model = noise()
    p, y, z = simulated(model, 3000, seed=12)
    run = kind(model).run(p, z)

    def rmse(a):
        return np.sqrt(np.mean((a - y) ** 2, axis=0))

    assert (rmse(run.values) < rmse(z)).all()
    assert (rmse(run.values) < rmse(p)).all()


@BOTH
def test_ill_scaled_covariance_stays_symmetric_and_positive(kind):
    model = noise(measurement_variance=1e-12, process_variance=1e6, transient_gain=0.0)
    rng = np.random.default_rng(13)
    p = np.cumsum(rng.normal(size=(2000, 3)), axis=0)
    run = kind(model).run(p, p + 1e3 * rng.normal(size=p.shape))
    assert (run.variances >= 0.0).all()
    assert np.isfinite(run.values).all()


@BOTH
def test_a_step_before_the_first_reset_is_refused(kind):
    fuser = kind(noise())
    with pytest.raises(ModelError) as error:
        fuser.step(np.zeros(3), np.zeros(3))
    assert str(error.value) == "the fuser was not started. Call reset with the first sample"


@BOTH
def test_a_prediction_that_is_not_finite_is_refused(kind):
    fuser = kind(noise(2))
    with pytest.raises(ModelError) as error:
        fuser.reset(np.array([1.0, np.nan]), np.zeros(2))
    assert str(error.value) == "the prediction to fuse is not finite: [ 1. nan]"
    with pytest.raises(ModelError, match="not finite"):
        fuser.run(np.full((3, 2), np.inf), np.zeros((3, 2)))


@BOTH
def test_a_value_whose_square_is_no_number_is_refused_and_not_followed(kind):
    fuser = kind(noise(2))
    fuser.reset(np.zeros(2), np.zeros(2))
    with pytest.raises(DataError) as error:
        fuser.step(np.zeros(2), np.array([0.0, 1e300]))
    assert str(error.value) == (
        "row 0: a measurement to fuse is 1e+300, beyond 1e+100. "
        "Scale the channel, or mask by NaN what is no measurement"
    )
    predictions = np.zeros((4, 2))
    predictions[3, 1] = -1e300
    with pytest.raises(DataError, match=r"^row 3: a prediction to fuse is -1e\+300"):
        fuser.run(predictions, np.zeros((4, 2)))
    assert fuser.step(np.zeros(2), np.zeros(2)).value.tolist() == [0.0, 0.0]


@BOTH
def test_wrong_shapes_are_refused(kind):
    fuser = kind(noise(2))
    with pytest.raises(DataError) as error:
        fuser.reset(np.zeros(3), np.zeros(2))
    assert str(error.value) == (
        "expected a prediction and a measurement of 2 channels, found shapes (3,) and (2,)"
    )
    with pytest.raises(DataError) as error:
        fuser.run(np.zeros((4, 2)), np.zeros((5, 2)))
    assert str(error.value) == (
        "expected predictions and measurements (time, 2), found (4, 2) and (5, 2)"
    )
    with pytest.raises(DataError) as error:
        fuser.run(np.zeros((0, 2)), np.zeros((0, 2)))
    assert str(error.value) == "there is no sample to fuse"


def test_consistency_of_nothing_is_refused():
    run = KalmanFuser(noise(1)).run(np.zeros((5, 1)), np.full((5, 1), np.nan))
    with pytest.raises(DataError) as error:
        run.consistency()
    assert str(error.value) == (
        "the consistency of a fuser cannot be checked: nothing was measured"
    )
