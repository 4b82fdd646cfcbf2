"""Units that a file itself names, in a row below its header: what the configuration leaves open."""

from __future__ import annotations

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


def sources_of(table: Table, config: LogsConfig) -> dict[str, ColumnSource]:
    """Channel -> source, with the unit that the file names where the configuration says nothing.

    What the configuration says (`unit`, `scale`, `offset`) stands against the file.

    Raises `DataError` for a unit that is not known or not one of the channel.
    """
    sources = config.sources(table.header)
    return {
        name: source.model_copy(update={"unit": _unit(table, name, told)})
        if (told := _told(table, config, source)) and _open(source)
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
        told = named_unit(_told(table, config, source))
        own = CHANNELS[name].unit if source.unit is None else source.unit
        if told in _SAYS_NOTHING or find_unit(own, name) == _or_none(told, name):
            continue
        if _open(source):
            entries.append(AuditEntry(name, "repaired", f"{told}, as its row of units says", rows))
        else:
            reason = f"unit of the configuration, where the row of units says {told}"
            entries.append(AuditEntry(name, "repaired", reason, rows))
    return tuple(entries)


def _open(source: ColumnSource) -> bool:
    """Whether the configuration says nothing of the unit."""
    return source.unit is None and (source.scale, source.offset) == (1.0, 0.0)


def _told(table: Table, config: LogsConfig, source: ColumnSource) -> str:
    """What the row of units says of a column; engines share it."""
    if not table.head.units or not source.column or source.column == table.clock:
        return ""
    prefixes = (config.engines or {"": ""}).values()
    columns = [source.column.replace(ENGINE, prefix) for prefix in prefixes]
    held = [name for name in columns if name in table.header]
    told = [table.head.units[table.header.index(name)] for name in held]
    if len(set(map(named_unit, told))) > 1:
        raise DataError(
            f"the row of units says {' and '.join(map(repr, told))} of the engines' columns",
            file=table.path,
            hint=f"Set the unit of column '{source.column}' in [logs.columns]",
        )
    return "" if not told or told[0] in _SAYS_NOTHING else told[0]


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
