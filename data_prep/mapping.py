"""Which column of a file is which channel of which engine, and help when one is not there."""

from __future__ import annotations

import difflib
from typing import TYPE_CHECKING, Protocol

import numpy as np

from data_prep.logs_config import ENGINE, ColumnSource, LogsConfig
from data_prep.units import find_unit, to_canonical
from narxcal.channels import CHANNELS
from narxcal.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from data_prep.head import Head
    from data_prep.log import FloatArray

_SHOWN = 12


class Table(Protocol):
    """A file of named columns."""

    path: Path

    @property
    def header(self) -> tuple[str, ...]:
        """Column names in file order."""

    @property
    def head(self) -> Head:
        """What stands above the first row."""

    @property
    def clock(self) -> str:
        """The column that holds clock times or dates; empty for none."""

    @property
    def hourly(self) -> bool:
        """Whether the clock holds minutes and seconds alone, so that it starts anew each hour."""

    def blocks(self, names: Sequence[str]) -> Iterator[dict[str, FloatArray]]:
        """Columns as float64 `(rows,)`, NaN where blank, in blocks of rows."""


def read_columns(table: Table, names: Sequence[str]) -> dict[str, FloatArray]:
    """Whole columns `(rows,)` of a table that memory can hold; raises as its `blocks` do."""
    pieces: dict[str, list[FloatArray]] = {name: [np.empty(0)] for name in names}
    for block in table.blocks(names):
        for name, values in block.items():
            pieces[name].append(values)
    # Popped one by one, so that pieces and whole columns never all exist at once.
    return {name: np.concatenate(pieces.pop(name)) for name in names}


def map_columns(table: Table, config: LogsConfig) -> dict[str, dict[str, str]]:
    """Engine -> channel -> column, for every column that `table` has.

    Raises `DataError` for a column that is configured, not optional and not there.
    """
    sources = config.sources(table.header)
    if "time_s" not in sources:
        hint = f"{_sentence(_near('time_s', table.header))} Or map the columns under [logs.columns]"
        raise DataError("column 'time_s' is missing", file=table.path, hint=hint)
    if set(sources) == {"time_s"} and not config.columns:
        raise DataError(
            "no column but 'time_s' is named as a channel",
            file=table.path,
            hint=f"Map the columns under [logs.columns]. {_listed(table.header)}",
        )
    engines = config.engines or {"": ""}
    return {
        engine: {
            name: column
            for name, source in sources.items()
            if (column := _column(table, name, source, (engine, prefix)))
        }
        for engine, prefix in engines.items()
    }


def _column(table: Table, name: str, source: ColumnSource, engine: tuple[str, str]) -> str:
    column = source.column.replace(ENGINE, engine[1])
    if column in table.header or not column:
        return column
    if source.optional:
        return ""
    if ENGINE in source.column and not any(engine[1] in known for known in table.header):
        raise DataError(
            f"no column name holds the prefix '{engine[1]}' of engine '{engine[0]}'",
            file=table.path,
            channel=name,
            hint=_prefixes(source.column, table.header),
        )
    raise DataError(
        f"column '{column}' is missing",
        file=table.path,
        channel=name,
        hint=f"{_sentence(_near(column, table.header))} Where a file may lack it: optional = true",
    )


def _sentence(hint: str) -> str:
    return hint if hint.endswith("?") else f"{hint}."


def _near(column: str, header: tuple[str, ...]) -> str:
    near = difflib.get_close_matches(column, header, n=3, cutoff=0.5)
    if near:
        return f"Did you mean {' or '.join(repr(name) for name in near)}?"
    return _listed(header)


def _listed(header: tuple[str, ...]) -> str:
    more = ", ..." if len(header) > _SHOWN else ""
    return f"The file has {', '.join(header[:_SHOWN])}{more}"


def _prefixes(template: str, header: tuple[str, ...]) -> str:
    head, _, tail = template.partition(ENGINE)
    fits = [name for name in header if name.startswith(head) and name.endswith(tail)]
    prefixes = [name[len(head) : len(name) - len(tail)] for name in fits]
    if not any(prefixes):
        return _near(template.replace(ENGINE, ""), header)
    return f"Prefixes in the file: {', '.join(repr(prefix) for prefix in prefixes if prefix)}"


def to_channel(name: str, cells: FloatArray, source: ColumnSource) -> FloatArray:
    """Cells as the file holds them -> channel `name` in its canonical unit."""
    if (source.scale, source.offset) != (1.0, 0.0):
        with np.errstate(over="ignore"):  # an infinity is accounted for on the raster
            cells = cells * source.scale + source.offset
    unit = CHANNELS[name].unit if source.unit is None else source.unit
    with np.errstate(over="ignore"):
        return to_canonical(cells, find_unit(unit, name))


def constants(sources: Mapping[str, ColumnSource]) -> dict[str, float]:
    """Channels that the configuration gives a value instead of a column."""
    return {
        name: source.constant for name, source in sources.items() if source.constant is not None
    }
