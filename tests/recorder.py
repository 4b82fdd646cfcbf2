"""An export as an airline recorder's ground station writes it: staggered words, codes and marks.

Each parameter has words of a number of bits, samples at its own place in the frame, and a word of
all ones at a fixed period; some cells hold `*`. Two rows stand below the header.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from narxcal.support.arrays import FloatArray

ROWS_HZ = 8


@dataclass(frozen=True)
class Word:
    """A parameter: resolution in its unit, bits, rows from one sample to the next, first row."""

    name: str
    unit: str
    code: str
    resolution: float
    bits: int
    every: int
    first: int

    @property
    def all_ones(self) -> float:
        return self.resolution * (2**self.bits - 1)


ENGINE = {
    "TRA_deg": Word("Eng{} TLA", "(deg)", "ANGLE", 0.5, 8, 2, 0),
    "N1_pct": Word("Eng{} N1", "()", "%N1(TACH)", 0.125, 10, 2, 1),
    "N2_pct": Word("Eng{} N2", "()", "%N2(TACH)", 0.125, 10, 4, 2),
    "EGT_C": Word("Eng{} EGT", "(deg C)", "NUMBER", 1.0, 10, 4, 3),
    "FF_kgph": Word("Eng{} Fuel Flow", "(kg/hr)", "NUMBER", 0.25, 12, 4, 1),
}
AIR = {
    "ALT_ft": Word("Altitude Press", "(feet)", "NUMBER", 1.0, 16, 8, 4),
    "Mach": Word("Mach", "()", "NUMBER", 0.001, 10, 8, 5),
    "SAT_C": Word("SAT", "(deg C)", "NUMBER", 0.25, 10, 8, 6),
}
CODED = ("N1_pct", "N2_pct", "EGT_C", "FF_kgph")
PERIOD_ROWS = 8 * ROWS_HZ  # the word of all ones comes every 8 s
STARS = 0.01  # share of cells


def write_export(
    path: Path, engines: list[dict[str, FloatArray]], rng: np.random.Generator, *, faults: bool
) -> dict[str, tuple[int, int]]:
    """Write channels `(rows,)` at `ROWS_HZ`; returns column -> words of all ones and cells of `*`.

    Without `faults` there is neither.
    """
    rows = len(engines[0]["time_s"])
    columns = {"Time": [f"{k / ROWS_HZ:.3f}" for k in range(rows)]}
    columns["Subframe"] = [str(1 + k // ROWS_HZ % 4) for k in range(rows)]
    below = [("(sec)", "NUMBER"), ("()", "NUMBER")]
    put: dict[str, tuple[int, int]] = {}
    parts = [(name, word, 1, engines[0]) for name, word in AIR.items()]
    parts += [(n, w, k, each) for k, each in enumerate(engines, 1) for n, w in ENGINE.items()]
    for name, word, engine, channels in parts:
        at = np.arange(word.first, rows, word.every)
        values = np.round(channels[name][at] / word.resolution) * word.resolution
        ones = np.zeros(len(at), dtype=np.bool_)
        if faults and name in CODED:
            ones[3 :: PERIOD_ROWS // word.every] = True
        stars = (rng.random(len(at)) < STARS) & ~ones & faults
        cells = [""] * rows
        for row, value, one, star in zip(at, values, ones, stars, strict=True):
            cells[row] = "*" if star else f"{word.all_ones if one else value:.10g}"
        column = word.name.format(engine)
        columns[column] = cells
        below.append((word.unit, word.code))
        put[column] = (int(ones.sum()), int(stars.sum()))
    lines = [",".join(columns), *(",".join(each) for each in zip(*below, strict=True))]
    lines += [",".join(each) for each in zip(*columns.values(), strict=True)]
    path.write_text("\n".join(lines) + "\n", "utf-8")
    return put
