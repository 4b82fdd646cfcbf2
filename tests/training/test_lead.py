"""Which model leads: the rule on held-out errors, and the models as part of a calibration."""

import numpy as np
import pytest

from data_prep.log import Log, Source
from narxcal.calibration.lead import KINDS, Lead
from narxcal.support.errors import ModelError
from training.baselines import FirstOrderLag, LinearArx
from training.lead import HeldOut, Leading, lead_folds, leading_kind

RISE = np.column_stack([np.linspace(0.0, 1.0, 50) ** 2, np.linspace(1.0, 0.0, 50)])
ARX = LinearArx(
    poles=((0.9, -0.2), (0.5, 0.1)),
    gains=(((0.1, 0.0), (0.2, 0.1), (0.0, 0.0)), ((0.2, 0.1), (0.1, 0.0), (0.0, 0.1))),
    offsets=(0.01, 0.0),
)


def errors(**ratios):
    """Held-out errors of three logs: of the network, then of each kind by its ratio to it."""
    network = np.array([1.0, 2.0, 0.5])
    columns = [network * np.asarray(ratios.get(kind, 2.0)) for kind in KINDS]
    return np.column_stack([network, *columns])


def test_the_network_leads_unless_a_simple_model_is_better_by_more_than_one_standard_error():
    assert leading_kind(errors()) is None
    assert leading_kind(errors(arx=[0.5, 0.6, 0.7])) == "arx"
    assert leading_kind(errors(arx=[0.3, 1.5, 1.1])) is None  # better on average, but not surely


def test_of_several_better_ones_the_best_on_average_leads():
    assert leading_kind(errors(first_order=[0.5, 0.6, 0.7], arx=[0.3, 0.9, 0.4])) == "arx"
    assert leading_kind(errors(first_order=[0.5, 0.6, 0.7], arx=[0.6, 0.6, 0.7])) == "first_order"
    assert leading_kind(errors(steady_state=[0.1, 0.1, 0.1], arx=[0.5] * 3)) == "steady_state"


def test_one_held_out_log_alone_is_no_evidence():
    assert leading_kind(errors(arx=[0.1] * 3)[:1]) is None
    assert leading_kind(errors(arx=[0.1] * 3)[:2]) == "arx"


def test_a_channel_without_held_out_samples_is_the_networks():
    assert leading_kind(np.full((3, 4), np.nan)) is None
    assert leading_kind(errors(arx=np.nan)) is None


def arx_lead():
    return Lead("arx", 0, poles=ARX.poles[0], gains=ARX.gains[0], offset=ARX.offsets[0])


def test_leads_run_as_the_baselines_they_were_fitted_as():
    dt_s, start = 0.1, np.array([0.3, 0.9])
    lag = FirstOrderLag((0.7, 0.5), (0.3, 0.4))
    push, pull = (1.0 - np.exp(-dt_s / tau) for tau in (0.7, 0.3))
    lead = Lead("first_order", 0, push, pull)
    expected = lag.simulate(RISE, start, dt_s)[:, 0]
    np.testing.assert_allclose(lead.simulate(RISE, 0.3), expected, rtol=1e-12)
    expected = ARX.simulate(RISE, start)[:, 0]
    np.testing.assert_allclose(arx_lead().simulate(RISE, 0.3), expected, rtol=1e-12)


@pytest.mark.parametrize(
    "lead", [Lead("steady_state", 1), Lead("first_order", 1, 0.2, 0.4), arx_lead()]
)
def test_a_lead_gives_the_same_in_any_pieces(lead):
    whole = lead.simulate(RISE, 0.4)
    state = lead.started(RISE[0], 0.4)
    pieces = [state.advance(RISE[a:b]) for a, b in ((1, 2), (2, 17), (17, 17), (17, 50))]
    np.testing.assert_allclose(np.concatenate(pieces), whole[1:], rtol=1e-12)


def test_one_step_from_its_own_free_run_is_that_run():
    lead = arx_lead()
    free = lead.simulate(RISE, 0.4)
    np.testing.assert_allclose(lead.predict(RISE, free)[1:], free[1:], rtol=1e-12)


def test_a_correction_replaces_the_newest_output():
    state = Lead("first_order", 0, 0.5, 0.5).started(np.zeros(2), 1.0)
    state.correct(np.nan)
    state.correct(4.0)
    assert state.advance(np.zeros((1, 2)))[0] == 2.0


def test_a_stored_lead_comes_back_and_an_unknown_kind_is_refused():
    assert Lead.from_json(arx_lead().to_json()) == arx_lead()
    with pytest.raises(ModelError) as caught:
        Lead.from_json(arx_lead().to_json() | {"kind": "magic"})
    assert str(caught.value) == (
        "expected a lead of kind steady_state, first_order, arx, found magic"
    )


def test_a_single_recording_is_divided_into_thirds():
    log = Log("a.csv", 0.1 * np.arange(90), {"N1_pct": np.arange(90.0)}, source=Source("a.csv"))
    parts, folds = lead_folds([log])
    assert [len(part) for part in parts] == [30, 30, 30]
    assert len({part.name for part in parts}) == 3
    assert [fold.judged for fold in folds] == [[0], [1], [2]]


def test_a_log_that_spoils_the_rest_is_named():
    errors = np.ones((4, 4, 1)) * np.array([1.0, 1.2, 5.0, 0.9])[:, None, None]
    held = HeldOut(errors, errors, errors)
    found = Leading((), ("N1_pct",), ("a", "b", "c", "d"), held, "")
    assert found.suspects == (
        (
            "c does not fit the other logs: held out, N1_pct is wrong by 5, 5.0 times as much as "
            "usual, in every model; check it, or leave it out"
        ),
    )
    parts = Leading((), ("N1_pct",), ("a", "b", "c", "d"), held, "", whole=False)
    assert parts.suspects == ()
    one_model = errors.copy()
    one_model[2, 1:] = 1.0
    held = HeldOut(one_model, errors, errors)
    assert Leading((), ("N1_pct",), ("a", "b", "c", "d"), held, "").suspects == ()
