"""The intake against the isentropic relations with a constant ratio of specific heats."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from narxcal.turbofan.gas import delta, intake, theta


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


def test_ratios_are_one_on_a_standard_day_at_sea_level():
    assert theta(288.15) == 1.0
    assert delta(101325.0) == 1.0
