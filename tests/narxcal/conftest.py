"""The curves of an engine that never was: smooth, cheap, and with switches that merely add."""

import numpy as np
import pytest

from narxcal.atmosphere import air_state
from narxcal.steady_callable import SteadyCallable
from narxcal.turbofan.virtual_engine import INPUT_NAMES


def curves(inputs):
    """N1, N2 and EGT (..., 3) at (..., 9): corrected speed by lever and idle, then by the air."""
    lever, altitude, mach, dT, ground, approach, ecs, nai, wai = np.moveaxis(inputs, -1, 0)
    root = np.sqrt(air_state(altitude, mach, dT).theta2)
    idle = np.where(ground > 0.5, 0.22, np.where(approach > 0.5, 0.36, 0.28))
    share = np.clip(lever / 85.0, 0.0, 1.0)
    n = idle + (1.0 - idle) * share**1.15 - 0.007 * share * (nai + wai)
    temperature = 600.0 + 520.0 * n**2 + 150.0 * (1.0 - n) ** 4
    bleed = 5.0 * ecs + 12.0 * nai + 8.0 * wai
    settled = 100.0 * n * root, 38.0 * root + 62.0 * n**0.75 * root, temperature * root**2 + bleed
    return np.stack(settled, axis=-1) - np.array([0.0, 0.0, 273.15])


@pytest.fixture(scope="session")
def maker():
    """The curves as a steady-state model with the inputs of the virtual engine."""
    return SteadyCallable(curves, (INPUT_NAMES, ("N1_pct", "N2_pct", "EGT_C")))
