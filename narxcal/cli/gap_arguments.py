"""The words of the commands that deal with the gap between simulator and flights."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any, TypeAlias

from narxcal.cli.values import count, seconds, seed

# argparse keeps the type of its sub-commands to itself.
_Commands: TypeAlias = "argparse._SubParsersAction[Any]"  # noqa: SLF001

SIMULATOR = "folder of simulated logs, run folder, FMU, module:function or virtual engine's name"


def diagnose(commands: _Commands) -> argparse.ArgumentParser:
    """`narxcal diagnose`."""
    text = "Say where simulator and flights differ, which effect it is, how far it shrinks."
    parser: argparse.ArgumentParser = commands.add_parser(
        "diagnose", help=text, description=text, allow_abbrev=False
    )
    parser.add_argument(
        "--real", metavar="DIR", type=Path, required=True, help="folder of the flights' logs"
    )
    parser.add_argument(
        "--sim", metavar="SIM", required=True, help=f"{SIMULATOR}; logs are paired by file name"
    )
    parser.add_argument("--out", metavar="DIR", type=Path, required=True, help="folder")
    parser.add_argument(
        "--config", metavar="CONFIG", help="TOML file whose [logs] maps columns that are not ours"
    )
    parser.add_argument(
        "--heldout-real", metavar="DIR", type=Path, help="flights to check the shrinkage on"
    )
    parser.add_argument("--heldout-sim", metavar="SIM", help="their simulated logs")
    return parser


def effects_of_simulate(parser: argparse.ArgumentParser) -> None:
    """What `narxcal simulate` takes to add the effects that `diagnose` found."""
    group = parser.add_argument_group("with the effects that diagnose found")
    group.add_argument("--sim", metavar="SIM", help=SIMULATOR)
    group.add_argument("--effects", metavar="GAP.json", type=Path, help="what diagnose wrote")
    group.add_argument(
        "--inputs", metavar="DIR", type=Path, dest="inputs_folder", help="folder of input logs"
    )
    group.add_argument("--config", metavar="CONFIG", help="TOML file whose [logs] maps columns")


def blind(commands: _Commands) -> argparse.ArgumentParser:
    """`narxcal blind make|run|score`."""
    text = "Make cases whose effect is withheld, answer them without the key, score with it."
    parser: argparse.ArgumentParser = commands.add_parser(
        "blind", help=text, description=text, allow_abbrev=False
    )
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    for add in (_blind_make, _blind_run, _blind_score):
        _output(add(actions))
    return parser


def _blind_make(actions: _Commands) -> argparse.ArgumentParser:
    text = "Fly the virtual engine with drawn effects; seal what they are in a key."
    parser: argparse.ArgumentParser = actions.add_parser(
        "make", help=text, description=text, allow_abbrev=False
    )
    parser.add_argument("--out", metavar="DIR", type=Path, required=True, help="folder")
    parser.add_argument("--cases", metavar="N", type=count, default=60, help="default 60")
    parser.add_argument(
        "--flights", metavar="N", type=count, default=6, help="of a case, default 6"
    )
    parser.add_argument("--held-out", metavar="N", type=count, default=2, help="more, default 2")
    parser.add_argument(
        "--duration",
        metavar="S",
        type=float,
        default=480.0,
        dest="duration_s",
        help="of a flight, default 480",
    )
    parser.add_argument(
        "--rate", metavar="HZ", type=float, default=32.0, dest="rate_hz", help="default 32"
    )
    parser.add_argument("--style", choices=("line", "enriched", "both"), default="both")
    parser.add_argument(
        "--engine",
        choices=("virtual", "lumped", "all"),
        default="all",
        help="engines of components, lumped ones, or all: every third case lumped (default)",
    )
    parser.add_argument(
        "--build",
        choices=("scattered", "same"),
        default="scattered",
        help="the recorded engine: one of its type (default), or the simulator's own",
    )
    parser.add_argument("--seed", metavar="N", type=seed, default=0, help="default 0")
    parser.add_argument("--secret", metavar="WORD", help="opens the key; the seed if left out")
    _jobs(parser)
    real = parser.add_argument_group("from real flights, instead of the virtual engine's")
    real.add_argument("--real", metavar="DIR", type=Path, help="folder of recorded logs")
    real.add_argument("--sim", metavar="SIM", help="run folder, FMU or module:function")
    real.add_argument(
        "--sim-logs",
        metavar="DIR",
        type=Path,
        help="instead: logs of any simulator, without noise, onto which effects are put",
    )
    real.add_argument("--config", metavar="CONFIG", help="TOML file whose [logs] maps columns")
    return parser


def _blind_run(actions: _Commands) -> argparse.ArgumentParser:
    text = "Diagnose every case without opening the key; goes on where it was cut short."
    parser: argparse.ArgumentParser = actions.add_parser(
        "run", help=text, description=text, allow_abbrev=False
    )
    parser.add_argument("folder", metavar="CASES", type=Path, help="folder that make wrote")
    parser.add_argument("--out", metavar="ANSWERS", type=Path, required=True, help="folder")
    parser.add_argument(
        "--timeout",
        metavar="S",
        type=seconds,
        default=900.0,
        dest="timeout_s",
        help="for one case, default 900; a case that takes longer has no answer",
    )
    parser.add_argument(
        "--seeds",
        metavar="N",
        type=count,
        default=1,
        help="answer each case N times, flights in another order: does the answer change?",
    )
    _jobs(parser)
    return parser


def _blind_score(actions: _Commands) -> argparse.ArgumentParser:
    text = "Open the key, and say how good the answers are."
    parser: argparse.ArgumentParser = actions.add_parser(
        "score", help=text, description=text, allow_abbrev=False
    )
    parser.add_argument("folder", metavar="CASES", type=Path, help="folder that make wrote")
    parser.add_argument("answers", metavar="ANSWERS", type=Path, help="folder that run wrote")
    parser.add_argument(
        "--secret",
        metavar="WORD",
        required=True,
        action="append",
        dest="secrets",
        help="that of make, or its seed; again for every folder of --also that has another",
    )
    parser.add_argument(
        "--also",
        metavar=("CASES", "ANSWERS"),
        nargs=2,
        type=Path,
        action="append",
        default=[],
        help="further cases with their answers, scored together with these; as often as wanted",
    )
    parser.add_argument(
        "--out", metavar="DIR", type=Path, help="folder of the score; ANSWERS if left out"
    )
    return parser


def _jobs(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--jobs", metavar="N", type=count, default=os.cpu_count() or 1, help="cases at a time"
    )


def _output(parser: argparse.ArgumentParser) -> None:
    """The output options again, behind the action; left out, those before it count."""
    group = parser.add_argument_group("output")
    for name, text in (
        ("--json", "print one JSON document instead"),
        ("--quiet", "print nothing but errors and warnings"),
        ("--traceback", "show where an error arose"),
    ):
        group.add_argument(name, action="store_true", default=argparse.SUPPRESS, help=text)
