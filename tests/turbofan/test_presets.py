"""The two engines against published figures of their class."""

import numpy as np
import pytest

from narxcal.support.errors import ConfigError
from narxcal.turbofan.design import PRESETS, preset

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


def test_presets_go_by_their_names():
    assert all(preset(name).name == name for name in PRESETS)


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
