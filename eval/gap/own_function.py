"""A simulator that is a user's own Python function, `module:function`.

Whatever it does ends in one sentence, and what it prints goes to stderr: stdout is the command's.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from data_prep.log import Log
from narxcal.channels import CHANNELS
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError, ModelError, NarxcalError

_TAKES = "It takes ({channel: (time,)}, dt_s) and returns {channel: (time,)}"
_Told = Mapping[str, FloatArray]


def open_function(reference: str) -> Callable[[Log], _Told]:
    """Import `module:function`, installed or in the current folder, as a simulator of logs.

    Raises `ConfigError` where there is none; the simulator raises `ModelError` where the function
    fails or returns anything but channels of the log's length.
    """
    module_name, _, name = reference.partition(":")
    with _its_failures(ConfigError, f"simulator '{reference}' cannot be imported"):
        module = _module(module_name, reference)
    function = getattr(module, name, None)
    if not callable(function):
        place = getattr(module, "__file__", None) or module_name
        raise ConfigError(f"simulator '{reference}': the module has no function '{name}' ({place})")

    def simulate(log: Log) -> _Told:
        told = {each: v.copy() for each, v in log.channels.items() if each in CHANNELS}
        what = f"simulator '{reference}' failed"
        with _its_failures(ModelError, what, file=log.name, hint=_TAKES):
            found = dict(function(told, log.dt_s))
            arrays = {each: np.array(v, dtype=np.float64) for each, v in found.items()}
        for each, values in arrays.items():
            if values.shape != (len(log),):
                raise ModelError(
                    f"simulator '{reference}' returned {values.shape}, expected ({len(log)},)",
                    file=log.name,
                    channel=each,
                )
        return arrays

    return simulate


def _module(name: str, reference: str) -> ModuleType:
    """Import a module; the current folder comes last, so that a file there hides nothing."""
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.append(here)
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        lost = (error.name or name).replace(".", "/")
        raise ConfigError(
            f"simulator '{reference}': {error}", hint=f"Install it, or put {lost}.py into {here}"
        ) from None


@contextmanager
def _its_failures(kind: type[NarxcalError], what: str, **where: Any) -> Iterator[None]:
    """Turn whatever a user's code raises, an exit included, into one of our errors."""
    try:
        with redirect_stdout(sys.stderr):
            yield
    except NarxcalError:
        raise
    except (Exception, SystemExit) as error:
        raise kind(f"{what}: {type(error).__name__}: {error}", **where) from error
