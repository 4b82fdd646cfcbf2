"""Drawn fleets for `narxcal watch`, in the layout of `narxcal fleet`.

Flights of 1.5 h at a changing choice of levels, model errors by level and engine, minutes that are
correlated with their flight, engines of unlike scatter. In one of six tails an engine wears (EGT
and N2), its EGT sensor shifts, it is exchanged (all offsets, Ti), or both engines' EGT meters
shift, by so many standard deviations of one flight.
"""

import io
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from data_prep.sources.binary_source import arrow
from eval.fleets.fleet import DOCUMENT, SCHEMA, WORK_LIST
from eval.fleets.fleet_rows import GOOD, Row, as_tables
from eval.fleets.watch import Watch
from narxcal.support.addresses import Folder
from narxcal.support.arrays import FloatArray
from narxcal.support.files import to_json

ENGINES: Final = ("left", "right")
# Standard deviation of a flight, of a minute about it; of a cell of a power level in excess.
SPREADS: Final = {"N1_pct": 0.10, "N2_pct": 0.08, "EGT_C": 3.0}
_MINUTE, _CELL, _TRANSIENT_S, _FLIGHT_S = 0.3, 0.5, 0.08, 0.03
HOURS: Final = 1.5
# Output and quantity -> share of the size, by scenario; the engines that change.
_OFFSETS = {(name, "offset"): 1.0 for name in SPREADS}
SCENARIOS: Final[dict[str, tuple[str, tuple[str, ...], dict[tuple[str, str], float]]]] = {
    "wear": ("trend", ("left",), {("EGT_C", "offset"): 1.0, ("N2_pct", "offset"): -0.7}),
    "sensor shift": ("step", ("left",), {("EGT_C", "offset"): 1.0}),
    "engine change": ("step", ("right",), {**_OFFSETS, ("N1_pct", "Ti"): 1.0}),
    "shared meter": ("step", ENGINES, {("EGT_C", "offset"): 1.0}),
}
_NEAR = 3  # flights


@dataclass(frozen=True)
class Case:
    """A fleet: `tails` of `flights`, in every sixth a change of `size` standard deviations."""

    scenario: str
    size: float
    seed: int
    tails: int = 18
    flights: int = 60

    @property
    def at(self) -> int:
        """Flight of a step."""
        return self.flights // 2

    @property
    def changed(self) -> tuple[str, ...]:
        """Tails that change; none of a stationary fleet."""
        return tuple(f"T{k:02d}" for k in range(0, self.tails, 6)) if self.size else ()

    def effect(self, tail: str, engine: str, of: tuple[str, str]) -> FloatArray:
        """Change (flights,) in standard deviations of a flight."""
        kind, engines, sizes = SCENARIOS[self.scenario]
        if tail not in self.changed or engine not in engines:
            return np.zeros(self.flights)
        place = np.arange(self.flights)
        shape = place / (self.flights - 1) if kind == "trend" else place >= self.at
        return np.asarray(sizes.get(of, 0.0) * self.size * shape, dtype=np.float64)


def draw(case: Case, dataset: Folder) -> None:
    """Write the dataset of a case."""
    pa, parquet = arrow(Path(WORK_LIST))
    names = [f"T{k:02d}" for k in range(case.tails)]
    document = {"schema": SCHEMA, "runs": dict.fromkeys(names, "drawn"), "versions": {}}
    parts = {DOCUMENT: to_json(document).encode()}
    listed: list[Row] = []
    for number, tail in enumerate(names):
        rows: dict[str, list[Row]] = {name: [] for name in ("logs", "trims", "scores", "events")}
        for engine in ENGINES:
            rng = np.random.default_rng([case.seed, number, ENGINES.index(engine)])
            for row in _engine(case, tail, engine, rng):
                rows[row.pop("table")].append(row)
        for name, table in as_tables(pa, rows).items():
            stream = io.BytesIO()
            parquet.write_table(table, stream)
            parts[f"{name}/{tail}/00000.parquet"] = stream.getvalue()
        log = {"file": f"{tail}.csv", "size": 1, "sha256": tail, "engine": ""}
        listed.append({"tail": tail, "batch": 0, **log})
    stream = io.BytesIO()
    parquet.write_table(pa.Table.from_pylist(listed), stream)
    for name, content in {WORK_LIST: stream.getvalue(), **parts}.items():
        dataset.write(name, content)


def _engine(case: Case, tail: str, engine: str, rng: np.random.Generator) -> Iterator[Row]:
    """Rows of one engine, each with its table."""
    scatter = np.sqrt(12.0 / rng.chisquare(12.0))
    by_level = {name: rng.normal(0.0, 2.0, 10) for name in SPREADS}
    by_move = rng.normal(0.0, 0.1, 2)
    flown = {
        name: rng.normal(size=case.flights) + case.effect(tail, engine, (name, "offset")) / scatter
        for name in SPREADS
    }
    quick = rng.normal(size=case.flights)
    quick += case.effect(tail, engine, ("N1_pct", "Ti"))
    for k in range(case.flights):
        file = f"{k:04d}.csv"
        whose = {"tail": tail, "file": file, "engine": engine, "log": f"{file}:{engine}"}
        known = {"status": GOOD, "hours": HOURS, "size": 1, "sha256": file}
        yield {"table": "logs", **whose, **known}
        levels = np.flatnonzero(rng.random(10) < 0.6)
        for name, spread in SPREADS.items():
            for level in levels.tolist():
                minutes = int(rng.integers(1, 30))
                cell = flown[name][k] + by_level[name][level] + _CELL * rng.normal()
                yield {
                    "table": "trims", **whose, "channel": name, "level": 0.1 * level + 0.05,
                    "minutes": minutes,
                    "offset": spread * scatter * (cell + _MINUTE * rng.normal() / minutes**0.5),
                    "standard_error": None if minutes < 2 else spread * scatter * _MINUTE
                    * float(np.sqrt(rng.chisquare(minutes - 1) / (minutes - 1) / minutes)),
                }  # fmt: skip
        for move in range(2):
            for _ in range(int(rng.integers(1, 6))):
                error = by_move[move] + _FLIGHT_S * quick[k] + _TRANSIENT_S * rng.normal()
                yield {
                    "table": "events", **whose, "direction": ("push", "pull")[move],
                    "speed": "fast", "channel": "N1_pct", "Ti_error_s": error,
                }  # fmt: skip


def judged(case: Case, found: Watch) -> tuple[int, int, int]:
    """Changes found as trend (wear) or as step within three flights, changes in all, false ones."""
    kind, engines, sizes = SCENARIOS[case.scenario]
    wanted = {(tail, engine, *of) for tail in case.changed for engine in engines for of in sizes}
    hits, false = set(), 0
    for one in found.effects:
        for change in one.drift.changes:
            near = kind == "trend" or abs(int(one.flights[change.at]) - case.at) <= _NEAR
            if tuple(one.key) in wanted and change.kind == kind and near:
                hits.add(tuple(one.key))
            else:
                false += 1
    return len(hits), len(wanted), false
