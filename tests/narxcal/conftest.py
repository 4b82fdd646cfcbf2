"""The curves of an engine that never was, a smaller one of two inputs, and calibrations of it."""

import numpy as np
import pytest
import torch

from narxcal.atmosphere import air_state
from narxcal.calibration.calibration import DynamicCalibration, narx_features
from narxcal.narx.network import NarxConfig, NarxModel, NarxNet, Scaling
from narxcal.steady.function import SteadyCallable
from narxcal.steady.table import SteadyTable
from narxcal.turbofan.engine import INPUT_NAMES


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


@pytest.fixture(scope="session")
def plane():
    """A table of four points over lever and Mach: N1 = 20 + lever, EGT = 300 + Mach."""
    points = np.array([[0.0, 0.0], [0.0, 0.8], [78.0, 0.0], [78.0, 0.8]])
    settled = np.column_stack([20 + points[:, 0], 300 + points[:, 1]])
    return SteadyTable((("TRA_deg", "Mach"), ("N1_pct", "EGT_C")), points, settled)


@pytest.fixture(scope="session")
def calibrated():
    """Calibrate a steady-state model of lever and Mach by a network drawn at random."""

    def calibrate(steady, log):
        torch.manual_seed(0)
        ss = steady.outputs(log)
        features = narx_features(ss, log[:, 1:])
        net = NarxNet(NarxConfig(lags=3, hidden=5, moving=2), features.shape[1], ss.shape[1])
        with torch.no_grad():
            for parameter in net.parameters():
                parameter.copy_(0.1 * torch.randn_like(parameter))
            net.low.fill_(-2.0)
            net.high.fill_(2.0)
        model = NarxModel(net.double(), Scaling.of(features), Scaling.of(ss, centred=False))
        return DynamicCalibration(steady, model, 1 / 32, ("Mach",))

    return calibrate
