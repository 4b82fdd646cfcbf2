"""Gas properties against tables and integrals; intake and nozzle against isentropic relations."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.optimize import brentq

from narxcal.turbofan.gas import (
    LOWER_HEATING_VALUE,
    REFERENCE_K,
    burnt_enthalpy,
    enthalpy,
    entropy,
    gas_constant,
    intake,
    isentropic_temperature,
    jet,
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


# Intake


def test_at_rest_only_the_recovery_is_lost():
    _, _, velocity, total_K, total_Pa = intake(288.15, 101325.0, 0.0, 0.99)
    assert total_K == pytest.approx(288.15, rel=1e-12)
    assert total_Pa == pytest.approx(0.99 * 101325.0, rel=1e-12)
    assert velocity == 0.0


@given(st.floats(210.0, 310.0), st.floats(0.0, 0.85))
def test_ram_rise_is_that_of_air_at_gamma_1_4(static_K, mach):
    _, _, velocity, total_K, total_Pa = intake(static_K, 5e4, mach, 1.0)
    assert total_K == pytest.approx(static_K * (1 + 0.2 * mach**2), rel=5e-4)
    assert total_Pa == pytest.approx(5e4 * (1 + 0.2 * mach**2) ** 3.5, rel=2e-3)
    assert velocity == pytest.approx(mach * (1.4 * 287.05 * static_K) ** 0.5, rel=2e-3)


# Nozzle


def gamma_at(total_K):
    cp = specific_heat(total_K, 0.0)
    return cp / (cp - gas_constant(0.0))


@given(st.floats(250.0, 900.0), st.floats(1.01, 1.7))
def test_unchoked_flow_fulfils_the_isentropic_relations(total_K, ratio):
    g, r = gamma_at(total_K), gas_constant(0.0)
    mach = brentq(lambda m: (1 + 0.5 * (g - 1) * m * m) ** (g / (g - 1)) - ratio, 0.0, 1.0)
    static = total_K / (1 + 0.5 * (g - 1) * mach * mach)
    found = jet(total_K, 0.0, ratio)
    velocity = mach * math.sqrt(g * r * static)
    assert found.velocity_mps == pytest.approx(velocity, rel=1e-9)
    # W sqrt(T) / (P A) with the density at the exit, whose pressure is the ambient one.
    density_per_pressure = 1.0 / (ratio * r * static)
    assert found.capacity == pytest.approx(
        density_per_pressure * velocity * math.sqrt(total_K), rel=1e-9
    )
    assert found.pressure_thrust == pytest.approx(0.0, abs=1e-12)


@given(st.floats(250.0, 900.0), st.floats(2.0, 12.0))
def test_a_choked_nozzle_keeps_its_capacity_and_gains_pressure_thrust(total_K, ratio):
    g = gamma_at(total_K)
    critical = (0.5 * (g + 1)) ** (g / (g - 1))
    found, at_critical = jet(total_K, 0.0, ratio), jet(total_K, 0.0, critical)
    assert found.capacity == pytest.approx(at_critical.capacity, rel=1e-12)
    assert found.velocity_mps == pytest.approx(at_critical.velocity_mps, rel=1e-12)
    assert found.pressure_thrust == pytest.approx(1 / critical - 1 / ratio, rel=1e-12)


def test_air_chokes_at_the_textbook_ratio():
    # gamma = 1.4: critical ratio 1.893, W sqrt(T) / (P A) = 0.0404 (any text on gas dynamics).
    assert jet(288.15, 0.0, 1.893).pressure_thrust == pytest.approx(0.0, abs=1e-3)
    assert jet(288.15, 0.0, 3.0).capacity == pytest.approx(0.0404, rel=3e-3)


def test_flow_vanishes_with_the_pressure_ratio_and_turns_round_below_one():
    assert jet(300.0, 0.0, 1.0).capacity == pytest.approx(0.0, abs=1e-12)
    assert jet(300.0, 0.0, 0.9998).capacity < 0.0
    knee = jet(300.0, 0.0, 1.0005).capacity
    assert jet(300.0, 0.0, 1.0005 - 1e-9).capacity == pytest.approx(knee, rel=1e-5)
