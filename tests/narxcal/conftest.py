"""A steady-state table of two inputs, and calibrations of steady-state models."""

import numpy as np
import pytest
import torch

from narxcal.calibration.dynamic import DynamicCalibration, narx_features
from narxcal.narx.config import NarxConfig
from narxcal.narx.module import NarxNet
from narxcal.narx.network import NarxModel, Scaling
from narxcal.steady.table import SteadyTable


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
