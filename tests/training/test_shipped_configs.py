"""The shipped configurations on the flights they name: held-out free run beats the steady state."""

from pathlib import Path

import numpy as np
import pytest

from narxcal.calibration.bundle import load_bundle, save_bundle
from training.config import load_config
from training.pipeline import calibrate, calibration_for, configured_files, prepare_logs
from training.records import split_logs

CONFIGS = Path(__file__).parents[2] / "configs"
DATA = Path(__file__).parents[3] / "shared" / "data"


def rmse(error):
    return np.sqrt(np.nanmean(error**2, axis=0))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["citation2", "jetcat", "agtf30"])
def test_a_held_out_flight_is_followed_better_than_by_its_steady_state(name, tmp_path):
    if not DATA.is_dir():
        pytest.skip("the recorded flights are not beside the checkout")
    config, base = load_config(CONFIGS / f"{name}.toml")
    logs = prepare_logs(config, configured_files(config, base))
    split = split_logs(logs, config.split)
    bundle = calibrate(config, base, split)
    save_bundle(tmp_path / "run", bundle)
    again = load_bundle(tmp_path / "run").calibration
    assert split.test
    for log in split.test:
        engine = calibration_for(bundle.calibration, log)
        inputs, measured = log.matrix(engine.input_names), log.matrix(engine.output_names)
        free_run = engine.simulate(inputs)
        settled = engine.steady.outputs(inputs)
        assert (rmse(free_run - measured) < rmse(settled - measured)).all()
        reloaded = calibration_for(again, log).simulate(inputs)
        np.testing.assert_array_equal(reloaded, free_run)
