"""Files that are no text: Parquet, arrays of MATLAB and HDF5, and MDF 4; Parquet is also written.

MATLAB of version 5 is read by scipy; the others need an extra: `parquet`, `hdf5` (also for MATLAB
7.3) and `mdf`. Arrays become columns:

| layout | column |
|---|---|
| array `(rows,)`, `(rows, 1)` or `(1, rows)` | of its name; in a struct or group `GROUP/NAME` |
| struct or group with `data` and `Rate`, and perhaps `Units` and `Description` | of its name |
| array `(rows, n)` `NAME`, `NAME_dev`, `NAME_test`, with `n` names in `NAME_var` | of these names |

Columns with rates have no stamps: sample k of a channel is at `k / rate`, and the rows are those of
the fastest column that is read. Columns slower than that are blank in between. Channels of MDF have
stamps of their own: the rows are those of all that are read, blank where a channel has none.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from scipy.io import loadmat

from data_prep.sources.csv_source import Counts, Pace, Words, readable
from data_prep.sources.text_file import Head
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError, DataError, NarxcalError

_PARQUET = b"PAR1"
_MATLAB, _MATLAB_73, _HDF5 = b"MATLAB 5.0 MAT", b"MATLAB 7.3 MAT", b"\x89HDF\r\n\x1a\n"
_MDF = b"MDF     "
_GROUP_ROWS = 100_000  # of a Parquet file, written at a time
_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_WHOLE = 1e-6  # by which a ratio of rates may differ from a whole number
# Bytes of arrays by byte of an HDF5 file, the most that deflate packs into one, and what any may
# have: arrays that were never written take no byte of it.
_SMALLEST, _UNSTORED = 1032, 1 << 26
_TABLES = ("", "_dev", "_test")  # endings of a table whose names are in `_var`


def open_binary(path: Path, time: str) -> ArraySource | ParquetSource | None:
    """Open a file that is no text, by its first bytes; None for any other.

    `time` is the column of stamps, "" where only the header is wanted. Raises `DataError` for a
    file that cannot be read, `ConfigError` without the extra that it needs.
    """
    magic = _magic(path)
    if magic.startswith(_PARQUET):
        return ParquetSource(path, time)
    arrays = magic.startswith((_MATLAB, _MATLAB_73, _HDF5, _MDF))
    return ArraySource(path, time) if arrays else None


def _magic(path: Path) -> bytes:
    with readable(path), path.open("rb") as raw:
        return raw.read(len(_MATLAB))


def _refuse_growing(path: Path, pace: Pace | None, what: str) -> None:
    if pace is not None and pace.follow:
        raise DataError(f"{what} cannot be followed", file=path, hint="Write it as CSV first")


@dataclass(frozen=True)
class _Column:
    """Values `(samples,)` and what the file says of them.

    A rate of 0 means one sample a row, unless the channel has `stamps_s` `(samples,)` of its own.
    """

    values: FloatArray
    unit: str = ""
    rate_hz: float = 0.0
    stamps_s: FloatArray | None = None


class ArraySource:
    """One file of arrays, whose columns were read as a whole; row 1 is the first.

    `time` is the column of stamps; "" where only the header is wanted. With `rated` channels, which
    have rates or stamps of their own, it is made from these.
    """

    truncated = False
    hourly = False
    tabular = True
    clock = ""

    def __init__(self, path: Path, time: str = "time_s") -> None:
        self.path = path
        self.counts: Counts = Counter()
        self._time = time
        self._columns = {" ".join(name.split()): each for name, each in _columns(path).items()}
        if not self._columns:
            raise DataError("the file holds no columns of numbers", file=path)
        self.rated = any(
            column.rate_hz or column.stamps_s is not None for column in self._columns.values()
        )
        if time and time not in self._columns and not self.rated:
            raise DataError(
                f"the file has no column '{time}', and its channels have no rates",
                file=path,
                channel="time_s",
                hint=f"Name the column of time: {', '.join(list(self._columns)[:12])}",
            )
        units = {} if not time or time in self._columns else {time: ""}
        units |= {name: each.unit for name, each in self._columns.items()}
        self.header = tuple(units)  # in file order; time first, where it follows from the rates
        self.head = Head(lines=0, units=tuple(units.values()) if any(units.values()) else ())

    def blocks(
        self,
        names: Sequence[str],
        pace: Pace | None = None,
        words: Words | None = None,  # noqa: ARG002 - arrays hold numbers
    ) -> Iterator[dict[str, FloatArray]]:
        """The named columns in blocks of up to `pace.lines` rows; blank is NaN.

        Raises `DataError` for columns of different lengths, for rates that do not divide the
        fastest one, and for a `pace` that follows a growing file.
        """
        _refuse_growing(self.path, pace, "a file of arrays")
        for name in names:
            values = self._columns[name].values if name in self._columns else np.empty(0)
            if np.iscomplexobj(values):
                raise _no_numbers(self.path, name, values.dtype)
        table = self._rows({name: self._columns[name] for name in names if name in self._columns})
        rows, size = len(next(iter(table.values()))), (pace or Pace()).lines
        for start in range(0, rows, size):
            yield {name: table[name][start : start + size] for name in names}

    def _rows(self, columns: Mapping[str, _Column]) -> dict[str, FloatArray]:
        """Columns on common rows, with stamps where they follow from the rates."""
        stamps = [each.stamps_s for each in columns.values() if each.stamps_s is not None]
        if stamps:
            return self._stamped(columns, np.unique(np.concatenate(stamps)))
        fastest = max((each.rate_hz for each in columns.values()), default=0.0)
        if self._time in self._columns or not fastest:
            lengths = {name: len(each.values) for name, each in columns.items()}
            if len(set(lengths.values())) > 1:
                found = ", ".join(f"{name} {length}" for name, length in lengths.items())
                raise DataError(f"columns of one table differ in rows: {found}", file=self.path)
            return {name: each.values for name, each in columns.items()}
        every = {name: self._every(name, each, fastest) for name, each in columns.items()}
        rows = max((len(columns[name].values) - 1) * step + 1 for name, step in every.items())
        table = {self._time: np.arange(rows) / fastest}
        for name, each in columns.items():
            table[name] = np.full(rows, np.nan)
            table[name][:: every[name]][: len(each.values)] = each.values
        return table

    def _stamped(self, columns: Mapping[str, _Column], time_s: FloatArray) -> dict[str, FloatArray]:
        """Columns with stamps of their own on the rows of all of them."""
        table = {self._time: time_s}
        for name, each in columns.items():
            table[name] = np.full(len(time_s), np.nan)
            if each.stamps_s is not None:
                table[name][np.searchsorted(time_s, each.stamps_s)] = each.values
        return table

    def _every(self, name: str, column: _Column, fastest_hz: float) -> int:
        ratio = fastest_hz / column.rate_hz if column.rate_hz else 0.0
        if ratio < 1.0 or abs(ratio - round(ratio)) > _WHOLE * ratio:
            raise DataError(
                f"a rate of {column.rate_hz:g} Hz does not divide that of {fastest_hz:g} Hz of "
                "another column",
                file=self.path,
                channel=name,
                hint="Write the columns that do to a file of their own",
            )
        return round(ratio)


def _columns(path: Path) -> dict[str, _Column]:
    magic = _magic(path)
    try:
        if magic.startswith(_MDF):
            return dict(_mdf(path))
        tree = _hdf5(path) if magic != _MATLAB else _matlab(path)
        return dict(_found(tree, ""))
    except NarxcalError:
        raise
    except Exception as error:  # readers by others raise anything on a damaged file
        raise DataError(
            f"the file cannot be read ({' '.join(str(error).split())[:100]})",
            file=path,
            hint="Copy it again",
        ) from error


def _matlab(path: Path) -> dict[str, Any]:
    """Variables of a MATLAB file; scipy leaves one open that it opened and cannot read."""
    with path.open("rb") as raw:
        found: dict[str, Any] = loadmat(cast("Any", raw), simplify_cells=True)
    return found


def _mdf(path: Path) -> Iterator[tuple[str, _Column]]:
    """Channels of numbers, each with the stamps of its group."""
    try:
        from asammdf import MDF  # noqa: PLC0415 - an extra, needed for such files only
    except ImportError:
        raise ConfigError(
            "MDF needs asammdf", file=path, hint="Install it with: pip install 'narxcal[mdf]'"
        ) from None
    with path.open("rb") as raw, MDF(raw) as file:
        for signal in file.iter_channels():
            values = _vector(signal.samples)
            if values is not None:
                stamps = np.asarray(signal.timestamps, dtype=np.float64)
                yield str(signal.name), _Column(values, str(signal.unit), stamps_s=stamps)


def _hdf5(path: Path) -> dict[str, Any]:
    """Groups as dictionaries and datasets as arrays, one with a unit as a struct."""
    try:
        import h5py  # noqa: PLC0415 - an extra, needed for such files only
    except ImportError:
        raise ConfigError(
            "HDF5 and MATLAB 7.3 need h5py",
            file=path,
            hint="Install it with: pip install 'narxcal[hdf5]'",
        ) from None

    left = _UNSTORED + _SMALLEST * path.stat().st_size

    def tree(item: Any) -> Any:
        nonlocal left
        if isinstance(item, h5py.Group):
            names = [name for name in item if not name.startswith("#")]
            for name in names:
                if isinstance(item.get(name, getlink=True), h5py.ExternalLink):
                    raise _elsewhere(path, name)
            return {name: tree(item[name]) for name in names}
        if item.external or item.is_virtual:
            raise _elsewhere(path, item.name)
        left -= item.nbytes
        if left < 0:
            raise DataError(
                f"its {path.stat().st_size} bytes say that they hold arrays of more than "
                f"{_UNSTORED + _SMALLEST * path.stat().st_size} bytes",
                file=path, channel=item.name, hint="Write the samples that were recorded",
            )  # fmt: skip
        values = item[()]
        if item.attrs.get("MATLAB_class") == b"char":
            return "".join(map(chr, np.ravel(values)))
        unit = next(
            (item.attrs[key] for key in ("units", "Units", "unit") if key in item.attrs), ""
        )
        return {"data": values, "units": unit} if unit else values

    with h5py.File(path, "r") as file:
        found: dict[str, Any] = tree(file)
    return found


def _elsewhere(path: Path, name: str) -> DataError:
    return DataError(
        "its samples are in another file", file=path, channel=name, hint="Copy them into this one"
    )


def _found(tree: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, _Column]]:
    for name, item in tree.items():
        if name.startswith("__"):
            continue
        if isinstance(item, dict):
            fields = {key.lower(): value for key, value in item.items()}
            values = _vector(fields.get("data"))
            if values is None:
                yield from _found(item, f"{prefix}{name}/")
                continue
            rate = float(np.ravel(fields["rate"])[0]) if "rate" in fields else 0.0
            yield prefix + name, _Column(values, _text(fields.get("units", "")), rate)
        elif table := dict(_table(tree, name, np.asarray(item))):
            yield from table.items()
        elif (values := _vector(item)) is not None:
            yield prefix + name, _Column(values)


def _table(tree: Mapping[str, Any], name: str, values: Any) -> Iterator[tuple[str, _Column]]:
    """Columns of a matrix that has names in `_var`; none for any other array."""
    if values.ndim != 2:
        return
    stems = [name.removesuffix(end) for end in _TABLES if name.endswith(end)]
    known = next((tree[f"{stem}_var"] for stem in stems if f"{stem}_var" in tree), None)
    names = [] if known is None else [_text(each) for each in np.ravel(known)]
    if len(names) == values.shape[1] and _numeric(values):
        for each, column in zip(names, values.T, strict=True):
            yield each, _Column(_floats(column))


def _vector(item: Any) -> FloatArray | None:
    """An array of numbers along one axis, as `(samples,)`; None for anything else."""
    values = np.asarray(item)
    if (
        not _numeric(values)
        or values.ndim == 0
        or max(values.shape) < values.size
        or not values.size
    ):
        return None
    return _floats(values.ravel())


def _floats(values: Any) -> FloatArray:
    """Numbers as doubles; of two parts as they are, for `ArraySource.blocks` to refuse."""
    return np.asarray(values, dtype=None if np.iscomplexobj(values) else np.float64)


def _numeric(values: Any) -> bool:
    return values.dtype == np.bool_ or bool(np.issubdtype(values.dtype, np.number))


def _text(item: Any) -> str:
    """Text of a string, of bytes or of an array of one of them."""
    plain = np.ravel(item)[0] if np.size(item) else ""
    return (plain.decode("utf-8", "replace") if isinstance(plain, bytes) else str(plain)).strip()


def _no_numbers(path: Path, name: str, kind: object) -> DataError:
    return DataError(f"expected a column of numbers, found {kind}", file=path, channel=name)


def arrow(path: Path) -> tuple[Any, Any]:
    """Return the modules pyarrow and pyarrow.parquet; raises `ConfigError` without the extra."""
    try:
        import pyarrow as pa  # noqa: PLC0415 - an extra, needed for such files only
        from pyarrow import parquet  # noqa: PLC0415 - likewise
    except ImportError:
        raise ConfigError(
            "Parquet needs pyarrow",
            file=path,
            hint="Install it with: pip install 'narxcal[parquet]'",
        ) from None
    return pa, parquet


def write_parquet(path: Path, columns: Mapping[str, FloatArray]) -> None:
    """Write columns (rows,) as doubles; NaN, a missing sample, is null."""
    pa, parquet = arrow(path)
    schema = pa.schema([(name, pa.float64()) for name in columns])
    rows = len(next(iter(columns.values())))
    with parquet.ParquetWriter(path, schema) as file:
        for start in range(0, rows, _GROUP_ROWS):
            group = slice(start, start + _GROUP_ROWS)
            arrays = [pa.array(values[group], from_pandas=True) for values in columns.values()]
            file.write_table(pa.table(arrays, schema=schema))


class ParquetSource:
    """One Parquet file: its header, and on request some of its columns; row 1 is the first.

    Column `time` may be one of dates or durations, which become seconds (dates from 1970).
    """

    truncated = False
    hourly = False
    tabular = True
    rated = False
    head = Head(lines=0)

    def __init__(self, path: Path, time: str = "time_s") -> None:
        self.path = path
        self.counts: Counts = Counter()
        self.clock = time  # it may hold dates, whose unit is part of the file
        pa, parquet = arrow(path)
        self._broken = (pa.ArrowException, OSError)
        self._numeric = (pa.types.is_floating, pa.types.is_integer, pa.types.is_boolean)
        self._temporal = (pa.types.is_timestamp, pa.types.is_duration)
        self._integer, self._double = pa.int64(), pa.float64()
        try:
            self._file: Any = parquet.ParquetFile(path)
        except self._broken as error:
            raise self._damaged() from error
        self._raw = {" ".join(name.split()): name for name in self._file.schema_arrow.names}
        self.header = tuple(self._raw)

    def blocks(
        self,
        names: Sequence[str],
        pace: Pace | None = None,
        words: Words | None = None,  # noqa: ARG002 - a column of words is no column of numbers
    ) -> Iterator[dict[str, FloatArray]]:
        """The named columns in blocks of up to `pace.lines` rows; null is NaN.

        Raises `DataError` for a column that holds no numbers, for a damaged file, and for a `pace`
        that follows a growing file: the table of contents of a Parquet file is written last.
        """
        _refuse_growing(self.path, pace, "a Parquet file")
        for name in names:
            kind = self._file.schema_arrow.field(self._raw[name]).type
            kinds = self._numeric + (self._temporal if name == self.clock else ())
            if not any(fits(kind) for fits in kinds):
                raise _no_numbers(self.path, name, kind)
        try:
            raw = [self._raw[name] for name in names]
            for batch in self._file.iter_batches((pace or Pace()).lines, columns=raw):
                columns = {name: batch.column(self._raw[name]) for name in names}
                yield {name: self._values(column) for name, column in columns.items()}
        except self._broken as error:
            raise self._damaged() from error

    def _values(self, column: Any) -> FloatArray:
        if not any(fits(column.type) for fits in self._temporal):
            return self._doubles(column)
        return self._doubles(column.cast(self._integer)) * _SECONDS[column.type.unit]

    def _doubles(self, column: Any) -> FloatArray:
        values: FloatArray = column.cast(self._double, safe=False).to_numpy(zero_copy_only=False)
        return values

    def _damaged(self) -> DataError:
        return DataError("the Parquet file is damaged", file=self.path, hint="Copy it again")
