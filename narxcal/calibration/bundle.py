"""The folder that `train` writes and everything else reads.

`weights.safetensors` holds every array of the calibration, `bundle.json` everything else:

    schema       "narxcal.bundle/1"
    dt_s         raster of the calibration in s
    channels     {"inputs": [...], "outputs": [...]}
    units        {channel: unit}
    weights      {"file", "sha256", "arrays": {name: {"dtype", "shape"}}}
    calibration  lags, widths, names and whatever `DynamicCalibration` needs beside arrays
    calibration_sha256  of that part, for a lag changed by hand is another model
    versions     of Python and the packages that made it
    ...          what the trainer adds: config, data hashes, split, seeds, metrics

Array names are paths: `narx/...` for the network and its scalings, `steady/...` for the
steady-state model. Nothing is pickled, so opening a bundle runs none of its content (a
bundle that refers to a callable or an FMU runs those, and only if they are unchanged).

A model as a folder: one JSON document, and one file of arrays that the document vouches for.

Nothing is pickled, so reading one runs none of its content.
"""

from __future__ import annotations

import hashlib
import json
import math
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load as load_arrays
from safetensors.numpy import save as save_arrays

from narxcal.calibration.calibration import DynamicCalibration
from narxcal.channels import CHANNELS
from narxcal.steady.model import CarriesFiles
from narxcal.support.errors import ModelError
from narxcal.support.files import atomic_folder, atomic_write_bytes, atomic_write_text, versions

if TYPE_CHECKING:
    from os import PathLike

WEIGHTS = "weights.safetensors"


def packed(arrays: Mapping[str, NDArray[Any]]) -> tuple[bytes, dict[str, Any]]:
    """What to write to `WEIGHTS`, and the document's entry `weights` that vouches for it.

    Raises `ModelError` for what the format cannot hold.
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
    """A hash of JSON-able values, by which a change by hand shows."""
    return hashlib.sha256(json.dumps(part, sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True)
class ModelFolder:
    """One kind of such folders: its document, its schema, and the words of its errors.

    `what` it is, who it is `made_by`, and what to do (`again`) where it is damaged.
    """

    what: str
    document: str
    schema: str
    made_by: str
    again: str

    def read_document(self, source: Path) -> dict[str, Any]:
        """The document; `ModelError` for a folder of something else."""
        hint = f"Name the folder that {self.made_by} wrote"
        if not source.is_dir():
            if source.exists():
                problem = f"a {self.what} is a folder, and this is a file"
                raise ModelError(problem, file=source, hint=hint)
            problem = f"the {self.what} folder does not exist"
            raise ModelError(problem, file=source, hint="Train one first")
        file = source / self.document
        if not file.is_file():
            raise ModelError(
                f"the folder holds no {self.document}, so it is no {self.what}",
                file=source,
                hint=hint,
            )
        try:
            found = json.loads(file.read_text(encoding="utf-8"))
        except ValueError as error:
            raise ModelError(f"not JSON: {error}", file=file, hint=self.again) from None
        schema = found.get("schema") if isinstance(found, dict) else None
        if schema != self.schema:
            raise ModelError(
                f"unknown schema {schema!r}, expected {self.schema!r}",
                file=file,
                hint="Read it with the version of narxcal that wrote it",
            )
        return dict(found)

    def part(self, source: Path, document: Mapping[str, Any], key: str) -> dict[str, Any]:
        """A part of the document; `ModelError` where it is missing."""
        part = document.get(key)
        if not isinstance(part, dict):
            raise ModelError(f"'{key}' is missing", file=source / self.document, hint=self.again)
        return part

    def read_arrays(self, source: Path, document: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
        """The arrays by name; `ModelError` where they are not those that the document means."""
        entry = self.part(source, document, "weights")
        file = source / WEIGHTS
        if not file.is_file():
            raise ModelError("the weights are missing", file=file, hint=self.again)
        data = file.read_bytes()
        found, expected = hashlib.sha256(data).hexdigest(), str(entry.get("sha256"))
        if found != expected:
            raise ModelError(
                f"the weights were altered or cut off: sha256 is {found[:12]}, "
                f"{self.document} says {expected[:12]}",
                file=file,
                hint=self.again,
            )
        try:
            arrays = load_arrays(data)
        except (SafetensorError, ValueError, KeyError) as error:
            raise ModelError(f"not safetensors: {error}", file=file, hint=self.again) from None
        self._check_shapes(source / self.document, _shapes(arrays), entry.get("arrays"))
        return arrays

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


def _shapes(arrays: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    return {
        name: {"dtype": str(array.dtype), "shape": list(array.shape)}
        for name, array in sorted(arrays.items())
    }


def _shape_text(entry: Any) -> str:
    if not isinstance(entry, Mapping):
        return "missing"
    return f"{entry.get('dtype')} {tuple(entry.get('shape') or ())}"


SCHEMA = "narxcal.bundle/1"
DOCUMENT = "bundle.json"
STEADY_FILES = "steady"
_OURS = ("schema", "dt_s", "channels", "units", "weights", "calibration", "calibration_sha256")
_FORM = ModelFolder(
    what="bundle",
    document=DOCUMENT,
    schema=SCHEMA,
    made_by="narxcal train",
    again="Copy the bundle again, or train it anew",
)


@dataclass(frozen=True)
class Bundle:
    """A calibration and where it comes from.

    `meta` is what JSON can hold: config, data hashes, split, seeds, metrics, versions.
    """

    calibration: DynamicCalibration
    meta: dict[str, Any] = field(default_factory=dict, repr=False)


def save_bundle(folder: str | PathLike[str], bundle: Bundle, replace: bool = False) -> None:
    """Write `bundle` as a new folder, whole or not at all.

    Raises `ConfigError` for a folder that has content (with `replace`, other than narxcal's)
    or cannot be written, and `ModelError` for content that cannot be stored.
    """
    with atomic_folder(folder, replace) as part:
        write_bundle(part, bundle)


def write_bundle(folder: str | PathLike[str], bundle: Bundle) -> None:
    """Write `bundle` into an existing folder beside what is there.

    `bundle.json` is written last and bears the hash of the weights: until then a reader finds
    no bundle, or the former one with weights that do not fit, and never a mixture.
    """
    target = Path(folder)
    meta, arrays = bundle.calibration.to_arrays()
    weights, entry = packed(arrays)
    calibration = _plain(meta, "bundle.calibration")
    document = {
        "schema": SCHEMA,
        "dt_s": float(bundle.calibration.dt_s),
        **_channels(bundle.calibration),
        "weights": entry,
        "calibration": calibration,
        "calibration_sha256": seal(calibration),
        "versions": versions(),
        **_checked_meta(bundle.meta),
    }
    text = json.dumps(_plain(document, "bundle"), indent=1, allow_nan=False) + "\n"
    _copy_files(target / STEADY_FILES, bundle.calibration.steady)
    atomic_write_bytes(target / WEIGHTS, weights)
    atomic_write_text(target / DOCUMENT, text)


def load_bundle(folder: str | PathLike[str]) -> Bundle:
    """Read a bundle and check it against its own hashes and shapes.

    Raises `ModelError` naming the file for a folder that is no bundle, a bundle of another
    schema, and one whose weights or structure are missing, cut off or altered.
    """
    source = Path(folder)
    document = read_document(source)
    arrays = _FORM.read_arrays(source, document)
    meta = _with_own_files(source, _sealed_calibration(source, document))
    calibration = DynamicCalibration.from_arrays(meta, arrays)
    return Bundle(calibration, {key: document[key] for key in document if key not in _OURS})


def read_document(folder: str | PathLike[str]) -> dict[str, Any]:
    """Read `bundle.json` alone, without the model; raises `ModelError` as `load_bundle`."""
    return _FORM.read_document(Path(folder))


def _channels(calibration: DynamicCalibration) -> dict[str, Any]:
    inputs, outputs = list(calibration.input_names), list(calibration.output_names)
    units = {name: CHANNELS[name].unit for name in (*inputs, *outputs) if name in CHANNELS}
    return {"channels": {"inputs": inputs, "outputs": outputs}, "units": units}


def _checked_meta(meta: Mapping[str, Any]) -> Mapping[str, Any]:
    taken = sorted(set(meta) & set(_OURS))
    if taken:
        raise ModelError(f"the bundle's meta may not hold '{taken[0]}', which it writes itself")
    return meta


def _sealed_calibration(source: Path, document: Mapping[str, Any]) -> dict[str, Any]:
    calibration = _FORM.part(source, document, "calibration")
    if seal(calibration) != document.get("calibration_sha256"):
        raise ModelError(
            "the part 'calibration' was altered", file=source / DOCUMENT, hint=_FORM.again
        )
    return calibration


def _copy_files(target: Path, steady: object) -> None:
    """Copy what the steady-state model needs; a file that is gone stays a mere reference."""
    if not isinstance(steady, CarriesFiles):
        return
    for file in map(Path, steady.files()):
        if file.is_file():
            target.mkdir(exist_ok=True)
            copy = target / file.name
            if not (copy.exists() and copy.samefile(file)):
                shutil.copyfile(file, copy)


def _with_own_files(source: Path, calibration: dict[str, Any]) -> dict[str, Any]:
    """Let the steady-state model's reference point at the bundle's own copy, if it has one."""
    steady = calibration.get("steady")
    if not isinstance(steady, dict) or "file" not in steady:
        return calibration
    copy = source / STEADY_FILES / Path(str(steady["file"])).name
    if not copy.is_file():
        return calibration
    return {**calibration, "steady": {**steady, "file": str(copy)}}


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
