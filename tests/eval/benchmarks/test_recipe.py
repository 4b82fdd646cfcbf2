"""One recipe on public sets: figures of ours and of the linear rungs, from files as they come."""

import importlib.util
import json

import numpy as np
import pandas as pd
import pytest

from eval.benchmarks import recipe
from narxcal.support.errors import DataError


@pytest.fixture
def folder(tmp_path):
    """A first-order lag in 400 samples: its second half is the official test range."""
    draw = np.random.default_rng(0)
    u = np.repeat(draw.standard_normal(40), 10)
    y = np.zeros(400)
    for k in range(1, 400):
        y[k] = 0.9 * y[k - 1] + 0.1 * u[k - 1]
    y += 0.01 * draw.standard_normal(400)
    pd.DataFrame({"u": u, "y": y}).to_csv(tmp_path / "lag.csv.gz", index=False)
    ranges = {"train": [0, 200], "test": [200, 400], "init_window": 10}
    (tmp_path / "lag.json").write_text(json.dumps(ranges))
    return tmp_path


def test_ours_and_linear_reach_the_noise_of_a_linear_set(folder):
    found = list(recipe.figures(folder, "lag", 0.05))
    models = [recipe.OURS, recipe.FIXED, recipe.LINEAR]
    if importlib.util.find_spec("jax_sysid") is None:
        assert [one.model for one in found] == models
    ours, fixed, linear, *_ = found
    assert max(ours.rmse, linear.rmse, fixed.rmse) < 0.02
    assert all(one.record == "" for one in found)
    document = recipe.document(found, {})
    assert document["geometric_mean_ratio"] == pytest.approx(ours.rmse / linear.rmse)
    assert document["figures"][0]["set"] == "lag"


def test_a_set_that_is_not_there_is_named(folder, tmp_path):
    with pytest.raises(DataError) as caught:
        recipe.names_in(folder, ["lag", "tanks"])
    assert str(caught.value) == (
        f"the set 'tanks' is not in {folder}. "
        "A set is NAME.csv.gz with columns u and y, and NAME.json with its ranges"
    )
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataError, match=r"^no set is in"):
        recipe.names_in(tmp_path / "empty")
