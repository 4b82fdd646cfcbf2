"""Runs a command and turns every end it can have into one line and an exit code.

0    good
1    a validation failed: a tolerance was missed, an alarm stands
2    bad input, configuration or bundle, or the disk refused the output
3    an error of narxcal itself
130  interrupted (Ctrl-C) with nothing written; `train` keeps its best network and ends well
141  whoever read the output (`| head`) went away
143  ended by SIGTERM, which is handled as Ctrl-C
"""

from __future__ import annotations

import argparse
import logging
import os
import socket
import sys
import traceback
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import NoReturn

from narxcal.cli.options import add_output
from narxcal.support.errors import ConfigError, NarxcalError, printable
from narxcal.support.interrupt import is_interrupt, safe_interrupt, terminated

GOOD, MISSED, BAD_INPUT, INTERNAL = 0, 1, 2, 3
INTERRUPTED, PIPE_CLOSED, TERMINATED = 130, 141, 143

# Each command is a module of its name with `add_options(parser)` and `run(options, console)`.
COMMANDS = {
    "demo": "Fly the virtual engine, train on it, evaluate; needs no files.",
    "init": "Draft a configuration from logs, with what is still to be filled in.",
    "prepare": "Read, clean and smooth the logs; find events, rank channels.",
    "train": "Calibrate a model. Ctrl-C keeps the best network so far and ends well.",
    "identify": "Calibrate by another method: output error, responses, subspace, static law.",
    "evaluate": "Judge a model in free run over whole logs, and its Ti and Tt.",
    "fleet": "Evaluate many logs into a dataset; goes on where it was interrupted.",
    "watch": "Find trends, steps and outliers of a fleet's engines over their flights.",
    "card": "Plan the lever moves to fly next, within the limits of an aircraft.",
    "compare": "Compare runs on the same held-out rows: one table, what is significant.",
    "qtg": "The qualification test guide: one sheet a test, as a PDF for an authority.",
    "crossval": "Leave one flight out, and ten random 7:3 splits by event.",
    "replay": "Stream a log through model and fuser, sample by sample.",
    "simulate": "Free run over a file of inputs, or over a folder with found effects.",
    "info": "Describe a model and where it comes from.",
    "fly": "Fly the virtual engine and write what its recorder measured.",
    "reproduce": "A paper's tables and figures, our numbers next to its claims.",
    "export": "Write a steady-state model as a table or an FMU.",
    "benchmark": "One recipe on public system-identification sets, with published figures.",
    "diagnose": "Find where simulator and flights differ, by which effect, and how far it shrinks.",
    "blind": "Make cases whose effect is withheld, answer them without the key, score with it.",
}
_EPILOG = """\
exit codes: 0 good, 1 a tolerance was missed or an alarm stands, 2 bad input or
configuration, 3 internal error (NARXCAL_TRACEBACK=1 shows where), 130 interrupted,
141 nobody read the output, 143 terminated.
--json prints one JSON document to stdout and nothing else.
"""


class _Parser(argparse.ArgumentParser):
    """Reports a bad command line as every other bad input: in one line, exit code 2."""

    def error(self, message: str) -> NoReturn:
        raise ConfigError(message, hint=f"See {self.prog} --help")


class _Version(argparse.Action):
    """Shows the version; it is looked up then, as that takes longer than all of the help."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        from importlib.metadata import PackageNotFoundError, version  # noqa: PLC0415

        try:
            found = version("narxcal")
        except PackageNotFoundError:  # run from a checkout that is not installed
            found = "unknown"
        sys.stdout.write(f"narxcal {found}\n")
        parser.exit()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `narxcal ARGUMENTS` (those of the process if None); returns the exit code."""
    given = sys.argv[1:] if arguments is None else list(arguments)
    # Our matrices are small: threads of the numerical libraries, which are counted at their import,
    # would only wait for each other and for our own.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    try:
        with safe_interrupt():
            code = _run(parse(given))
            sys.stdout.flush()
    except BrokenPipeError:
        _drop_stdout()
        return PIPE_CLOSED
    except KeyboardInterrupt as stop:
        return _interrupted(str(stop))
    except Exception as error:  # noqa: BLE001 -- the roof: nothing above could still report it
        if is_interrupt(error):
            return _interrupted("")
        if "--traceback" in given or os.environ.get("NARXCAL_TRACEBACK", "") not in ("", "0"):
            traceback.print_exc()
        return _report(error)
    return TERMINATED if terminated() else code


def parse(arguments: Sequence[str]) -> argparse.Namespace:
    """Parse a command line; raises `ConfigError` for a bad one, `SystemExit` after `--help`."""
    return parser_of(next((word for word in arguments if word in COMMANDS), "")).parse_args(
        arguments
    )


def parser_of(command: str) -> argparse.ArgumentParser:
    """Parser of the command line, with the options of `command` alone.

    Only that command's module is imported: `--help` must not wait for all of them.
    """
    parser = _Parser(
        prog="narxcal",
        description="Calibrates the dynamics of a steady-state turbofan model from flight logs.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, text in COMMANDS.items():
        own = commands.add_parser(name, help=text, description=text, allow_abbrev=False)
        if name == command:
            import_module(f"narxcal.cli.{name}").add_options(own)
            add_output(own)
    return parser


def _run(options: argparse.Namespace) -> int:
    console = import_module("narxcal.cli.console").Console(json=options.json, quiet=options.quiet)
    warnings = logging.Handler(logging.WARNING)
    warnings.emit = lambda record: console.warn(record.getMessage())  # type: ignore[method-assign]
    logging.getLogger("narxcal").addHandler(warnings)
    try:
        module = import_module(f"narxcal.cli.{options.command}")
        with _alone(module, options), _cluster(options):
            code: int = module.run(options, console)
    finally:
        logging.getLogger("narxcal").removeHandler(warnings)
    return code


@contextmanager
def _cluster(options: argparse.Namespace) -> Iterator[None]:
    """Compute on the cluster of --scheduler or --workers, where the command has them."""
    where = getattr(options, "scheduler", None), getattr(options, "workers", None)
    if where == (None, None):
        yield
        return
    from narxcal.support.parallel import cluster  # noqa: PLC0415 -- help does not wait for joblib

    with cluster(*where):
        yield


@contextmanager
def _alone(module: ModuleType, options: argparse.Namespace) -> Iterator[None]:
    """Let no two commands write one output; raises `ConfigError` before any work."""
    from narxcal.support.files import in_place  # noqa: PLC0415 -- help does not wait for numpy

    out = getattr(options, "out", None)
    if out is None and hasattr(module, "default_output"):
        out = module.default_output(options)
    with ExitStack() as stack:
        if isinstance(out, Path) and not in_place(out):  # an address elsewhere can't be locked
            with suppress(OSError):  # the command says what is wrong with the place
                stack.enter_context(locked(out))
        yield


@contextmanager
def locked(target: Path) -> Iterator[None]:
    """Keep other processes that lock it from writing to `target` while the block runs.

    The lock is a file next to the target, `.NAME.lock`, that names process and machine; where its
    folder does not exist, next to the first one above that does not either.

    It ends with the process, however that ends; locks of network file systems may not hold.
    Raises `ConfigError` if another process has it, and `OSError` if it cannot be written.
    """
    from filelock import FileLock, Timeout  # noqa: PLC0415 -- help does not wait for it

    folder = Path(os.path.realpath(target))
    while not folder.parent.exists():
        folder = folder.parent
    file = folder.with_name(f".{folder.name}.lock")
    lock = FileLock(file, blocking=False)
    try:
        lock.acquire()
    except Timeout:
        owner = file.read_text(encoding="utf-8", errors="replace").strip()
        raise ConfigError(
            f"{target} is being written by another command (process {owner or 'unknown'})",
            hint="Wait for it to end, or choose another name",
        ) from None
    try:
        file.write_text(f"{os.getpid()} on {socket.gethostname()}\n", encoding="utf-8")
        yield
    finally:
        try:
            with suppress(OSError):  # Windows removes no open file
                file.unlink()  # before the release, so that nobody locks what is about to go
        finally:
            lock.release()


def _interrupted(state: str) -> int:
    text = f"interrupted; {state or 'nothing was written'}"
    return _end(text, TERMINATED if terminated() else INTERRUPTED)


def _report(error: Exception) -> int:
    if isinstance(error, OSError):
        _drop_stdout()
    # Before 3.13 `Path.resolve` reports a loop of links by a RuntimeError.
    loop = isinstance(error, RuntimeError) and "Symlink loop" in str(error)
    if isinstance(error, (NarxcalError, OSError)) or loop:
        return _end(f"error: {_one_line(error)}", BAD_INPUT)
    what = f"{type(error).__name__}: {_one_line(error)}"
    hint = "Set NARXCAL_TRACEBACK=1 or add --traceback to see where, and report it"
    return _end(f"internal error: {what}. {hint}", INTERNAL)


def _end(text: str, code: int) -> int:
    sys.stderr.write(f"narxcal: {printable(text)}\n")
    return code


def _one_line(error: BaseException) -> str:
    if isinstance(error, OSError) and not isinstance(error, NarxcalError) and error.strerror:
        place = f"{error.filename}: " if error.filename else ""
        return f"{place}{error.strerror}"
    return " ".join(str(error).split())


def _drop_stdout() -> None:
    """Discard what stdout still buffers: the interpreter would fail on it once more at its end."""
    with suppress(OSError), Path(os.devnull).open("w", encoding="utf-8") as nowhere:
        os.dup2(nowhere.fileno(), sys.stdout.fileno())
