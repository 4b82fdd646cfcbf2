"""What a worn engine shows at one fan speed, whatever a control holds."""

from types import SimpleNamespace

import numpy as np
import pytest

from narxcal.effects import Flights, Signals
from training.gap.at_speed import at_one_speed, burns_more

OUTPUTS = ("N1_pct", "EGT_C", "FF_kgph")
DT, HELD = 0.5, 80  # s; samples at each lever


def line(fan, altitude_ft):
    """Where the engine settles: temperature and fuel flow over the speed of its fan."""
    thin = 1.0 - altitude_ft / 50_000.0
    return np.stack([fan, 1000.0 * (fan / 100.0) ** 0.6 - 273.15, 3000.0 * thin * fan**3 / 1e6], -1)


def flown(slower=0.0, hotter=0.0, thirstier=0.0):
    """Steps of the lever at two altitudes, and gaps of an engine that is not the simulated one.

    In % of the levels: by how much its fan is slower, and how much hotter it is, and burns more,
    at one speed. While it moves the temperature is off by 80 K more.
    """
    fan = np.repeat(
        np.array([[40.0, 70.0, 55.0, 90.0, 100.0], [45.0, 95.0, 60.0, 80.0, 50.0]]), HELD, 1
    )
    altitude = np.repeat([[2_000.0], [20_000.0]], fan.shape[1], axis=1)
    y = line(fan, altitude)
    real = line(fan * (1.0 - slower / 100.0), altitude)
    real[..., 1] += hotter / 100.0 * (real[..., 1] + 273.15)
    real[..., 2] *= 1.0 + thirstier / 100.0
    real[:, np.arange(fan.shape[1]) % HELD < 8, 1] += 80.0
    low, high = y.min(axis=(0, 1)), y.max(axis=(0, 1))
    signals = Signals(("ALT_ft",), OUTPUTS, DT, "TRA_deg", low, high, active=("ALT_ft",))
    flights = Flights(signals, altitude[..., None], y, np.full(2, fan.shape[1]))
    return flights, SimpleNamespace(gap=real - y, weights=np.ones_like(y))


@pytest.mark.parametrize("slower", [0.0, 2.0, -1.0])
def test_shifts_at_one_speed_are_the_same_whatever_the_control_holds(slower):
    found = at_one_speed(*flown(slower, 3.0, 4.0))
    assert list(found) == ["EGT_C", "FF_kgph"]
    np.testing.assert_allclose(found["EGT_C"], 100.0 * np.log(1.03), atol=0.02)
    np.testing.assert_allclose(found["FF_kgph"], 100.0 * np.log(1.04), atol=0.1)


def test_the_same_engine_is_off_by_nothing():
    for shift in at_one_speed(*flown(2.0)).values():
        np.testing.assert_allclose(shift, 0.0, atol=0.1)


def test_what_is_not_known_at_rest_is_not_told():
    flights, measure = flown(0.0, 3.0, 4.0)
    measure.weights[1, :, 1] = 0.0
    found = at_one_speed(flights, measure)
    assert np.isnan(found["EGT_C"]).tolist() == [False, True]
    assert not np.isnan(found["FF_kgph"]).any()
    measure.weights[:, 30:, 0] = 0.0
    assert all(np.isnan(shift).all() for shift in at_one_speed(flights, measure).values())


def test_an_engine_that_never_rests_tells_nothing():
    flights, measure = flown(0.0, 3.0, 4.0)
    flights.y[..., 0] += 5.0 * np.sin(np.arange(flights.y.shape[1]))
    assert all(np.isnan(shift).all() for shift in at_one_speed(flights, measure).values())


@pytest.mark.parametrize(
    ("fuel", "more"),
    [
        ([4.0, 4.2, 9.0], True),
        ([2.3, 2.4, 2.6], False),
        ([2.6, 2.6, 2.6], True),
        ([-4.0] * 3, False),
    ],
)
def test_a_worn_engine_burns_more_in_the_median(fuel, more):
    """Of a temperature that is 3 % up, 0.8 and at least 2.5 %."""
    shifts = {"EGT_C": np.full(3, 3.0), "FF_kgph": np.array(fuel)}
    assert burns_more(shifts, (0.8, 2.5)) is more


def test_without_fuel_flow_or_temperature_nothing_is_said_of_wear():
    assert not burns_more({"EGT_C": np.ones(2)}, (0.0, 0.0))
    assert not burns_more({"FF_kgph": np.ones(2)}, (0.0, 0.0))
    assert not burns_more({"EGT_C": np.ones(2), "FF_kgph": np.full(2, np.nan)}, (0.0, 0.0))
