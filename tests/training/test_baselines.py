"""Baselines recover the systems they are made for, and travel as JSON."""

import json
import math
from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_prep.log import Log
from narxcal.support.errors import ModelError
from training.dynamics.baselines import (
    Baselines,
    FirstOrderLag,
    Linear,
    Run,
    arx_of,
    fit_baselines,
    linear,
)

DT_S = 0.1


class Steady:
    """Settled N1 = 20 + lever, EGT = 300 + 5 lever."""

    input_names, output_names = ("TRA_deg",), ("N1_pct", "EGT_C")

    def outputs(self, inputs):
        return np.column_stack([20.0 + inputs[:, 0], 300.0 + 5.0 * inputs[:, 0]])


@dataclass
class Calibration:
    steady: Steady = field(default_factory=Steady)
    dt_s: float = DT_S
    input_names: tuple = Steady.input_names
    output_names: tuple = Steady.output_names

    def for_engine(self, _, **__):
        return self

    def settled(self, inputs):
        return self.steady.outputs(inputs)


def slams(seed=0, samples=2000):
    """Random levels, each held for 10 s."""
    levels = np.random.default_rng(seed).uniform(0.0, 80.0, samples // 100)
    return np.repeat(levels, 100)


def log_of(outputs, lever):
    time_s = DT_S * np.arange(len(lever))
    channels = {"TRA_deg": lever, "N1_pct": outputs[:, 0], "EGT_C": outputs[:, 1]}
    return Log("flight.csv", time_s, channels)


def lag_run(push_s, pull_s, steady, start):
    lag = FirstOrderLag(push_s, pull_s)
    members = [lag.member(k, DT_S) for k in range(len(push_s))]
    return np.column_stack([one.simulate(steady, start[k]) for k, one in enumerate(members)])


def lagged(lever, push_s, pull_s):
    settled = Steady().outputs(lever[:, None])
    return lag_run(push_s, pull_s, settled, settled[0])


def test_the_time_constants_of_push_and_pull_are_found():
    lever = slams()
    params = fit_baselines(Calibration(), [log_of(lagged(lever, (0.7, 2.0), (1.6, 0.4)), lever)])
    assert params["first_order"]["push_s"] == pytest.approx([0.7, 2.0], rel=0.01)
    assert params["first_order"]["pull_s"] == pytest.approx([1.6, 0.4], rel=0.01)


def test_a_symmetric_lag_steps_as_its_closed_form():
    lag = lag_run((1.5,), (1.5,), np.full((50, 1), 10.0), [4.0])
    expected = 10.0 - 6.0 * np.exp(-DT_S * np.arange(50) / 1.5)
    np.testing.assert_allclose(lag[:, 0], expected, rtol=1e-12)


@given(seed=st.integers(0, 99), push=st.floats(0.01, 0.99), pull=st.floats(0.01, 0.99))
@settings(max_examples=20)
def test_the_compiled_lag_gives_the_numbers_of_the_plain_one(seed, push, pull):
    settled = np.random.default_rng(seed).normal(size=(300, 1)).cumsum(axis=0)
    push_s, pull_s = (-DT_S / math.log1p(-gain) for gain in (push, pull))
    fast = lag_run((push_s,), (pull_s,), settled, [1.0])[:, 0]
    plain = [1.0]
    for target in settled[1:, 0]:
        ahead = target - plain[-1]
        plain.append(plain[-1] + (push if ahead > 0.0 else pull) * ahead)
    np.testing.assert_allclose(fast, plain, rtol=1e-9)


# Coefficients of two systems: poles, then what increments of the steady value add.
SECOND, FIRST = np.array([1.5, -0.56, -0.9, 0.3]), np.array([0.8, -0.5])


def linear_run(coefficients, steady, start):
    count = len(coefficients)
    members = [linear("arx", k, np.array(c), count) for k, c in enumerate(coefficients)]
    return np.column_stack([one.simulate(steady, start[k]) for k, one in enumerate(members)])


@pytest.mark.parametrize("kind", ["arx", "output_error"])
def test_a_linear_system_is_recovered(kind):
    lever = slams(1)
    steady = Steady().outputs(lever[:, None])
    outputs = linear_run((SECOND, FIRST), steady, steady[0])
    found = Baselines.from_json(fit_baselines(Calibration(), [log_of(outputs, lever)]))
    np.testing.assert_allclose(found.simulate(kind, steady, outputs[0], DT_S), outputs, atol=1e-6)


def test_output_error_is_not_biased_by_noise_as_arx_is():
    lever, rng = slams(1), np.random.default_rng(0)
    steady = Steady().outputs(lever[:, None])
    outputs = linear_run((FIRST, FIRST), steady, steady[0])
    noisy = outputs + 5.0 * rng.normal(size=outputs.shape)
    found = Baselines.from_json(fit_baselines(Calibration(), [log_of(noisy, lever)]))
    left = {
        kind: np.abs(found.simulate(kind, steady, outputs[0], DT_S) - outputs).max()
        for kind in ("arx", "output_error")
    }
    assert left["output_error"] < 0.5 * left["arx"]


def test_a_level_of_each_run_is_no_slow_pole():
    runs = []
    for level in (-3.0, 2.0):
        steady = Steady().outputs(slams(int(level) + 9, 600)[:, None])
        runs.append(Run(steady, linear_run((FIRST, FIRST), steady, steady[0]) + level))
    assert arx_of(runs, 0, 1) == pytest.approx(FIRST, abs=1e-9)


@given(
    poles=st.lists(st.floats(-0.95, 0.95), min_size=1, max_size=3),
    moves=st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3),
)
def test_whatever_its_coefficients_a_linear_model_rests_on_the_steady_state(poles, moves):
    fed_back = -np.poly(poles)[1:]
    coefficients = np.concatenate([fed_back, moves[: len(poles)]])
    steady = np.repeat([[20.0], [90.0]], [1, 2000], axis=0)
    assert linear_run([coefficients], steady, [31.0])[-1, 0] == pytest.approx(90.0, abs=1e-6)


def test_a_run_shorter_than_the_order_tells_nothing():
    steady = np.array([[50.0], [60.0], [60.0], [60.0], [40.0], [40.0], [40.0], [40.0]])
    y = linear_run([[0.5, -0.5]], steady, [50.0])
    runs = [Run(steady[:1], y[:1]), Run(steady, y)]
    assert arx_of(runs, 0, 1) == pytest.approx([0.5, -0.5], abs=1e-6)


def test_an_arx_run_is_its_difference_equation():
    steady = np.random.default_rng(2).normal(size=40)
    run = linear_run([[0.5, 0.3, 0.7, -0.2]], steady[:, None], [2.0])[:, 0]
    d, moved = [2.0 - steady[0]] * 2, np.diff(steady, prepend=[steady[0]] * 2)
    for k in range(1, 40):
        d.append(0.5 * d[-1] + 0.3 * d[-2] + 0.7 * moved[k + 1] - 0.2 * moved[k])
    np.testing.assert_allclose(run, steady + d[1:], rtol=1e-12)


def test_an_unstable_arx_is_never_returned():
    lever = slams(3, 400)
    growing = np.exp(0.02 * np.arange(len(lever)))
    params = fit_baselines(Calibration(), [log_of(np.column_stack([growing, growing]), lever)])
    for poles in (*params["arx"]["poles"], *params["output_error"]["poles"]):
        roots = np.roots([1.0, *(-value for value in poles)])
        assert np.all(np.abs(roots) < 1.0)


def test_a_channel_without_a_stable_arx_runs_as_nan():
    none = {"poles": ((),), "gains": ((),), "offsets": (0.0,)}
    linear_models = (Linear(kind, **none) for kind in ("arx", "output_error"))
    found = Baselines(FirstOrderLag((1.0,), (1.0,)), *linear_models, (0.0,), (1.0,))
    assert np.isnan(found.simulate("arx", np.ones((5, 1)), np.array([1.0]), DT_S)).all()


def test_masked_samples_do_not_move_the_fit():
    lever = slams(4)
    outputs = lagged(lever, (1.0, 1.0), (1.0, 1.0))
    holes = outputs.copy()
    holes[300:420] = np.nan
    holes[0] = np.nan
    params = fit_baselines(Calibration(), [log_of(holes, lever)])
    assert params["first_order"]["push_s"] == pytest.approx([1.0, 1.0], rel=0.01)


def test_parameters_survive_json():
    lever = slams(5, 600)
    params = fit_baselines(Calibration(), [log_of(lagged(lever, (1.0, 2.0), (1.0, 2.0)), lever)])
    assert Baselines.from_json(json.loads(json.dumps(params))) == Baselines.from_json(params)
    assert params["low"][0] < params["high"][0]


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("arx", {}, r"the part 'baselines' has no 'arx.poles'"),
        ("low", ["0.5", 1.0], r"the part 'baselines', 'low.0': .* found '0.5'"),
        ("low", [0.5], "'baselines' are no models of the same outputs"),
        ("first_order", None, "the part 'baselines', 'lag': .* found None"),
    ],
)
def test_baselines_that_were_altered_are_refused(key, value, words):
    lever = slams(5, 600)
    stored = fit_baselines(Calibration(), [log_of(lagged(lever, (1.0, 2.0), (1.0, 2.0)), lever)])
    with pytest.raises(ModelError, match=words):
        Baselines.from_json({**stored, key: value})
