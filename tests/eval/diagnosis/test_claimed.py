"""Claimed effects of a document become settings that run."""

import numpy as np
import pytest

from eval.diagnosis.expected import claimed_in, settings, with_effects
from narxcal.support.errors import ConfigError


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
    assert left < 0.05 * np.sqrt(np.nanmean(data.difference[..., 2] ** 2))
    np.testing.assert_array_equal(with_effects({}, data.flights, None), data.flights.y)
