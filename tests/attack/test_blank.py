"""A replay without predictions is no result, and a grid or a window without bounds is refused."""

import json

import pytest

from data_prep.cleaning.smooth import SmoothConfig
from data_prep.config import LogsConfig
from eval.replay import ReplaySummary
from narxcal.support.errors import ConfigError


def summary(blank):
    return ReplaySummary(
        rows=1000, engines=("",), log_s=100.0, wall_s=1.0, held={}, restarts={}, blank={"": blank},
        outside={}, gated={}, unfused={}, slow={}, dropped=0, truncated=False,
    )  # fmt: skip


def test_a_replay_of_blank_rows_names_the_input_that_is_missing():
    (text,) = summary({"Mach": 990, "dT_C": 20}).missed
    assert text == (
        "the model could not run at 99 % of the samples, for Mach is missing or out of its "
        "physical range: check its column and unit under [logs.columns]"
    )
    assert summary({"Mach": 50}).missed == []
    assert summary({}).missed == []
    assert json.loads(json.dumps(summary({}).to_dict()))["missed"] == []


@pytest.mark.parametrize("rate", [1e9, 1000.1, 0.0, -1.0])
def test_no_grid_takes_all_memory(rate):
    with pytest.raises(ConfigError, match="raster_hz"):
        LogsConfig.parse({"raster_hz": rate})


def test_no_window_is_longer_than_any_log():
    with pytest.raises(ConfigError, match="window"):
        SmoothConfig.parse({"window": 10**9 + 1})
