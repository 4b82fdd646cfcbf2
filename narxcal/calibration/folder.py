"""A folder of one JSON document and one file of arrays, each checked against its own hash."""

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

from narxcal.support.errors import ModelError
from narxcal.support.files import is_file, is_folder

WEIGHTS = "weights.safetensors"
PENDING = "weights.safetensors.new"


def packed(arrays: Mapping[str, NDArray[Any]]) -> tuple[bytes, dict[str, Any]]:
    """Serialise arrays for `WEIGHTS`; returns the bytes and the document's entry `weights`."""
    for name, array in arrays.items():
        if name == "__metadata__":
            raise ModelError(f"array name '{name}' is the format's own")
        if array.dtype.kind not in "biuf":
            raise ModelError(f"array '{name}' of type {array.dtype} cannot be stored in a bundle")
    data = save_arrays({name: np.array(array, order="C") for name, array in arrays.items()})
    sha256 = hashlib.sha256(data).hexdigest()
    shapes = {
        name: {"dtype": str(array.dtype), "shape": list(array.shape)}
        for name, array in sorted(arrays.items())
    }
    return data, {"file": WEIGHTS, "sha256": sha256, "arrays": shapes}


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
            arrays: dict[str, NDArray[Any]] = load_arrays(data)
        except (SafetensorError, ValueError, KeyError) as error:
            raise ModelError(f"not safetensors: {error}", file=file, hint=self.again) from None
        return arrays

    def _weights(self, source: Path, expected: str) -> bytes:
        """The file with the expected hash; a writer killed at its end leaves it as `PENDING`."""
        file = source / WEIGHTS
        found = {each: each.read_bytes() for each in (file, source / PENDING) if each.is_file()}
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


def _no_number(text: str) -> float:
    raise ValueError(f"{text} is no number in JSON")
