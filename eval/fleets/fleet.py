"""Evaluate a fleet: many logs against a run, or one run per tail, into a dataset that can grow.

    FLEET/fleet.json            schema, hash of the run of each tail, versions
    FLEET/worklist.parquet      tail, batch, file, size, sha256, engine
    FLEET/TABLE/TAIL/N.parquet  rows of batch N of a tail, for each table of `fleet_rows`

The work list says which files form a batch, once and for all: files that come later form later
batches. The tables of a batch are a function of its files and its run alone, and `logs` is written
last: where it is there, the batch is done; where not, it is computed anew into the same names.
So whatever is interrupted or computed twice, each log is there once, with the same bytes.
"""

from __future__ import annotations

import io
import json
import re
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, partial
from itertools import groupby
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any, Final, Literal, NamedTuple
from urllib.parse import quote

from pydantic import Field, field_validator

from data_prep.sources.binary_source import arrow
from eval.fleets.fleet_rows import (
    DUPLICATE,
    FAILED,
    GOOD,
    TABLES,
    Row,
    as_tables,
    not_evaluated,
    rows_of,
)
from eval.judging.log_evaluation import assess_log
from eval.run_logs import EvaluateConfig, evaluation_logs, run_config
from narxcal.calibration.bundle import Bundle, load_bundle
from narxcal.support.addresses import Folder
from narxcal.support.errors import ConfigError, DataError, ModelError, NarxcalError
from narxcal.support.files import sha256_of, to_json
from narxcal.support.parallel import WorkerDied, identity, in_processes
from narxcal.support.progress import Progress, silent
from narxcal.support.settings import Section, read_toml

CONFIG_SCHEMA: Final = "narxcal.fleet/1"
SCHEMA: Final = "narxcal.fleet-dataset/1"
DOCUMENT, WORK_LIST = "fleet.json", "worklist.parquet"
_LIST_COLUMNS = {
    "tail": "string", "batch": "int64", "file": "string", "size": "int64", "sha256": "string",
    "engine": "string",
}  # fmt: skip
_DECISIVE = ("tail", "file", "batch", "size", "sha256", "status")  # of what is done with a row
_TAIL = "{tail}"
_SEARCH_S = 20.0  # 100,000 names take 0.2 s
_SEARCH = """
import json, re, sys
pattern, names = json.load(sys.stdin)
found = [re.search(pattern, name) for name in names]
print(json.dumps([match[1] if match else None for match in found]))
"""
_STORE_EVERY_S = 60.0  # what a killed listing may lose; 100,000 rows are written in 1 s


def with_group(text: str, of: str) -> str:
    """Return a regular expression with a group `of` something; raises `ValueError`."""
    try:
        groups = re.compile(text).groups
    except re.error as error:
        raise ValueError(f"expected a regular expression: {error}") from None
    if groups < 1:
        raise ValueError(f"expected a regular expression with a group: {of}")
    return text


class FleetConfig(Section):
    """A fleet's TOML file.

    `flights` is the folder of the logs and `run` the run that they are evaluated against, with
    `{tail}` in it one per tail: paths relative to the file, or fsspec addresses. `files` are
    patterns below `flights`. The first group of the regular expression `tail`, searched in a
    file's name below `flights`, is its tail; left out, the folder that it is in. `batch` files of a
    tail are one task and one part of the dataset.
    """

    schema_: Literal["narxcal.fleet/1"] = Field(default=CONFIG_SCHEMA, alias="schema")
    flights: str = Field(min_length=1)
    run: str = Field(min_length=1)
    files: tuple[str, ...] = Field(default=("**/*.csv", "**/*.csv.gz"), min_length=1)
    tail: str = r"([^/]+)/[^/]+$"
    batch: int = Field(default=64, ge=1, le=1000)

    @field_validator("tail")
    @classmethod
    def _has_a_group(cls, text: str) -> str:
        return with_group(text, "the tail")

    def tails_of(self, files: Sequence[str]) -> dict[str, str]:
        """File -> tail; raises `DataError` where the pattern does not match.

        A pattern may search for longer than anybody waits, and only another process can be ended.
        """
        asked = json.dumps([self.tail, list(files)])
        try:
            done = subprocess.run(  # noqa: S603 -- this interpreter, with a text of ours
                [sys.executable, "-I", "-c", _SEARCH], input=asked, capture_output=True, text=True,
                timeout=_SEARCH_S, check=True,
            )  # fmt: skip
        except (subprocess.SubprocessError, OSError):
            raise ConfigError(
                f"tail = '{self.tail}' finds nothing within {_SEARCH_S:g} s",
                hint="Repeat nothing that is repeated already, such as (a+)+",
            ) from None
        found: list[str | None] = json.loads(done.stdout)
        for file, tail in zip(files, found, strict=True):
            if not tail:
                problem = f"its name does not match tail = '{self.tail}'"
                raise DataError(problem, file=file, hint="Correct the latter")
        return {file: tail or "" for file, tail in zip(files, found, strict=True)}


def load_fleet(path: Path) -> FleetConfig:
    """Read a fleet's TOML file; its paths become absolute. Raises `ConfigError`."""
    config = FleetConfig.parse(read_toml(path, CONFIG_SCHEMA), path)
    base = path.resolve().parent
    places = {
        name: str(base / place) for name in ("flights", "run")
        if "://" not in (place := getattr(config, name))
    }  # fmt: skip
    return config.model_copy(update=places)


class Run(NamedTuple):
    """A run that a worker can load: its address, the hash that it has to have, and trust."""

    address: str
    trust: bool
    sha256: str = ""


class File(NamedTuple):
    """A file of the work list; `first` names an earlier one of the same bytes."""

    name: str
    size: int
    sha256: str
    first: str = ""


@dataclass(frozen=True)
class Batch:
    """Files of one tail that are evaluated and written together."""

    tail: str
    number: int
    run: Run
    files: tuple[File, ...]

    @property
    def part(self) -> str:
        return f"{_folder(self.tail)}/{self.number:05d}.parquet"


def _folder(tail: str) -> str:
    """Folder of a tail; readers of datasets pass over names that begin with `.` or `_`."""
    name = quote(tail, safe=" ")
    return f"%{ord(name[0]):02X}{name[1:]}" if name[0] in "._" else name


# --- what a worker does ---


def evaluate_batch(batch: Batch, flights: Folder) -> tuple[Batch, dict[str, Any]]:
    """Evaluate the files of a batch; returns it with its pyarrow tables.

    A log that fails is a row with its reason. Raises `ModelError` for a run that is not the one.
    """
    pa, _ = arrow(Path(WORK_LIST))
    rows: dict[str, list[Row]] = {name: [] for name in TABLES}
    for file in batch.files:
        for name, found in _of_file(file, batch.run, flights).items():
            rows[name] += [{"tail": batch.tail, "file": file.name, **row} for row in found]
    return batch, as_tables(pa, rows)


def _of_file(file: File, run: Run, flights: Folder) -> dict[str, list[Row]]:
    bundle, settings = _loaded(run)
    failed = partial(not_evaluated, FAILED, size=file.size, sha256=file.sha256)
    if file.first:
        what = f"the same bytes as {file.first}, which counts"
        return not_evaluated(DUPLICATE, what, file.size, file.sha256)
    place = file.name
    try:
        with flights.on_disk(file.name) as path:
            place = str(path)
            logs = evaluation_logs(bundle, [path])
        found: dict[str, list[Row]] = {name: [] for name in TABLES}
        for log in logs:
            if log.source.sha256 != file.sha256:
                return failed(f"the file changed: sha256 was {file.sha256[:12]}")
            for name, rows in rows_of(assess_log(bundle, log, settings), settings).items():
                found[name] += rows
    except NarxcalError as error:
        # The row says which file, and the dataset does not depend on where the flights are.
        return failed(str(error).removeprefix(f"{place}: ").replace(place, file.name))
    except Exception as error:  # noqa: BLE001 -- one log of 100,000 must not end the fleet
        return failed(f"internal error: {type(error).__name__}: {error}")
    found["logs"] = [{**row, "size": file.size} for row in found["logs"]]
    return found


@lru_cache(maxsize=4)
def _loaded(run: Run) -> tuple[Bundle, EvaluateConfig]:
    """A run with its settings of the evaluation; kept, for it is known by its hash."""
    return _read(run)


def _read(run: Run) -> tuple[Bundle, EvaluateConfig]:
    with Folder(run.address).on_disk("") as folder:
        bundle = load_bundle(folder, trust=run.trust)
    if run.sha256 and bundle.sha256 != run.sha256:
        raise ModelError(
            f"expected the run with sha256 {run.sha256[:12]}, found {bundle.sha256[:12]}",
            file=run.address,
            hint="Every worker has to read the same run",
        )
    return bundle, run_config(bundle)[1]


def _hashed(names: tuple[str, ...], flights: Folder) -> dict[str, str]:
    """Name -> sha256 of files; empty for one that cannot be read, which its evaluation reports."""
    found = {}
    for name in names:
        try:
            with flights.on_disk(name) as path:
                found[name] = sha256_of(path)
        except (NarxcalError, OSError):
            found[name] = ""
    return found


# --- the dataset ---


def read_table(dataset: Folder, name: str) -> Any:
    """The work list, or a table of a dataset with all batches of it, as a pyarrow table.

    Raises `DataError` for a missing table or a damaged part, `ConfigError` without pyarrow.
    """
    if name == WORK_LIST:
        return _read_part(dataset, name)
    pa, _ = arrow(Path(WORK_LIST))
    parts = dataset.sizes([f"{name}/*/*.parquet"])
    if not parts:
        hint = "Restore it, or remove the table logs: all is then computed anew"
        raise DataError(f"the table {name} is missing", file=dataset.address, hint=hint)
    return pa.concat_tables([_read_part(dataset, part) for part in parts])


def _read_part(dataset: Folder, name: str) -> Any:
    """One file of a dataset, with the columns and types of its table and no text left out."""
    pa, parquet = arrow(Path(name))
    columns = _LIST_COLUMNS if name == WORK_LIST else TABLES[name.partition("/")[0]]
    place = f"{dataset.address}/{name}"
    hint = "Restore it, or choose another --out"
    if name != WORK_LIST:
        hint = "Remove its batch from the table logs: it is then computed anew"
    try:
        table = parquet.read_table(io.BytesIO(dataset.read(name)))
        table.validate(full=True)
    except NarxcalError:
        raise
    except Exception:  # noqa: BLE001 -- a reader by others raises anything on a damaged file
        raise DataError("the Parquet file is damaged", file=place, hint=hint) from None
    found = {each.name: str(each.type) for each in table.schema}
    for column, kind in columns.items():
        wanted = str(pa.type_for_alias(kind))
        # As pandas writes what it has read: long texts, whole numbers of which some are missing.
        same = {wanted, f"large_{wanted}", "null", "double" if wanted == "int64" else wanted}
        if found.get(column) not in same:
            raise DataError(
                f"expected a column of {kind}, found {found.get(column, 'none')}",
                file=place, channel=column, hint=hint,
            )  # fmt: skip
    kinds = pa.schema([(column, pa.type_for_alias(kind)) for column, kind in columns.items()])
    table = table.select(list(columns)).cast(kinds)
    decisive = [name for name in _DECISIVE if name in columns]
    for number, row in enumerate(table.select(decisive).to_pylist()):
        wrong = _wrong_row(row)
        if wrong:
            raise DataError(wrong, file=place, row=number + 1, hint=hint)
    return table


def _wrong_row(row: Row) -> str:
    """What is wrong with a row of a dataset, of which a file may be read; empty for nothing."""
    empty = [name for name, value in row.items() if value is None]
    if empty:
        return f"its {empty[0]} is missing"
    file = PurePosixPath(row["file"])
    if ".." in file.parts or file.is_absolute() or PureWindowsPath(file).drive or not row["tail"]:
        return f"expected a tail and a file below the folder of flights, found {row['file']}"
    if row.get("batch", 0) < 0 or row.get("size", 0) < 0:
        return "expected a batch and a size of at least 0"
    if row.get("status", GOOD) not in {GOOD, FAILED, DUPLICATE}:
        return f"the status {row['status']} is unknown"
    return ""


class _Document(Section):
    """`fleet.json`."""

    schema_: Literal["narxcal.fleet-dataset/1"] = Field(alias="schema")
    runs: Mapping[str, str]
    versions: Mapping[str, str]


def read_document(dataset: Folder) -> _Document:
    """Read `fleet.json` of a dataset; raises `DataError` where it is missing or another."""
    hint = "Name the folder that narxcal fleet wrote"
    if not dataset.has(DOCUMENT):
        raise DataError(f"there is no {DOCUMENT}", file=dataset.address, hint=hint)
    place, table = f"{dataset.address}/{DOCUMENT}", {}
    with suppress(ValueError, RecursionError):
        found = json.loads(dataset.read(DOCUMENT))
        table = found if isinstance(found, dict) else {}
    schema = table.get("schema")
    if schema != SCHEMA:
        raise DataError(f"expected the schema {SCHEMA}, found {schema}", file=place, hint=hint)
    try:
        return _Document.parse(table, place)
    except ConfigError as error:
        raise DataError(error.problem, file=place, hint=hint) from None


@dataclass
class Fleet:
    """A dataset in a folder, and how it grows; `trust` as of `load_bundle`."""

    out: Folder
    config: FleetConfig
    jobs: int = 1
    trust: bool = False
    _runs: dict[str, tuple[Run, str]] = field(default_factory=dict)

    @cached_property
    def flights(self) -> Folder:
        return Folder(self.config.flights)

    def list_files(self, progress: Progress = silent) -> list[Row]:
        """The work list, with the files that came since and all hashes; stored.

        Raises `DataError` for flights that are not there or have changed, `ConfigError` for a
        folder with other content or the results of another run or version, `ModelError` for a run
        that cannot be loaded.
        """
        sizes = self.flights.sizes(self.config.files)
        if not sizes:
            raise DataError(
                f"no file matches {' or '.join(self.config.files)}",
                file=self.config.flights,
                hint="Set flights and files",
            )
        known = self._stored_list(sizes)
        rows = [*known, *self._new_rows(sizes, known)]
        self._write_document({row["tail"] for row in rows})
        for row in rows:
            row["engine"] = row["engine"] or self._run(row["tail"])[1]
        self._write_list(rows)
        self._hash(rows, progress)
        return rows

    def _stored_list(self, sizes: Mapping[str, int]) -> list[Row]:
        if not self.out.has(WORK_LIST):
            if self.out.sizes(["logs/*/*.parquet"]):
                hint = "Restore it, or choose another --out"
                raise DataError("the work list is missing", file=self.out.address, hint=hint)
            return []
        rows: list[Row] = _read_part(self.out, WORK_LIST).to_pylist()
        for row in rows:
            size = sizes.get(row["file"], row["size"])
            if size != row["size"]:
                raise DataError(
                    f"it had {row['size']} bytes when it was listed, now {size}",
                    file=f"{self.config.flights}/{row['file']}",
                    hint="Restore it, or evaluate the fleet into another --out",
                )
        return rows

    def _new_rows(self, sizes: Mapping[str, int], known: Sequence[Row]) -> Iterator[Row]:
        """Rows of the files that are not listed yet, in batches that follow those of their tail."""
        listed = {row["file"] for row in known}
        tails = self.config.tails_of([name for name in sizes if name not in listed])
        after = {row["tail"]: row["batch"] + 1 for row in known}
        new = sorted(tails, key=lambda name: (tails[name], name))
        for tail, names in groupby(new, key=tails.__getitem__):
            for k, name in enumerate(names):
                number = after.get(tail, 0) + k // self.config.batch
                yield {
                    "tail": tail, "batch": number, "file": name, "size": sizes[name], "sha256": "",
                    "engine": "",
                }  # fmt: skip

    def _run(self, tail: str) -> tuple[Run, str]:
        """The run of a tail with its hash, and the engines that it reads from a file."""
        run = Run(self.config.run.replace(_TAIL, tail), self.trust)
        if run.address not in self._runs:
            bundle, _ = _read(run)
            if not bundle.sha256:
                problem = "the run has no hash over all of it"
                raise ModelError(problem, file=run.address, hint="Train it anew")
            logs = run_config(bundle)[0].logs
            if logs.flights:
                raise ConfigError(
                    "[logs] flights of the run joins files, and a fleet evaluates file by file",
                    file=run.address,
                    hint="Join the files of a flight before, or evaluate the run on their folder",
                )
            engines = ",".join(logs.engines)
            self._runs[run.address] = run._replace(sha256=bundle.sha256), engines
        return self._runs[run.address]

    def _write_document(self, tails: set[str]) -> None:
        """Write which runs and versions this is of, or refuse a folder that is of others."""
        runs = {tail: self._run(tail)[0].sha256 for tail in sorted(tails)}
        document = {"schema": SCHEMA, "runs": runs, "versions": identity()}
        if self.out.has(DOCUMENT):
            self._check_document(read_document(self.out), document)
        elif self.out.sizes(["*", "*/*"]):
            raise ConfigError(
                "the folder holds other content", file=self.out.address, hint="Choose another --out"
            )
        self.out.write(DOCUMENT, to_json(document).encode())

    def _check_document(self, stored: _Document, own: Mapping[str, Any]) -> None:
        wrong = [
            (f"of {tail} are of the run with sha256 {was[:12]}, this one has {now[:12]}", "run")
            for tail, now in own["runs"].items()
            if (was := stored.runs.get(tail, now)) != now
        ] + [
            (f"are of {name} {was}, this is {name} {now}", "version")
            for name, now in own["versions"].items()
            if (was := stored.versions.get(name, "none")) != now
        ]
        for problem, what in wrong:
            hint = f"Choose another --out, or that {what}"
            raise ConfigError(f"the results {problem}", file=self.out.address, hint=hint)

    def _hash(self, rows: Sequence[Row], progress: Progress) -> None:
        """Fill in missing hashes; what is known is stored, also if this is interrupted."""
        waiting = [row for row in rows if not row["sha256"]]
        if not waiting:
            return
        each, count = {row["file"]: row for row in waiting}, self.config.batch
        names = list(each)
        groups = [tuple(names[k : k + count]) for k in range(0, len(names), count)]
        task, done, stored = partial(_hashed, flights=self.flights), 0, time.monotonic()
        jobs = max(1, min(self.jobs, len(groups)))
        try:
            for found in in_processes(task, groups, jobs, ordered=False):
                for name, sha256 in found.items():
                    each[name]["sha256"] = sha256
                done += len(found)
                progress(done, len(names), "hashes")
                if time.monotonic() > stored + _STORE_EVERY_S:
                    self._write_list(rows)
                    stored = time.monotonic()
        finally:
            self._write_list(rows)

    def batches(self, rows: Sequence[Row]) -> list[Batch]:
        """Those that are not in the dataset yet."""
        done = set(self.out.sizes(["logs/*/*.parquet"]))
        first: dict[str, str] = {}
        found = []
        for (tail, number), group in groupby(rows, key=lambda row: (row["tail"], row["batch"])):
            files = []
            for row in group:
                name, sha256 = row["file"], row["sha256"]
                earlier = first.setdefault(sha256, name) if sha256 else name
                files.append(File(name, row["size"], sha256, earlier if earlier != name else ""))
            batch = Batch(tail, number, self._run(tail)[0], tuple(files))
            found += [batch] if f"logs/{batch.part}" not in done else []
        return found

    def grow(self, batches: Sequence[Batch], progress: Progress = silent) -> None:
        """Evaluate batches and write them one by one as they come; `progress` counts files.

        Raises as `in_processes`, but for a file of which the workers die: that is a row.
        """
        left = {batch.part: batch for batch in batches}
        total = sum(len(batch.files) for batch in batches)
        work = partial(evaluate_batch, flights=self.flights)
        jobs = max(1, min(self.jobs, len(left)))
        while left:
            try:
                for batch, tables in in_processes(work, list(left.values()), jobs, ordered=False):
                    self._write(left.pop(batch.part), tables)
                    files = sum(len(each.files) for each in left.values())
                    progress(total - files, total, batch.tail)
            except WorkerDied as died:
                batch = left[died.item.part]
                self._write(batch, self._file_by_file(batch))
                del left[batch.part]

    def _file_by_file(self, batch: Batch) -> dict[str, Any]:
        """Tables of a batch with a file of which workers die, in a task for each file."""
        pa, _ = arrow(Path(WORK_LIST))
        work = partial(evaluate_batch, flights=self.flights)
        found = []
        for file in batch.files:
            try:
                ((_, tables),) = in_processes(work, [replace(batch, files=(file,))], 1)
            except WorkerDied as died:
                whose = {"tail": batch.tail, "file": file.name}
                rows = not_evaluated(FAILED, died.problem, file.size, file.sha256)["logs"]
                tables = as_tables(pa, {"logs": [{**whose, **row} for row in rows]})
            found.append(tables)
        return {
            name: pa.concat_tables([each[name] for each in found]).combine_chunks()
            for name in TABLES
        }

    def _write(self, batch: Batch, tables: Mapping[str, Any]) -> None:
        for name in sorted(tables, key=lambda name: name == "logs"):
            self._write_table(f"{name}/{batch.part}", tables[name])

    def _write_table(self, name: str, table: Any) -> None:
        _, parquet = arrow(Path(name))
        stream = io.BytesIO()
        parquet.write_table(table, stream)
        self.out.write(name, stream.getvalue())

    def _write_list(self, rows: Sequence[Row]) -> None:
        pa, _ = arrow(Path(WORK_LIST))
        kinds = [(name, pa.type_for_alias(kind)) for name, kind in _LIST_COLUMNS.items()]
        self._write_table(WORK_LIST, pa.Table.from_pylist(list(rows), pa.schema(kinds)))
