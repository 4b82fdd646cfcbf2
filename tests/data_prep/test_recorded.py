"""Outputs that a log does not record."""

import numpy as np
import pytest

from data_prep.config import LogsConfig
from data_prep.equilibrium import QuasiSteadyConfig, quasi_steady
from data_prep.events import EventsConfig, find_events
from data_prep.log import AuditEntry, Log, Source
from data_prep.prepare import Preparation, Prepared, cautions, with_outputs
from narxcal.support.errors import DataError

DT_S = 0.1
OUTPUTS = ("N1_pct", "N2_pct", "EGT_C")
ANYWHERE = Preparation(events=EventsConfig(condition=""))


def flight(*outputs):
    """One slam at 10 s, answered with a time constant of 3 s."""
    time_s = DT_S * np.arange(600)
    since = np.maximum(time_s - 10.0, 0.0)
    channels = {"TRA_deg": np.where(since > 0.0, 60.0, 20.0)}
    channels |= {name: 40.0 + 50.0 * (1.0 - np.exp(-since / 3.0)) for name in outputs}
    return Log("f.csv:left", time_s, channels, source=Source("f.csv", "sha", "left"))


def test_a_log_with_every_output_is_left_as_it_is():
    log = flight(*OUTPUTS)
    assert with_outputs(log, OUTPUTS) is log
    assert cautions([log], ANYWHERE, OUTPUTS) == []


def test_an_output_that_is_not_there_is_masked_counted_and_told():
    log = with_outputs(flight("N1_pct", "N2_pct"), OUTPUTS)
    assert np.isnan(log["EGT_C"]).all()
    assert log.audit.entries == (AuditEntry("EGT_C", "masked", "not recorded", 600),)
    assert log.recorded(OUTPUTS) == ("N1_pct", "N2_pct")
    said = "f.csv:left: EGT_C is not recorded: nothing is learned or judged by it"
    assert cautions([log], ANYWHERE, OUTPUTS) == [said]
    assert with_outputs(log, OUTPUTS) is log


def test_the_column_that_was_looked_for_is_told():
    columns = {
        "time_s": {"column": "t"},
        "N2_pct": {"column": "{engine}_core"},
        "EGT_C": {"column": "{engine}_itt"},
    }
    mapping = LogsConfig.parse({"columns": columns, "engines": {"left": "lh", "right": "rh"}})
    tables = Preparation(logs=mapping, events=EventsConfig(condition=""))
    (said,) = cautions([flight("N1_pct")], tables, OUTPUTS)
    assert said == (
        "f.csv:left: N2_pct (column 'lh_core'), EGT_C (column 'lh_itt') are not recorded: nothing "
        "is learned or judged by them"
    )


def test_a_log_without_any_output_is_refused():
    with pytest.raises(DataError) as caught:
        with_outputs(flight("FF_kgph"), OUTPUTS)
    assert str(caught.value) == (
        "f.csv:left: the log has none of the outputs N1_pct, N2_pct, EGT_C. Map one of them under "
        "[logs.columns], or run the model alone by narxcal simulate. The log has TRA_deg, FF_kgph"
    )


def test_columns_can_be_spared_without_touching_the_others():
    columns = {"time_s": {"column": "t"}, "EGT_C": {"column": "itt"}, "Mach": {"column": "M"}}
    spared = LogsConfig.parse({"columns": columns}).sparing({"EGT_C"})
    assert {name: one.optional for name, one in spared.columns.items()} == {
        "time_s": False, "EGT_C": True, "Mach": False,
    }  # fmt: skip


def test_events_wait_for_the_responses_that_are_there():
    usual = EventsConfig(condition="")
    whole = flight("N1_pct", "N2_pct")
    assert usual.for_log(whole, OUTPUTS) == usual
    lacking = with_outputs(flight("N2_pct"), OUTPUTS)
    wanted = usual.for_log(lacking, OUTPUTS)
    assert wanted.response == ("N2_pct",)
    # N1 and N2 move alike here: the event has to end where it would with N1.
    assert find_events(lacking, wanted) == find_events(whole, usual)
    (early,) = find_events(lacking, usual)
    (event,) = find_events(lacking, wanted)
    assert early.stop < event.stop


def test_without_any_response_the_configuration_stays_for_the_events_to_refuse():
    usual = EventsConfig(condition="")
    assert usual.for_log(flight("FF_kgph"), OUTPUTS) is usual


def test_a_prepared_log_finds_its_events_and_equilibrium():
    log = with_outputs(flight("N2_pct"), OUTPUTS)
    one = Prepared(log, ANYWHERE, OUTPUTS)
    assert one.events == tuple(find_events(log, ANYWHERE.events.for_log(log, OUTPUTS)))
    expected = quasi_steady(log, "TRA_deg", ("N1_pct", "N2_pct"), QuasiSteadyConfig())
    np.testing.assert_array_equal(one.equilibrium, expected)


def test_a_speed_that_is_not_recorded_does_not_unsettle_a_log():
    log = with_outputs(flight("N2_pct"), OUTPUTS)
    config = QuasiSteadyConfig()
    both = quasi_steady(log, "TRA_deg", ("N1_pct", "N2_pct"), config)
    assert both.any()
    assert (both == quasi_steady(log, "TRA_deg", ("N2_pct",), config)).all()
