"""Lags behind a control that holds N1: a slow twin, what the control does, what must not matter."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from narxcal.atmosphere import air_state
from narxcal.calibration.register import Parts, Register, Sample
from narxcal.lumped.engine import LumpedEngine, shapes_of
from narxcal.lumped.governed import LINES, inner_steps
from narxcal.lumped.limited import LIMITED
from narxcal.lumped.states import ROWS
from narxcal.narx.config import NarxConfig
from narxcal.narx.module import NarxNet
from narxcal.narx.network import NarxModel, Scaling
from narxcal.support.errors import ModelError
from training.dynamics.lag_priors import Form, start_engine

NAMES, INPUTS = ("N1_pct", "N2_pct", "EGT_C"), ("ALT_ft", "Mach", "dT_C")
CENTRE, HALF = np.array([62.0, 75.0, 520.0]), np.array([35.0, 20.0, 240.0])
DT_S = 0.1


def lags(seed=None, limit=1000.0):
    """The lags that a fit starts from, or such that are drawn about them."""
    scales = {"centre": CENTRE, "half": HALF, "limit": np.full(3, limit)}
    engine, _ = start_engine(NAMES, Form(governed=True), scales)
    if seed is not None:
        engine.theta[:] += np.random.default_rng(seed).normal(scale=0.2, size=len(engine.theta))
    return engine


def steps_of(levels, hold_s=20.0, dt_s=DT_S, air=(0.0, 0.0, 0.0)):
    """Inputs and steady-state values that step from level to level, each held."""
    part = np.repeat(np.asarray(levels, dtype=float), round(hold_s / dt_s))
    return np.tile(air, (len(part), 1)), CENTRE + HALF * part[:, None]


def run(model, inputs, ss, start=(0.0, 0.0, 0.0), dt_s=DT_S):
    return model.deviations(model.drive(inputs, INPUTS, ss), np.array(start), dt_s)


def solved(rows):
    matrix, right = zip(*rows, strict=True)
    return np.linalg.solve(np.array(matrix), np.array(right))


class Slowly:
    """The module's equations one by one, in plain words, for N1, N2 and EGT in this order."""

    def __init__(self, model, inputs, ss):
        self.model, self.inputs, self.ss = model, inputs, ss
        air = air_state(*inputs.T)
        self.root = np.sqrt(air.theta2)
        self.thin, self.hot = np.log(self.root / air.delta2), np.log(self.root)
        self.target = (ss / self.root[:, None] - CENTRE) / HALF
        self.named = dict(zip((*LINES, "probe_s", "push_T"), model.arrays["lines"], strict=True))
        self.soak, self.h = np.zeros(3), DT_S / inner_steps(DT_S)
        self.fuel = self.reset = self.metal = self.casing = 0.0

    def line(self, name, z):
        return math.exp(np.clip(self.named[name] @ z, -5.0, 5.0))

    def slope(self, rank, k, v, w):
        row, mach = self.model.arrays["slopes"][rank], self.inputs[k, 1]
        tilt = (row[3] + row[4] * mach) * (v + w)
        bend = row[5] * (v * v + v * w + w * w)
        return row[0] + row[1] * self.thin[k] + row[2] * mach + tilt + bend

    def behind(self, tau, deviation, drawn, step):
        a = math.exp(-self.h / tau)
        return a * deviation + (1 - a) * (drawn + step * tau / self.h)

    def heated(self, f, z):
        """Metal and casing a step on, which are kept as they are."""
        keep = math.exp(-self.h / math.exp(np.clip(2.85 - 0.5 * z[4] + 0.8 * z[1], -5.0, 5.0)))
        self.metal = f + (self.metal - f) * keep
        self.casing = self.metal + (self.casing - self.metal) * math.exp(-self.h / 80.0)

    def spools(self, x, z, ends):
        """Fuel demand, valve, reset, core and fan: backward Euler as one linear system.

        Where the demand leaves its limits, its equation is the limit's.
        """
        (v, u, f, r), (w, s, c), h = x, ends, self.h
        core, fan, gain = (self.line(name, z) for name in ("core_s", "fan_s", "gain"))
        valve = np.clip(self.model.arrays["extra"][0], 0.01, 1.0)
        lead = valve + self.line("lead_s", z)
        reset = fan * core / (fan + core) + self.line("reset_s", z)
        push = self.line("push", z)
        # Unknowns f_d, f', r', v', u'; the first row is the governor's.
        governor = [1.0, 0.0, -1.0, 0.0, gain * (1 + lead / h)], gain * (s + lead * u / h)
        rest = [
            ([-h / valve, 1 + h / valve, 0, 0, 0], f),
            ([-h / reset, 0, 1 + h / reset, 0, 0], r),
            ([0, -h / core, 0, 1 + h / core, 0], v),
            (
                [0, 0, 0, -(c * h + push) / fan, 1 + h / fan],
                u + h / fan * (s - c * w) - push * v / fan,
            ),
        ]
        opened = np.clip(self.model.arrays["extra"][1] * self.opened(), -1.0, 1.0)
        up, down = self.line("up", z) * math.exp(-opened), self.line("down", z) * math.exp(opened)
        demand, f, r, v, u = solved([governor, *rest])
        if not -down <= (demand - v) / core <= up:
            most = up if (demand - v) / core > up else -down
            demand, f, r, v, u = solved([([1, 0, 0, -1, 0], core * most), *rest])
        return v, u, f, r

    def sample(self, k, fast):
        """The fast deviations a sample on; what is remembered changes."""
        unit, target = 1.0 / (self.root[k] * HALF), self.target
        v, u = target[k - 1, 1] - fast[1] * unit[1], target[k - 1, 0] - fast[0] * unit[0]
        self.metal, self.casing = self.metal + target[k - 1, 1], self.casing + target[k - 1, 1]
        f, r = target[k - 1, 1] - self.fuel, target[k - 1, 1] - self.reset
        move = (target[k] - target[k - 1]) / inner_steps(DT_S)
        for i in range(inner_steps(DT_S)):
            s, w = (target[k - 1] + (i + 1) * move)[:2]
            vc, uc, wc = np.clip([v, u, w], -1.5, 1.5)
            z = [1, self.thin[k], self.hot[k], self.inputs[k, 1], vc, uc, vc * vc, vc * uc, uc * uc]
            c = max(self.slope(0, k, vc, wc), 0.05)
            before, fan = v, s - move[0] - u
            v, u, f, r = self.spools((v, u, f, r), z, (w, s, c))
            self.heated(f, z)
            core, power = ((w - move[1] - before) + (w - v)) / 2, (v - before) / self.h
            drawn = self.slope(1, k, vc, wc) * core - self.line("push_T", z) * power
            drawn = (drawn + self.model.arrays["extra"][2] * (fan - c * core)) / unit[2]
            step = (self.ss[k, 2] - self.ss[k - 1, 2]) / inner_steps(DT_S)
            fast[2] = self.behind(self.line("probe_s", z), fast[2], drawn, step)
        self.fuel, self.reset = np.clip([target[k, 1] - f, target[k, 1] - r], -5.0, 5.0)
        self.metal, self.casing = np.clip(
            np.array([self.metal, self.casing]) - target[k, 1], -5.0, 5.0
        )
        return np.array([(target[k, 0] - u) / unit[0], (target[k, 1] - v) / unit[1], fast[2]])

    def opened(self):
        return max(self.metal - self.casing, 0.0)

    def heat(self, k, casing, was):
        for o, rank in ((1, 0), (0, 1), (2, 2)):
            p, step = self.model.arrays["heat"][rank], self.ss[k, o] - self.ss[k - 1, o]
            log_tau = p[1] + p[2] * np.clip(self.target[k, 1], -1.5, 1.5) + p[3] * self.thin[k]
            left = math.exp(-DT_S / math.exp(np.clip(log_tau, -0.5, 4.5)))
            self.soak[o] = left * (self.soak[o] + p[0] * step)
            left, unit = math.exp(-DT_S / math.exp(np.clip(p[5], 2.0, 5.0))), self.root[k] * HALF[o]
            casing[o] = left * (casing[o] - p[4] * unit * was) + p[4] * unit * self.opened()
        return self.soak + casing

    def run(self, start):
        fast, casing = np.array([start[0], 0.0, 0.0]), np.array([0.0, start[1], start[2]])
        found = [fast + casing]
        for k in range(1, len(self.ss)):
            was = self.opened()
            fast = self.sample(k, fast)
            slow = self.heat(k, casing, was)
            fast = np.clip(fast + slow, -self.model.limit, self.model.limit) - slow
            found.append(fast + slow)
        return np.array(found)


@settings(max_examples=15)
@given(seed=st.integers(0, 200))
def test_the_kernel_is_the_equations(seed):
    model, rng = lags(seed, limit=60.0), np.random.default_rng(seed)
    ss = CENTRE + HALF * np.repeat(rng.uniform(-1.1, 1.1, (6, 1)), 15, axis=0)
    inputs = np.repeat(rng.uniform([0.0, 0.0, -20.0], [39000.0, 0.8, 15.0], (6, 3)), 15, axis=0)
    start = rng.normal(size=3)
    got = run(model, inputs, ss, start)
    np.testing.assert_allclose(got, Slowly(model, inputs, ss).run(start), rtol=1e-8, atol=1e-8)


def test_an_engine_at_rest_stays_there_and_one_that_is_not_comes_to_rest():
    inputs, ss = steps_of([0.3], hold_s=900.0)
    np.testing.assert_allclose(run(lags(), inputs, ss), 0.0, atol=1e-9)
    left = run(lags(), inputs, ss, (2.0, -1.0, 30.0))
    assert np.abs(left[-1]).max() < 1e-3


AIR = st.tuples(st.floats(0.0, 45000.0), st.floats(0.0, 0.95), st.floats(-40.0, 30.0))


def drawn_lags(seed, spread):
    """Lags whose parameters are far from those of any fit."""
    model, rng = lags(), np.random.default_rng(seed)
    model.theta[:] += spread * rng.normal(size=len(model.theta))
    return model


def largest_pole(model, level, air, dt_s):
    """Of the step that is linearised by differences about the equilibrium at a level."""
    model.arrays["extra"][1] = 0.0  # clearances have a kink at rest, and act on limits alone
    inputs, ss = steps_of([level], hold_s=2.0 * dt_s, dt_s=dt_s, air=air)
    drive, size = model.drive(inputs, INPUTS, ss), 1e-6  # kinks of limits stay outside it

    def step(x):
        return model.run(drive, (np.zeros(1, int), x.reshape(1, ROWS, 3)), dt_s)[1].ravel()

    used = model.used.ravel()
    moves = size * np.eye(3 * ROWS)[used]
    jacobian = np.stack([(step(one) - step(-one))[used] / (2.0 * size) for one in moves], axis=1)
    return np.abs(np.linalg.eigvals(jacobian)).max()


@given(st.integers(0, 2**31), st.floats(0.1, 3.0), st.floats(-1.5, 1.5), AIR, st.floats(0.01, 2.0))
def test_every_equilibrium_is_stable_whatever_the_parameters_are(seed, spread, level, air, dt_s):
    """The step contracts all states of control, spools and metal."""
    assert largest_pole(drawn_lags(seed, spread), level, air, dt_s) < 1.0


@given(st.integers(0, 2**31), st.floats(-1.2, 1.2), st.floats(-1.2, 1.2), AIR)
def test_it_comes_to_rest_behind_a_slam(seed, before, after, air):
    model = drawn_lags(seed, 0.3)
    model.arrays["heat"][:, [0, 4]] = 0.0  # heat takes minutes
    slowest_s = -DT_S / math.log(largest_pole(drawn_lags(seed, 0.3), after, air, DT_S))
    inputs, ss = steps_of([before, after], hold_s=9.0 * slowest_s, air=air)
    left = run(model, inputs, ss)
    # A slam of 2.4 half ranges, exp(-9) of it, and as much again ten times for what overshoots.
    assert np.abs(left[-1] / HALF).max() < 10.0 * 2.4 * math.exp(-9.0)


@pytest.mark.parametrize("air", [(0.0, 0.0, 0.0), (39000.0, 0.8, 0.0), (300.0, 0.2, -25.0)])
@pytest.mark.parametrize("levels", [(-0.9, 0.9), (0.9, -0.9), (0.5, 0.4)])
def test_it_comes_to_rest_behind_every_move(air, levels):
    inputs, ss = steps_of(levels, hold_s=400.0, air=air)
    left = run(lags(), inputs, ss)
    assert np.abs(left[-1] / HALF).max() < 0.01


def test_while_a_heavy_fan_comes_down_the_core_is_below_where_it_will_settle():
    inputs, ss = steps_of([0.6, -0.8])
    speeds = ss - run(lags(), inputs, ss)
    pull = speeds[200:400]
    assert pull[:, 1].min() < ss[-1, 1] - 0.5
    assert pull[:, 0].min() > ss[-1, 0] - 0.5


def test_the_core_is_never_faster_than_its_limits():
    model = lags()
    core_s, valve_s = 0.4, model.arrays["extra"][0]
    model.arrays["extra"][1] = model.arrays["lines"][[0, 4, 5]] = 0.0
    # half ranges a second, up and down
    model.arrays["lines"][[0, 4, 5], 0] = math.log(core_s), math.log(0.2), math.log(0.1)
    model.arrays["heat"][:, [0, 4]] = 0.0
    inputs, ss = steps_of([-0.9, 0.9, -0.9], hold_s=30.0)
    pace = np.diff(ss - run(model, inputs, ss), axis=0)[:, 1] / (DT_S * HALF[1])
    behind_valve = core_s / (core_s + valve_s)  # the fuel trails a demand that runs ahead of it
    assert pace.max() == pytest.approx(0.2 * behind_valve, rel=0.05)
    assert pace.min() == pytest.approx(-0.1 * behind_valve, rel=0.05)


def test_a_deviation_is_bounded_whatever_the_parameters_are():
    model = lags(7, limit=5.0)
    model.arrays["lines"][:] *= 10.0
    inputs, ss = steps_of(np.random.default_rng(0).uniform(-1.0, 1.0, 10), hold_s=5.0)
    assert np.abs(run(model, inputs, ss)).max() <= 5.0 + 1e-9


def test_a_finer_raster_gives_nearly_the_same():
    levels = [-0.8, 0.7, -0.2]
    fine = run(lags(), *steps_of(levels, dt_s=1 / 32), dt_s=1 / 32)[::2]
    coarse = run(lags(), *steps_of(levels, dt_s=1 / 16), dt_s=1 / 16)
    assert np.abs((fine - coarse) / HALF).max() < 0.06


def test_measured_deviations_replace_its_own():
    model = lags()
    inputs, ss = steps_of([-0.5, 0.5])
    free = run(model, inputs, ss)
    drive = model.drive(inputs, INPUTS, ss)
    np.testing.assert_allclose(model.deviations(drive, free[0], DT_S, free), free, atol=1e-9)
    unknown = np.full_like(free, np.nan)
    np.testing.assert_allclose(model.deviations(drive, free[0], DT_S, unknown), free, atol=1e-9)
    held = model.deviations(drive, free[0], DT_S, np.zeros_like(free))
    assert np.abs(held[300]).max() < np.abs(free[202]).max()


def test_without_a_mach_number_it_is_zero():
    model = lags(3)
    inputs, ss = steps_of([-0.5, 0.5])
    some = model.deviations(model.drive(inputs[:, :1], ("ALT_ft",), ss), np.zeros(3), DT_S)
    np.testing.assert_array_equal(some, run(model, inputs, ss))


def register():
    torch.manual_seed(0)
    net = NarxNet(NarxConfig(lags=2, taps=(0,), hidden=2, moving=6), 9, 3)
    net.low[:], net.high[:] = -2.0, 2.0
    narx = NarxModel(net, Scaling(np.zeros(9), np.full(9, 50.0)), Scaling(np.zeros(3), HALF))
    inputs, ss = steps_of([-0.5, 0.6, 0.1], hold_s=3.0, air=(20000.0, 0.6, 5.0))
    parts = Parts(narx, lags(4), DT_S, None, INPUTS, [])
    return Register(parts, Sample(inputs[0], ss[0], np.array([1.0, -1.0, 20.0]))), inputs, ss


def test_in_a_register_steps_and_blocks_give_the_same():
    (whole, inputs, ss), (single, *_), (halves, *_) = register(), register(), register()
    expected = whole.advance(inputs[1:], ss[1:])
    steps = np.concatenate(
        [single.advance(inputs[k : k + 1], ss[k : k + 1]) for k in range(1, len(ss))]
    )
    parts = [halves.advance(inputs[1:40], ss[1:40]), halves.advance(inputs[40:], ss[40:])]
    np.testing.assert_allclose(steps, expected, atol=1e-9)
    np.testing.assert_allclose(np.concatenate(parts), expected, atol=1e-9)


def test_a_correction_counts_as_the_newest_output():
    model, inputs, ss = register()
    model.advance(inputs[1:40], ss[1:40])
    model.correct(ss[39] - [2.0, np.nan, 10.0])
    own = model.lagged[:3].sum(axis=0) + model.parts.narx.output_scaling.up(model.state.history[:3])
    assert own[[0, 2]] == pytest.approx([2.0, 10.0])


def test_arrays_bring_either_form_back():
    model = lags(5)
    meta, arrays = model.to_arrays()
    back = LumpedEngine.from_arrays(meta, arrays)
    assert back.governed
    inputs, ss = steps_of([-0.5, 0.5])
    np.testing.assert_array_equal(run(back, inputs, ss), run(model, inputs, ss))
    scales = {"centre": CENTRE, "half": HALF, "limit": np.ones(3)}
    plain = LumpedEngine.of(NAMES, {"parameters": np.zeros((3, len(LIMITED)))}, scales)
    assert not LumpedEngine.from_arrays(*plain.to_arrays()).governed


@pytest.mark.parametrize("name", sorted({**shapes_of(3, governed=True), "limit": ()}))
def test_an_array_that_does_not_fit_is_named(name):
    meta, arrays = lags().to_arrays()
    arrays = {**arrays, name: arrays[name][:-1]}
    with pytest.raises(ModelError, match=f"lag array '{name}' has to be of shape"):
        LumpedEngine.from_arrays(meta, arrays)


def test_an_engine_without_a_fan_is_refused():
    with pytest.raises(ModelError, match="the speeds of a fan and a core, found N2_pct, EGT_C"):
        _ = replace(lags(), output_names=("N2_pct", "EGT_C")).order
