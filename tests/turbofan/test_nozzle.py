"""The convergent nozzle against the isentropic relations, and its borders."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq

from narxcal.turbofan.gas import gas_constant, jet, specific_heat


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
