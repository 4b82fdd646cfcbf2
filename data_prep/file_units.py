"""Units that a file itself names, in or below its header: what the configuration leaves open."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from data_prep.log import AuditEntry
from data_prep.logs_config import ENGINE
from data_prep.units import find_unit, named_unit
from narxcal.channels import CHANNELS
from narxcal.errors import ConfigError, DataError

if TYPE_CHECKING:
    from data_prep.logs_config import ColumnSource, LogsConfig
    from data_prep.mapping import Table

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
