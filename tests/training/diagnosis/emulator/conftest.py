"""A small engine that is its own exact emulator, and flights of it."""

import numpy as np
import pytest

from narxcal import two_spool
from narxcal.effects import Flights, Signals
from narxcal.two_spool import TwoSpool
from training.diagnosis.emulator import GreyBoxEmulator

DT = 0.25
INPUTS = ("TRA_deg", "ALT_ft", "Mach", "dT_C", "NAI")
OUTPUTS = ("N1_pct", "N2_pct", "EGT_C")
NOISE = np.array([0.03, 0.03, 0.5])


class Steady:
    """Where the engine settles, in the place of a model fitted to logs."""

    def outputs(self, u):
        return settled(u)


def engine_of():
    """Two spools under a governor, its temperature, and limits that large moves reach."""
    theta = np.zeros(two_spool.SIZE)
    theta[two_spool.GAIN], theta[two_spool.DAMP] = np.log(1.5), 0.8
    theta[two_spool.UP : two_spool.UP + 3] = np.log(5.0), 0.5, 1.0
    theta[two_spool.DOWN : two_spool.DOWN + 3] = np.log(6.0), 0.5, 1.0
    theta[two_spool.FAN], theta[two_spool.LINE] = np.log(0.9), 1.8
    theta[two_spool.VALVE], theta[two_spool.PUSH] = np.log(0.2), 0.3
    thermal = np.array([[10.0, 0.0, 0.0, 0.0, 12.0, 0.0, 0.0, 0.0, 0.9]])
    return GreyBoxEmulator(Steady(), TwoSpool(theta, thermal, 50.0, 40.0, 0, DT))


def settled(u):
    """Outputs (..., outputs) at rest at inputs (..., inputs)."""
    to = 25.0 + 0.8 * u[..., 0]
    return np.stack([to, 45.0 + 0.5 * to, 300.0 + 5.0 * to], axis=-1)


def simulate(u):
    """Flights of the engine from rest."""
    rest = settled(u[:, :1])
    limits = (rest[:, 0].min(axis=0), rest[:, 0].max(axis=0))
    signals = Signals(INPUTS, OUTPUTS, DT, "TRA_deg", *limits)
    start = Flights(signals, u, np.repeat(rest, 2, axis=1), np.full(len(u), u.shape[1]))
    return engine_of().run(start, u)


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
    y = simulate(u)
    limits = (y.min(axis=(0, 1)), y.max(axis=(0, 1)))
    active = ("TRA_deg", "ALT_ft", "dT_C", "NAI")
    signals = Signals(INPUTS, OUTPUTS, DT, "TRA_deg", *limits, (2.0, 80.0), active)
    return Flights(signals, u, y, np.full(count, steps))


@pytest.fixture(scope="session")
def engine():
    return engine_of()
