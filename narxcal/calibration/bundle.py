"""The folder that `train` writes and everything else reads: a calibration, and where it comes from.

`weights.safetensors` stores every array of the calibration, `bundle.json` everything else:

    schema       "narxcal.bundle/2"
    sha256       of the whole document without this entry, as canonical JSON (`seal`)
    dt_s         sampling interval of the calibration in s
    channels     {"inputs": [...], "outputs": [...]}
    units        {channel: unit}
    weights      {"file", "sha256", "arrays": {name: {"dtype", "shape"}}}
    files        {"steady/NAME": sha256} of what the steady-state model needs, such as an FMU
    calibration  lags, widths, names and whatever the `Calibration` needs in addition to arrays
    versions     of Python and the packages that made it
    ...          the entries of `narxcal.calibration.run_record`

Array names are paths: `narx/...` for the network and its scalings, `steady/...` for the
steady-state model, `lag/...` for the lags. The one hash covers the document and, by their hashes,
the weights and files: any altered byte is refused. It protects against damage and edits, not
against an author: nothing is pickled, and a steady-state model that runs code (a Python function,
an FMU) opens only with `trust`.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load as load_arrays
from safetensors.numpy import save as save_arrays

from narxcal.calibration.calibration import Calibration
from narxcal.calibration.certificate import Certificate, certify
from narxcal.calibration.identified import calibration_from_arrays
from narxcal.calibration.run_record import RunRecord
from narxcal.channels import described
from narxcal.steady.model import CarriesFiles
from narxcal.steady.opening import refuse_code
from narxcal.support.errors import ConfigError, ModelError, NarxcalError
from narxcal.support.files import (
    Results,
    atomic_folder,
    atomic_write_bytes,
    atomic_write_text,
    is_file,
    is_folder,
    sha256_of,
    to_json,
    versions,
)

WEIGHTS = "weights.safetensors"
_PENDING = "weights.safetensors.new"


def packed(arrays: Mapping[str, NDArray[Any]]) -> tuple[bytes, dict[str, Any]]:
    """Serialise arrays for `WEIGHTS`; returns the bytes and the document's entry `weights`.

    Raises `ModelError` for what the format cannot store.
    """
    for name, array in arrays.items():
        if name == "__metadata__":
            raise ModelError(f"array name '{name}' is the format's own")
        if array.dtype.kind not in "biuf":
            raise ModelError(f"array '{name}' of type {array.dtype} cannot be stored in a bundle")
    data = save_arrays({name: np.array(array, order="C") for name, array in arrays.items()})
    sha256 = hashlib.sha256(data).hexdigest()
    return data, {"file": WEIGHTS, "sha256": sha256, "arrays": _shapes(arrays)}


def seal(part: Mapping[str, Any]) -> str:
    """SHA-256 of JSON-able values in canonical form: keys sorted, ASCII."""
    text = json.dumps(part, sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True)
class ModelFolder:
    """One kind of model folder: a JSON document and one file of arrays, with the words of errors.

    `schemas` are those that can be read, the one that is written first. `what` names the folder,
    `made_by` its writer, and `again` says what to do where it is damaged.
    """

    what: str
    document: str
    schemas: tuple[str, ...]
    made_by: str
    again: str

    def read_document(self, source: Path) -> dict[str, Any]:
        """Read the document; raises `ModelError` for a folder of something else."""
        hint = f"Name the folder that {self.made_by} wrote"
        if not is_folder(source):
            if is_file(source):
                problem = f"a {self.what} is a folder, and this is a file"
                raise ModelError(problem, file=source, hint=hint)
            problem = f"the {self.what} folder does not exist"
            raise ModelError(problem, file=source, hint="Train one first")
        file = source / self.document
        if not is_file(file):
            raise ModelError(
                f"the folder holds no {self.document}, so it is no {self.what}",
                file=source,
                hint=hint,
            )
        try:
            found = json.loads(file.read_bytes().decode("utf-8"), parse_constant=_no_number)
        except OSError as error:
            raise ModelError(f"cannot be read: {error.strerror}", file=file) from None
        except (ValueError, RecursionError) as error:
            raise ModelError(f"not JSON: {error}", file=file, hint=self.again) from None
        schema = found.get("schema") if isinstance(found, dict) else None
        if schema not in self.schemas:
            raise ModelError(
                f"unknown schema {schema!r}, expected {self.schemas[0]!r}",
                file=file,
                hint="Train it anew, or read it with the version of narxcal that wrote it",
            )
        return dict(found)

    def part(self, source: Path, document: Mapping[str, Any], key: str) -> dict[str, Any]:
        """A part of the document; `ModelError` where it is missing."""
        part = document.get(key)
        if not isinstance(part, dict):
            raise ModelError(f"'{key}' is missing", file=source / self.document, hint=self.again)
        return part

    def read_arrays(self, source: Path, document: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
        """Read the arrays by name; `ModelError` unless they are those of the document."""
        entry = self.part(source, document, "weights")
        data = self._weights(source, str(entry.get("sha256")))
        file = source / WEIGHTS
        try:
            arrays = load_arrays(data)
        except (SafetensorError, ValueError, KeyError) as error:
            raise ModelError(f"not safetensors: {error}", file=file, hint=self.again) from None
        self._check_shapes(source / self.document, _shapes(arrays), entry.get("arrays"))
        return arrays

    def _weights(self, source: Path, expected: str) -> bytes:
        """The file with the expected hash; a writer killed at its end leaves it as `_PENDING`."""
        file = source / WEIGHTS
        found = {each: each.read_bytes() for each in (file, source / _PENDING) if each.is_file()}
        for data in found.values():
            if hashlib.sha256(data).hexdigest() == expected:
                return data
        if file not in found:
            raise ModelError("the weights are missing", file=file, hint=self.again)
        raise ModelError(
            "the weights were altered or cut off: sha256 is "
            f"{hashlib.sha256(found[file]).hexdigest()[:12]}, "
            f"{self.document} says {expected[:12]}",
            file=file,
            hint=self.again,
        )

    def _check_shapes(self, file: Path, found: Mapping[str, Any], expected: Any) -> None:
        if found == expected:
            return
        listed = expected if isinstance(expected, Mapping) else {}
        for name in sorted({*found, *listed}):
            if found.get(name) != listed.get(name):
                raise ModelError(
                    f"array '{name}' is {_shape_text(found.get(name))} in {WEIGHTS}, "
                    f"and {_shape_text(listed.get(name))} here",
                    file=file,
                    hint=self.again,
                )
        raise ModelError("the list of arrays is missing", file=file, hint=self.again)


def _no_number(text: str) -> float:
    raise ValueError(f"{text} is no number in JSON")


def _shapes(arrays: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    return {
        name: {"dtype": str(array.dtype), "shape": list(array.shape)}
        for name, array in sorted(arrays.items())
    }


def _shape_text(entry: Any) -> str:
    if not isinstance(entry, Mapping):
        return "missing"
    shape = entry.get("shape")
    return f"{entry.get('dtype')} {tuple(shape) if isinstance(shape, list) else shape}"


SCHEMA = "narxcal.bundle/2"
DOCUMENT = "bundle.json"
STEADY_FILES = "steady"
_CONTENT = Results("narxcal.bundle/", DOCUMENT, (WEIGHTS, _PENDING, f"{STEADY_FILES}/*"))
_OURS = ("schema", "sha256", "dt_s", "channels", "units", "weights", "files", "calibration")
_FORM = ModelFolder(
    what="bundle",
    document=DOCUMENT,
    schemas=(SCHEMA,),
    made_by="narxcal train",
    again="Copy the bundle again, or train it anew",
)


@dataclass(frozen=True)
class Bundle:
    """A calibration and where it comes from.

    `sha256` is the hash of the stored bundle; empty for one that was not loaded.
    """

    calibration: Calibration
    record: RunRecord = field(default_factory=RunRecord, repr=False)
    sha256: str = ""

    @cached_property
    def certificate(self) -> Certificate:
        """Whether the model settles at constant inputs, as stored or as found now."""
        return self.record.certificate or certify(self.calibration)


def save_bundle(folder: str | PathLike[str], bundle: Bundle, replace: bool = False) -> None:
    """Write `bundle` as a new folder, whole or not at all.

    Raises `ConfigError` for a folder that has content (with `replace`, other than a bundle)
    or cannot be written, and `ModelError` for content that cannot be stored.
    """
    with atomic_folder(folder, _CONTENT if replace else None) as part:
        write_bundle(part, bundle)


def write_bundle(folder: str | PathLike[str], bundle: Bundle) -> None:
    """Write `bundle` into an existing folder, next to what is there.

    The document is exchanged after the new weights are on the disk and before the old ones go, so
    that a reader finds either bundle whole, wherever the writer is killed.
    """
    target = Path(folder)
    meta, arrays = bundle.calibration.to_arrays()
    weights, entry = packed(arrays)
    record = bundle.record.to_json()
    taken = sorted(set(record) & set(_OURS))
    if taken:
        raise ModelError(f"the run's record may not hold '{taken[0]}', which the bundle writes")
    parts = {
        "dt_s": float(bundle.calibration.dt_s),
        **_channels(bundle.calibration),
        "weights": entry,
        "calibration": meta,
        "versions": versions(),
        **record,
    }
    document = _plain({"schema": SCHEMA, **parts}, "bundle")
    document["files"] = _copied_files(target / STEADY_FILES, bundle.calibration.steady)
    text = to_json({"schema": SCHEMA, "sha256": seal(document), **document})
    atomic_write_bytes(target / _PENDING, weights)
    atomic_write_text(target / DOCUMENT, text)
    (target / _PENDING).replace(target / WEIGHTS)


def settle_bundle(folder: str | PathLike[str]) -> None:
    """Do what a writer that was killed at its end did no more; the bundle reads as before."""
    source = Path(folder)
    pending = source / _PENDING
    if not pending.is_file():
        return
    if sha256_of(pending) == _FORM.read_document(source).get("weights", {}).get("sha256"):
        pending.replace(source / WEIGHTS)
    else:
        pending.unlink()


def check_bundle(folder: str | PathLike[str]) -> RunRecord:
    """Check a bundle against its own hashes, without opening its model; returns its record.

    Raises `ModelError` as `load_bundle`.
    """
    source = Path(folder)
    document = read_document(source)
    _FORM.read_arrays(source, document)
    _with_own_files(source, document)
    return _record(document, source / DOCUMENT)


def load_bundle(folder: str | PathLike[str], *, trust: bool = False) -> Bundle:
    """Read a bundle and check it against its own hashes and shapes.

    With `trust`, a steady-state model that is a Python function or an FMU is run; without, a
    bundle of such a model is refused with the file that would run and its hash, and one whose
    configuration names such a model to train with, too. Raises `ModelError` naming the file
    for a folder that is no bundle, a bundle of another schema, and one in which anything is
    missing, cut off, altered or of a wrong type.
    """
    source = Path(folder)
    document = read_document(source)
    arrays = _FORM.read_arrays(source, document)
    meta = _with_own_files(source, document)
    file = source / DOCUMENT
    try:
        if not trust:
            _refuse_code(document)
        calibration = calibration_from_arrays(meta, arrays, trust=trust)
        stored = {"dt_s": float(document["dt_s"]), "channels": document["channels"]}
        named = {"dt_s": calibration.dt_s, "channels": _channels(calibration)["channels"]}
    except NarxcalError as error:
        raise ModelError(
            error.problem, file=error.file or file, channel=error.channel, hint=error.hint
        ) from error
    except Exception as error:
        problem = f"the part 'calibration' cannot be read: {type(error).__name__}: {error}"
        raise ModelError(problem, file=file, hint=_FORM.again) from error
    if stored != named:
        raise ModelError(
            "'dt_s' or 'channels' differ from those of the part 'calibration'",
            file=file,
            hint=_FORM.again,
        )
    return Bundle(calibration, _record(document, file), str(document["sha256"]))


def _record(document: Mapping[str, Any], file: Path) -> RunRecord:
    try:
        return RunRecord.parse({key: document[key] for key in document if key not in _OURS})
    except (ConfigError, ModelError) as error:
        raise ModelError(error.problem, file=file, hint=_FORM.again) from None


def _refuse_code(document: Mapping[str, Any]) -> None:
    """Refuse a configuration that names code; what is no table of keys is refused elsewhere."""
    for part in ("config", "configured"):
        table = document.get(part)
        section = table.get("steady_state") if isinstance(table, dict) else None
        if isinstance(section, dict):
            refuse_code(section)


def read_document(folder: str | PathLike[str]) -> dict[str, Any]:
    """Read and check `bundle.json` without the model; raises `ModelError` as `load_bundle`."""
    source = Path(folder)
    file = source / DOCUMENT
    document = _FORM.read_document(source)
    try:
        problem = _alteration(source, document)
    except RecursionError:
        problem = "the document is nested too deeply"
    if problem:
        raise ModelError(problem, file=file, hint=_FORM.again)
    if not isinstance(document.get("units", {}), dict):
        raise ModelError("'units' is no table of keys", file=file, hint=_FORM.again)
    return document


def _alteration(source: Path, document: dict[str, Any]) -> str:
    """Say how a document differs from what was written; empty where it does not."""
    rest = {key: value for key, value in document.items() if key != "sha256"}
    # The text is compared, too: a changed byte between two values changes no value.
    whole = (source / DOCUMENT).read_bytes() == to_json(document).encode()
    if whole and seal(rest) == document.get("sha256"):
        return ""
    return "the file was altered: its content does not have the hash that it states"


def _channels(calibration: Calibration) -> dict[str, Any]:
    inputs, outputs = list(calibration.input_names), list(calibration.output_names)
    units = {name: described(name).unit for name in (*inputs, *outputs)}
    return {"channels": {"inputs": inputs, "outputs": outputs}, "units": units}


def _copied_files(target: Path, steady: object) -> dict[str, str]:
    """Copy what the steady-state model needs; returns {name in the bundle: sha256}.

    A file that no longer exists stays a mere reference.
    """
    copies = {}
    for file in map(Path, steady.files() if isinstance(steady, CarriesFiles) else ()):
        if file.is_file():
            target.mkdir(exist_ok=True)
            copy, sha256 = target / file.name, sha256_of(file)
            # What is there already may belong to the model that is about to be replaced.
            if not (copy.is_file() and sha256_of(copy) == sha256):
                atomic_write_bytes(copy, file.read_bytes())
            copies[f"{STEADY_FILES}/{file.name}"] = sha256
    return copies


def _with_own_files(source: Path, document: Mapping[str, Any]) -> dict[str, Any]:
    """The part 'calibration', its steady-state model's file being the bundle's own copy.

    Every file that the document lists is checked; one that it does not list is never used.
    """
    calibration = _FORM.part(source, document, "calibration")
    steady = calibration.get("steady")
    name = Path(str(steady.get("file", ""))).name if isinstance(steady, dict) else ""
    copy = source / STEADY_FILES / name
    files = _FORM.part(source, document, "files")
    for listed, sha256 in files.items():
        _check_file(source, listed, sha256)
    if f"{STEADY_FILES}/{name}" not in files or not isinstance(steady, dict):
        return calibration
    return {**calibration, "steady": {**steady, "file": str(copy)}}


def _check_file(source: Path, listed: str, sha256: Any) -> None:
    file = source / STEADY_FILES / Path(listed).name
    if listed != f"{STEADY_FILES}/{file.name}":
        problem = f"'{listed}' is no file in {STEADY_FILES}/"
        raise ModelError(problem, file=source / DOCUMENT, hint=_FORM.again)
    if not file.is_file():
        raise ModelError("the file is missing", file=file, hint=_FORM.again)
    found = sha256_of(file)
    if found != sha256:
        raise ModelError(
            f"the file was altered: sha256 is {found[:12]}, {DOCUMENT} says {str(sha256)[:12]}",
            file=file,
            hint=_FORM.again,
        )


def _plain(value: Any, where: str) -> Any:
    """Turn what NumPy, pathlib and tuples hold into JSON.

    A number that is not finite becomes null, except in the calibration, which must come back
    as it was.
    """
    if isinstance(value, Mapping):
        return {str(key): _plain(item, f"{where}.{key}") for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item, where) for item in value]
    if isinstance(value, (np.ndarray, np.generic)):
        return _plain(value.tolist(), where)
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, float) and not math.isfinite(value):
        if not where.startswith("bundle.calibration"):
            return None
        raise ModelError(f"{where} is {value}, which JSON cannot hold", hint="Store it as array")
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    raise ModelError(f"{where} of type {type(value).__name__} cannot be stored in a bundle")
