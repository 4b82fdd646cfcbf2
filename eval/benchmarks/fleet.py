"""What a fleet costs: copies of one log on workers of this machine.

    python -m eval.benchmarks.fleet RUN LOG --logs 1000 --seconds 60 --workers 1 2

Each copy has a noise of its own, so that none is a duplicate. `client` is the process of the
command, in which Dask's scheduler runs, too. `overhead` is its CPU time as a share of that of the
workers; `busy` the latter as a share of the wall time of all workers, from the first batch to the
last.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from data_prep.reading import read_logs
from eval.run_logs import run_config
from narxcal.calibration.bundle import load_bundle
from narxcal.support.files import log_csv

_TAILS = 20
_EVERY_S = 0.25  # between looks at the processes


def write_copies(folder: Path, run: Path, log: Path, size: tuple[int, float]) -> float:
    """Write `size` = (logs, seconds) copies of a log's beginning; returns their hours."""
    config, _ = run_config(load_bundle(run))
    found = read_logs([log], config.logs)[0]
    count, seconds = size
    rows = min(len(found), round(seconds / found.dt_s))
    channels = {name: values[:rows] for name, values in found.channels.items()}
    rng = np.random.default_rng(1)
    outputs = [name for name in config.narx.outputs if name in channels]
    for number in range(count):
        changed = {
            name: channels[name] + rng.normal(0.0, 1e-4 * np.ptp(channels[name]), rows)
            for name in outputs
        }
        file = folder / f"T{number % _TAILS:02d}" / f"{number:06d}.csv"
        file.parent.mkdir(parents=True, exist_ok=True)
        text = log_csv({"time_s": found.time_s[:rows], **channels, **changed})
        file.write_text(text, "utf-8")
    return count * rows * found.dt_s / 3600.0


def measure(config: Path, out: Path, workers: int) -> dict[str, float]:
    """Run the fleet on new workers; wall and CPU seconds from the first batch on, most memory."""
    import psutil  # noqa: PLC0415 -- comes with distributed

    command = [sys.executable, "-m", "narxcal", "fleet", str(config), "--out", str(out), "--quiet"]
    client = psutil.Popen([*command, "--workers", str(workers)])
    cpu_s, largest = {"client": 0.0, "workers": 0.0}, Counter[str]()
    ready = 0.0, dict(cpu_s)
    while client.poll() is None:
        seen = {"client": [client], "workers": client.children(recursive=True)}
        for name, group in seen.items():
            used = [_used(each) for each in group]
            cpu_s[name] = max(cpu_s[name], sum(seconds for seconds, _ in used))
            largest[name] = max(largest[name], *(memory for _, memory in used), 0)
        if not ready[0] and (out / "logs").exists():
            ready = time.perf_counter(), dict(cpu_s)
        time.sleep(_EVERY_S)
    if client.returncode or not ready[0]:
        raise SystemExit(client.returncode or 3)
    wall_s = time.perf_counter() - ready[0]
    used_s = {name: cpu_s[name] - ready[1][name] for name in cpu_s}
    return {
        "workers": workers,
        "wall_s": wall_s,
        **{f"{name}_cpu_s": value for name, value in used_s.items()},
        **{f"{name}_MB": value / 1e6 for name, value in largest.items()},
        "overhead": used_s["client"] / used_s["workers"],
        "busy": used_s["workers"] / (workers * wall_s),
    }


def _used(process: Any) -> tuple[float, int]:
    """CPU seconds and bytes of memory; 0 for a process that has ended."""
    import psutil  # noqa: PLC0415 -- as above

    try:
        times = process.cpu_times()
        return times.user + times.system, process.memory_info().rss
    except psutil.Error:
        return 0.0, 0


def main(arguments: Sequence[str] | None = None) -> None:
    """Print one row per number of workers."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("run", type=Path)
    parser.add_argument("log", type=Path)
    parser.add_argument("--logs", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    options = parser.parse_args(arguments)
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with tempfile.TemporaryDirectory(prefix="fleet-") as name:
        folder = Path(name)
        size = options.logs, options.seconds
        hours = write_copies(folder / "flights", options.run, options.log, size)
        config = folder / "fleet.toml"
        config.write_text(
            f'schema = "narxcal.fleet/1"\nflights = "flights"\nbatch = {options.batch}\n'
            f'run = "{options.run.resolve()}"\n',
            "utf-8",
        )
        rows = [
            measure(config, folder / f"out-{k}", workers)
            for k, workers in enumerate(options.workers)
        ]
    load = ", ".join(f"{each:.1f}" for each in os.getloadavg())
    sys.stdout.write(f"{options.logs} logs, {hours:.1f} h; load of the machine {load}\n")
    sys.stdout.write(pd.DataFrame(rows).set_index("workers").T.round(3).to_string() + "\n")


if __name__ == "__main__":
    main()
