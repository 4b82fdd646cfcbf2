"""`narxcal diagnose` from end to end, its page, and `simulate --effects` on it."""

import json
import shutil

import pandas as pd
import pytest
from matplotlib import pyplot as plt

import narxcal
from eval.diagnosis.diagnose import Request, _learned_of
from eval.diagnosis.learned import keep_learned, learned_by
from eval.diagnosis.page import budget_table, console_tables, sizes_table
from eval.diagnosis.simulators import open_simulator
from eval.diagnosis.words import outcome, sentences
from narxcal.cli import main
from narxcal.support.errors import ConfigError, ModelError
from narxcal.support.progress import silent

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def document(diagnosed):
    return json.loads((diagnosed / "gap.json").read_text("utf-8"))


def test_the_slow_probe_is_named_with_its_size_and_closes_the_gap_on_another_flight(document):
    assert document["schema"] == "narxcal.gap/2"
    assert document["verdict"]["effects"] == ["sensor_lag:EGT_C"]
    [row] = [row for row in document["effects"] if row["id"] == "sensor_lag"][:1]
    size = row["parameters"]["tau_s"]
    assert size["low"] <= 1.2 <= size["high"]
    assert document["shrink"]["realised"] > 0.9


def test_shares_add_up_to_the_whole_gap_by_channel_and_by_phase(document):
    rows = document["budget"]
    assert sum(row["share"] for row in rows) == pytest.approx(1.0, abs=1e-6)
    for row in rows:
        assert sum(row["channels"].values()) == pytest.approx(row["share"], abs=1e-9)
        assert sum(row["phases"].values()) == pytest.approx(row["share"], abs=1e-9)
        assert row["low"] <= row["share"] <= row["high"]


def test_the_page_says_what_the_document_says(diagnosed, document):
    html = (diagnosed / "gap.html").read_text("utf-8")
    first, *rest = sentences(document)
    assert first.startswith("Lag of the EGT sensor (sensor_lag:EGT_C), 100 % probable, tau_s 1.")
    assert rest[-1].endswith(" of the gap is left over that no effect known to narxcal explains.")
    assert outcome(document).headline == first
    assert first in html
    for table in (budget_table(document), sizes_table(document)):
        assert all(row[0].text in html for row in table.rows)


def test_tables_of_the_terminal_name_every_cause_and_fit_it(document):
    (_, _, causes), (_, _, others) = console_tables(document)
    assert len(causes) == len(document["budget"])
    assert all(row[0] != "sensor_lag:EGT_C" for row in others)
    assert all(len("  ".join(row)) <= 100 for row in (*causes, *others))


def test_the_named_effect_is_added_to_a_simulation(case, diagnosed):
    out = case / "with_effects"
    code = main(
        ["simulate", "--sim", str(case / "sim_held"), "--effects", str(diagnosed / "gap.json"),
         "--inputs", str(case / "real_held"), "--out", str(out), "--quiet"]
    )  # fmt: skip
    assert code == 0
    made, real, sim = (
        pd.read_csv(folder / "f3.csv")["EGT_C"]
        for folder in (out, case / "real_held", case / "sim_held")
    )
    assert (made - real).std() < 0.2 * (sim - real).std()


def test_python_gives_the_budget_as_a_table_and_a_figure(case):
    found = narxcal.diagnose(case / "real", case / "sim")
    assert found.table["share"].sum() == pytest.approx(1.0, abs=1e-6)
    assert found.table.index[0] == "sensor_lag:EGT_C"
    [axes] = found.plot().axes
    assert axes.get_xlabel() == "share of the energy of the whole gap"
    assert narxcal.plot.gap(found, ax=axes) is axes
    plt.close(axes.figure)
    assert "sensor_lag:EGT_C" in found._repr_html_()


def test_what_a_simulator_gets_wrong_by_itself_is_learned_and_then_no_finding(
    case, tmp_path, capsys
):
    run = tmp_path / "run"
    run.mkdir()
    arguments = ["diagnose", "--real", str(case / "real"), "--sim", str(case / "sim"), "--quiet"]
    assert main([*arguments, "--learn", "--out", str(run)]) == 2
    assert capsys.readouterr().err.startswith(f"narxcal: error: {run}: --learn needs a run folder")
    (run / "bundle.json").write_text("{}")
    assert main([*arguments, "--learn", "--out", str(run)]) == 0
    learned = learned_by(run)
    assert learned.logs == 3
    (run / "discrepancy.json").write_text('{"flights": "x"}')
    with pytest.raises(ModelError, match="Learn it again"):
        learned_by(run)


def test_a_run_learns_from_its_own_flights_what_it_gets_wrong(
    project, tmp_path, capsys, monkeypatch
):
    run = tmp_path / "run"
    shutil.copytree(project / "run", run)
    assert main(["diagnose", "--learn", "--out", str(run)]) == 0
    assert capsys.readouterr().out.startswith("Learned from ")
    learned = learned_by(run)
    assert learned.logs >= 1
    assert set(learned.noise) == {"N1_pct", "N2_pct", "EGT_C"}

    # It is used where it cannot be kept.
    (run / "discrepancy.json").unlink()
    (run / "discrepancy.json").mkdir()
    monkeypatch.setattr("eval.diagnosis.diagnose.learn_left_out", lambda *_, **__: learned)
    simulator = open_simulator(str(run))
    found, (warning,) = _learned_of(Request(tmp_path, str(run)), simulator, silent)
    assert found.logs >= 1
    assert f"{run} gets wrong by itself is learned anew each time" in warning
    with pytest.raises(ConfigError, match=r"discrepancy\.json"):
        keep_learned(found, run)


def test_flights_are_required_where_something_is_diagnosed(capsys):
    assert main(["diagnose", "--sim", "single_aisle", "--out", "nowhere"]) == 2
    assert "--real is required" in capsys.readouterr().err


REFUSED = {
    "--build-tolerance 0.2": "--build-tolerance needs --build same",
    "--build same --build-tolerance 2": "--build-tolerance: expected a share from 0 to 1, found 2",
}


@pytest.mark.parametrize("words", REFUSED)
def test_how_much_builds_may_differ_is_a_share(capsys, words):
    given = ["diagnose", "--real", "r", "--sim", "single_aisle", "--out", "nowhere"]
    assert main([*given, *words.split()]) == 2
    assert REFUSED[words] in capsys.readouterr().err
