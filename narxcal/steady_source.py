"""Opens the maker's steady-state model from what a configuration says about it."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path

from pydantic import Field

from narxcal.errors import ConfigError
from narxcal.settings import Section
from narxcal.steady_callable import SteadyCallable
from narxcal.steady_csv import read_steady_table
from narxcal.steady_fmu import FmuOptions, SteadyFmu
from narxcal.steady_state import SteadyStateModel
from narxcal.steady_table import Method


class SteadySourceOptions(Section):
    """What differs between the kinds, all optional.

    `method` of a table's interpolation; `ranges` `{input: (low, high)}`, the envelope of a
    callable or an FMU; `variables` `{channel: name in the FMU}`; `settle_s`, how long an FMU
    is run before it is read.
    """

    method: Method = "linear"
    ranges: dict[str, tuple[float, float]] = Field(default_factory=dict)
    variables: dict[str, str] = Field(default_factory=dict)
    settle_s: float = Field(default=1.0, gt=0.0)


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
