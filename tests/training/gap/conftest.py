"""A small analytic engine that is its own exact emulator, and gaps made with known effects."""

import numpy as np
import pytest

from narxcal.effects import Flights, Signals, effect
from narxcal.effects.running import respond

DT = 0.25
INPUTS = ("TRA_deg", "ALT_ft", "Mach", "dT_C", "NAI")
OUTPUTS = ("N1_pct", "N2_pct", "EGT_C")
NOISE = np.array([0.03, 0.03, 0.5])


class Engine:
    """Two spools and a temperature, each a lag behind where the lever wants it."""

    def drive(self, u):
        return np.stack([u[..., 0], np.exp(-u[..., 1] / 40000.0)], axis=-1)

    def rate(self, y, drive):
        wanted, air = 25.0 + 0.8 * drive[..., 0], drive[..., 1]
        n1, n2, egt = np.moveaxis(y, -1, 0)
        return np.stack(
            [
                air * (wanted - n1) / 1.2,
                air * (45.0 + 0.5 * wanted - n2) / 0.8,
                (300.0 + 5.0 * wanted + 4.0 * (wanted - n1) - egt) / 0.9,
            ],
            axis=-1,
        )

    def run(self, u):
        start = 25.0 + 0.8 * u[:, 0, 0]
        y = [np.stack([start, 45.0 + 0.5 * start, 300.0 + 5.0 * start], axis=-1)]
        for k in range(u.shape[1] - 1):
            y.append(y[-1] + DT * self.rate(y[-1], self.drive(u[:, k])))
        return np.stack(y, axis=1)


def lever(random, steps):
    """Slams, slow moves and small reversals, held for some seconds each."""
    at, angles = 20.0, []
    while len(angles) < steps:
        small = random.random() < 0.4
        to = float(np.clip(at + random.uniform(-4, 4) if small else random.uniform(2, 80), 2, 80))
        way = max(2, round(abs(to - at) / random.uniform(8, 80) / DT))
        angles += list(np.linspace(at, to, way)) + [to] * round(random.uniform(4, 14) / DT)
        at = to
    return np.array(angles[:steps])


@pytest.fixture(scope="session")
def flights():
    """Five flights of 200 s."""
    random = np.random.default_rng(3)
    count, steps = 5, 800
    u = np.zeros((count, steps, len(INPUTS)))
    for f in range(count):
        u[f, :, 0] = lever(random, steps)
        u[f, :, 1] = random.uniform(0, 30000) + np.linspace(0, 3000, steps)
        u[f, :, 2] = 0.4
        u[f, :, 3] = random.uniform(-15, 15)
        u[f, steps // 3 : steps // 2, 4] = 1.0
    y = Engine().run(u)
    limits = (y.min(axis=(0, 1)), y.max(axis=(0, 1)))
    active = ("TRA_deg", "ALT_ft", "dT_C", "NAI")
    signals = Signals(INPUTS, OUTPUTS, DT, "TRA_deg", *limits, (2.0, 80.0), active)
    return Flights(signals, u, y, np.full(count, steps))


@pytest.fixture(scope="session")
def engine():
    return Engine()


@pytest.fixture(scope="session")
def recorded(flights, engine):
    """`recorded({"sensor_lag:EGT_C": [1.0]}, seed)`: outputs with effects and noise."""

    def make(effects, seed=0, noise=NOISE):
        settings = [(effect(name), np.array([theta])) for name, theta in effects.items()]
        y = respond(settings, flights, engine)[0] if settings else flights.y
        return y + noise * np.random.default_rng(seed).standard_normal(y.shape)

    return make
