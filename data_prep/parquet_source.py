"""Parquet files (needs the extra `parquet`): columns read in batches, and logs written."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any

from data_prep.csv_source import Counts, Pace, Words
from data_prep.text_file import Head
from narxcal.support.errors import ConfigError, DataError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from narxcal.support.arrays import FloatArray

MAGIC = b"PAR1"
_GROUP_ROWS = 100_000  # written at a time
_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


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

    def __init__(self, path: Path, time: str = "time_s") -> None:
        self.path = path
        self.counts: Counts = Counter()
        self._time = time
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

    @property
    def header(self) -> tuple[str, ...]:
        """Column names in file order."""
        return tuple(self._raw)

    @property
    def head(self) -> Head:
        """There are no lines above the first row."""
        return Head(lines=0)

    @property
    def clock(self) -> str:
        """The column that may hold dates, whose unit is part of the file."""
        return self._time

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
        if pace is not None and pace.follow:
            raise DataError(
                "a Parquet file cannot be followed", file=self.path, hint="Write it as CSV first"
            )
        for name in names:
            kind = self._file.schema_arrow.field(self._raw[name]).type
            kinds = self._numeric + (self._temporal if name == self._time else ())
            if not any(fits(kind) for fits in kinds):
                raise DataError(
                    f"expected a column of numbers, found {kind}", file=self.path, channel=name
                )
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
