"""Fly virtual flights: logs as a recorder writes them, and a file with the truth about them.

One flight is planned once for both engines of the aircraft (`FlightScenario.planned`). Each engine
is simulated by `narxcal.turbofan` and measured by `narxcal.flight_test.sensors`.
"""

from __future__ import annotations

import gzip
import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from narxcal.channels import CHANNELS
from narxcal.flight_test.pilot import SIDES
from narxcal.flight_test.scenario import SCHEMA, FlightScenario, FlownEffect
from narxcal.flight_test.sensors import Streams, record
from narxcal.support.arrays import FloatArray
from narxcal.support.csv_text import log_csv
from narxcal.support.errors import ConfigError, ModelError
from narxcal.support.files import is_file, versions
from narxcal.support.parallel import in_processes
from narxcal.support.progress import Progress, silent
from narxcal.support.settings import read_toml
from narxcal.turbofan import Unmodelled, VirtualEngine, build_scatter
from narxcal.turbofan.cycle import Health

TRUTH_SCHEMA: Final = "narxcal.flight_truth/1"
# Beside the logs, under names that no pattern of log files matches.
TRUTH, TRUE_CHANNELS = "truth.json", "truth"
# The lever moves where it is faster than the tremor of a hand and has moved at least so far.
_TREMOR_DEG_S, _LEAST_DEG = 0.2, 0.5


@dataclass(frozen=True, eq=False)
class VirtualLog:
    """One engine's recording of one flight.

    `name` is that of its file, without the ending. `recorded` are the channels of the log, `true`
    the outputs and inner state of the engine without sensors: channel -> `(time,)`. `facts` is
    its row of the truth file.
    """

    name: str
    recorded: Mapping[str, FloatArray]
    true: Mapping[str, FloatArray]
    facts: Mapping[str, Any]


class WriteOptions(NamedTuple):
    """How to write: processes, compression, and whether the true outputs are written too."""

    jobs: int = 1
    gzipped: bool = False
    true_channels: bool = False


class _Written(NamedTuple):
    """A log as bytes, its true channels likewise (empty where not wanted), and its facts."""

    name: str
    content: bytes
    true_content: bytes
    facts: dict[str, Any]


def load_scenario(path: str | Path) -> FlightScenario:
    """Read a scenario of schema `narxcal.fly/1`; a name that is no file is a shipped one's.

    `demo`, `fly_demo` and `fly_demo.toml` all mean the shipped `fly_demo.toml`. Raises
    `ConfigError` for a missing file, bad TOML, an unknown key, effect, channel or value.
    """
    file = _file(Path(path))
    return FlightScenario.parse(read_toml(file, SCHEMA), file)


def _file(path: Path) -> Path:
    if is_file(path):
        return path
    shipped = Path(str(files("configs")))
    found = {item.stem.removeprefix("fly_"): item for item in sorted(shipped.glob("fly_*.toml"))}
    name = path.name.removesuffix(".toml").removeprefix("fly_")
    if name in found:
        return found[name]
    raise ConfigError(
        "the scenario does not exist",
        file=path,
        hint=f"Name a file, or one of the shipped {', '.join(found)}",
    )


def write_flights(
    folder: Path,
    scenario: FlightScenario,
    options: WriteOptions | None = None,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Write all logs of a scenario into `folder` and return the document of the truth about them.

    Canonical CSV files `flight_01_left.csv` ..., or `.csv.gz`; and under `truth/` the outputs of
    the engine without sensors, where they are wanted. `progress` counts the flights. The
    bytes depend on the scenario alone, not on `jobs`.
    """
    options = options or WriteOptions()
    folder.mkdir(parents=True, exist_ok=True)
    count = scenario.flight_count
    each_flight = partial(_formatted, scenario, options)
    flights = in_processes(each_flight, range(1, count + 1), min(options.jobs, count))
    rows: list[dict[str, Any]] = []
    for number, logs in enumerate(flights, start=1):
        for log in logs:
            (folder / log.name).write_bytes(log.content)
            if options.true_channels:
                (folder / TRUE_CHANNELS).mkdir(exist_ok=True)
                (folder / TRUE_CHANNELS / log.name).write_bytes(log.true_content)
            rows.append(log.facts)
        progress(number, count, f"flight {number}")
    return _truth(scenario, rows)


def _formatted(scenario: FlightScenario, options: WriteOptions, flight: int) -> list[_Written]:
    """Fly one flight and format its logs; runs in a process of its own."""
    ending = ".csv.gz" if options.gzipped else ".csv"
    written = []
    for log in fly(scenario, flight):
        content = _csv(log.recorded, options)
        time_s = {"time_s": log.recorded["time_s"]}
        true_content = _csv(time_s | dict(log.true), options) if options.true_channels else b""
        name = log.name + ending
        facts = {"file": name, "sha256": hashlib.sha256(content).hexdigest(), **log.facts}
        written.append(_Written(name, content, true_content, facts))
    return written


def _csv(channels: Mapping[str, FloatArray], options: WriteOptions) -> bytes:
    """Format as CSV, compressed without a time of writing: the same numbers are the same bytes."""
    content = log_csv(channels, digits=8).encode()
    return gzip.compress(content, 6, mtime=0) if options.gzipped else content


def _truth(scenario: FlightScenario, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Document of the truth about the logs; without a date, so that it is as reproducible."""
    return {
        "schema": TRUTH_SCHEMA,
        "name": scenario.name,
        "version": versions()["narxcal"],
        "engine": scenario.engine,
        "seed": scenario.seed,
        "build": {engine: build(scenario, engine)._asdict() for engine in scenario.engines},
        "effects": [effect.model_dump(mode="json") for effect in scenario.effects],
        "logs": rows,
        "scenario": scenario.model_dump(mode="json", by_alias=True),
    }


def fly(scenario: FlightScenario, flight: int) -> list[VirtualLog]:
    """Fly one flight (numbered from 1) and record its engines; writes no files."""
    plans = scenario.planned(flight)
    return [_flown(scenario, flight, engine, plans) for engine in scenario.engines]


def _flown(
    scenario: FlightScenario,
    flight: int,
    engine: str,
    plans: Mapping[str, Mapping[str, FloatArray]],
) -> VirtualLog:
    """Simulate one engine over its plan, and measure its outputs."""
    plan, dt_s = plans[engine], 1.0 / scenario.plan.rate_hz
    # The end of the longer log: what happens to the aircraft happens to both engines.
    end_s = max(len(each["time_s"]) for each in plans.values()) * dt_s
    effects = scenario.effects_on(flight, engine, end_s)
    name = scenario.log_name(flight, engine)
    true = _simulated(scenario, (name, engine), plan, effects)
    outputs = [each for each in _in_order(true) if CHANNELS[each].role == "output"]
    seen = {each: true[each] for each in outputs if each in (scenario.outputs or outputs)}
    streams = Streams(scenario.seed, flight, SIDES.index(engine))
    faults = [effect.fault() for effect in effects if effect.on_sensor]
    recording = record({**plan, **seen}, dt_s, scenario.sensors, streams, faults)
    recorded = {each: recording.channels[each] for each in _in_order(recording.channels)}
    facts = {
        "flight": flight,
        "engine": engine,
        "samples": len(plan["time_s"]),
        "duration_s": len(plan["time_s"]) * dt_s,
        "alt_ft": _range(plan["ALT_ft"]),
        "Mach": _range(plan["Mach"]),
        "effects": [effect.model_dump(mode="json") for effect in effects],
        "lever_moves": [each.row() for each in lever_moves(plan["time_s"], plan["TRA_deg"])],
        "sensors": recording.drawn,
    }
    return VirtualLog(name, recorded, true, facts)


def _simulated(
    scenario: FlightScenario,
    names: tuple[str, str],
    plan: Mapping[str, FloatArray],
    effects: Sequence[FlownEffect],
) -> dict[str, FloatArray]:
    """Simulate the engine; `names` are those of log and engine. A failure names the log."""
    inputs = {name: values for name, values in plan.items() if name != "time_s"}
    log, engine = names
    try:
        return flown_engine(scenario, engine, effects).simulate(inputs, 1 / scenario.plan.rate_hz)
    except ModelError as error:
        raise ModelError(error.problem, file=log, row=error.row, hint=error.hint) from None


def flown_engine(
    scenario: FlightScenario, side: str, effects: Sequence[FlownEffect] = ()
) -> VirtualEngine:
    """Build the engine on one side of the aircraft, with those `effects` that sit in an engine."""
    unmodelled = [
        Unmodelled(effect.id, effect.parameters, effect.windows_s)
        for effect in effects
        if not effect.on_sensor
    ]
    return VirtualEngine(scenario.engine, build(scenario, side), unmodelled)


def build(scenario: FlightScenario, side: str) -> Health:
    """Draw the build of the engine on one side: multipliers of efficiencies and flows."""
    random = np.random.default_rng(scenario.stream(0, f"build {side}"))
    return build_scatter(random, scenario.build_scatter_pct)


def _in_order(names: Iterable[str]) -> list[str]:
    given = set(names)
    return [name for name in CHANNELS if name in given]


def _range(values: FloatArray) -> list[float]:
    return [float(values.min()), float(values.max())]


class LeverMove(NamedTuple):
    """A movement of the lever in one direction, from its start to its end."""

    start_s: float
    stop_s: float
    from_deg: float
    to_deg: float

    @property
    def kind(self) -> str:
        return "push" if self.to_deg > self.from_deg else "pull"

    def row(self) -> dict[str, Any]:
        return {"kind": self.kind, **self._asdict()}


def lever_moves(time_s: FloatArray, tra_deg: FloatArray) -> list[LeverMove]:
    """Find the true movements of a lever `(time,)`: `start_s` is the last sample before it moves.

    A change of direction begins another movement. Movements of less than half a degree are left
    out.
    """
    change = np.diff(tra_deg)
    moving = np.abs(change / np.diff(time_s)) > _TREMOR_DEG_S
    direction = np.sign(np.where(moving, change, 0.0))
    edges = (np.flatnonzero(np.diff(direction)) + 1).tolist()
    moves = [
        LeverMove(float(time_s[a]), float(time_s[b]), float(tra_deg[a]), float(tra_deg[b]))
        for a, b in zip([0, *edges], [*edges, len(direction)], strict=True)
        if direction[a : a + 1].any()
    ]
    return [move for move in moves if abs(move.to_deg - move.from_deg) >= _LEAST_DEG]
