"""The weights of the mixture by errors over what was held out."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from training.dynamics.mixture import (
    MODELS,
    HeldOut,
    Mixture,
    error_products,
    leader_of,
    weights_of,
)
from training.responses.transients import Responses

ALL = np.ones(len(MODELS), dtype=bool)
LAGS, SIMPLE = MODELS.index("lags"), MODELS.index("first_order")


def products(*pieces, correlation=0.5):
    """Mean products of errors with these RMS (pieces, models)."""
    rms = np.array(pieces)
    alike = correlation + (1.0 - correlation) * np.eye(rms.shape[1])
    return rms[:, :, None] * rms[:, None, :] * alike


@pytest.mark.parametrize("pieces", [0, 1])
def test_with_fewer_than_two_pieces_the_simple_models_share_the_output(pieces):
    known = products(*[[0.1, 0.1, 1.0, 2.0, 3.0]] * pieces) if pieces else np.empty((0, 5, 5))
    assert weights_of(known) == pytest.approx([0.0, 0.0, 1 / 3, 1 / 3, 1 / 3])
    fitted = np.array([True, True, True, False, False])
    assert weights_of(known, fitted).tolist() == [0.0, 0.0, 1.0, 0.0, 0.0]


def test_without_a_held_out_free_run_the_network_is_alone():
    assert weights_of(np.full((2, 5, 5), np.nan)).tolist() == [1.0, 0.0, 0.0, 0.0, 0.0]


def test_models_alike_share_the_output_and_a_worse_one_has_less():
    found = weights_of(products([1.0, 1.1, 0.9, 1.0, 2.0], [1.1, 0.9, 1.0, 1.0, 2.2]))
    assert found.sum() == pytest.approx(1.0)
    assert found[:4] == pytest.approx([1 / 4] * 4, abs=0.08)
    assert found[4] < 0.08


def test_a_model_that_is_clearly_best_everywhere_leads_alone():
    rest = np.ones(4)
    found = weights_of(products([0.1, *rest], [0.12, *(1.1 * rest)], [0.1, *(0.9 * rest)]))
    assert found.tolist() == [1.0, 0.0, 0.0, 0.0, 0.0]


def test_every_piece_counts_alike_however_large_its_errors_are():
    """The second model is best on two pieces, the first on one with errors of a hundred."""
    rest = np.full(3, 3.0)
    found = weights_of(
        products([1.0, 0.5, *rest], [1.0, 0.5, *rest], [100.0, 200.0, *(100.0 * rest)])
    )
    assert found[1] > found[0]


def test_a_slow_error_that_all_models_share_changes_no_weight():
    """As that of their steady state, larger than what they differ by."""
    rng, time_s, dt_s = np.random.default_rng(0), np.arange(0.0, 3600.0, 0.5), 0.5
    shared = 2.5 * np.sin(2.0 * np.pi * time_s / 1800.0)[:, None]
    size = np.linspace(0.5, 1.5, len(MODELS))[:, None, None]
    models = size * rng.normal(size=(len(MODELS), len(time_s), 1))

    def weights(error):
        known = np.ones(len(time_s), dtype=bool)
        measured = error + np.zeros((len(time_s), 1))
        logs = [
            HeldOut(
                name,
                name,
                whole=True,
                models=models,
                steady=measured,
                measured=measured,
                inside=known,
                dt_s=dt_s,
                responses=(),
            )
            for name in ("a", "b")
        ]
        return weights_of(error_products(logs, 0))

    np.testing.assert_allclose(weights(shared), weights(0.0), atol=0.02)


def test_a_model_without_a_free_run_has_no_weight():
    known = products([1.0, 1.1, 1.0, 0.9, 1.0], [1.1, 1.0, 0.9, 1.0, 1.0])
    known[:, 3, :] = known[:, :, 3] = np.nan
    found = weights_of(known)
    assert found[3] == 0.0
    assert found.sum() == pytest.approx(1.0)


def test_a_model_that_is_stable_in_the_folds_alone_has_no_weight():
    fitted = np.array([True, True, True, True, False])
    found = weights_of(products([1.0, 1.1, 1.0, 1.0, 0.1], [1.1, 1.0, 0.9, 1.0, 0.1]), fitted)
    assert found[4] == 0.0
    assert found.sum() == pytest.approx(1.0)


@given(
    pieces=st.integers(2, 5),
    scale=st.floats(1e-3, 1e3),
    seed=st.integers(0, 2**32 - 1),
)
def test_weights_are_shares_and_have_no_unit(pieces, scale, seed):
    errors = np.random.default_rng(seed).normal(size=(pieces, 5, 30))
    known = errors @ errors.transpose(0, 2, 1)
    found = weights_of(known)
    assert (found >= 0.0).all()
    assert found.sum() == pytest.approx(1.0)
    assert weights_of(scale**2 * known) == pytest.approx(found, abs=1e-3)


def held(log, errors, whole=True, losses=()):
    """A held-out log whose free runs err by `errors` (models,) in the one output.

    Each of `losses` (transients, models) is that of a transient, which passes below one half.
    """
    models = np.tile(np.reshape(errors, (-1, 1, 1)), (1, 50, 1))
    nothing = np.zeros((50, 1))
    inside = np.ones(50, dtype=bool)
    each = np.reshape(losses, (-1, len(MODELS))).T[:, :, None]
    judged = tuple(
        Responses(np.arange(len(one)), one, np.where(np.isfinite(one), one < 0.5, np.nan))
        for one in each
    )
    return HeldOut(log, log, whole, models, nothing, nothing, inside, 0.1, judged)


@pytest.mark.parametrize(
    ("losses", "errors", "leader"),
    [
        ([0.2, 0.2, 0.2, 0.2, 0.2], [1.0, 1.0, 1.0, 1.0, 1.0], 0),
        ([0.2, 0.1, 0.2, 0.2, 0.2], [1.0, 9.0, 1.0, 1.0, 1.0], LAGS),  # whatever the RMSE
        ([0.2, 0.2, 0.2, 0.2, 0.2], [1.0, 0.9, 0.5, 1.0, 1.0], LAGS),  # ties by RMSE
        ([0.2, 0.3, 0.2, 0.2, 0.2], [1.0, 0.9, 0.5, 1.0, 1.0], 0),
        ([0.2, 0.2, 0.1, 0.2, 0.2], [1.0, 1.0, 2.0, 1.0, 1.0], SIMPLE),
        ([np.nan] * 5, [1.0, 1.0, 0.5, 0.5, 0.5], LAGS),  # nothing judged
    ],
)
def test_response_times_choose_who_leads_a_speed(losses, errors, leader):
    """Losses and errors scatter between flights, all models alike; no mixture of them leads."""
    flights = [
        held(str(k), (1.0 + 0.1 * k) * np.array(errors), losses=[0.05 * k + np.array(losses)] * 3)
        for k in range(4)
    ]
    assert leader_of(flights, 0, ALL) == leader
    missing = ALL.copy()
    missing[1:] = False
    assert leader_of(flights, 0, missing) == 0


def test_a_simple_model_leads_by_whole_recordings_alone():
    losses, errors = [0.2, 0.2, 0.1, 0.2, 0.2], np.ones(5)
    regions = [held(str(k), errors, whole=False, losses=[losses] * 3) for k in range(3)]
    flights = [
        held(f"{k}", errors, losses=[np.array(losses) + 0.01 * k * (np.arange(5) == 2)] * 3)
        for k in range(3)
    ]
    assert leader_of(regions, 0, ALL) == 0
    assert leader_of([*regions, *flights], 0, ALL) == SIMPLE


def test_one_flight_that_a_model_does_better_on_does_not_make_it_lead():
    better, worse = [0.3, 0.1, 0.3, 0.3, 0.3], [0.3, 0.35, 0.3, 0.3, 0.3]
    flights = [held(str(k), [1.0] * 5, losses=[each]) for k, each in enumerate((better, worse))]
    assert leader_of(flights, 0, ALL) == 0
    assert leader_of(flights[:1], 0, ALL) == 0


def mixture(*logs):
    """Network and lags with half of the output each."""
    weights = np.zeros((len(MODELS), 1))
    weights[:2] = 0.5
    return Mixture(("N1_pct",), weights, logs, "")


def test_a_log_that_spoils_the_rest_is_named():
    sizes = {"a": 1.0, "b": 1.2, "c": 5.0, "d": 0.9}
    logs = [held(name, [size] * len(MODELS)) for name, size in sizes.items()]
    assert mixture(*logs).suspects == (
        (
            "c does not fit the other logs: held out, N1_pct is wrong by 5, 5.0 times as much as "
            "usual, in every model; check it, or leave it out"
        ),
    )
    regions = [held(name, [size] * len(MODELS), whole=False) for name, size in sizes.items()]
    assert mixture(*regions).suspects == ()
    one_model = [*logs[:2], held("c", [5.0, *[1.0] * (len(MODELS) - 1)]), logs[3]]
    assert mixture(*one_model).suspects == ()


def test_what_is_stored_says_weights_and_held_out_errors():
    sizes = (1.0, 3.0, 2.0, 1.0, 4.0)
    logs = (
        held("a", [*sizes[:-1], np.nan], losses=[[0.2] * 5]),
        held("b", sizes, losses=[[0.6] * 5, [np.nan] * 5]),
    )
    found = mixture(*logs).row()
    one = found["channels"]["N1_pct"]
    assert one["weights"] == {"network": 0.5, "lags": 0.5}
    errors = dict(zip(MODELS, sizes, strict=True))
    assert one["held_out_rmse"] == pytest.approx({**errors, "mixture": 2.0})
    assert one["held_out_level"] == [2.0, 2.0]
    assert one["held_out_responses"]["lags"] == {
        "passed": 1, "judged": 2, "loss": pytest.approx(0.4), "loss_error": pytest.approx(0.2)
    }  # fmt: skip
    assert found["held_out"] == ["a", "b"]


def test_lags_that_take_the_place_of_a_mixture_have_held_out_runs_of_their_own():
    errors = np.arange(1.0, len(MODELS) + 1.0)
    found = mixture(held("a", errors))
    assert found.free_runs[0].model[0, 0] == pytest.approx(np.mean(errors[:2]))
    lags = found.by_lags("it does not settle")
    assert lags.free_runs[0].model[0, 0] == errors[MODELS.index("first_order")]
    stored = lags.row()
    assert stored["status"] == "it does not settle"
    assert stored["channels"]["N1_pct"]["weights"] == {"first_order": 1.0}
