"""A model as a folder: one JSON document, and one file of arrays that the document vouches for.

Nothing is pickled, so reading one runs none of its content.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load as load_arrays
from safetensors.numpy import save as save_arrays

from narxcal.errors import ModelError

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
