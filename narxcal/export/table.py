"""Writes a steady-state model as a table that `narxcal.steady.table` reads back."""

from __future__ import annotations

import gzip
from importlib.metadata import PackageNotFoundError, version
from os import PathLike
from pathlib import Path

import numpy as np

from narxcal.export.grid import Grid
from narxcal.export.plan import Planned, plan
from narxcal.export.report import ExportOptions, ExportReport
from narxcal.steady.model import SteadyStateModel
from narxcal.support.files import atomic_write_bytes


def export_table(
    model: SteadyStateModel,
    grid: Grid,
    path: str | PathLike[str],
    options: ExportOptions | None = None,
) -> ExportReport:
    """Sample `model` on a full grid and write a CSV (or .csv.gz), whole or not at all.

    `grid` has the nodes to start from; see `ExportOptions` for how many are added. Inputs of
    one node are left out. The same model and options give the same bytes.

    Raises `ModelError` as `plan`, and `ConfigError` where the file cannot be written.
    """
    chosen, file = options or ExportOptions(), Path(path)
    planned = plan(model, grid, chosen, separate=False)
    draft = planned.report(grid, chosen, str(file), 0)
    data = (_comments(draft, chosen.source) + _rows(planned)).encode("utf-8")
    if file.suffix == ".gz":
        data = gzip.compress(data, compresslevel=9, mtime=0)
    atomic_write_bytes(file, data)
    return planned.report(grid, chosen, str(file), len(data))


def generation_tool() -> str:
    """Name and version of what writes the files."""
    try:
        return f"narxcal {version('narxcal')}"
    except PackageNotFoundError:  # run from a checkout that is not installed
        return "narxcal"


def description(report: ExportReport, source: str) -> list[str]:
    """Where an export comes from and how far it can be trusted, in lines."""
    fixed = ", ".join(f"{name} = {value:g}" for name, value in report.fixed.items())
    model = " ".join(["Steady-state engine model", *"".join(filter(_plain, source)).split()])
    return [
        f"{model}, sampled by {generation_tool()}",
        f"Largest interpolation errors at {report.measured.inside} random conditions",
        *(
            f"{output.name} {output.max:.3g} {output.unit} ({output.max_pct:.2g} % of its range), "
            f"RMS {output.rms:.2g}"
            for output in report.measured.outputs
        ),
        *([f"Holds for {fixed} only"] if fixed else []),
    ]


def _plain(letter: str) -> bool:
    """Whether a letter can stand in a comment and in XML."""
    return letter.isprintable() or letter.isspace()


def _comments(report: ExportReport, source: str) -> str:
    return "".join(f"# {line}\n" for line in description(report, source))


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
