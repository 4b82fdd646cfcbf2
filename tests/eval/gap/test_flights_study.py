"""The page about the open flights: what acts in both engines, what one explains in the other."""

import numpy as np
import pytest

from data_prep.log import Source
from eval.gap.flights_study import paired, study, written


def test_each_engine_stands_beside_what_the_simulator_says(fly, record, log_of):
    sim = fly(0)
    log = log_of(record(sim, 0))
    log = type(log)(log.name, log.time_s, log.channels, source=Source(file="f", engine="left"))

    def simulate(log):
        return {name: sim[name] for name in ("N1_pct", "N2_pct", "EGT_C")}

    [pair] = paired([log], simulate)
    assert pair.name == "left"
    np.testing.assert_array_equal(pair.sim["N1_pct"], sim["N1_pct"])
    np.testing.assert_array_equal(pair.real["N1_pct"], log["N1_pct"])


@pytest.mark.slow
def test_what_one_engine_tells_is_checked_on_the_other(pair, probe):
    pairs = [pair(seed, probe) for seed in range(2)]
    found = study("f1, by a model of f2", pairs)
    assert found.both["verdict"]["effects"] == ["sensor_lag:EGT_C"]
    assert set(found.crossed) == {"flight_0", "flight_1"}
    assert all(each["shrink"]["realised"] > 0.8 for each in found.crossed.values())
    page = written([found])
    assert "## f1, by a model of f2" in page
    rows = [line for line in page.splitlines() if line.startswith("| flight_")]
    assert all(len(row.split(" | ")) == 4 and "`sensor_lag:EGT_C`" in row for row in rows)
