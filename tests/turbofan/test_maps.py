"""Map forms: their design point, their shape, and the straight ends that Newton's method needs."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from narxcal.turbofan.maps import (
    BACKBONE,
    SURGE,
    CompressorMap,
    TurbineMap,
    compressor,
    cosine,
    sine,
    stodola,
    turbine_capacity,
    turbine_efficiency,
)

CHART = CompressorMap(30.0, 5.0, 0.85, 2.0, 2.5)
TURBINE = TurbineMap(0.001, 3.0, 0.9, 1.0 / math.sqrt(3e5))
speeds = st.floats(0.2, 1.1)


def test_the_design_point_lies_on_the_backbone():
    assert compressor(CHART, 1.0, BACKBONE) == pytest.approx((30.0, 5.0, 0.85), rel=1e-14)


@given(speeds)
def test_the_backbone_follows_its_powers_of_speed(n):
    flow, ratio, _ = compressor(CHART, n, BACKBONE)
    assert flow == pytest.approx(30.0 * n**2.0, rel=1e-12)
    assert ratio - 1.0 == pytest.approx(4.0 * n**2.5, rel=1e-12)


@given(speeds, st.floats(-2.9, 2.5))
def test_flow_falls_and_pressure_rises_towards_surge_even_beyond_the_ends(n, alpha):
    flow, ratio, _ = compressor(CHART, n, alpha)
    after = compressor(CHART, n, alpha + 0.05)
    assert after[0] < flow
    assert after[1] > ratio or ratio < 0.31  # the least ratio


@given(speeds)
def test_efficiency_of_a_speed_line_is_best_on_the_backbone(n):
    best = compressor(CHART, n, BACKBONE)[2]
    assert best > compressor(CHART, n, 0.1)[2]
    assert best > compressor(CHART, n, SURGE)[2]


@pytest.mark.parametrize("knee", [0.2, SURGE])
def test_the_straight_end_of_the_cosine_joins_smoothly(knee):
    h = 1e-6
    assert cosine(knee - h) == pytest.approx(cosine(knee + h), abs=3e-6)
    slopes = [(cosine(at + h) - cosine(at - h)) / (2 * h) for at in (knee - 1e-3, knee + 1e-3)]
    assert slopes[0] == pytest.approx(slopes[1], abs=2e-3)


@pytest.mark.parametrize("knee", [0.0, 1.35])
def test_the_straight_end_of_the_sine_joins_smoothly(knee):
    h = 1e-6
    assert sine(knee - h) == pytest.approx(sine(knee + h), abs=3e-6)
    slopes = [(sine(at + h) - sine(at - h)) / (2 * h) for at in (knee - 1e-3, knee + 1e-3)]
    assert slopes[0] == pytest.approx(slopes[1], abs=2e-3)


def test_a_turbine_swallows_its_design_flow_and_chokes():
    assert turbine_capacity(TURBINE, 3.0) == pytest.approx(0.001, rel=1e-14)
    assert turbine_capacity(TURBINE, 9.0) < 1.03 * turbine_capacity(TURBINE, 3.0)
    assert turbine_capacity(TURBINE, 1.2) < 0.8 * turbine_capacity(TURBINE, 3.0)


@given(st.floats(1.0, 12.0), st.floats(1.5, 5.0))
def test_capacity_grows_with_the_pressure_ratio(ratio, choking):
    assert stodola(ratio + 0.01, choking) > stodola(ratio, choking) or ratio > 8.0


def test_capacity_joins_its_straight_end_smoothly():
    below, above = stodola(1.01 - 1e-7, 3.0), stodola(1.01 + 1e-7, 3.0)
    assert below == pytest.approx(above, abs=2e-6)


def test_turbine_efficiency_is_best_at_its_velocity_ratio():
    best = turbine_efficiency(TURBINE, 1.0, 3e5)
    assert best == pytest.approx(0.9, rel=1e-12)
    assert turbine_efficiency(TURBINE, 0.6, 3e5) < best
    assert turbine_efficiency(TURBINE, 1.4, 3e5) < best
