"""A real calibration, saved and loaded, gives the same numbers with every kind of model."""

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import numpy as np
import pytest

from narxcal import Bundle, load_bundle, save_bundle
from narxcal.steady.fitted import FittedSteadyState, Layout
from narxcal.steady.fmu import SteadyFmu
from narxcal.steady.function import SteadyCallable
from narxcal.steady.model import Envelope, SteadyOptions
from narxcal.steady.table import SteadyTable

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
        engine_lines=np.zeros((0, 2, 2)),
    )


@pytest.mark.parametrize("make", [table, scattered, function, fmu, fitted])
def test_a_loaded_bundle_simulates_and_steps_as_the_saved_one(calibrated, make, tmp_path):
    saved = calibrated(make(tmp_path), LOG)
    save_bundle(tmp_path / "run", Bundle(saved, {"seed": 3}))
    bundle = load_bundle(tmp_path / "run", trust=True)
    loaded = bundle.calibration
    assert bundle.meta["seed"] == 3
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
    save_bundle(run, Bundle(loaded.calibration, {"again": True}), replace=True)
    again = load_bundle(run, trust=True)
    assert again.meta["again"] is True
    np.testing.assert_array_equal(again.calibration.simulate(LOG), loaded.calibration.simulate(LOG))
