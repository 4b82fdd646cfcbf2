"""Draft a configuration from logs alone: each line with its evidence, or a question.

What a file or a name says is taken. A unit that neither says is taken where the data exclude all
others: by the highest value of a running engine, or by the air data, which agree with each other in
one set of units alone. Whatever is left stays open: `"?"`, which no command runs with. So each file
of numbers gives a draft, be nothing in it known but the names of its columns.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path

import numpy as np

from data_prep.cleaning.words import code_words, switch
from data_prep.config import ENGINE, LogsConfig
from data_prep.derive import filled, units_that_agree
from data_prep.drafting.naming import PER_MINUTE, Reading, declarable, fits, read_name
from data_prep.sources.binary_source import ArraySource, open_binary
from data_prep.sources.columns import Table, unit_text
from data_prep.sources.csv_source import open_csv
from data_prep.sources.units import (
    find_unit,
    is_volume_flow,
    named_unit,
    to_canonical,
    usual_units,
)
from narxcal.channels import CHANNELS, SPOOLS, described
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import DataError
from narxcal.support.settings import OPEN, in_toml

_BLOCKS = 20  # of 50,000 rows that are looked at
_FEWEST = 2  # values of a channel
_ANY = 1e30  # a range that any value of a declared channel lies in
# Keys of [logs] that a file may leave open, and the values with which it is looked at.
_ASSUMED: Mapping[str, object] = {"dates": "DMY", "frames_hz": 25.0, "decimal": ","}
# Between which values (canonical) the highest one of a recording of a running engine lies.
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

    `assumed` is the value of an open key with which the logs are looked at.
    """

    channel: str
    keys: _Keys
    why: str
    assumed: float | str = ""

    def __str__(self) -> str:
        keys = ", ".join(f"{key} = {in_toml(value)}" for key, value in self.keys.items())
        return f"{self.channel} = {{ {keys} }}  # {self.why}"


@dataclass(frozen=True)
class Draft:
    """Columns and engines of a recorder's files, as far as they follow from the first of them.

    `unused` are columns that may be channels and were not taken, with the reason; `others` those
    that are no channel of the table and may be declared; `unknown` those whose name says nothing.
    `assumed` are keys of [logs] that are open, with the values with which the file was looked at.
    """

    lines: tuple[Line, ...]
    engines: Mapping[str, str]
    unused: Mapping[str, str] = field(default_factory=dict)
    others: tuple[Line, ...] = ()
    unknown: tuple[str, ...] = ()
    assumed: Mapping[str, object] = field(default_factory=dict)

    def logs(self, **keys: object) -> LogsConfig:
        """Return the table [logs] in which what is open is left as recorded, to look at the logs.

        A speed whose scale is open gets 100 at its highest.
        """
        columns = {}
        for line in (*self.lines, *self.others):
            if line.keys["column"] != OPEN:
                usual = {"unit": described(line.channel).unit, "scale": 1.0}
                columns[line.channel] = {
                    key: (line.assumed or usual[key]) if value == OPEN else value
                    for key, value in line.keys.items()
                }
        placed = any(ENGINE in str(each["column"]) for each in columns.values())
        tables = {
            "engines": dict(self.engines) if placed else {},
            "channels": {line.channel: {"range": (-_ANY, _ANY)} for line in self.others},
            "columns": columns,
        }
        return LogsConfig.parse({**self.assumed, **keys, **tables})

    def where_there(self, headers: Sequence[Sequence[str]]) -> Draft:
        """Return the same with columns that one of the headers lacks as optional."""
        marks = list(self.engines.values()) or [""]

        def lacking(line: Line) -> bool:
            column = str(line.keys.get("column", ""))
            names = [column.replace(ENGINE, mark) for mark in marks]
            return any(name not in header for header in headers for name in names)

        lines, others = (
            tuple(
                replace(line, keys={**line.keys, "optional": True})
                if line.channel != "time_s" and lacking(line)
                else line
                for line in some
            )
            for some in (self.lines, self.others)
        )
        return replace(self, lines=lines, others=others)


def draft(paths: Sequence[Path]) -> Draft:
    """Draft the columns and engines of files of any format that narxcal reads, by the first one.

    What another file lacks becomes optional. Raises `DataError` for a file that cannot be read.
    """
    unused: dict[str, str] = {}
    table, assumed, time = _open(paths[0], unused)
    readings = {
        column: reading
        for column in table.header
        if (reading := read_name(column, unit_text(table, column, "")))
        and (reading.channel != "time_s" or column == time)
    }
    values = _values(table, list(readings), unused)
    rows = [len(values[time])] if time else [*map(len, values.values())]
    usual = max(rows, key=rows.count, default=0)
    other = [name for name, own in values.items() if len(own) != usual]
    unused.update(dict.fromkeys(other, "of other rows than the others"))
    known = {name: each for name, each in readings.items() if name not in unused}
    found = _Drafting(table, known, values, unused).draft()
    headers = [table.header, *(_source(each, {}, "").header for each in paths[1:])]
    return replace(found, assumed=assumed).where_there(headers)


def _open(path: Path, unused: dict[str, str]) -> tuple[Table, dict[str, object], str]:
    """Open a file, with what it leaves open and its first column of stamps that rise, or "".

    Why others were not taken is added to `unused`.
    """
    table = _source(path, {}, "")
    if isinstance(table, ArraySource) and table.rated:
        return _source(path, {}, "time_s"), {}, "time_s"
    read = ((name, read_name(name, unit_text(table, name, "time_s"))) for name in table.header)
    for name in [name for name, each in read if each and _is_time(each)]:
        assumed: dict[str, object] = {}
        try:
            found = _source(path, assumed, name)
            stamps = _values(found, [name], unused)
        except DataError as error:
            unused[name] = error.problem
            continue
        if name in stamps and _rises(stamps[name]):
            return found, assumed, name
        unused.setdefault(name, "stamps that do not rise")
    return table, {}, ""


def _source(path: Path, assumed: dict[str, object], time: str) -> Table:
    """Open a file by its column of stamps, "" for none; a key that it leaves open is `assumed`."""
    columns = {"columns": {"time_s": {"column": time}}} if time else {}
    try:
        return open_binary(path, time) or open_csv(path, LogsConfig.parse({**assumed, **columns}))
    except DataError as error:
        asked = (key for key in _ASSUMED if f"[logs] {key}" in (error.hint or ""))
        key = next((each for each in asked if each not in assumed), None)
        if key is None:
            raise
        assumed[key] = _ASSUMED[key]
        return _source(path, assumed, time)


def _is_time(reading: Reading) -> bool:
    return reading.channel == "time_s" and reading.unit not in ("hour", "min")


def _rises(stamps: FloatArray) -> bool:
    steps = np.diff(stamps[np.isfinite(stamps)])
    return bool(len(steps) and np.mean(steps >= 0.0) > 0.99 and steps.max() > 0.0)


def _values(table: Table, names: Sequence[str], unused: dict[str, str]) -> dict[str, FloatArray]:
    """Return the first rows of columns, without code words; words of switches are 0 and 1.

    What cannot be read is `unused`, with the reason.
    """
    if not names:
        return {}
    words = dict.fromkeys(names, switch)
    words.pop(table.clock, None)
    try:
        blocks = list(islice(table.blocks(names, words=words), _BLOCKS))
    except DataError as error:
        bad = [name for name in names if name == error.channel] or [*names]
        if len(bad) == len(names) > 1:
            return {k: v for name in names for k, v in _values(table, [name], unused).items()}
        unused.update(dict.fromkeys(bad, error.problem))
        return _values(table, [name for name in names if name not in bad], unused)
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
    unused: dict[str, str]

    def draft(self) -> Draft:
        marks = self._engines()
        chosen = self._chosen(marks)
        lines = [self._time(chosen.pop("time_s", []))]
        air = self._air({name: chosen[name][0] for name in _AIR if name in chosen})
        commands = chosen.pop("command", [])
        if "TRA_deg" not in chosen and commands:
            lines.append(self._lever(commands))
        found = (self._line(name, chosen[name], air) for name in CHANNELS if name in chosen)
        lines += [line for line in found if line]
        engines = {_engine_name(mark): mark for mark in marks}
        others = self._others(marks)
        own = [str(line.keys["column"]) for line in others]
        named = {each.replace(ENGINE, mark) for each in own for mark in marks or [""]}
        named |= self.readings.keys() | self.unused.keys() | {self.table.clock}
        unknown = tuple(each for each in self.table.header if each.strip() and each not in named)
        return Draft(tuple(lines), engines, self.unused, others, unknown)

    def _others(self, marks: Collection[str]) -> tuple[Line, ...]:
        """Return lines of columns that are no channel, and have a unit of an engine's quantity."""
        known: dict[str, tuple[str, str, str]] = {}
        for column in self.table.header:
            said = unit_text(self.table, column, "")
            left = column not in self.readings and column not in self.unused
            found = declarable(column, said, marks) if left and len(known) < _MOST_OTHERS else None
            if found:
                known.setdefault(found[0], (column, *found[1:]))
        values = _values(self.table, [column for column, *_ in known.values()], self.unused)
        lines = []
        for name, (column, template, unit) in known.items():
            if column in values:
                cells = to_canonical(values[column], find_unit(unit, name))
                seen = f"{_high(cells, 0.001):.4g} to {_high(cells):.4g} {described(name).unit}"
                lines.append(Line(name, {"column": template, "unit": unit}, seen))
        return tuple(lines)

    def _engines(self) -> tuple[str, ...]:
        """Return the marks of engines that most templates of engine channels share.

        Temperatures alone show none: an engine has a probe at each cylinder or burner.
        """
        of: dict[str, set[str]] = {}
        for reading in self.readings.values():
            role = CHANNELS[reading.channel].role
            if reading.engine and role in ("output", "lever") and reading.channel != "EGT_C":
                of.setdefault(reading.template, set()).add(reading.engine)
        counts = Counter(tuple(sorted(marks)) for marks in of.values())
        return max(counts, key=lambda marks: (counts[marks], len(marks)), default=())

    def _chosen(self, marks: Sequence[str]) -> dict[str, list[str]]:
        """Channel -> its columns, that of the best template first; `command`: demanded speeds."""
        templates: dict[str, dict[str, list[str]]] = {}
        if not marks:  # of one engine, each column stands for itself
            alone = {name: each._replace(template=name) for name, each in self.readings.items()}
            self.readings = {name: each._replace(engine="") for name, each in alone.items()}
        for column, reading in self.readings.items():
            role = CHANNELS[reading.channel].role
            if reading.engine and reading.engine not in marks:
                self.unused[column] = "another way of marking engines"
            elif marks and not reading.engine and role == "output":
                self.unused[column] = "of no single engine"
            elif reading.command and reading.channel not in SPOOLS:
                self.unused[column] = "a demanded value"
            elif role in ("output", "lever") and self._stays(column):
                self.unused[column] = "without a value that changes"
            else:
                key = "command" if reading.command else reading.channel
                templates.setdefault(key, {}).setdefault(reading.template, []).append(column)
        return {name: self._best(name, found) for name, found in templates.items()}

    def _stays(self, column: str) -> bool:
        return len(np.unique(_finite(self.values[column]))) < _FEWEST

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
            why = "no column of stamps that rise has the name of a time; without any, add one in s"
            return Line("time_s", {"column": OPEN}, why)
        column = columns[0]
        if column == self.table.clock or (self.table.head.units and not self._unit(column)):
            return Line("time_s", {"column": column}, "clock times, dates or rates")
        said = self._unit(column)
        possible = [unit for unit in _TIME_UNITS if self._usual_time(column, unit)]
        # A name alone says little: the seconds of a `SecOfDay` are no days.
        doubtful = possible and said == self.readings[column].unit
        if fits(said, "time_s") and not (doubtful and named_unit(said) not in possible):
            return Line("time_s", {"column": column, "unit": named_unit(said)}, f"says '{said}'")
        if possible == ["s"]:
            why = "no unit is given; any other but s gives no recorder's rate"
            return Line("time_s", {"column": column, "unit": "s"}, why)
        why = (
            f"in which unit? Rows are {self._own_interval(column):.4g} apart. One that is none of "
            "s, ms, min: scale instead, as 0.125 for eighths of a second"
        )
        assumed = possible[0] if len(possible) == 1 else ""
        return Line("time_s", {"column": column, "unit": OPEN}, why, assumed)

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
            if CHANNELS[reading.channel].role in ("time", "output") and filled.sum() > 1:
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
        usual = usual_units(name)
        if said or len(usual) == 1:
            return _as_said(name, keys, said, seen)
        possible = [air[name]] if name in air else self._possible(name, columns)
        if len(possible) == 1:
            what = "the air data" if name in air else "a running engine"
            why = f"no other unit fits {what}; {seen}"
            return Line(name, {**keys, "unit": possible[0]}, why)
        wanted = " or ".join(possible or usual)
        if name in SPOOLS:
            wanted += " or, of revolutions, scale = 100 / (those at 100 %)"
        return Line(name, {**keys, "unit": OPEN}, f"{wanted}? It is {seen}")

    def _range(self, columns: Sequence[str]) -> tuple[float, float]:
        values = np.concatenate([self.values[column] for column in columns])
        return _high(values, 0.001), _high(values)

    def _possible(self, name: str, columns: Sequence[str]) -> list[str]:
        floor, recorded = CHANNELS[name].low - 1.0, np.array(self._range(columns))
        bounds = _HIGHEST.get(name, (CHANNELS[name].low, CHANNELS[name].high))
        ranges = {
            unit: to_canonical(recorded, find_unit(unit, name)).tolist()
            for unit in usual_units(name)
        }
        return [u for u, (low, high) in ranges.items() if low >= floor and _within(high, bounds)]

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
            name: (named_unit(said[name]),) if fits(said[name], name) else usual_units(name)
            for name in columns
        }
        air = {name: self.values[column] for name, column in columns.items()}
        mach = [each for each, read in self.readings.items() if read.channel == "Mach"]
        return units_that_agree(
            {**air, **({"Mach": self.values[mach[0]]} if mach else {})}, possible
        )


def _as_said(name: str, keys: _Keys, said: str, seen: str) -> Line:
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
