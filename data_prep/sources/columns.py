"""The columns of a file as channels of its engines, in canonical units.

A unit comes from the configuration, else from the file itself: a row of units below or above the
header, or brackets that end a column's name. One that is not understood is never passed over.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from data_prep.config import ENGINE, ColumnSource, LogsConfig
from data_prep.drafting.naming import is_designation
from data_prep.log import AuditEntry
from data_prep.sources.csv_source import Counts, Pace, Words
from data_prep.sources.text_file import Head
from data_prep.sources.units import (
    Unit,
    find_unit,
    is_no_unit,
    is_volume_flow,
    litres_per_hour,
    named_unit,
    to_canonical,
)
from narxcal.channels import described
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError, DataError

_SHOWN = 12  # names of columns in a message
_SEARCHED = 1000  # columns among which a misspelt one is looked for
_NO_UNIT = ("", "-", "rpm")  # a speed in revolutions has a scale
_BRACKETS_AT_END = re.compile(r"[\[({<]([^][(){}<>]+)[])}>]\s*$")


class Table(Protocol):
    """A file of named columns.

    `header` are the column names in file order, `head` the lines above the first row, `clock` the
    column that holds clock times or dates ("" for none), `hourly` whether that shows minutes and
    seconds alone, so that it starts anew each hour, `tabular` whether the rows look like those of
    a log; else no message quotes the file. `counts` are the rows and cells read so far that were
    left out or blanked, by column (`*`: rows), action and reason; `truncated`: the file broke off
    within a row, which was left out.
    """

    path: Path
    header: tuple[str, ...]
    head: Head
    clock: str
    hourly: bool
    tabular: bool
    counts: Counts
    truncated: bool

    def blocks(
        self, names: Sequence[str], pace: Pace | None = None, words: Words | None = None
    ) -> Iterator[dict[str, FloatArray]]:
        """Columns as float64 `(rows,)`, NaN where blank, in blocks of rows.

        Those of `words` may hold words, each with a function that gives their number.
        """


def map_columns(table: Table, config: LogsConfig) -> dict[str, dict[str, str]]:
    """Engine -> channel -> column, for every column that `table` has.

    Raises `DataError` for a file that is no log, and for a column that is configured, not optional
    and not there.
    """
    sources = config.sources(table.header)
    if config.time_column not in table.header and not table.tabular:
        raise DataError(
            f"the file is no log: it has no column '{config.time_column}' and hardly any numbers",
            file=table.path,
            hint="Expected a header and rows of numbers; [logs] files names the files to read",
        )
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
    column = " ".join(source.column.replace(ENGINE, engine[1]).split())
    if column in table.header or not column:
        return column
    if source.optional and name != "time_s":
        return ""
    if ENGINE in source.column and not any(engine[1] in known for known in table.header):
        raise DataError(
            f"no column name holds the prefix '{engine[1]}' of engine '{engine[0]}'",
            file=table.path,
            channel=name,
            hint=_prefixes(source.column, table.header),
        )
    hint = _near(column, table.header)
    if name != "time_s":
        hint = f"{_sentence(hint)} Where a file may lack it: optional = true"
    raise DataError(f"column '{column}' is missing", file=table.path, channel=name, hint=hint)


def _sentence(hint: str) -> str:
    return hint if hint.endswith("?") else f"{hint}."


def _near(column: str, header: tuple[str, ...]) -> str:
    near = difflib.get_close_matches(column, header[:_SEARCHED], n=3, cutoff=0.5)
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
    """Convert cells as they stand in the file to channel `name` in its canonical unit."""
    if (source.scale, source.offset) != (1.0, 0.0):
        with np.errstate(over="ignore"):  # an infinity is counted on the grid
            cells = cells * source.scale + source.offset
    unit = described(name).unit if source.unit is None else source.unit
    with np.errstate(over="ignore"):
        return to_canonical(cells, find_unit(unit, name))


def constants(sources: Mapping[str, ColumnSource]) -> dict[str, float]:
    """Channels that the configuration gives a value instead of a column."""
    return {
        name: source.constant for name, source in sources.items() if source.constant is not None
    }


def sources_of(table: Table, config: LogsConfig) -> dict[str, ColumnSource]:
    """Channel -> source, with the unit that the file names where the configuration gives none.

    The file's unit is that in its row of units or, without such a row, in brackets that end the
    column's name. `unit`, `scale` and `offset` of the configuration take precedence.

    Raises `DataError` for a unit that is not known or not one of the channel.
    """
    sources = config.sources(table.header)
    for name, source in sources.items():
        text = _unit_text(table, config, name, source)
        volume = (text and _is_open(source) and text) or source.unit or ""
        if source.density_kgpl is not None and is_volume_flow(volume):
            scale = source.scale * litres_per_hour(volume) * source.density_kgpl
            sources[name] = source.model_copy(update={"unit": "kg/h", "scale": scale})
        elif text and _is_open(source):
            sources[name] = source.model_copy(update={"unit": _unit(table, name, text)})
    return sources


def head_entries(table: Table, config: LogsConfig, rows: int) -> tuple[AuditEntry, ...]:
    """Account for the lines above the first of `rows` rows, in an audit."""
    entries = [
        AuditEntry("*", "dropped", "line above the header", table.head.above),
        AuditEntry("*", "dropped", "row of units", int(bool(table.head.units))),
        AuditEntry("*", "dropped", "row of types or codes below the header", table.head.below),
    ]
    for name, source in config.sources(table.header).items():
        named = named_unit(_unit_text(table, config, name, source))
        own = described(name).unit if source.unit is None else source.unit
        if named in _NO_UNIT or find_unit(own, name) == _or_none(named, name):
            continue
        reason = f"unit of the configuration, where the {_place(table)} says {named}"
        if _is_open(source):
            reason = f"{named}, as its {_place(table)} says"
        entries.append(AuditEntry(name, "repaired", reason, rows))
    return tuple(entries)


def _is_open(source: ColumnSource) -> bool:
    """Whether the configuration leaves the unit to the file."""
    return source.unit is None and (source.scale, source.offset) == (1.0, 0.0)


def _place(table: Table) -> str:
    return "row of units" if table.head.units else "header"


def _unit_text(table: Table, config: LogsConfig, name: str, source: ColumnSource) -> str:
    """What stands in the file as the unit of channel `name`; engines share it."""
    if not source.column or source.column == table.clock:
        return ""
    prefixes = (config.engines or {"": ""}).values()
    columns = [source.column.replace(ENGINE, prefix) for prefix in prefixes]
    texts = [unit_text(table, column, name) for column in columns if column in table.header]
    if len(set(map(named_unit, texts))) > 1:
        raise DataError(
            f"the {_place(table)} says {' and '.join(map(repr, texts))} of the engines' columns",
            file=table.path,
            hint=f"Set the unit of column '{source.column}' in [logs.columns]",
        )
    return texts[0] if texts else ""


def unit_text(table: Table, column: str, name: str) -> str:
    """Return what stands in the file as the unit of a column: in a row, or brackets that end it.

    Brackets around an engine or another word of a column's name are none, nor is a letter that is
    no unit of channel `name`. `HP` is a unit of powers alone.
    """
    if table.head.units:
        text = table.head.units[table.header.index(column)]
        return "" if is_no_unit(text) else text
    found = _BRACKETS_AT_END.search(column)
    text = found[1].strip() if found else ""
    fits = named_unit(text) and _or_none(named_unit(text), name)
    other = len(text) == 1 and not fits
    part_of_name = is_designation(text) and not (fits and len(text) > 1)
    return "" if other or is_no_unit(text) or part_of_name else text


def _unit(table: Table, name: str, text: str) -> str:
    hint = f"Say what it is in [logs.columns]: unit of {name}, or scale and offset"
    unit = named_unit(text)
    if not unit or _or_none(unit, name) is None:
        what = "is not known" if not unit else f"does not fit {described(name).unit}"
        if is_volume_flow(text):
            what = "is a flow of volume"
            hint = f"Set density_kgpl of {name} in [logs.columns]: kg of fuel in a litre, about 0.8"
        problem = f"the {_place(table)} says '{text}', which {what}"
        raise DataError(problem, file=table.path, channel=name, hint=hint)
    return unit


def _or_none(unit: str, name: str) -> Unit | None:
    try:
        return find_unit(unit, name)
    except ConfigError:
        return None
