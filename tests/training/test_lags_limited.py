"""Fitting the lags: known ones come back, also past a bleed that nobody recorded."""

import numpy as np
import pytest

from narxcal.lumped.engine import LumpedEngine
from narxcal.lumped.limited import LIMITED as PARAMETERS
from narxcal.lumped.limited import UNLIMITED
from narxcal.support.errors import DataError
from training.dynamics.lag_priors import Form, start_engine
from training.dynamics.lags import fit_engine
from training.records import LagSamples

NAMES = (("ALT_ft",), ("N1_pct", "N2_pct", "EGT_C"))
DT_S = 0.1
SCALES = {
    "centre": np.array([60.0, 75.0, 500.0]),
    "half": np.array([30.0, 20.0, 150.0]),
    "limit": np.full(3, 1e3),
}


HEAT = {"heat": 1.0, "heat_speed": -0.5, "heat_rate": 0.4, "heat_air": 0.8}


def truth(**limits):
    """Lags without limits of the spools' rates, but for `limits`; their heat is nil."""
    free = {"log_up": UNLIMITED, "log_down": UNLIMITED, **limits}
    values = {
        "N1_pct": {"log_tau": 0.2, "air": 0.8, "speed": -0.3, "target": -0.4, "lead_s": 0.2,
                   "core": 0.3, **HEAT},
        "N2_pct": {"log_tau": 0.0, "air": 1.0, "speed": -0.2, "target": -0.5, "lead_s": 0.4,
                   **HEAT},
        "EGT_C": {"log_tau": -0.5, "core": -3.0, "slow_share": 0.1, "log_slow_tau": 2.0},
    }  # fmt: skip
    table = [[values[name].get(key, free.get(key, 0.0)) for key in PARAMETERS] for name in NAMES[1]]
    return LumpedEngine.of(NAMES[1], {"parameters": np.array(table)}, SCALES)


def log(seed, *, bleed=0.0, noise=0.02, dt_s=DT_S, model=None, hold_s=12.0):
    """Moves every `hold_s` at altitudes up to 30 000 ft, followed by the true lags."""
    rng = np.random.default_rng(seed)
    hold, moves = round(hold_s / dt_s), 40
    part = np.repeat(rng.uniform(-1.0, 1.0, moves), hold)
    part = np.convolve(part, np.ones(8) / 8, "same")[:, None]
    ss = np.array([60.0, 75.0, 500.0]) + np.array([30.0, 20.0, 150.0]) * part
    inputs = np.repeat(rng.uniform(0.0, 30000.0, moves), hold)[:, None]
    model = model or truth()
    lag = model.deviations(model.drive(inputs, NAMES[0], ss), np.zeros(3), dt_s)
    measured = ss - lag + noise * rng.normal(size=ss.shape) * [1.0, 1.0, 10.0]
    measured[hold * 5 : hold * 8] += bleed
    return LagSamples(inputs, ss, measured)


def follow(model, seed=99, dt_s=DT_S, true=None):
    """RMS error of a fitted model's free run over a log that it has not seen, per output."""
    new = log(seed, noise=0.0, dt_s=dt_s, model=true)
    lag = model.deviations(model.drive(new.inputs, NAMES[0], new.ss), np.zeros(3), dt_s)
    spread = (new.ss - new.measured).std(axis=0)
    return np.sqrt(np.mean((new.ss - lag - new.measured) ** 2, axis=0)) / spread


def test_known_lags_come_back_and_follow_an_unseen_log():
    model = fit_engine([log(0), log(1)], NAMES, DT_S)
    # So close to the moves, little is seen of the slow heat soak, which is most in the temperature.
    assert (follow(model) < [0.01, 0.01, 0.15]).all()
    core = dict(zip(PARAMETERS, model.arrays["parameters"][1], strict=True))
    assert core["air"] == pytest.approx(1.0, abs=0.05)
    assert core["lead_s"] == pytest.approx(0.4, abs=0.05)
    assert core["core"] == 0.0


def test_a_finer_raster_gives_the_same_lags():
    model = fit_engine([log(0, dt_s=1 / 32), log(1, dt_s=1 / 32)], NAMES, 1 / 32)
    assert (follow(model, dt_s=1 / 32) < 0.1).all()


def test_a_bleed_that_nobody_recorded_hardly_bends_them():
    model = fit_engine([log(0, bleed=1.5), log(1)], NAMES, DT_S)
    assert (follow(model) < [0.06, 0.06, 0.15]).all()


def test_masked_samples_are_left_out():
    holed = log(0)
    holed.measured[500:900, 0] = np.nan
    holed.measured[2000:2050] = np.nan
    assert (follow(fit_engine([holed, log(1)], NAMES, DT_S)) < [0.01, 0.01, 0.15]).all()


def test_the_limit_is_wider_than_what_training_has_seen():
    one = log(0)
    model = fit_engine([one], NAMES, DT_S)
    assert (model.limit > np.abs(one.ss - one.measured).max(axis=0)).all()


def test_an_engine_that_never_moves_cannot_teach_a_lag():
    still = np.tile([60.0, 75.0, 500.0], (200, 1))
    wander = still + 1e-12 * np.arange(200)[:, None]
    with pytest.raises(DataError, match="the outputs never move, so no lag can be fitted"):
        fit_engine([LagSamples(np.zeros((200, 1)), still, wander)], NAMES, DT_S)


def test_small_moves_count_as_much_as_slams():
    """One log of slams, and one of moves a tenth of that, which are slower than the lags allow."""
    slams, small = log(0, noise=0.0), log(1, noise=0.0)
    middle = np.array([60.0, 75.0, 500.0])
    ss = middle + 0.1 * (small.ss - middle)
    slow = np.zeros_like(ss)
    for k in range(1, len(ss)):
        slow[k] = np.exp(-DT_S / 2.5) * (slow[k - 1] + ss[k] - ss[k - 1])
    small = LagSamples(small.inputs, ss, ss - slow)
    left = []
    for logs in ([slams, small], [slams]):
        model = fit_engine(logs, NAMES, DT_S)
        drive = model.drive(small.inputs, NAMES[0], ss)
        error = (model.deviations(drive, np.zeros(3), DT_S) - slow)[:, 1]
        left.append(float(np.sqrt(np.mean(error**2))))
    assert left[0] < 0.75 * left[1]  # of absolute errors slams would decide alone


def test_limits_of_acceleration_and_deceleration_come_back():
    true = truth(log_up=-0.5, up_air=-1.0, up_speed=0.6, log_down=0.3, down_air=-0.7)
    logs = [log(seed, model=true) for seed in (0, 1)]
    limited = fit_engine(logs, NAMES, DT_S, Form(limited=True))
    assert (follow(limited, true=true) < 0.05).all()
    plain = fit_engine(logs, NAMES, DT_S)
    assert (follow(limited, true=true)[:2] < 0.5 * follow(plain, true=true)[:2]).all()
    assert (plain.arrays["parameters"][:, PARAMETERS.index("log_up")] == UNLIMITED).all()


def test_how_a_slow_fan_holds_the_core_back_comes_back():
    true = truth(log_up=-0.5, up_air=-1.0, log_down=0.3, down_air=-0.7)
    true.arrays["parameters"][1, PARAMETERS.index("up_other")] = 0.8
    logs = [log(seed, model=true) for seed in (0, 1)]
    fitted = fit_engine(logs, NAMES, DT_S, Form(limited=True))
    assert (follow(fitted, true=true) < 0.05).all()
    found = fitted.arrays["parameters"][:, PARAMETERS.index("up_other")]
    assert found[1] == pytest.approx(0.8, abs=0.3)
    assert found[0] == found[2] == 0.0


def test_the_heat_of_the_casing_comes_back_though_each_stretch_begins_with_some_of_it():
    true = truth()
    hot = {"casing_share": 0.1, "log_casing_tau": 4.0, "core": 6.0, "rate": -4.0, "rate_air": 0.5}
    for name, value in hot.items():
        true.arrays["parameters"][2, PARAMETERS.index(name)] = value
    logs = [log(seed, model=true, hold_s=40.0) for seed in (0, 1)]
    fitted = fit_engine(logs, NAMES, DT_S, Form(limited=True))
    plain = fit_engine(logs, NAMES, DT_S)
    assert follow(fitted, true=true)[2] < 0.03
    assert follow(plain, true=true)[2] > 0.06


@pytest.mark.parametrize("share", [0.0, 0.15])
def test_heat_that_drives_the_spools_comes_back_and_is_nil_where_there_is_none(share):
    """It shows where the engine rests between moves, as in flight."""
    true = truth()
    slow = [PARAMETERS.index(name) for name in ("slow_share", "log_slow_tau")]
    true.arrays["parameters"][:2, slow] = share, 1.6
    fitted = fit_engine([log(k, model=true, hold_s=40.0) for k in (0, 1)], NAMES, DT_S)
    found = fitted.arrays["parameters"][:2, slow[0]]
    assert found == pytest.approx([share] * 2, abs=0.003 + 0.25 * share)
    assert (follow(fitted, true=true)[:2] < 0.03).all()
    begun, _ = start_engine(NAMES[1], Form(), SCALES)
    given = [PARAMETERS.index(name) for name in HEAT]
    assert begun.arrays["parameters"][:2, given].tolist() == [list(HEAT.values())] * 2
    assert not begun.arrays["parameters"][2, given].any()  # a temperature shows heat itself
