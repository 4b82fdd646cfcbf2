"""Claimed effects become settings that run, from a finding as from its document."""

import numpy as np
import pytest

from eval.gap.claimed import (
    changes,
    claimed,
    claimed_in,
    offset_leads,
    settings,
    with_effects,
)
from narxcal.support.errors import ConfigError
from training.budget.result import Interval


def test_each_effect_has_the_sizes_of_the_best_model_with_it(make_model, make_finding):
    lag = {"tau_s": Interval(1.0, 0.9, 1.1)}
    joint = make_model(
        "sensor_lag:EGT_C",
        "throttle_delay",
        parameters={"sensor_lag:EGT_C": lag, "throttle_delay": {"delay_s": Interval(0.3, 0, 1)}},
    )
    offset = make_model(
        "sensor_bias:N1_pct", parameters={"sensor_bias:N1_pct": {"bias": lag["tau_s"]}}
    )
    found = make_finding(
        "effects",
        ("sensor_lag:EGT_C", "throttle_delay", "sensor_bias:N1_pct"),
        (joint, offset, make_model("sensor_lag:EGT_C", gain=0.1)),
    )
    assert claimed(found) == {
        "sensor_lag:EGT_C": {"tau_s": 1.0},
        "throttle_delay": {"delay_s": 0.3},
        "sensor_bias:N1_pct": {"bias": 1.0},
    }


@pytest.mark.parametrize("kind", ["none", "unknown"])
def test_nothing_is_claimed_without_a_claim(make_model, make_finding, kind):
    assert claimed(make_finding(kind, (), (make_model("spool_lag"),))) == {}


def test_a_document_that_claims_what_it_does_not_hold_is_refused():
    with pytest.raises(ConfigError, match="names 'spool_lag', which is not among the effects"):
        claimed_in({"verdict": {"effects": ["spool_lag"]}, "effects": []})


def test_unknown_parameters_and_impossible_effects_are_refused(make_data):
    signals = make_data(flights=1).flights.signals
    with pytest.raises(ConfigError, match=r"'spool_lag' has no parameter 'tau'\. It has factor"):
        settings({"spool_lag": {"tau": 1.0}}, signals)
    with pytest.raises(ConfigError, match="'temperature_effect' cannot act on these logs"):
        settings({"temperature_effect": {}}, signals)


def test_a_parameter_that_is_not_given_is_neutral(make_data):
    [(_, theta)] = settings({"sensor_lag:EGT_C": {}}, make_data(flights=1).flights.signals)
    assert not theta.any()


def test_the_planted_lag_closes_the_gap(make_data, probe):
    data = make_data(probe)
    after = with_effects({"sensor_lag:EGT_C": {"tau_s": 1.0}}, data.flights, None)
    left = np.sqrt(np.nanmean((data.real - after)[..., 2] ** 2))
    assert left < 0.05 * np.sqrt(np.nanmean(data.gap[..., 2] ** 2))
    np.testing.assert_array_equal(changes({}, data, None), 0.0)


@pytest.mark.parametrize(
    ("said", "gain", "leads"),
    [
        (("none",), 0.95, True),
        (("unknown",), 0.95, True),
        (("none",), 0.85, False),
        (("effects", ("sensor_bias:EGT_C",)), 0.95, False),
    ],
)
def test_an_offset_leads_where_nothing_is_claimed_and_it_is_most_of_the_gap(
    said, gain, leads, make_finding, make_model
):
    tried = make_model("sensor_lag:EGT_C", gain=0.99), make_model("sensor_bias:EGT_C", gain=gain)
    assert offset_leads(make_finding(*said, tried=tried)) is leads
    assert not offset_leads(make_finding(*said, tried=tried[:1]))
