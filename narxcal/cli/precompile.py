"""Compile what commands run ahead of their first use: `python -m narxcal.cli.precompile`.

Numba compiles a function when it is first called and caches the code next to its source, or, where
that is read-only, in the user's cache folder (`NUMBA_CACHE_DIR` names another). Here commands run
on the smallest inputs that call every kernel of theirs, in processes side by side: these functions
are compiled in half of the time that the commands would take one after the other.
"""

from __future__ import annotations

import io
import os
import sys
from argparse import ArgumentParser
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stderr
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from narxcal.cli.app import main
from narxcal.support.arrays import FloatArray
from narxcal.support.compiled import lagged
from narxcal.support.csv_text import log_csv
from narxcal.support.parallel import in_processes

# Idle, range and time constant in s of an engine of first-order lags, whose recorder has noise.
_LAGS = {"N1_pct": (25.0, 75.0, 1.5), "N2_pct": (55.0, 45.0, 0.8), "EGT_C": (400.0, 350.0, 0.7)}
_NOISE_PCT, _RATE_HZ, _SAMPLES = 0.05, 8.0, 800

_FLIGHT = """schema = "narxcal.fly/1"
name = "Smallest flight"
flights = 1
[plan]
style = "line"
duration_s = 600.0
rate_hz = 8.0
"""
_RUN = """schema = "narxcal.config/1"
name = "Smallest run"
[logs]
folder = "real"
files = ["*.csv"]
[split]
train = ["flight_[123].csv"]
test = ["flight_4.csv"]
[steady_state]
inputs = ["TRA_deg"]
[narx]
hidden = 4
[train]
choice_s = 1
horizons_s = [5.0]
iterations = [1]
threads = 1
"""


def _fly(folder: Path) -> int:
    config = folder / "fly.toml"
    config.write_text(_FLIGHT, encoding="utf-8")
    return main(["fly", str(config), "--out", str(folder / "flown"), "--quiet", "--jobs", "1"])


def _train(folder: Path) -> int:
    write_logs(folder, 4)
    config, run = folder / "run.toml", str(folder / "run")
    config.write_text(_RUN, encoding="utf-8")
    log = str(folder / "real" / "flight_4.csv")
    return max(
        main(["train", str(config), "--out", run, "--quiet"]),
        main(["replay", run, log, "--out", str(folder / "replayed.csv"), "--quiet"]),
    )


def _diagnose(folder: Path) -> int:
    write_logs(folder, 2)
    real, sim = (str(folder / name) for name in ("real", "sim"))
    out = str(folder / "gap")
    return main(["diagnose", "--real", real, "--sim", sim, "--out", out, "--quiet"])


def write_logs(folder: Path, flights: int) -> None:
    """Write recorded and simulated flights of slams, whose EGT probes differ."""
    for number in range(1, flights + 1):
        random = np.random.default_rng(number)
        levels = np.where(np.arange(10) % 2, 55.0, 15.0) + random.uniform(-8.0, 8.0, 10)
        lever = np.repeat(levels, _SAMPLES // 10)
        time_s = np.arange(_SAMPLES) / _RATE_HZ
        sim = {"time_s": time_s, "TRA_deg": lever, "ALT_ft": 5000.0 + 20.0 * time_s}
        for name, (idle, span, tau_s) in _LAGS.items():
            sim[name] = idle + span * _lagged(lever / 70.0, tau_s)
        real = {**sim, "EGT_C": _lagged(sim["EGT_C"], 1.2)}
        for name in _LAGS:
            real[name] = real[name] + random.normal(0.0, _NOISE_PCT, _SAMPLES)
        for kind, channels in (("real", real), ("sim", sim)):
            (folder / kind).mkdir(exist_ok=True)
            text = log_csv(channels)
            (folder / kind / f"flight_{number}.csv").write_text(text, encoding="utf-8")


def _lagged(values: FloatArray, tau_s: float) -> FloatArray:
    found = values.copy()
    for k in range(1, len(found)):
        found[k] = lagged(found[k - 1], values[k], tau_s, 1.0 / _RATE_HZ)
    return found


# The longest first.
TASKS: Mapping[str, Callable[[Path], int]] = {"diagnose": _diagnose, "train": _train, "fly": _fly}


def run_task(name: str) -> int:
    """Run the commands of one task; returns the highest exit code, and prints errors alone."""
    said = io.StringIO()
    with TemporaryDirectory() as folder, redirect_stderr(said):
        code = TASKS[name](Path(folder))
    if code:
        sys.stderr.write(said.getvalue())
    return code


def precompile(names: Sequence[str]) -> int:
    return max(in_processes(run_task, names, min(os.cpu_count() or 1, len(names))))


def parsed(arguments: Sequence[str] | None = None) -> list[str]:
    """Return the tasks that a command line names, all if it names none."""
    parser = ArgumentParser(prog="python -m narxcal.cli.precompile", description=__doc__)
    parser.add_argument("tasks", nargs="*", metavar="TASK", help=f"of {', '.join(TASKS)}")
    names: list[str] = parser.parse_args(arguments).tasks
    if unknown := set(names) - set(TASKS):
        parser.error(f"there is no task {min(unknown)}; tasks are {', '.join(TASKS)}")
    return names or [*TASKS]


if __name__ == "__main__":
    sys.exit(precompile(parsed()))
