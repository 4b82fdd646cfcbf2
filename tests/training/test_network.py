"""Training in free run: from a linear model that a free run can bear, it finds known systems.

It repeats itself, stops and goes on exactly; networks merged side by side compute what each did.
"""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from narxcal.narx.config import NarxConfig
from narxcal.narx.module import NarxNet
from narxcal.narx.network import NarxModel, Scaling
from narxcal.record import Record
from narxcal.support.errors import DataError
from training.config import TrainConfig
from training.dynamics.free_run import FreeRunProblem, cut_windows
from training.dynamics.network import (
    Material,
    fit_narx,
    merge_models,
    net_of,
    new_model,
    start_linear,
)

STRUCTURE = NarxConfig(lags=1, taps=(0,), hidden=3)
SHORT = TrainConfig(
    horizons_s=(20.0, 0.0), iterations=(4, 5), starts=2, score_every_s=1.0, threads=1
)
OPTIMISERS = ("lm", "adam")
DARK = (
    "dark: output 1 of 1 has no known sample in any {} record. "
    "Leave the output out, or add records that hold it"
)


class Stop:
    """A watch that keeps every progress and presses Ctrl-C after `steps` of them."""

    def __init__(self, steps=10**9):
        self.steps, self.seen = steps, []

    def __call__(self, progress):
        self.seen.append(progress)
        if len(self.seen) >= self.steps:
            raise KeyboardInterrupt


def theta(result):
    return net_of(result.model).get_theta()


def free_run_r2(result, record):
    error = result.model.simulate(record.u, record.y[0]) - record.y
    return 1.0 - (error**2).sum() / ((record.y - record.y.mean()) ** 2).sum()


def same_history(one, other):
    assert len(one) == len(other)
    for a, b in zip(one, other, strict=True):
        assert replace(a, validation=0.0) == replace(b, validation=0.0)
        assert a.validation == b.validation or np.isnan([a.validation, b.validation]).all()


def test_a_known_system_is_recovered_from_noisy_records(lag_record):
    noisy = [lag_record(seed, 600, noise=0.05) for seed in range(3)]
    config = TrainConfig(horizons_s=(20.0, 0.0), iterations=(10, 20), score_every_s=1.0, threads=1)
    result = fit_narx(Material(noisy, [], 1.0), STRUCTURE, config)
    unseen = lag_record(9, 600)
    assert free_run_r2(result, unseen) > 0.995
    # The pole is the decay of what is left of a start away from rest.
    still = np.zeros((40, 1))
    gap = result.model.simulate(still, [0.2]) - result.model.simulate(still, [0.0])
    pole = (gap[5:15, 0] / gap[4:14, 0]).mean()
    assert pole == pytest.approx(0.9, abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("optimiser", OPTIMISERS)
def test_the_same_seed_gives_the_same_network_and_another_one_does_not(optimiser, lag_record):
    config = SHORT.model_copy(update={"optimiser": optimiser, "starts": 1})
    material = Material([lag_record(noise=0.05)], [], 1.0)
    first, again = (fit_narx(material, STRUCTURE, config) for _ in range(2))
    other = fit_narx(material, STRUCTURE, config.model_copy(update={"seed": 5}))
    assert np.array_equal(theta(first), theta(again))
    same_history(first.history, again.history)
    assert not np.array_equal(theta(first), theta(other))


def test_training_leaves_the_callers_random_numbers_alone(lag_record):
    torch.manual_seed(3)
    expected = torch.rand(4)
    torch.manual_seed(3)
    fit_narx(Material([lag_record()], [], 1.0), STRUCTURE, SHORT.model_copy(update={"starts": 1}))
    assert torch.equal(torch.rand(4), expected)


@pytest.mark.parametrize("validated", [False, True])
@pytest.mark.parametrize("optimiser", OPTIMISERS)
def test_stopping_after_any_step_and_going_on_is_the_same_path(optimiser, validated, lag_record):
    config = SHORT.model_copy(update={"optimiser": optimiser, "patience": 3})
    validation = [lag_record(7, 200, noise=0.05)] if validated else []
    material = Material([lag_record(noise=0.05)], validation, 1.0)
    watch = Stop()
    whole = fit_narx(material, STRUCTURE, config, watch)
    for progress in watch.seen[::3] + watch.seen[-2:]:
        resumed = fit_narx(material, STRUCTURE, config, resume=progress)
        assert np.array_equal(theta(resumed), theta(whole))
        assert resumed.score == whole.score
        assert resumed.status == whole.status == "all steps done"
        same_history(resumed.history, whole.history)


def test_ctrl_c_keeps_the_best_and_says_so(lag_record):
    material = Material([lag_record(noise=0.05)], [lag_record(7, 200)], 1.0)
    watch = Stop(6)
    result = fit_narx(material, STRUCTURE, SHORT, watch)
    assert result.status == (
        "interrupted: the best network so far was kept; --resume goes on from here"
    )
    assert len(result.history) == 6
    best = min(result.history, key=lambda row: row.validation)
    assert result.score == best.validation
    assert np.array_equal(theta(result), watch.seen[result.history.index(best)].theta)


def test_what_was_interrupted_goes_on_to_the_uninterrupted_end(lag_record):
    material = Material([lag_record(noise=0.05)], [], 1.0)
    whole = fit_narx(material, STRUCTURE, SHORT)
    watch = Stop(7)
    fit_narx(material, STRUCTURE, SHORT, watch)
    resumed = fit_narx(material, STRUCTURE, SHORT, resume=watch.seen[-1])
    assert np.array_equal(theta(resumed), theta(whole))


def test_validation_records_choose_by_their_own_free_run(lag_record):
    train = [lag_record(noise=0.3, samples=120)]
    unseen = lag_record(7, 300)
    result = fit_narx(Material(train, [unseen], 1.0), NarxConfig(lags=2, hidden=8), SHORT)
    error = result.model.simulate(unseen.u, unseen.y[0]) - unseen.y
    scaled = error[1:] / result.model.output_scaling.scale
    assert result.score == pytest.approx(np.sqrt((scaled**2).mean()), rel=1e-6)
    assert result.score == min(row.validation for row in result.history)


def test_training_stops_when_validation_gets_no_better(lag_record):
    config = TrainConfig(
        horizons_s=(0.0,), iterations=(60,), patience=2, score_every_s=1.0, threads=1
    )
    wrong = lag_record(7, 200)
    wrong = Record(wrong.u, -wrong.y)  # the better the fit, the worse here
    result = fit_narx(Material([lag_record(noise=0.1)], [wrong], 1.0), STRUCTURE, config)
    assert len(result.history) < 60
    worst = [row.validation for row in result.history][-2:]
    assert min(worst) >= result.score


def test_the_order_of_records_does_not_matter(lag_record):
    records = [lag_record(seed, 150 + 50 * seed, noise=0.05) for seed in range(3)]
    config = SHORT.model_copy(update={"starts": 1})
    one = fit_narx(Material(records, [], 1.0), STRUCTURE, config)
    other = fit_narx(Material(records[::-1], [], 1.0), STRUCTURE, config)
    np.testing.assert_allclose(theta(one), theta(other), rtol=1e-5, atol=1e-7)


def test_records_do_not_leak_across_their_borders(lag_record):
    parts = [lag_record(0, 200), lag_record(1, 200)]
    parts[1] = Record(parts[1].u, parts[1].y + 3.0)  # a border that is no motion of the system
    joined = Record(
        np.concatenate([part.u for part in parts]), np.concatenate([part.y for part in parts])
    )
    config = SHORT.model_copy(update={"starts": 1})
    apart = fit_narx(Material(parts, [], 1.0), STRUCTURE, config)
    leaked = fit_narx(Material([joined], [], 1.0), STRUCTURE, config)
    assert not np.allclose(theta(apart), theta(leaked), rtol=1e-3)


def test_what_a_masked_sample_held_has_no_influence(lag_record):
    clean = lag_record(noise=0.05)
    masked = clean.y.copy()
    masked[50:90] = np.nan
    weight = np.ones(len(clean))
    weight[50:90] = 0.0
    wild = clean.y.copy()
    wild[50:90] = np.nan
    config = SHORT.model_copy(update={"starts": 1})
    fits = [
        fit_narx(Material([Record(clean.u, y, weight=w)], [], 1.0), STRUCTURE, config)
        for y, w in ((masked, None), (wild, weight))
    ]
    assert np.isfinite(theta(fits[0])).all()
    assert np.array_equal(theta(fits[0]), theta(fits[1]))
    assert free_run_r2(fits[0], lag_record(9)) > 0.97


@pytest.mark.parametrize("every", [2, 400])
def test_outputs_of_which_no_two_successive_samples_are_known_give_a_finite_model(
    every, lag_record
):
    one = lag_record()
    rows = np.arange(len(one)) % every == 0
    sparse = replace(one, y=np.where(rows[:, None], one.y, np.nan))
    config = TrainConfig(horizons_s=(20.0,), iterations=(2,))
    found = fit_narx(Material([sparse], [], 1.0), NarxConfig(lags=2, hidden=2), config)
    assert np.isfinite(found.model.simulate(one.u, one.y[:1])).all()


def test_a_horizon_shorter_than_a_sample_is_one_sample(lag_record):
    config = TrainConfig(horizons_s=(0.01,), iterations=(1,), score_every_s=1.0, threads=1)
    one = TrainConfig(horizons_s=(1.0,), iterations=(1,), score_every_s=1.0, threads=1)
    fits = [fit_narx(Material([lag_record()], [], 1.0), STRUCTURE, c) for c in (config, one)]
    assert np.array_equal(theta(fits[0]), theta(fits[1]))


@pytest.mark.parametrize(
    ("records", "validation", "message"),
    [
        ([], [], "at least one record is needed, found none"),
        (
            [Record(np.zeros(1), np.zeros(1), "short")],
            [],
            (
                "short: a record needs more than 1 samples, found 1. Leave this record out, or "
                "join it to the one that it was cut from"
            ),
        ),
        (
            [Record(np.zeros(50), np.full(50, np.nan), "dark")],
            [],
            DARK.format("training"),
        ),
        (
            [Record(np.arange(50.0), np.arange(50.0), "good")],
            [Record(np.zeros(50), np.full(50, np.nan), "dark")],
            DARK.format("validation"),
        ),
        (
            [Record(np.zeros(50), np.zeros(50), "one")],
            [Record(np.zeros((50, 2)), np.zeros(50), "two")],
            "two: expected 1 inputs and 1 outputs as in one, found 2 and 1",
        ),
    ],
)
def test_unfit_records_are_refused(records, validation, message):
    with pytest.raises(DataError) as error:
        fit_narx(Material(records, validation, 1.0), STRUCTURE, SHORT)
    assert str(error.value) == message


def test_a_network_is_judged_from_every_place_that_a_whole_record_is_run_from(lag_record):
    update = {"horizons_s": (0.0,), "iterations": (3,), "starts": 1, "restarts": 3}
    record = lag_record(noise=0.05)
    result = fit_narx(Material([record], [], 1.0), STRUCTURE, SHORT.model_copy(update=update))
    windows = cut_windows(result.model, [record], None, restarts=3)
    assert len(windows) == 3
    loss = FreeRunProblem(net_of(result.model), windows).loss(theta(result))
    assert result.score == pytest.approx(np.sqrt(2.0 * loss))


# The start.
configs = st.builds(
    NarxConfig,
    lags=st.integers(1, 4),
    taps=st.sampled_from([(0,), (0, 1), (1, 2)]),
    hidden=st.integers(1, 4),
    moving=st.integers(0, 1),
)


def started(records, config, seed=0):
    model = new_model(records, config, seed)
    problem = FreeRunProblem(net_of(model), cut_windows(model, records, None))
    start_linear(model, records, problem)
    return model, problem


def test_a_linear_system_is_found_at_once():
    rng = np.random.default_rng(0)
    u = rng.normal(size=400)
    y = np.zeros(400)
    for k in range(1, 400):
        y[k] = 0.8 * y[k - 1] + 0.5 * u[k]
    model, _ = started([Record(u, y)], NarxConfig(lags=1, taps=(0,), hidden=2))
    np.testing.assert_allclose(model.simulate(u[:, None], y[:1]), y[:, None], atol=1e-3)


@given(config=configs, seed=st.integers(0, 99), drift=st.booleans())
def test_it_never_diverges(config, seed, drift):
    rng = np.random.default_rng(seed)
    u = rng.normal(size=(120, 2))
    y = np.cumsum(rng.normal(size=(120, 2)), axis=0) if drift else rng.normal(size=(120, 2))
    y[30:34, 0] = np.nan
    model, problem = started([Record(u, y)], config)
    free_run = model.simulate(10.0 * rng.normal(size=(5000, 2)), np.zeros(2))[1:]
    low, high = model.bounds
    assert (free_run >= low - 1e-9).all()
    assert (free_run <= high + 1e-9).all()
    # A model of the mean alone is among what it had to choose from, up to the ridge.
    variance = 0.5 * np.nanmean(model.output_scaling.down(y) ** 2)
    assert problem.loss(net_of(model).get_theta()) <= 1.1 * variance + 1e-9


def test_bounds_are_the_envelope_and_a_margin():
    y = np.linspace(-10.0, 30.0, 50)
    model = new_model([Record(y, y)], NarxConfig(margin=0.25), 0)
    np.testing.assert_allclose(np.ravel(model.bounds), [-20.0, 40.0])


def test_an_input_that_hardly_varies_is_scaled_as_if_it_varied_as_much_as_asked():
    u = np.column_stack([np.linspace(0.0, 1.0, 50), np.linspace(0.0, 300.0, 50)])
    record = Record(u, u[:, 0])
    plain = new_model([record], NarxConfig(), 0).input_scaling.scale
    asked = new_model([record], NarxConfig(), 0, np.array([0.0, 3000.0])).input_scaling.scale
    assert asked.tolist() == [plain[0], 3000.0]


def test_bounds_of_an_anchored_network_hold_its_rest():
    y = np.linspace(20.0, 30.0, 50)
    model = new_model([Record(y, y)], NarxConfig(margin=0.1, moving=1), 0)
    np.testing.assert_allclose(np.ravel(model.bounds), [-3.0, 33.0])
    assert model.output_scaling.centre == pytest.approx([0.0])
    assert model.input_scaling.centre == pytest.approx([0.0])


def test_an_anchored_start_rests_at_zero():
    rng = np.random.default_rng(0)
    u = np.column_stack([rng.normal(size=200), np.full(200, 3.0) + rng.normal(size=200)])
    y = np.convolve(u[:, 0], 0.5 ** np.arange(8))[:200] + 5.0
    model, _ = started([Record(u, y)], NarxConfig(moving=1))
    still = np.column_stack([np.zeros(50), np.full(50, 4.0)])
    np.testing.assert_allclose(model.simulate(still, [0.0]), 0.0, atol=1e-12)


def test_the_seed_draws_the_hidden_layer_and_nothing_else():
    record = Record(np.arange(30.0), np.arange(30.0) ** 2)
    one, same, other = (new_model([record], NarxConfig(), seed) for seed in (1, 1, 2))
    assert np.array_equal(net_of(one).get_theta(), net_of(same).get_theta())
    assert not np.array_equal(net_of(one).get_theta(), net_of(other).get_theta())
    assert not net_of(one).output.weight.any()
    assert not net_of(one).linear.weight.any()


# Merging.
INPUTS = 3


def single(config, seed):
    torch.manual_seed(seed)
    net = NarxNet(config, INPUTS, 1)
    net.low[:], net.high[:] = -0.5 - 0.1 * seed, 0.5 + 0.1 * seed
    shared = np.random.default_rng(0)
    own = np.random.default_rng(seed)
    inputs = Scaling(shared.normal(size=INPUTS), 1.0 + shared.random(INPUTS))
    return NarxModel(net, inputs, Scaling(own.normal(size=1), 1.0 + own.random(1)))


@settings(max_examples=15)
@given(
    lags=st.integers(1, 4),
    taps=st.sampled_from([(0,), (0, 1), (1, 3)]),
    moving=st.integers(0, 2),
    count=st.integers(1, 4),
)
def test_merged_networks_are_the_separate_ones(lags, taps, moving, count):
    config = NarxConfig(lags=lags, taps=taps, hidden=3, moving=moving)
    models = [single(config, seed) for seed in range(count)]
    merged = merge_models(models)
    u = np.random.default_rng(1).normal(size=(80, INPUTS))
    start = np.linspace(-0.2, 0.2, count)
    together = merged.simulate(u, start)
    for k, model in enumerate(models):
        alone = model.simulate(u, start[k : k + 1])[:, 0]
        np.testing.assert_allclose(together[:, k], alone, rtol=1e-12, atol=1e-13)
    lows = [model.bounds[0][0] for model in models]
    assert merged.bounds[0] == pytest.approx(lows)
    measured = np.random.default_rng(2).normal(size=(80, count))
    steps = merged.predict(u, measured)
    for k, model in enumerate(models):
        np.testing.assert_allclose(
            steps[1:, k], model.predict(u, measured[:, k : k + 1])[1:, 0], rtol=1e-12, atol=1e-13
        )


def test_one_network_is_left_as_it_is():
    model = single(NarxConfig(), 0)
    assert merge_models([model]) is model


def test_a_single_output_keeps_inputs_name_and_weight():
    weight = np.arange(4.0)
    record = Record(np.ones((4, 2)), np.arange(8.0).reshape(4, 2), "flight", weight)
    (part,) = Material([record], [], 0.1).of_output(1).records
    assert part.y.tolist() == [[1.0], [3.0], [5.0], [7.0]]
    assert part.u is record.u
    assert (part.name, part.weight) == ("flight", weight)
