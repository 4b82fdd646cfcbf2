"""The design point closes: what was asked for is what the off-design solution finds there."""

from dataclasses import replace

import numpy as np
import pytest

from narxcal.turbofan.cycle import Health, Running, gas_path
from narxcal.turbofan.design import close, preset
from narxcal.turbofan.gas import intake


def at_design(bench):
    chosen = preset(bench.name)
    closed = close(chosen.point, chosen.shape)
    air = intake(288.15, 101325.0, 0.0, chosen.point.recovery)
    run = Running(1.0, 1.0, closed.fuel_kgps, 0.0, 0.0, 0.0, 0.0)
    residual = np.empty(5)
    s = gas_path((closed.path, Health()), air, run, np.array(closed.positions), residual)
    return chosen.point, air, residual, s


def test_all_flows_and_powers_balance_at_the_design_point(bench):
    _, _, residual, s = at_design(bench)
    assert np.abs(residual).max() < 1e-10
    assert abs(s.power1_W) < 1e-10 * s.hpt_W
    assert abs(s.power2_W) < 1e-10 * s.hpt_W


def test_what_was_asked_for_is_there(bench):
    point, air, _, s = at_design(bench)
    assert pytest.approx(point.flow_kgps, rel=1e-10) == s.W2
    assert pytest.approx(point.bypass_ratio, rel=1e-10) == s.W13 / s.W21
    assert pytest.approx(point.T4_K, rel=1e-10) == s.T4
    assert s.P13 / air.P2_Pa == pytest.approx(point.fan_pressure_ratio, rel=1e-10)
    overall = point.lpc_pressure_ratio * point.hpc_pressure_ratio
    assert s.P3 / air.P2_Pa == pytest.approx(overall, rel=1e-10)


def test_the_settled_engine_finds_its_design_point(bench):
    x, s = bench.rest(bench.point())
    _, _, _, design = at_design(bench)
    assert x == pytest.approx([*bench.core.closed.positions, 1.0, 1.0], rel=1e-8)
    assert s.net_N == pytest.approx(design.net_N, rel=1e-8)


def test_a_point_whose_turbines_cannot_drive_it_is_refused():
    chosen = preset("business_jet")
    with pytest.raises(ValueError, match="sign"):
        close(replace(chosen.point, hpt_efficiency=0.05), chosen.shape)
