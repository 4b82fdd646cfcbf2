"""The C compiler of this machine, and a compiled model run from Python."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from narxcal.export.program import Program, shipped
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ModelError

_FLAGS = ("-std=c99", "-O2", "-fPIC", "-w")
SUFFIX = ".dylib" if sys.platform == "darwin" else ".so"


def compiler() -> str | None:
    """Path of the C compiler, None where there is none."""
    return shutil.which("cc")


def compiled(code: Mapping[str, str], flags: Sequence[str] = ()) -> bytes:
    """Compile `code` {file: text} to a shared library."""
    found = compiler()
    if found is None:
        raise ModelError(
            "the model has to be compiled, and there is no C compiler 'cc' on the PATH",
            hint="Install one (on Debian: apt install gcc), or export a table or the sources",
        )
    shared = "-dynamiclib" if sys.platform == "darwin" else "-shared"
    with tempfile.TemporaryDirectory(prefix="narxcal_c_") as folder:
        for name, text in code.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        sources = [name for name in code if name.endswith(".c")]
        done = subprocess.run(  # noqa: S603  (the user's compiler on our sources)
            [found, shared, *_FLAGS, *flags, *sources, "-o", "model", "-lm"],
            cwd=folder, capture_output=True, text=True, check=False,
        )  # fmt: skip
        if done.returncode:
            output = (done.stderr or done.stdout).strip().splitlines() or ["nothing"]
            raise ModelError(
                f"the C compiler failed with exit code {done.returncode}: {output[-1]}",
                file=found,
                hint="Check that it compiles C, or export a table",
            )
        return (Path(folder) / "model").read_bytes()


@dataclass(frozen=True, eq=False)
class Compiled:
    """A compiled model: one state, and the functions of `engine.h`."""

    library: Any
    state: Any
    inputs: int
    outputs: int

    @classmethod
    def of(cls, program: Program) -> Self:
        """Compile and load a program; raises `ModelError` as `compiled`."""
        with tempfile.TemporaryDirectory(prefix="narxcal_c_") as folder:
            file = Path(folder) / f"engine{SUFFIX}"
            file.write_bytes(compiled({**program.code, "many.c": shipped("many.c")}))
            library = ctypes.CDLL(str(file))
        inputs, outputs = len(program.model.input_names), len(program.model.output_names)
        number, flag = ctypes.c_double, ctypes.c_int
        now = [number * outputs, number * outputs, flag, flag]
        own = [number * inputs, number * max(program.states, 1), _structure("Outputs", now), flag]
        return cls(library, _structure("State", own)(), inputs, outputs)

    def start(
        self, inputs: FloatArray, measured: FloatArray | None = None, engine: int = 0
    ) -> FloatArray:
        """Begin at inputs (n_in,); returns values, half-widths, inside and held in a row."""
        given = None if measured is None else _pointer(measured)
        self.library.narxcal_start(ctypes.byref(self.state), engine, _pointer(inputs), given)
        value, half_width, inside, held = (getattr(self.state.f2, f"f{k}") for k in range(4))
        return np.array([*value, *half_width, inside, held])

    def steps(self, inputs: FloatArray) -> FloatArray:
        """Advance through the samples of inputs (time, n_in); rows as of `start`."""
        rows = np.empty((len(inputs), 2 * self.outputs + 2))
        count = ctypes.c_size_t(len(inputs))
        state = ctypes.byref(self.state)
        self.library.narxcal_many(state, _pointer(inputs), count, _pointer(rows))
        return rows

    def run(
        self, inputs: FloatArray, measured: FloatArray | None = None, engine: int = 0
    ) -> FloatArray:
        """Free run over inputs (time, n_in); rows as of `start`."""
        return np.vstack([self.start(inputs[0], measured, engine), self.steps(inputs[1:])])

    def step_us(self, inputs: FloatArray) -> float:
        """CPU time of a step in microseconds, over inputs (time, n_in)."""
        given = np.ascontiguousarray(np.tile(inputs, (1 + 20_000 // len(inputs), 1)))
        begin = time.process_time()
        self.steps(given)
        return 1e6 * (time.process_time() - begin) / len(given)


def _structure(name: str, kinds: Sequence[Any]) -> Any:
    fields = [(f"f{number}", kind) for number, kind in enumerate(kinds)]
    return type(name, (ctypes.Structure,), {"_fields_": fields})


def _pointer(values: FloatArray) -> Any:
    """Address of an array, which the pointer keeps alive."""
    return np.ascontiguousarray(values, dtype=np.float64).ctypes.data_as(
        ctypes.POINTER(ctypes.c_double)
    )
