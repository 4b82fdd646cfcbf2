"""The design point closes: what was asked for is what the off-design solution finds there."""

from dataclasses import replace

import numpy as np
import pytest

from narxcal.support.errors import ConfigError
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


# Presets against published figures of their class

# ICAO emissions databank, as OpenAP 2.6.2 carries it: rated thrust in kN, overall pressure ratio,
# fuel flow in kg/s at 100, 85, 30 and 7 % of the rated thrust; JT15D-4 and CFM56-5B4/3.
DATABANK = {
    "business_jet": (11.12, 10.1, (0.1697, 0.143, 0.059, 0.0261)),
    "single_aisle": (120.1, 27.3, (1.142, 0.939, 0.316, 0.102)),
}


def test_an_unknown_engine_is_refused_with_those_there_are():
    with pytest.raises(
        ConfigError, match=r"unknown engine 'jumbo'\. Known engines: business_jet, single_aisle"
    ):
        preset("jumbo")


def test_thrust_and_pressure_ratio_are_those_of_the_class(bench):
    thrust, ratio, _ = DATABANK[bench.name]
    _, s = bench.rest(bench.point())
    assert 1e-3 * s.net_N == pytest.approx(thrust, rel=0.005)
    assert s.P3 / (101325.0 * bench.machine.recovery) == pytest.approx(ratio, rel=0.01)


def test_fuel_flows_of_the_landing_and_take_off_cycle_are_those_of_the_class(bench):
    _, _, published = DATABANK[bench.name]
    found = [bench.rest(bench.point(n1=n)) for n in np.linspace(0.2, 1.0, 60)]
    thrust = np.array([s.net_N for _, s in found])
    fuel = bench.machine.fuel_unit_kgps * np.array([x[6] for x, _ in found])
    ours = np.interp(np.array([1.0, 0.85, 0.3, 0.07]) * thrust[-1], thrust, fuel)
    assert ours == pytest.approx(published, rel=0.03)
