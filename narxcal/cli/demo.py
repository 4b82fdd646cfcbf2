"""`narxcal demo`: fly the virtual engine, train on its logs and evaluate, without any input."""

from __future__ import annotations

import shutil
from argparse import ArgumentParser, Namespace
from importlib.resources import files
from pathlib import Path

from narxcal.cli.console import Console
from narxcal.cli.evaluate import PAGE, report, show
from narxcal.cli.evaluate import RESULTS as EVALUATION
from narxcal.cli.options import path
from narxcal.cli.results import logs_for
from narxcal.cli.train import train
from narxcal.flight_test.fly import TRUTH, WriteOptions, load_scenario, write_flights
from narxcal.support.files import Results, atomic_write_text, to_json
from training.config import load_config

SCHEMA = "narxcal.demo/1"
DOCUMENT, CONFIG, FLIGHTS, MODEL, PAGES = "demo.json", "demo.toml", "flights", "run", "evaluate"
SCENARIO, JOBS = "fly_demo.toml", 2
RESULTS = Results(SCHEMA, DOCUMENT, (CONFIG, FLIGHTS, MODEL, PAGES))


def add_options(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--out",
        metavar="DIR",
        type=path,
        default=Path("demo_run"),
        help="default demo_run",
    )


def run(options: Namespace, console: Console) -> int:
    folder = options.out.resolve()
    RESULTS.check(folder)
    _begin(folder)
    _fly(folder / FLIGHTS, console)
    config, base = load_config(folder / CONFIG)
    bundle = train(config, base, folder / MODEL, (False, console))
    logs = logs_for(bundle, None, None, console)
    found, evaluation, html = report(bundle, logs, (folder / MODEL, None), console)
    (folder / PAGES).mkdir()
    EVALUATION.write(folder / PAGES, evaluation, html)
    page = f"{PAGES}/{PAGE}"
    document = {"schema": SCHEMA, "complete": True, "page": page, "evaluation": evaluation}
    atomic_write_text(folder / DOCUMENT, to_json(document))
    show(console, found)
    console.say("This engine is a virtual one: draw no conclusions about any real one.")
    console.finish(document, f"Page: {options.out / PAGES / PAGE}")
    return found.outcome.exit_code


def _begin(folder: Path) -> None:
    """Mark the folder as incomplete, and delete the files of an earlier demonstration."""
    atomic_write_text(folder / DOCUMENT, to_json({"schema": SCHEMA, "complete": False}))
    for name in (FLIGHTS, MODEL, PAGES):
        shutil.rmtree(folder / name, ignore_errors=True)
    shipped = files("configs").joinpath("demo.toml").read_text(encoding="utf-8")
    atomic_write_text(folder / CONFIG, shipped)


def _fly(folder: Path, console: Console) -> None:
    scenario = load_scenario(Path(str(files("configs"))) / SCENARIO)
    with console.progress("Flying the virtual engine") as advance:
        truth = write_flights(folder, scenario, WriteOptions(JOBS), advance)
    atomic_write_text(folder / TRUTH, to_json(truth))
