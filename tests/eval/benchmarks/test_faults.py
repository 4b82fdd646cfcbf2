"""Drawn faults: the same ones for a seed, in the channel that they name and nowhere else."""

import numpy as np
import pytest

from data_prep.log import Log
from eval.benchmarks.faults import drawn, sensor

TIME_S = 0.2 * np.arange(3000)
WAVE = np.sin(TIME_S / 40.0)
LOG = Log(
    "flight",
    TIME_S,
    {
        "N1_pct": 70.0 + 20.0 * WAVE, "N2_pct": 85.0 + 10.0 * WAVE, "EGT_C": 500.0 + 90.0 * WAVE,
        "FF_kgph": 300.0 + 150.0 * WAVE, "ALT_ft": 9000.0 + 500.0 * WAVE,
        "Mach": 0.4 + 0.01 * WAVE,
    },
)  # fmt: skip


def test_a_seed_draws_the_same_faults_and_another_seed_others():
    words = [[(one.kind, one.channels, one.size) for one in drawn(LOG, k, 20)] for k in (3, 3, 4)]
    assert words[0] == words[1] != words[2]
    assert len({kind for kind, *_ in words[0]}) >= 6


@pytest.mark.parametrize("seed", range(3))
def test_a_fault_changes_what_it_names_between_begin_and_end(seed):
    for one in drawn(LOG, seed, 16):
        bad = one.into(LOG)
        if one.channels == ("time_s",):
            assert len(bad) != len(LOG)
            continue
        for name in LOG.channels:
            changed = bad[name] != LOG[name]
            if name in one.channels:
                assert changed.any()
                rows = np.flatnonzero(changed)
                assert round(one.begins * len(LOG)) <= rows[0]
                assert rows[-1] < round(one.ends * len(LOG))
            else:
                assert not changed.any()


def test_the_sensor_models_are_those_of_the_library():
    values = LOG["N1_pct"]
    assert sensor("sensor_gain", "N1_pct", 5.0)(values, TIME_S) == pytest.approx(1.05 * values)
    assert sensor("sensor_bias", "N1_pct", -2.0)(values, TIME_S) == pytest.approx(values - 2.0)
    drift = sensor("sensor_drift", "N1_pct", 36.0)(values, TIME_S) - values
    assert np.diff(drift) == pytest.approx(0.2 * 36.0 / 3600.0)
    ramp = 50.0 + 0.1 * TIME_S
    late = sensor("sensor_lag", "N1_pct", 3.0, 0.0)(ramp, TIME_S)
    assert (ramp - late)[-1] == pytest.approx(0.3, rel=0.05)  # slope times the time constant


def test_only_sensors_are_drawn():
    with pytest.raises(Exception, match="has no channel"):
        sensor("spool_lag", "N1_pct", 1.2)
