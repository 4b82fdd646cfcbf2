"""What the product is for: response times on flights that took no part, held to floors.

Floors lie a little below what the shipped configurations reach: of the Citation with each flight
left out (`python -m eval.bench --flights`), of the others on the flight that they hold out, and of
other people's recorders with one half of a set judged by a model of the other. Every channel of a
shipped configuration is followed better than by its steady state. Whoever moves a floor says why.
"""

from itertools import chain
from pathlib import Path

import numpy as np
import pytest

from data_prep.prepare import prepare
from eval.benchmarks.flights import left_one_out, trained_on
from eval.benchmarks.recorders import Recorder
from eval.judging.evaluate import evaluate
from training.config import load_config
from training.pipeline import calibrate, configured_files, prepare_logs
from training.records import split_logs

DATA = Path(__file__).parents[3] / ".." / "shared" / "data"


def left_out(config, base):
    """Free runs over each flight by a model of the others."""
    for _, bundle, test in left_one_out(config, base, configured_files(config, base)):
        yield evaluate(bundle, test)


def held_out(config, base):
    """Free runs over what the configuration holds out."""
    split = split_logs(prepare_logs(config, configured_files(config, base)), config.split)
    yield evaluate(calibrate(config, base, split), list(split.test))


def halves(recorder):
    """Free runs over every second recording by a model of the others, and the other way round."""
    logs = [
        [one.log for one in prepare(own, recorder.config)] for own in recorder.recordings.values()
    ]
    for first in (0, 1):
        train, test = (list(chain(*logs[k::2])) for k in (first, 1 - first))
        yield evaluate(trained_on(recorder.config, Path(), train), test)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "folder", "runs", "floors"),
    [
        ("citation2.toml", "flights", left_out, (209, 190, (0.96, 0.72, 14.5))),
        ("agtf30.toml", "agtf30", held_out, (30, 28, (0.4, 0.25, 3.8))),
        ("jetcat.toml", "flights", held_out, (5, 1, (2.2, 26.0))),
    ],
)
def test_response_times_stay_in_tolerance(name, folder, runs, floors):
    if not (DATA / folder).is_dir():
        pytest.skip(f"the recorded flights are not in {DATA}")
    config, base = load_config(name)
    assessed, passed, rmse = floors
    found = list(runs(config.with_logs_in(DATA / folder), base))
    assert sum(one.tally.assessed for one in found) == assessed
    assert sum(one.tally.passed for one in found) >= passed
    errors = np.mean([[each.rmse for each in one.pooled.values()] for one in found], axis=0)
    assert (errors <= rmse).all(), errors
    for one in found:
        assert all(each.rmse < each.steady_state_rmse for each in one.pooled.values())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "passed", "ratio"),
    [("jetcat", 6, 1.0), ("test_cell", 0, 1.12), ("micro_gas_turbine", 0, 1.01)],
)
def test_other_peoples_recorders_stay_near_the_best_baseline_in_hindsight(name, passed, ratio):
    if not DATA.is_dir():
        pytest.skip(f"the recorders are not in {DATA}")
    found = list(halves(Recorder.read(name, DATA)))
    assert sum(one.tally.passed for one in found) >= passed
    pooled = [each for one in found for each in one.pooled.values()]
    over = [each.rmse / min(each.baselines.values()) for each in pooled]
    assert np.exp(np.mean(np.log(over))) <= ratio, over
