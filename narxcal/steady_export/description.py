"""modelDescription.xml of an exported FMU, and what FMI 3.0 wants beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from narxcal.channels import CHANNELS
from narxcal.steady_state import Envelope

# Factor and offset to the SI base units given, where the standard can say it.
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
    """One variable of the FMU, `reference` its place; only inputs have a `start`."""

    name: str
    reference: int
    text: str
    start: float | None = None

    @property
    def unit(self) -> str | None:
        """Its unit, None where it is a plain number."""
        unit = CHANNELS[self.name].unit if self.name in CHANNELS else "-"
        return unit if unit in _SI else None


@dataclass(frozen=True)
class Description:
    """What the XML says: names, token, where the model comes from, inputs, outputs, sources."""

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
    """Write sources/buildDescription.xml, which FMI 3.0 wants (FMI 3.0.2, section 2.5.2)."""
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
    """Unit and start, as both standards write them."""
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
