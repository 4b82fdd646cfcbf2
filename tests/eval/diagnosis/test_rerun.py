"""A simulator that can be run again says itself what an effect on its inputs does."""

from dataclasses import replace

import numpy as np
import pytest

from eval.diagnosis.pairs import pair_logs
from eval.diagnosis.simulators import Rerun
from narxcal.effects import effect, respond
from narxcal.support.errors import ModelError
from tests.eval.diagnosis.conftest import batch

BLOCK = 2


class Guess:
    """An emulator that must not be asked for inputs, and says nothing of any pace."""

    def run(self, flights, _told, pace=None, _shift=None):
        assert pace is not None
        return np.repeat(flights.y, len(pace[0]) // len(flights.y), axis=0)


def simulate(log):
    """Outputs that are lags of the lever, on the raster of the log."""
    power, dt_s = log["TRA_deg"] / 70.0, log.dt_s
    found = {}
    for name, tau_s, low, span in (("N1_pct", 1.5, 25, 75), ("N2_pct", 0.8, 55, 45)):
        y = np.empty_like(power)
        y[0] = power[0]
        for k in range(1, len(y)):
            y[k] = power[k] + np.exp(-dt_s / tau_s) * (y[k - 1] - power[k])
        found[name] = low + span * y
    found["EGT_C"] = 400.0 + 350.0 * power
    return found


@pytest.fixture
def flights(fly, log_of):
    logs = []
    for seed in range(2):
        channels = fly(seed, 120.0)
        channels |= simulate(log_of(channels))
        logs.append(pair_logs(f"flight_{seed}", log_of(channels), log_of(channels)))
    return batch(logs).flights


def test_an_effect_on_inputs_is_the_simulator_told_so(flights):
    rerun = Rerun(Guess(), simulate, BLOCK)
    setting = (effect("throttle_bias"), np.array([[3.0]]))
    found = respond([setting], flights, rerun)[0] - flights.y
    np.testing.assert_allclose(found[:, 400:, 0], 75.0 * 3.0 / 70.0, atol=1e-6)
    np.testing.assert_allclose(found[:, 400:, 2], 350.0 * 3.0 / 70.0, atol=1e-6)


def test_what_was_flown_is_asked_once(flights):
    """And anew for other flights."""
    asked = []
    rerun = Rerun(Guess(), lambda log: asked.append(log) or simulate(log), BLOCK)
    for width in (1.0, 2.0):
        respond([(effect("throttle_backlash"), np.array([[width]]))], flights, rerun)
    assert len(asked) == 3 * len(flights.u)
    other = replace(flights, u=flights.u + 0.0)
    np.testing.assert_array_equal(rerun.run(other, other.u), rerun.run(flights, flights.u))
    assert len(asked) == 5 * len(flights.u)


def test_an_effect_inside_is_the_emulators(flights):
    setting = (effect("spool_lag"), np.array([[1.5]]))
    found = respond([setting], flights, Rerun(Guess(), simulate, BLOCK))[0]
    np.testing.assert_array_equal(found, flights.y)


def test_samples_of_which_it_says_nothing_are_bridged(flights):
    def gaps(log):
        found = simulate(log)
        found["EGT_C"][60:80] = np.nan
        return found

    told = flights.u + 0.0
    found, whole = (Rerun(Guess(), each, BLOCK).run(flights, told) for each in (gaps, simulate))
    assert np.isfinite(found).all()
    np.testing.assert_array_equal(found[:, 41:], whole[:, 41:])
    mute = Rerun(Guess(), lambda log: {**simulate(log), "EGT_C": np.full(len(log), np.nan)}, BLOCK)
    with pytest.raises(ModelError, match="channel EGT_C: the simulator no longer gives it"):
        mute.run(flights, told)


class Slower:
    """An emulator whose every run is 10, 1 more at another pace, and where it settles besides."""

    def run(self, flights, told, pace=None, shift=None):
        rows = len(told) if pace is None else len(pace[0])
        changed = 0.0 if pace is None or pace.fan_up[0] == 1.0 else 1.0
        found = np.full((rows, *flights.y.shape[1:]), 10.0 + changed)
        return found if shift is None else found + shift.settled


def test_of_both_the_input_is_the_simulators_and_the_pace_the_emulators(flights):
    rerun = Rerun(Slower(), simulate, BLOCK)
    told = (effect("throttle_bias"), np.array([[3.0]]))
    paced = (effect("spool_lag"), np.array([[1.5]]))
    alone = respond([told], flights, rerun)[0]
    np.testing.assert_allclose(respond([told, paced], flights, rerun)[0], alone + 1.0, atol=1e-9)


def test_where_it_settles_is_the_emulators_and_the_simulator_is_not_asked(flights):
    asked, idle = [], effect("idle_schedule")
    s = flights.signals
    s = replace(s, inputs=(*s.inputs, "Approach"), active=(*s.active, "Approach"))
    set_ = np.arange(flights.u.shape[1]) > 100
    u = np.concatenate([flights.u, np.tile(set_[:, None], (len(flights.u), 1, 1))], axis=2)
    rerun = Rerun(Slower(), lambda log: asked.append(log) or simulate(log), BLOCK)
    theta = np.array([[0.5, 2.0, 1.0, 8.0]])
    of = replace(flights, signals=s, u=u)
    found = respond([(idle, theta)], of, rerun)[0]
    lever = (u[..., s.u("TRA_deg")] - s.lever[0]) / (s.lever[1] - s.lever[0])
    shape = set_ * np.maximum(0.0, 1.0 - 2.0 * lever)
    assert shape.max() > 0.5
    np.testing.assert_allclose(found - flights.y, shape[..., None] * theta[0, 1:], atol=1e-9)
    assert not asked
