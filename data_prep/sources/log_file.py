"""Files of recordings as canonical channels, block by block; several of one flight as one.

A recorder cuts a flight into files one after the other, or writes engine and air data each into a
file of their own. `[logs] flights` says by their names which belong together. Rows of one stamp
become one row: the first of that stamp in each file, the second, and so on.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from data_prep.cleaning.words import CodeWords, Labels, switch
from data_prep.config import LogsConfig
from data_prep.log import CODE_WORD, AuditEntry
from data_prep.sources.binary_source import open_binary
from data_prep.sources.columns import (
    Table,
    constants,
    head_entries,
    map_columns,
    sources_of,
    to_channel,
)
from data_prep.sources.csv_source import Counts, Pace, open_csv, readable
from data_prep.sources.stamps import DAY_S, Passed, clock_goes_on, ordered_rows
from data_prep.sources.stream import GridStream
from narxcal.channels import described
from narxcal.support.arrays import FloatArray, IntArray
from narxcal.support.errors import DataError, did_you_mean
from narxcal.support.files import sha256_of
from narxcal.support.moments import stamp

# Numbers in a block: 40 MB. A recording of hours is one block, so that the rate of the rows and of
# each channel is found from all of it; in a larger file they are found from blocks of this size.
BLOCK_CELLS = 5_000_000
_DAYS = 10.0  # a clock without a date has counted no more of them
_ONE_CLOCK = "Files of one flight need one clock, which does not start anew in each"

Rows = dict[str, "FloatArray"]  # channel -> (rows,)


def open_table(path: Path, config: LogsConfig) -> Table:
    """Open a file of any format that is read, by its first bytes; raises `DataError`."""
    return open_binary(path, config.time_column) or open_csv(path, config)


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
                yield _one_block(waiting)
                waiting, cells = [], 0
        if waiting:
            yield _one_block(waiting)

    def stream(self, dt_s: float, look_ahead_s: float, rows_s: float | None = None) -> GridStream:
        known = constants(self._sources)
        return GridStream(
            self.config, dt_s, look_ahead_s, str(self.path), known, self.hourly, rows_s
        )

    def _canonical(self, engine: str, cells: Mapping[str, FloatArray]) -> Rows:
        return {
            name: to_channel(name, cells[column], self._sources[name])
            for name, column in self._columns[engine].items()
        }


def _one_block(blocks: list[dict[str, Rows]]) -> dict[str, Rows]:
    """Blocks as one; they lose their channels one by one, so that memory never holds all twice."""
    if len(blocks) == 1:
        return blocks[0]
    found: dict[str, Rows] = {}
    for engine in dict.fromkeys(engine for block in blocks for engine in block):
        parts = [block.pop(engine) for block in blocks if engine in block]
        found[engine] = {
            name: np.concatenate([part.pop(name) for part in parts]) for name in list(parts[0])
        }
    return found


def open_log(path: Path, config: LogsConfig) -> LogFile | Flight:
    """Open a file, or the flight that it is a part of; raises as `LogFile` and `Flight`."""
    parts = config.parts(path)
    return LogFile(path, config) if len(parts) == 1 else Flight(parts, config)


class _Part(NamedTuple):
    """Rows of one engine in one file, in order of time: stamps, number within a stamp, channels."""

    path: Path
    time_s: FloatArray
    number: IntArray
    channels: Rows

    @property
    def span_s(self) -> tuple[float, float]:
        return float(self.time_s[0]), float(self.time_s[-1])


class Flight:
    """The files of one flight, with the verbs of `LogFile`; it is read whole.

    Raises `DataError` where no file has a column that is not optional.
    """

    hourly = False

    def __init__(self, paths: Sequence[Path], config: LogsConfig) -> None:
        self.path, self.config = paths[0], config
        self.name = config.flight_of(self.path)
        own = config.for_inputs(())
        self.files = [LogFile(path, own) for path in paths]
        self.engines = tuple(dict.fromkeys(each for file in self.files for each in file.engines))
        self._counts: dict[str, Counts] = {}
        self._heads: list[AuditEntry] = []
        for file in self.files:
            if file.hourly:
                raise DataError(
                    "a clock without hours cannot be joined with other files",
                    file=file.path,
                    hint=_ONE_CLOCK,
                )
        there = frozenset[str]().union(*(file.channels for file in self.files))
        for name, source in config.columns.items():
            if source.column and not source.optional and name not in there:
                raise DataError(
                    f"no file of flight '{self.name}' has column '{source.column}'",
                    file=self.path,
                    channel=name,
                    hint="Where a flight may lack it: optional = true. Its files are "
                    f"{', '.join(path.name for path in paths)}",
                )

    @property
    def truncated(self) -> bool:
        return any(file.truncated for file in self.files)

    def sha256(self) -> str:
        """Hash of the hashes of all files, in their order."""
        return hashlib.sha256("".join(each.sha256() for each in self.files).encode()).hexdigest()

    def blocks(self, engines: Sequence[str], pace: Pace | None = None) -> Iterator[dict[str, Rows]]:
        """Yield engine -> channel -> `(rows,)` of the whole flight; raises `DataError`."""
        if pace and pace.follow:
            raise DataError(
                "a flight of several files cannot be followed",
                file=self.path,
                hint="Follow one file that has all channels",
            )
        whole: dict[str, list[_Part]] = {}
        for file in self.files:
            blocks = list(file.blocks([each for each in engines if each in file.engines]))
            rows = sum(len(next(iter(block.values()))["time_s"]) for block in blocks if block)
            self._heads += file.head_entries(rows)
            for engine, counts in file.counted().items():
                self._counts[engine] = self._counts.get(engine, Counter()) + counts
            for engine, found in (_one_block(blocks) if blocks else {}).items():
                parts = whole.setdefault(engine, [])
                parts += self._part(file, found, engine, parts)
        yield {engine: _joined(parts) for engine, parts in whole.items() if parts}

    def large_blocks(self) -> Iterator[dict[str, Rows]]:
        return self.blocks(self.engines)

    def counted(self) -> dict[str, Counts]:
        """Take engine -> what was dropped and blanked, as `LogFile.counted`."""
        counts, self._counts = self._counts, {}
        return counts

    def head_entries(self, rows: int) -> tuple[AuditEntry, ...]:  # noqa: ARG002 - of each file
        """Account for the lines above the rows of all files."""
        return tuple(self._heads)

    def stream(self, dt_s: float, look_ahead_s: float, rows_s: float | None = None) -> GridStream:
        """Return the stream that puts the rows of one engine on a grid of `dt_s`."""
        known = constants(self.config.columns)
        return GridStream(self.config, dt_s, look_ahead_s, str(self.path), known, rows_s=rows_s)

    def _part(
        self, file: LogFile, rows: Rows, engine: str, before: Sequence[_Part]
    ) -> Iterator[_Part]:
        """Order the rows of a file, which may go on where another one was cut, and at midnight."""
        own = rows.keys() - {"time_s"}
        last = next((each for each in reversed(before) if each.channels.keys() == own), None)
        ends_s = last.span_s[1] if last else np.nan
        days = int(ends_s // DAY_S) if ends_s < _DAYS * DAY_S else 0
        gap_s = self.config.max_gap_s
        stamps, _, moved = clock_goes_on(rows["time_s"], gap_s, ends_s, Passed(days))
        ordered = ordered_rows(stamps, gap_s, str(file.path))
        counts = self._counts.setdefault(engine, Counter())
        for entry in (*moved, *ordered.entries):
            counts[entry.channel, entry.action, entry.reason] += entry.samples
        if len(ordered.time_s):
            number = _number_within(ordered.time_s)
            if last and ordered.time_s[0] == ends_s:
                number[ordered.time_s == ends_s] += np.sum(last.time_s == ends_s)
            yield _Part(
                file.path, ordered.time_s, number, {name: rows[name][ordered.order] for name in own}
            )


def _number_within(time_s: FloatArray) -> IntArray:
    """Of ascending stamps (rows,), how many rows before have the same one."""
    first = np.append(True, np.diff(time_s) > 0.0)
    rows = np.arange(len(time_s))
    return rows - np.maximum.accumulate(np.where(first, rows, 0))


def _joined(parts: Sequence[_Part]) -> Rows:
    """Rows of all parts in order of time, NaN where a part has none; raises `DataError`."""
    _check_shared_time(parts)
    keys = np.concatenate([np.column_stack([each.time_s, each.number]) for each in parts])
    known, rows = np.unique(keys, axis=0, return_inverse=True)
    places = np.split(rows.ravel(), np.cumsum([len(each.time_s) for each in parts])[:-1])
    for (one, at), (other, there) in combinations(zip(parts, places, strict=True), 2):
        _check_overlap(one, other, np.intersect1d(at, there, return_indices=True)[1:])
    names = dict.fromkeys(name for each in parts for name in each.channels)
    whole: Rows = {"time_s": known[:, 0]}
    for name in names:
        whole[name] = np.full(len(known), np.nan)
        for each, at in zip(parts, places, strict=True):
            if name in each.channels:
                given = np.isfinite(each.channels[name])
                whole[name][at[given]] = each.channels[name][given]
    return whole


def _check_shared_time(parts: Sequence[_Part]) -> None:
    """Files of different channels have to overlap in time, else nothing is recorded together."""
    spans: dict[frozenset[str], tuple[float, float, Path]] = {}
    for each in parts:
        first, last, path = spans.get(frozenset(each.channels), (*each.span_s, each.path))
        ends = min(first, each.span_s[0]), max(last, each.span_s[1])
        spans[frozenset(each.channels)] = (*ends, path)
    for one, other in combinations(spans.values(), 2):
        if min(one[1], other[1]) < max(one[0], other[0]):
            raise DataError(
                f"it runs from {stamp(one[0])} to {stamp(one[1])} and {other[2].name} from "
                f"{stamp(other[0])} to {stamp(other[1])}: files of one flight with different "
                "channels have to share time",
                file=one[2],
                channel="time_s",
                hint=_ONE_CLOCK,
            )


def _check_overlap(one: _Part, other: _Part, rows: tuple[IntArray, IntArray]) -> None:
    """Where two files have one channel at one time, they have to hold the same samples.

    `rows` are the rows of each that have the same stamp.
    """
    start, end = max(one.time_s[0], other.time_s[0]), min(one.time_s[-1], other.time_s[-1])
    shared = one.channels.keys() & other.channels.keys()
    if start > end or not shared:
        return
    same = [np.isin(np.arange(len(k.time_s)), r) for k, r in zip((one, other), rows, strict=True)]
    apart_s = [
        k.time_s[(k.time_s >= start) & (k.time_s <= end) & ~known]
        for k, known in zip((one, other), same, strict=True)
    ]
    for name in sorted(shared):
        a, b = one.channels[name][rows[0]], other.channels[name][rows[1]]
        differ = one.time_s[rows[0]][np.isfinite(a) & np.isfinite(b) & (a != b)]
        wrong_s = np.concatenate([differ, *(apart_s if start < end else [])])
        if len(wrong_s):
            raise DataError(
                f"it and {other.path.name} overlap from {stamp(start)} to {stamp(end)}, and differ "
                f"at {stamp(wrong_s.min())}",
                file=one.path,
                channel=name,
                hint=f"{_ONE_CLOCK}; or they are of different flights",
            )
