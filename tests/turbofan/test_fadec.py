"""The control on a two-spool surrogate: response, limits, hand-overs, similarity."""

import math
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba import njit

from narxcal.atmosphere import air_state
from narxcal.support.compiled import lagged, table_value
from narxcal.turbofan import fadec
from narxcal.turbofan.fadec import FadecParameters, FuelValveParameters, Sensed

DT = 0.015
SEA, HIGH = (0.0, 0.0), (35000.0, 0.78)
PLACES = pytest.mark.parametrize("place", [SEA, HIGH])
N1 = np.linspace(15.0, 110.0, 40)
N2 = 100.0 * (0.38 + 0.62 * (N1 / 100.0) ** 0.75)
FUEL = 0.05 + 0.95 * (N1 / 100.0) ** 2.3
PS3 = 2.5e6 * (0.05 + 0.95 * (N1 / 100.0) ** 1.8)
CORE_S = np.interp(N1, [20.0, 100.0], [0.80, 0.35])
FAN_S = np.interp(N1, [20.0, 100.0], [0.35, 0.22])
REST_S = 0.18  # valve, fuel line, sampling
NO_LIMIT = (math.inf, math.inf)
N1_OUT, N2_OUT, T45_OUT, PS3_OUT, FUEL_OUT, ACTIVE_OUT = range(6)


class Plant(NamedTuple):
    """Corrected steady lines and time constants of the surrogate, and the air it stands in."""

    N1: np.ndarray
    N2: np.ndarray
    fuel: np.ndarray
    Ps3: np.ndarray
    core_s: np.ndarray
    fan_s: np.ndarray
    P2_Pa: float
    T2_K: float


@njit  # no cache: it would keep this file's tuples under the name of one import
def sense(plant, speeds, fuel, command):
    """Gas temperature and pressure answer fuel at once, beyond what the core's speed holds."""
    delta, theta = plant.P2_Pa / 101325.0, plant.T2_K / 288.15
    n1, n2 = speeds
    excess = fuel / table_value(n2, plant.N2, plant.fuel) - 1.0
    hot = (650.0 + 0.052 * n1 * n1 + 350.0 * excess) * theta
    pressure = table_value(n2, plant.N2, plant.Ps3) * (1.0 + 0.2 * excess) * delta
    root = math.sqrt(theta)
    return Sensed(command, n1 * root, n2 * root, hot, pressure, plant.P2_Pa, plant.T2_K)


@njit
def fly(plant, control, valve, states, commands, dt):  # noqa: PLR0917
    """Closed loop from rest: one row of what the engine did (time, 6) per command."""
    state, line, speeds = states
    n1, n2 = speeds
    delta, root = plant.P2_Pa / 101325.0, math.sqrt(plant.T2_K / 288.15)
    burned = line[fadec.BURNED]
    out = np.empty((len(commands), 6))
    for k in range(len(commands)):
        sensed = sense(plant, (n1, n2), burned / (delta * root), commands[k])
        demand, active = fadec.control_step(control, state, sensed, dt)
        out[k] = (sensed.N1_pct, sensed.N2_pct, sensed.T45_K, sensed.Ps3_Pa, demand, float(active))
        burned = fadec.valve_step(valve, line, demand, dt)
        core = table_value(burned / (delta * root), plant.fuel, plant.N2)
        fan = table_value(n2, plant.N2, plant.N1)
        n2 = lagged(n2, core, table_value(n1, plant.N1, plant.core_s) * root / delta, dt)
        n1 = lagged(n1, fan, table_value(n1, plant.N1, plant.fan_s) * root / delta, dt)
    return out


def parameters(limits=NO_LIMIT, accel_margin=0.35, decel_margin=0.35, **others):
    gain, reset, lead = fadec.governor(N1, FUEL, (CORE_S, FAN_S, REST_S))
    accel, decel = (1.0 + accel_margin) * FUEL / PS3, (1.0 - decel_margin) * FUEL / PS3
    topping = (np.array(limits), np.array([0.03, 0.002]), np.array([0.8, 0.7]))
    return FadecParameters(N1, gain, reset, lead, N2, accel, decel, *topping, **others)


class Flight(NamedTuple):
    """A run at one place: what came out, and the place's corrections."""

    rows: np.ndarray
    delta: float
    root: float

    @property
    def n1(self):
        """Corrected N1."""
        return self.rows[:, N1_OUT] / self.root

    @property
    def active(self):
        return self.rows[:, ACTIVE_OUT].astype(int)


def run(commands, control=None, place=SEA, dt=DT, slow=1.0):
    """Fly corrected N1 `commands` (time,) from rest at the first; `slow` stretches the spools."""
    air = air_state(*place)
    delta, root = float(air.delta2), math.sqrt(float(air.theta2))
    plant = Plant(N1, N2, FUEL, PS3, slow * CORE_S, slow * FAN_S, float(air.P2_Pa), float(air.T2_K))
    control = control or parameters()
    start = float(commands[0])
    speeds = start, float(np.interp(start, N1, N2))
    fuel = float(np.interp(start, N1, FUEL))
    state = fadec.steady_control(sense(plant, speeds, fuel, start * root), fuel * delta * root)
    line = fadec.steady_valve(FuelValveParameters(), fuel * delta * root, dt)
    valve = FuelValveParameters()
    rows = fly(plant, control, valve, (state, line, speeds), np.asarray(commands) * root, dt)
    return Flight(rows, delta, root)


def step_at_one_second(start, end, seconds=60.0, dt=DT):
    return np.where(np.arange(round(seconds / dt)) * dt < 1.0, float(start), float(end))


def settling_s(flight, target, share=0.01, dt=DT):
    """Time after the step from which the speed stays within `share` of it."""
    outside = np.abs(flight.n1 - target) > share * abs(target - flight.n1[0])
    return dt * (len(outside) - int(np.argmax(outside[::-1]))) - 1.0


MOVES = [(25, 95), (95, 25), (25, 60), (60, 63), (80, 78), (90, 95), (40, 100)]


@pytest.mark.slow
@PLACES
@pytest.mark.parametrize(("start", "end"), MOVES)
def test_every_move_settles_on_its_command_without_overshoot(start, end, place):
    flight = run(step_at_one_second(start, end), place=place)
    beyond = np.sign(end - start) * (flight.n1 - end)
    assert np.max(beyond) <= 0.002 * abs(end - start)
    assert flight.n1[-1] == pytest.approx(end, abs=1e-4)
    assert flight.active[-1] == fadec.GOVERNOR


@pytest.mark.parametrize(("slow", "share"), [(0.6, 0.0), (0.8, 0.0), (1.2, 0.03), (1.5, 0.11)])
@pytest.mark.parametrize(("start", "end"), MOVES)
def test_an_engine_other_than_the_one_it_was_tuned_for_is_governed_too(start, end, slow, share):
    flight = run(step_at_one_second(start, end), slow=slow)
    beyond = np.sign(end - start) * (flight.n1 - end)
    assert np.max(beyond) <= share * abs(end - start) + 1e-9
    assert flight.n1[-1] == pytest.approx(end, abs=1e-4)


@PLACES
@pytest.mark.parametrize("speed", [25.0, 60.0, 100.0])
def test_what_is_settled_stays_settled(speed, place):
    flight = run(np.full(400, speed), place=place)
    np.testing.assert_allclose(flight.rows, np.tile(flight.rows[0], (400, 1)), rtol=1e-12)
    fuel = float(np.interp(speed, N1, FUEL)) * flight.delta * flight.root
    assert flight.rows[0, FUEL_OUT] == pytest.approx(fuel, rel=1e-15)


@PLACES
def test_a_slam_rides_the_acceleration_schedule_and_a_chop_the_deceleration_schedule(place):
    for start, end, active, margin in (
        (25, 95, fadec.ACCELERATION, 1.35),
        (95, 25, fadec.DECELERATION, 0.65),
    ):
        flight = run(step_at_one_second(start, end), place=place)
        riding = flight.active == active
        assert np.sum(riding) * DT > 1.5
        speed, pressure, fuel = flight.rows[riding][:, [N2_OUT, PS3_OUT, FUEL_OUT]].T
        ratio = np.interp(speed / flight.root, N2, FUEL / PS3) * flight.root
        np.testing.assert_allclose(fuel, margin * ratio * pressure, rtol=1e-9)
        assert np.all(np.isin(flight.active, [fadec.GOVERNOR, active]))


def test_hand_overs_are_bumpless():
    """After a slam begins, fuel moves no faster where limiters change than where one rules."""
    flight = run(step_at_one_second(25, 95), parameters((93.0, 1000.0)))
    change = np.abs(np.diff(flight.rows[:, FUEL_OUT]))
    begun = round(1.0 / DT) + 1
    switches = begun + np.flatnonzero(np.diff(flight.active[begun:]))
    assert len(switches) >= 1
    ruled = np.setdiff1d(np.arange(begun, len(change)), switches)
    assert np.max(change[switches]) <= np.max(change[ruled])


@PLACES
@pytest.mark.parametrize(
    ("which", "limit", "column"),
    [
        (fadec.N2_TOPPING, 93.0, N2_OUT),
        (fadec.T45_TOPPING, 1080.0, T45_OUT),
    ],
)
def test_a_topping_limit_holds_and_lets_go_without_windup(which, limit, column, place):
    commands = step_at_one_second(25, 100, 80.0)
    commands[round(60.0 / DT) :] = 50.0
    root = run(commands[:1], place=place).root
    limits = np.full(2, math.inf)
    limits[which - fadec.N2_TOPPING] = limit = limit * (root, root**2)[column - N2_OUT]
    flight = run(commands, parameters(limits), place)
    assert np.max(flight.rows[:, column]) <= limit * (1.0 + 1e-6)
    held = round(55.0 / DT)
    assert flight.active[held] == which
    assert flight.rows[held, column] == pytest.approx(limit, rel=1e-5)
    # Let go after a minute at the limit it comes down like one that was never held.
    rest = flight.n1[round(60.0 / DT) :]
    fresh = run(np.r_[np.full(2, rest[0]), np.full(len(rest), 50.0)], place=place).n1[2:]
    assert np.max(np.abs(rest - fresh)) < 0.5
    assert np.min(rest) > 50.0 - 0.05


def test_the_least_fuel_holds_the_engine_above_its_command_and_lets_go():
    commands = step_at_one_second(90, 20, 80.0)
    commands[round(60.0 / DT) :] = 60.0
    least = float(np.interp(35.0, N1, FUEL))
    flight = run(commands, parameters(lean_ratio=least / float(np.interp(35.0, N1, PS3))))
    held = round(55.0 / DT)
    assert flight.active[held] == fadec.MINIMUM
    assert flight.n1[held] == pytest.approx(35.0, abs=0.1)
    assert flight.n1[-1] == pytest.approx(60.0, abs=1e-4)
    assert np.max(flight.n1[held:]) < 60.1


def test_a_long_ride_on_the_schedule_winds_nothing_up():
    """An engine that hardly accelerates comes to rest like a quick one, only later."""
    weak = run(step_at_one_second(25, 95, 120.0), parameters(accel_margin=0.08))
    assert np.sum(weak.active == fadec.ACCELERATION) * DT > 10.0
    assert np.max(weak.n1) <= 95.1
    assert weak.n1[-1] == pytest.approx(95.0, abs=1e-4)


def test_margins_set_how_fast_the_engine_goes_each_way():
    def needed(start, end, **margins):
        return settling_s(run(step_at_one_second(start, end), parameters(**margins)), end)

    assert needed(25, 95, accel_margin=0.25) > needed(25, 95) + 0.5
    assert needed(25, 95, decel_margin=0.25) == needed(25, 95)
    assert needed(95, 25, decel_margin=0.25) > needed(95, 25) + 0.3


def test_the_response_at_height_is_slower_than_at_sea_level_and_quicker_than_in_corrected_time():
    _, delta, root = run([50.0], place=HIGH)
    fine = 0.002
    low = settling_s(run(step_at_one_second(60, 62, 12.0, fine), dt=fine), 62.0, dt=fine)
    high = settling_s(run(step_at_one_second(60, 62, 32.0, fine), None, HIGH, fine), 62.0, dt=fine)
    assert 1.1 * low < high < 0.9 * low * root / delta


def test_the_step_hardly_matters():
    coarse = run(step_at_one_second(25, 95, 15.0)).n1
    fine = run(step_at_one_second(25, 95, 15.0, DT / 4), dt=DT / 4).n1[::4]
    assert np.max(np.abs(coarse - fine[: len(coarse)])) < 0.8


@given(st.lists(st.floats(20.0, 100.0), min_size=1, max_size=12), st.sampled_from([SEA, HIGH]))
def test_no_lever_play_breaks_a_limit(targets, place):
    commands = np.repeat(np.r_[targets[0], targets], round(1.5 / DT))
    root = run(commands[:1], place=place).root
    limits = (104.0 * root, 1250.0 * root**2)
    flight = run(commands, parameters(limits), place)
    speed, pressure, fuel = flight.rows[:, [N2_OUT, PS3_OUT, FUEL_OUT]].T
    ratio = np.interp(speed / flight.root, N2, FUEL / PS3) * flight.root * pressure
    assert np.all(fuel <= 1.35 * ratio * (1.0 + 1e-9))
    assert np.all(fuel >= 0.65 * ratio * (1.0 - 1e-9))
    for column, limit in zip((N2_OUT, T45_OUT), limits, strict=True):
        assert np.max(flight.rows[:, column]) <= 1.01 * limit
