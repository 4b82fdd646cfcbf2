"""Writes the demonstration's logs: flights of the stand-in engine as canonical CSV files."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

import pandas as pd

from narxcal.atomic import atomic_write_text
from narxcal.standin_pilot import fly


def write_logs(
    folder: str | PathLike[str], seed: int = 0, flights: int = 6, duration_s: float = 480.0
) -> list[Path]:
    """Write `flight_1.csv` ... at 32 Hz and return their paths; the same seed, the same bytes.

    Raises `ConfigError` if a file cannot be written or the flights are too short.
    """
    paths = [Path(folder) / f"flight_{number}.csv" for number in range(1, flights + 1)]
    for index, path in enumerate(paths):
        log = pd.DataFrame(fly(1000 * seed + index, duration_s))
        # Eight digits keep multiples of 1/32 s exact for longer than any flight.
        atomic_write_text(path, log.to_csv(index=False, float_format="%.8g", lineterminator="\n"))
    return paths
