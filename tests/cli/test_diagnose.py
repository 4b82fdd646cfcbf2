"""`narxcal diagnose` from end to end, and `narxcal simulate --effects` on what it found."""

import json

import numpy as np
import pandas as pd
import pytest

from narxcal.cli import main


def write(folder, name, table):
    folder.mkdir(exist_ok=True)
    table.to_csv(folder / name, index=False, float_format="%.9g")


@pytest.fixture(scope="module")
def case(slow_probe, tmp_path_factory):
    """Three flights to diagnose and one held out."""
    folder = tmp_path_factory.mktemp("case")
    for seed in range(4):
        real, sim = slow_probe(seed, 200.0, stay_s=20.0)
        held = "_held" if seed == 3 else ""
        write(folder / f"sim{held}", f"f{seed}.csv.gz", sim)
        write(folder / f"real{held}", f"f{seed}.csv", real)
    return folder


@pytest.fixture(scope="module")
def diagnosed(case):
    held = ["--heldout-real", str(case / "real_held"), "--heldout-sim", str(case / "sim_held")]
    where = ["--real", str(case / "real"), "--sim", str(case / "sim")]
    code = main(["diagnose", *where, *held, "--out", str(case / "gap"), "--quiet"])
    return code, case / "gap"


def test_a_slow_probe_is_found_and_the_gap_closes_on_other_flights(diagnosed):
    code, folder = diagnosed
    document = json.loads((folder / "gap.json").read_text("utf-8"))
    assert code == 0
    assert document["verdict"]["kind"] == "effects"
    assert document["verdict"]["effects"] == ["sensor_lag:EGT_C"]
    assert document["effects"][0]["parameters"]["tau_s"]["value"] == pytest.approx(1.2, abs=0.1)
    assert document["where"][0]["channel"] == "EGT_C"
    assert document["side"]["sensor"] > 0.9
    assert document["shrink"]["realised"] > 0.95
    assert document["shrink"]["realised"] == pytest.approx(
        document["shrink"]["predicted"]["value"], abs=0.04
    )


def intervals(value, path=""):
    """Every part of a document with ends: where, the value in between (if any), low, high."""
    if isinstance(value, dict):
        # Levels of regimes are called low, mid and high, too.
        if isinstance(value.get("low"), float) and "regime_shares" not in path:
            middle = value.get("value", value.get("share"))
            yield path, middle, value["low"], value["high"]
        for key, part in value.items():
            yield from intervals(part, f"{path}/{key}")
    elif isinstance(value, list):
        for number, part in enumerate(value):
            yield from intervals(part, f"{path}/{number}")


def refuse(constant):
    pytest.fail(f"{constant} is no JSON")


def test_the_document_keeps_its_contract(diagnosed):
    """The keys that others rely on, numbers that JSON knows, and every value within its ends."""
    text = (diagnosed[1] / "gap.json").read_text("utf-8")
    document = json.loads(text, parse_constant=refuse)
    keys = {"schema", "verdict", "effects", "where", "side", "theil", "shrink", "emulator"}
    assert keys | {"quality"} <= set(document)
    verdict = {"kind": str, "effects": list, "ambiguous_with": list, "reason": str}
    for key, kind in {**verdict, "separating_manoeuvre": str}.items():
        assert isinstance(document["verdict"][key], kind)
    for row in document["effects"]:
        assert isinstance(row["id"], str)
        assert isinstance(row["family"], str)
        assert 0.0 <= row["probability"] <= 1.0
        assert {"value", "low", "high"} == set(row["gain"])
        assert all({"value", "low", "high"} <= set(each) for each in row["parameters"].values())
    for row in document["where"]:
        assert {"channel", "direction", "phase", "regime", "share", "low", "high"} <= set(row)
    causes = {row["cause"]: row["share"] for row in document["budget"]}
    assert sum(causes.values()) == pytest.approx(1.0)
    assert max(causes, key=lambda name: causes[name]) == "sensor_lag:EGT_C"
    shrink = document["shrink"]
    assert {"value", "low", "high"} == set(shrink["predicted"])
    assert isinstance(shrink["realised"], float)
    assert all({"before", "after", "floor"} == set(row) for row in shrink["channels"].values())
    assert document["emulator"]["used"] is True
    assert set(document["emulator"]["rmse"]) == set(shrink["channels"])
    assert set(document["side"]) == {"input", "process", "sensor"}
    found = list(intervals(document))
    assert len(found) > 30
    for path, middle, low, high in found:
        assert low <= high, path
        assert middle is None or low <= middle <= high, path


def test_anybody_can_add_the_effects_to_the_simulator(diagnosed, case, narxcal):
    _, folder = diagnosed
    out = case / "with_effects"
    done = narxcal(
        "simulate",
        *("--sim", case / "sim_held", "--effects", folder / "gap.json"),
        *("--inputs", case / "real_held", "--out", out),
    )
    assert done.code == 0, done.err
    assert "sensor_lag:EGT_C" in done.out
    made, real = pd.read_csv(out / "f3.csv"), pd.read_csv(case / "real_held" / "f3.csv")
    sim = pd.read_csv(case / "sim_held" / "f3.csv.gz")
    assert list(made.columns) == list(sim.columns)

    def rms(a):
        return float(np.sqrt(np.mean((a["EGT_C"] - real["EGT_C"]) ** 2)))

    assert rms(made) < 0.1 * rms(sim)
    np.testing.assert_allclose(made["N1_pct"], sim["N1_pct"], rtol=1e-7)
    again = narxcal(
        "simulate",
        *("--sim", case / "sim_held", "--effects", folder / "gap.json", "--json"),
        *("--inputs", case / "real_held", "--out", out),
    )
    assert json.loads(again.out)["effects"]["sensor_lag:EGT_C"]["tau_s"] > 1.0


def refused(done, words):
    assert (done.code, done.out) == (2, "")
    assert words in done.err


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (("--sim", "x"), "--effects and --inputs are missing"),
        (("--sim", "x", "--effects", "g", "--inputs", "d", "run"), "expected either RUN"),
        ((), "expected RUN and INPUTS.csv, or --sim, --effects and --inputs"),
    ],
)
def test_half_a_command_is_refused(narxcal, tmp_path, words, problem):
    refused(narxcal("simulate", *words, "--out", tmp_path / "out"), problem)


def test_bad_input_is_one_line_and_leaves_nothing(case, slow_probe, narxcal, tmp_path):
    def run(real, sim, *more):
        return narxcal("diagnose", "--real", real, "--sim", sim, "--out", tmp_path / "g", *more)

    refused(run(case / "real", case / "sim_held"), "has no partner here")
    refused(run(case / "real", "nowhere"), "is no folder of logs, run folder, FMU")
    refused(run(case / "none", case / "sim"), "the folder of the logs does not exist")
    refused(
        run(case / "real", case / "sim", "--heldout-sim", "x"),
        "--heldout-sim needs --heldout-real",
    )
    real, sim = slow_probe(0, 30.0, stay_s=20.0)
    write(tmp_path / "short_real", "f.csv", real)
    write(tmp_path / "short_sim", "f.csv", sim)
    refused(run(tmp_path / "short_real", tmp_path / "short_sim"), "too little excitation")
    assert not (tmp_path / "g").exists()


def test_a_folder_of_other_content_is_not_overwritten(case, narxcal, tmp_path):
    (tmp_path / "mine.txt").write_text("mine", "utf-8")
    done = narxcal("diagnose", "--real", case / "real", "--sim", case / "sim", "--out", tmp_path)
    refused(done, "holds other content ('mine.txt')")


def test_a_diagnosis_is_not_replaced_by_logs_made_from_it(diagnosed, case, narxcal):
    folder = diagnosed[1]
    before = sorted(folder.iterdir())
    done = narxcal(
        "simulate",
        *("--sim", case / "sim_held", "--effects", folder / "gap.json"),
        *("--inputs", case / "real_held", "--out", folder),
    )
    refused(done, "holds other content ('emulator') and is not overwritten")
    assert sorted(folder.iterdir()) == before
