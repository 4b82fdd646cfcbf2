"""Opens the maker's steady-state model from what a configuration says about it."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path

from narxcal.steady.fmu import FmuOptions, SteadyFmu
from narxcal.steady.function import SteadyCallable
from narxcal.steady.model import SteadyStateModel
from narxcal.steady.options import SteadySourceOptions
from narxcal.steady.table import read_steady_table
from narxcal.support.errors import ConfigError

__all__ = ["SteadySourceOptions", "open_steady"]


def open_steady(
    kind: str,
    source: str,
    names: tuple[Sequence[str], Sequence[str]],
    folder: str | PathLike[str] = ".",
    options: SteadySourceOptions | None = None,
) -> SteadyStateModel:
    """Open `source` as `kind` "table" (a CSV file), "callable" (`module:function`) or "fmu".

    `names` are the input and output channels; files and modules are looked for relative to
    `folder`. Raises `ConfigError`, `DataError` or `ModelError` as the kind itself does.
    """
    chosen = options or SteadySourceOptions()
    path = Path(folder) / source
    if kind == "table":
        return read_steady_table(path, *names, chosen.method)
    if kind == "callable":
        return SteadyCallable.load(source, names, chosen.ranges, folder)
    if kind == "fmu":
        given = chosen.model_dump(include=set(FmuOptions.model_fields))
        return SteadyFmu(path, names, FmuOptions.parse(given))
    raise ConfigError(
        f"unknown kind of steady-state source '{kind}'", hint="Use table, callable or fmu"
    )
