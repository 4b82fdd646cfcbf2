"""Write a steady-state model as a CSV table that `narxcal.steady.table` reads."""

from __future__ import annotations

import gzip
from os import PathLike
from pathlib import Path

import numpy as np

from narxcal.export.grid import Grid
from narxcal.export.plan import Planned, plan
from narxcal.export.report import ExportOptions, ExportReport, description
from narxcal.steady.model import SteadyStateModel
from narxcal.support.files import atomic_write_bytes


def export_table(
    model: SteadyStateModel,
    grid: Grid,
    path: str | PathLike[str],
    options: ExportOptions | None = None,
) -> ExportReport:
    """Sample `model` on a full grid and write a CSV (or .csv.gz), completely or not at all.

    `grid` has the first nodes; `ExportOptions` limit how many are added. Inputs of one node are
    left out. The same model and options give the same bytes.

    Raises `ModelError` as `plan`, and `ConfigError` where the file cannot be written.
    """
    chosen, file = options or ExportOptions(), Path(path)
    planned = plan(model, grid, chosen, separate=False)
    draft = planned.report(grid, chosen, str(file), 0)
    comments = "".join(f"# {line}\n" for line in description(draft, chosen.source))
    data = (comments + _rows(planned)).encode("utf-8")
    if file.suffix == ".gz":
        data = gzip.compress(data, compresslevel=9, mtime=0)
    atomic_write_bytes(file, data)
    return planned.report(grid, chosen, str(file), len(data))


def _rows(planned: Planned) -> str:
    (block,) = planned.gridded.blocks
    nodes = [[repr(value) for value in axis.tolist()] for axis in block.axes]
    places = np.unravel_index(np.arange(block.rows), block.values.shape[:-1])
    values = block.values.reshape(block.rows, -1).tolist()
    lines = [",".join((*planned.gridded.input_names, *planned.gridded.output_names))]
    for where, row in zip(np.column_stack(places).tolist(), values, strict=True):
        at = [axis[place] for axis, place in zip(nodes, where, strict=True)]
        lines.append(",".join([*at, *(f"{value:.9g}" for value in row)]))
    return "\n".join(lines) + "\n"
