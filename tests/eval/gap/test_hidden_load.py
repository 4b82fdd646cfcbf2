"""An unlogged load from the logs to the document, the page, and back onto simulated logs."""

import json
from dataclasses import replace

import numpy as np
import pytest

from eval.gap import diagnose as module
from eval.gap.applied import read_effects
from eval.gap.blocks import batch
from eval.gap.diagnose import diagnose_pairs
from eval.gap.expected import expected, seen
from eval.gap.hidden_load import aircraft, look_for_load
from eval.gap.page import gap_page
from eval.gap.pairs import pair_logs
from eval.gap.summary import window_table
from tests.eval.gap.conftest import lagged
from training.budget.result import Interval

SIZES = {"on_N1_pct": -0.6, "on_N2_pct": -0.5, "on_EGT_C": 14.0}
SLOW = {"tau_s": Interval(9.0, 8.9, 9.1)}
WINDOWS = {
    0: (62.0, 119.0),
    1: (95.0, 170.0),
    2: (43.0, 111.0),
    3: (123.0, 197.0),
    4: (72.0, 131.0),
}


class NoEmulator:
    """Stands in for the emulator, which a load does not need."""

    calibration = None

    def errors(self, flights):
        return np.zeros(len(flights.signals.outputs))


def loaded(seed):
    """Outputs with the load on in this flight's window."""

    def change(channels):
        time_s = channels["time_s"]
        since = [np.maximum(time_s - t, 0.0) for t in WINDOWS[seed]]
        there = np.exp(-since[1]) - np.exp(-since[0])
        return {key[3:]: channels[key[3:]] + size * there for key, size in SIZES.items()}

    return change


@pytest.fixture
def found(pair, monkeypatch, make_finding, make_model):
    """A diagnosis of three flights and two held out, whose clock starts at 100 s."""
    sizes = {key: Interval(size, 0.9 * size, 1.1 * size) for key, size in SIZES.items()}
    model = make_model("unlogged_switch", parameters={"unlogged_switch": sizes})
    answer = make_finding("effects", ("unlogged_switch",), (model,))
    monkeypatch.setattr(module, "fit_emulators", lambda _flights: (NoEmulator(),))
    monkeypatch.setattr(module, "diagnose", lambda *_args, **_more: answer)
    pairs = [pair(seed, loaded(seed)) for seed in range(5)]
    late = [replace(each, time_s=each.time_s + 100.0) for each in pairs]
    return diagnose_pairs(late[:3], late[3:])


def windows_of(document):
    rows = [row for row in document["effects"] if row["id"] == "unlogged_switch"]
    return rows[0]["windows"]


def test_windows_stand_in_the_document_by_log_and_clock(found):
    rows = windows_of(found.document)
    assert [row["log"] for row in rows] == [f"flight_{k}" for k in range(5)]
    assert [row["held_out"] for row in rows] == [False] * 3 + [True] * 2
    for row, times in zip(rows, WINDOWS.values(), strict=True):
        assert row["log_start_s"] == 100.0
        assert row["start_s"] - 100.0 == pytest.approx(times[0], abs=1.5)
        assert row["end_s"] - 100.0 == pytest.approx(times[1], abs=1.5)
        low, high = row["start_span_s"]
        assert low <= row["start_s"] <= high
        size = row["shift"]["EGT_C"]
        assert size["low"] < size["value"] < size["high"]
        assert size["value"] == pytest.approx(14.0, abs=0.8)
    json.dumps(found.document)


def test_held_out_flights_are_told_by_sizes_from_elsewhere(found):
    shrink = found.document["shrink"]
    assert shrink["realised"] > 0.9
    assert shrink["channels"]["EGT_C"]["after"] < 0.4 * shrink["channels"]["EGT_C"]["before"]


def test_of_a_load_no_input_tells_how_much_there_is_in_other_flights(found):
    told = found.evidence
    here = seen(told.data, told.after, told.finding.by_others)
    assert told.held_out is not None
    assert told.predicted == expected(here)


def test_terminal_and_page_tell_the_windows(found):
    title, head, rows = window_table(found.document)
    assert title == "When the load was on (* held out)"
    assert head[:3] == ("log", "from [s]", "to [s]")
    assert len(rows) == 5
    assert rows[3][0] == "flight_3 *"
    assert all("±" in cell and " " not in cell for row in rows for cell in row[1:])
    html = gap_page(found.document, found.evidence)
    assert "When the load was on" in html
    assert "held out" in html


def test_windows_go_onto_the_logs_they_were_found_in_and_no_others(found, tmp_path, fly, log_of):
    file = tmp_path / "gap.json"
    file.write_text(json.dumps(found.document, default=float))
    effects = read_effects(file)
    sim = fly(1, rate_hz=32.0, start_s=50.0)
    outputs = effects.added_to(log_of(sim), "flight_1")
    since = sim["time_s"] - 50.0
    inside = (since > WINDOWS[1][0] + 8.0) & (since < WINDOWS[1][1] - 3.0)
    np.testing.assert_allclose((outputs["EGT_C"] - sim["EGT_C"])[inside], 14.0, atol=0.1)
    before = since < WINDOWS[1][0] - 3.0
    np.testing.assert_allclose((outputs["EGT_C"] - sim["EGT_C"])[before], 0.0, atol=1e-9)
    assert effects.has_load
    assert effects.knows("flight_4")
    assert not effects.knows("elsewhere")
    np.testing.assert_array_equal(effects.added_to(log_of(sim), "elsewhere")["EGT_C"], sim["EGT_C"])


def test_no_load_is_said_with_its_reason(pair, probe, monkeypatch, make_finding, make_model):
    answer = make_finding("effects", ("sensor_lag:EGT_C",), (make_model("sensor_lag:EGT_C"),))
    monkeypatch.setattr(module, "fit_emulators", lambda _flights: (NoEmulator(),))
    monkeypatch.setattr(module, "diagnose", lambda *_args, **_more: answer)
    document = diagnose_pairs([pair(seed, probe) for seed in range(3)]).document
    assert document["quality"]["unlogged_load"] not in ("", "found")
    assert window_table(document)[2] == []


def test_what_an_effect_of_lever_moves_hides_is_found_in_what_it_leaves(
    pair, monkeypatch, make_finding, make_model
):
    """A lag of the temperature probe so long that nothing ever rests hides the load."""

    def both(seed):
        def change(channels):
            told = loaded(seed)(channels)
            dt_s = channels["time_s"][1] - channels["time_s"][0]
            return {**told, "EGT_C": lagged(told["EGT_C"], 9.0, dt_s)}

        return change

    asked = []

    def answer(flights, *_args, **_more):
        asked.append(flights.signals.inputs)
        lag = make_model("sensor_lag:EGT_C", parameters={"sensor_lag:EGT_C": SLOW})
        return make_finding("effects", ("sensor_lag:EGT_C",), (lag,))

    monkeypatch.setattr(module, "fit_emulators", lambda _flights: (NoEmulator(),))
    monkeypatch.setattr(module, "diagnose", answer)
    found = diagnose_pairs([pair(seed, both(seed)) for seed in range(4)])
    assert ["unlogged" in inputs for inputs in asked] == [False, True]
    assert found.document["quality"]["unlogged_load"] == "found"
    assert len(found.evidence.windows) == 4


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (("a_left", "a_right", "b_left", "b_right"), ((0, 1), (2, 3))),
        (("a_lh", "a_rh", "b", "c"), ((0, 1),)),
        (("a_left_1", "a_left_2", "a_right_1", "a_right_2"), ((0, 2), (1, 3))),
        (("flight_1", "flight_2", "flight_3", "flight_4"), ()),
        (("f_eng1", "f_eng2", "g_eng1", "h_eng2"), ((0, 1),)),
    ],
)
def test_engines_of_one_aircraft_are_known_by_name_and_place(names, expected, make_data):
    data = make_data(flights=4)
    u = data.flights.u.copy()
    ambient = [data.flights.signals.u(name) for name in ("ALT_ft", "Mach", "dT_C")]
    for group in expected:
        u[group[1]][:, ambient] = u[group[0]][:, ambient]
    data = replace(data, flights=replace(data.flights, u=u), names=names)
    assert aircraft(data) == expected


def test_engines_flown_elsewhere_are_no_pair(make_data):
    data = replace(make_data(flights=2), names=("a_left", "a_right"))
    assert aircraft(data) == ()


def test_a_channel_without_any_gap_is_no_reason_for_a_warning(fly, record, log_of):
    """Warnings are errors in these tests."""
    pairs = []
    for seed in range(3):
        sim = fly(seed)
        real = {**record(sim, seed), "N2_pct": sim["N2_pct"]}
        pairs.append(pair_logs(f"f{seed}", log_of(real), log_of(sim)))
    _, load = look_for_load(batch(pairs))
    assert load.windows == ()
