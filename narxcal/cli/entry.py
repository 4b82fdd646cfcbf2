"""Runs a command and turns every end it can have into one line and an exit code.

0    good
1    a validation failed: a tolerance was missed
2    bad input, configuration or bundle, or the disk refused the output
3    an error of narxcal itself
130  interrupted (Ctrl-C) with nothing written; `train` keeps its best network and ends well
141  whoever read the output (`| head`) went away
"""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from narxcal.cli.arguments import parse
from narxcal.support.errors import NarxcalError
from narxcal.support.interrupt import is_interrupt, safe_interrupt

if TYPE_CHECKING:
    from argparse import Namespace

GOOD, MISSED, BAD_INPUT, INTERNAL, INTERRUPTED, PIPE_CLOSED = 0, 1, 2, 3, 130, 141


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `narxcal ARGUMENTS` (those of the process if None); returns the exit code."""
    wants_traceback = _wants_traceback(sys.argv[1:] if arguments is None else arguments)
    try:
        with safe_interrupt():
            code = _run(parse(arguments))
            sys.stdout.flush()
    except BrokenPipeError:
        _drop_stdout()
        return PIPE_CLOSED
    except KeyboardInterrupt as stop:
        return _end(f"interrupted; {str(stop) or 'nothing was written'}", INTERRUPTED)
    except Exception as error:  # noqa: BLE001 -- the roof: nothing above could still report it
        if is_interrupt(error):
            return _end("interrupted; nothing was written", INTERRUPTED)
        if wants_traceback:
            traceback.print_exc()
        return _report(error)
    return code


def _report(error: Exception) -> int:
    if isinstance(error, OSError):
        _drop_stdout()
    if isinstance(error, (NarxcalError, OSError)):
        return _end(f"error: {_one_line(error)}", BAD_INPUT)
    what = f"{type(error).__name__}: {_one_line(error)}"
    hint = "Set NARXCAL_TRACEBACK=1 or add --traceback to see where, and report it"
    return _end(f"internal error: {what}. {hint}", INTERNAL)


def _run(options: Namespace) -> int:
    """Import the command's module only now: `--help` must not wait for PyTorch.

    Our matrices are small: threads of the numerical libraries, which are counted at their import,
    would only wait for each other and for our own.
    """
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    console = import_module("narxcal.cli.console").Console(json=options.json, quiet=options.quiet)
    code: int = import_module(f"narxcal.cli.{options.command}").run(options, console)
    return code


def _wants_traceback(arguments: Sequence[str]) -> bool:
    return "--traceback" in arguments or os.environ.get("NARXCAL_TRACEBACK", "") not in ("", "0")


def _end(text: str, code: int) -> int:
    sys.stderr.write(f"narxcal: {text}\n")
    return code


def _one_line(error: BaseException) -> str:
    if isinstance(error, OSError) and not isinstance(error, NarxcalError) and error.strerror:
        place = f"{error.filename}: " if error.filename else ""
        return f"{place}{error.strerror}"
    return " ".join(str(error).split())


def _drop_stdout() -> None:
    """Give up what stdout still holds: the interpreter would fail on it once more at its end."""
    with suppress(OSError), Path(os.devnull).open("w", encoding="utf-8") as nowhere:
        os.dup2(nowhere.fileno(), sys.stdout.fileno())
