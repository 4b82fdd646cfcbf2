"""One recipe on public sets: figures of ours and of the linear rungs, from files as they come."""

import json
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from eval.benchmarks import drawn_systems, recipe
from eval.benchmarks.public_sets import read
from narxcal.support.errors import ConfigError, DataError
from training.choice import Limits


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
    found = list(recipe.figures(folder, "lag", Limits(0.05)))
    models = [recipe.OURS, recipe.FIXED, recipe.LINEAR]
    assert [one.model for one in found] == models
    ours, fixed, linear, *_ = found
    assert max(ours.rmse, linear.rmse, fixed.rmse) < 0.02
    assert all(one.record == "" for one in found)
    document = recipe.document(found, {})
    assert document["geometric_mean_ratio"] == pytest.approx(ours.rmse / linear.rmse)
    assert document["figures"][0]["set"] == "lag"


def test_drawn_systems_are_sets_that_hang_on_their_seed_alone(tmp_path):
    for folder, seed in (("a", 3), ("b", 3), ("c", 4)):
        drawn_systems.write(tmp_path / folder, seed)
    names = recipe.names_in(tmp_path / "a")
    assert len(names) == len(drawn_systems.SYSTEMS)
    for name in names:
        one, same = (read(tmp_path / folder, name) for folder in "ab")
        other = read(tmp_path / "c", name.replace("_3", "_4"))
        np.testing.assert_array_equal(one.train[0].y, same.train[0].y)
        assert len(one.test[0]) == 2000
        assert np.isfinite(one.train[0].y).all()
        assert np.std(one.test[0].y) > 0.05
        assert not np.array_equal(one.test[0].y, other.test[0].y)


def test_a_python_without_jax_sysid_says_what_to_install(folder):
    with pytest.raises(ConfigError) as caught:
        list(recipe.figures(folder, "lag", Limits(0.05), jax_python=Path(sys.executable)))
    assert "--jax-python: jax-sysid failed in" in str(caught.value)
    assert "pip install jax-sysid==1.1.0" in str(caught.value)
    with pytest.raises(ConfigError, match="can't be run"):
        list(recipe.figures(folder, "lag", Limits(0.05), jax_python=folder / "no python"))


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
