"""The words of the command line: commands, options and their help."""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import NoReturn, TypeAlias

from narxcal.cli import gap_arguments
from narxcal.cli.values import count, fraction, seed
from narxcal.support.errors import ConfigError

_EPILOG = """\
exit codes: 0 good, 1 a tolerance was missed, 2 bad input or configuration,
3 internal error (NARXCAL_TRACEBACK=1 shows where), 130 interrupted.
--json prints one JSON document to stdout and nothing else.
"""


class _Parser(argparse.ArgumentParser):
    """Reports a bad command line as every other bad input: in one line, exit code 2."""

    def error(self, message: str) -> NoReturn:
        raise ConfigError(message, hint=f"See {self.prog} --help")


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """Parse a command line; raises `ConfigError` for a bad one, `SystemExit` after `--help`."""
    return _parser().parse_args(arguments)


def _parser() -> _Parser:
    parser = _Parser(
        prog="narxcal",
        description="Calibrates the dynamics of a steady-state turbofan model from flight logs.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"narxcal {_version()}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for add in (
        _demo,
        _prepare,
        _train,
        _evaluate,
        _crossval,
        _replay,
        _simulate,
        _info,
        _denoise,
        _fly,
        _reproduce,
        _export,
        gap_arguments.diagnose,
        gap_arguments.blind,
    ):
        _common(add(commands))
    return parser


# argparse keeps the type of its sub-commands to itself.
_Commands: TypeAlias = "argparse._SubParsersAction[_Parser]"  # noqa: SLF001


def _command(commands: _Commands, name: str, text: str) -> argparse.ArgumentParser:
    return commands.add_parser(name, help=text, description=text, allow_abbrev=False)


def _common(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("output")
    group.add_argument("--json", action="store_true", help="print one JSON document instead")
    group.add_argument("--quiet", action="store_true", help="print nothing but errors and warnings")
    group.add_argument("--traceback", action="store_true", help="show where an error arose")


def _config(parser: argparse.ArgumentParser, out: str, text: str) -> None:
    """What every command that starts from a configuration takes."""
    parser.add_argument("config", metavar="CONFIG", help="TOML file, or a shipped one's name")
    parser.add_argument("--out", metavar=out, type=Path, required=True, help=text)
    _data(parser, "folder of the logs, instead of the configuration's")


def _data(parser: argparse.ArgumentParser, text: str) -> None:
    parser.add_argument(
        "--data",
        metavar="DIR",
        type=Path,
        default=os.environ.get("NARXCAL_DATA") or None,
        help=f"{text} (or set NARXCAL_DATA)",
    )


def _jobs(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--jobs", metavar="N", type=count, default=os.cpu_count() or 1, help="folds at a time"
    )


def _bundle(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("bundle", metavar="RUN", type=Path, help="folder that train wrote")


def _logs(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--logs",
        metavar="FILE",
        type=Path,
        nargs="+",
        action="extend",
        help="logs to use instead of the held-out ones; read by RUN's column mapping",
    )


def _demo(commands: _Commands) -> argparse.ArgumentParser:
    parser = _command(
        commands, "demo", "Fly the virtual engine, train on it, evaluate; needs no files."
    )
    parser.add_argument("--out", metavar="DIR", type=Path, default=Path("demo_run"), help="folder")
    return parser


def _prepare(commands: _Commands) -> argparse.ArgumentParser:
    parser = _command(
        commands, "prepare", "Read, clean and smooth the logs; find events, rank channels."
    )
    _config(parser, "DIR", "folder for the prepared logs, tables and page")
    return parser


def _train(commands: _Commands) -> argparse.ArgumentParser:
    parser = _command(
        commands,
        "train",
        "Calibrate a model. Ctrl-C keeps the best network so far and ends well.",
    )
    _config(parser, "RUN", "folder for the model")
    parser.add_argument("--resume", action="store_true", help="go on with a training cut short")
    return parser


def _evaluate(commands: _Commands) -> argparse.ArgumentParser:
    parser = _command(
        commands, "evaluate", "Judge a model in free run over whole logs, and its Ti and Tt."
    )
    _bundle(parser)
    _logs(parser)
    parser.add_argument(
        "--trim",
        metavar="FRACTION",
        type=fraction,
        help="estimate offsets from this first part of each log, score the rest",
    )
    parser.add_argument("--out", metavar="DIR", type=Path, help="folder (default RUN/evaluate)")
    _data(parser, "folder of the held-out logs, if they have moved")
    return parser


def _crossval(commands: _Commands) -> argparse.ArgumentParser:
    parser = _command(
        commands, "crossval", "Leave one flight out, and ten random 7:3 splits by event."
    )
    _config(parser, "DIR", "folder for the tables and the page")
    _jobs(parser)
    return parser


def _replay(commands: _Commands) -> argparse.ArgumentParser:
    parser = _command(commands, "replay", "Stream a log through model and fuser, sample by sample.")
    _bundle(parser)
    parser.add_argument("log", metavar="LOG.csv", type=Path, help="log, read by RUN's mapping")
    parser.add_argument("--out", metavar="OUT.csv", type=Path, required=True, help="CSV file")
    parser.add_argument("--engine", metavar="NAME", help="replay this engine only")
    parser.add_argument("--realtime", action="store_true", help="no faster than the clock")
    parser.add_argument(
        "--follow",
        action="store_true",
        help="wait for growth until none came for 10 s; rows in OUT.part",
    )
    return parser


def _simulate(commands: _Commands) -> argparse.ArgumentParser:
    parser = _command(
        commands, "simulate", "Free run over a file of inputs, or over a folder with found effects."
    )
    parser.add_argument(
        "bundle", metavar="RUN", type=Path, nargs="?", help="folder that train wrote"
    )
    parser.add_argument(
        "inputs",
        metavar="INPUTS.csv",
        type=Path,
        nargs="?",
        help="inputs, by RUN's mapping or canonical",
    )
    parser.add_argument(
        "--out", metavar="OUT", type=Path, required=True, help="CSV file; folder with --effects"
    )
    gap_arguments.effects_of_simulate(parser)
    return parser


def _info(commands: _Commands) -> argparse.ArgumentParser:
    parser = _command(commands, "info", "Say what a model is and where it comes from.")
    _bundle(parser)
    return parser


def _denoise(commands: _Commands) -> argparse.ArgumentParser:
    parser = _command(
        commands, "denoise", "The paper's noise experiment: raw, fused and free run against SNR."
    )
    _bundle(parser)
    _logs(parser)
    parser.add_argument("--out", metavar="DIR", type=Path, required=True, help="folder")
    parser.add_argument("--channel", metavar="NAME", help="default N2_pct, or the first output")
    _data(parser, "folder of the held-out logs, if they have moved")
    return parser


def _reproduce(commands: _Commands) -> argparse.ArgumentParser:
    parser = _command(
        commands, "reproduce", "A paper's tables and figures, our numbers beside its claims."
    )
    parser.add_argument("paper", metavar="PAPER", choices=("narx-paper",), help="narx-paper")
    parser.add_argument("--out", metavar="DIR", type=Path, required=True, help="folder")
    parser.add_argument(
        "--config", metavar="CONFIG", default="narx_paper.toml", help="default narx_paper.toml"
    )
    _data(parser, "folder of your own data sets, instead of virtual flights")
    parser.add_argument("--seed", metavar="N", type=seed, default=0, help="of the virtual flights")
    parser.add_argument("--quick", action="store_true", help="few steps and two divisions")
    _jobs(parser)
    return parser


def _fly(commands: _Commands) -> argparse.ArgumentParser:
    parser = _command(commands, "fly", "Fly the virtual engine and write what its recorder saw.")
    parser.add_argument("config", metavar="CONFIG", help="TOML file, or a shipped one's name")
    parser.add_argument(
        "--out", metavar="DIR", type=Path, required=True, help="folder for the logs"
    )
    parser.add_argument(
        "--effects",
        metavar="EFFECT",
        nargs="+",
        action="extend",
        help="effects instead of CONFIG's, as spool_lag:factor=1.3,sensor_lag@EGT_C:tau_s=1.5, "
        "or none",
    )
    parser.add_argument("--sensors", metavar="PRESET", help="sensors instead of CONFIG's")
    parser.add_argument("--seed", metavar="N", type=seed, help="seed instead of CONFIG's")
    parser.add_argument("--flights", metavar="N", type=count, help="flights instead of CONFIG's")
    parser.add_argument("--gzip", action="store_true", help="write .csv.gz")
    parser.add_argument(
        "--truth-channels", action="store_true", help="write the outputs no sensor sees, too"
    )
    parser.add_argument(
        "--jobs", metavar="N", type=count, default=os.cpu_count() or 1, help="flights at a time"
    )
    return parser


def _export(commands: _Commands) -> argparse.ArgumentParser:
    parser = _command(commands, "export", "Write a steady-state model as a table or an FMU.")
    parser.add_argument(
        "source",
        metavar="SOURCE",
        help="run folder, table (.csv), FMU, module:function, or a virtual engine's name",
    )
    parser.add_argument("--to", choices=("table", "fmu"), required=True, help="what to write")
    parser.add_argument(
        "--out", metavar="FILE", type=Path, required=True, help=".csv, .csv.gz or .fmu"
    )
    parser.add_argument("--fmi", choices=("2.0", "3.0"), default="2.0", help="default 2.0")
    parser.add_argument(
        "--tolerance", metavar="PCT", type=float, default=0.5, help="of each range (default 0.5)"
    )
    parser.add_argument(
        "--max-rows", metavar="N", type=count, default=100_000, help="default 100000"
    )
    parser.add_argument(
        "--nodes",
        metavar="NAME=NODES",
        nargs="+",
        action="extend",
        help="nodes to have, as ALT_ft=0,36089,43000 or dT_C=-30:30:7; one node fixes an input",
    )
    parser.add_argument("--no-refine", action="store_true", help="add no nodes")
    parser.add_argument("--strict", action="store_true", help="write nothing beyond the tolerance")
    parser.add_argument("--inputs", metavar="NAME", nargs="+", help="where SOURCE names none")
    parser.add_argument("--outputs", metavar="NAME", nargs="+", help="where SOURCE names none")
    return parser


def _version() -> str:
    try:
        return version("narxcal")
    except PackageNotFoundError:  # run from a checkout that is not installed
        return "unknown"
