"""A steady-state model given as an FMU for co-simulation, FMI 2.0 or 3.0 (extra `fmu`).

FMI standards 2.0.4 and 3.0.2, sections on co-simulation: every sample is a fresh run of the
FMU (reset, initialise, set inputs, one step, read outputs), so that no sample depends on the one
before. An FMU is native code: one stored in a bundle is opened only with trust (`steady.opening`).
"""

from __future__ import annotations

import contextlib
import shutil
import weakref
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, ClassVar, Self
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from narxcal.steady.model import (
    Arrays,
    BoxModel,
    Envelope,
    Names,
    SteadyOptions,
    register_steady,
    stored,
    stored_names,
)
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ModelError, did_you_mean
from narxcal.support.files import is_file, sha256_of

_REAL = ("Real", "Float64")
_WHAT = "steady-state FMU"
_OPTIONS = ("variables", "ranges", "settle_s")


@register_steady
class SteadyFmu(BoxModel):
    """Evaluates an FMU whose variables have canonical units.

    Raises `ModelError` if FMPy is missing, if the file is no FMU that this machine can run,
    if a variable is missing, and if the FMU reports an error.
    """

    kind: ClassVar[str] = "fmu"

    def __init__(
        self,
        path: str | PathLike[str],
        names: Names,
        options: SteadyOptions | None = None,
    ) -> None:
        self.path = Path(path)
        self.options = options or SteadyOptions()
        self.input_names, self.output_names = (tuple(part) for part in names)
        self.envelope = Envelope.from_ranges(self.input_names, self.options.ranges)
        self._unit = open_unit(self.path)
        self._inputs = self._references(self.input_names)
        self._outputs = self._references(self.output_names)

    def __reduce__(self) -> tuple[Any, ...]:
        """Open the file again in a worker process; a running FMU cannot be sent."""
        return type(self), (self.path, (self.input_names, self.output_names), self.options)

    def files(self) -> tuple[str, ...]:
        return (str(self.path),)

    def to_arrays(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        meta = {
            "file": str(self.path.resolve()),
            "sha256": sha256_of(self.path),
            "input_names": list(self.input_names),
            "output_names": list(self.output_names),
            **self.options.model_dump(mode="json", include=set(_OPTIONS)),
        }
        return meta, {}

    @classmethod
    def executed(cls, meta: Mapping[str, Any]) -> str:
        """Name the FMU that would be loaded and its hash; nothing is loaded."""
        file, sha256 = stored(meta, "file", _WHAT), str(stored(meta, "sha256", _WHAT))
        return f"the native code of the FMU {file} (sha256 {sha256[:12]})"

    @classmethod
    def from_arrays(cls, meta: Mapping[str, Any], arrays: Arrays) -> Self:  # noqa: ARG003
        """Open the FMU again; raises `ModelError` if it is missing or another one."""
        file = Path(stored(meta, "file", _WHAT))
        if not is_file(file):
            raise ModelError(
                "the FMU of this bundle is missing", file=file, hint="Put it there again"
            )
        if sha256_of(file) != stored(meta, "sha256", _WHAT):
            raise ModelError(
                "the FMU is not the one the bundle was trained on",
                file=file,
                hint="Restore the former file, or train anew",
            )
        options = {key: stored(meta, key, _WHAT) for key in _OPTIONS}
        return cls(file, stored_names(meta, _WHAT), SteadyOptions.parse(options))

    def _references(self, names: Sequence[str]) -> list[int]:
        return [self._reference(name) for name in names]

    def _reference(self, name: str) -> int:
        wanted = self.options.variables.get(name, name)
        known = {variable.name: variable for variable in self._unit.variables}
        if wanted not in known:
            raise ModelError(
                f"the FMU has no variable '{wanted}'",
                file=self.path,
                channel=name,
                hint=did_you_mean(wanted, known, "It has"),
            )
        if known[wanted].type not in _REAL:
            raise ModelError(
                f"variable '{wanted}' is {known[wanted].type}, expected a real number",
                file=self.path,
                channel=name,
            )
        return int(known[wanted].valueReference)

    def _evaluate(self, inputs: FloatArray) -> FloatArray:
        return np.array([self._point(row) for row in inputs.tolist()])

    def _point(self, inputs: list[float]) -> list[float]:
        try:
            return self._unit.evaluate(self._inputs, inputs, self._outputs, self.options.settle_s)
        except self._unit.call_error as error:
            at = ", ".join(
                f"{name} {value:g}" for name, value in zip(self.input_names, inputs, strict=True)
            )
            raise ModelError(f"the FMU failed at {at}: {error}", file=self.path) from None


class Unit:
    """One running FMU; freed, with the files it was unpacked to, when no longer referenced."""

    def __init__(self, slave: Any, description: Any, folder: Any, call_error: Any) -> None:
        self.variables = description.modelVariables
        self.call_error: type[Exception] = call_error
        self.slave, self.fmi3 = slave, not description.fmiVersion.startswith("2")
        kind = "Float64" if self.fmi3 else "Real"
        self.put, self.get = (getattr(slave, f"{verb}{kind}") for verb in ("set", "get"))
        self._used = False
        self.close = weakref.finalize(self, _close, slave, folder)

    def begin(self) -> None:
        """Go back to initialisation at time 0."""
        if self._used:
            self.slave.reset()
        self._used = True
        if not self.fmi3:
            self.slave.setupExperiment(startTime=0.0)
        self.slave.enterInitializationMode()

    def evaluate(
        self, inputs: list[int], values: list[float], outputs: list[int], settle_s: float
    ) -> list[float]:
        """Run from the start at constant inputs for `settle_s`, and read the outputs."""
        self.begin()
        self.put(inputs, values)
        self.slave.exitInitializationMode()
        self.slave.doStep(0.0, settle_s)
        return list(self.get(outputs))


def import_fmpy(path: Path) -> Any:
    """Import FMPy to read `path`; raises `ModelError` where it is not installed."""
    try:
        import fmpy  # noqa: PLC0415  (an extra that most installations lack)
        import fmpy.fmi1  # noqa: PLC0415
    except ImportError:
        raise ModelError(
            "an FMU needs FMPy, which is not installed",
            file=path,
            hint="pip install 'narxcal[fmu]'",
        ) from None
    return fmpy


def read_description(path: Path) -> Any:
    """Read an FMU's model description; raises `ModelError` for what is no FMU."""
    fmpy = import_fmpy(path)
    if not is_file(path):
        raise ModelError("the FMU does not exist", file=path)
    # FMPy raises bare Exception for whatever it dislikes about a file.
    try:
        return fmpy.read_model_description(path)
    except BadZipFile:
        raise ModelError("the file is no FMU: it is not a zip archive", file=path) from None
    except Exception as error:
        raise ModelError(f"the file is no FMU that can be read: {error}", file=path) from error


def open_unit(path: Path) -> Unit:
    """Unpack and start an FMU; raises `ModelError` for one that this machine cannot run."""
    fmpy = import_fmpy(path)
    description = read_description(path)
    platforms = fmpy.supported_platforms(path)
    _check(path, description, (platforms, fmpy.platform))
    folder = fmpy.extract(path)
    try:
        # FMPy leaves the working directory changed when a library does not load.
        with contextlib.chdir("."):
            slave = fmpy.instantiate_fmu(folder, description, "CoSimulation")
    except Exception as error:
        shutil.rmtree(folder, ignore_errors=True)
        raise ModelError(f"the FMU does not start: {error}", file=path) from error
    return Unit(slave, description, folder, fmpy.fmi1.FMICallException)


def _check(path: Path, description: Any, platforms: tuple[list[str], str]) -> None:
    version = str(description.fmiVersion)
    if not version.startswith(("2.", "3.")):
        raise ModelError(f"the FMU is of FMI {version}, expected 2.0 or 3.0", file=path)
    if description.coSimulation is None:
        raise ModelError(
            "the FMU offers no co-simulation", file=path, hint="Export it for co-simulation"
        )
    found, here = platforms
    if here not in found:
        hint = "Build its sources: fmpy compile FILE" if "c-code" in found else None
        raise ModelError(
            f"the FMU has no binary for {here}, only {', '.join(found) or 'none'}",
            file=path,
            hint=hint,
        )


def _close(slave: Any, folder: Any) -> None:
    slave.freeInstance()
    shutil.rmtree(folder, ignore_errors=True)
