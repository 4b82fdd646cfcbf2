"""`narxcal reproduce` end to end on tiny data sets, its page, and what it refuses."""

import json

import pytest
from markupsafe import escape

from narxcal.calibration.bundle import load_bundle
from narxcal.cli import main
from narxcal.cli import reproduce as command

CONFIG = """\
schema = "narxcal.config/1"
name = "tiny"

[logs]
files = ["data_set_*.csv"]
raster_hz = 8.0

[smooth]
window = 3

[split]
train = ["*"]
test = ["data_set_3*"]

[narx]
hidden = 2
lags = 1
lag_limits = false

[train]
choice_s = 0 # mixtures have tests of their own

[steady_state]
kind = "table"
source = "MAKER"
inputs = ["TRA_deg", "ALT_ft", "Mach", "dT_C", "WOW", "Approach"]
"""
STUDIES = [
    "correlation", "smoothing", "segments", "inputs", "deviations", "accuracy",
    "response_times", "splits", "noise", "goal",
]  # fmt: skip


def strict(text):
    def refuse(constant):
        pytest.fail(f"{constant} is not JSON")

    return json.loads(text, parse_constant=refuse)


@pytest.fixture(scope="module")
def place(tmp_path_factory, piece, maker_table):
    """A folder of three data sets and their configuration."""
    folder = tmp_path_factory.mktemp("paper")
    (folder / "sets").mkdir()
    for number in (1, 2, 3):
        piece(number).to_csv(folder / "sets" / f"data_set_{number}.csv")
    (folder / "tiny.toml").write_text(CONFIG.replace("MAKER", maker_table["source"]), "utf-8")
    return folder


def arguments(place, out, *more):
    words = ["reproduce", "narx-paper", "--config", place / "tiny.toml", "--data", place / "sets"]
    return [str(word) for word in (*words, "--out", out, "--quick", "--jobs", "1", *more)]


@pytest.fixture(scope="module")
def out(place):
    folder = place / "out"
    assert main(arguments(place, folder, "--quiet")) == 1  # a few steps reach nobody's figures
    return folder


@pytest.fixture(scope="module")
def document(out):
    return strict((out / "reproduce.json").read_text("utf-8"))


def test_every_study_is_in_the_document_with_claims_and_outcome(document):
    assert document["schema"] == "narxcal.reproduce/1"
    assert (document["paper"], document["complete"], document["quick"]) == (
        "narx-paper", True, True,
    )  # fmt: skip
    assert [study["study"] for study in document["studies"]] == STUDIES
    assert document["test"] == [3]
    claims = [claim for study in document["studies"] for claim in study["claims"]]
    for claim in claims:
        assert set(claim) == {
            "what", "origin", "claimed", "ours", "unit", "bound", "met", "remark",
        }  # fmt: skip
        assert (claim["met"] is None) == (claim["ours"] is None)
    assert document["ok"] is False
    assert len(document["missed"]) == sum(claim["met"] is False for claim in claims)


def test_the_page_needs_nothing_but_itself_and_shows_what_the_document_says(
    out, document, sound_page
):
    page = sound_page((out / "reproduce.html").read_text("utf-8"))
    text = " ".join(page.text)
    for study in document["studies"]:
        assert study["study"] in page.ids
        assert study["title"] in text
        assert all(claim["what"] in text for claim in study["claims"])
    assert "quick: too few training steps to judge by" in text


def test_the_model_is_there_to_be_used(out):
    assert load_bundle(out / "model").calibration.output_names == ("N1_pct", "N2_pct", "EGT_C")


def test_a_result_may_be_replaced_but_nothing_else(place, out, tmp_path, capsys):
    command.RESULTS.check(out)
    (tmp_path / "mine.txt").write_text("mine", "utf-8")
    assert main(arguments(place, tmp_path)) == 2
    assert "holds other content ('mine.txt')" in capsys.readouterr().err


def test_an_unknown_paper_is_refused(capsys):
    assert main(["reproduce", "magna-carta", "--out", "x"]) == 2
    assert "invalid choice: 'magna-carta'" in capsys.readouterr().err


@pytest.mark.slow
def test_an_older_paper_makes_a_page_and_a_document_that_agree(tmp_path, capsys, monkeypatch):
    out = tmp_path / "out"
    monkeypatch.setattr(command, "SPEY_QUICK_SEEDS", 1)
    code = main(["reproduce", "spey", "--quick", "--out", str(out), "--json"])
    document = json.loads(capsys.readouterr().out)
    assert code == (0 if document["ok"] else 1)
    assert document == json.loads((out / "reproduce.json").read_text("utf-8"))
    claims = [claim for study in document["studies"] for claim in study["claims"]]
    page = (out / "reproduce.html").read_text("utf-8")
    assert len(claims) > 5
    assert len(document["missed"]) == sum(claim["met"] is False for claim in claims)
    assert all(str(escape(claim["what"])) in page for claim in claims)
    known = [claim for claim in claims if "S12" in claim["what"] or "35 %" in claim["what"]]
    assert known
    assert all(claim["met"] for claim in known)
    (shares,) = [row["coverage"] for row in document["studies"] if "coverage" in row]
    assert shares["pooled"] > 65.0


def test_too_few_data_sets_end_in_one_line(place, tmp_path, capsys):
    words = arguments(place, tmp_path / "out")
    (tmp_path / "sets").mkdir()
    first = (place / "sets" / "data_set_1.csv").read_bytes()
    (tmp_path / "sets" / "data_set_1.csv").write_bytes(first)
    words[words.index(str(place / "sets"))] = str(tmp_path / "sets")
    assert main(words) == 2
    shown = capsys.readouterr().err
    assert shown.count("\n") == 1
    assert "at least 3 data sets, found 1" in shown


def test_without_data_the_virtual_engine_flies(place, tmp_path, monkeypatch):
    seen = []

    def fake_write(folder, scenario, jobs):
        seen.append((folder, scenario.seed, scenario.build_scatter_pct, scenario.records, jobs))

    def fake_flown(config, base, folder):
        raise KeyboardInterrupt(str(folder))

    monkeypatch.setattr(command, "write_records", fake_write)
    monkeypatch.setattr(command, "flown", fake_flown)
    monkeypatch.delenv("NARXCAL_DATA", raising=False)
    out = tmp_path / "out"
    words = ["reproduce", "narx-paper", "--out", str(out), "--seed", "7", "--jobs", "3"]
    assert main(words) == 130
    assert seen == [(out / "flights", 7, 0.0, "fast_push", 3)]
    left = strict((out / "reproduce.json").read_text("utf-8"))
    assert left == {"schema": "narxcal.reproduce/1", "complete": False}


def test_own_data_with_the_virtual_engines_model_are_warned_of(place, tmp_path, capsys):
    (tmp_path / "sets").mkdir()
    words = ["reproduce", "narx-paper", "--data", str(tmp_path / "sets")]
    assert main([*words, "--out", str(tmp_path / "out")]) == 2
    shown = capsys.readouterr().err
    assert "warning: narx_paper.toml has the virtual engine's steady-state model" in shown
    (tmp_path / "sets" / "maker.csv").touch()
    assert main([*words, "--out", str(tmp_path / "out")]) == 2
    assert "warning" not in capsys.readouterr().err
