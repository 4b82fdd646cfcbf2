"""`narxcal fly`: logs of virtual flights, and a file with the truth about them.

OUT contains the logs, `truth.json` and, with `--truth-channels`, `truth/` with the true outputs.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from narxcal.cli.console import Console
from narxcal.cli.options import add_jobs, add_out, count, path, seed
from narxcal.flight_test.fly import (
    TRUE_CHANNELS,
    TRUTH,
    TRUTH_SCHEMA,
    WriteOptions,
    load_scenario,
    write_flights,
)
from narxcal.flight_test.moves import FlightCard
from narxcal.flight_test.scenario import FlightScenario
from narxcal.support.files import Results

_LOG = r"(flight_\d+_(left|right)|data_set_\d+)\.csv(\.gz)?"
RESULTS = Results(TRUTH_SCHEMA, TRUTH, (TRUE_CHANNELS,), _LOG)

# Keys of the scenario that the command line may set, and the option of each.
_TYPED = {"seed": "--seed", "flights": "--flights", "sensors.preset": "--sensors"}


def add_options(parser: ArgumentParser) -> None:
    parser.add_argument("config", metavar="CONFIG", help="TOML file, or a shipped one's name")
    add_out(parser)
    parser.add_argument(
        "--card", metavar="CARD.json", type=path, help="fly this flight card on every flight"
    )
    parser.add_argument("--sensors", metavar="PRESET", help="sensors instead of CONFIG's")
    parser.add_argument("--seed", metavar="N", type=seed, help="seed instead of CONFIG's")
    parser.add_argument("--flights", metavar="N", type=count, help="flights instead of CONFIG's")
    parser.add_argument("--gzip", action="store_true", help="write .csv.gz")
    parser.add_argument(
        "--truth-channels", action="store_true", help="write the outputs no sensor measures, too"
    )
    add_jobs(parser, "flights")


def run(options: Namespace, console: Console) -> int:
    """Fly all flights of a scenario and write all of them or none."""
    RESULTS.check(options.out)
    scenario = read_scenario(options)
    how = WriteOptions(options.jobs, options.gzip, options.truth_channels)
    with RESULTS.writing(options.out) as folder:
        with console.progress("Flying") as advance:
            document = write_flights(folder, scenario, how, advance)
        RESULTS.write(folder, document)
    _show(console, document, options.out)
    console.document({**document, "out": str(options.out)})
    return 0


def read_scenario(options: Namespace) -> FlightScenario:
    """Read CONFIG and replace what the command line gives; raises `ConfigError`."""
    scenario = load_scenario(options.config)
    changes: dict[str, Any] = {
        name: value for name in ("seed", "flights") if (value := getattr(options, name)) is not None
    }
    if options.card is not None:
        changes["card"] = FlightCard.read(options.card)
    if options.sensors is not None:
        changes["sensors"] = {"preset": options.sensors}
    if not changes:
        return scenario
    # Validated again: effects name flights, whose number may have changed.
    stored = scenario.model_dump(by_alias=True, exclude_unset=True)
    typed = {key: word for key, word in _TYPED.items() if key.partition(".")[0] in changes}
    return FlightScenario.parse({**stored, **changes}, options.config, typed)


def _show(console: Console, document: Mapping[str, Any], out: Path) -> None:
    head = ("log", "length [s]", "pushes", "pulls", "altitude [ft]", "Mach", "effects")
    console.table(document["name"], head, [_row(log) for log in document["logs"]])
    facts = {_name(effect): _size(effect, document["logs"]) for effect in document["effects"]}
    console.facts(facts or {"Effects": "none"})
    for text in _unflown(document):
        console.warn(text)
    console.say(f"Logs: {out}. Truth: {out / TRUTH}")


def _unflown(document: Mapping[str, Any]) -> list[str]:
    """Warnings about windows that begin after the end of every log with the effect."""
    ends: dict[tuple[str, float, float], list[float]] = {}
    for log in document["logs"]:
        for effect in log["effects"]:
            for start_s, end_s in effect["windows_s"]:
                key = _name(effect), start_s, end_s
                ends.setdefault(key, []).append(log["duration_s"])
    return [
        f"{name}: the window {start_s:g}-{end_s:g} s begins when every log with it is over, by "
        f"{max(logs):g} s: it changes nothing"
        for (name, start_s, end_s), logs in ends.items()
        if start_s >= max(logs)
    ]


def _row(log: Mapping[str, Any]) -> list[str]:
    kinds = [move["kind"] for move in log["lever_moves"]]
    return [
        log["file"].partition(".")[0],
        f"{log['duration_s']:.0f}",
        str(kinds.count("push")),
        str(kinds.count("pull")),
        "{:.0f}-{:.0f}".format(*log["alt_ft"]),
        "{:.2f}-{:.2f}".format(*log["Mach"]),
        str(len(log["effects"])),
    ]


def _name(effect: Mapping[str, Any]) -> str:
    where = f"@{effect['channel']}" if effect["channel"] else ""
    return f"{effect['id']}{where}"


def _size(effect: Mapping[str, Any], logs: list[Mapping[str, Any]]) -> str:
    sizes = ", ".join(f"{name} {value:g}" for name, value in effect["parameters"].items())
    there = sum(_name(effect) == _name(each) for log in logs for each in log["effects"])
    return f"{sizes} (on {there} of {len(logs)} logs)"
