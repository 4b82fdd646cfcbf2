"""Draft a configuration from logs alone: each line with its evidence, or a question.

What a file or a name says is taken. A unit that neither says is taken where the data exclude all
others: by the highest value of a running engine, or by the air data, which agree with each other in
one set of units alone. Whatever is left stays open: `"?"`, which no command runs with.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path

import numpy as np

from data_prep.binary_source import open_binary
from data_prep.columns import Table, unit_text
from data_prep.config import ENGINE, LogsConfig
from data_prep.csv_source import readable
from data_prep.derive import filled, units_that_agree
from data_prep.log_file import open_table
from data_prep.naming import PER_MINUTE, Reading, declarable, fits, read_name
from data_prep.text_file import DELIMITERS, fields, first_lines, has_content, open_text
from data_prep.units import find_unit, is_volume_flow, named_unit, to_canonical
from data_prep.words import code_words, switch
from narxcal.channels import CHANNELS, SPOOLS, described
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import DataError
from narxcal.support.settings import OPEN

_BLOCKS = 20  # of 50,000 rows that are looked at
_LINES = 50  # in which a header is looked for
_FEWEST = 2  # names of channels in a header, and values of a channel
# In which units a channel is recorded, and between which values (canonical) the highest one of a
# recording of a running engine lies.
_UNITS: Mapping[str, tuple[str, ...]] = {
    "N1_pct": ("%", "-"),
    "N2_pct": ("%", "-"),
    "EGT_C": ("degC", "K", "degF", "degR"),
    "FF_kgph": ("kg/h", "lb/h", "kg/s", "lb/s"),
    "ALT_ft": ("ft", "m"),
    "CAS_kt": ("kt", "km/h", "m/s", "mph"),
    "TAS_kt": ("kt", "km/h", "m/s", "mph"),
    "SAT_C": ("degC", "K", "degF"),
    "TAT_C": ("degC", "K", "degF"),
    "FN_kN": ("kN", "N", "lbf"),
}
_HIGHEST: Mapping[str, tuple[float, float]] = {
    "N1_pct": (20.0, 125.0),
    "N2_pct": (45.0, 125.0),
    "EGT_C": (300.0, 1150.0),
    "FF_kgph": (5.0, 20000.0),
    "SAT_C": (-60.0, 55.0),
    "TAT_C": (-60.0, 80.0),
}
_TEMPERATURES = ("temperature", "difference")
_AIR = ("ALT_ft", "CAS_kt", "TAS_kt", "SAT_C", "TAT_C")
# Recorders sample an engine's channels at these rates, and run for so long.
_RATES_HZ = (0.5, 100.0)
_LENGTHS_S = (30.0, 86400.0)
_TIME_UNITS = ("s", "ms", "us", "min", "h")
_LEVER = (5.0, 120.0)  # highest value of a lever that needs no scale
_EITHER_WAY = ("air", "squat")  # in the name of a switch that may be on in flight
# Columns that are no channel, of two lines each: with the 21 of `CHANNELS`, and 20 lines of other
# tables, a draft is one page of 66 lines.
_MOST_OTHERS = 12
_PROPORTIONAL = 0.02  # by which two columns of one speed may differ
_Keys = dict[str, str | float | bool]


@dataclass(frozen=True)
class Line:
    """One channel of [logs.columns]: its keys, and why they are so.

    `assumed` is the value of an open scale with which the logs are looked at.
    """

    channel: str
    keys: _Keys
    why: str
    assumed: float = 1.0

    def __str__(self) -> str:
        """Return the line in TOML."""
        keys = ", ".join(
            f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in self.keys.items()
        )
        return f"{self.channel} = {{ {keys} }}  # {self.why}"


@dataclass(frozen=True)
class Draft:
    """Columns and engines of a recorder's files, as far as they follow from the first of them.

    `unused` are columns that may be channels and were not taken, with the reason; `others` those
    that are no channel of the table and may be declared; `unknown` those whose name says nothing.
    """

    lines: tuple[Line, ...]
    engines: Mapping[str, str]
    unused: Mapping[str, str] = field(default_factory=dict)
    others: tuple[Line, ...] = ()
    unknown: tuple[str, ...] = ()

    def logs(self, **keys: object) -> LogsConfig:
        """Return the table [logs] in which what is open is left as recorded, to look at the logs.

        A speed whose scale is open gets 100 at its highest.
        """
        columns = {}
        for line in self.lines:
            known = {key: value for key, value in line.keys.items() if value != OPEN}
            if "column" not in known:
                continue
            for key in ("scale", "density_kgpl"):
                if line.keys.get(key) == OPEN:
                    known[key] = line.assumed
            if line.keys.get("unit") == OPEN:
                known["unit"] = CHANNELS[line.channel].unit
            columns[line.channel] = known
        return LogsConfig.parse({**keys, "engines": dict(self.engines), "columns": columns})

    def where_there(self, headers: Sequence[Sequence[str]]) -> Draft:
        """Return the same with columns that one of the headers lacks as optional."""
        marks = list(self.engines.values()) or [""]

        def lacking(line: Line) -> bool:
            column = str(line.keys.get("column", ""))
            names = [column.replace(ENGINE, mark) for mark in marks]
            return any(name not in header for header in headers for name in names)

        lines = [
            replace(line, keys={**line.keys, "optional": True})
            if line.channel != "time_s" and lacking(line)
            else line
            for line in self.lines
        ]
        return replace(self, lines=tuple(lines))


def draft(paths: Sequence[Path]) -> Draft:
    """Draft the columns and engines of files of any format that narxcal reads, by the first one.

    What another file lacks becomes optional. Raises `DataError` for a file that cannot be read, or
    none of whose columns is of an engine.
    """
    path = paths[0]
    table, time = _open(path)
    readings = {
        column: reading
        for column in table.header
        if (reading := read_name(column, unit_text(table, column, "")))
        and (reading.channel != "time_s" or column == time)
    }
    if not any(CHANNELS[each.channel].role == "output" for each in readings.values()):
        raise DataError(
            "no column has the name of an engine's channel",
            file=path,
            hint=f"Write [logs.columns] by hand. The file has {', '.join(table.header[:12])}",
        )
    found = _Drafting(table, readings, _values(table, list(readings))).draft()
    return found.where_there([table.header, *(_open(each)[0].header for each in paths[1:])])


def _open(path: Path) -> tuple[Table, str]:
    """Open a file whose columns are not mapped, and find its column of time; "" for none."""
    binary = open_binary(path, "")
    if binary:
        time = ("" if binary.rated else _time_of(binary.header)) or "time_s"
    else:
        with readable(path), open_text(path) as text:
            time = _time_of(_header(first_lines(text, _LINES)))
    known = {"columns": {"time_s": {"column": time}}} if time else {}
    return open_table(path, LogsConfig.parse(known)), time


def _header(lines: Sequence[str]) -> tuple[str, ...]:
    """Return the cells of the line that names most channels; () where none names two."""
    best: tuple[int, tuple[str, ...]] = (_FEWEST - 1, ())
    for line in (line for line in lines if has_content(line, "")):
        for delimiter in (*DELIMITERS, " "):
            cells = fields(line.lstrip("#"), delimiter)
            named = sum(read_name(cell) is not None for cell in cells)
            best = max(best, (named, cells), key=lambda each: each[0])
    return best[1]


def _time_of(header: Sequence[str]) -> str:
    """Return the first column that is named as time; "" for none."""
    found = ((name, read_name(name)) for name in header)
    return next((name for name, read in found if read and _is_time(read)), "")


def _is_time(reading: Reading) -> bool:
    return reading.channel == "time_s" and reading.unit not in ("hour", "min")


def _values(table: Table, names: Sequence[str]) -> dict[str, FloatArray]:
    """Return the first rows of columns, without code words; words of switches are 0 and 1."""
    words = dict.fromkeys(names, switch)
    words.pop(table.clock, None)
    blocks = list(islice(table.blocks(names, words=words), _BLOCKS))
    if not blocks:
        raise DataError("no rows follow the header", file=table.path)
    found = {name: np.concatenate([block[name] for block in blocks]) for name in names}
    for name, values in found.items():
        for word in code_words(values):
            found[name] = np.where(word.rows(found[name]), np.nan, found[name])
    return found


def _high(values: FloatArray, quantile: float = 0.999) -> float:
    known = values[np.isfinite(values)]
    return float(np.quantile(known, quantile)) if len(known) else float("nan")


@dataclass
class _Drafting:
    """Draws up the lines of one file."""

    table: Table
    readings: dict[str, Reading]
    values: dict[str, FloatArray]
    unused: dict[str, str] = field(default_factory=dict)

    def draft(self) -> Draft:
        marks = self._engines()
        chosen = self._chosen(marks)
        lines = [self._time(chosen.pop("time_s", []))]
        if not any(CHANNELS[name].role == "output" for name in chosen if name in CHANNELS):
            why = "; ".join(f"{name}: {text}" for name, text in self.unused.items())
            raise DataError(
                "no column of an engine channel can be used", file=self.table.path, hint=why
            )
        air = self._air({name: chosen[name][0] for name in _AIR if name in chosen})
        commands = chosen.pop("command", [])
        if "TRA_deg" not in chosen and commands:
            lines.append(self._lever(commands))
        for name in (each for each in CHANNELS if each in chosen):
            line = self._line(name, chosen[name], air)
            if line:
                lines.append(line)
        engines = {_engine_name(mark): mark for mark in marks}
        others = self._others(marks)
        own = [str(line.keys["column"]) for line in others]
        named = {each.replace(ENGINE, mark) for each in own for mark in marks or [""]}
        named |= self.readings.keys()
        unknown = tuple(each for each in self.table.header if each.strip() and each not in named)
        return Draft(tuple(lines), engines, self.unused, others, unknown)

    def _others(self, marks: Collection[str]) -> tuple[Line, ...]:
        """Return lines of columns that are no channel, and have a unit of an engine's quantity."""
        found: dict[str, Line] = {}
        for column in self.table.header:
            said = unit_text(self.table, column, "")
            known = None if column in self.readings else declarable(column, said, marks)
            if known and known[0] not in found and len(found) < _MOST_OTHERS:
                name, template, unit = known
                cells = to_canonical(_values(self.table, [column])[column], find_unit(unit, name))
                seen = f"{_high(cells, 0.001):.4g} to {_high(cells):.4g} {described(name).unit}"
                found[name] = Line(name, {"column": template, "unit": unit}, seen)
        return tuple(found.values())

    def _engines(self) -> tuple[str, ...]:
        """Return the marks of engines that most templates of engine channels share."""
        of: dict[str, set[str]] = {}
        for reading in self.readings.values():
            if reading.engine and CHANNELS[reading.channel].role in ("output", "lever"):
                of.setdefault(reading.template, set()).add(reading.engine)
        counts = Counter(tuple(sorted(marks)) for marks in of.values())
        return max(counts, key=lambda marks: (counts[marks], len(marks)), default=())

    def _chosen(self, marks: Sequence[str]) -> dict[str, list[str]]:
        """Channel -> its columns, that of the best template first; `command`: demanded speeds."""
        templates: dict[str, dict[str, list[str]]] = {}
        for column, reading in self.readings.items():
            role = CHANNELS[reading.channel].role
            if reading.engine and reading.engine not in marks:
                self.unused[column] = "another way of marking engines"
            elif marks and not reading.engine and role == "output":
                self.unused[column] = "of no single engine"
            elif reading.command and reading.channel not in SPOOLS:
                self.unused[column] = "a demanded value"
            elif role != "switch" and len(np.unique(_finite(self.values[column]))) < _FEWEST:
                self.unused[column] = "without a value that changes"
            elif reading.channel == "time_s" and not (_is_time(reading) and self._rises(column)):
                self.unused[column] = "stamps that do not rise"
            else:
                key = "command" if reading.command else reading.channel
                templates.setdefault(key, {}).setdefault(reading.template, []).append(column)
        return {name: self._best(name, found) for name, found in templates.items()}

    def _rises(self, column: str) -> bool:
        steps = np.diff(self.values[column][np.isfinite(self.values[column])])
        return bool(len(steps) and np.mean(steps >= 0.0) > 0.99 and steps.max() > 0.0)

    def _best(self, name: str, templates: Mapping[str, list[str]]) -> list[str]:
        """Return the columns of the template whose name leaves least doubt.

        A percentage of speed is proportional to revolutions: one that is not gives way to them.
        """
        ranked = sorted(templates.values(), key=lambda each: self.readings[each[0]].doubt)
        if name in (*SPOOLS, "command"):
            turns = [each for each in ranked if named_unit(self._unit(each[0])) == PER_MINUTE]
            shares = [each for each in ranked if each not in turns]
            if turns and shares and not self._proportional(turns[0][0], shares[0][0]):
                ranked = [*turns, *shares]
        for others in ranked[1:]:
            what = "demanded" if name == "command" else name
            self.unused.update(dict.fromkeys(others, f"{what} is '{ranked[0][0]}'"))
        return ranked[0]

    def _proportional(self, first: str, second: str) -> bool:
        x, y = self.values[first], self.values[second]
        both = np.isfinite(x) & np.isfinite(y)
        slope = np.sum(x[both] * y[both]) / max(np.sum(x[both] ** 2), 1e-300)
        away = np.abs(y[both] - slope * x[both])
        return bool(np.quantile(away, 0.9) <= _PROPORTIONAL * _high(np.abs(y)))

    def _unit(self, column: str) -> str:
        """Return what the file or the name says of a unit."""
        reading = self.readings[column]
        said = unit_text(self.table, column, reading.channel) or reading.unit
        # Degrees of temperature are those of any scale.
        scale = find_unit(CHANNELS[reading.channel].unit, reading.channel).dimension
        return "" if named_unit(said) == "deg" and scale in _TEMPERATURES else said

    def _time(self, columns: Sequence[str]) -> Line:
        if not columns:
            raise DataError(
                "no column that rises has the name of a time",
                file=self.table.path,
                channel="time_s",
                hint=f"Rename it time. The file has {', '.join(self.table.header[:8])}",
            )
        column = columns[0]
        if column == self.table.clock or (self.table.head.units and not self._unit(column)):
            return Line("time_s", {"column": column}, "clock times, dates or rates")
        said = self._unit(column)
        if said and fits(said, "time_s"):
            return Line("time_s", {"column": column, "unit": named_unit(said)}, f"says '{said}'")
        possible = [unit for unit in _TIME_UNITS if self._usual_time(column, unit)]
        if possible == ["s"]:
            why = "no unit is given; any other but s gives no recorder's rate"
            return Line("time_s", {"column": column, "unit": "s"}, why)
        why = (
            f"in which unit? Rows are {self._own_interval(column):.4g} apart. One that is none of "
            "s, ms, min: scale instead, as 0.125 for eighths of a second"
        )
        return Line("time_s", {"column": column, "unit": OPEN}, why)

    def _usual_time(self, column: str, unit: str) -> bool:
        to_s = find_unit(unit, "time_s").scale
        own, length = self._own_interval(column) * to_s, np.ptp(_finite(self.values[column])) * to_s
        rate = 1.0 / max(own, 1e-12)
        return bool(_within(rate, _RATES_HZ) and _within(float(length), _LENGTHS_S))

    def _own_interval(self, column: str) -> float:
        """Return the longest interval of an output's cells, blanks left out."""
        time = self.values[column]
        found = [0.0]
        for name, reading in self.readings.items():
            filled = np.isfinite(self.values[name]) & np.isfinite(time)
            if CHANNELS[reading.channel].role == "output" and filled.sum() > 1:
                found.append(float(np.median(np.diff(time[filled]))))
        return max(found)

    def _lever(self, columns: Sequence[str]) -> Line:
        scale = _lever_scale(_high(self.values[columns[0]]))
        why = "there is no lever; a demanded speed takes its place, at any scale"
        return Line("TRA_deg", {**self._column(columns), "scale": scale, "unit": "deg"}, why)

    def _column(self, columns: Sequence[str]) -> _Keys:
        return {"column": self.readings[columns[0]].template}

    def _line(self, name: str, columns: Sequence[str], air: Mapping[str, str]) -> Line | None:
        """Return the line of a channel; None for a switch that is none."""
        if CHANNELS[name].role == "switch":
            return self._switch(name, columns)
        if name == "TRA_deg":
            return self._own_lever(columns)
        keys, said = self._column(columns), self._unit(columns[0])
        low, high = self._range(columns)
        seen = f"{low:.4g} to {high:.4g}"
        if named_unit(said) == PER_MINUTE or (name in SPOOLS and high > 2.0 * _HIGHEST[name][1]):
            why = f"100 / (rpm at 100 %); {seen}, so 100 % at the highest would be {100 / high:.6g}"
            return Line(name, {**keys, "scale": OPEN}, why, 100.0 / high)
        if said or name not in _UNITS:
            return _as_said(name, keys, said, seen)
        possible = [air[name]] if name in air else self._possible(name, columns)
        if len(possible) == 1:
            what = "the air data" if name in air else "a running engine"
            why = f"no other unit fits {what}; {seen}"
            return Line(name, {**keys, "unit": possible[0]}, why)
        wanted = " or ".join(possible or _UNITS[name])
        if name in SPOOLS:
            wanted += " or, of revolutions, scale = 100 / (those at 100 %)"
        return Line(name, {**keys, "unit": OPEN}, f"{wanted}? It is {seen}")

    def _range(self, columns: Sequence[str]) -> tuple[float, float]:
        values = np.concatenate([self.values[column] for column in columns])
        return _high(values, 0.001), _high(values)

    def _possible(self, name: str, columns: Sequence[str]) -> list[str]:
        """Return the units in which the highest value of a running engine, and all, are usual."""
        low, high = self._range(columns)
        possible = []
        for unit in _UNITS[name]:
            least, most = to_canonical(np.array([low, high]), find_unit(unit, name))
            bounds = _HIGHEST.get(name, (CHANNELS[name].low, CHANNELS[name].high))
            if least >= CHANNELS[name].low - 1.0 and _within(float(most), bounds):
                possible.append(unit)
        return possible

    def _own_lever(self, columns: Sequence[str]) -> Line:
        keys, said = self._column(columns), self._unit(columns[0])
        low, high = self._range(columns)
        if said and fits(said, "TRA_deg"):
            return _as_said("TRA_deg", keys, said, f"{low:.4g} to {high:.4g}")
        most = max(abs(low), abs(high))
        if not _within(most, _LEVER) or low < CHANNELS["TRA_deg"].low:
            keys["scale"] = _lever_scale(most)
        why = f"any scale of the lever does; {low:.4g} to {high:.4g} {said}".rstrip()
        return Line("TRA_deg", {**keys, "unit": "deg"}, why)

    def _switch(self, name: str, columns: Sequence[str]) -> Line | None:
        values = np.concatenate([self.values[column] for column in columns])
        states = np.unique(values[np.isfinite(values)])
        if not np.isin(states, (0.0, 1.0)).all():
            text = ", ".join(f"{each:g}" for each in states[:4])
            self.unused.update(dict.fromkeys(columns, f"{name} is 0 or 1, not {text}"))
            return None
        keys = {**self._column(columns), "unit": "0/1", "optional": True}
        if name != "WOW":
            return Line(name, keys, "0 and 1, or words for them; 1 is on")
        fast, slow = self._speeds(columns[0])
        if fast < slow:
            return Line(name, keys, "1 is on the ground, at low airspeed")
        if not np.isfinite(fast - slow):
            if not any(word in columns[0].casefold() for word in _EITHER_WAY):
                return Line(name, keys, "1 is on the ground, by its name")
            why = "1 if 1 is on the ground; -1 if it is in flight, and then offset = 1"
            return Line(name, {**keys, "scale": OPEN}, why)
        why = "1 is in flight: it is 1 at high airspeed"
        return Line(name, {**keys, "scale": -1.0, "offset": 1.0}, why)

    def _speeds(self, switch_column: str) -> tuple[float, float]:
        """Mean of a switch at high and at low airspeed; NaN where there is none."""
        for column, reading in self.readings.items():
            if reading.channel in ("CAS_kt", "TAS_kt", "Mach"):
                rows = np.arange(0.0, len(self.values[column]))
                speed, state = (filled(self.values[each], rows) for each in (column, switch_column))
                middle = 0.5 * (_high(speed, 0.001) + _high(speed))
                if (speed > middle).any() and (speed < middle).any():
                    return float(state[speed > middle].mean()), float(state[speed < middle].mean())
        return float("nan"), float("nan")

    def _air(self, columns: Mapping[str, str]) -> dict[str, str]:
        """Return the units in which alone the air data agree, by channel."""
        said = {name: self._unit(column) for name, column in columns.items()}
        possible = {
            name: (named_unit(said[name]),) if fits(said[name], name) else _UNITS[name]
            for name in columns
        }
        air = {name: self.values[column] for name, column in columns.items()}
        mach = [each for each, read in self.readings.items() if read.channel == "Mach"]
        return units_that_agree(
            {**air, **({"Mach": self.values[mach[0]]} if mach else {})}, possible
        )


def _as_said(name: str, keys: _Keys, said: str, seen: str) -> Line:
    """Return the line of a channel whose unit the file or the name says."""
    if not said:
        return Line(name, keys, f"has no unit; {seen}")
    if is_volume_flow(said):
        why = f"'{said}': kg of fuel in a litre, about 0.8"
        return Line(name, {**keys, "density_kgpl": OPEN}, why, 0.8)
    if not fits(said, name):
        return Line(name, {**keys, "unit": OPEN}, f"the file says '{said}', which is not known")
    return Line(name, {**keys, "unit": named_unit(said)}, f"says '{said}'; {seen}")


def _finite(values: FloatArray) -> FloatArray:
    return values[np.isfinite(values)]


def _within(value: float, bounds: tuple[float, float]) -> bool:
    return bounds[0] <= value <= bounds[1]


def _lever_scale(high: float) -> float:
    """Return the power of ten that brings the highest value of a lever to between 10 and 100."""
    return float(10.0 ** (2.0 - np.ceil(np.log10(max(high, 1e-9)) - 1e-3)))


def _engine_name(mark: str) -> str:
    """Name an engine by its mark: `lh` is left, `1` is engine1."""
    names = {"l": "left", "r": "right"}
    return names.get(mark[0].casefold(), f"engine{mark}") if not mark.isdigit() else f"engine{mark}"
