"""The C sources of an FMU: the fixed ones beside this module, and the table as C arrays."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from importlib.resources import files
from typing import Any

import numpy as np

from narxcal.steady_export.gridded import Block, GriddedModel

_PER_LINE = 8


def sources(gridded: GriddedModel, version: str) -> tuple[str, dict[str, str]]:
    """Token that names this very model, and the C files of FMI `version` "2.0" or "3.0"."""
    wrapper = f"fmi{version[0]}.c"
    fixed = {name: _shipped(name) for name in (wrapper, "steady.c", "steady.h")}
    table = _table(gridded)
    sizes = (
        f"#define N_IN {len(gridded.input_names)}\n"
        f"#define N_OUT {len(gridded.output_names)}\n"
        f"#define N_BLOCKS {len(gridded.blocks)}\n"
    )
    names = ",".join((*gridded.input_names, *gridded.output_names))
    everything = "".join([names, sizes, table, *fixed.values()])
    digest = hashlib.sha256(everything.encode("utf-8")).hexdigest()
    token = "{" + "-".join((digest[:8], *(digest[k : k + 4] for k in (8, 12, 16)), digest[20:32]))
    token += "}"
    sizes += f'#define TOKEN "{token}"\n'
    return token, {**fixed, "sizes.h": sizes, "table.h": table}


def start_values(gridded: GriddedModel) -> list[float]:
    """Inputs before any is set: zero, or the end of the envelope nearest to it."""
    zero: list[float] = gridded.envelope.clamp(np.zeros(len(gridded.input_names))).tolist()
    return zero


def _shipped(name: str) -> str:
    return files("narxcal.steady_export").joinpath("c", name).read_text(encoding="utf-8")


def _table(gridded: GriddedModel) -> str:
    known = gridded.known.ravel()
    parts = [
        _array("double", "low_ends", gridded.envelope.low.tolist()),
        _array("double", "high_ends", gridded.envelope.high.tolist()),
        _array("double", "start_values", start_values(gridded)),
    ]
    if not known.all():
        parts.append(_array("unsigned char", "known", known.astype(int).tolist()))
    entries = []
    for number, block in enumerate(gridded.blocks):
        parts += _block(block, number)
        mask = "known" if number == 0 and not known.all() else "NULL"
        entries.append(_entry(block, number, mask))
    body = ",\n".join(entries)
    return "".join(parts) + f"static const Block blocks[] = {{\n{body}\n}};\n"


def _block(block: Block, number: int) -> list[str]:
    nodes = [value for axis in block.axes for value in axis.tolist()]
    return [
        _array("int", f"columns_{number}", block.columns),
        _array("size_t", f"lengths_{number}", [len(axis) for axis in block.axes]),
        _array("double", f"nodes_{number}", nodes),
        _array("double", f"values_{number}", block.values.ravel().tolist()),
    ]


def _entry(block: Block, number: int, mask: str) -> str:
    nodes = sum(len(axis) for axis in block.axes)
    return (
        f"    {{{len(block.columns)}, columns_{number}, lengths_{number}, {nodes}, "
        f"nodes_{number}, values_{number}, {mask}}}"
    )


def _array(kind: str, name: str, values: Iterable[Any]) -> str:
    """Write numbers with all their digits: repr is the shortest text that comes back exactly."""
    texts = [repr(value) for value in values]
    lines = [",".join(texts[k : k + _PER_LINE]) for k in range(0, len(texts), _PER_LINE)]
    return f"static const {kind} {name}[] = {{\n" + ",\n".join(lines) + "\n};\n"
