"""The two-spool grey box against its equations written out, at rest, and in its limits."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from narxcal.effects.base import Pace, as_simulated
from narxcal.two_spool import (
    DAMP,
    DOWN,
    FAN,
    GAIN,
    HOLDS_RATE,
    LINE,
    PUSH,
    RESET,
    SIZE,
    UP,
    VALVE,
    TwoSpool,
    soft,
)

DT = 0.125
STEPS = 2  # inside one raster interval of 0.125 s


def coefficients():
    theta = np.zeros(SIZE)
    theta[GAIN : GAIN + 4] = np.log(1.5), 0.3, 0.2, 0.4
    theta[DAMP : DAMP + 3] = 0.8, -0.2, 0.1
    theta[UP : UP + 5] = np.log(4.0), 0.5, 1.0, -0.3, -0.8
    theta[DOWN : DOWN + 5] = np.log(6.0), 0.2, 0.8, 0.2, 0.5
    theta[FAN : FAN + 4] = np.log(0.9), -0.3, -0.4, 0.5
    theta[LINE : LINE + 4] = 1.4, 0.8, 0.1, -0.2
    theta[VALVE], theta[PUSH], theta[RESET] = np.log(0.2), 0.4, 0.3
    return theta


THERMAL = np.array(
    [
        [8.0, -2.0, 0.7, 1.0, 12.0, 3.0, -1.0, 0.5, 0.9],
        [10.0, 5.0, 0.0, 0.0, 20.0, 0.0, 0.0, 0.0, 0.3],
    ]
)


def engine(governed=0, theta=None):
    return TwoSpool(coefficients() if theta is None else theta, THERMAL, 50.0, 45.0, governed, DT)


def flown(steps=200, seed=0):
    """Settled values that jump every few seconds, with their air and first row."""
    random = np.random.default_rng(seed)
    power = np.repeat(random.uniform(0.0, 1.0, steps // 25 + 1), 25)[:steps]
    steady = np.stack(
        [25 + 70 * power, 52 + 42 * power, 350 + 400 * power, 150 + 900 * power], axis=-1
    )
    none = np.zeros((1, steps))
    return steady[None], none - 0.4, none, steady[None, 0]


def pace_of(**changed):
    return np.stack([np.full(1, value) for value in as_simulated(1)._replace(**changed)], axis=1)


def line(values, x, air):
    return values[0] + values[1] * x + values[2] * air


def cubic(flat, slope, bend, n2):
    """A curve over core speed whose slope at its share x of the range is a parabola in x."""
    x = np.clip((n2 - 50.0) / 45.0, -0.2, 1.2)
    return 45.0 * (flat * x + slope * x**2 / 2.0 + bend * x**3 / 3.0)


def written_out(steady, air, pace, governed, load):
    """The equations of the module's docstring, one state at a time."""
    t, h = coefficients(), DT / STEPS
    n1, n2, *flows = steady[0]
    p = v = r = 0.0
    blades = metal = flows[0]
    found = [[n1, n2, *flows]]
    for k in range(len(steady) - 1):
        for i in range(STEPS):
            s = steady[k] + i / STEPS * (steady[k + 1] - steady[k])
            x = min(max((n2 - 50.0) / 45.0, -0.2), 1.2)
            thin = np.exp(air) ** pace.thin_air[0]
            z = min(max((s[1] - 50.0) / 45.0, -0.2), 1.2)
            fan = t[LINE] + t[LINE + 2] * air, t[LINE + 1], t[LINE + 3]
            behind = s[0] + cubic(*fan, n2) - cubic(*fan, s[1]) - n1
            taken = pace.loss[0] * np.exp(air) * (1.0 + x) / 2.0 * (blades - metal)
            w = behind + t[PUSH] * (p - taken)
            dn1 = w * np.exp(t[FAN + 3] * w / 45.0) / np.exp(line(t[FAN:], x, air))
            dn1 *= thin * (pace.fan_up[0] if dn1 > 0 else pace.fan_down[0])
            spare = p - taken
            dn2 = spare * thin * (pace.core_up[0] if spare > 0 else pace.core_down[0])
            error = s[governed % 2] - (n1, n2)[governed % 2]
            gain = np.exp(line(t[GAIN:], x, air) + t[GAIN + 3] * (z - x))
            q = gain * (error + r) - line(t[DAMP:], x, air) * dn1
            up, down = (
                np.exp(line(t[at:], x, air) + t[at + 3] * x**2 + t[at + 4] * behind / 45.0)
                for at in (UP, DOWN)
            )
            up, down = up * pace.limit[0], down * pace.fall[0]
            if governed < HOLDS_RATE:
                own = load * np.exp(air) * (1.0 + x) / 2.0
                up, down = max(up - own, 0.05 * up), max(down + own, 0.05 * down)
            held = 1.0 + (q / (up if q > 0 else down)) ** 4
            r, q = r + h * t[RESET] ** 2 * error / held, q / held**0.25
            if governed >= HOLDS_RATE:
                q /= thin * (pace.core_up[0] if q > 0 else pace.core_down[0])
                q += taken
            q -= pace.valve_s[0] * dn2 / pace.core_s[0]
            v = q + np.exp(-h / max(pace.valve_s[0], 1e-9)) * (v - q)
            for j, own in enumerate(THERMAL):
                curve = own[0] + own[3] * air, own[1], own[2]
                to = s[2 + j] + cubic(*curve, n2) - cubic(*curve, s[1])
                to += (own[4] + own[5] * x + own[6] * x**2 + own[7] * air) * p
                flows[j] = to + np.exp(-h / own[8]) * (flows[j] - to)
            blades = flows[0] + np.exp(-h / pace.rise_s[0]) * (blades - flows[0])
            metal = flows[0] + np.exp(-h / pace.metal_s[0]) * (metal - flows[0])
            p = v + np.exp(-h / 0.2) * (p - v)
            n1, n2 = n1 + h * dn1, n2 + h * dn2
        found.append([n1, n2, *flows])
    return np.array(found)


@pytest.mark.parametrize("load", [0.0, 1.5, -1.5])
@pytest.mark.parametrize("governed", [0, 1, HOLDS_RATE, HOLDS_RATE + 1])
@pytest.mark.parametrize(
    "changed",
    [
        {},
        {"fan_up": 0.7, "fan_down": 1.2, "core_up": 0.8, "core_down": 0.9},
        {"thin_air": 0.6, "limit": 0.5},
        {"fall": 0.6},
        {"valve_s": 0.7, "core_s": 1.5},
        {"loss": 0.02, "metal_s": 6.0, "rise_s": 0.4},
    ],
)
def test_it_is_its_equations(governed, changed, load):
    steady, air, none, start = flown()
    pace = Pace(
        *(
            np.full(1, v[0])
            for v in as_simulated(1)._replace(**{k: np.array([v]) for k, v in changed.items()})
        )
    )
    found = engine(governed).free_run(
        (steady, air, none + load, start), np.zeros(1, dtype=int), np.stack(pace, axis=1), 2
    )
    said = written_out(steady[0], -0.4, pace, governed, load)
    np.testing.assert_allclose(found[0], said, atol=1e-9)


def test_at_rest_it_stays_at_rest():
    steady = np.repeat(flown()[0][:, :1], 100, axis=1)
    none = np.zeros((1, 100))
    given_ = (steady, none, none, steady[:, 0])
    found = engine().free_run(given_, np.zeros(1, dtype=int), pace_of())
    np.testing.assert_allclose(found, steady, atol=1e-12)


@given(st.floats(0.5, 3.0), st.floats(-1.0, 0.0))
def test_it_comes_to_rest_where_it_is_asked_whatever_its_rotors_weigh(factor, air):
    steady = np.repeat(flown()[0][:, 30:31], 800, axis=1)
    start = steady[:, 0] - np.array([[20.0, 12.0, 100.0, 200.0]])
    slower = dict.fromkeys(("fan_up", "fan_down", "core_up", "core_down"), 1.0 / factor)
    found = engine().free_run(
        (steady, np.full((1, 800), air), np.zeros((1, 800)), start),
        np.zeros(1, dtype=int),
        pace_of(**slower),
    )
    np.testing.assert_allclose(found[0, -1], steady[0, -1], atol=0.3)


def test_a_control_that_holds_acceleration_makes_up_for_a_heavier_core():
    """The core comes as simulated, on so much more fuel; the fan trails as it would anyway."""
    given_ = flown()
    heavier = pace_of(core_up=0.5, core_down=0.5)
    one = np.zeros(1, dtype=int)
    quick = coefficients()
    quick[VALVE], quick[PUSH] = np.log(0.05), 0.0
    alike, held, free = (
        engine(kind, quick).free_run(given_, one, pace)[0]
        for kind, pace in ((1, pace_of()), (HOLDS_RATE + 1, heavier), (1, heavier))
    )
    np.testing.assert_allclose(held[:, 1], alike[:, 1], atol=0.05)
    assert np.abs(free[:, 1] - alike[:, 1]).max() > 2.0
    fuel = [np.abs(np.gradient(run[:, 3], DT)).max() for run in (alike, held)]
    assert fuel[1] > 1.1 * fuel[0]


HEATED = {"loss": 0.02, "metal_s": 8.0, "rise_s": 0.0}


def test_heat_that_metal_takes_slows_a_slam_and_costs_fuel_until_it_is_warm():
    """Once the core has come, fuel brings what the metal takes; in the end there is no trace."""
    steady = np.repeat(flown()[0][:, 30:31], 1200, axis=1)
    start = steady[:, 0] - np.array([[40.0, 25.0, 250.0, 600.0]])
    given_ = (steady, np.zeros((1, 1200)), np.zeros((1, 1200)), start)
    dry, heated = (
        engine(1).free_run(given_, np.zeros(1, dtype=int), pace, 2)[0]
        for pace in (pace_of(), pace_of(**HEATED))
    )
    assert (heated[8:40, 1] < dry[8:40, 1] - 0.2).all()
    assert (heated[80:160, 3] > dry[80:160, 3] + 1.0).all()
    np.testing.assert_allclose(heated[-1], dry[-1], atol=0.02)


def test_a_control_that_holds_acceleration_brings_what_the_metal_takes():
    given_, one = flown(), np.zeros(1, dtype=int)
    quick = coefficients()
    quick[VALVE], quick[PUSH] = np.log(0.05), 0.0
    alike, held, free = (
        engine(kind, quick).free_run(given_, one, pace, 2)[0]
        for kind, pace in (
            (1, pace_of()),
            (HOLDS_RATE + 1, pace_of(**HEATED)),
            (1, pace_of(**HEATED)),
        )
    )
    assert np.abs(held[:, 1] - alike[:, 1]).max() < 0.1 * np.abs(free[:, 1] - alike[:, 1]).max()


def slam(steps=600):
    """From idle to where the settled values are, and what holds there (blocks of one)."""
    steady = np.repeat(flown()[0][:, 30:31], steps, axis=1)
    start = steady[:, 0] - np.array([[40.0, 25.0, 250.0, 600.0]])
    return steady, np.zeros((1, steps)), start


@given(st.floats(0.3, 3.0))
def test_a_load_makes_slams_longer_and_chops_shorter_and_shifts_nothing(load):
    """What holds the speeds brings what a load takes: at rest there is no trace of it."""
    (steady, none, up), one = slam(), np.zeros(1, dtype=int)
    down = 2.0 * steady[:, 0] - up
    for start, sign in ((up, -1.0), (down, -1.0)):
        free, loaded = (
            engine().free_run((steady, none, none + size, start), one, pace_of())[0]
            for size in (0.0, load)
        )
        moving = slice(4, 12)
        assert (sign * (loaded - free)[moving, 1] > 0.0).all()
        np.testing.assert_allclose(loaded[-1], free[-1], atol=0.02)


def test_what_a_load_takes_is_so_much_acceleration():
    """Far behind, the core comes by its limit less the load, in thin air so much less."""
    steady, none, start = slam(16)
    one, theta = np.zeros(1, dtype=int), coefficients()
    theta[UP : UP + 5], theta[VALVE] = (np.log(4.0), 0.0, 0.0, 0.0, 0.0), np.log(0.05)
    for air in (0.0, -0.7):
        came = [
            engine(1, theta).free_run((steady, none + air, none + load, start), one, pace_of())[0]
            for load in (0.0, 1.0)
        ]
        lost = (came[0][-1, 1] - came[1][-1, 1]) / (15 * DT)
        x = (came[1][:, 1].mean() - 50.0) / 45.0
        assert lost == pytest.approx(np.exp(air) * (1.0 + x) / 2.0, rel=0.15)


def test_a_control_that_holds_acceleration_brings_what_a_load_takes():
    (steady, none, start), one = slam(), np.zeros(1, dtype=int)
    runs = [
        engine(HOLDS_RATE).free_run((steady, none, none + load, start), one, pace_of())
        for load in (0.0, 2.0)
    ]
    np.testing.assert_array_equal(*runs)


def test_no_load_is_more_than_a_limit_has():
    (steady, none, start), one = slam(100), np.zeros(1, dtype=int)
    found = engine().free_run((steady, none, none + 1e3, start), one, pace_of())[0]
    assert (np.diff(found[:, 1]) > -1e-9).all()
    assert found[-1, 1] > start[0, 1] + 1.0


def test_the_reset_waits_while_a_limit_holds():
    """Behind a limit the whole way, a slam is as far with a reset as without one."""
    steady = np.repeat(flown()[0][:, 30:31], 60, axis=1)
    start = steady[:, 0] - np.array([[60.0, 30.0, 300.0, 600.0]])
    low = coefficients()
    low[UP], low[RESET] = np.log(1.0), 0.0
    high = low.copy()
    high[RESET] = 0.5
    far = [
        engine(1, theta).free_run(
            (steady, np.zeros((1, 60)), np.zeros((1, 60)), start), np.zeros(1, dtype=int), pace_of()
        )
        for theta in (low, high)
    ]
    np.testing.assert_allclose(far[1], far[0], atol=0.05)
    assert (far[0][0, -1, :2] < steady[0, -1, :2] - 10.0).all()


def test_many_rows_are_each_alone():
    one, two = flown(seed=1), flown(seed=2)
    both = tuple(np.concatenate(pair) for pair in zip(one, two, strict=True))
    which = np.array([1, 0, 1])
    both = (*both[:3], both[3][which])
    paces = np.concatenate([pace_of(), pace_of(limit=0.6), pace_of(thin_air=0.5)])
    found = engine().free_run(both, which, paces)
    for row, (block, pace) in enumerate(zip([two, one, two], paces, strict=True)):
        alone = engine().free_run(block, np.zeros(1, dtype=int), pace[None])
        np.testing.assert_array_equal(found[row], alone[0])


@given(st.floats(-100, 100), st.floats(0.1, 20))
def test_a_soft_limit_passes_what_is_small_and_never_more_than_the_limit(demand, limit):
    found = soft(demand, limit)
    assert abs(found) <= min(abs(demand), limit) * (1 + 1e-12)
    assert found * demand >= 0.0
    if abs(demand) < 0.3 * limit:
        assert abs(found - demand) <= 0.01 * abs(demand)
