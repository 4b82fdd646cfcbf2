"""Flies virtual flights and writes what their recorders saw, with the truth in a file beside."""

from __future__ import annotations

import gzip
import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from narxcal.channels import CHANNELS
from narxcal.flight_test.flown_engine import build_facts, flown_engine
from narxcal.flight_test.scenario import (
    SCHEMA,
    SIDES,
    FlightScenario,
    FlownEffect,
    canonical,
    lever_moves,
)
from narxcal.flight_test.sensors import Streams, record
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError, ModelError
from narxcal.support.settings import read_toml
from training.parallel import in_processes

TRUTH_SCHEMA: Final = "narxcal.flight_truth/1"
# Beside the logs, where no pattern of log files finds them.
TRUTH, TRUE_CHANNELS = "truth.json", "truth"


@dataclass(frozen=True, eq=False)
class VirtualLog:
    """One engine's recording of one flight.

    `name` is that of its file, without the ending. `recorded` is what the log holds, `true` what
    the engine did, without sensors and with its inner state: channel -> `(time,)`. `facts` is its
    row of the truth file.
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
    """A log as bytes, its true channels likewise (empty where unwanted), and its facts."""

    name: str
    content: bytes
    true_content: bytes
    facts: dict[str, Any]


Watch = Callable[[Mapping[str, Any], int, int], None]


def load_scenario(path: str | Path) -> FlightScenario:
    """Read a scenario of schema `narxcal.fly/1`; a name that is no file is a shipped one's.

    `demo`, `fly_demo` and `fly_demo.toml` all mean the shipped `fly_demo.toml`. Raises
    `ConfigError` for a missing file, bad TOML, an unknown key, effect, channel or value.
    """
    file = _file(Path(path))
    return FlightScenario.parse(read_toml(file, SCHEMA), file)


def _file(path: Path) -> Path:
    if path.is_file():
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


def fly(scenario: FlightScenario, flight: int) -> list[VirtualLog]:
    """Fly one flight (numbered from 1) and record its engines; no files.

    The same scenario and number give the same numbers, whatever else is flown.
    """
    plans = scenario.planned(flight)
    return [_flown(scenario, flight, engine, plans) for engine in scenario.engines]


def write_flights(
    folder: Path,
    scenario: FlightScenario,
    options: WriteOptions | None = None,
    watch: Watch | None = None,
) -> dict[str, Any]:
    """Write all logs of a scenario and the truth about them into `folder`; returns the truth.

    Canonical CSV files `flight_01_left.csv` ..., or `.csv.gz`; `truth.json`; and under `truth/`
    the engine's outputs as no sensor sees them, where they are wanted. `watch` is told each
    flight's facts, its number and how many there are. The bytes depend on the scenario alone, not
    on `jobs`.
    """
    options = options or WriteOptions()
    folder.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    for number, flight in enumerate(_all_flights(scenario, options), start=1):
        for log in flight:
            (folder / log.name).write_bytes(log.content)
            if options.true_channels:
                (folder / TRUE_CHANNELS).mkdir(exist_ok=True)
                (folder / TRUE_CHANNELS / log.name).write_bytes(log.true_content)
            rows.append(log.facts)
        if watch is not None:
            watch(flight[-1].facts, number, scenario.flight_count)
    return _truth(scenario, rows)


def _all_flights(scenario: FlightScenario, options: WriteOptions) -> Iterator[list[_Written]]:
    """Fly and format every flight, in order, in parallel processes where there are several."""
    numbers = range(1, scenario.flight_count + 1)
    jobs = min(options.jobs, scenario.flight_count)
    return in_processes(partial(_write, scenario, options), numbers, jobs)


def _write(scenario: FlightScenario, options: WriteOptions, flight: int) -> list[_Written]:
    """Fly one flight and put its logs into bytes; runs in a process of its own."""
    ending = ".csv.gz" if options.gzipped else ".csv"
    written = []
    for log in fly(scenario, flight):
        content = _bytes(log.recorded, options)
        time_s = {"time_s": log.recorded["time_s"]}
        true_content = _bytes(time_s | dict(log.true), options) if options.true_channels else b""
        name = log.name + ending
        facts = {"file": name, "sha256": hashlib.sha256(content).hexdigest(), **log.facts}
        written.append(_Written(name, content, true_content, facts))
    return written


def _flown(
    scenario: FlightScenario,
    flight: int,
    engine: str,
    plans: Mapping[str, Mapping[str, FloatArray]],
) -> VirtualLog:
    """Run one engine through its plan, and its outputs through the sensors."""
    plan, dt_s = plans[engine], 1.0 / scenario.plan.rate_hz
    # The longer log's, so that what happens to the aircraft happens to both engines.
    end_s = max(len(each["time_s"]) for each in plans.values()) * dt_s
    effects = scenario.effects_on(flight, engine, end_s)
    name = scenario.log_name(flight, engine)
    true = _simulated(scenario, (name, engine), plan, effects)
    seen = {each: true[each] for each in _recorded_outputs(scenario, true)}
    streams = Streams(scenario.seed, flight, SIDES.index(engine))
    faults = [effect.fault() for effect in effects if effect.on_sensor]
    recording = record({**plan, **seen}, dt_s, scenario.sensors, streams, faults)
    recorded = {each: recording.channels[each] for each in canonical(recording.channels)}
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
    who: tuple[str, str],
    plan: Mapping[str, FloatArray],
    effects: Sequence[FlownEffect],
) -> dict[str, FloatArray]:
    """What the engine does; `who` names log and engine. A failure names the log."""
    inputs = {name: values for name, values in plan.items() if name != "time_s"}
    log, engine = who
    try:
        return flown_engine(scenario, engine, effects).simulate(inputs, 1 / scenario.plan.rate_hz)
    except ModelError as error:
        raise ModelError(error.problem, file=log, row=error.row, hint=error.hint) from None


def _recorded_outputs(scenario: FlightScenario, outputs: Mapping[str, FloatArray]) -> list[str]:
    """Names of the outputs to record: those asked for, or all."""
    there = [name for name in canonical(outputs) if CHANNELS[name].role == "output"]
    return [name for name in there if name in (scenario.outputs or there)]


def _range(values: FloatArray) -> list[float]:
    return [float(values.min()), float(values.max())]


def _bytes(channels: Mapping[str, FloatArray], options: WriteOptions) -> bytes:
    """Format as CSV, blank where there is no reading.

    Eight digits keep multiples of 1/32 s exact for longer than any flight. The zip bears no time,
    so that the same numbers are the same bytes.
    """
    # Adding 0 turns the minus zero of a rounded reading into zero.
    table = np.column_stack(list(channels.values())) + 0.0
    form = ",".join(["%.8g"] * len(channels)) + "\n"
    text = "".join([form % tuple(row) for row in table.tolist()]).replace("nan", "")
    content = (",".join(channels) + "\n" + text).encode()
    return gzip.compress(content, 6, mtime=0) if options.gzipped else content


def _truth(scenario: FlightScenario, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """What is known about the logs; bears no date, so that it is as reproducible as they are."""
    return {
        "schema": TRUTH_SCHEMA,
        "name": scenario.name,
        "version": _version(),
        "engine": scenario.engine,
        "seed": scenario.seed,
        "build": {engine: build_facts(scenario, engine) for engine in scenario.engines},
        "effects": [effect.model_dump(mode="json") for effect in scenario.effects],
        "logs": rows,
        "scenario": scenario.model_dump(mode="json", by_alias=True),
    }


def _version() -> str:
    try:
        return version("narxcal")
    except PackageNotFoundError:  # run from a checkout that is not installed
        return "unknown"
