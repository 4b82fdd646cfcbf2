"""The form of a model is chosen by held-out free runs: what wins where, why, and bad input."""

from itertools import count, pairwise
from types import SimpleNamespace

import numpy as np
import pytest
import torch  # noqa: F401 (its import takes seconds of processor time, which a first fit would count)
from sklearn.base import clone

from narxcal import Narx, Record
from narxcal.narx.network import Scaling
from narxcal.support.errors import ConfigError, DataError, ModelError
from training.estimator import search
from training.estimator.ladder import Limits, choose, divide
from training.estimator.latent import Data, Shape, fit_linear, grown, path
from training.estimator.search import record_folds

QUICK = Limits(1.0)


@pytest.fixture
def counted(monkeypatch):
    """A search that ends by the work counted alone: its result is that of any machine."""
    clock = count(1e-9, 1e-9)
    monkeypatch.setattr(search, "time", SimpleNamespace(process_time=lambda: next(clock)))


def linear_system(seed, length=300, noise=0.02):
    """y = second-order lag of u, measured with noise."""
    draw = np.random.default_rng(seed)
    u = np.repeat(draw.standard_normal(length // 20 + 1), 20)[:length]
    y = np.zeros(length)
    for k in range(2, length):
        y[k] = 1.5 * y[k - 1] - 0.56 * y[k - 2] + 0.06 * u[k - 1]
    return Record(u, y + noise * draw.standard_normal(length), f"linear {seed}")


def curved_system(seed, length=400, noise=0.01):
    """A first-order lag whose output saturates."""
    draw = np.random.default_rng(seed)
    u = 2.0 * np.repeat(draw.standard_normal(length // 10 + 1), 10)[:length]
    x = np.zeros(length)
    for k in range(1, length):
        x[k] = 0.8 * x[k - 1] + 0.2 * u[k - 1]
    return Record(u, np.tanh(2.0 * x) + noise * draw.standard_normal(length), f"curved {seed}")


def hammerstein(u, seed):
    """A first-order lag behind a curve."""
    draw = np.random.default_rng(100 + seed)
    y = np.zeros(len(u))
    for k in range(1, len(u)):
        y[k] = 0.8 * y[k - 1] + 0.2 * (np.tanh(2.0 * u[k - 1]) + 0.3 * u[k - 1] ** 2)
    return Record(u, y + 0.01 * draw.standard_normal(len(u)), f"pattern {seed}")


def test_held_out_pieces_never_touch_what_is_fitted():
    record = Record(np.arange(600.0), np.arange(600.0), "ramp")
    folds = record_folds([record], gap=10)
    assert len(folds) == 8
    for fold in folds:
        held = np.concatenate([run.record.u[:, 0] for run in fold.held])
        fitted = np.concatenate([part.u[:, 0] for part in fold.fit])
        nearest = np.abs(fitted[:, None] - np.unique(held)[None]).min()
        assert nearest > 10
    assert {run.begin for fold in folds for run in fold.held} == {0, 33}


def test_long_records_are_held_out_in_blocks_from_different_parts():
    record = Record(np.zeros((3600, 1)), np.arange(3600.0)[:, None], "r")
    folds = record_folds([record], gap=10)
    seen = np.zeros(3600, dtype=int)
    for fold in folds:
        held = sorted({(r.record.y[0, 0], r.record.y[-1, 0]) for r in fold.held if not r.begin})
        assert len(held) == 3
        assert [int(first // 1200) for first, _ in held] == [0, 1, 2]
        for first, last in held:
            assert last - first + 1 == 200
            seen[int(first) : int(last) + 1] += 1
        fitted = np.concatenate([part.y[:, 0] for part in fold.fit])
        for first, last in held:
            assert not ((fitted > first - 10) & (fitted < last + 10)).any()
    assert seen.min() >= 1


def test_whole_records_are_held_out_where_there_are_four():
    records = [linear_system(seed) for seed in range(5)]
    folds = record_folds(records, gap=10)
    assert len(folds) == 5
    for fold in folds:
        names = {run.record.name.split("[")[0] for run in fold.held}
        assert len(names) == 1
        assert names.isdisjoint(part.name.split("[")[0] for part in fold.fit)


def test_a_linear_model_is_recovered_from_several_records():
    records = [linear_system(seed, noise=0.0) for seed in range(2)]
    ones = (Scaling(np.zeros(1), np.ones(1)), Scaling(np.zeros(1), np.ones(1)))
    shape = Shape(2, 1, 1, 0, (0,))
    fitted = fit_linear(Data.of(records, (0,), ones), shape)
    poles = np.linalg.eigvals(shape.parts(fitted.z)[0][:2, :2])
    np.testing.assert_allclose(np.sort(poles.real), [0.7, 0.8], atol=1e-3)


def test_drift_is_not_learned_as_a_mode_slower_than_the_record_shows():
    draw = np.random.default_rng(5)
    u, y = draw.standard_normal((600, 1)), np.zeros((600, 1))
    for k in range(1, 600):
        y[k] = 0.9 * y[k - 1] + 0.1 * u[k - 1]
    drift = 0.05 * np.cumsum(draw.standard_normal((600, 1)), axis=0)
    ones = (Scaling(np.zeros(1), np.ones(1)),) * 2
    for longest, time_constants in ((0, 600.0 / 5.0), (6000, 6000.0 / 5.0)):
        data = Data.of([Record(u, y + drift, "drift")], (0,), ones, longest=longest)
        fitted = fit_linear(data, Shape(1, 1, 1, 0, (0,)))
        pole = fitted.shape.parts(fitted.z)[0][0, 0]
        assert -1.0 / np.log(pole) <= time_constants * (1.0 + 1e-9)


def test_falling_decays_never_raise_the_loss():
    record = curved_system(0)
    scalings = (Scaling.of(record.u), Scaling.of(record.y))
    data = Data.of([record], (0,), scalings)
    linear = fit_linear(data, Shape(1, 1, 1, 0, (0,)))
    losses = [fit.loss for fit, _ in path(grown(linear, 4, 0), data, (1e-1, 1e-3, 1e-5), 20)]
    assert losses[0] <= linear.loss * 1.001
    assert all(after <= before * 1.001 for before, after in pairwise(losses))
    assert losses[-1] < 0.2 * linear.loss


def test_few_records_are_held_out_at_a_time_however_many_samples_they_have():
    records = [Record(np.zeros(9000), np.arange(9000.0), f"long {k}") for k in range(6)]
    folds = divide(records, 1e6, ())
    assert [len(fold.fit) for fold in folds] == [5] * 6
    assert len(divide(records[:1], 1e6, ())) == 4
    assert len(divide(records[:1], 1e9, ())) == 8


@pytest.mark.slow
@pytest.mark.usefixtures("counted")
def test_records_of_different_patterns_get_a_model_that_is_good_on_all_of_them():
    draw = np.random.default_rng(0)
    patterns = [
        np.repeat(draw.uniform(-1.0, 1.0, 30), 10),
        np.repeat(draw.uniform(0.4, 1.0, 30), 10),
        np.sin(np.arange(300) / 15.0),
        np.sign(np.repeat(draw.standard_normal(10), 30)),
    ]
    records = [hammerstein(u, seed) for seed, u in enumerate(patterns)]
    found = choose(records, Limits(6.0))
    unseen = hammerstein(np.repeat(draw.uniform(0.4, 1.0, 30), 10), 9)
    error = found.model.simulate(unseen.u, unseen.y[:20])[20:] - unseen.y[20:]
    line = choose(records, Limits(2.0, linear=True))
    straight = line.model.simulate(unseen.u, unseen.y[:20])[20:] - unseen.y[20:]
    assert np.std(error) < 0.5 * np.std(straight)


@pytest.mark.slow
@pytest.mark.usefixtures("counted")
def test_a_linear_system_gets_a_linear_model_and_a_curved_one_more():
    straight = choose([linear_system(0, 400)], QUICK)
    assert straight.rung in {"first-order lag", "ARX", "linear output error"}
    bent = choose([curved_system(0, 500)], QUICK)
    assert bent.rung in {"latent states", "NARX network", "mean"}
    assert bent.tried["chosen"].sum() == 1
    unseen = curved_system(9)
    error = bent.model.simulate(unseen.u, unseen.y[:20])[20:] - unseen.y[20:]
    assert np.sqrt(np.mean(error**2)) < 0.05
    assert bent.rung in bent.reason
    assert 0.6 < bent.spent / bent.budget < 1.3


@pytest.mark.slow
@pytest.mark.usefixtures("counted")
def test_the_same_records_and_seed_give_the_same_model_stored_or_not(tmp_path):
    records = [curved_system(seed, 200) for seed in range(2)]
    one, two = (Narx(time_limit_s=0.3, seed=3).fit(records) for _ in range(2))
    unseen = curved_system(9)
    free = one.simulate(unseen.u, unseen.y[:9])
    np.testing.assert_array_equal(free, two.simulate(unseen.u, unseen.y[:9]))
    one.save(tmp_path / "model")
    loaded = Narx.load(tmp_path / "model")
    np.testing.assert_array_equal(free, loaded.simulate(unseen.u, unseen.y[:9]))
    assert loaded.get_params() == one.get_params() == clone(one).get_params()
    assert loaded.reason_ == one.reason_
    assert loaded.choice_["form"].tolist() == one.choice_["form"].tolist()
    band = loaded.simulate(unseen.u, unseen.y[:9], interval=0.9)
    np.testing.assert_array_equal(band.y, free)
    assert np.all(band.low[:9] == band.high[:9])
    covered = (band.low <= unseen.y) & (unseen.y <= band.high)
    assert covered[9:].mean() > 0.8


def test_a_record_of_two_samples_is_left_out_and_alone_refused():
    short = (np.zeros(2), np.zeros(2))
    with pytest.raises(DataError) as caught:
        Narx(time_limit_s=0.1).fit([short])
    assert str(caught.value) == (
        "the longest record has 2 samples with outputs, and at least 8 are needed to fit and to "
        "hold something out. Add longer records"
    )
    model = Narx(time_limit_s=0.05).fit([linear_system(0, 60), short])
    assert np.isfinite(model.simulate(np.ones(9), [0.0])).all()


def test_an_output_that_never_varies_and_an_input_that_never_moves_give_finite_models():
    record = linear_system(0, 100)
    constant = Narx(time_limit_s=0.05).fit([(record.u, np.full(100, 0.7))])
    np.testing.assert_allclose(constant.simulate(record.u, [0.7]), 0.7, atol=1e-6)
    still = Narx(time_limit_s=0.05).fit([(np.ones(100), record.y)])
    assert np.isfinite(still.simulate(np.ones(50), record.y[:5])).all()


@pytest.mark.usefixtures("counted")
def test_a_budget_too_small_for_anything_but_linear_models_says_so():
    model = Narx(time_limit_s=0.01).fit([linear_system(0, 200)])
    assert "latent forms were left out: the budget is too small" in model.status_
    assert "the NARX network was left out: the budget" in model.status_
    assert np.isfinite(model.score([linear_system(1)]))


def test_masked_outputs_and_several_channels_are_fitted():
    one, two = linear_system(0, 200), linear_system(1, 200)
    y = np.column_stack([one.y, 2.0 * one.y])
    y[50:60, 0] = np.nan
    model = Narx(time_limit_s=0.05).fit([Record(np.column_stack([one.u, two.u]), y)])
    assert model.score([(np.column_stack([one.u, two.u]), y)]) > 0.9


def test_the_clock_ends_a_search_within_a_fit_and_what_was_found_is_returned(monkeypatch):
    clock = count(0.0, 0.1)
    monkeypatch.setattr(search, "time", SimpleNamespace(process_time=lambda: next(clock)))
    found = choose([curved_system(0, 500)], Limits(20.0))
    assert 20.0 * 0.85 < next(clock) < 22.0
    assert "the clock shortened the search: the result depends on the machine" in found.status
    assert set(found.tried["rung"]) == {"first-order lag", "ARX", "linear output error"}
    unseen = curved_system(9)
    assert np.std(found.model.simulate(unseen.u, unseen.y[:20])[20:] - unseen.y[20:]) < 0.5


def test_without_a_choice_there_is_no_interval_and_no_table():
    record = linear_system(0, 100)
    model = Narx(structure=None).fit([record])
    with pytest.raises(ModelError, match=r"^the structure was given, so nothing was chosen$"):
        _ = model.choice_
    with pytest.raises(ModelError, match="nothing was held out, so there is no interval"):
        model.simulate(record.u, record.y[:2], interval=0.9)


def test_a_time_limit_has_to_be_one():
    with pytest.raises(ConfigError, match=r"^key 'time_limit_s': expected a time above 0, found 0"):
        Narx(time_limit_s=0.0).fit([linear_system(0, 100)])


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("1 sample", "the longest record has 1 samples"),
        ("8 samples", None),
        ("fewer samples than lags", None),
        ("both constant", None),
        ("one output known in a part only", None),
        ("three known samples", None),
        ("an output masked throughout", "output 2 of 2 has no known sample in any training record"),
        ("an input that is NaN", "an input is not a finite number"),
        ("1e300", "a value is beyond 1e\\+100"),
        ("1e-300", None),
        ("an offset of 1e9", None),
        ("many short records", None),
        ("more inputs than samples", None),
        ("growing without bound", None),
        ("masked records beside a good one", None),
    ],
)
@pytest.mark.filterwarnings("error")
def test_records_that_hold_little_give_a_finite_model_or_one_clear_error(name, expected):
    records = scarce(name)
    if expected is not None:
        with pytest.raises(DataError, match=expected):
            Narx(time_limit_s=0.02).fit(records)
        return
    model = Narx(time_limit_s=0.02).fit(records)
    u = np.random.default_rng(1).standard_normal((40, model.model.inputs))
    for scale in (1.0, 1e6):
        free = model.simulate(scale * u, np.zeros((1, model.model.outputs)))
        assert np.isfinite(free).all()
    assert model.reason_
    assert model.status_


def scarce(name):
    """Records that hold little, by name."""
    draw = np.random.default_rng(0)
    noise = draw.standard_normal
    part, known, masked, missing = noise((60, 2)), noise(60), noise((60, 2)), noise(60)
    part[:40, 1], known[3:], masked[:, 1], missing[7] = np.nan, np.nan, np.nan, np.nan
    large = noise(60)
    large[5] = 1e300
    return {
        "1 sample": [(noise(1), noise(1))],
        "8 samples": [(noise(8), noise(8))],
        "fewer samples than lags": [(noise(14), noise(14))],
        "both constant": [(np.ones(60), np.ones(60))],
        "one output known in a part only": [(noise(60), part)],
        "three known samples": [(noise(60), known)],
        "an output masked throughout": [(noise(60), masked)],
        "an input that is NaN": [(missing, noise(60))],
        "1e300": [(noise(60), large)],
        "1e-300": [(1e-300 * noise(60), 1e-300 * noise(60))],
        "an offset of 1e9": [(noise(60), 1e9 + noise(60))],
        "many short records": [(noise(9), noise(9)) for _ in range(12)],
        "more inputs than samples": [(noise((20, 30)), noise(20))],
        "growing without bound": [(noise(80), np.exp(0.2 * np.arange(80)))],
        "masked records beside a good one": [
            (noise(60), np.full(60, np.nan)),
            (noise(60), noise(60)),
        ],
    }[name]
