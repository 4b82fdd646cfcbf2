"""The TOML table `[logs]`: where the recordings are and which column is which channel.

Speeds, ratios, powers and the like that are not in the table of channels are declared in
`[logs.channels]`, and are then used as the outputs of that table are.
"""

from __future__ import annotations

import fnmatch
import glob
import re
from collections.abc import Collection, Mapping
from functools import cached_property
from pathlib import Path, PurePath
from typing import Annotated, Literal, Self

from pydantic import Field, PositiveFloat, field_validator, model_validator

from data_prep.derive import DeriveConfig
from data_prep.sources.clock import Order
from data_prep.sources.units import find_unit, is_volume_flow
from narxcal.channels import CHANNELS, ENDINGS, Channel, Role, channel, described, symbol
from narxcal.support.errors import ConfigError, DataError
from narxcal.support.files import is_file, is_folder
from narxcal.support.settings import Section

ENGINE, FLIGHT = "{engine}", "{flight}"
FASTEST_HZ = 1000.0  # no recorder of engine channels is faster, and a grid takes memory


_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


class DeclaredChannel(Section):
    """A measured quantity beyond the table of channels: torque, power, the speed of a propeller.

    `range` is what is physically possible, in the unit that ends the channel's name: a sample
    outside is a recording fault. `unit` may say that unit again. What is `commanded`, as a lever,
    may stay constant and jump.
    """

    range: tuple[float, float]
    unit: str = ""
    commanded: bool = False

    @field_validator("range")
    @classmethod
    def _rises(cls, ends: tuple[float, float]) -> tuple[float, float]:
        if not ends[0] < ends[1]:
            raise ValueError("expected [lowest, highest]")
        return ends

    def named(self, name: str) -> Channel:
        """Return the channel that `[logs.channels]` declares under `name`.

        Raises `ConfigError` for a name that clashes with the table of channels or has no unit.
        """
        same = next((each for each in CHANNELS if symbol(each) == symbol(name)), "")
        if same:
            raise ConfigError(
                f"[logs.channels] declares '{name}', and {same} is built in",
                hint=f"Map the column to {same}, with scale and offset, or choose another name",
            )
        known = described(name)
        unit = self.unit or known.unit
        endings = {each: end for end, each in ENDINGS.items()}
        if unit not in (*endings, "-"):
            raise ConfigError(
                f"[logs.channels] declares '{name}' in '{unit}', which is no unit of a channel",
                hint=f"Units are {', '.join(endings)} and -. [logs.columns] converts from others",
            )
        if unit != known.unit or not _NAME.fullmatch(name) or ("_" in name and unit == "-"):
            listed = f"Units end in {', '.join(f'_{end}' for end in ENDINGS)}; a ratio has no '_'"
            right = f"{name.partition('_')[0]}_{endings[unit]}" if unit in endings else ""
            raise ConfigError(
                f"[logs.channels] declares '{name}', a name that does not end in its unit",
                hint=f"Name it {right}" if _NAME.fullmatch(right) else listed,
            )
        role: Role = "lever" if self.commanded else "output"
        return Channel(name, unit, role, *self.range, known.meaning)


class ColumnSource(Section):
    """Where one channel comes from: `channel = (cell * scale + offset) in unit`.

    `unit` is the canonical one when left out. An `optional` column may be absent from a file.
    `constant` (in the canonical unit) replaces a column: the altitude of a test bench.
    `density_kgpl` (kg/l) makes a mass flow of a volume flow, in `unit` or that of the file.
    """

    column: str = ""
    constant: float | None = None
    unit: str | None = None
    scale: float = 1.0
    offset: float = 0.0
    optional: bool = False
    density_kgpl: PositiveFloat | None = None

    @field_validator("column")
    @classmethod
    def _one_line(cls, value: str) -> str:
        return " ".join(value.split())  # as sources name their columns

    @model_validator(mode="after")
    def _one_origin(self) -> Self:
        if (self.column != "") == (self.constant is not None):
            raise ValueError("expected either a column or a constant")
        return self


class LogsConfig(Section):
    """TOML table `[logs]`.

    Without `[logs.columns]` the header is canonical. `[logs.engines]` maps an engine's name to
    what replaces `{engine}` in the column names; each engine becomes its own log.
    `raster_hz` is the rate of the sampling grid; left out, each file's own. `max_gap_s` splits a
    log; a channel's blanks are bridged up to `bridge_s`.

    `dates` is the order of day, month and year where the stamps do not settle it; `frames_hz`
    the frames of a second in stamps `HH:MM:SS:FF`. `no_value` are further words that stand for
    no value, in addition to `data_prep.cleaning.words.NO_VALUE`. `instances` are columns that tell
    the engines, units or recordings in a file apart: each combination of their values becomes a
    log. `channels` are declared beyond the table of `narxcal.channels`. `flights` are patterns of
    file names in which `{flight}` stands for what the files of one flight share: they become one
    recording (`data_prep.sources.log_file`).
    """

    folder: str = "."
    files: tuple[str, ...] = ("*.csv", "*.csv.gz")
    raster_hz: Annotated[float, Field(gt=0.0, le=FASTEST_HZ)] | None = None
    max_gap_s: PositiveFloat = 2.0
    bridge_s: float = Field(default=0.5, ge=0.0)
    delimiter: str = "auto"
    decimal: Literal["auto", ".", ","] = "auto"
    comment: str = Field(default="#", max_length=1)
    dates: Order = "auto"
    frames_hz: PositiveFloat | None = None
    no_value: tuple[str, ...] = ()
    instances: tuple[str, ...] = ()
    flights: tuple[str, ...] = ()
    engines: dict[str, str] = Field(default_factory=dict)
    channels: dict[str, DeclaredChannel] = Field(default_factory=dict)
    columns: dict[str, ColumnSource] = Field(default_factory=dict)
    derive: DeriveConfig = DeriveConfig()

    @field_validator("delimiter")
    @classmethod
    def _one_character(cls, value: str) -> str:
        if value != "auto" and (len(value) != 1 or not (value.isprintable() or value == "\t")):
            raise ValueError("expected 'auto' or a single character")
        return value

    @field_validator("flights")
    @classmethod
    def _name_a_flight(cls, patterns: tuple[str, ...]) -> tuple[str, ...]:
        for pattern in patterns:
            if pattern.count(FLIGHT) != 1 or PurePath(pattern).name != pattern:
                raise ValueError(f"expected names of files with {FLIGHT} in them")
        return patterns

    @field_validator("files")
    @classmethod
    def _in_the_folder(cls, patterns: tuple[str, ...]) -> tuple[str, ...]:
        for pattern in patterns:
            if not pattern or PurePath(pattern).anchor or ".." in PurePath(pattern).parts:
                raise ValueError("expected patterns of files below [logs] folder, without its path")
        return patterns

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.delimiter != "auto" and self.delimiter in (self.decimal, self.comment):
            raise ValueError("delimiter, decimal and comment have to differ")
        placed = any(ENGINE in source.column for source in self.columns.values())
        if bool(self.engines) != placed:
            raise ValueError("[logs.engines] and '{engine}' in the column names belong together")
        self._check_channels()
        return self

    def _check_channels(self) -> None:
        """Every column is of a channel, every declared channel has a column and its own symbol."""
        symbols = [symbol(name) for name in self.declared]
        for name in self.declared:
            if symbols.count(symbol(name)) > 1:
                raise ConfigError(
                    f"[logs.channels] declares '{symbol(name)}' twice",
                    hint="Tables and pages show channels without their units: give it another name",
                )
            if self.columns and name not in self.columns:
                raise ConfigError(
                    f"[logs.channels] declares '{name}', and [logs.columns] has no column for it",
                    hint=f'Add {name} = {{ column = "...", unit = "{self.declared[name].unit}" }}',
                )
        for name, source in self.columns.items():
            unit = source.unit if source.unit is not None else self.channel(name).unit
            if source.density_kgpl is None or not is_volume_flow(unit):
                find_unit(unit, name)
        if self.columns and "time_s" not in self.columns:
            raise ConfigError(
                "[logs.columns] lacks time_s", hint='Add time_s = { column = "...", unit = "s" }'
            )

    @cached_property
    def declared(self) -> Mapping[str, Channel]:
        return {name: each.named(name) for name, each in self.channels.items()}

    def channel(self, name: str) -> Channel:
        """Look up a channel, built in or declared; raises `ConfigError` for any other name."""
        try:
            return self.declared.get(name) or channel(name)
        except ConfigError as error:
            if "_" not in name or described(name).unit == "-":
                raise
            hint = f"{error.hint} Or declare it: [logs.channels] {name} = {{ range = [0, 100] }}"
            raise ConfigError(error.problem, hint=hint) from None

    def resolve(self, base: Path) -> list[Path]:
        """Files that match `files` in `folder`, which is relative to `base`; in order of name.

        Of a flight of several files it is the first.
        Raises `DataError` when the folder is missing or a pattern matches nothing.
        """
        folder = (Path(base) / self.folder).resolve()
        if not is_folder(folder):
            what = "is a file" if is_file(folder) else "does not exist"
            hint = "Set [logs] folder, or name another by --data"
            raise DataError(f"the folder of the logs {what}", file=folder, hint=hint)
        found: dict[Path, None] = {}
        for pattern in self.files:
            found.update(dict.fromkeys(sorted(folder.glob(pattern))))
        if not found:
            raise DataError(
                f"no file matches {' or '.join(self.files)}",
                file=folder,
                hint="Set [logs] files",
            )
        flights: dict[tuple[Path, str], Path] = {}
        for path in found:
            key = path.parent, self.flight_of(path)
            flights[key] = min(path, flights.get(key, path))
        return list(flights.values())

    @cached_property
    def _patterns(self) -> tuple[re.Pattern[str], ...]:
        ends = (
            [fnmatch.translate(end)[:-2] for end in each.split(FLIGHT)] for each in self.flights
        )
        return tuple(re.compile("(?P<flight>.+)".join(both)) for both in ends)

    def flight_of(self, path: Path) -> str:
        """What stands for `{flight}` in the name of a file; the name itself where nothing does."""
        known = (pattern.fullmatch(path.name) for pattern in self._patterns)
        return next((found["flight"] for found in known if found), path.name)

    def parts(self, path: Path) -> list[Path]:
        """Files of the flight of `path` in its folder, in order of name; itself where it is all."""
        flight = self.flight_of(path)
        if flight == path.name or not is_file(path):
            return [path]
        named = {
            each
            for pattern in self.flights
            for each in path.parent.glob(pattern.replace(FLIGHT, glob.escape(flight)))
        }
        return sorted(each for each in named if self.flight_of(each) == flight)

    @property
    def time_column(self) -> str:
        return self.columns["time_s"].column if self.columns else "time_s"

    def for_inputs(self, names: Collection[str]) -> Self:
        """The same with all columns but those of `names` optional: a model needs its inputs alone.

        A channel from which an input is derived is not among them: where it is missing, so is the
        input, which is reported.
        """
        columns = {
            name: source.model_copy(update={"optional": source.optional or name not in names})
            for name, source in self.columns.items()
        }
        return self.model_copy(update={"columns": columns})

    def every(self, dt_s: float) -> Self:
        return self.model_copy(update={"raster_hz": 1.0 / dt_s})

    def sources(self, header: tuple[str, ...]) -> dict[str, ColumnSource]:
        """Channel -> source; the canonical names found in `header` when none are configured."""
        if self.columns:
            return dict(self.columns)
        names = [name for name in header if name in CHANNELS or name in self.declared]
        return {name: ColumnSource(column=name) for name in names}
