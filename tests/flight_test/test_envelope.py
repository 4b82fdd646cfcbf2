"""Airspeed, altitude and Mach as one triple."""

import numpy as np
import pytest

from narxcal.atmosphere import mach_of_cas
from narxcal.flight_test.route import AIRCRAFT, CEILING_FT, MACH_MAX, check_between
from narxcal.support.errors import ConfigError


@pytest.mark.parametrize(
    ("cas_kt", "alt_ft", "mach"),
    [
        # Standard tables of calibrated airspeed on the standard day.
        (250.0, 0.0, 0.378),
        (250.0, 10_000.0, 0.452),
        (300.0, 20_000.0, 0.650),
        (280.0, 30_000.0, 0.742),
        (0.0, 5000.0, 0.0),
    ],
)
def test_mach_of_a_calibrated_airspeed(cas_kt, alt_ft, mach):
    assert mach_of_cas(cas_kt, alt_ft) == pytest.approx(mach, abs=2e-3)


def test_at_sea_level_calibrated_is_true_airspeed():
    speeds = np.array([100.0, 200.0, 400.0])
    np.testing.assert_allclose(mach_of_cas(speeds, 0.0), speeds / 661.4786)


def test_one_airspeed_is_a_higher_mach_higher_up():
    assert (np.diff(mach_of_cas(250.0, np.linspace(0.0, 40_000.0, 50))) > 0.0).all()


def test_both_aircraft_stay_in_the_papers_envelope():
    assert pytest.approx(39_370.08, abs=0.01) == CEILING_FT
    for aircraft in AIRCRAFT.values():
        assert aircraft.ceiling_ft <= CEILING_FT
        assert aircraft.mach_max <= MACH_MAX


@pytest.mark.parametrize("value", [-0.1, 1.1, float("nan")])
def test_what_lies_outside_is_refused(value):
    with pytest.raises(ConfigError, match=r"x has to lie in 0 \.\. 1, got .*\. Try less"):
        check_between("x", value, 0.0, 1.0, "Try less")
