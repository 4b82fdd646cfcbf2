"""When a load of known size was on in other flights, however long it was on."""

from dataclasses import replace

import numpy as np
import pytest

from tests.training.gap.test_unlogged import DT_S, FLIGHTS, NOISE, SHIFT, STEPS, shifted
from training.gap.known_load import search_known
from training.gap.levels import climb, without_nuisances
from training.gap.quadratic import misfit
from training.gap.unlogged import Asked, find_known_load, levels_of

WINDOWS = (
    ((147.0, 237.0), (365.0, 471.0)),
    ((90.0, 210.0), (436.0, 555.0)),
    ((60.0, 190.0), (400.0, 520.0)),
    ((150.0, 260.0), (420.0, 560.0)),
)


def twice(values):
    return np.concatenate([values, values], axis=1)


LONG = replace(FLIGHTS, u=twice(FLIGHTS.u), y=twice(FLIGHTS.y), lengths=2 * FLIGHTS.lengths)


@pytest.fixture(scope="module")
def on():
    """A third of the time, in two windows of each flight."""
    time, found = np.arange(2 * STEPS) * DT_S, np.zeros((4, 2 * STEPS))
    for row, windows in zip(found, WINDOWS, strict=True):
        for start, stop in windows:
            row[(time >= start) & (time < stop)] = 1.0
    return found


def with_load_that_grows(on):
    """A large load that shifts more at power, and N1 less than in the flights it is known from."""
    noise = np.random.default_rng(3).standard_normal(LONG.y.shape) * NOISE
    grows = (0.3 + 1.2 * LONG.u[..., :1] / 80.0) * np.array([0.2, 1.0, 1.0])
    return misfit(LONG, LONG.y + noise + shifted(on, 5.0 * SHIFT) * grows, NOISE)


def test_long_windows_are_not_taken_for_wandering(on):
    measure = with_load_that_grows(on)
    levels = levels_of(Asked(LONG, measure, tuple((f,) for f in range(4))), 10.0)
    assert climb(levels, 5.0 * SHIFT, without_nuisances(levels), fixed=True) is None
    assert search_known(levels, 5.0 * SHIFT).explained > 0.3
    found = find_known_load(LONG, measure, 5.0 * SHIFT)
    assert (found.on != on).mean() < 0.05


def at_idle(on, share):
    """A load that leaves N1 as it is and shifts the others by `share` of their known shift."""
    noise = np.random.default_rng(5).standard_normal(LONG.y.shape) * NOISE
    form = np.array([0.0, share, share])
    return misfit(LONG, LONG.y + noise + shifted(on, 5.0 * SHIFT) * form, NOISE)


def test_at_idle_a_load_is_found_that_shifts_an_engine_otherwise(on):
    measure = at_idle(on, 2.5)
    levels = levels_of(Asked(LONG, measure, tuple((f,) for f in range(4))), 10.0)
    known = search_known(levels, 5.0 * SHIFT)
    assert known is None or not known.on.any(axis=1).all()
    found = find_known_load(LONG, measure, 5.0 * SHIFT)
    assert (found.on != on).mean() < 0.05
    assert {window.flight for window in found.windows} == {0, 1, 2, 3}


def test_windows_that_the_known_shift_does_not_explain_are_none_of_it(on):
    assert not find_known_load(LONG, at_idle(on, 0.2), 5.0 * SHIFT).on.any()


def test_flights_without_it_hold_none(on):
    noise = np.random.default_rng(4).standard_normal(LONG.y.shape) * NOISE
    slow = np.sin(np.arange(2 * STEPS) * DT_S / 90.0)[:, None] * np.array([0.2, 0.2, 6.0])
    measure = misfit(LONG, LONG.y + noise + slow, NOISE)
    assert not find_known_load(LONG, measure, 5.0 * SHIFT).on.any()


def test_a_flight_of_which_nothing_is_known_is_left_alone(on):
    measure = with_load_that_grows(on)
    real = measure.gap + LONG.y
    real[3] = np.nan
    found = find_known_load(LONG, misfit(LONG, real, NOISE), 5.0 * SHIFT)
    assert not found.on[3].any()
