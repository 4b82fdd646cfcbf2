"""A flight that an engine of lags flies, and copies of it under other names, clocks and rates."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d

from data_prep.log import Log, Source

LAGS = {"N1_pct": (25.0, 75.0, 1.5), "N2_pct": (55.0, 45.0, 0.8), "EGT_C": (400.0, 350.0, 0.7)}
NOISE = {"N1_pct": 0.05, "N2_pct": 0.04, "EGT_C": 0.8}


def flight(seed, duration_s=300.0, rate_hz=8.0, stay_s=12.0, levels=None, *, noise=1.0):
    """A log of slams between drawn levels; `levels` repeats those of another seed."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(round(duration_s * rate_hz)) / rate_hz
    drawn = np.random.default_rng(seed if levels is None else levels)
    count = int(duration_s / stay_s) + 1
    lever = np.where(np.arange(count) % 2, 55.0, 15.0) + drawn.uniform(-8.0, 8.0, count)
    lever = lever[(time_s // stay_s).astype(int)]
    channels = {"TRA_deg": lever, "ALT_ft": 5000.0 + 20.0 * time_s}
    for name, (idle, span, tau_s) in LAGS.items():
        settled, value = idle + span * lever / 70.0, []
        state = settled[0]
        for target in settled:
            state += (target - state) / (tau_s * rate_hz)
            value.append(state)
        channels[name] = np.array(value) + noise * rng.normal(0.0, NOISE[name], len(time_s))
    name = f"flight_{seed}.csv"
    return Log(name, time_s, channels, source=Source(f"/flights/{name}", f"bytes of {seed}"))


def renamed(log, name="copy.csv"):
    """The same samples from another file."""
    return replace(log, name=name, source=Source(f"/flights/{name}", f"bytes of {name}"))


def cut(log, from_s, to_s, clock_s=0.0):
    """A part of a log, with its clock set anew."""
    rows = np.flatnonzero((log.time_s >= from_s) & (log.time_s < to_s))
    part = log.part(rows[0], rows[-1] + 1)
    return renamed(replace(part, time_s=part.time_s - part.time_s[0] + clock_s))


def resampled(log, rate_hz, late_s=0.0):
    """A log as a recorder of another rate would write it, back on the grid of the log."""
    own = np.arange(log.time_s[0] + late_s, log.time_s[-1], 1.0 / rate_hz)
    grid = np.arange(own[0], own[-1], log.dt_s)
    channels = {
        name: np.interp(grid, own, np.interp(own, log.time_s, values))
        for name, values in log.channels.items()
    }
    return renamed(replace(log, time_s=grid, channels=channels, interpolated={}))


@pytest.fixture(name="flight", scope="session")
def _flight():
    return flight


@pytest.fixture(scope="session")
def copies():
    """Copies of a log: name -> function of the log."""
    return {
        "renamed": renamed,
        "cut": lambda log: cut(log, 100.0, 220.0, clock_s=1000.0),
        "resampled": lambda log: resampled(log, 5.0, 0.03),
        "EGT x 1.2": lambda log: renamed(log.with_channels({"EGT_C": 1.2 * log["EGT_C"]})),
        "four digits": lambda log: renamed(
            log.with_channels(
                {name: np.array([float(f"{x:.4g}") for x in log[name]]) for name in LAGS}
            )
        ),
        "recalibrated": lambda log: renamed(
            log.with_channels(
                {name: log[name] * (1.001 + 0.0015 * log.time_s / log.time_s[-1]) for name in LAGS}
            )
        ),
        "smoothed": lambda log: renamed(
            log.with_channels(
                {name: uniform_filter1d(values, 6) for name, values in log.channels.items()}
            )
        ),
        "masked": lambda log: renamed(
            log.with_channels({"N1_pct": np.where(log.time_s % 10.0 < 2.0, np.nan, log["N1_pct"])})
        ),
    }
