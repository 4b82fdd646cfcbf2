"""`narxcal fly`: what it writes, prints and refuses."""

import json
import signal
import time

import pytest

from data_prep.config import LogsConfig
from narxcal.flight_test.moves import FlightCard
from narxcal.flight_test.scenario import FlightScenario

QUICK = """\
schema = "narxcal.fly/1"
name = "quick"
engine = "business_jet"
flights = 2

[plan]
duration_s = 480.0
rate_hz = 8.0
"""


@pytest.fixture
def quick(tmp_path):
    file = tmp_path / "quick.toml"
    file.write_text(QUICK, "utf-8")
    return file


def names(folder):
    return sorted(str(file.relative_to(folder)) for file in folder.rglob("*") if file.is_file())


LAG = "[[effects]]\nid = 'sensor_lag'\nchannel = 'EGT_C'\nparameters = { tau_s = 1.5 }\n"
ALONE = ("--jobs", "1")  # flights this short are flown before a second process has started
LOGS = [f"flight_0{flight}_{side}.csv" for flight in (1, 2) for side in ("left", "right")]


def test_fly_writes_logs_and_truth_and_shows_a_table(narxcal, quick, tmp_path):
    out = tmp_path / "out"
    done = narxcal("fly", quick, "--out", out, *ALONE)
    assert (done.code, done.err) == (0, "")
    assert names(out) == [*LOGS, "truth.json"]
    assert [file.name for file in LogsConfig(folder=str(out)).resolve(out)] == LOGS
    lines = done.out.splitlines()
    assert lines[0] == "quick"
    assert lines[1].split() == [
        "log", "length", "[s]", "pushes", "pulls", "altitude", "[ft]", "Mach", "effects"
    ]  # fmt: skip
    assert [line.split()[0] for line in lines[2:6]] == [name[:-4] for name in LOGS]
    assert lines[6].split() == ["Effects", "none"]
    assert max(map(len, lines[:7])) <= 80


def test_a_window_after_the_end_of_every_flight_is_told(narxcal, quick, tmp_path):
    quick.write_text(
        QUICK + "[[effects]]\nid = 'unlogged_switch'\nparameters = { bleed = 0.01 }\n"
        "windows_s = [[100.0, 200.0], [600.0, 700.0]]\n",
        "utf-8",
    )
    words = ("--flights", "1", "--quiet")
    done = narxcal("fly", quick, "--out", tmp_path / "out", *words, *ALONE)
    assert (done.code, done.out) == (0, "")
    assert done.err == (
        "narxcal: warning: unlogged_switch: the window 600-700 s begins when every log with it is "
        "over, by 480 s: it changes nothing\n"
    )


def test_the_document_is_the_truth_file(narxcal, quick, tmp_path):
    out = tmp_path / "out"
    done = narxcal("fly", quick, "--out", out, "--json", "--seed", "3", "--flights", "1", *ALONE)
    document = json.loads(done.out)
    assert document.pop("out") == str(out)
    assert document == json.loads((out / "truth.json").read_text("utf-8"))
    assert document["schema"] == "narxcal.flight_truth/1"
    assert (document["seed"], len(document["logs"])) == (3, 2)


CARD = {
    "schema": "narxcal.card/1",
    "lever": "TRA_deg",
    "limits": {"altitude_ft": [5000.0, 5000.0], "mach": [0.4, 0.4], "climb_ft_min": 3000.0,
               "lever": [5.0, 80.0], "lever_per_s": 60.0},
    "steps": [{"name": "slam", "altitude_ft": 5000.0, "Mach": 0.4, "settle_s": 10.0,
               "corners": [[0.0, 5.0], [1.25, 80.0], [20.0, 80.0]], "share": 1.0}],
    "headline": "what else the card has is passed over",
}  # fmt: skip


def test_a_card_is_flown_on_every_flight_and_stays_with_the_truth(narxcal, quick, tmp_path):
    card, out = tmp_path / "card.json", tmp_path / "out"
    card.write_text(json.dumps(CARD), "utf-8")
    done = narxcal("fly", quick, "--out", out, "--card", card, "--json", *ALONE)
    assert (done.code, done.err) == (0, "")
    document = json.loads(done.out)
    assert len(document["logs"]) == 4
    for log in document["logs"]:
        assert [move["kind"] for move in log["lever_moves"]] == ["push"]
        assert log["alt_ft"] == [5000.0, 5000.0]
    again = FlightScenario.parse(document["scenario"])
    assert again.card == FlightCard.parse(CARD)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "cannot be read: No such file or directory\n"),
        (
            "{}",
            (
                "is no document of schema narxcal.card/1. narxcal card writes it next to the page, "
                "with the ending .json\n"
            ),
        ),
        (
            json.dumps(CARD | {"steps": []}),
            "key 'steps': expected a list of at least 1, found []\n",
        ),
    ],
)
def test_what_is_no_card_is_refused(narxcal, quick, tmp_path, text, words):
    card = tmp_path / "card.json"
    if text is not None:
        card.write_text(text, "utf-8")
    done = narxcal("fly", quick, "--out", tmp_path / "out", "--card", card)
    assert done.code == 2
    assert done.err == f"narxcal: error: {card}: {words}"


@pytest.mark.slow
def test_options_take_the_place_of_what_the_file_says(narxcal, quick, tmp_path):
    quick.write_text(
        QUICK + "[[effects]]\nid = 'sensor_bias'\nchannel = 'N1_pct'\n"
        "parameters = { offset = 1.0 }\n",
        "utf-8",
    )
    done = narxcal("fly", quick, "--out", tmp_path / "a", "--sensors", "perfect", "--json", *ALONE)
    document = json.loads(done.out)
    assert document["effects"][0]["parameters"] == {"offset": 1.0}
    assert document["scenario"]["sensors"]["preset"] == "perfect"
    assert document["scenario"]["plan"]["rate_hz"] == 8.0
    assert [len(log["effects"]) for log in document["logs"]] == [1, 1, 1, 1]
    as_said = narxcal("fly", quick, "--out", tmp_path / "c", "--flights", "1", "--json", *ALONE)
    assert json.loads(as_said.out)["scenario"]["sensors"]["preset"] == "test_instrumentation"


def test_effects_are_listed_with_size_and_reach(narxcal, quick, tmp_path):
    quick.write_text(f"{QUICK}{LAG}engines = ['left']\n", "utf-8")
    done = narxcal("fly", quick, "--out", tmp_path / "out", *ALONE)
    assert "sensor_lag@EGT_C  tau_s 1.5 (on 2 of 4 logs)" in done.out


@pytest.mark.slow
def test_bytes_do_not_depend_on_jobs_and_a_run_may_replace_an_earlier_one(narxcal, quick, tmp_path):
    quick.write_text(QUICK.replace("flights = 2", "flights = 2\nengines = ['left']"), "utf-8")
    one, two = tmp_path / "one", tmp_path / "two"
    wide = ("--gzip", "--truth-channels", "--quiet")
    assert narxcal("fly", quick, "--out", one, "--flights", "3", *ALONE, *wide).code == 0
    assert narxcal("fly", quick, "--out", one, *ALONE, *wide).out == ""
    assert narxcal("fly", quick, "--out", two, "--jobs", "2", *wide).code == 0
    zipped = [f"{name}.gz" for name in LOGS if "left" in name]
    assert names(one) == [*zipped, "truth.json", *(f"truth/{name}" for name in zipped)]
    for name in names(one):
        assert (one / name).read_bytes() == (two / name).read_bytes()


def test_a_folder_with_other_content_is_left_alone(narxcal, quick, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "flight_01_left.csv").write_text("mine", "utf-8")
    done = narxcal("fly", quick, "--out", tmp_path / "out")
    assert done.code == 2
    assert done.err == (
        f"narxcal: error: output folder {tmp_path / 'out'} holds other content "
        "('flight_01_left.csv') and is not overwritten. Choose another name, or empty it yourself\n"
    )
    assert names(tmp_path / "out") == ["flight_01_left.csv"]


REFUSED = {
    "--sensors ideal": "--sensors: Input should be 'test_instrumentation', 'fdr' or 'perfect', "
    "found 'ideal'",
    "--flights 1000": "--flights: Input should be less than or equal to 999",
    "--seed -1": "argument --seed: expected a whole number of 0 or more, found -1",
    "--flights 0": "argument --flights: expected a whole number of 1 or more, found 0",
}


@pytest.mark.parametrize("words", REFUSED)
def test_what_cannot_be_flown_is_refused_and_nothing_is_written(narxcal, quick, tmp_path, words):
    done = narxcal("fly", quick, "--out", tmp_path / "out", *words.split())
    assert done.code == 2
    assert done.err.startswith(f"narxcal: error: {REFUSED[words]}")
    assert done.err.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["quick.toml"]


def test_a_scenario_that_is_not_there_names_the_shipped_ones(narxcal, tmp_path):
    done = narxcal("fly", "demmo", "--out", tmp_path / "out")
    assert done.code == 2
    assert done.err == (
        "narxcal: error: demmo: the scenario does not exist. "
        "Name a file, or one of the shipped demo, enriched, line, narx_paper\n"
    )


@pytest.mark.parametrize("jobs", ["1", pytest.param("2", marks=pytest.mark.slow)])
def test_an_interrupted_run_leaves_nothing(start, quick, tmp_path, jobs):
    out = tmp_path / "out"
    process = start("fly", quick, "--out", out, "--flights", "999", "--jobs", jobs)
    while not list(tmp_path.glob(".out.*.part/*.csv")):
        assert process.poll() is None, process.communicate()
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate()
    assert (process.returncode, err) == (130, "narxcal: interrupted; nothing was written\n")
    assert [path.name for path in tmp_path.iterdir()] == ["quick.toml"]
