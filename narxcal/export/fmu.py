"""Write a model as a compiled FMU for co-simulation, FMI 2.0 or 3.0.

An FMU is a zip archive of modelDescription.xml, the compiled library, and its C sources: those of
`narxcal.export.program`, and a wrapper that places its grid of samples in any communication step.
A steady state alone is a model without dynamics.
"""

from __future__ import annotations

import hashlib
import io
import re
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from narxcal.calibration.identified import IdentifiedCalibration, NoDynamics
from narxcal.channels import described
from narxcal.export.compiler import SUFFIX, compiled, compiler
from narxcal.export.grid import Grid
from narxcal.export.plan import plan
from narxcal.export.program import Program, shipped
from narxcal.export.report import ExportOptions, ExportReport, description, generation_tool
from narxcal.steady.model import SteadyStateModel
from narxcal.support.errors import ConfigError, ModelError
from narxcal.support.files import atomic_write_bytes

# Factor and offset to SI base units, for units that the standard can describe.
_SI: dict[str, dict[str, str]] = {
    "deg": {"rad": "1", "factor": "0.017453292519943295"},
    "ft": {"m": "1", "factor": "0.3048"},
    "degC": {"K": "1", "offset": "273.15"},
    "%": {"factor": "0.01"},
    "kg/h": {"kg": "1", "s": "-1", "factor": "0.0002777777777777778"},
    "kN": {"kg": "1", "m": "1", "s": "-2", "factor": "1000"},
    "rpm": {"rad": "1", "s": "-1", "factor": "0.10471975511965978"},
    "kW": {"kg": "1", "m": "2", "s": "-3", "factor": "1000"},
    "Nm": {"kg": "1", "m": "2", "s": "-2"},
    "kPa": {"kg": "1", "m": "-1", "s": "-2", "factor": "1000"},
    "A": {"A": "1"},
    "V": {"kg": "1", "m": "2", "s": "-3", "A": "-1"},
}


@dataclass(frozen=True)
class Variable:
    """One variable of the FMU; `kind` is Real, Integer or Boolean, as FMI 2.0 calls it."""

    name: str
    reference: int
    text: str
    causality: str
    kind: str = "Real"
    start: str | None = None
    channel: str = ""

    @property
    def unit(self) -> str | None:
        """Its unit, None for a number without unit."""
        unit = described(self.channel).unit
        return unit if unit in _SI else None

    @property
    def variability(self) -> str:
        if self.causality == "parameter":
            return "tunable" if self.kind == "Boolean" else "fixed"
        return "continuous" if self.channel else "discrete"


def variables(program: Program) -> list[Variable]:
    """Inputs, outputs and parameters, with the value references of fmi.h."""
    model, envelope = program.model, program.envelope
    inputs, outputs = model.input_names, model.output_names
    found = []
    for k, name in enumerate(inputs):
        low, high = envelope.low[k], envelope.high[k]
        text, start = f"{described(name).meaning}, from {low:g} to {high:g}", repr(program.start[k])
        found.append(Variable(name, k, text, "input", start=start, channel=name))
    settled, first, count = "" if program.states else ", settled", len(inputs), len(outputs)
    for k, name in enumerate(outputs):
        text = f"{described(name).meaning}{settled}"
        found.append(Variable(name, first + k, text, "output", channel=name))
    if model.interval is not None:
        for row, end in ((1, "low"), (2, "high")):
            for k, name in enumerate(outputs):
                text = f"{end} end of the interval of {100.0 * program.level:g} % of samples"
                at = first + row * count + k
                found.append(Variable(f"{name}_{end}", at, text, "output", channel=name))
    last = first + 3 * count
    inside = "1 if the inputs are inside the envelope, 0 if they were held at its border"
    held = "1 if an input was no number, so that its last value was used"
    found += [
        Variable("inside", last, inside, "output"),
        Variable("held", last + 1, held, "output"),
    ]
    if len(program.engines) > 1:
        names = ", ".join(f"{k} {name}" for k, name in enumerate(program.engines) if k)
        text = f"which engine: 0 in general, {names}"
        found.append(Variable("engine", last + 2, text, "parameter", "Integer", "0"))
    if program.states:
        text = "whether inputs run straight to their new values within a step, or have them at once"
        found.append(Variable("interpolate", last + 3, text, "parameter", "Boolean", "false"))
    return found


@dataclass(frozen=True, eq=False)
class Description:
    """Content of the XML: identifier, token, program, files to compile."""

    identifier: str
    token: str
    program: Program
    sources: tuple[str, ...]

    def model(self, version: str) -> bytes:
        """modelDescription.xml of FMI `version` "2.0" or "3.0"."""
        two = version == "2.0"
        root = Element(
            "fmiModelDescription",
            {
                "fmiVersion": version,
                "modelName": self.identifier,
                "guid" if two else "instantiationToken": self.token,
                "description": "; ".join(self.program.about),
                "generationTool": generation_tool(),
                "variableNamingConvention": "flat",
            },
        )
        state = "FMUstate" if two else "FMUState"
        simulation = SubElement(
            root,
            "CoSimulation",
            {
                "modelIdentifier": self.identifier,
                "canHandleVariableCommunicationStepSize": "true",
                f"canGetAndSet{state}": "true",
                f"canSerialize{state}": "true",
            },
        )
        if two:
            simulation.set("canNotUseMemoryManagementFunctions", "true")
            listed = SubElement(simulation, "SourceFiles")
            for name in self.sources:
                SubElement(listed, "File", {"name": name})
        found = variables(self.program)
        _units(root, found)
        if self.program.states:
            SubElement(root, "DefaultExperiment", {"stepSize": repr(self.program.model.dt_s)})
        (_variables2 if two else _variables3)(root, found)
        return _text(root)

    def build(self) -> bytes:
        """sources/buildDescription.xml, required by FMI 3.0 (FMI 3.0.2, section 2.5.2)."""
        root = Element("fmiBuildDescription", {"fmiVersion": "3.0"})
        build = SubElement(root, "BuildConfiguration", {"modelIdentifier": self.identifier})
        files = SubElement(build, "SourceFileSet", {"language": "C99"})
        for name in self.sources:
            SubElement(files, "SourceFile", {"name": name})
        return _text(root)


def _units(root: Element, found: list[Variable]) -> None:
    used = {one.unit for one in found}
    known = [unit for unit in _SI if unit in used]
    if not known:
        return
    definitions = SubElement(root, "UnitDefinitions")
    for unit in known:
        SubElement(SubElement(definitions, "Unit", {"name": unit}), "BaseUnit", _SI[unit])


def _value(variable: Variable) -> dict[str, str]:
    found = {"unit": variable.unit, "start": variable.start}
    if variable.channel == "dT_C":
        found["relativeQuantity"] = "true"  # a difference: the offset of degC does not apply
    return {key: text for key, text in found.items() if text is not None}


def _role(variable: Variable) -> dict[str, str]:
    return {
        "name": variable.name,
        "valueReference": str(variable.reference),
        "causality": variable.causality,
        "variability": variable.variability,
        "description": variable.text,
    }


def _variables2(root: Element, found: list[Variable]) -> None:
    listed = SubElement(root, "ModelVariables")
    for variable in found:
        scalar = SubElement(listed, "ScalarVariable", _role(variable))
        SubElement(scalar, variable.kind, _value(variable))
    structure = SubElement(root, "ModelStructure")
    for part in ("Outputs", "InitialUnknowns"):
        unknowns = SubElement(structure, part)
        # Indices count from one, in the order of the variables.
        for index, variable in enumerate(found, start=1):
            if variable.causality == "output":
                SubElement(unknowns, "Unknown", {"index": str(index)})


_KINDS3 = {"Real": "Float64", "Integer": "Int32", "Boolean": "Boolean"}


def _variables3(root: Element, found: list[Variable]) -> None:
    listed = SubElement(root, "ModelVariables")
    time = {"name": "time", "causality": "independent", "variability": "continuous"}
    # Behind `held` and the two parameters.
    last = next(one.reference for one in found if one.name == "held") + 3
    SubElement(listed, "Float64", {**time, "valueReference": str(last)})
    for variable in found:
        SubElement(listed, _KINDS3[variable.kind], {**_role(variable), **_value(variable)})
    structure = SubElement(root, "ModelStructure")
    for part in ("Output", "InitialUnknown"):
        for variable in found:
            if variable.causality == "output":
                SubElement(structure, part, {"valueReference": str(variable.reference)})


def _text(root: Element) -> bytes:
    indent(root)
    xml: bytes = tostring(root, encoding="UTF-8", xml_declaration=True)
    return xml + b"\n"


def export_fmu(
    model: SteadyStateModel,
    grid: Grid,
    path: str | PathLike[str],
    fmi: str = "2.0",
    options: ExportOptions | None = None,
) -> ExportReport:
    """Sample a steady-state model and write it as an FMU without dynamics.

    The FMU interpolates multilinearly in double precision, clamps inputs to the envelope and
    reports that in its output `inside`. Switches whose effects add up get grids of their own, which
    makes it much finer than a table of the same size.
    """
    chosen, file = options or ExportOptions(), Path(path)
    _headers(fmi)
    planned = plan(model, grid, chosen, separate=True)
    draft = planned.report(grid, chosen, str(file), 0)
    text = "; ".join(description(draft, chosen.source))
    chosen.progress(0, 1, "compiling")
    alone = IdentifiedCalibration(planned.gridded, NoDynamics(), 1.0)
    size = write_fmu(Program(alone, [text]), file, fmi)
    return planned.report(grid, chosen, str(file), size)


def write_fmu(program: Program, file: Path, fmi: str = "2.0") -> int:
    """Compile a model and write the FMU; returns its size in bytes.

    It runs on the platform that it was made on and contains its sources for others (`fmpy
    compile`); where there is no compiler `cc`, it contains the sources alone.
    """
    headers, folder = _headers(fmi)
    code = {
        **program.code,
        **{name: shipped(name) for name in ("fmi.h", "fmi.c", f"fmi{fmi[0]}.c")},
    }
    names = ",".join(variable.name for variable in variables(program))
    digest = hashlib.sha256("".join([names, *code.values()]).encode("utf-8")).hexdigest()
    parts = (digest[:8], *(digest[k : k + 4] for k in (8, 12, 16)), digest[20:32])
    token = f"{{{'-'.join(parts)}}}"
    code["token.h"] = f'#define TOKEN "{token}"\n'
    to_compile = tuple(name for name in code if name.endswith(".c"))
    about = Description(_identifier(file), token, program, to_compile)
    members = {"modelDescription.xml": about.model(fmi)}
    if compiler() is not None:
        binary = f"binaries/{folder}/{about.identifier}{SUFFIX}"
        members[binary] = compiled(code, [f"-I{headers}"])
    members |= {f"sources/{name}": text.encode("utf-8") for name, text in code.items()}
    if fmi == "3.0":
        members["sources/buildDescription.xml"] = about.build()
    data = _archive(members)
    atomic_write_bytes(file, data)
    return len(data)


def _headers(fmi: str) -> tuple[Path, str]:
    """Folder of the standard's headers, and that of this platform's binary in an FMU."""
    if fmi not in {"2.0", "3.0"}:
        raise ConfigError(f"unknown FMI version '{fmi}'", hint="Use 2.0 or 3.0")
    try:
        import fmpy  # noqa: PLC0415  (an extra that most installations lack)
    except ImportError:
        raise ModelError(
            "an FMU needs the headers that FMPy ships, and it is not installed",
            hint="pip install 'narxcal[fmu]'",
        ) from None
    headers = Path(fmpy.__path__[0]) / "c-code"
    if not (headers / f"fmi{fmi[0]}Functions.h").is_file():
        raise ModelError(
            f"FMPy {fmpy.__version__} lacks the headers of FMI {fmi}",
            file=headers,
            hint="Install the version of FMPy that constraints.txt names",
        )
    platform: Any = fmpy.platform if fmi == "2.0" else fmpy.platform_tuple
    return headers, str(platform)


def _identifier(file: Path) -> str:
    name = re.sub(r"\W", "_", file.stem, flags=re.ASCII)
    return name if name[:1].isalpha() else f"model_{name}"


# Archives contain no time of writing, so that the same model gives the same bytes.
_NO_TIME = (1980, 1, 1, 0, 0, 0)


def _archive(members: Mapping[str, bytes]) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name, data in members.items():
            entry = zipfile.ZipInfo(name, _NO_TIME)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, data)
    return buffer.getvalue()
