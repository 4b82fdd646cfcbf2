"""Write a steady-state model as a compiled FMU for co-simulation, FMI 2.0 or 3.0.

An FMU is a zip archive of modelDescription.xml, the compiled library, and its C sources: the fixed
ones in `narxcal/export/c`, and the sampled model as C arrays.
"""

from __future__ import annotations

import hashlib
import io
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from os import PathLike
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from narxcal.channels import CHANNELS
from narxcal.export.grid import Block, Grid, GriddedModel
from narxcal.export.plan import Planned, plan
from narxcal.export.report import ExportOptions, ExportReport, description, generation_tool
from narxcal.steady.model import Envelope, SteadyStateModel
from narxcal.support.errors import ConfigError, ModelError
from narxcal.support.files import atomic_write_bytes

_PER_LINE = 8


def sources(gridded: GriddedModel, version: str) -> tuple[str, dict[str, str]]:
    """Token that identifies the model, and the C files of FMI `version` "2.0" or "3.0"."""
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
    """Start values of the inputs: zero, or the end of the envelope nearest to it."""
    zero: list[float] = gridded.envelope.clamp(np.zeros(len(gridded.input_names))).tolist()
    return zero


def _shipped(name: str) -> str:
    return files("narxcal.export").joinpath("c", name).read_text(encoding="utf-8")


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
    """Format as a C array; `repr` is the shortest text that is read back exactly."""
    texts = [repr(value) for value in values]
    lines = [",".join(texts[k : k + _PER_LINE]) for k in range(0, len(texts), _PER_LINE)]
    return f"static const {kind} {name}[] = {{\n" + ",\n".join(lines) + "\n};\n"


# Factor and offset to SI base units, for units that the standard can describe.
_SI: dict[str, dict[str, str]] = {
    "deg": {"rad": "1", "factor": "0.017453292519943295"},
    "ft": {"m": "1", "factor": "0.3048"},
    "degC": {"K": "1", "offset": "273.15"},
    "%": {"factor": "0.01"},
    "kg/h": {"kg": "1", "s": "-1", "factor": "0.0002777777777777778"},
    "kN": {"kg": "1", "m": "1", "s": "-2", "factor": "1000"},
}


@dataclass(frozen=True)
class Variable:
    """One variable of the FMU with its value reference; only inputs have a `start`."""

    name: str
    reference: int
    text: str
    start: float | None = None

    @property
    def unit(self) -> str | None:
        """Its unit, None for a number without unit."""
        unit = CHANNELS[self.name].unit if self.name in CHANNELS else "-"
        return unit if unit in _SI else None


@dataclass(frozen=True)
class Description:
    """Content of the XML: names, token, origin of the model, variables, sources."""

    identifier: str
    token: str
    text: str
    tool: str
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    sources: tuple[str, ...]


def variables(
    names: tuple[Sequence[str], Sequence[str]], start: Sequence[float], envelope: Envelope
) -> tuple[tuple[Variable, ...], tuple[Variable, ...]]:
    """Inputs and outputs of the FMU, `inside` the last of the outputs."""
    ends = zip(envelope.low, envelope.high, strict=True)
    inputs = tuple(
        Variable(name, k, f"{CHANNELS[name].meaning}, from {low:g} to {high:g}", value)
        for k, (name, value, (low, high)) in enumerate(zip(names[0], start, ends, strict=True))
    )
    first = len(inputs)
    outputs = [
        Variable(name, first + k, f"{CHANNELS[name].meaning}, settled")
        for k, name in enumerate(names[1])
    ]
    inside = "1 if the inputs are inside the envelope, 0 if they were held at its border"
    outputs.append(Variable("inside", first + len(outputs), inside))
    return inputs, tuple(outputs)


def model_description(about: Description, version: str) -> bytes:
    """Write the XML of FMI `version` "2.0" or "3.0"."""
    token = "guid" if version == "2.0" else "instantiationToken"
    root = Element(
        "fmiModelDescription",
        {
            "fmiVersion": version,
            "modelName": about.identifier,
            token: about.token,
            "description": about.text,
            "generationTool": about.tool,
            "variableNamingConvention": "flat",
        },
    )
    simulation = SubElement(
        root,
        "CoSimulation",
        {"modelIdentifier": about.identifier, "canHandleVariableCommunicationStepSize": "true"},
    )
    if version == "2.0":
        simulation.set("canNotUseMemoryManagementFunctions", "true")
        listed = SubElement(simulation, "SourceFiles")
        for name in about.sources:
            SubElement(listed, "File", {"name": name})
    _units(root, about)
    if version == "2.0":
        _variables2(root, about)
    else:
        _variables3(root, about)
    return _text(root)


def build_description(about: Description) -> bytes:
    """Write sources/buildDescription.xml, required by FMI 3.0 (FMI 3.0.2, section 2.5.2)."""
    root = Element("fmiBuildDescription", {"fmiVersion": "3.0"})
    build = SubElement(root, "BuildConfiguration", {"modelIdentifier": about.identifier})
    files = SubElement(build, "SourceFileSet", {"language": "C99"})
    for name in about.sources:
        SubElement(files, "SourceFile", {"name": name})
    return _text(root)


def _units(root: Element, about: Description) -> None:
    used = {one.unit for one in (*about.inputs, *about.outputs)}
    known = [unit for unit in _SI if unit in used]
    if not known:
        return
    definitions = SubElement(root, "UnitDefinitions")
    for unit in known:
        SubElement(SubElement(definitions, "Unit", {"name": unit}), "BaseUnit", _SI[unit])


def _value(variable: Variable) -> dict[str, str]:
    """Attributes of unit and start, the same in both versions."""
    found = {"unit": variable.unit, "start": None}
    if variable.start is not None:
        found["start"] = repr(variable.start)
    if variable.name == "dT_C":
        found["relativeQuantity"] = "true"  # a difference: the offset of degC does not apply
    return {key: text for key, text in found.items() if text is not None}


def _role(variable: Variable, causality: str) -> dict[str, str]:
    discrete = variable.name == "inside"
    return {
        "name": variable.name,
        "valueReference": str(variable.reference),
        "causality": causality,
        "variability": "discrete" if discrete else "continuous",
        "description": variable.text,
    }


def _all(about: Description) -> list[tuple[Variable, str]]:
    return [(one, "input") for one in about.inputs] + [(one, "output") for one in about.outputs]


def _variables2(root: Element, about: Description) -> None:
    listed = SubElement(root, "ModelVariables")
    for variable, causality in _all(about):
        scalar = SubElement(listed, "ScalarVariable", _role(variable, causality))
        SubElement(scalar, "Real", _value(variable))
    structure = SubElement(root, "ModelStructure")
    for part in ("Outputs", "InitialUnknowns"):
        unknowns = SubElement(structure, part)
        for variable in about.outputs:
            # Indices count from one, in the order of the variables.
            SubElement(unknowns, "Unknown", {"index": str(variable.reference + 1)})


def _variables3(root: Element, about: Description) -> None:
    listed = SubElement(root, "ModelVariables")
    time = {"name": "time", "causality": "independent", "variability": "continuous"}
    reference = str(len(about.inputs) + len(about.outputs))
    SubElement(listed, "Float64", {**time, "valueReference": reference})
    for variable, causality in _all(about):
        SubElement(listed, "Float64", {**_role(variable, causality), **_value(variable)})
    structure = SubElement(root, "ModelStructure")
    for part in ("Output", "InitialUnknown"):
        for variable in about.outputs:
            SubElement(structure, part, {"valueReference": str(variable.reference)})


def _text(root: Element) -> bytes:
    indent(root)
    xml: bytes = tostring(root, encoding="UTF-8", xml_declaration=True)
    return xml + b"\n"


# Archives contain no time of writing, so that the same model gives the same bytes.
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

    The FMU interpolates multilinearly in double precision, clamps inputs to the envelope and
    reports that in its output `inside`. Switches whose effects add up get grids of their own, which
    makes it much finer than a table of the same size. It runs on the platform that it was made on
    and contains its sources for others (`fmpy compile`).

    Raises `ModelError` where FMPy or a C compiler is missing, where compiling fails and as
    `plan`; `ConfigError` for another `fmi` and where the file cannot be written.
    """
    chosen, file = options or ExportOptions(), Path(path)
    toolchain = _Toolchain.found(fmi)
    planned = plan(model, grid, chosen, separate=True)
    draft = planned.report(grid, chosen, str(file), 0)
    text = "; ".join(description(draft, chosen.source))
    about, code = _described(planned, _identifier(file), text, fmi)
    chosen.progress(0, 1, "compiling")
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
    """Make a C identifier from the name of the file."""
    name = re.sub(r"\W", "_", file.stem, flags=re.ASCII)
    return name if name[:1].isalpha() else f"model_{name}"


@dataclass(frozen=True)
class _Toolchain:
    """A C compiler, the headers of the standard, and the place of the binary in the archive."""

    compiler: str
    headers: Path
    folder: str
    suffix: str

    @classmethod
    def found(cls, fmi: str) -> _Toolchain:
        """Find compiler and headers before any other work."""
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
                output = (done.stderr or done.stdout).strip().splitlines() or ["nothing"]
                raise ModelError(
                    f"the C compiler failed with exit code {done.returncode}: {output[-1]}",
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
