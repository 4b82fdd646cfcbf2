"""Gas properties: against tables, and enthalpy and entropy as integrals of the specific heat."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from narxcal.turbofan.gas import (
    LOWER_HEATING_VALUE,
    REFERENCE_K,
    burnt_enthalpy,
    enthalpy,
    entropy,
    gas_constant,
    isentropic_temperature,
    specific_heat,
    temperature_at_enthalpy,
)

temperatures = st.floats(210.0, 1950.0)
ratios = st.floats(0.0, 0.05)


@pytest.mark.parametrize(
    ("temperature", "value"),
    # Dry air, kJ/(kg K): Incropera & DeWitt, Fundamentals of Heat and Mass Transfer, table A.4.
    [(250, 1.006), (300, 1.007), (400, 1.014), (600, 1.051), (800, 1.099), (1000, 1.141)],
)
def test_air_has_the_specific_heat_of_the_tables(temperature, value):
    assert 1e-3 * specific_heat(temperature, 0.0) == pytest.approx(value, rel=4e-3)


def test_air_has_the_enthalpy_and_entropy_of_the_tables():
    # Air as an ideal gas, 300 K to 1000 K: Cengel & Boles, Thermodynamics, table A-17.
    assert enthalpy(1000, 0.0) - enthalpy(300, 0.0) == pytest.approx(
        (1046.04 - 300.19) * 1e3, rel=2e-3
    )
    assert entropy(1000, 0.0) - entropy(300, 0.0) == pytest.approx(
        (2.96770 - 1.70203) * 1e3, rel=2e-3
    )
    # Relative pressures of the same table: 1.3860 at 300 K, 114.0 at 1000 K.
    assert isentropic_temperature(300.0, 0.0, 114.0 / 1.3860) == pytest.approx(1000.0, rel=2e-3)


@given(temperatures, temperatures, ratios)
def test_enthalpy_is_the_integral_of_the_specific_heat(low, high, far):
    found, _ = quad(specific_heat, low, high, args=(far,))
    assert enthalpy(high, far) - enthalpy(low, far) == pytest.approx(found, rel=1e-9, abs=1e-4)


@given(temperatures, temperatures, ratios)
def test_entropy_is_the_integral_of_the_specific_heat_over_temperature(low, high, far):
    found, _ = quad(lambda t: specific_heat(t, far) / t, low, high)
    assert entropy(high, far) - entropy(low, far) == pytest.approx(found, rel=1e-8, abs=1e-7)


@given(temperatures, ratios, st.floats(200.0, 2000.0))
def test_temperature_is_found_back_from_enthalpy_wherever_the_search_starts(t, far, guess):
    assert temperature_at_enthalpy(enthalpy(t, far), far, guess) == pytest.approx(t, rel=1e-11)


@given(st.floats(250.0, 700.0), ratios, st.floats(1.0, 20.0))
def test_an_isentropic_change_is_undone_by_its_inverse(t, far, ratio):
    after = isentropic_temperature(t, far, ratio)
    rise = gas_constant(far) * math.log(ratio)
    assert entropy(after, far) - entropy(t, far) == pytest.approx(rise, abs=1e-6)
    assert isentropic_temperature(after, far, 1.0 / ratio) == pytest.approx(t, rel=1e-11)


@given(temperatures, ratios, st.floats(0.1, 10.0))
def test_mixing_keeps_enthalpy_linear_in_the_masses(t, far, air):
    # A kilogram of air with `far` of fuel, diluted by `air` kilograms at the same temperature.
    mixed = (1.0 + far + air) * enthalpy(t, far / (1.0 + air))
    parts = (1.0 + far) * enthalpy(t, far) + air * enthalpy(t, 0.0)
    assert mixed == pytest.approx(parts, rel=1e-12)


@given(st.floats(300.0, 900.0), st.floats(0.001, 0.035))
def test_burning_releases_the_heating_value_at_the_reference_temperature(t3, far):
    h4 = burnt_enthalpy(enthalpy(t3, 0.0), far, 1.0)
    released = (1.0 + far) * (h4 - enthalpy(REFERENCE_K, far))
    released -= enthalpy(t3, 0.0) - enthalpy(REFERENCE_K, 0.0)
    assert released == pytest.approx(far * LOWER_HEATING_VALUE, rel=1e-9)


def test_air_leaves_the_burner_as_hot_as_the_charts_say():
    # About 700 K of rise from 800 K at a ratio of 0.02: Saravanamuttoo et al., figure 2.17.
    h4 = burnt_enthalpy(enthalpy(800.0, 0.0), 0.02, 1.0)
    assert temperature_at_enthalpy(h4, 0.02, 1200.0) == pytest.approx(1500.0, abs=25.0)
