"""A small analytic engine that takes a pace, flights of it, and every effect that can act."""

import numpy as np
import pytest

from narxcal.effects import Flights, Signals, candidates
from narxcal.effects.base import as_simulated

INPUTS = ("TRA_deg", "ALT_ft", "Mach", "dT_C", "Approach", "ECS", "NAI", "WAI", "unlogged")
OUTPUTS = ("N1_pct", "N2_pct", "EGT_C", "FF_kgph")
DT = 0.125
FASTEST = 12.0  # acceleration of the core in %/s that its control allows


class Engine:
    """Lags of each output behind its steady value, coupled: exact as its own emulator."""

    def drive(self, u):
        thin = np.exp(-u[..., 1:2] / 40000.0)
        return np.concatenate([u[..., :1], thin, u[..., 6:7]], axis=-1)

    def rate(self, y, drive):
        lever, thin, bleed = drive[..., 0], drive[..., 1], drive[..., 2]
        n1, n2, egt, ff = np.moveaxis(y, -1, 0)
        to = 25.0 + 0.9 * lever
        return np.stack(
            [
                thin * (to - n1) / 1.2 + 0.1 * (n2 - 50.0 - 0.5 * n1),
                thin * (50.0 + 0.5 * to - n2) / 0.8,
                (320.0 + 4.0 * to + 3.0 * (to - n1) + 12.0 * bleed - egt) / 0.9,
                (100.0 + 0.1 * to**2 - ff) / 0.3,
            ],
            axis=-1,
        )

    def simulate(self, u, start):
        """Explicit steps: `u` (..., time, inputs), `start` (..., outputs)."""
        y = [start]
        for k in range(u.shape[-2] - 1):
            y.append(y[-1] + DT * self.rate(y[-1], self.drive(u[..., k, :])))
        return np.stack(y, axis=-2)

    def run(self, flights, told, pace=None, shift=None):
        """Explicit steps at a pace: lags of the speeds scaled, the lever behind the valve's.

        An engine that settles elsewhere moves as it would, so far away; a load slows its core.
        """
        pace = pace or as_simulated(len(told))
        rows, which = np.arange(len(pace[0])) % len(flights.u), np.arange(len(pace[0])) % len(told)
        drive, air = self.drive(told[which]).copy(), flights.signals.thin_air(told)[which]
        for k in range(1, drive.shape[1]):
            late = np.exp(-DT / np.maximum(pace.valve_s, 1e-9))
            drive[:, k, 0] += late * (drive[:, k - 1, 0] - drive[:, k, 0])
        none = np.zeros((*drive.shape[:2], len(OUTPUTS)))
        off, load = shift or (none, none[..., 0])
        y = [flights.y[rows, 0] + settled(told[which, 0]) - settled(flights.u[rows, 0]) + off[:, 0]]
        metal = y[0][:, 2]
        for k in range(drive.shape[1] - 1):
            rate = self.rate(y[-1] - off[:, k], drive[:, k])
            thin = air[:, k] ** pace.thin_air
            rate[:, 0] *= thin * np.where(rate[:, 0] > 0.0, pace.fan_up, pace.fan_down)
            rate[:, 1] *= thin * np.where(rate[:, 1] > 0.0, pace.core_up, pace.core_down)
            room = FASTEST * pace.limit / np.maximum(rate[:, 1], 1e-9)
            rate *= np.where(pace.limit == 1.0, 1.0, np.minimum(room, 1.0))[:, None]
            fall = FASTEST * pace.fall / np.maximum(-rate[:, 1], 1e-9)
            rate *= np.where(pace.fall == 1.0, 1.0, np.minimum(fall, 1.0))[:, None]
            rate[:, 1] -= pace.loss * (y[-1][:, 2] - metal) + load[:, k]
            metal = metal + DT / pace.metal_s * (y[-1][:, 2] - metal)
            y.append(y[-1] + DT * rate)
        return np.stack(y, axis=1)


def levers(flights=3, steps=240, seed=0):
    """Levers in steps and ramps, two altitudes, all switches used: (flights, time, inputs)."""
    random = np.random.default_rng(seed)
    u = np.zeros((flights, steps, len(INPUTS)))
    stay = 40
    stops = random.uniform(5.0, 80.0, (flights, steps // stay + 2))
    for f in range(flights):
        corners = np.arange(stops.shape[1]) * stay
        stairs = np.repeat(stops[f], stay)[:steps]
        slopes = np.interp(np.arange(steps), corners, stops[f])
        u[f, :, 0] = np.where(np.arange(steps) < steps // 2, stairs, slopes)
        u[f, :, 1] = 5000.0 + 12000.0 * f + 10.0 * np.arange(steps)
        u[f, :, 2] = 0.3 + 0.1 * f
        u[f, :, 3] = 10.0 * f - 8.0
        for column in range(4, 9):
            u[f, :, column] = (np.arange(steps) // (20 + 7 * column) + f) % 2
    return u


def settled(u):
    """Outputs (..., outputs) near rest at inputs (..., inputs)."""
    to = 25.0 + 0.9 * u[..., 0]
    rest = [to, 50.0 + 0.5 * to, 320.0 + 4.0 * to, 100.0 + 0.1 * to**2]
    return np.stack(rest, axis=-1)


def signals(u, y):
    return Signals(
        INPUTS,
        OUTPUTS,
        DT,
        "TRA_deg",
        y.min(axis=(0, 1)),
        y.max(axis=(0, 1)),
        (float(u[..., 0].min()), float(u[..., 0].max())),
        INPUTS,
    )


U = levers()
FLOWN = Engine().simulate(U, settled(U[:, 0]))
SIGNALS = signals(U, FLOWN)
ALL = candidates(SIGNALS)


def each(effects):
    return pytest.fixture(params=effects, ids=[effect.name for effect in effects])


@each(ALL)
def acting(request):
    """Every effect of the library."""
    return request.param


@each([e for e in ALL if any(p.linear for p in e.parameters(SIGNALS))])
def linear(request):
    """Every effect with an amplitude."""
    return request.param


@each([e for e in ALL if e.on_rates])
def moving(request):
    """Every effect on rates alone."""
    return request.param


@each([e for e in ALL if e.side == "sensor" or (e.terms and not (e.settled or e.taken))])
def reading(request):
    """Every effect on outputs alone."""
    return request.param


@each([e for e in ALL if e.takes_power])
def loading(request):
    """Every effect that takes power from the core."""
    return request.param


@each([e for e in ALL if e.side == "sensor"])
def sensor(request):
    """Every effect on one channel."""
    return request.param


@pytest.fixture
def engine():
    return Engine()


@pytest.fixture
def fly():
    """Flights of the engine from rest, at inputs (flights, time, inputs)."""

    def flown(u):
        y = Engine().simulate(u, settled(u[:, 0]))
        return Flights(SIGNALS, u, y, np.full(len(u), u.shape[1]))

    return flown


@pytest.fixture
def flights():
    """Three flights that nothing may write to."""
    found = Flights(SIGNALS, U, FLOWN, np.full(len(U), U.shape[1]))
    found.u.flags.writeable = found.y.flags.writeable = False
    return found


@pytest.fixture
def neutral():
    """A row of parameters at which the effect is not there."""
    return lambda effect: np.array([[p.neutral for p in effect.parameters(SIGNALS)]])


@pytest.fixture
def sized():
    """A row of parameters of a clear size: the last start, or a share of the upper bound.

    What is all or nothing is nothing.
    """

    def size(p, share):
        if p.all_or_nothing:
            return p.neutral
        return p.starts[-1] if p.starts else share * p.high

    def row(effect, share=0.1):
        return np.array([[size(p, share) for p in effect.parameters(SIGNALS)]])

    return row
