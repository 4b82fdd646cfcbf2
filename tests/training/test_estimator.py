"""The scikit-learn-like door: fit, simulate, predict, score, clone."""

import doctest

import numpy as np
import pandas as pd
import pytest
import torch
from sklearn.base import clone, is_regressor
from sklearn.exceptions import NotFittedError
from sklearn.model_selection import GridSearchCV, TimeSeriesSplit, cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

import training.estimator.narx
from narxcal import Narx, NarxConfig, Record
from narxcal.support.errors import ConfigError, DataError, ModelError
from training.config import TrainConfig

QUICK = TrainConfig(horizons_s=(20.0, 0.0), iterations=(5, 10), score_every_s=1.0, threads=1)
STRUCTURE = NarxConfig(lags=1, taps=(0,), hidden=3)


def test_the_example_of_its_documentation_runs():
    result = doctest.testmod(training.estimator.narx)
    assert result.attempted > 4
    assert result.failed == 0


def test_it_learns_simulates_predicts_and_scores(lag_record):
    model = Narx(STRUCTURE, QUICK).fit([lag_record(0), lag_record(1)])
    unseen = lag_record(5)
    assert model.score([unseen]) > 0.99
    free_run = model.simulate(unseen.u[:, 0], unseen.y[0])
    assert free_run.shape == unseen.y.shape
    error = free_run[1:] - unseen.y[1:]
    spread = unseen.y[1:] - unseen.y.mean()
    by_hand = 1.0 - (error**2).sum() / (spread**2).sum()
    assert model.score([unseen]) == pytest.approx(by_hand)
    steps = model.predict(unseen.u[:, 0], unseen.y[:, 0])
    assert np.isnan(steps[0]).all()
    np.testing.assert_allclose(steps[1:], unseen.y[1:], atol=0.05)


def test_a_prediction_some_steps_ahead_is_the_free_run_from_the_measurement_before(lag_record):
    model, unseen = Narx(STRUCTURE, QUICK).fit([lag_record(0)]), lag_record(5)
    u, y = unseen.u, unseen.y + 0.1 * np.random.default_rng(0).standard_normal(unseen.y.shape)
    np.testing.assert_array_equal(model.predict(u, y, steps=1), model.predict(u, y))
    for steps in (2, 7):
        ahead = model.predict(u, y, steps=steps)
        assert np.flatnonzero(np.isnan(ahead)).tolist() == list(range(steps))
        for k in (steps + 1, 200, len(u) - 1):
            free = model.simulate(u[: k + 1], y[: k + 1 - steps])
            np.testing.assert_allclose(ahead[k], free[k], rtol=1e-9)
    assert np.isnan(model.predict(u[:5], y[:5], steps=5)).all()


def test_plain_arrays_are_one_record_and_are_predicted_from_rest(lag_record):
    record = lag_record(0)
    u, y = record.u, record.y[:, 0]
    model = Narx(STRUCTURE, QUICK).fit(u, y)
    assert model.n_features_in_ == 1
    records = Narx(STRUCTURE, QUICK).fit([record])
    np.testing.assert_array_equal(model.simulate(u, y[:1]), records.simulate(u, y[:1]))
    assert model.score(u, y) == records.score([record]) > 0.99
    still = np.full((50, 1), 1.5)
    np.testing.assert_allclose(model.predict(still), np.tanh(1.5), atol=0.02)
    stepped = np.concatenate([still, 0.0 * still])
    free = model.simulate(np.concatenate([still, stepped]), [np.tanh(1.5)])[50:, 0]
    np.testing.assert_allclose(model.predict(stepped), free, atol=1e-3)
    assert model.predict(u[:0]).shape == (0,)
    both = Narx(STRUCTURE, QUICK).fit(u, np.column_stack([y, 2.0 * y]))
    assert both.predict(stepped).shape == (100, 2)
    np.testing.assert_allclose(
        both.predict(stepped)[:, 1], 2.0 * both.predict(stepped)[:, 0], atol=0.05
    )


def test_searches_of_scikit_learn_take_plain_arrays(lag_record):
    record = lag_record(0)
    X, y = pd.DataFrame({"lever": record.u[:, 0]}), record.y[:, 0]
    pipeline = make_pipeline(StandardScaler(), Narx(STRUCTURE, QUICK))
    scores = cross_val_score(pipeline, X, y, cv=TimeSeriesSplit(3))
    assert scores.min() > 0.8  # the first fold learns from four steps
    errors = cross_val_score(
        clone(pipeline), X, y, cv=TimeSeriesSplit(3), scoring="neg_root_mean_squared_error"
    )
    assert errors.min() > -0.5  # each fold starts from rest, which it is not at
    search = GridSearchCV(pipeline, {"narx__structure__hidden": [1, 3]}, cv=TimeSeriesSplit(2))
    assert search.fit(X, y).score(X, y) > 0.99
    assert search.predict(X).shape == y.shape


def test_pairs_of_arrays_are_records(lag_record):
    one, two = lag_record(0), lag_record(1)
    records = Narx(STRUCTURE, QUICK).fit([one, two])
    pairs = Narx(STRUCTURE, QUICK).fit([(one.u[:, 0], one.y[:, 0].tolist()), (two.u, two.y)])
    expected = records.simulate(one.u, one.y[:1])
    np.testing.assert_array_equal(pairs.simulate(one.u, one.y[:1]), expected)
    assert pairs.score((one.u, one.y)) == records.score(one) == records.score([one])


def test_a_masked_first_sample_starts_at_the_first_known_one(lag_record):
    record = lag_record(0)
    shifted = Record(record.u, record.y + 500.0)
    model = Narx(STRUCTURE, QUICK).fit([shifted])
    y = shifted.y.copy()
    y[0] = np.nan
    assert model.score([Record(record.u, y)]) > 0.99


def test_outputs_that_never_vary_score_nothing_and_not_an_error(lag_record):
    record = lag_record(0)
    model = Narx(STRUCTURE, QUICK).fit([record])
    assert model.score([(record.u, np.full(len(record), 0.7))]) == 0.0


@pytest.mark.parametrize(
    ("given", "found"),
    [
        ((np.zeros((9, 2)),), "ndarray of shape (9, 2)"),
        (([np.zeros(9), np.zeros(9)],), "ndarray of shape (9,)"),
        ((None,), "NoneType"),
        (([(np.zeros(9), np.zeros(9), "name")],), "tuple"),
        ((pd.DataFrame({"u": [0.0, 1.0], "y": [0.0, 0.5]}),), "DataFrame of shape (2, 2)"),
        ((torch.zeros(9, 2),), "Tensor of shape (9, 2)"),
    ],
)
def test_what_is_no_record_is_told_how_to_become_one(given, found):
    with pytest.raises(DataError) as error:
        Narx().fit(*given)
    assert str(error.value) == (
        f"expected records of inputs and outputs, found {found}. "
        "Pass a list of pairs, [(u, y)], or of Record(u, y)"
    )


def test_a_start_of_one_dimension_is_time_for_one_output_and_a_sample_for_several(lag_record):
    record = lag_record(0)
    one = Narx(STRUCTURE, QUICK).fit([record])
    whole = one.simulate(record.u, record.y[:5])
    np.testing.assert_array_equal(one.simulate(record.u[:, 0], record.y[:5, 0]), whole)
    np.testing.assert_array_equal(whole[:5], record.y[:5])
    two = Narx(STRUCTURE, QUICK).fit([(record.u, np.hstack([record.y, 2.0 * record.y]))])
    start = [record.y[0, 0], 2.0 * record.y[0, 0]]
    np.testing.assert_array_equal(
        two.simulate(record.u, start), two.simulate(record.u, np.array([start]))
    )


def test_scores_leave_masked_samples_out(lag_record):
    record = lag_record(0)
    model = Narx(STRUCTURE, QUICK).fit([record])
    masked = record.y.copy()
    masked[100:150] = np.nan
    assert model.score([Record(record.u, masked)]) > 0.99


def test_what_a_masked_array_hides_is_masked(lag_record):
    record = lag_record(0)
    hidden = np.arange(len(record))[:, None] % 5 == 2
    gross = np.where(hidden, 1e9, record.y)
    as_nan = Narx(STRUCTURE, QUICK).fit([(record.u, np.where(hidden, np.nan, gross))])
    as_mask = Narx(STRUCTURE, QUICK).fit([(record.u, np.ma.masked_array(gross, hidden))])
    expected = as_nan.simulate(record.u, record.y[:1])
    np.testing.assert_array_equal(as_mask.simulate(record.u, record.y[:1]), expected)


def test_tables_and_series_of_pandas_are_arrays(lag_record):
    record = lag_record(0)
    u, y = record.u[:, 0], record.y[:, 0]
    arrays = Narx(STRUCTURE, QUICK).fit([(u, y)])
    tables = Narx(STRUCTURE, QUICK).fit([(pd.DataFrame({"lever": u}), pd.Series(y))])
    expected = arrays.simulate(u, y[:1])
    np.testing.assert_array_equal(tables.simulate(pd.Series(u), pd.Series(y[:1])), expected)


def test_without_a_past_nothing_is_predicted(lag_record):
    record = lag_record(0)
    model = Narx(STRUCTURE, QUICK).fit([record])
    assert np.isnan(model.predict(record.u[:1], record.y[:1])).tolist() == [[True]]
    assert model.predict(record.u[:0], record.y[:0]).shape == (0, 1)


@pytest.mark.parametrize(
    ("score", "message"),
    [
        (lambda model, *_: model.score([]), "at least one record is needed, found none"),
        (
            lambda model, u, y: model.score([(u, y)], start=0),
            "expected at least one start sample, found start = 0",
        ),
        (
            lambda model, u, y: model.score([(u, y)], start=len(u)),
            (
                "record 1: a record needs more than 200 samples, found 200. Leave this record out, "
                "or join it to the one that it was cut from"
            ),
        ),
        (
            lambda model, u, y: model.score([(u, np.hstack([y, y]))]),
            "record 1: expected 1 inputs and 1 outputs as in training, found 1 and 2",
        ),
        (
            lambda model, u, y: model.score([(u, y), (u, np.nan * y)]),
            (
                "record 2: output 1 of 1 has no known sample that a free run could start from. "
                "Leave this record out, or fill its first sample"
            ),
        ),
        (
            lambda model, u, y: model.simulate(u, y),
            (
                "the start of 200 samples covers all 200 of the inputs, so nothing is simulated. "
                "Give the first k samples, or `predict` for one step"
            ),
        ),
        (
            lambda model, u, y: model.predict(u, y, steps=0),
            "expected a prediction of at least one step, found steps = 0",
        ),
        (
            lambda model, u, y: model.fit(u, y[:-1]),
            "record 1: inputs and outputs have to be of one length, found 200 and 199 samples",
        ),
        (
            lambda model, u, y: model.simulate(u, y[:0]),
            "a free run needs at least one start sample, found none",
        ),
        (
            lambda model, u, y: model.fit([(u, y)], validation=[(np.hstack([u, u]), y)]),
            "validation record 1: expected 1 inputs and 1 outputs as in record 1, found 2 and 1",
        ),
    ],
)
def test_what_it_cannot_do_is_said(lag_record, score, message):
    record = lag_record(0)
    u, y = record.u[:200], record.y[:200]
    with pytest.raises(DataError) as error:
        score(Narx(STRUCTURE, QUICK).fit([record]), u, y)
    assert str(error.value) == message


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (
            Narx({"hidden": 3}, QUICK),
            "key 'structure': expected NarxConfig, found dict. Pass NarxConfig(...)",
        ),
        (
            Narx(STRUCTURE, "lm"),
            "key 'train': expected TrainConfig, found str. Pass TrainConfig(...)",
        ),
        (Narx(STRUCTURE, QUICK, dt_s=0.0), "key 'dt_s': expected a time above 0, found 0.0"),
        (Narx(STRUCTURE, QUICK, dt_s=np.nan), "key 'dt_s': expected a time above 0, found nan"),
    ],
)
def test_parameters_that_are_none_are_refused_by_fit(lag_record, model, message):
    with pytest.raises(ConfigError) as error:
        clone(model).fit([lag_record(0)])
    assert str(error.value) == message


def test_before_fit_it_says_so():
    with pytest.raises(ModelError) as error:
        Narx().simulate(np.zeros(5), [0.0])
    assert str(error.value) == "the NARX network is not trained yet. Call fit first"
    assert isinstance(error.value, NotFittedError)


def test_scikit_learn_can_clone_it_and_knows_what_it_is():
    model = Narx(STRUCTURE, QUICK, dt_s=0.5)
    copy = clone(model)
    assert copy is not model
    assert copy.get_params() == model.get_params()
    assert is_regressor(model)
    assert repr(model).startswith("Narx(")


def test_nested_settings_are_read_and_set_by_name():
    model = Narx(train=QUICK)
    assert model.get_params()["structure__lags"] == 8
    model.set_params(structure__hidden=3, structure__taps=[1], train__seed=7, dt_s=0.5)
    assert model.structure == NarxConfig(lags=8, hidden=3, taps=(1,))
    assert model.train == QUICK.model_copy(update={"seed": 7})
    assert model.dt_s == 0.5
    assert clone(model).get_params() == model.get_params()


def test_a_nested_setting_that_is_wrong_is_named():
    with pytest.raises(ConfigError, match=r"^unknown key 'hiden'. Did you mean 'hidden'\?$"):
        Narx().set_params(structure__hiden=3)
    with pytest.raises(ValueError, match="Invalid parameter 'bogus'"):
        Narx().set_params(bogus__lags=3)


def test_a_grid_search_over_records_and_a_pipeline_work(lag_record):
    records = [lag_record(seed) for seed in range(4)]
    search = GridSearchCV(Narx(STRUCTURE, QUICK), {"structure__hidden": [1, 3]}, cv=2)
    search.fit(records)
    assert set(search.best_params_) == {"structure__hidden"}
    pipeline = make_pipeline(search.best_estimator_).fit(records)
    score = search.best_estimator_.score(records)
    assert pipeline.score(records) == score
    assert 0.99 < score < 1.0


def table_of(record, order):
    u = pd.DataFrame(np.column_stack([record.u, record.u**2]), columns=["lever", "square"])
    return u[list(order)], pd.DataFrame(record.y, columns=["speed"])


def test_tables_are_taken_by_name_before_and_after_storing(tmp_path, lag_record):
    u, y = table_of(lag_record(0), ("lever", "square"))
    model = Narx(STRUCTURE, QUICK).fit([(u, y), table_of(lag_record(1), ("square", "lever"))])
    arrays = Narx(STRUCTURE, QUICK).fit(
        [
            (table_of(lag_record(k), ("lever", "square"))[0].to_numpy(), lag_record(k).y)
            for k in (0, 1)
        ]
    )
    model.save(tmp_path / "model")
    expected = arrays.simulate(u.to_numpy(), y.to_numpy()[:1])
    for found in (model, Narx.load(tmp_path / "model")):
        assert (found.input_names_, found.output_names_) == (("lever", "square"), ("speed",))
        permuted = u[["square", "lever"]]
        assert np.array_equal(found.simulate(permuted, y[:1]), expected)
        assert found.score((permuted, y)) == arrays.score((u.to_numpy(), y.to_numpy()))
        one_step = arrays.predict(u.to_numpy(), y.to_numpy())
        np.testing.assert_array_equal(found.predict(permuted, y), one_step)
    renamed = u.rename(columns={"lever": "throttle"})
    for use in (
        lambda: model.simulate(renamed, y[:1]),
        lambda: model.predict(renamed, y),
        lambda: model.score((renamed, y)),
        lambda: model.fit([(u, y), (renamed, y)]),
    ):
        with pytest.raises(DataError, match=r"throttle: unknown column; expected .* lever, sq"):
            use()
    with pytest.raises(DataError, match="channel lever: the column is missing"):
        model.simulate(u[["square"]], y[:1])


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("dt_s", "1"), ("dt_s", None), ("dt_s", True), ("dt_s", -1.0), ("time_limit_s", "2"),
        ("time_limit_s", np.nan), ("seed", "0"), ("seed", 0.5), ("seed", -1), ("seed", None),
        ("structure", np.zeros(2)), ("train", "quick"),
    ],
)  # fmt: skip
def test_a_parameter_of_the_wrong_type_is_named(key, value, lag_record):
    with pytest.raises(ConfigError, match=f"key '{key}': expected "):
        Narx(**{key: value}).fit([lag_record(0)])
