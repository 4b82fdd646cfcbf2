"""The atmosphere against the published tables."""

import importlib.util

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from narxcal.atmosphere import (
    FT_M,
    P0_PA,
    T0_K,
    air_at,
    air_state,
    cas_of_mach,
    corrected_scale,
    isa,
    mach_of_cas,
    pressure_altitude,
    static_temperature,
    total_ratios,
)

# ICAO Doc 7488: geopotential altitude m, temperature K, pressure hPa.
ICAO = [
    (-1000.0, 294.650, 1139.29),
    (0.0, 288.150, 1013.25),
    (1000.0, 281.650, 898.745),
    (5000.0, 255.650, 540.199),
    (10000.0, 223.150, 264.363),
    (11000.0, 216.650, 226.320),
    (15000.0, 216.650, 120.446),
    (20000.0, 216.650, 54.7487),
]


@pytest.mark.parametrize(("height", "temperature", "pressure"), ICAO)
def test_standard_values_are_those_of_the_icao_table(height, temperature, pressure):
    found = isa(height / FT_M)
    assert found[0] == pytest.approx(temperature, abs=1e-3)
    assert found[1] == pytest.approx(pressure * 100, rel=2e-5)


def test_flight_level_350_has_the_ratios_of_the_handbooks():
    air = air_state(35000.0)
    assert air.theta == pytest.approx(0.7594, abs=1e-4)
    assert air.delta == pytest.approx(0.2353, abs=1e-4)


def test_all_to_20_km_agrees_with_ambiance():
    if importlib.util.find_spec("ambiance") is None:
        pytest.skip("the peer ambiance is not installed")
    from ambiance import Atmosphere  # noqa: PLC0415

    # ambiance takes geometric altitude.
    height = np.linspace(0, 20000, 201)
    peer = Atmosphere(height * 6356766.0 / (6356766.0 - height))
    temperature, pressure = isa(height / FT_M)
    np.testing.assert_allclose(temperature, peer.temperature, rtol=1e-6)
    np.testing.assert_allclose(pressure, peer.pressure, rtol=1e-5)


def test_pressure_is_continuous_at_the_tropopause_and_held_above_20_km():
    edge = 11000.0 / FT_M
    assert isa(edge - 1e-6)[1] == pytest.approx(isa(edge + 1e-6)[1], rel=1e-9)
    assert isa(70000.0) == isa(20000.0 / FT_M)


def test_at_rest_on_a_standard_day_at_sea_level_all_ratios_are_one():
    air = air_state(0.0)
    assert [air.theta, air.delta, air.theta2, air.delta2] == pytest.approx([1.0] * 4)


def test_total_ratios_at_mach_one_are_those_of_the_flow_tables():
    air = air_state(0.0, 1.0)
    assert air.theta2 == pytest.approx(1.2)
    assert 1.0 / air.delta2 == pytest.approx(0.52828, abs=1e-5)


@given(st.floats(-2000, 60000), st.floats(0, 1.2), st.floats(-60, 60))
def test_a_deviation_shifts_the_temperature_only(alt, mach, shift):
    warm, standard = air_state(alt, mach, shift), air_state(alt, mach)
    assert pytest.approx(shift, abs=1e-9) == warm.T_K - standard.T_K
    assert warm.P2_Pa == standard.P2_Pa
    assert warm.T2_K >= warm.T_K
    assert warm.theta2 * T0_K == pytest.approx(warm.T2_K)
    assert warm.delta2 * P0_PA == pytest.approx(warm.P2_Pa)


def test_inputs_broadcast_and_nan_stays_nan():
    air = air_state(np.array([0.0, np.nan, 30000.0]), 0.5, np.zeros((2, 1)))
    assert air.T_K.shape == air.P_Pa.shape == air.T2_K.shape == air.P2_Pa.shape == (2, 3)
    assert np.isnan(air.delta2[:, 1]).all()
    assert np.isfinite(air.delta2[:, [0, 2]]).all()


@given(alt_ft=st.floats(-1000.0, 80000.0), mach=st.floats(0.0, 0.9), dt_c=st.floats(-40.0, 40.0))
def test_a_single_sample_has_the_air_of_many(alt_ft, mach, dt_c):
    air = air_state(alt_ft, mach, dt_c)
    assert total_ratios(alt_ft, mach, dt_c) == pytest.approx((air.theta2, air.delta2), rel=1e-13)


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


@given(st.floats(0.0, 500.0), st.floats(-1000.0, 45_000.0))
def test_airspeed_and_mach_are_each_others_inverse(cas_kt, alt_ft):
    assert cas_of_mach(mach_of_cas(cas_kt, alt_ft), alt_ft) == pytest.approx(cas_kt, abs=1e-9)


def test_at_sea_level_calibrated_is_true_airspeed():
    speeds = np.array([100.0, 200.0, 400.0])
    np.testing.assert_allclose(mach_of_cas(speeds, 0.0), speeds / 661.4786)


def test_one_airspeed_is_a_higher_mach_higher_up():
    assert (np.diff(mach_of_cas(250.0, np.linspace(0.0, 40_000.0, 50))) > 0.0).all()


def test_air_of_a_matrix_takes_missing_channels_as_zero():
    inputs = np.array([[30.0, 35000.0], [60.0, 0.0]])
    found = air_at(inputs, ("TRA_deg", "ALT_ft"))
    np.testing.assert_array_equal(found.T2_K, air_state([35000.0, 0.0]).T2_K)
    assert air_at(inputs[0], ("TRA_deg", "Mach")).theta2 > 1e8  # a Mach number of 35000


@pytest.mark.parametrize(
    ("name", "value", "corrected"),
    [
        # At Mach 0.8 and FL 350: theta2 = 0.7594 * 1.128, delta2 = 0.2353 * 1.128^3.5.
        ("N1_pct", 80.0, 80.0 / 0.92555),
        ("EGT_C", 500.0, 773.15 / 0.85661),
        ("FF_kgph", 900.0, 900.0 / (0.35868 * 0.92555)),
        ("FN_kN", 12.0, 12.0 / 0.35868),
        ("EPR", 1.4, 1.4),
        ("TRQ_Nm", 3000.0, 3000.0 / 0.35868),
        ("SHP_kW", 600.0, 600.0 / (0.35868 * 0.92555)),
        ("TRQ_pct", 60.0, 60.0),
        ("NP_rpm", 1700.0, 1700.0),
    ],
)
def test_corrected_values_refer_to_sea_level(name, value, corrected):
    scale, offset = corrected_scale(name, air_state(35000.0, 0.8))
    assert (value + offset) / scale == pytest.approx(corrected, rel=2e-4)


@given(st.floats(-70.0, 50.0), st.floats(0.0, 1.0), st.floats(0.5, 1.0))
def test_a_total_probe_is_undone(static_c, mach, recovery):
    total_c = (static_c + 273.15) * (1.0 + 0.2 * recovery * mach**2) - 273.15
    assert static_temperature(total_c, mach, recovery) == pytest.approx(static_c, abs=1e-9)


def test_pressure_altitude_is_the_altitude_at_which_the_atmosphere_has_that_pressure():
    alt_ft = np.array([-1500.0, 0.0, 20000.0, 36089.0, 36090.0, 60000.0])
    found = pressure_altitude(isa(alt_ft)[1] / 1000.0)
    np.testing.assert_allclose(found, alt_ft, atol=1e-6)
    assert np.isnan(pressure_altitude([0.0, -1.0])).all()
