"""Proof that an exported model computes what `simulate` does: the free runs that were compared."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from narxcal.calibration.calibration import Calibration
from narxcal.steady.model import Envelope
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import DataError
from narxcal.support.files import atomic_write_text, sha256_of, to_json

SCHEMA = "narxcal.proof/1"
FILE = "proof.json"
BOUND = 1e-9  # of a difference in float64, in the unit of the output
_HOLD, _LEVELS, _FAR = 30, 20, 0.2  # samples per level, levels, reach beyond the envelope


@dataclass(frozen=True, eq=False)
class Case:
    """Inputs (time, n_in) of a log and its engine; NaN where an input is unknown."""

    name: str
    engine: str
    inputs: FloatArray


# A case, and the measured outputs (n_out,) to begin at; None in equilibrium.
Trial = tuple[Case, FloatArray | None]
# Outputs (time, n_out) of the exported model over trials.
Run = Callable[[Sequence[Trial]], Iterable[FloatArray]]


def drawn(envelope: Envelope, engine: str = "") -> Case:
    """Draw levels in and around the envelope, each held, with holes in the inputs."""
    rng = np.random.default_rng(0)
    span = envelope.high - envelope.low
    low, high = envelope.low - _FAR * span, envelope.high + _FAR * span
    bounded = np.isfinite(low) & np.isfinite(high)
    low, high = np.where(bounded, low, 0.0), np.where(bounded, high, 1.0)
    levels = np.repeat(rng.uniform(low, high, (_LEVELS, len(low))), _HOLD, axis=0)
    holes = rng.integers(1, len(levels), (2, len(low)))
    for column, rows in enumerate(holes.T):
        levels[rows, column] = np.nan
    return Case("drawn: outside the envelope, with holes", engine, levels)


def held(inputs: FloatArray) -> FloatArray:
    """Inputs whose unknown values are those of the sample before."""
    known = np.isfinite(inputs)
    rows = np.maximum.accumulate(np.where(known, np.arange(len(inputs))[:, None], 0), axis=0)
    return np.take_along_axis(inputs, rows, axis=0)


def compare(
    model: Calibration, run: Run, cases: Iterable[Case], *, starts: bool = True
) -> list[dict[str, Any]]:
    """Compare free runs, restarts in mid-flight and, with `starts`, runs from other outputs."""
    trials: list[tuple[str, Trial]] = []
    for case in cases:
        first, later = held(case.inputs)[0], case.inputs[len(case.inputs) // 2 :]
        trials.append(("free run", (case, None)))
        if np.isfinite(later[0]).all():
            again = Case(case.name, case.engine, later)
            trials.append(("restart in mid-flight", (again, None)))
        if starts:
            away = model.for_engine(case.engine, or_mean=True).steady.outputs(first) * 1.02
            trials.append(("start at other outputs", (case, away)))
    found = run([trial for _, trial in trials])
    expected = simulated(model)([trial for _, trial in trials])
    return [
        row_of(model, case, what, np.abs(y - own))
        for (what, (case, _)), y, own in zip(trials, found, expected, strict=True)
    ]


def simulated(model: Calibration) -> Run:
    return lambda trials: (
        model.for_engine(case.engine, or_mean=True).simulate(held(case.inputs), start)
        for case, start in trials
    )


def row_of(model: Calibration, case: Case, what: str, off: FloatArray) -> dict[str, Any]:
    """Row of a proof, of the differences (time, n_out)."""
    worst = dict(zip(model.output_names, off.max(axis=0).tolist(), strict=True))
    row = {"log": case.name, "engine": case.engine, "what": what, "samples": len(off)}
    return {**row, "largest": worst}


def largest(rows: Sequence[dict[str, Any]]) -> float:
    """Largest difference of all rows; infinite where one is no number."""
    values = np.array([value for row in rows for value in row["largest"].values()])
    return float(np.max(np.where(np.isfinite(values), values, np.inf), initial=0.0))


def document(file: Path, rows: list[dict[str, Any]], bound: float, **more: Any) -> dict[str, Any]:
    """Return the proof of one exported file."""
    worst = largest(rows)
    return {
        "file": file.name, "sha256": sha256_of(file), "bound": bound, "largest": worst,
        "ok": worst <= bound, **more, "rows": rows,
    }  # fmt: skip


def read(folder: Path) -> dict[str, Any]:
    """Proofs by file in the `proof.json` of a folder; `DataError` for one of another kind."""
    file = folder / FILE
    if not file.is_file():
        return {}
    try:
        stored = json.loads(file.read_text(encoding="utf-8"))
    except ValueError:
        stored = None
    if not isinstance(stored, dict) or stored.get("schema") != SCHEMA:
        raise DataError(
            "the file is no proof of an export", file=file, hint="Choose another folder"
        )
    return dict(stored["proofs"])


def write(folder: Path, proof: dict[str, Any]) -> None:
    """Enter a proof in the `proof.json` of a folder, in the place of that of the same file."""
    proofs = {**read(folder), proof["file"]: proof}
    atomic_write_text(folder / FILE, to_json({"schema": SCHEMA, "proofs": proofs}))
