"""A real calibration, saved and loaded: same numbers, no code without trust, no garbage."""

import json
import re
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import numpy as np
import pytest

from narxcal import Bundle, ModelError, NarxcalError, load_bundle, save_bundle
from narxcal.calibration.folder import seal
from narxcal.calibration.run_record import RunRecord
from narxcal.cli.app import main
from narxcal.steady.fitted import FittedSteadyState, Layout
from narxcal.steady.fmu import SteadyFmu
from narxcal.steady.function import SteadyCallable
from narxcal.steady.model import Envelope, SteadyOptions
from narxcal.steady.table import SteadyTable
from narxcal.support.files import to_json

NAMES = (("TRA_deg", "Mach"), ("N1_pct", "EGT_C"))
LOG = np.column_stack([40 + 30 * np.sign(np.sin(np.arange(200) / 15)), np.linspace(0, 0.7, 200)])


def fmu_source():
    spec = spec_from_file_location("fmu_source", Path(__file__).parents[1] / "fmu_source.py")
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def table(_):
    points = np.array([[0.0, 0.0], [0.0, 0.8], [78.0, 0.0], [78.0, 0.8]])
    return SteadyTable(NAMES, points, np.column_stack([20 + points[:, 0], 300 + points[:, 1]]))


def scattered(_):
    points = np.random.default_rng(0).uniform([0, 0], [80, 0.8], (40, 2))
    return SteadyTable(NAMES, points, np.column_stack([20 + points[:, 0], 300 + points[:, 1]]))


def function(folder):
    code = "def outputs(inputs): return inputs * [1.0, 2.0] + [20.0, 300.0]\n"
    (folder / "my_deck.py").write_text(code, encoding="utf-8")
    return SteadyCallable.load("my_deck:outputs", NAMES, {"TRA_deg": (0.0, 60.0)}, folder)


def fmu(folder):
    file = fmu_source().build(folder / "deck.fmu", 2)
    return SteadyFmu(file, NAMES, SteadyOptions(variables={"EGT_C": "ITT"}))


def fitted(_):
    return FittedSteadyState(
        layout=Layout(
            input_names=NAMES[0], output_names=NAMES[1], driver="TRA_deg", corrected=False
        ),
        envelope=Envelope(np.array([0.0, 0.0]), np.array([78.0, 0.8])),
        knots=np.linspace(0.0, 78.0, 4),
        curve=np.random.default_rng(0).uniform(1, 20, (2, 1, 5)),
        seen=np.array([0.0, 78.0]),
        engine_curves=np.zeros((0, 2, 5)),
    )


@pytest.mark.parametrize("make", [table, scattered, function, fmu, fitted])
def test_a_loaded_bundle_simulates_and_steps_as_the_saved_one(calibrated, make, tmp_path):
    saved = calibrated(make(tmp_path), LOG)
    save_bundle(tmp_path / "run", Bundle(saved, RunRecord.parse({"seed": 3})))
    bundle = load_bundle(tmp_path / "run", trust=True)
    loaded = bundle.calibration
    assert bundle.record.to_json()["seed"] == 3
    assert loaded.input_names == saved.input_names
    assert loaded.output_names == saved.output_names
    assert loaded.dt_s == saved.dt_s
    start = np.array([30.0, 400.0])
    whole = saved.simulate(LOG, start)
    assert np.ptp(whole[:, 0]) > 1.0
    np.testing.assert_array_equal(loaded.simulate(LOG, start), whole)
    np.testing.assert_array_equal(loaded.steady.inside(LOG), saved.steady.inside(LOG))
    loaded.reset(LOG[0], start)
    steps = np.array([loaded.step(row) for row in LOG[1:]])
    np.testing.assert_allclose(steps, whole[1:], rtol=1e-9)


def test_the_bundles_own_fmu_serves_when_the_former_is_gone(calibrated, tmp_path):
    saved = calibrated(fmu(tmp_path), LOG)
    save_bundle(tmp_path / "run", Bundle(saved))
    (tmp_path / "deck.fmu").unlink()
    (tmp_path / "run").rename(tmp_path / "moved")
    loaded = load_bundle(tmp_path / "moved", trust=True).calibration
    np.testing.assert_array_equal(loaded.simulate(LOG), saved.simulate(LOG))


def test_a_bundle_may_be_saved_over_the_one_it_was_loaded_from(calibrated, tmp_path):
    run = tmp_path / "run"
    save_bundle(run, Bundle(calibrated(fmu(tmp_path), LOG)))
    loaded = load_bundle(run, trust=True)
    save_bundle(run, Bundle(loaded.calibration, RunRecord.parse({"again": True})), replace=True)
    again = load_bundle(run, trust=True)
    assert again.record.to_json()["again"] is True
    np.testing.assert_array_equal(again.calibration.simulate(LOG), loaded.calibration.simulate(LOG))


@pytest.fixture
def planted(calibrated, tmp_path):
    """A run whose author made it call a function that leaves a mark."""
    mark = tmp_path / "mark"
    (tmp_path / "maker.py").write_text(
        f"open({str(mark)!r}, 'w').close()\ndef outputs(inputs): return inputs * [1.0, 2.0]\n",
        encoding="utf-8",
    )
    steady = SteadyCallable.load("maker:outputs", NAMES, None, tmp_path)
    save_bundle(tmp_path / "run", Bundle(calibrated(steady, LOG)))
    mark.unlink()
    (tmp_path / "run" / "steady").mkdir()
    (tmp_path / "maker.py").rename(tmp_path / "run" / "steady" / "maker.py")
    edit(
        tmp_path / "run",
        lambda d: d["calibration"]["steady"].update(file=f"{tmp_path}/run/steady/maker.py"),
    )
    forget("maker")
    return tmp_path / "run", mark


def forget(module):
    for name in [name for name in sys.modules if name.endswith(f"_{module}")]:
        del sys.modules[name]


def edit(run, change):
    """Change the document and give it the hash of what it says now, as an author could."""
    file = run / "bundle.json"
    document = json.loads(file.read_text(encoding="utf-8"))
    change(document)
    rest = {key: value for key, value in document.items() if key != "sha256"}
    file.write_text(to_json({**document, "sha256": seal(rest)}), encoding="utf-8")


def test_a_run_executes_nothing_without_trust(planted):
    run, mark = planted
    sha256 = json.loads((run / "bundle.json").read_text("utf-8"))["calibration"]["steady"]["sha256"]
    message = (
        f"{run / 'bundle.json'}: opening this model would run the Python function 'maker:outputs' "
        f"of {run / 'steady' / 'maker.py'} (sha256 {sha256[:12]}). If you would run a program of "
        "its author, allow it by --trust, in Python by load_bundle(folder, trust=True)"
    )
    with pytest.raises(ModelError, match=f"^{re.escape(message)}$"):
        load_bundle(run)
    assert not mark.exists()
    assert load_bundle(run, trust=True).calibration.output_names == NAMES[1]
    assert mark.exists()


def test_info_shows_the_hash_of_the_bundle(calibrated, tmp_path, capsys):
    save_bundle(tmp_path / "run", Bundle(calibrated(table(tmp_path), LOG), RunRecord(config={})))
    assert main(["info", str(tmp_path / "run"), "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["sha256"] == load_bundle(tmp_path / "run").sha256
    assert main(["info", str(tmp_path / "run")]) == 0
    words = " ".join(capsys.readouterr().out.split())
    assert f"sha256 {shown['sha256'][:16]}" in words
    assert "holds no evaluation of these weights: one that evaluate --out DIR wrote" in words


FLIPS = 150


@pytest.mark.parametrize("name", ["bundle.json", "weights.safetensors"])
def test_no_flipped_bit_gives_a_model(calibrated, tmp_path, name):
    run = tmp_path / "run"
    save_bundle(
        run, Bundle(calibrated(fitted(tmp_path), LOG), RunRecord(seeds=[3], config={"name": "x"}))
    )
    file, random = run / name, np.random.default_rng(0)
    former = file.read_bytes()
    for bit in random.choice(8 * len(former), min(FLIPS, 8 * len(former)), replace=False):
        data = bytearray(former)
        data[bit // 8] ^= 1 << (bit % 8)
        file.write_bytes(bytes(data))
        with pytest.raises(ModelError, match=re.escape(str(file))):
            load_bundle(run)
    file.write_bytes(former)
    load_bundle(run)


GARBAGE = [None, True, -1, 0, 10**9, 1e300, "", "x", [], {}, [[[]]], {"a": [None]}]


def nodes(value, path=()):
    """Every path to a value in a JSON document."""
    yield path
    if isinstance(value, (dict, list)):
        for key in value if isinstance(value, dict) else range(len(value)):
            yield from nodes(value[key], (*path, key))


@pytest.mark.parametrize("make", [table, fitted])
def test_garbage_with_a_fitting_hash_is_refused_or_runs(calibrated, tmp_path, make):
    run = tmp_path / "run"
    record = RunRecord(config={"name": "x"}, data={"a.csv": "ab"}, seeds=[0])
    save_bundle(run, Bundle(calibrated(make(tmp_path), LOG), record))
    whole = json.loads((run / "bundle.json").read_text(encoding="utf-8"))
    every = [(path, value) for path in nodes(whole) if path for value in GARBAGE]
    cases = every[::7]  # `make fuzz` damages all of it
    refused = []
    for path, value in cases:
        document = json.loads(json.dumps(whole))
        part = document
        for key in path[:-1]:
            part = part[key]
        part[path[-1]] = value
        edit(run, lambda old, new=document: (old.clear(), old.update(new)))
        try:
            load_bundle(run).calibration.simulate(LOG[:5])
        except NarxcalError as error:
            refused.append((path, value, str(error)))
    # What only describes the arrays is read by nobody.
    read = [path for path, _ in cases if path[:2] != ("weights", "arrays")]
    assert len(refused) > len(read) // 2
    assert [case for case in refused if str(run) not in case[2]] == []


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_weights_that_are_not_finite_are_refused(calibrated, tmp_path, bad):
    saved = calibrated(table(tmp_path), LOG)
    saved.narx.output_scaling.scale[0] = bad
    save_bundle(tmp_path / "run", Bundle(saved))
    message = (
        f"{tmp_path / 'run' / 'bundle.json'}: array 'narx/output_scaling.scale' has a number that "
        "is not finite. The bundle was altered; train it again"
    )
    with pytest.raises(ModelError, match=f"^{re.escape(message)}$"):
        load_bundle(tmp_path / "run")
