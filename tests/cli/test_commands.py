"""What each command prints, writes and returns when all is well."""

import gzip
import json
import math
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from data_prep.reading import read_logs
from eval.diagnosis.diagnose import screening_by
from narxcal.calibration.bundle import load_bundle, save_bundle
from narxcal.cli import main
from narxcal.cli.app import COMMANDS, parse
from narxcal.cli.prepare import file_names
from narxcal.cli.results import config_header
from training.steady.steady_choice import Outlier

ROOT = Path(__file__).parents[2]


def strict(text):
    """One JSON document and nothing else, without NaN or infinity."""

    def refuse(constant):
        pytest.fail(f"{constant} is not JSON")

    return json.loads(text, parse_constant=refuse)


def test_help_is_there_at_once_and_does_not_wait_for_torch():
    script = (
        "import sys\n"
        "from narxcal.cli import main\n"
        "try:\n    main(['--help'])\n"
        "except SystemExit as end:\n    code = end.code\n"
        "heavy = {'torch', 'pandas', 'numba', 'matplotlib', 'numpy'} & set(sys.modules)\n"
        "sys.exit(f'imported {heavy}' if heavy or code else None)"
    )
    done = subprocess.run(
        [sys.executable, "-c", script],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert all(name in done.stdout for name in COMMANDS)


def widest(text):
    """Width of the tables; a path is as long as it is."""
    return max(len(line) for line in text.splitlines() if "/" not in line or "│" in line)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself_and_takes_json_and_quiet(capsys, command):
    with pytest.raises(SystemExit) as end:
        main([command, "--help"])
    assert end.value.code == 0
    text = capsys.readouterr().out
    assert "--json" in text
    assert "--quiet" in text
    assert max(map(len, text.splitlines())) <= 80


def test_prepare_writes_logs_that_can_be_read_again_with_their_tables(project, narxcal, tmp_path):
    out = tmp_path / "prepared"
    done = narxcal("prepare", project / "tiny.toml", "--out", out, "--json")
    assert (done.code, done.err) == (0, "")
    document = strict(done.out)
    assert document == strict((out / "prepare.json").read_text("utf-8"))
    assert document["schema"] == "narxcal.prepare/1"
    assert [log["log"] for log in document["logs"]] == [f"flight_{n}.csv" for n in (1, 2, 3)]
    (log,) = read_logs(out / document["logs"][0]["prepared"])
    assert len(log) == document["logs"][0]["samples"]
    events = pd.read_csv(out / "events.csv")
    assert (events["label"].isin([0, 1])).all()
    assert document["logs"][0]["events"]["found"] == (events["log"] == "flight_1.csv").sum()
    ranking = pd.read_csv(out / "pearson.csv")
    assert ranking.loc[ranking["rho"].abs().idxmax(), "input"] == "TRA_deg"
    assert set(pd.read_csv(out / "windows.csv")["window"]) == {3, 11, 21}
    assert "<html" in (out / "prepare.html").read_text("utf-8")


@pytest.mark.usefixtures("undrawn")
def test_prepare_again_replaces_its_own_results_with_the_same_bytes(project, narxcal, tmp_path):
    out = tmp_path / "prepared"
    assert narxcal("prepare", project / "tiny.toml", "--out", out, "--quiet").out == ""
    first = {path.name: path.read_bytes() for path in out.rglob("*.gz")}
    assert narxcal("prepare", project / "tiny.toml", "--out", out, "--quiet").code == 0
    assert {path.name: path.read_bytes() for path in out.rglob("*.gz")} == first
    assert gzip.decompress(first["flight_1.csv.gz"]).startswith(b"time_s,")


def test_logs_that_would_share_a_file_get_numbers():
    names = ("a.csv.gz:left", "a.csv:left", "a:left", "a.csv:right#2")
    assert file_names(names) == [
        "logs/a_left", "logs/a_left(2)", "logs/a_left(3)", "logs/a_right_2"
    ]  # fmt: skip


@pytest.fixture
def in_processes(monkeypatch):
    """Even small files are worth a process."""
    monkeypatch.setattr("narxcal.cli.prepare._BYTES_PER_PROCESS", 1)


@pytest.mark.slow
@pytest.mark.usefixtures("in_processes")
def test_files_prepared_side_by_side_give_the_same_bytes(project, narxcal, tmp_path, monkeypatch):
    monkeypatch.setattr(
        "narxcal.cli.prepare.config_header",
        lambda *given: replace(config_header(*given), created="now"),
    )
    monkeypatch.setattr("narxcal.cli.prepare.MOST_DRAWN", 1)
    found = []
    for jobs in (1, 3):
        out = tmp_path / str(jobs)
        args = ("prepare", project / "tiny.toml", "--out", out, "--jobs", jobs)
        assert narxcal(*args).code == 0
        files = (path for path in out.rglob("*") if path.is_file())
        found.append({path.relative_to(out): path.read_bytes() for path in files})
    assert found[0] == found[1]
    assert len(found[0]) == 8


@pytest.mark.slow
@pytest.mark.usefixtures("in_processes")
@pytest.mark.parametrize("jobs", [1, 3])
def test_the_first_file_that_cannot_be_read_is_named_and_nothing_stays(
    project, narxcal, tmp_path, jobs
):
    data = shutil.copytree(project / "flights", tmp_path / "flights")
    for number in (2, 3):
        file = data / f"flight_{number}.csv"
        file.write_text(file.read_text("utf-8").replace("\n0.", "\nx.", 1), "utf-8")
    out = ("--out", tmp_path / "out", "--jobs", jobs)
    done = narxcal("prepare", project / "tiny.toml", "--data", data, *out)
    assert done.code == 2
    assert done.err.startswith(f"narxcal: error: {data / 'flight_2.csv'}, channel time_s, row ")
    assert list(tmp_path.iterdir()) == [data]


@pytest.mark.usefixtures("undrawn")
def test_prepared_logs_as_parquet_hold_what_the_csv_files_hold(project, narxcal, tmp_path):
    pytest.importorskip("pyarrow", reason="the extra 'parquet' is not installed")
    out = tmp_path / "prepared"
    done = narxcal("prepare", project / "tiny.toml", "--out", out, "--parquet", "--json")
    for log in strict(done.out)["logs"]:
        text, table = pd.read_csv(out / log["prepared"]), pd.read_parquet(out / log["parquet"])
        assert list(text) == list(table)
        np.testing.assert_allclose(table["time_s"], text["time_s"], rtol=1e-14)
        np.testing.assert_allclose(table, text, rtol=1e-8, atol=1e-300)
        assert (table.isna() == text.isna()).all(axis=None)


@pytest.mark.usefixtures("undrawn")
def test_parquet_without_its_library_is_refused_before_any_work(
    project, narxcal, tmp_path, monkeypatch
):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    done = narxcal("prepare", project / "tiny.toml", "--out", tmp_path / "out", "--parquet")
    assert done.code == 2
    assert "Parquet needs pyarrow. Install it with: pip install 'narxcal[parquet]'" in done.err
    assert list(tmp_path.iterdir()) == []


def test_info_tells_what_the_model_is_and_where_it_comes_from(project, narxcal):
    done = narxcal("info", project / "run", "--json")
    document = strict(done.out)
    bundle = load_bundle(project / "run")
    assert document["channels"]["outputs"] == ["N1_pct", "N2_pct", "EGT_C"]
    assert document["lags"] == bundle.calibration.narx.config.lags
    assert document["split"]["test"] == ["flight_3.csv"]
    assert len(document["data"]) == 3
    assert document["versions"]["torch"]
    low, high = document["deviation_bounds"]["N1_pct"]
    assert low < 0.0 < high
    shown = narxcal("info", project / "run").out
    assert "Test logs" in shown
    assert "Steady state the maker's table " in " ".join(shown.split())
    assert "flight_3.csv" in shown
    assert widest(shown) <= 80


@pytest.mark.slow
def test_evaluate_judges_the_held_out_log_and_says_that_a_tolerance_was_missed(project, narxcal):
    done = narxcal("evaluate", project / "run")
    assert done.code == 1  # four steps of training are not enough
    assert widest(done.out) <= 80
    assert "FAIL" in done.out
    folder = project / "run" / "evaluate"
    assert done.out.endswith(f"Page: {folder / 'evaluate.html'}\n")
    document = strict((folder / "evaluate.json").read_text("utf-8"))
    assert document["schema"] == "narxcal.evaluate/1"
    assert [log["log"] for log in document["logs"]] == ["flight_3.csv"]
    figures = document["logs"][0]["channels"]["N1_pct"]
    for name in ("rmse", "nrmse", "max_rel_pct", "one_step_rmse", "steady_state_rmse"):
        assert figures[name] > 0.0
    interval = figures["interval"]
    assert interval["level"] == 0.9
    assert 0.0 < interval["coverage"] <= 1.0
    assert interval["half_width"] > 0.0
    assert "Within the 90 % interval: N1" in done.out
    assert {"start_s", "label", "Ti", "Tt"} <= set(document["logs"][0]["events"][0])
    assert document["logs"][0]["ti_tt"]["assessed"] > 0


@pytest.mark.usefixtures("undrawn")
def test_info_shows_the_last_evaluation_of_these_weights_only(project, narxcal, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(project / "run", run, ignore=shutil.ignore_patterns("evaluate"))
    assert strict(narxcal("info", run, "--json").out)["metrics"] is None
    assert (
        f"{run / 'evaluate'} holds no evaluation of these weights: one that evaluate --out DIR "
        "wrote is in DIR\n"
    ) in narxcal("info", run).out
    done = narxcal("evaluate", run, "--json")
    metrics = strict(narxcal("info", run, "--json").out)["metrics"]
    assert metrics["channels"] == strict(done.out)["pooled"]["channels"]
    assert metrics["logs"] == {"flight_3.csv": "test"}
    assert "Last evaluation: flight_3.csv" in narxcal("info", run).out
    file = run / "evaluate" / "evaluate.json"
    file.write_text(file.read_text("utf-8").replace('"weights_sha256": "', '"weights_sha256": "0'))
    assert strict(narxcal("info", run, "--json").out)["metrics"] is None


@pytest.mark.usefixtures("undrawn")
def test_a_log_that_is_named_twice_is_judged_once(project, narxcal, tmp_path):
    file = project / "flights" / "flight_3.csv"
    done = narxcal(
        "evaluate", project / "run", "--logs", file, file, "--out", tmp_path / "out", "--json"
    )
    assert [log["log"] for log in strict(done.out)["logs"]] == ["flight_3.csv"]
    once, level = done.err.splitlines()
    assert once == "narxcal: warning: a file that is named twice is read once"
    assert "fewer than 3 training logs were held out" in level


@pytest.mark.slow
def test_identify_by_narx_is_train(project, narxcal, tmp_path):
    done = narxcal("identify", project / "tiny.toml", "--method", "narx", "--out", tmp_path / "run")
    assert done.code == 0
    runs = (project / "run", tmp_path / "run")
    weights = [(run / "weights.safetensors").read_bytes() for run in runs]
    assert weights[0] == weights[1]
    document = strict((tmp_path / "run" / "identify.json").read_text("utf-8"))
    assert (document["method"], document["parameters"]) == ("narx", {})


@pytest.mark.usefixtures("training")
def test_train_warns_of_patterns_that_name_no_log_and_of_logs_that_are_in_no_set(
    project, narxcal, tmp_path
):
    text = (project / "tiny.toml").read_text("utf-8")
    text = text.replace('folder = "flights"', f'folder = "{project / "flights"}"')
    text = text.replace('test = ["flight_3.csv*"]', 'test = ["flight3*"]')
    (tmp_path / "typo.toml").write_text(text, "utf-8")
    done = narxcal("train", tmp_path / "typo.toml", "--out", tmp_path / "run", "--quiet")
    assert done.code == 0
    assert done.err == (
        "narxcal: warning: [split] test = 'flight3*' matches no log\n"
        "narxcal: warning: not used, for no pattern in [split] matches: flight_3.csv\n"
    )


@pytest.mark.usefixtures("undrawn")
def test_evaluate_says_that_no_log_was_held_out(project, narxcal, tmp_path):
    bundle = load_bundle(project / "run")
    stored, every = bundle.record.to_json(), {"train": ["*"], "validate": [], "test": []}
    record = bundle.record.having(
        config={**stored["config"], "split": every},
        split={**every, "train": [row["log"] for row in stored["identities"]]},
        identities=[{**row, "role": "train"} for row in stored["identities"]],
    )
    save_bundle(tmp_path / "run", replace(bundle, record=record))
    done = narxcal("evaluate", tmp_path / "run", "--quiet")
    first, level = done.err.splitlines()
    assert first == (
        "narxcal: warning: no log was held out: these are logs that the model was trained on"
    )
    assert "is not judged: fewer than 3 training logs were held out" in level
    assert done.out == ""


@pytest.mark.usefixtures("undrawn")
def test_a_log_that_was_not_learned_from_is_named_in_every_later_evaluation(
    project, narxcal, tmp_path
):
    bundle = load_bundle(project / "run")
    words = Outlier("x.csv", {"N1_pct": 3.61}).words
    screening = {**bundle.record.screening.model_dump(), "contradicting": [{"words": words}]}
    save_bundle(tmp_path / "run", replace(bundle, record=bundle.record.having(screening=screening)))
    log = project / "flights" / "flight_1.csv"
    done = narxcal("evaluate", tmp_path / "run", "--logs", log, "--out", tmp_path / "out", "--json")
    assert strict(done.out)["cautions"][0] == words
    assert "x.csv contradicts the other logs as a whole" in done.err


def test_evaluate_takes_several_files_after_one_option_or_several():
    ways = ("--logs a b --trim 0.2", "--logs a --trim 0.2 --logs b")
    one, other = (parse(["evaluate", "run", *way.split()]) for way in ways)
    assert one == other
    assert (one.logs, one.trim) == ([Path("a"), Path("b")], 0.2)


@pytest.mark.usefixtures("undrawn")
def test_evaluate_warns_of_a_held_out_file_that_has_changed(project, narxcal, tmp_path):
    folder = tmp_path / "moved"
    folder.mkdir()
    for file in (project / "flights").iterdir():
        text = file.read_text("utf-8")
        cut = text.splitlines(keepends=True)[:3000]
        (folder / file.name).write_text("".join(cut) if "_3" in file.name else text, "utf-8")
    done = narxcal(
        "evaluate", project / "run", "--data", folder, "--out", tmp_path / "out", "--json"
    )
    file = folder / "flight_3.csv"
    assert done.err.startswith(
        f"narxcal: warning: {file}: the file has changed since the training: sha256 was "
    )
    document = strict(done.out)
    assert len(document["changed"]) == 1
    assert document["logs"][0]["role"] == "new"


def test_simulate_gives_the_free_run_and_needs_no_outputs(project, narxcal, tmp_path):
    flight = pd.read_csv(project / "flights" / "flight_3.csv")
    inputs, out = tmp_path / "inputs.csv", tmp_path / "out.csv"
    flight.drop(columns=["N1_pct", "N2_pct", "EGT_C", "FF_kgph"]).to_csv(inputs, index=False)
    done = narxcal("simulate", project / "run", inputs, "--out", out, "--json")
    assert (done.code, done.err) == (0, "")
    table = pd.read_csv(out)
    outputs = ["N1_pct", "N2_pct", "EGT_C"]
    valid = [f"{name}_valid" for name in outputs]
    assert list(table) == ["time_s", *outputs, "inside_envelope", *valid]
    assert (table[valid] == 1).all(axis=None)
    assert strict(done.out)["logs"][0]["samples"] == len(table)
    measured = np.interp(table["time_s"], flight["time_s"], flight["N1_pct"])
    assert math.sqrt(np.mean((table["N1_pct"] - measured) ** 2)) < 6.0


def test_simulate_gives_the_interval_by_the_errors_of_held_out_logs(project, narxcal, tmp_path):
    bundle, out = load_bundle(project / "run"), tmp_path / "out.csv"
    calibration, inputs = bundle.calibration, project / "flights" / "flight_3.csv"
    done = narxcal("simulate", project / "run", inputs, "--out", out, "--interval", "0.8")
    assert (
        "Interval of 80 % by the errors of 2 held-out logs, so few that it is widened" in done.out
    )
    table = pd.read_csv(out)
    outputs = list(calibration.output_names)
    half = (table[[f"{name}_high" for name in outputs]].to_numpy() - table[outputs]).to_numpy()
    names = [f"{name}_low" for name in outputs]
    np.testing.assert_allclose(table[outputs].to_numpy() - half, table[names], rtol=1e-6)
    assert (half > 0.0).all()
    refused = narxcal("simulate", project / "run", inputs, "--out", out, "--interval", "1")
    assert refused.code == 2
    assert "expected a share from 0.5 to 0.99, found 1" in refused.err


def test_a_model_without_held_out_errors_has_no_interval_and_says_so(project, narxcal, tmp_path):
    bundle = load_bundle(project / "run")
    without = replace(bundle, calibration=bundle.calibration.with_interval(None))
    save_bundle(tmp_path / "old", without)
    assert load_bundle(tmp_path / "old").calibration.interval is None
    log, out = project / "flights" / "flight_3.csv", tmp_path / "out.csv"
    done = narxcal("replay", tmp_path / "old", log, "--out", out)
    assert "No interval: the model stores no errors of held-out logs" in done.out
    assert "N1_pct_low" not in pd.read_csv(out)
    done = narxcal(
        "simulate", tmp_path / "old", log, "--out", tmp_path / "s.csv", "--interval", ".9"
    )
    assert done.code == 2
    assert "no errors of held-out logs are stored with this model" in done.err


@pytest.mark.usefixtures("undrawn")
def test_stamps_of_a_clock_that_counts_since_1970_keep_their_fractions(project, narxcal, tmp_path):
    flight = pd.read_csv(project / "flights" / "flight_3.csv").head(400)
    inputs = tmp_path / "flight_1.csv"
    flight.assign(time_s=1.7e9 + flight["time_s"]).round(4).to_csv(inputs, index=False)
    assert narxcal("simulate", project / "run", inputs, "--out", tmp_path / "s.csv").code == 0
    assert narxcal("replay", project / "run", inputs, "--out", tmp_path / "r.csv").code == 0
    data = ("--data", tmp_path, "--out", tmp_path / "p")
    assert narxcal("prepare", project / "tiny.toml", *data, "--quiet").code == 0
    for file in ("s.csv", "r.csv", "p/logs/flight_1.csv.gz"):
        stamps = pd.read_csv(tmp_path / file)["time_s"]
        np.testing.assert_allclose(stamps.diff().dropna(), 0.125, rtol=0, atol=1e-4)


def test_replay_writes_prediction_fused_value_and_flags(project, narxcal, tmp_path):
    out = tmp_path / "replayed.csv"
    log = project / "flights" / "flight_3.csv"
    done = narxcal("replay", project / "run", log, "--out", out, "--json")
    assert (done.code, done.err) == (0, "")
    document, table = strict(done.out), pd.read_csv(out)
    assert document["schema"] == "narxcal.replay/1"
    assert document["rows"] == len(table)
    assert {"N1_pct_free_run", "N1_pct_fused", "N1_pct_innovation"} <= set(table)
    assert {"inside_envelope", "held", "gap"} <= set(table)
    assert (
        f"Replayed: {out}\n"
        in narxcal("replay", project / "run", log, "--out", out, "--overwrite").out
    )


@pytest.mark.slow
def test_crossval_writes_folds_and_page(project, narxcal, tmp_path):
    out, quick = tmp_path / "folds", tmp_path / "quick.toml"
    text = (project / "tiny.toml").read_text("utf-8")
    quick.write_text(text.replace("[2, 2]", "[2, 2]\nchoice_s = 0.0\ndelay_s = 0.0"), "utf-8")
    data = ("--data", project / "flights")
    done = narxcal("crossval", quick, *data, "--out", out, "--jobs", "1", "--json")
    assert done.code == 1
    document = strict(done.out)
    assert document == strict((out / "crossval.json").read_text("utf-8"))
    assert [len(scheme["folds"]) for scheme in document["schemes"]] == [3, 1]
    assert "<html" in (out / "crossval.html").read_text("utf-8")


@pytest.mark.usefixtures("undrawn")
def test_the_folder_of_the_logs_can_be_named_by_option_or_environment(
    project, narxcal, tmp_path, monkeypatch
):
    config = tmp_path / "elsewhere.toml"
    config.write_text((project / "tiny.toml").read_text("utf-8"), "utf-8")
    missing = tmp_path / "flights"
    without = narxcal("prepare", config, "--out", tmp_path / "a")
    assert without.code == 2
    assert without.err == (
        f"narxcal: error: {missing}: the folder of the logs does not exist. "
        "Set [logs] folder, or name another by --data\n"
    )
    data = project / "flights"
    given = narxcal("prepare", config, "--out", tmp_path / "a", "--data", data, "--quiet")
    assert (given.code, given.out, given.err) == (0, "", "")
    monkeypatch.setenv("NARXCAL_DATA", str(data))
    assert narxcal("prepare", config, "--out", tmp_path / "b", "--quiet").code == 0


@pytest.mark.usefixtures("undrawn")
def test_a_log_without_a_probe_is_judged_by_its_spools(project, narxcal, tmp_path):
    log = tmp_path / "noegt.csv"
    pd.read_csv(project / "flights" / "flight_3.csv").drop(columns="EGT_C").to_csv(log, index=False)
    done = narxcal("evaluate", project / "run", "--logs", log, "--out", tmp_path / "ev")
    assert done.code in {0, 1}
    said = "noegt.csv: EGT_C is not recorded: nothing is learned or judged by it"
    assert done.err.startswith(f"narxcal: warning: {said}\n")
    assert re.search("EGT \\[°C\\] +\u2013( +\u2013){7}", done.out)
    document = strict((tmp_path / "ev" / "evaluate.json").read_text("utf-8"))
    first, level = document["cautions"]
    assert first == said
    assert re.search(r"level error of N1_pct .*, N2_pct \S+ % is not judged", level)
    assert document["logs"][0]["channels"]["EGT_C"]["rmse"] is None
    assert document["logs"][0]["channels"]["N1_pct"]["rmse"] > 0.0


def test_qtg_writes_a_guide_of_the_numbers_of_evaluate(project, narxcal, undrawn, tmp_path):
    tests, out = tmp_path / "tests.toml", tmp_path / "qtg.pdf"
    narxcal("evaluate", project / "run", "--out", tmp_path / "ev", "--quiet")
    evaluated = strict((tmp_path / "ev/evaluate.json").read_text("utf-8"))
    log = evaluated["logs"][0]
    row = next(one for one in log["events"] if one["ok"] is not None)
    tests.write_text(
        'schema = "narxcal.qtg_tests/1"\n[[test]]\nnumber = "A-1"\n'
        f'log = "{log["log"]}"\nstart_s = {row["start_s"]:.3f}\n',
        "utf-8",
    )
    done = narxcal("qtg", project / "run", "--out", out, "--tests", tests)
    document = strict(out.with_suffix(".json").read_text("utf-8"))
    assert done.code == (0 if document["ok"] else 1)
    assert f"Guide: {out} and qtg.json" in done.out
    assert out.read_bytes().startswith(b"%PDF-")
    (test,) = document["tests"]
    same = [one for one in log["events"] if one["start_s"] == row["start_s"]]
    assert (test["number"], test["results"]) == ("A-1", same)
    assert narxcal("qtg", project / "run", "--out", out).err == (
        f"narxcal: error: output file {out} exists. Add --overwrite, or choose another name\n"
    )
    assert narxcal("qtg", project / "run", "--out", tmp_path / "qtg.html").err == (
        "narxcal: error: the guide is a .pdf file, and --out names qtg.html. Name it qtg.pdf\n"
    )


def test_flights_that_a_run_was_trained_on_make_a_diagnosis_undetermined(project):
    flights = project / "flights"
    (doubt,) = screening_by(load_bundle(project / "run"), flights).doubts
    assert doubt.startswith("the run was trained on samples of flight_1.csv, flight_2.csv: ")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda log: {"EGT_C": log["EGT_C"] + 273.15}, "EGT_C unit, the whole log: looks like kel"),
        (lambda log: {"N1_pct": log["N2_pct"], "N2_pct": log["N1_pct"]}, "N1_pct and N2_pct exch"),
        (lambda _: {}, ""),
    ],
)
def test_a_misread_log_makes_a_diagnosis_undetermined(project, tmp_path, change, said):
    flight = pd.read_csv(project / "flights" / "flight_3.csv")
    flight.assign(**change(flight)).to_csv(tmp_path / "new.csv", index=False)
    doubts = screening_by(load_bundle(project / "run"), tmp_path).doubts
    assert [each.partition(": ")[2][: len(said)] for each in doubts] == [said] * bool(said)
