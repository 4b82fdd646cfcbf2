"""`identify` and `compare`: what they write, what takes it, and every bad input in one line."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from narxcal.calibration.bundle import load_bundle
from narxcal.support.errors import NarxcalError
from training.config import RunConfig
from training.papers.identify import output_error, subspace_model, transfer
from training.pipeline import prepare_logs

RATE_HZ = 5.0
TAUS = {"N1_pct": 1.6, "N2_pct": 0.9, "EGT_C": 0.5}
CONFIG = """\
schema = "narxcal.config/1"
name = "stairs"

[logs]
folder = "FOLDER"
files = ["flight_*.csv"]

[smooth]
window = 1

[events]
condition = ""

[steady_state]
inputs = ["TRA_deg", "ALT_ft", "Mach", "dT_C"]
corrected = false
blend = []
switches = []

[narx]
lag_limits = false
lag_governed = false

[train]
horizons_s = [5.0]
iterations = [2]
choice_s = 0.0

[split]
train = ["flight_[12]*"]
test = ["flight_3*"]

[evaluate.crossval]
random_splits = 0
"""


def stairs(seed, steps=26, **change):
    """A log of lags behind a lever that moves every 12 s; `change` replaces columns."""
    rng, size = np.random.default_rng(seed), round(12 * RATE_HZ)
    lever = np.repeat(rng.uniform(15.0, 75.0, steps), size)
    lever[0:size] = lever[size : 2 * size] = 45.0
    time_s = np.arange(len(lever)) / RATE_HZ
    steady = {"N1_pct": 20 + lever, "N2_pct": 50 + 0.6 * lever, "EGT_C": 350 + 0.05 * lever**2}
    log = {"time_s": time_s, "TRA_deg": lever, "ALT_ft": np.linspace(1e3, 9e3, len(lever)),
           "Mach": 0.4 + 0.1 * np.sin(time_s / 20.0), "dT_C": 0.0 * lever}  # fmt: skip
    for name, values in steady.items():
        keep, y = np.exp(-1.0 / RATE_HZ / TAUS[name]), np.empty_like(values)
        y[0] = values[0]
        for k in range(1, len(values)):
            y[k] = values[k] + keep * (y[k - 1] - values[k])
        log[name] = y + rng.normal(0.0, 0.002 * np.ptp(values), len(y))
    for name, of in change.items():
        log[name] = of(log)
    return pd.DataFrame(log)


def written(folder, change=None, steps=26, **config):
    """Three logs and a configuration; `config` are texts to replace."""
    (folder / "flights").mkdir(parents=True)
    for number in (1, 2, 3):
        table = stairs(number, steps, **(change or {}))
        table.to_csv(folder / "flights" / f"flight_{number}.csv", index=False)
    text = CONFIG.replace("FOLDER", str(folder / "flights"))
    for old, new in config.items():
        text += new if old == "more" else ""
    (folder / "stairs.toml").write_text(text, encoding="utf-8")
    return folder / "stairs.toml"


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    return written(tmp_path_factory.mktemp("stairs"))


@pytest.fixture(scope="module")
def logs(project):
    config = RunConfig.parse({"steady_state": {"inputs": ["TRA_deg", "ALT_ft", "Mach", "dT_C"]}})
    return prepare_logs(config, sorted((project.parent / "flights").glob("*.csv")))


METHODS = ("output-error", "transfer", "subspace", "static:polynomial")


@pytest.fixture(scope="module")
def runs(project):
    """A run of each quick method."""
    from narxcal.cli import main  # noqa: PLC0415

    folder = project.parent / "runs"
    for method in METHODS:
        out = folder / method.replace("static:", "")
        command = ["identify", str(project), "--method", method, "--out", str(out), "--quiet"]
        assert main(command) == 0
    return folder


def identified(runs, name):
    return json.loads((runs / name / "identify.json").read_text("utf-8"))


def test_lags_are_recovered_with_their_deviations(runs):
    found = identified(runs, "transfer")
    assert (found["schema"], found["method"]) == ("narxcal.identify/1", "transfer")
    for name, tau in TAUS.items():
        rows = {k: row for k, row in found["parameters"].items() if name in k}
        assert rows
        for row in rows.values():
            assert set(row) == {"value", "unit", "sd", "sd_coloured", "low", "high"}
            # The lever jumps between two samples: up to one of them, 0.2 s, is a delay.
            assert row["value"] == pytest.approx(tau, abs=0.15)
            assert row["low"] < row["value"] < row["high"]
    assert found["status"] == "converged"
    assert found["free_run"]["rmse"]["N1_pct"] < 0.5


def test_subspace_finds_the_time_constants_of_all_outputs(logs):
    found = subspace_model(method("subspace", order=3), Curves(), logs)
    values = sorted(row["value"] for row in found.parameters.values())
    np.testing.assert_allclose(values, sorted(TAUS.values()), rtol=0.1)
    assert all(row["sd"] is None for row in found.parameters.values())


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("name", ["output-error", "transfer", "subspace", "polynomial"])
def test_every_command_takes_every_run(runs, narxcal, tmp_path, name):
    run, log = runs / name, runs.parent / "flights" / "flight_3.csv"
    done = narxcal("evaluate", run, "--out", tmp_path / "ev", "--json")
    assert done.code in (0, 1), done.err
    rmse = json.loads(done.out)["pooled"]["channels"]["N1_pct"]["rmse"]
    assert rmse < (8.0 if name == "polynomial" else 0.8)
    assert narxcal("replay", run, log, "--out", tmp_path / "replayed.csv").code == 0
    assert narxcal("simulate", run, log, "--out", tmp_path / "simulated.csv").code == 0
    replayed, simulated = (pd.read_csv(tmp_path / f"{w}.csv") for w in ("replayed", "simulated"))
    np.testing.assert_allclose(
        replayed["N1_pct_free_run"], simulated["N1_pct"], rtol=1e-6, atol=1e-6
    )
    done = narxcal("info", run, "--json")
    assert json.loads(done.out)["parameters"] == load_bundle(run).calibration.size
    assert narxcal("info", run).code == 0


@pytest.mark.slow
def test_diagnose_takes_an_identified_run_as_the_simulator(
    runs, narxcal, tmp_path, project, monkeypatch
):
    def unknown(*_, **__):  # what a run gets wrong by itself is learned in test_diagnose.py
        raise NarxcalError("not asked for")

    monkeypatch.setattr("eval.diagnosis.diagnose.learn_left_out", unknown)
    flights = project.parent / "flights"
    done = narxcal(
        "diagnose", "--sim", runs / "transfer", "--real", flights, "--out", tmp_path / "gap"
    )
    assert done.code in (0, 1), done.err
    assert (tmp_path / "gap" / "gap.json").is_file()


@pytest.mark.slow
def test_crossval_identifies_in_every_fold(project, narxcal, tmp_path):
    where = ("--out", tmp_path / "cv", "--jobs", "1", "--json")
    done = narxcal("crossval", project, "--method", "transfer", *where)
    assert done.code in (0, 1), done.err
    (scheme,) = json.loads(done.out)["schemes"]
    assert len(scheme["folds"]) == 3
    assert all(fold["values"]["rmse.N1_pct"] < 0.8 for fold in scheme["folds"])


def test_compare_puts_all_runs_and_baselines_into_one_table(runs, narxcal, tmp_path):
    names = ("output-error", "transfer", "subspace", "polynomial")
    out = tmp_path / "compared"
    done = narxcal("compare", *(runs / name for name in names), "--out", out, "--json")
    assert (done.code, done.err) == (0, "")
    found = json.loads(done.out)
    assert found == json.loads((out / "compare.json").read_text("utf-8"))
    assert found["schema"] == "narxcal.compare/1"
    rows = {row["run"]: row for row in found["rows"]}
    assert list(rows) == [*names, "steady state", "first-order lag", "ARX"]
    wanted = {"run", "method", "channels", "ti_tt", "parameters", "aic", "fit_s", "simulate_us",
              "coverage_90"}  # fmt: skip
    assert all(set(row) == wanted for row in rows.values())
    assert rows["polynomial"]["method"] == "static:polynomial"
    better = {(one["better"], one["worse"]) for one in found["significant"]}
    assert ("transfer", "steady state") in better
    assert ("steady state", "transfer") not in better
    page = (out / "compare.html").read_text("utf-8")
    assert all(name in page for name in names)
    done = narxcal("compare", *(runs / name for name in names), "--out", out)
    table = done.out.partition("N1_pct: least")[0]
    assert max(map(len, table.splitlines())) <= 80


def test_a_run_named_twice_is_refused(runs, narxcal, tmp_path):
    done = narxcal("compare", runs / "transfer", runs / "transfer", "--out", tmp_path / "c")
    assert (done.code, done.err) == (2, "narxcal: error: a run is named twice. Name each once\n")


def test_runs_without_a_common_log_are_refused(runs, project, narxcal, tmp_path):
    other = tmp_path / "other.toml"
    text = project.read_text("utf-8").replace("flight_3*", "flight_2*").replace("[12]", "[13]")
    other.write_text(text, encoding="utf-8")
    narxcal("identify", other, "--method", "subspace", "--out", tmp_path / "other")
    done = narxcal("compare", runs / "transfer", tmp_path / "other", "--out", tmp_path / "c")
    assert done.code == 2
    assert done.err == (
        "narxcal: error: no log is held out of all runs. Name the logs to compare on by --logs\n"
    )


BAD = {
    "unknown method": (
        {}, "magic", "",
        (
            "--method magic: expected narx, output-error, transfer, subspace or static:NAME, "
            "found 'magic'"
        ),
    ),
    "unknown law": (
        {}, "static:magic", "",
        (
            "unknown static law 'magic'. Laws are mattingly, torenbeek, aerospatiale, wanner, "
            "cold-thrust, torenbeek-fuel, bada3, yoder, yoder-plus, polynomial, spline-table"
        ),
    ),
    "argument missing": (
        {}, "static:yoder", "",
        (
            "the static law 'yoder': missing a required argument: 'F0_kN'. "
            "Set it under [identify.static]; it takes F0_kN"
        ),
    ),
    "channel missing": (
        {}, "static:yoder", "[identify.static]\nF0_kN = 20.0\n",
        "channel FF_kgph: the fit of 'Yoder' needs FF_kgph",
    ),
    "input missing": (
        {"FF_kgph": lambda log: 10.0 * log["TRA_deg"]}, "static:yoder",
        "[identify.static]\nF0_kN = 20.0\n",
        (
            "the model 'Yoder' needs ALT_ft, Mach, FN_kN; missing: FN_kN. "
            "Add the channel to the logs or choose a model without it"
        ),
    ),
    "mesh with holes": (
        {}, "transfer", "[identify]\naltitudes_ft = [2000.0, 30000.0]\n",
        "the mesh of level x altitude has holes: hardly any motion near level",
    ),
    "table with holes": (
        {}, "static:spline-table",
        (
            '[identify.static]\noutput = "N1_pct"\n'
            "nodes = { TRA_deg = [20.0, 40.0, 60.0, 70.0], ALT_ft = [1e3, 3e3, 6e3, 9e3] }\n"
        ),
        (
            "the table over TRA_deg x ALT_ft has 16 holes: fewer than 3 Mach numbers at 20 x 1000; "
            "20 x 3000; 20 x 6000. Fly the missing nodes, leave their row out, or fit a polynomial"
        ),
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_clear_error(project, narxcal, tmp_path, case):
    change, method, more, message = BAD[case]
    path = written(tmp_path, change) if change else tmp_path / "stairs.toml"
    text = project.read_text("utf-8") if not change else path.read_text("utf-8")
    path.write_text(text + more, encoding="utf-8")
    done = narxcal("identify", path, "--method", method, "--out", tmp_path / "run")
    assert done.code == 2
    assert message in done.err
    *warnings, error = done.err.splitlines()  # stairs are also coarse signals
    assert error.startswith("narxcal: error: ")
    assert all(line.startswith("narxcal: warning: ") for line in warnings)
    assert not (tmp_path / "run" / "bundle.json").exists()


class Curves:
    """The steady state of `stairs`, and one without a slope."""

    input_names = ("TRA_deg", "ALT_ft", "Mach", "dT_C")
    output_names = ("N1_pct", "N2_pct", "EGT_C")

    def __init__(self, flat=False):
        self.flat = flat

    def outputs(self, inputs):
        lever = inputs[..., 0]
        last = 500.0 + 0.0 * lever if self.flat else 350 + 0.05 * lever**2
        return np.stack([20 + lever, 50 + 0.6 * lever, last], axis=-1)

    def inside(self, inputs):
        return np.ones(len(inputs), dtype=bool)


def method(name, **more):
    table = {"method": name, **more}
    inputs = {"inputs": list(Curves.input_names)}
    return RunConfig.parse({"identify": table, "steady_state": inputs})


@pytest.mark.parametrize("fit", [transfer, subspace_model])
def test_an_input_that_never_moves_is_an_error(logs, fit):
    held = [log.with_channels({"TRA_deg": np.full(len(log), 45.0)}) for log in logs]
    expected = "the steady state never moves in the training logs: no response can be identified"
    with pytest.raises(Exception, match=expected):
        fit(method("narx"), Curves(), held)


def test_a_rank_deficient_hankel_matrix_is_an_error(logs):
    (log, *_) = logs
    step = np.where(np.arange(len(log)) < 7, 30.0, 60.0)  # 24 quiet samples would do
    with pytest.raises(Exception, match="not persistently exciting of order 24"):
        subspace_model(method("subspace"), Curves(), [log.with_channels({"TRA_deg": step})])


def test_an_unexcited_parameter_is_named(logs):
    found = output_error(method("output-error"), Curves(flat=True), logs)
    assert "unidentifiable" in found.status
    assert any("beta" in text for text in found.warnings)


def test_a_hole_that_nobody_asked_for_is_a_named_warning(logs):
    tall = []
    for log in logs:
        high = log["TRA_deg"] > 60.0
        tall.append(log.with_channels({"ALT_ft": np.where(high, 30e3, 1e3)}))
    found = transfer(method("transfer"), Curves(), tall)
    assert any("parameters are not scheduled over altitude" in text for text in found.warnings)
    assert found.dynamics.conditions == ("level",)


@pytest.mark.parametrize("fit", [output_error, transfer])
def test_the_parts_of_one_log_are_two_records(logs, fit):
    log, half = logs[0], len(logs[0]) // 2
    parts = [log.part(0, half), log.part(half, len(log))]
    apart = [parts[0], replace(parts[1], name="another")]
    name = fit.__name__.replace("_", "-")
    found, expected = (fit(method(name), Curves(), each) for each in (parts, apart))
    for key, row in found.parameters.items():
        assert row == expected.parameters[key.replace(f"{log.name}.2", "another")]
