"""Accuracy of configurations that name columns and split alone: `python -m eval.bench --untuned`.

On every set one recording takes no part in training. The model's figures are compared with those
of the better baseline (first-order lag or linear ARX, channel by channel). Virtual engines are
flown and written as a recorder would; logs of real engines, and of those simulated by others, are
read where they are. A set's configuration says which columns there are, which log is judged and
what drives the engine, and nothing about the model.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from eval.benchmarks import Row
from eval.benchmarks.flights import Passes
from eval.diagnosis.blind.lumped import LumpedEngine
from eval.judging.evaluate import Evaluation, evaluate
from eval.judging.free_run import ARX, FIRST_ORDER
from narxcal.channels import channel
from narxcal.flight_test.fly import fly
from narxcal.flight_test.pilot import SIDES
from narxcal.flight_test.scenario import FlightScenario
from narxcal.flight_test.sensors import Streams, record
from narxcal.support.errors import DataError
from training.config import SCHEMA, RunConfig, load_config
from training.pipeline import calibrate, configured_files, prepare_logs
from training.records import split_logs

Tables = Mapping[str, Mapping[str, Any]]
Flown = Callable[[FlightScenario, int], Mapping[str, Any]]
_ENGINE: Final = SIDES[0]
_FUEL: Final[dict[str, dict[str, Any]]] = {
    "events": {"driver": "FF_kgph"},
    "steady_state": {"inputs": ["FF_kgph", "ALT_ft", "Mach", "dT_C"]},
}


@dataclass(frozen=True)
class UntunedSet:
    """One engine and recorder: `logs(folder, seed)` says where its logs are, having made them.

    `tables` are those of the configuration; [logs] folder is put in.
    """

    name: str
    tables: Tables
    logs: Callable[[Path, int, Path], Path]


def _flown(scenario: Mapping[str, Any], flown: Flown, folder: Path, seed: int, _data: Path) -> Path:
    """Write the flights of a scenario, `flown` by some engine, as CSV."""
    whole = FlightScenario.parse({"engines": [_ENGINE], **scenario, "seed": seed}, "untuned")
    for flight in range(1, whole.flight_count + 1):
        channels = flown(whole, flight)
        table = pd.DataFrame({name: channels[name] for name in channels})
        table.to_csv(folder / f"flight_{flight}.csv", index=False, float_format="%.8g")
    return folder


def _virtual(scenario: FlightScenario, flight: int) -> Mapping[str, Any]:
    return fly(scenario, flight)[0].recorded


def _lumped(kind: str, scenario: FlightScenario, flight: int) -> Mapping[str, Any]:
    """The flight as an engine of another structure makes it."""
    plan, dt_s = scenario.planned(flight)[_ENGINE], 1.0 / scenario.plan.rate_hz
    outputs = LumpedEngine(kind).simulate(plan, dt_s)
    streams = Streams(scenario.seed, flight, 0)
    return record({**plan, **outputs}, dt_s, scenario.sensors, streams).channels


def _coarse(scenario: FlightScenario, flight: int) -> Mapping[str, Any]:
    """What an airline's recorder keeps of a flight: some rows, imperial units, no fuel flow."""
    step = round(scenario.plan.rate_hz / _AIRLINE_HZ)
    seen = {name: values[::step] for name, values in _virtual(scenario, flight).items()}
    seen.pop("FF_kgph")
    return seen | {"EGT_C": np.round(seen["EGT_C"] * 1.8 + 32.0)}


_AIRLINE_HZ: Final = 4.0


def _there(name: str, _folder: Path, _seed: int, data: Path) -> Path:
    return data / name


def _split(train: list[str], test: list[str]) -> dict[str, Any]:
    return {"split": {"train": train, "test": test}}


def _last_of(count: int) -> dict[str, Any]:
    """The last flight is judged."""
    numbers = [f"flight_{number}*" for number in range(1, count + 1)]
    return {"logs": {"files": ["flight_*.csv"]}, **_split(numbers[:-1], numbers[-1:])}


def _enriched(engine: str, flights: int, minutes: float, rate_hz: float) -> dict[str, Any]:
    plan = {"style": "enriched", "duration_s": 60.0 * minutes, "rate_hz": rate_hz}
    return {"engine": engine, "flights": flights, "plan": plan}


def _columns(config: str) -> dict[str, Any]:
    """The columns of a shipped configuration."""
    section = load_config(config)[0].logs
    keep = {"files", "columns", "engines", "derive", "raster_hz", "max_gap_s"}
    return section.model_dump(mode="json", include=keep, exclude_defaults=True)


def _flies(name: str, tables: Tables, scenario: Mapping[str, Any], flown: Flown) -> UntunedSet:
    return UntunedSet(name, tables, partial(_flown, scenario, flown))


def _reads(name: str, tables: Tables, folder: str) -> UntunedSet:
    return UntunedSet(name, tables, partial(_there, folder))


def _agtf30(raster_hz: float, tables: Tables) -> dict[str, Any]:
    logs = {"raster_hz": raster_hz, "files": ["flight_*.csv.gz"]}
    return {"logs": logs, **tables, **_split(["flight_1*", "flight_2*"], ["flight_3*"])}


_LUMPED: Final = _enriched("business_jet", 4, 8.0, 32.0)
_N1, _N2 = (partial(_lumped, f"lumped_{spool}") for spool in ("n1", "n2"))
_LINE: Final = {
    "engine": "single_aisle",
    "flights": 5,
    "plan": {"style": "line", "duration_s": 1800.0, "rate_hz": 16.0},
}
_AIRLINE_COLUMNS: Final[Mapping[str, Any]] = {
    **{name: {"column": name} for name in
       ("time_s", "TRA_deg", "ALT_ft", "Mach", "dT_C", "WOW", "N1_pct", "N2_pct")},
    "EGT_C": {"column": "EGT_C", "unit": "degF"},
}  # fmt: skip
_AIRLINE: Final = {**_last_of(5), "logs": {"files": ["flight_*.csv"], "columns": _AIRLINE_COLUMNS}}
_CITATION: Final = {
    "logs": _columns("citation2"), **_FUEL, **_split(["*flight1*"], ["*flight2*"])
}  # fmt: skip
_JET: Final = {
    "logs": _columns("jetcat"),
    "running": {"above": {"N1_pct": 30.0}},
    "steady_state": {"inputs": ["TRA_deg"]},
    "narx": {"outputs": ["N1_pct", "EGT_C"]},
    **_split(["*20230222*"], ["*20230109*"]),
}
SETS: Final = (
    _flies("virtual single-aisle, 3 flights of 15 min at 16 Hz, switches recorded", _last_of(4),
           _enriched("single_aisle", 4, 15.0, 16.0), _virtual),
    _flies("virtual business jet, 2 flights of 8 min at 16 Hz", _last_of(3),
           _enriched("business_jet", 3, 8.0, 16.0), _virtual),
    _flies("lumped, N1 governed, 3 flights of 8 min at 32 Hz", _last_of(4), _LUMPED, _N1),
    _flies("lumped, N2 governed, 3 flights of 8 min at 32 Hz", _last_of(4), _LUMPED, _N2),
    _flies("the same, no lever recorded: driven by fuel flow", {**_last_of(4), **_FUEL},
           _LUMPED, _N2),
    _flies("airline recorder at 4 Hz, 4 line flights of 30 min, no fuel flow", _AIRLINE,
           _LINE, _coarse),
    _reads("AGTF30 at 4 Hz from the lever, 2 flights", _agtf30(4.0, {}), "agtf30"),
    _reads("AGTF30 at 32 Hz from fuel flow, 2 flights", _agtf30(32.0, _FUEL), "agtf30"),
    _reads("Citation II, 1 flight", _CITATION, "flights"),
    _reads("JetCat turbojet, 1 recording", _JET, "flights"),
)  # fmt: skip


_SOURCE: Final = "the better of first-order lag and linear ARX on the same rows"


def rows(data: Path, seed: int, sets: Sequence[UntunedSet] = SETS) -> Iterator[Row]:
    """Measure every set whose logs are there; flights are drawn from `seed`."""
    for one in sets:
        with tempfile.TemporaryDirectory() as folder:
            try:
                found = judged(one, one.logs(Path(folder), seed, data))
            except DataError as error:
                yield Row(one.name, "all", math.nan, "", note=f"not measured: {error}")
                continue
        yield from rows_of(one.name, found)


def judged(one: UntunedSet, folder: Path) -> Evaluation:
    """Train on a set as its configuration says, and evaluate what took no part."""
    tables: dict[str, Any] = {**one.tables, "schema": SCHEMA}
    tables["logs"] = {**tables.get("logs", {}), "folder": str(folder)}
    config = RunConfig.parse(tables, one.name)
    split = split_logs(prepare_logs(config, configured_files(config, folder)), config.split)
    return evaluate(calibrate(config, folder, split), split.test)


def rows_of(group: str, found: Evaluation) -> Iterator[Row]:
    """Share of response times in tolerance, and the error of each channel."""
    yield Passes.of(found, (FIRST_ORDER, ARX)).row(group, "Ti and Tt passed", _SOURCE)
    for name, pooled in found.pooled.items():
        best = float(np.fmin(pooled.first_order_rmse, pooled.arx_rmse))
        unit = channel(name).unit
        yield Row(group, f"RMSE {name}", pooled.rmse, unit, best, "at most", _SOURCE)
