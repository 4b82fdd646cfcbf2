"""The transport delay of a lever: one that is there is found, one that is not isn't."""

import numpy as np
import pytest

from data_prep.log import Log, Source
from narxcal.steady.table import SteadyTable
from training.config import RunConfig
from training.dynamics.transport import choose_delay, delayed

NAMES, DT_S = (("TRA_deg",), ("N1_pct", "N2_pct", "EGT_C")), 0.1
LEVELS = np.array([0.0, 20.0, 40.0, 60.0, 80.0])[:, None]
CONFIG = RunConfig.parse({"steady_state": {"inputs": ["TRA_deg"]}})


def steady():
    return SteadyTable(NAMES, LEVELS, np.hstack([20 + LEVELS, 50 + 0.6 * LEVELS, 400 + 4 * LEVELS]))


def flight(seed, delay_s, noise=0.05):
    """Four minutes of an engine of second order, whose lever acts late."""
    rng = np.random.default_rng(seed)
    lever = np.repeat(rng.uniform(5.0, 75.0, 16), 150)
    late = np.concatenate([np.full(round(delay_s / DT_S), lever[0]), lever])[: len(lever)]
    ss = steady().outputs(late[:, None])
    core, y = ss[0].copy(), ss.copy()
    for k in range(1, len(ss)):
        core = core + DT_S / 0.5 * (ss[k] - core)
        y[k] = y[k - 1] + DT_S / np.array([1.4, 1.0, 1.8]) * (core - y[k - 1])
    y += noise * rng.normal(size=y.shape) * [1.0, 1.0, 8.0]
    channels = {"TRA_deg": lever, **dict(zip(NAMES[1], y.T, strict=True))}
    time_s = DT_S * np.arange(len(lever))
    return Log(f"f{seed}", time_s, channels, source=Source(file=f"f{seed}"))


@pytest.mark.parametrize("delay_s", [0.0, 1.5])
def test_a_delay_is_found_where_there_is_one(delay_s):
    found = choose_delay(CONFIG, steady(), [flight(seed, delay_s) for seed in (0, 1, 2)])
    if delay_s == 0.0:
        assert found.delay is None
    else:
        assert found.delay.channels == ("TRA_deg",)
        # The engine also has a lag of half a second, which plain lags lack.
        assert found.delay.delay_s == pytest.approx(delay_s, abs=0.25)
        assert found.delay.low_s <= found.delay.delay_s <= found.delay.high_s


def test_a_known_delay_is_taken():
    logs = [flight(0, 0.0)]
    known = choose_delay(CONFIG.having(train={"delay_s": 0.7}), steady(), logs).delay
    assert (known.delay_s, known.low_s, known.high_s) == (0.7, 0.7, 0.7)
    assert choose_delay(CONFIG.having(train={"delay_s": 0.0}), steady(), logs).delay is None
    late = delayed(logs[0], known)
    np.testing.assert_allclose(late["TRA_deg"][7:], logs[0]["TRA_deg"][:-7])
    np.testing.assert_array_equal(late["N1_pct"], logs[0]["N1_pct"])
    assert delayed(logs[0], None) is logs[0]
