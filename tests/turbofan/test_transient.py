"""The engine in time, against an independent integration of the same equations."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from narxcal.turbofan.cycle import Health, Running
from narxcal.turbofan.gas import intake
from narxcal.turbofan.solve import solve
from narxcal.turbofan.transient import LEAST_FLOW, heat_metal, steps_per_sample, turn_rotors


class FuelRun:
    """Rotors and metal at a fuel schedule, at sea level static, without the control."""

    def __init__(self, bench, n1=0.75):
        self.bench, self.body = bench, bench.body
        self.engine = (bench.machine.path, Health())
        self.air = intake(288.15, 101325.0, 0.0, bench.machine.recovery)
        self.x, s = bench.rest(bench.point(n1=n1))
        self.start = np.array([n1, self.x[5], s.T41, s.T41])
        self.steady = bench.machine.fuel_unit_kgps * self.x[6]

    def fuel(self, t):
        return self.steady * (1.0 + 0.15 * (1.0 - np.cos(t)))

    def stations(self, t, rotors, heat, clearance):
        run = Running(rotors[0], rotors[1], self.fuel(t), 0.0, 0.0, heat, clearance)
        found, good = solve(self.engine, self.air, run, self.x[:5].copy(), np.zeros((5, 5)))
        assert good
        return found

    def stepped(self, end_s, count):
        dt = end_s / count
        metal = np.array([*self.start[2:], 0.0, 0.0])
        first = self.stations(0.0, self.start[:2], 0.0, 0.0)
        inertia = np.array([self.body.inertia1_J, self.body.inertia2_J])
        rates = np.array([first.power1_W, first.power2_W]) / inertia / self.start[:2]
        rotors = np.array([*self.start[:2], *rates])
        for k in range(count):
            s = self.stations(k * dt, rotors, metal[2], metal[3])
            heat_metal(self.body, metal, s, dt)
            turn_rotors(self.body, rotors, s, 1.0, dt)
        return np.array([*rotors[:2], *metal[:2]])

    def heat(self, t, y):
        """Heat flow and stations that agree: the metal cools the gas that heats it."""
        clearance = self.body.clearance_pK * max(y[2] - y[3], 0.0)
        found = 0.0
        for _ in range(60):
            s = self.stations(t, y[:2], found, clearance)
            flow = max(s.W45 / self.body.flow_kgps, LEAST_FLOW)
            before, found = found, self.body.metal_WpK * flow**0.8 * (s.T41 - y[2])
            if abs(found - before) < 1e-9 * s.hpt_W:
                break
        return s, flow

    def rates(self, t, y):
        s, flow = self.heat(t, y)
        return [
            s.power1_W / self.body.inertia1_J / y[0],
            s.power2_W / self.body.inertia2_J / y[1],
            (s.T41 - y[2]) * flow**0.8 / self.body.metal_tau_s,
            (y[2] - y[3]) / self.body.casing_tau_s,
        ]


def test_rotors_and_metal_follow_the_slow_integration_of_scipy(bench):
    run = FuelRun(bench)
    exact = solve_ivp(run.rates, (0.0, 4.0), run.start, "LSODA", rtol=1e-8, atol=1e-9).y[:, -1]
    coarse, fine = run.stepped(4.0, 256), run.stepped(4.0, 1024)
    assert coarse[:2] == pytest.approx(exact[:2], abs=2e-4)  # 0.02 % of speed at 64 Hz
    assert coarse[2:] == pytest.approx(exact[2:], abs=0.3)  # K
    assert np.abs(fine - exact)[2] < 0.5 * np.abs(coarse - exact)[2]
    assert fine[:2] == pytest.approx(exact[:2], abs=6e-5)


def test_rotors_alone_are_stepped_to_second_order(bench):
    """A constant surplus power: energy grows with time, whatever the speed."""
    s = bench.rest(bench.point())[1]._replace(power1_W=1e5, power2_W=0.0)
    inertia = bench.body.inertia1_J
    errors = []
    for count in (20, 40, 80):
        dt = 2.0 / count
        rotors = np.array([0.5, 0.6, 1e5 / inertia / 0.5, 0.0])
        # The rate one step earlier, so that the two-step formula starts to second order.
        rotors[2] = 1e5 / inertia / np.sqrt(0.25 - 2.0 * 1e5 / inertia * dt)
        for _ in range(count):
            turn_rotors(bench.body, rotors, s, 1.0, dt)
        errors.append(abs(rotors[0] - np.sqrt(0.25 + 2.0 * 1e5 * 2.0 / inertia)))
        assert rotors[1] == 0.6
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.25)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.25)


def test_metal_and_casing_follow_their_lags(bench):
    s = bench.rest(bench.point())[1]
    metal = np.array([800.0, 700.0, 0.0, 0.0])
    for _ in range(2000):
        heat_metal(bench.body, metal, s, 0.01)
    flow = s.W45 / bench.body.flow_kgps
    left = np.exp(-20.0 / bench.body.metal_tau_s * flow**0.8)
    assert metal[0] == pytest.approx(s.T41 + (800.0 - s.T41) * left, rel=1e-9)
    assert metal[2] == pytest.approx(bench.body.metal_WpK * flow**0.8 * (s.T41 - metal[0]))
    assert metal[3] == pytest.approx(bench.body.clearance_pK * (metal[0] - metal[1]))
    assert 700.0 < metal[1] < metal[0]


def test_clearances_only_open_while_the_casing_is_the_colder(bench):
    s = bench.rest(bench.point(n1=0.5))[1]
    metal = np.array([600.0, 900.0, 0.0, 0.5])
    heat_metal(bench.body, metal, s, 0.01)
    assert metal[3] == 0.0


@pytest.mark.parametrize(("factor", "weight"), [(1.0, 1.0), (2.0, 3.0)])
def test_inertia_weighs_on_the_way_up_as_asked(bench, factor, weight):
    s = bench.rest(bench.point())[1]._replace(power1_W=2e5, power2_W=-1e5)
    body = bench.body._replace(asymmetry=factor)
    rotors = np.array([0.7, 0.8, 0.0, 0.0])
    turn_rotors(body, rotors, s, weight, 0.01)
    assert rotors[2] == pytest.approx(2e5 / (body.inertia1_J * weight * factor * 0.7))
    assert rotors[3] == pytest.approx(-1e5 / (body.inertia2_J * weight * 0.8))


@pytest.mark.parametrize(
    ("dt", "count"), [(1 / 256, 1), (1 / 64, 1), (1 / 32, 2), (0.1, 7), (0.2, 13)]
)
def test_a_sample_takes_as_many_control_cycles_as_it_needs(dt, count):
    assert steps_per_sample(dt) == count
