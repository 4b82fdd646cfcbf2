"""The gas path keeps mass and energy at every point, and is its own image at another altitude."""

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from narxcal.turbofan.cycle import Health, Running, handling_bleed, reynolds_factor
from narxcal.turbofan.gas import LOWER_HEATING_VALUE, REFERENCE_K, Air, enthalpy, intake
from narxcal.turbofan.lever import n1_command
from narxcal.turbofan.solve import BLEED, MACH, N1, OFFTAKE_W, STATIC_K, STATIC_PA, solve

inputs = st.tuples(
    st.one_of(st.just(0.0), st.floats(0.0, 85.0)),
    st.floats(0.0, 12000.0 / 0.3048),
    st.floats(0.0, 0.85),
    st.floats(-30.0, 20.0),
    *[st.sampled_from([0.0, 1.0])] * 5,
)


def heat(temperature, far):
    """Enthalpy above the temperature at which the heating value is stated."""
    return enthalpy(temperature, far) - enthalpy(REFERENCE_K, far)


def imbalances(path, air, run, s):
    """Mass in less out over the air flow, and energy in less out over the heat of the fuel."""
    bleed, handling = run.bleed * s.W25, s.W21 - s.W25
    mass = s.W2 + run.fuel_kgps - (s.W13 + s.W45 + bleed + handling)
    supplied = path.burner_efficiency * run.fuel_kgps * LOWER_HEATING_VALUE
    inflow = s.W2 * heat(air.T2_K, 0.0) + supplied
    jets = s.W13 * heat(s.T13, 0.0) + s.W45 * heat(s.T5, s.far45)
    taken = bleed * heat(s.T3, 0.0) + handling * heat(s.T21, 0.0) + run.offtake_W + run.soak_W
    friction = (1.0 - path.mechanical_efficiency) * (s.hpt_W + s.lpt_W)
    spinning = s.power1_W + s.power2_W
    return mass / s.W2, (inflow - jets - taken - friction - spinning) / supplied


@example((85.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0))
@example((0.0, 39370.0, 0.85, 20.0, 0.0, 1.0, 1.0, 1.0, 1.0))
@given(inputs)
def test_mass_and_energy_are_kept_at_rest_all_over_the_envelope(bench, u):
    row = np.array([u])
    condition = bench.engine._conditions(row, n1_command(bench.engine.settings.ratings, row))[0]
    x, s = bench.settled(condition)
    air = intake(condition[STATIC_K], condition[STATIC_PA], condition[MACH], bench.machine.recovery)
    fuel = bench.machine.fuel_unit_kgps * x[6]
    run = Running(condition[N1], x[5], fuel, condition[BLEED], condition[OFFTAKE_W], 0.0, 0.0)
    mass, energy = imbalances(bench.machine.path, air, run, s)
    assert abs(mass) < 1e-8
    assert abs(energy) < 1e-8
    assert abs(s.power1_W) + abs(s.power2_W) < 1e-9 * s.hpt_W


@given(st.floats(0.4, 1.05), st.floats(0.8, 1.5), st.floats(-0.06, 0.06), st.floats(0.0, 0.02))
def test_mass_and_energy_are_kept_in_a_transient_with_hot_metal(bench, n1, more, soak, clearance):
    x, s = bench.rest(bench.point(n1=n1, bleed=0.05, offtake_W=2e4))
    air = intake(288.15, 101325.0, 0.0, bench.machine.recovery)
    fuel = more * bench.machine.fuel_unit_kgps * x[6]
    run = Running(n1, x[5], fuel, 0.05, 2e4, soak * s.hpt_W, clearance)
    after, good = solve((bench.machine.path, Health()), air, run, x[:5].copy(), np.zeros((5, 5)))
    assume(good)
    mass, energy = imbalances(bench.machine.path, air, run, after)
    assert abs(mass) < 1e-8
    assert abs(energy) < 1e-8
    assert (after.power2_W > 0.0) == (more > 1.0) or abs(more - 1.0) < 0.1


@pytest.mark.parametrize("corrected", [0.5, 0.8, 1.0])
@pytest.mark.parametrize("mach", [0.0, 0.6])
def test_corrected_performance_does_not_depend_on_altitude(bench, corrected, mach):
    """Without Reynolds effect, bleed and off-take an altitude with the temperature of sea level
    differs in pressure alone, and all flows and forces go with it."""
    path = bench.machine.path._replace(reynolds_loss=0.0)
    machine = bench.machine._replace(path=path)
    low = bench.rest(bench.point(0.0, mach, 0.0, corrected), machine)
    far_up = bench.point(30000.0, mach, 0.0, corrected).condition()
    far_up[STATIC_K] = 288.15
    x, s = bench.settled(far_up, machine)
    pressure = far_up[STATIC_PA] / 101325.0
    assert x[:6] == pytest.approx(low[0][:6], rel=1e-6)
    assert x[6] == pytest.approx(low[0][6] * pressure, rel=1e-6)
    for name in ("W2", "W45", "P3", "P5", "net_N", "gross_N", "hpt_W"):
        assert getattr(s, name) == pytest.approx(getattr(low[1], name) * pressure, rel=1e-6)
    assert pytest.approx(low[1].T45, rel=1e-6) == s.T45


def test_thin_air_costs_efficiency_and_dense_air_gains_none():
    standard = Air(288.15, 101325.0, 0.0, 288.15, 101325.0)
    assert reynolds_factor(0.012, standard) == 1.0
    assert reynolds_factor(0.012, standard._replace(P2_Pa=2e5)) == 1.0
    assert reynolds_factor(0.012, standard._replace(P2_Pa=0.0)) == pytest.approx(0.988)


def test_handling_bleed_opens_smoothly_as_the_core_slows_down(bench):
    path = bench.machine.path._replace(handling_bleed=0.2, handling_shut=0.8)
    speeds = np.linspace(0.3, 1.1, 801)
    share = np.array([handling_bleed(path, n) for n in speeds])
    assert np.all(np.diff(share) <= 0.0)
    assert np.all(np.abs(np.diff(share)) < 2e-3)
    assert share[speeds < 0.48] == pytest.approx(0.2)
    assert np.all(share[speeds > 0.8] == 0.0)


def test_every_station_is_where_it_belongs(bench):
    _, s = bench.rest(bench.point())
    assert s.T21 < s.T3 < s.T45 < s.T41 < s.T4
    assert s.P3 > s.P45 > s.P5 > 101325.0
    assert pytest.approx(s.W13 + s.W21, rel=1e-14) == s.W2
