"""Reads the table of a steady-state model from a CSV file."""

from __future__ import annotations

import csv
import gzip
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from narxcal.channels import channel
from narxcal.errors import DataError
from narxcal.steady_options import Method
from narxcal.steady_table import SteadyTable

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from os import PathLike

    from narxcal.steady_state import Floats

_DELIMITERS = (",", ";", "\t")


def read_steady_table(
    path: str | PathLike[str],
    input_names: Sequence[str] | None = None,
    output_names: Sequence[str] | None = None,
    method: Method = "linear",
) -> SteadyTable:
    """Read a CSV (or .csv.gz) whose header holds canonical channels in canonical units.

    Lines that start with `#` are comments. Where the header is separated by `;` or tabs, numbers
    may have decimal commas. By default the channels with the role of an output
    are the outputs and the others the inputs; name them where one is otherwise (fuel flow as
    the driver). Further columns are ignored.

    Raises `DataError` naming file, row (line of the file) and value, and `ConfigError` for a
    name that is no channel.
    """
    file = Path(path)
    header, rows = _read_rows(file)
    outputs = tuple(output_names or _by_role(header, input_names or (), output=True))
    inputs = tuple(input_names or _by_role(header, outputs, output=False))
    for name in (*inputs, *outputs):
        channel(name)
        if name not in header:
            raise DataError(
                "the table lacks this column",
                file=file,
                channel=name,
                hint=f"Columns found: {', '.join(header)}",
            )
    if not inputs or not outputs:
        raise DataError(
            f"the table needs input and output columns, got inputs {list(inputs)} and outputs "
            f"{list(outputs)}",
            file=file,
        )
    numbers = _numbers(file, rows, {name: header.index(name) for name in (*inputs, *outputs)})
    try:
        return SteadyTable(
            (inputs, outputs), numbers[:, : len(inputs)], numbers[:, len(inputs) :], method
        )
    except DataError as error:
        raise DataError(error.problem, file=file, channel=error.channel, hint=error.hint) from None


def _by_role(header: Sequence[str], taken: Sequence[str], *, output: bool) -> list[str]:
    return [
        name
        for name in header
        if name not in taken
        and channel(name).role != "time"
        and (channel(name).role == "output") == output
    ]


def _read_rows(file: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    if not file.is_file():
        raise DataError("the table does not exist", file=file)
    opener = gzip.open if file.suffix == ".gz" else open
    try:
        with opener(file, "rt", encoding="utf-8-sig", newline="") as stream:
            lines = _cells(stream)
    except (OSError, EOFError, UnicodeDecodeError, csv.Error) as error:
        raise DataError(f"the table cannot be read: {error}", file=file) from None
    if len(lines) < 2:
        raise DataError("the table has no rows", file=file)
    return lines[0][1], lines[1:]


def _cells(stream: Iterable[str]) -> list[tuple[int, list[str]]]:
    """Lines with content, each with its number in the file, in points whatever the decimal mark."""
    text = list(stream)
    header = next((line for line in text if line.strip() and not line.startswith("#")), "")
    delimiter = next((each for each in _DELIMITERS if each in header), ",")
    reader = csv.reader(text, delimiter=delimiter)
    return [
        (reader.line_num, [_in_points(cell.strip(), delimiter) for cell in row])
        for row in reader
        if any(row) and not row[0].startswith("#")
    ]


def _in_points(cell: str, delimiter: str) -> str:
    return cell if delimiter == "," else cell.replace(",", ".")


def _numbers(file: Path, rows: list[tuple[int, list[str]]], columns: Mapping[str, int]) -> Floats:
    result = np.empty((len(rows), len(columns)))
    for index, (line, cells) in enumerate(rows):
        for place, (name, column) in enumerate(columns.items()):
            text = cells[column] if column < len(cells) else ""
            result[index, place] = _number(text, file, name, line)
    return result


def _number(text: str, file: Path, name: str, line: int) -> float:
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise DataError(f"expected a number, got '{text}'", file=file, channel=name, row=line)
    return value
