"""Writes the paper's ten data sets, and beside them what the engine did without sensors."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from narxcal.atomic import atomic_write_text
from narxcal.standin import INPUT_NAMES, FloatArray, StandInEngine
from narxcal.standin_pilot import fly

LOGS, TRUTH = "logs", "truth"


def write_data_sets(
    folder: Path, seed: int = 0, count: int = 10, duration_s: float = 480.0
) -> None:
    """Write `logs/data_set_01.csv` ... and `truth/` beside it; the same seed, the same bytes."""
    for number in range(1, count + 1):
        flight = fly(1000 * seed + number, duration_s)
        _write(folder / LOGS / f"data_set_{number:02d}.csv", flight)
        inputs = {name: flight[name] for name in INPUT_NAMES}
        clean = StandInEngine().simulate(inputs, 1.0 / 32.0)
        _write(folder / TRUTH / f"data_set_{number:02d}.csv", {"time_s": flight["time_s"], **clean})


def _write(path: Path, channels: Mapping[str, FloatArray]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    table = pd.DataFrame(channels)
    atomic_write_text(path, table.to_csv(index=False, float_format="%.8g", lineterminator="\n"))
