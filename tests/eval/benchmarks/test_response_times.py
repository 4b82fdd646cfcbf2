"""What the product is for: response times on flights left out, held to floors.

Floors lie a little below what `python -m eval.bench --flights` reaches. Whoever moves one says why.
"""

from pathlib import Path

import numpy as np
import pytest

from data_prep.prepare import hold_inputs, prepare
from data_prep.reading import read_logs
from eval.evaluate import evaluate
from training.config import load_config
from training.folds import leave_one_flight_out
from training.pipeline import calibrate, configured_files
from training.records import Split

DATA = Path(__file__).parents[3] / ".." / "shared" / "data"


def left_out(config, base):
    """Free runs over each flight by a model of the others."""
    logs = [
        one.log for one in prepare(read_logs(configured_files(config, base), config.logs), config)
    ]
    for plan in leave_one_flight_out(logs, config.events):
        train = [hold_inputs(part.log, config.steady_state.inputs) for part in plan.train]
        bundle = calibrate(config, base, Split(tuple(train), (), ()))
        yield evaluate(bundle, [part.log for part in plan.test])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "folder", "judged", "passed", "rmse"),
    [
        ("citation2.toml", "flights", 209, 190, (0.96, 0.72, 14.5)),
        ("agtf30.toml", "agtf30", 86, 80, (0.5, 0.25, 3.6)),
    ],
)
def test_response_times_of_flights_left_out_stay_in_tolerance(name, folder, judged, passed, rmse):
    if not (DATA / folder).is_dir():
        pytest.skip(f"the recorded flights are not in {DATA}")
    config, base = load_config(name)
    found = list(left_out(config.with_logs_in(DATA / folder), base))
    assert sum(one.tally.assessed for one in found) == judged
    assert sum(one.tally.passed for one in found) >= passed
    errors = np.mean([[each.rmse for each in one.pooled.values()] for one in found], axis=0)
    assert (errors <= rmse).all(), errors
