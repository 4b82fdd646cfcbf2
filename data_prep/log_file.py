"""One file of recordings as canonical channels, block by block."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from data_prep.array_source import MAGIC_BYTES, ArraySource, is_array_file
from data_prep.code_words import CodeWords
from data_prep.columns import constants, head_entries, map_columns, sources_of, to_channel
from data_prep.csv_source import Counts, Pace, open_csv, readable
from data_prep.log import CODE_WORD, AuditEntry
from data_prep.parquet_source import MAGIC, ParquetSource
from data_prep.stream import GridStream
from data_prep.words import Labels, switch
from narxcal.channels import described
from narxcal.support.errors import DataError, did_you_mean
from narxcal.support.files import sha256_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from data_prep.columns import Table
    from data_prep.config import LogsConfig
    from narxcal.support.arrays import FloatArray

# Numbers in a block: 40 MB. A recording of hours is one block, so that the rate of the rows and of
# each channel is found from all of it; in a larger file they are found from blocks of this size.
BLOCK_CELLS = 5_000_000

Rows = dict[str, "FloatArray"]  # channel -> (rows,)


def open_table(path: Path, config: LogsConfig) -> Table:
    """Open a file of any format that is read, by its first bytes; raises `DataError`."""
    with readable(path), path.open("rb") as raw:
        magic = raw.read(MAGIC_BYTES)
    if magic.startswith(MAGIC):
        return ParquetSource(path, config.time_column)
    if is_array_file(magic):
        return ArraySource(path, config.time_column)
    return open_csv(path, config)


class LogFile:
    """One file of recordings: its engines, and their rows as canonical channels, block by block.

    `engines` has one without a name where the configuration names none.
    """

    def __init__(self, path: Path, config: LogsConfig) -> None:
        self.path = path
        self.config = config
        self.table = open_table(path, config)
        self._columns = map_columns(self.table, config)
        self._sources = sources_of(self.table, config)
        self.engines = tuple(self._columns)
        self.name = path.name

    @property
    def hourly(self) -> bool:
        """Whether the clock shows minutes and seconds alone."""
        return self.table.hourly

    @property
    def truncated(self) -> bool:
        """Whether the file broke off within a row that was read."""
        return self.table.truncated

    @property
    def channels(self) -> frozenset[str]:
        """Channels of which the file has a column, for any engine."""
        return frozenset(name for columns in self._columns.values() for name in columns)

    def sha256(self) -> str:
        """Hash of the file's bytes."""
        with readable(self.path):
            return sha256_of(self.path)

    def head_entries(self, rows: int) -> tuple[AuditEntry, ...]:
        """Account for the lines above the first of `rows` rows, in an audit."""
        return head_entries(self.table, self.config, rows)

    def blocks(self, engines: Sequence[str], pace: Pace | None = None) -> Iterator[dict[str, Rows]]:
        """Yield engine -> channel -> `(rows,)`, in file order; raises `DataError`.

        Where columns tell instances apart, `engine-instance` takes the place of the engine.
        """
        columns = [column for each in engines for column in self._columns[each].items()]
        switches = {column: switch for name, column in columns if described(name).role == "switch"}
        labels = {column: Labels() for column in self._instances()}
        if labels and pace and pace.live:
            raise DataError(
                "a file of several instances cannot be streamed",
                file=self.path,
                hint="Write each of them to a file of its own",
            )
        names = list(dict.fromkeys([column for _, column in columns] + list(labels)))
        words = {**switches, **{column: each.number for column, each in labels.items()}}
        others = {*switches, *labels, self.config.time_column}
        coded = {name: CodeWords() for name in names if name not in others}
        for cells in self.table.blocks(names, pace, words):
            self._mask_code_words(cells, coded)
            rows = self._apart(cells, labels) if labels else {"": slice(None)}
            yield {
                "-".join(filter(None, (engine, instance))): {
                    name: values[chosen] for name, values in self._canonical(engine, cells).items()
                }
                for engine in engines
                for instance, chosen in rows.items()
            }

    def _mask_code_words(
        self, cells: dict[str, FloatArray], coded: Mapping[str, CodeWords]
    ) -> None:
        """Blank the code words of each column, and count them."""
        for column, words in coded.items():
            for word, rows in words.masks(cells[column]):
                cells[column] = np.where(rows, np.nan, cells[column])
                reason = f"{CODE_WORD} {word.value:g}: {word.why}"
                self.table.counts[column, "dropped", reason] += int(rows.sum())

    def _instances(self) -> tuple[str, ...]:
        columns = tuple(" ".join(name.split()) for name in self.config.instances)
        for column in columns:
            if column not in self.table.header:
                raise DataError(
                    f"column '{column}' of [logs] instances is missing",
                    file=self.path,
                    hint=did_you_mean(column, self.table.header, "The file has"),
                )
        return columns

    def _apart(
        self, cells: Mapping[str, FloatArray], labels: Mapping[str, Labels]
    ) -> dict[str, NDArray[np.intp]]:
        """Instance -> its rows; a row without a label belongs to none, which is counted."""
        keys = np.column_stack([cells[column] for column in labels])
        known = np.flatnonzero(np.isfinite(keys).all(axis=1))
        self.table.counts["*", "dropped", "row of no instance"] += len(keys) - len(known)
        found, of_row = np.unique(keys[known], axis=0, return_inverse=True)
        return {
            "-".join(
                each.label(number) for each, number in zip(labels.values(), key, strict=True)
            ): known[of_row.ravel() == k]
            for k, key in enumerate(found)
        }

    def counted(self) -> dict[str, Counts]:
        """Take engine -> what the file's `counts` became since the last call, by channel."""
        counts, self.table.counts = self.table.counts, Counter()
        found: dict[str, Counts] = {engine: Counter() for engine in self.engines}
        for engine, columns in self._columns.items():
            channels = {"*": "*", **{column: name for name, column in columns.items()}}
            for (column, action, reason), count in counts.items():
                if column in channels:
                    found[engine][channels[column], action, reason] += count
        return found

    def large_blocks(self) -> Iterator[dict[str, Rows]]:
        """Yield the same for all engines of a finished file, in blocks of about `BLOCK_CELLS`."""
        waiting: list[dict[str, Rows]] = []
        cells = 0
        for block in self.blocks(self.engines):
            waiting.append(block)
            cells += sum(len(values) for rows in block.values() for values in rows.values())
            if cells >= BLOCK_CELLS:
                yield _joined(waiting)
                waiting, cells = [], 0
        if waiting:
            yield _joined(waiting)

    def stream(self, dt_s: float, look_ahead_s: float, rows_s: float | None = None) -> GridStream:
        """Return the stream that puts the rows of one engine on a grid of `dt_s`."""
        known = constants(self._sources)
        return GridStream(
            self.config, dt_s, look_ahead_s, str(self.path), known, self.hourly, rows_s
        )

    def _canonical(self, engine: str, cells: Mapping[str, FloatArray]) -> Rows:
        return {
            name: to_channel(name, cells[column], self._sources[name])
            for name, column in self._columns[engine].items()
        }


def _joined(blocks: list[dict[str, Rows]]) -> dict[str, Rows]:
    if len(blocks) == 1:
        return blocks[0]
    found: dict[str, Rows] = {}
    for engine in dict.fromkeys(engine for block in blocks for engine in block):
        parts = [block.pop(engine) for block in blocks if engine in block]
        found[engine] = {
            name: np.concatenate([part.pop(name) for part in parts]) for name in list(parts[0])
        }
    return found
