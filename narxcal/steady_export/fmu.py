"""Writes a steady-state model as a compiled FMU for co-simulation, FMI 2.0 or 3.0."""

from __future__ import annotations

import io
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

from narxcal.atomic import atomic_write_bytes
from narxcal.errors import ConfigError, ModelError
from narxcal.steady_export.c_source import sources, start_values
from narxcal.steady_export.description import (
    Description,
    build_description,
    model_description,
    variables,
)
from narxcal.steady_export.grid import Grid
from narxcal.steady_export.plan import Planned, plan
from narxcal.steady_export.report import ExportOptions, ExportReport
from narxcal.steady_export.table import description, generation_tool
from narxcal.steady_state import SteadyStateModel

# Archives bear no time, so that the same model gives the same bytes.
_NO_TIME = (1980, 1, 1, 0, 0, 0)
_FLAGS = ("-std=c99", "-O2", "-fPIC", "-w")


def export_fmu(
    model: SteadyStateModel,
    grid: Grid,
    path: str | PathLike[str],
    fmi: str = "2.0",
    options: ExportOptions | None = None,
) -> ExportReport:
    """Sample `model`, compile the C sources around the numbers, and write the FMU.

    The FMU interpolates multilinearly in double precision, holds inputs at the ends of the
    envelope and says so in its output `inside`. Switches whose effects add up get grids of
    their own, which makes it much finer than a table of the same size. It runs on machines
    like this one and carries its sources for others (`fmpy compile`).

    Raises `ModelError` where FMPy or a C compiler is missing, where compiling fails and as
    `plan`; `ConfigError` for another `fmi` and where the file cannot be written.
    """
    chosen, file = options or ExportOptions(), Path(path)
    toolchain = _Toolchain.found(fmi)
    planned = plan(model, grid, chosen, separate=True)
    draft = planned.report(grid, chosen, str(file), 0)
    text = "; ".join(description(draft, chosen.source))
    about, code = _described(planned, _identifier(file), text, fmi)
    chosen.watch(0, 1, "compiling")
    members = {
        "modelDescription.xml": model_description(about, fmi),
        f"binaries/{toolchain.folder}/{about.identifier}{toolchain.suffix}": toolchain.compiled(
            code, about.sources
        ),
        **{f"sources/{name}": text.encode("utf-8") for name, text in code.items()},
    }
    if fmi == "3.0":
        members["sources/buildDescription.xml"] = build_description(about)
    data = _archive(members)
    atomic_write_bytes(file, data)
    return planned.report(grid, chosen, str(file), len(data))


def _described(
    planned: Planned, identifier: str, text: str, fmi: str
) -> tuple[Description, dict[str, str]]:
    gridded = planned.gridded
    token, code = sources(gridded, fmi)
    names = (gridded.input_names, gridded.output_names)
    inputs, outputs = variables(names, start_values(gridded), gridded.envelope)
    to_compile = tuple(name for name in code if name.endswith(".c"))
    tool = generation_tool()
    return Description(identifier, token, text, tool, inputs, outputs, to_compile), code


def _identifier(file: Path) -> str:
    """Make a name that C allows from that of the file."""
    name = re.sub(r"\W", "_", file.stem, flags=re.ASCII)
    return name if name[:1].isalpha() else f"model_{name}"


@dataclass(frozen=True)
class _Toolchain:
    """A C compiler, the headers of the standard, and where the binary goes in the archive."""

    compiler: str
    headers: Path
    folder: str
    suffix: str

    @classmethod
    def found(cls, fmi: str) -> _Toolchain:
        """Look for everything before any work is done."""
        if fmi not in ("2.0", "3.0"):
            raise ConfigError(f"unknown FMI version '{fmi}'", hint="Use 2.0 or 3.0")
        try:
            import fmpy  # noqa: PLC0415  (an extra that most installations lack)
        except ImportError:
            raise ModelError(
                "an FMU needs the headers that FMPy ships, and it is not installed",
                hint="pip install 'narxcal[fmu]'",
            ) from None
        compiler = shutil.which("cc")
        if compiler is None:
            raise ModelError(
                "an FMU has to be compiled, and there is no C compiler 'cc' on the PATH",
                hint="Install one (on Debian: apt install gcc), or export a table",
            )
        headers = Path(fmpy.__path__[0]) / "c-code"
        if not (headers / f"fmi{fmi[0]}Functions.h").is_file():
            raise ModelError(
                f"FMPy {fmpy.__version__} lacks the headers of FMI {fmi}",
                file=headers,
                hint="Install the version of FMPy that constraints.txt names",
            )
        folder = fmpy.platform if fmi == "2.0" else fmpy.platform_tuple
        return cls(compiler, headers, folder, fmpy.sharedLibraryExtension)

    def compiled(self, code: Mapping[str, str], to_compile: tuple[str, ...]) -> bytes:
        """Compile `code` {file: text} in a folder of its own; raises `ModelError`."""
        shared = "-dynamiclib" if sys.platform == "darwin" else "-shared"
        with tempfile.TemporaryDirectory(prefix="narxcal_fmu_") as folder:
            for name, text in code.items():
                (Path(folder) / name).write_text(text, encoding="utf-8")
            command = [self.compiler, shared, *_FLAGS, f"-I{self.headers}", *to_compile]
            done = subprocess.run(  # noqa: S603  (the user's compiler on our sources)
                [*command, "-o", "model", "-lm"],
                cwd=folder,
                capture_output=True,
                text=True,
                check=False,
            )
            if done.returncode:
                said = (done.stderr or done.stdout).strip().splitlines() or ["nothing"]
                raise ModelError(
                    f"the C compiler failed with exit code {done.returncode}: {said[-1]}",
                    file=self.compiler,
                    hint="Check that it compiles C, or export a table",
                )
            return (Path(folder) / "model").read_bytes()


def _archive(members: Mapping[str, bytes]) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name, data in members.items():
            entry = zipfile.ZipInfo(name, _NO_TIME)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, data)
    return buffer.getvalue()
