"""An engine of first-order lags flown through slams, and logs of it in pairs."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from data_prep.log import Log
from eval.diagnosis import diagnose, flights
from eval.diagnosis.pairs import pair_logs
from training.diagnosis.budget import Budget, Cause, Interval, Verdict, Weighed
from training.diagnosis.fit import Frame
from training.diagnosis.metric import Metric, assumed_variance
from training.diagnosis.nuisances import nuisances

RATE_HZ = 16.0


def batch(pairs):
    """All pairs at 8 Hz: steps that the expected values of the tests are for."""
    return flights.batch(pairs, 8.0, 12.0)


NOISE = {"N1_pct": 0.05, "N2_pct": 0.04, "EGT_C": 0.8}


def lagged(target, tau_s, dt_s):
    kept, found = np.exp(-dt_s / tau_s), np.empty_like(target)
    found[0] = target[0]
    for k in range(1, len(target)):
        found[k] = target[k] + kept * (found[k - 1] - target[k])
    return found


def lever(time_s, seed):
    """A slam every 20 s between changing levels."""
    rng = np.random.default_rng(seed)
    levels = np.where(np.arange(200) % 2, 55.0, 15.0) + rng.uniform(-8.0, 8.0, 200)
    return levels[(time_s // 20.0).astype(int)]


def flown(seed=0, duration_s=240.0, rate_hz=RATE_HZ, start_s=0.0, lever_of=(1.0, 0.0)):
    """Canonical channels of one simulated flight; its lever is scaled, and read with a bias."""
    dt_s = 1.0 / rate_hz
    time_s = start_s + dt_s * np.arange(round(duration_s * rate_hz))
    tra = lever_of[0] * lever(time_s - start_s, seed)
    power = (tra + lever_of[1]) / 70.0
    one = np.ones_like(time_s)
    return {
        "time_s": time_s,
        "TRA_deg": tra,
        "ALT_ft": 5000.0 + 20.0 * (time_s - start_s) * (1 + seed % 3),
        "Mach": 0.4 * one,
        "dT_C": 3.0 * one,
        "NAI": (time_s - start_s > 0.5 * duration_s).astype(float),
        "N1_pct": 25.0 + 75.0 * lagged(power, 1.5, dt_s),
        "N2_pct": 55.0 + 45.0 * lagged(power, 0.8, dt_s),
        "EGT_C": 400.0 + 350.0 * lagged(power, 0.7, dt_s),
    }


def as_log(channels, name="flight"):
    rest = {key: values for key, values in channels.items() if key != "time_s"}
    return Log(name, channels["time_s"], rest)


def measured(channels, seed=0, **changes):
    """What was recorded: the channels, changed ones instead, and noise."""
    rng = np.random.default_rng(1000 + seed)
    found = {**channels, **changes}
    for name, size in NOISE.items():
        if name in found:
            found[name] = found[name] + rng.normal(0.0, size, len(found[name]))
    return found


def probe_lag(channels, tau_s=1.0):
    dt_s = channels["time_s"][1] - channels["time_s"][0]
    return {"EGT_C": lagged(channels["EGT_C"], tau_s, dt_s)}


def nothing(_channels):
    return {}


@cache
def pair_of(seed, effect=nothing, **how):
    sim = flown(seed, **how)
    real = measured(sim, seed, **effect(sim))
    return pair_logs(f"flight_{seed}", as_log(real), as_log(sim))


def gap_data(effect=nothing, flights=4, **how):
    return batch([pair_of(seed, effect, **how) for seed in range(flights)])


def budget_of(kind, effects=(), ambiguous_with=(), **more):
    """A budget that names `effects`: name -> parameter -> interval."""
    rows = tuple(
        Weighed(name, 0.9, sizes, dict.fromkeys(sizes, "s"), 0.9, (0.9, 0.8))
        for name, sizes in dict(effects).items()
    )
    verdict = Verdict(kind, tuple(effects), ambiguous_with, "because", "fly")
    causes = (Cause("unexplained", 1.0, 1.0, 1.0, {}, {}),)
    return Budget(verdict, causes, rows, 0.1, 0.0, 0.5, **more)


NAME = "sensor_lag:EGT_C"
LAG = {"tau_s": Interval(1.0, 0.9, 1.1)}


def weighed(record, *_differences):
    """What is known of a record before any effect is weighed."""
    metric = Metric(record, assumed_variance(record))
    return SimpleNamespace(frame=Frame(record, metric, record.gap, nuisances(record)))


class NoEmulator:
    """Stands in for the emulator, which effects on sensors do not need."""

    def errors(self, flights):
        return np.zeros(len(flights.signals.outputs))


@pytest.fixture
def answer(monkeypatch, make_budget):
    """Makes the core find this, if there is no doubt."""
    nothing = make_budget("unknown", {})

    def set_to(kind="effects", effects=None):
        found = make_budget(kind, {NAME: LAG} if effects is None else effects)

        def concluded(_evidence, _phases, doubts=(), refused=""):
            verdict = replace(nothing.verdict, reason="; ".join(doubts) or refused)
            return replace(nothing, verdict=verdict) if doubts or refused else found

        monkeypatch.setattr(diagnose, "fit_emulators", lambda _flights: (NoEmulator(),))
        monkeypatch.setattr(diagnose, "weigh", weighed)
        monkeypatch.setattr(diagnose, "concluded", concluded)

    set_to()
    return set_to


@pytest.fixture
def make_budget():
    return budget_of


@pytest.fixture
def fly():
    return flown


@pytest.fixture
def record():
    return measured


@pytest.fixture
def log_of():
    return as_log


@pytest.fixture
def probe():
    return probe_lag


@pytest.fixture
def pair():
    return pair_of


@pytest.fixture
def make_data():
    return gap_data


@pytest.fixture(scope="session")
def flights_of_the_engine():
    """Three simulated flights as one batch."""
    return gap_data(flights=3, rate_hz=8.0).flights


@pytest.fixture
def write():
    """Write channels as a canonical CSV file, `.gz` or not."""

    def run(file, channels, digits=9):
        file.parent.mkdir(parents=True, exist_ok=True)
        table = np.column_stack(list(channels.values()))
        np.savetxt(
            file,
            table,
            fmt=f"%.{digits}g",
            delimiter=",",
            header=",".join(channels),
            comments="",
        )

    return run
