"""The grey box fitted to logs: it follows them, knows heavier rotors, and takes what there is."""

from dataclasses import replace

import numpy as np
import pytest

from narxcal import two_spool
from narxcal.effects import Flights, effect
from narxcal.effects.base import as_simulated
from narxcal.effects.running import Shift, respond
from narxcal.support.errors import DataError
from tests.training.diagnosis.emulator.conftest import simulate
from training.diagnosis.emulator import fit_emulators, widened
from training.diagnosis.two_spool_fit import GOVERNED_CORE


@pytest.fixture(scope="module")
def fitted(flights):
    return fit_emulators(flights)[0]


def test_its_free_run_follows_the_logs(fitted, flights):
    span = flights.signals.high - flights.signals.low
    assert (fitted.errors(flights) < 0.02 * span).all()


@pytest.mark.parametrize(
    ("name", "size"),
    [
        ("spool_lag", 1.5),
        ("spool_coupling", 1.5),
        ("accel_limit", 0.6),
        ("accel_decel_asymmetry", 1.5),
        ("altitude_lag", 0.6),
        ("throttle_backlash", 4.0),
    ],
)
def test_what_an_effect_does_to_the_engine_it_does_to_its_emulator(
    name, size, fitted, flights, engine
):
    others = [p.neutral for p in effect(name).parameters(flights.signals)[1:]]
    setting = (effect(name), np.array([[size, *others]]))
    true, found = (respond([setting], flights, e)[0] - flights.y for e in (engine, fitted))
    span = flights.signals.high - flights.signals.low
    left = np.sum(((found - true) / span) ** 2) / np.sum((true / span) ** 2)
    assert left < 0.15


def test_a_schedule_of_fuel_a_reset_and_curves_are_found(engine, flights):
    """An engine whose limits bend and go with the fan, whose governor resets: its own twin."""
    theta = engine.engine.theta.copy()
    theta[two_spool.UP + 3 : two_spool.UP + 5] = -1.0, -0.8
    theta[two_spool.DOWN + 3] = 0.8
    theta[two_spool.GAIN + 3], theta[two_spool.FAN + 3] = 0.4, 0.6
    theta[two_spool.LINE + 1], theta[two_spool.LINE + 3] = 0.6, -0.4
    theta[two_spool.RESET] = 0.4
    twin = replace(engine, engine=replace(engine.engine, theta=theta))
    flown = replace(flights, y=twin.free_run(flights))
    span = flown.y.max(axis=(0, 1)) - flown.y.min(axis=(0, 1))
    found = fit_emulators(flown)[0]
    assert (found.errors(flown) < 0.012 * span).all()
    assert found.engine.theta[two_spool.RESET] == pytest.approx(0.4, abs=0.12)
    setting = (effect("accel_limit"), np.array([[0.6, 30.0]]))
    true, said = (respond([setting], flown, e)[0] - flown.y for e in (twin, found))
    assert np.sum(((said - true) / span) ** 2) < 0.1 * np.sum((true / span) ** 2)


def test_it_settles_elsewhere_from_the_start_and_goes_there_as_it_goes_anywhere(fitted, flights):
    """By a shift that lasts it stays away by that; where there is none it is itself."""
    count, shift = len(flights.u), np.zeros_like(flights.y)
    pace, itself = as_simulated(count), fitted.run(flights, flights.u)
    none = np.zeros(shift.shape[:2])
    same = fitted.run(flights, flights.u, pace, Shift(shift, none))
    np.testing.assert_array_equal(same, itself)
    shift[1:] = 0.5, 0.25, 3.0
    moved = fitted.run(flights, flights.u, pace, Shift(shift, none)) - itself
    np.testing.assert_array_equal(moved[0], 0.0)
    np.testing.assert_allclose(moved[1:, 0], shift[1:, 0], atol=1e-9)
    np.testing.assert_allclose(np.median(moved[1:], axis=1), shift[1:, 0], rtol=0.1)


def test_each_row_settles_by_its_own_shift(fitted, flights):
    count = len(flights.u)
    shift = np.zeros((2 * count, *flights.y.shape[1:]))
    shift[count:] = 1.0, 0.5, 5.0
    load = 0.1 * shift[..., 2]
    both = fitted.run(flights, flights.u, as_simulated(2 * count), Shift(shift, load))
    np.testing.assert_array_equal(both[:count], fitted.run(flights, flights.u))
    own = Shift(shift[count:], load[count:])
    alone = fitted.run(flights, flights.u, as_simulated(count), own)
    np.testing.assert_array_equal(both[count:], alone)


def test_a_row_does_not_know_the_others(fitted, flights):
    told = flights.u.copy()
    told[..., 0] += 2.0
    both = fitted.run(flights, np.concatenate([flights.u, told]))
    np.testing.assert_array_equal(both[: len(told)], fitted.run(flights, flights.u))
    np.testing.assert_array_equal(both[len(told) :], fitted.run(flights, told))


def test_without_a_lever_the_fuel_says_where_the_core_goes(flights):
    signals = replace(
        flights.signals,
        inputs=("FF_kgph", *flights.signals.inputs[1:]),
        driver="FF_kgph",
        active=("FF_kgph", "ALT_ft", "dT_C", "NAI"),
    )
    found = fit_emulators(replace(flights, signals=signals))[0]
    assert found.engine.governed == GOVERNED_CORE


@pytest.mark.parametrize("kept", [(0, 2), (1, 2)])
def test_one_spool_alone_is_an_engine(kept, flights):
    s, columns = flights.signals, list(kept)
    signals = replace(
        s, outputs=tuple(s.outputs[j] for j in kept), low=s.low[columns], high=s.high[columns]
    )
    alone = Flights(signals, flights.u, flights.y[..., columns], flights.lengths)
    found = fit_emulators(alone)[0]
    assert (found.errors(alone) < 0.05 * (signals.high - signals.low)).all()


def test_without_a_speed_there_is_no_engine(flights):
    s = flights.signals
    signals = replace(s, outputs=("EGT_C",), low=s.low[2:], high=s.high[2:])
    only = Flights(signals, flights.u, flights.y[..., 2:], flights.lengths)
    with pytest.raises(DataError, match="no spool speed is recorded"):
        fit_emulators(only)[0]


def test_what_the_simulator_says_of_other_flights_widens_its_emulator(flights):
    """Of high power it knows what low power says, until it is told; its control stays the same."""
    lever = flights.u[..., 0]
    low = lever.max(axis=1) < np.sort(lever.max(axis=1))[2]
    u = flights.u.copy()
    u[..., 0] = np.where(low[:, None], 2.0 + 0.4 * (lever - 2.0), lever)
    y = simulate(u)
    few = _some(flights, u[low], y[low])
    begun = fit_emulators(few)[-1]
    every = _some(flights, u, y)
    found = widened(begun, every)
    span = y.max(axis=(0, 1)) - y.min(axis=(0, 1))
    assert (begun.errors(every) > 0.1 * span).all()
    assert (found.errors(every) < 0.03 * span).all()
    assert found.engine.governed == begun.engine.governed >= two_spool.HOLDS_FUEL


def _some(flights, u, y):
    limits = (y.min(axis=(0, 1)), y.max(axis=(0, 1)))
    lever = (float(u[..., 0].min()), float(u[..., 0].max()))
    signals = replace(flights.signals, low=limits[0], high=limits[1], lever=lever)
    return Flights(signals, u, y, np.full(len(u), u.shape[1]))
