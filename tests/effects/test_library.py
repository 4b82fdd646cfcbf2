"""What the library holds, who can act on what, and how it answers to a wrong name."""

import re
from dataclasses import replace

import pytest

from narxcal.effects import LIBRARY, candidates, effect
from narxcal.flight_test import sensors
from narxcal.support.errors import ConfigError
from narxcal.turbofan.unmodelled import PARAMETERS


def names(signals):
    return [each.name for each in candidates(signals)]


def test_it_has_every_effect_that_a_virtual_flight_can_have():
    assert set(LIBRARY) >= {*PARAMETERS, *sensors.PARAMETERS}


def test_no_name_is_offered_twice(flights):
    found = names(flights.signals)
    assert len(set(found)) == len(found)


def test_an_effect_needs_what_it_acts_on(flights):
    s = flights.signals
    assert "altitude_lag" not in names(replace(s, active=("TRA_deg",)))
    assert "bleed_extraction" not in names(replace(s, active=("TRA_deg",)))
    assert "unlogged_switch" not in names(replace(s, active=("TRA_deg",)))
    assert "idle_schedule" not in names(replace(s, active=("TRA_deg",)))
    assert "temperature_effect" not in names(replace(s, active=("TRA_deg",)))
    outputs = replace(s, outputs=("N2_pct", "EGT_C"), low=s.low[1:3], high=s.high[1:3])
    assert "spool_lag" in names(outputs)
    assert "spool_coupling" not in names(outputs)
    assert "flowmeter_dynamics:FF_kgph" not in names(outputs)
    assert "sensor_lag:N1_pct" not in names(outputs)


def test_what_a_control_holds_is_not_worn(flights):
    lever, fuel = flights.signals, replace(flights.signals, driver="FF_kgph")
    assert lever.governed
    assert not fuel.governed
    worn = [p.name for p in effect("deterioration").parameters(lever)]
    assert "base_N1_pct" not in worn
    assert "base_N1_pct" in [p.name for p in effect("deterioration").parameters(fuel)]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("spool_lagg", "unknown effect 'spool_lagg'.*Did you mean 'spool_lag'"),
        ("zzz", "unknown effect 'zzz'.*Known: throttle_backlash"),
        ("sensor_lag", "'sensor_lag' needs a channel, as in sensor_lag:EGT_C"),
        ("flowmeter_dynamics", "'flowmeter_dynamics' needs a channel"),
        ("spool_lag:N1_pct", "'spool_lag' has no channel"),
    ],
)
def test_a_wrong_name_is_answered(name, message):
    with pytest.raises(ConfigError) as caught:
        effect(name)
    assert re.search(message, str(caught.value), re.DOTALL)


def test_a_column_that_is_not_there_is_named(flights):
    with pytest.raises(ConfigError, match="there is no input 'N3'"):
        flights.signals.u("N3")
    with pytest.raises(ConfigError, match="there is no output 'T3_K'"):
        flights.signals.y("T3_K")
