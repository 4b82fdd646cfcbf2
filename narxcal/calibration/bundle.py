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

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from narxcal.calibration.calibration import Calibration
from narxcal.calibration.certificate import Certificate, certify
from narxcal.calibration.folder import PENDING, WEIGHTS, ModelFolder, packed, seal
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
    sha256_of,
    to_json,
    versions,
)

SCHEMA = "narxcal.bundle/2"
DOCUMENT = "bundle.json"
STEADY_FILES = "steady"
_CONTENT = Results("narxcal.bundle/", DOCUMENT, (WEIGHTS, PENDING, f"{STEADY_FILES}/*"))
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
        "schema": SCHEMA,
        "dt_s": float(bundle.calibration.dt_s),
        **_channels(bundle.calibration),
        "weights": entry,
        "calibration": _plain(meta, finite=True),
        "versions": versions(),
        **record,
    }
    document = _plain(parts, finite=False)
    document["files"] = _copied_files(target / STEADY_FILES, bundle.calibration.steady)
    text = to_json({"schema": SCHEMA, "sha256": seal(document), **document})
    atomic_write_bytes(target / PENDING, weights)
    atomic_write_text(target / DOCUMENT, text)
    (target / PENDING).replace(target / WEIGHTS)


def settle_bundle(folder: str | PathLike[str]) -> None:
    """Do what a writer that was killed at its end did no more; the bundle reads as before."""
    source = Path(folder)
    pending = source / PENDING
    if not pending.is_file():
        return
    if sha256_of(pending) == _FORM.read_document(source).get("weights", {}).get("sha256"):
        pending.replace(source / WEIGHTS)
    else:
        pending.unlink()


def check_bundle(folder: str | PathLike[str]) -> RunRecord:
    """Check a bundle against its own hashes, without opening its model; returns its record."""
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


def _plain(value: Any, *, finite: bool) -> Any:
    """Turn what NumPy, pathlib and tuples hold into JSON.

    A number that is not finite becomes null, or with `finite` a `ModelError`.
    """
    try:
        text = json.dumps(value, default=_as_json, allow_nan=not finite)
    except ValueError:
        raise ModelError(
            "the calibration holds a number that JSON cannot", hint="Store it as array"
        ) from None
    return json.loads(text, parse_constant=lambda _: None)


def _as_json(value: object) -> Any:
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    raise ModelError(f"a value of type {type(value).__name__} cannot be stored in a bundle")
