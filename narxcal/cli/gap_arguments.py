"""The words of the commands that deal with the gap between simulator and flights."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, TypeAlias

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
