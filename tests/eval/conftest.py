"""A hand-made engine: settled values linear in the lever, and a network that is an exact lag."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from data_prep.log import Log, Source
from narxcal.calibration.bundle import Bundle
from narxcal.calibration.dynamic import DynamicCalibration
from narxcal.calibration.run_record import RunRecord
from narxcal.narx.config import NarxConfig
from narxcal.narx.module import NarxNet
from narxcal.narx.network import NarxModel, Scaling
from narxcal.steady.table import SteadyTable
from training.config import RunConfig
from training.dynamics.baselines import fit_baselines

DT_S = 0.1
INPUTS, OUTPUTS = ("TRA_deg", "Mach"), ("N1_pct", "N2_pct")
TAU_S = (1.5, 0.8)


def steady():
    points = np.array([[0.0, 0.0], [0.0, 0.8], [80.0, 0.0], [80.0, 0.8]])
    settled = np.column_stack([20.0 + points[:, 0], 50.0 + 0.5 * points[:, 0]])
    return SteadyTable((INPUTS, OUTPUTS), points, settled)


def lag_network(tau_s):
    """d(k) = a d(k-1) + a (ss(k) - ss(k-1)), which is a first-order lag of the outputs."""
    inputs, outputs = 5, 2
    net = NarxNet(NarxConfig(lags=1, hidden=1, moving=outputs), inputs, outputs).double()
    decay = np.exp(-DT_S / np.array(tau_s))
    with torch.no_grad():
        for parameter in net.parameters():
            parameter.zero_()
        for k in range(outputs):
            net.linear.weight[k, k] = decay[k]
            net.linear.weight[k, outputs + k] = decay[k]
        net.low.fill_(-100.0)
        net.high.fill_(100.0)
    plain = [Scaling(np.zeros(n), np.ones(n)) for n in (inputs, outputs)]
    return NarxModel(net, *plain)


def lever(time_s):
    """Slams up and down every 20 s between changing levels."""
    step = (time_s // 20.0).astype(int)
    return np.where(step % 2, 60.0 + 5.0 * (step % 3), 10.0 + 5.0 * (step % 4))


def lag_log(name="flight.csv:left", duration_s=240.0, tau_s=TAU_S, offset=(0.0, 0.0)):
    """What the lag engine does with the lever, plus a constant `offset` per output."""
    time_s = DT_S * np.arange(round(duration_s / DT_S))
    inputs = np.column_stack([lever(time_s), np.full(len(time_s), 0.3)])
    calibration = DynamicCalibration(steady(), lag_network(tau_s), DT_S, ("Mach",))
    outputs = calibration.simulate(inputs) + np.array(offset)
    channels = dict(zip((*INPUTS, *OUTPUTS), np.column_stack([inputs, outputs]).T, strict=True))
    source = Source(f"/flights/{name}", "hash-of-" + name, name.rpartition(":")[2])
    return Log(name, time_s, channels, source=source)


def lag_bundle(tau_s=TAU_S, train=(), **sections):
    """A bundle of the lag engine; `sections` go into its configuration."""
    calibration = DynamicCalibration(steady(), lag_network(tau_s), DT_S, ("Mach",))
    table = {
        "schema": "narxcal.config/1",
        "smooth": {"window": 1},
        "events": {"condition": "", "response": ["N1_pct", "N2_pct"]},
        "steady_state": {"inputs": list(INPUTS), "blend": []},
        "narx": {"outputs": list(OUTPUTS), "schedule": ["Mach"]},
        **sections,
    }
    config = RunConfig.parse(table)
    logs = train or (lag_log("train.csv:left"),)
    record = RunRecord.parse({
        "config": config.model_dump(mode="json", by_alias=True),
        "split": {"train": [log.name for log in logs], "validate": [], "test": []},
        "data": {log.source.file: log.source.sha256 for log in logs},
        "identities": [identity(log) for log in train],
        "baselines": fit_baselines(calibration, logs),
        # The engine is exact and has no noise.
        "held_out": {"logs": ["a"], "fitted": False, "rmse": {key: [0.0] for key in OUTPUTS}},
    })  # fmt: skip
    return Bundle(calibration, record)


def identity(log):
    """What a bundle keeps of a training log."""
    source = {"file": log.source.file, "sha256": log.source.sha256, "engine": log.source.engine}
    return {"log": log.name, "role": "train", **source, **log.identity.to_json()}


def masked(log, channel, rows):
    values = log[channel].copy()
    values[rows] = np.nan
    return replace(log, channels={**log.channels, channel: values})


@pytest.fixture
def make_log():
    return lag_log


@pytest.fixture
def make_bundle():
    return lag_bundle


@pytest.fixture
def mask():
    return masked
