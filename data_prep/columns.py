"""Which column of a file is which channel of which engine, and help when one is not there.

Units that a file itself names, in or below its header: what the configuration leaves open.
"""

from __future__ import annotations

import difflib
from typing import TYPE_CHECKING, Protocol

import numpy as np

from data_prep.config import ENGINE, ColumnSource, LogsConfig
from data_prep.units import find_unit, to_canonical
from narxcal.channels import CHANNELS
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from data_prep.text_file import Head
import re
from typing import TYPE_CHECKING

from data_prep.log import AuditEntry
from data_prep.units import named_unit
from narxcal.support.errors import ConfigError

if TYPE_CHECKING:
    from data_prep.config import ColumnSource, LogsConfig

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


_SAYS_NOTHING = ("", "-")
_BRACKETS_AT_END = re.compile(r"[\[({<]([^][(){}<>]+)[])}>]\s*$")
_RIGHT = "r"  # the right engine of [L] and [R], no degree Rankine


def sources_of(table: Table, config: LogsConfig) -> dict[str, ColumnSource]:
    """Channel -> source, with the unit that the file names where the configuration says nothing.

    That is a row of units, or where there is none brackets that end the column's name. What the
    configuration says (`unit`, `scale`, `offset`) stands against the file.

    Raises `DataError` for a unit that is not known or not one of the channel.
    """
    sources = config.sources(table.header)
    return {
        name: source.model_copy(update={"unit": _unit(table, name, told)})
        if (told := _told(table, config, name, source)) and _open(source)
        else source
        for name, source in sources.items()
    }


def head_entries(table: Table, config: LogsConfig, rows: int) -> tuple[AuditEntry, ...]:
    """What was done with the lines above the first of `rows` rows, for the audit."""
    entries = [
        AuditEntry("*", "dropped", "line above the header", table.head.above),
        AuditEntry("*", "dropped", "row of units", int(bool(table.head.units))),
    ]
    for name, source in config.sources(table.header).items():
        told = named_unit(_told(table, config, name, source))
        own = CHANNELS[name].unit if source.unit is None else source.unit
        if told in _SAYS_NOTHING or find_unit(own, name) == _or_none(told, name):
            continue
        if _open(source):
            reason = f"{told}, as its {_place(table)} says"
            entries.append(AuditEntry(name, "repaired", reason, rows))
        else:
            reason = f"unit of the configuration, where the {_place(table)} says {told}"
            entries.append(AuditEntry(name, "repaired", reason, rows))
    return tuple(entries)


def _open(source: ColumnSource) -> bool:
    """Whether the configuration says nothing of the unit."""
    return source.unit is None and (source.scale, source.offset) == (1.0, 0.0)


def _place(table: Table) -> str:
    return "row of units" if table.head.units else "header"


def _told(table: Table, config: LogsConfig, name: str, source: ColumnSource) -> str:
    """What the file says of the unit of channel `name`; engines share it."""
    if not source.column or source.column == table.clock:
        return ""
    prefixes = (config.engines or {"": ""}).values()
    columns = [source.column.replace(ENGINE, prefix) for prefix in prefixes]
    told = [_told_of(table, name, column) for column in columns if column in table.header]
    if len(set(map(named_unit, told))) > 1:
        raise DataError(
            f"the {_place(table)} says {' and '.join(map(repr, told))} of the engines' columns",
            file=table.path,
            hint=f"Set the unit of column '{source.column}' in [logs.columns]",
        )
    return "" if not told or told[0] in _SAYS_NOTHING else told[0]


def _told_of(table: Table, name: str, column: str) -> str:
    if table.head.units:
        return table.head.units[table.header.index(column)]
    found = _BRACKETS_AT_END.search(column)
    told = found[1].strip() if found else ""
    # Much stands in brackets: only what names a unit of this very channel is taken for one.
    unit = "" if told.isdigit() or told.casefold() == _RIGHT else named_unit(told)
    return told if unit and _or_none(unit, name) else ""


def _unit(table: Table, name: str, told: str) -> str:
    hint = f"Say what it is in [logs.columns]: unit of {name}, or scale and offset"
    unit = named_unit(told)
    if not unit or _or_none(unit, name) is None:
        what = "is not known" if not unit else f"does not fit {CHANNELS[name].unit}"
        problem = f"the row of units below the header says '{told}', which {what}"
        raise DataError(problem, file=table.path, channel=name, hint=hint)
    return unit


def _or_none(unit: str, name: str) -> object:
    try:
        return find_unit(unit, name)
    except ConfigError:
        return None
