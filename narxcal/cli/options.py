"""Options that several commands share, and the values that options take."""

from __future__ import annotations

import math
import os
import sys
from argparse import SUPPRESS, ArgumentParser, ArgumentTypeError, _ArgumentGroup
from collections.abc import Callable
from pathlib import Path

# A parser, or a group of its options with a title of their own.
Options = ArgumentParser | _ArgumentGroup
SIMULATOR = "folder of simulated logs, run folder, FMU, module:function or virtual engine's name"
# numpy seeds its generators with any whole number, torch with 64 bits, signed.
_LARGEST_SEED = 2**63 - 1
# No machine has more processors, and no list of cases is longer.
_LARGEST_COUNT = 1_000_000


# --- values ---


def path(text: str) -> Path:
    if not text or "\0" in text:
        raise ArgumentTypeError(f"expected a file or folder, found {text!r}")
    return Path(text)


def address(text: str) -> Path | str:
    """Folder of this machine as a path, any other fsspec address as it is."""
    plain = text.removeprefix("file://")
    return plain if "://" in plain else path(plain).absolute()


def _between(low: float, high: float, what: str) -> Callable[[str], float]:

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            raise ArgumentTypeError(f"expected {what}, found {text}")
        return value

    return read


# Of `--trim`: the rest has to be long enough to score.
fraction = _between(0.0, 0.9, "a fraction from 0 to 0.9")
minutes = _between(1.0, 600.0, "1 to 600 minutes")
seconds = _between(sys.float_info.min, math.inf, "more than 0 s")


def level(text: str) -> float:
    """Share of samples that an interval covers, as `--interval` takes it."""
    from narxcal.intervals import LEVELS  # noqa: PLC0415 -- help does not wait for numpy

    low, high = LEVELS[0], LEVELS[-1]
    return _between(low, high, f"a share from {low} to {high}")(text)


def add_interval(parser: Options, default: float | None = None) -> None:
    shown = "" if default is None else f" (default {default:g})"
    parser.add_argument(
        "--interval",
        metavar="SHARE",
        type=level,
        default=default,
        help=f"columns X_low and X_high, between which this share of samples lies{shown}",
    )


def count(text: str) -> int:
    return _whole(text, 1, _LARGEST_COUNT)


def seed(text: str) -> int:
    """Whole number of 0 or more, from which random numbers are drawn."""
    return _whole(text, 0, _LARGEST_SEED)


def _whole(text: str, least: int, most: int) -> int:
    try:
        value = int(text)
    except ValueError:
        value = least - 1
    if value < least:
        raise ArgumentTypeError(f"expected a whole number of {least} or more, found {text[:40]}")
    if value > most:
        raise ArgumentTypeError(f"expected a whole number of at most {most}, found {text[:40]}")
    return value


# --- options ---


def add_config(parser: ArgumentParser, out: str, text: str) -> None:
    """CONFIG, --out and --data: what every command takes that starts from a configuration."""
    parser.add_argument("config", metavar="CONFIG", help="TOML file, or a shipped one's name")
    parser.add_argument("--out", metavar=out, type=path, required=True, help=text)
    add_data(parser, "folder of the logs, instead of the configuration's")


def add_method(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--method",
        metavar="METHOD",
        help="output-error, transfer, subspace, static:NAME or narx, instead of [identify]",
    )


def add_data(parser: ArgumentParser, text: str) -> None:
    """--data, or NARXCAL_DATA."""
    parser.add_argument(
        "--data",
        metavar="DIR",
        type=path,
        default=os.environ.get("NARXCAL_DATA") or None,
        help=f"{text} (or set NARXCAL_DATA)",
    )


def add_out(parser: ArgumentParser) -> None:
    parser.add_argument("--out", metavar="DIR", type=path, required=True, help="folder")


def add_out_file(parser: ArgumentParser, name: str, text: str) -> None:
    """--out and --overwrite of a command that writes one file, or two of one name."""
    parser.add_argument("--out", metavar=name, type=path, required=True, help=text)
    parser.add_argument("--overwrite", action="store_true", help="replace OUT if it exists")


def add_jobs(parser: ArgumentParser, what: str) -> None:
    """--jobs: how many of `what` at a time; --workers and --scheduler: on a Dask cluster."""
    parser.add_argument(
        "--jobs", metavar="N", type=count, default=os.cpu_count() or 1, help=f"{what} at a time"
    )
    place = parser.add_mutually_exclusive_group()
    place.add_argument(
        "--workers", metavar="N", type=count, help=f"{what} on N new Dask workers of this machine"
    )
    place.add_argument(
        "--scheduler", metavar="ADDRESS", help=f"{what} on the cluster of a Dask scheduler"
    )


def add_run(parser: ArgumentParser) -> None:
    parser.add_argument("bundle", metavar="RUN", type=path, help="folder that train wrote")
    add_trust(parser)


def add_trust(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--trust",
        action="store_true",
        help="allow a run whose steady-state model is a function or an FMU to execute it",
    )


def add_logs(parser: Options) -> None:
    """--logs: other logs than those of the run."""
    parser.add_argument(
        "--logs",
        metavar="FILE",
        type=path,
        nargs="+",
        action="extend",
        help="logs to use instead of the held-out ones; read by RUN's column mapping",
    )


def add_mapping(parser: ArgumentParser) -> None:
    parser.add_argument("--config", metavar="CONFIG", help="TOML file whose [logs] maps columns")


def add_output(parser: ArgumentParser, *, after_action: bool = False) -> None:
    """--json, --quiet and --traceback of every command.

    Where they stand again `after_action`, leaving them out keeps those before it.
    """
    group = parser.add_argument_group("output")
    default = SUPPRESS if after_action else False
    for name, text in (
        ("--json", "print one JSON document instead"),
        ("--quiet", "print nothing but errors and warnings"),
        ("--traceback", "show where an error arose"),
    ):
        group.add_argument(name, action="store_true", default=default, help=text)
