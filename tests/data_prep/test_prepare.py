"""Preparation: warnings, missing outputs, held inputs, and logs that nobody here wrote."""

from __future__ import annotations

import tomllib
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_prep.cleaning.clean import CleanConfig, clean
from data_prep.cleaning.smooth import SmoothConfig, smooth
from data_prep.config import LogsConfig
from data_prep.equilibrium import QuasiSteadyConfig, quasi_steady
from data_prep.events import EventsConfig, find_events
from data_prep.log import AuditEntry, Log, Source
from data_prep.prepare import Preparation, Prepared, cautions, hold_inputs, prepare, with_outputs
from data_prep.reading import read_logs
from narxcal.support.arrays import runs
from narxcal.support.errors import DataError

ROOT = Path(__file__).parents[2]
DATA = ROOT.parent / "shared" / "data"


def table(name):
    return tomllib.loads((ROOT / "configs" / f"{name}.toml").read_text("utf-8"))


@cache
def recorded(name):
    """All logs that the shipped configuration `name` maps, raw."""
    path = ROOT / "configs" / f"{name}.toml"
    config = LogsConfig.parse(table(name)["logs"])
    if not DATA.is_dir():
        pytest.skip(f"the recorded flights are not at {DATA}")
    return read_logs(config.resolve(path.parent), config)


@cache
def cleaned(name, number):
    """One of those logs, cleaned as it is."""
    return clean(recorded(name)[number])


@cache
def gap_logs(kind):
    files = sorted((DATA / "gap_example").glob(f"case_*/{kind}*/*.csv.gz"))
    if not files:
        pytest.skip(f"the gap cases are not at {DATA}")
    return read_logs(files)


def prepared(name):
    tables = table(name)
    sections = Preparation(
        clean=CleanConfig.parse(tables.get("clean", {})),
        smooth=SmoothConfig.parse(tables.get("smooth", {})),
    )
    logs = [one.log for one in prepare(recorded(name), sections)]
    return logs, EventsConfig.parse(tables["events"])


def test_prepare_cleans_then_smooths():
    values = 75 + np.random.default_rng(0).normal(0, 0.05, 3200)
    values[1000] = 95.0
    log = Log("f", np.arange(3200) / 32, {"N1_pct": values})
    done = prepare([log])[0].log
    expected = smooth(clean(log))
    np.testing.assert_array_equal(done["N1_pct"], expected["N1_pct"])
    assert done.audit == expected.audit
    assert abs(done["N1_pct"][1000] - 75) < 0.1


@pytest.mark.parametrize("name", ["citation2", "agtf30", "jetcat"])
def test_no_good_recording_is_masked_and_few_samples_are_repaired(name):
    for log in recorded(name):
        entries = clean(log).audit.entries[len(log.audit.entries) :]
        assert [entry for entry in entries if entry.action == "masked"] == []
        for entry in entries:
            assert entry.samples < 0.004 * len(log), (log.name, entry)


@pytest.mark.parametrize("kind", ["sim", "real"])
def test_no_gap_case_is_masked_nor_a_noise_free_output_touched(kind):
    for log in gap_logs(kind):
        entries = clean(log).audit.entries[len(log.audit.entries) :]
        assert [entry for entry in entries if entry.action == "masked"] == []
        if kind == "sim":
            assert {entry.channel for entry in entries} <= {"ALT_ft", "Mach", "dT_C"}


def fault(values, kind, rows, rng):
    """Put one kind of sensor fault into `rows`; returns the channel and the rows it hit."""
    broken = values.copy()
    if kind == "frozen":
        broken[rows] = broken[rows[0]]
    elif kind == "spiking":
        rows = rows[rng.random(len(rows)) < 0.3]
        size = 0.5 * np.ptp(np.percentile(values, (1, 99)))
        broken[rows] += size * rng.uniform(0.5, 1.5, len(rows)) * rng.choice([-1, 1], len(rows))
    else:
        broken[rows] = float(kind)
    return broken, rows


@pytest.mark.parametrize("name", ["citation2", "agtf30"])
@pytest.mark.parametrize(
    ("channel", "kind", "seconds"),
    [
        ("N2_pct", "frozen", 40),
        ("EGT_C", "spiking", 20),
        ("FF_kgph", "0", 30),
        ("FF_kgph", "9999", 30),
        ("N1_pct", "0", 3),
    ],
)
def test_injected_faults_are_found_and_only_they(name, channel, kind, seconds):
    rng = np.random.default_rng(7)
    for number in (-2, -1):
        log, base = recorded(name)[number], cleaned(name, number)
        values, hits = log[channel], []
        near = np.zeros(len(log), dtype=np.bool_)
        for part in (0.04, 0.3, 0.72):
            first = round(part * len(log))
            rows = np.arange(first, first + round(seconds / log.dt_s))
            values, hit = fault(values, kind, rows, rng)
            hits.append(hit)
            near[first - 1 : rows[-1] + 2] = True
        done = clean(log.with_channels({channel: values}))
        lost = np.isnan(done[channel])
        touched = lost | (done[channel] != values)
        assert all(touched[hit].mean() > 0.95 for hit in hits)
        assert not lost[~near].any()
        for other in log.channels:
            if other != channel:
                np.testing.assert_array_equal(done[other], base[other])


def test_every_lever_move_of_the_simulated_flights_is_an_event_with_its_exact_start():
    logs, config = prepared("agtf30")
    for log in logs:
        moving = np.flatnonzero(np.diff(log["TRA_deg"]) != 0)
        first = np.concatenate(([True], np.diff(moving) > 16))
        assert [event.start for event in find_events(log, config)] == moving[first].tolist()


def rapid_changes(speed, dt_s, sign):
    """The independent criterion: N1 by more than 15 % within 8 s, as spans of samples."""
    window = round(8.0 / dt_s)
    starts, stops = runs(sign * (speed[window:] - speed[:-window]) > 15.0)
    spans = []
    for start, stop in zip(starts.tolist(), stops.tolist(), strict=True):
        if spans and start - spans[-1][1] < 2.0 / dt_s:
            spans[-1][1] = stop
        else:
            spans.append([start, stop])
    return [(start - round(1.0 / dt_s), stop + window) for start, stop in spans]


def test_every_rapid_push_and_pull_of_the_citation_is_an_event():
    logs, config = prepared("citation2")
    everywhere = config.model_copy(update={"condition": ""})
    for log in logs:
        events = find_events(log, everywhere)
        for label, sign, fewest, most in ((0, 1, 9, 14), (1, -1, 5, 12)):
            spans = rapid_changes(log["N1_pct"], log.dt_s, sign)
            starts = [event.start for event in events if event.label == label]
            assert fewest <= len(spans) <= most
            for start, stop in spans:
                assert any(start <= at <= stop for at in starts), (log.name, label, start)


def test_citation_events_in_flight_hold_no_sample_on_the_ground():
    logs, config = prepared("citation2")
    for log in logs:
        events = find_events(log, config)
        assert len(events) > 10
        for event in events:
            assert (log["WOW"][event.start : event.stop] == 0).all()


ANYWHERE = Preparation(events=EventsConfig(condition=""))


def warnings(log, tables=ANYWHERE, outputs=()):
    return {one.kind: one.text for one in Prepared(log, tables, outputs).warnings}


def written(folder, stamps):
    rows = [f"{stamp:.10g},{80 + k},30" for k, stamp in enumerate(stamps)]
    path = folder / "log.csv"
    path.write_text("\n".join(["time_s,N1_pct,TRA_deg", *rows]) + "\n", encoding="utf-8")
    return read_logs(path)[0]


def test_stamps_coarser_than_the_rows_are_told(tmp_path):
    some = np.sort(np.random.default_rng(1).uniform(0.0, 50.0, 400))  # as rows of a bus come
    log = written(tmp_path, np.floor(some))
    said = (
        "log.csv: 350 rows have the time stamp of the row before and were left out; its stamps are "
        "coarser than its rows"
    )
    assert cautions([log], ANYWHERE)[0] == said
    assert warnings(log).keys() == {"crowded", "rate"}
    assert warnings(log, Preparation()).keys() == {"crowded", "rate", "condition"}


def test_a_few_equal_stamps_are_no_caution(tmp_path):
    stamps = np.arange(400) / 8
    stamps[100] = stamps[99]
    log = written(tmp_path, stamps)
    assert any(entry.reason == "duplicate time stamp" for entry in log.audit.entries)
    assert cautions([log], ANYWHERE) == []


def test_speeds_in_the_wrong_unit_are_told():
    time, ratio = np.arange(40) / 8, np.linspace(0.3, 1.04, 40)
    log = Log("rig.csv", time, {"N1_pct": ratio, "N2_pct": 0.9 * ratio})
    highest = "N1_pct 1.04 % and N2_pct 0.936 %"
    said = f"rig.csv: the engine never runs, at most {highest}: is the unit right?"
    assert cautions([log], ANYWHERE) == [said]
    assert warnings(log.with_channels({"N2_pct": 90.0 * ratio})) == {}
    assert warnings(Log("none.csv", time, {"EGT_C": ratio})) == {}
    assert warnings(Log("lost.csv", time, {"N1_pct": np.full(40, np.nan)})) == {}


def test_a_channel_of_which_nothing_is_left_is_told_with_why():
    speeds = {"N1_pct": np.linspace(5000.0, 7000.0, 400), "N2_pct": np.linspace(80.0, 90.0, 400)}
    log = clean(Log("rpm.csv", np.arange(400) / 8, speeds))
    said = "rpm.csv: no sample is left of N1_pct (out of range): check column and unit"
    assert cautions([log], ANYWHERE) == [said]
    assert "masked" not in warnings(log.with_channels({"N1_pct": speeds["N2_pct"]}))


def test_recordings_too_slow_for_ti_and_tt_are_told(tmp_path):
    path = tmp_path / "qar.csv"
    lever = [f"{k / 8:g},{30 + k % 40},{80 + k % 9 if k % 8 == 0 else ''}" for k in range(400)]
    path.write_text("\n".join(["time_s,TRA_deg,N1_pct", *lever]) + "\n", encoding="utf-8")
    (log,) = read_logs(path)
    said = (
        "qar.csv: N1_pct is sampled every 1 s, coarser than the tolerance of 0.25 s on Ti and Tt: "
        "these times are limited by interpolation"
    )
    assert cautions([log], ANYWHERE) == [said]
    assert warnings(log, Preparation(events=EventsConfig(condition="", response=()))) == {}
    time = 0.5 * np.arange(40)
    slow = Log("slow.csv", time, {"TRA_deg": time, "N1_pct": 80.0 + time})
    assert warnings(slow)["rate"].startswith(
        "TRA_deg is sampled every 0.5 s and N1_pct is sampled every 0.5 s, coarser than"
    )


def test_many_logs_with_the_same_warning_are_one_line():
    time = np.arange(40) / 8
    logs = [Log(name, time, {"N1_pct": 80.0 + time}) for name in "abcde"]
    said = "there is no WOW channel: events on the ground count like those in flight"
    assert cautions(logs, Preparation()) == [f"a, b, c and 2 more: {said}"]
    assert cautions(logs[:2], Preparation()) == [f"a, b: {said}"]


def test_many_logs_with_like_warnings_are_the_first_one_and_a_count():
    time = np.arange(40) / 8
    logs = [Log(f"{k}.csv", time, {"N1_pct": (1.0 + 0.1 * k) * time / 5.0}) for k in range(64)]
    (line,) = cautions(logs, ANYWHERE)
    assert line == (
        "0.csv and, likewise, 63 more: the engine never runs, at most N1_pct 0.975 %: "
        "is the unit right?"
    )
    assert len(cautions(logs[:3], ANYWHERE)) == 3


def test_a_window_that_blurs_is_a_warning_of_its_logs():
    log = Log("a.csv", np.arange(40) / 8, {"N1_pct": np.full(40, 80.0)})
    tables = Preparation(events=EventsConfig(condition=""), smooth=SmoothConfig(window=11))
    assert warnings(log, tables) == {
        "window": "[smooth] window = 11 lasts 1.4 s at 8 Hz, which blurs fast movements: take 1"
    }


DT_S = 0.1
OUTPUTS = ("N1_pct", "N2_pct", "EGT_C")


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


def test_a_model_needs_the_columns_of_its_inputs_alone(tmp_path):
    names = {"time_s": "t", "EGT_C": "itt", "FF_kgph": "fuel", "Mach": "M"}
    columns = {name: {"column": column} for name, column in names.items()}
    mapping = LogsConfig.parse({"columns": columns})
    path = tmp_path / "log.csv"
    path.write_text("t,M\n" + "".join(f"{k / 10},0.3\n" for k in range(40)), "utf-8")
    with pytest.raises(DataError, match="channel EGT_C: column 'itt' is missing"):
        read_logs([path], mapping)
    (log,) = read_logs([path], mapping.for_inputs(["Mach"]))
    assert set(log.channels) == {"Mach"}
    path.write_text("t,fuel\n0,1\n0.1,1\n", "utf-8")
    with pytest.raises(DataError, match="channel Mach: column 'M' is missing"):
        read_logs([path], mapping.for_inputs(["Mach"]))


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


NAN = float("nan")


def inputs_log(**channels):
    values = {name: np.array(value, dtype=float) for name, value in channels.items()}
    count = len(next(iter(values.values())))
    return Log("flight.csv:left", 0.1 * np.arange(count), values)


def test_the_last_value_is_carried_on_and_the_first_back():
    given_ = inputs_log(Mach=[NAN, 0.3, NAN, NAN, 0.5, NAN], N1_pct=[NAN] * 6)
    held = hold_inputs(given_, ["Mach"])
    assert held["Mach"].tolist() == [0.3, 0.3, 0.3, 0.3, 0.5, 0.5]
    assert np.isnan(held["N1_pct"]).all()
    assert held.audit.entries == (AuditEntry("Mach", "filled", "held for the model", 4),)
    assert np.isnan(given_["Mach"]).sum() == 4


def test_a_complete_log_is_left_as_it_is():
    given_ = inputs_log(Mach=[0.1, 0.2], TRA_deg=[1.0, 2.0])
    assert hold_inputs(given_, ["Mach", "TRA_deg"]) is given_


@given(values=st.lists(st.one_of(st.just(NAN), st.floats(-1e3, 1e3)), min_size=2, max_size=30))
def test_known_samples_stay_and_none_is_unknown(values):
    known = np.isfinite(values)
    if not known.any():
        return
    held = hold_inputs(inputs_log(Mach=values), ["Mach"])["Mach"]
    assert np.array_equal(held[known], np.array(values)[known])
    assert np.isfinite(held).all()
    assert set(held) <= set(np.array(values)[known])


def test_a_channel_without_any_sample_is_refused():
    with pytest.raises(DataError) as error:
        hold_inputs(inputs_log(Mach=[NAN, NAN]), ["Mach"])
    assert str(error.value) == (
        "flight.csv:left, channel Mach: an input of the model has no valid sample. "
        "Map another column to it, or leave the log out"
    )


def test_a_channel_that_is_not_there_is_refused():
    with pytest.raises(DataError) as error:
        hold_inputs(inputs_log(Mach=[0.1, 0.2]), ["TRA_deg"])
    assert str(error.value) == (
        "flight.csv:left, channel TRA_deg: an input of the model is not in the log. Map it under "
        "[logs.columns], if need be as TRA_deg = { constant = ... }, or take it out of "
        "[steady_state] inputs. The log has Mach"
    )


def test_a_fragment_without_a_channel_is_left_out_and_counted():
    """Four seconds between two pauses, of which cleaning leaves no speed."""
    speed = 70.0 + np.sin(np.arange(1200) / 90.0)
    lost = np.where(np.arange(1200) < 40, np.nan, speed)[:40]
    logs = [
        Log(name, start_s + 0.1 * np.arange(len(values)), {"N1_pct": values, "FF_kgph": 9 * values})
        for name, start_s, values in (("a", 0, speed), ("a#2", 200, speed[:40]), ("b", 0, speed))
    ]
    assert [one.log.name for one in prepare(logs)] == ["a", "a#2", "b"]
    logs[1] = logs[1].with_channels({"N1_pct": lost})
    found = prepare(logs)
    assert [one.log.name for one in found] == ["a", "b"]
    reason = "fragment without a valid sample of a channel"
    assert AuditEntry("*", "dropped", reason, 40) in found[0].log.audit.entries
    text = "a: 40 samples are left out: in parts below 20 s nothing is left of a channel"
    assert text in cautions([one.log for one in found], Preparation())
    logs[0] = logs[0].with_channels({"N1_pct": np.full(1200, np.nan)})
    assert [one.log.name for one in prepare(logs)] == ["a", "a#2", "b"]
