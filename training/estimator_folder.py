"""A trained `Narx` as a folder: `narx.json` and `weights.safetensors`.

    schema      "narxcal.narx/1"
    parameters  structure, train and dt_s as given, null for what was left to the default
    network     structure and width of the trained network
    result      how the training ended: status, score, every step
    weights     file, SHA-256, shapes; the arrays themselves are in that file
    sha256      of parameters, network and result
    versions    of Python and the packages that made it

A number that is not finite, such as a validation error without validation records, is null.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar

from narxcal.atomic import atomic_folder, atomic_write_bytes, atomic_write_text
from narxcal.errors import ConfigError, ModelError
from narxcal.model_folder import WEIGHTS, ModelFolder, packed, seal
from narxcal.narx_config import NarxConfig
from narxcal.narx_model import NarxModel
from narxcal.versions import versions
from training.config import TrainConfig
from training.trainer import FitResult, HistoryRow

_FORM = ModelFolder(
    what="stored Narx",
    document="narx.json",
    schema="narxcal.narx/1",
    made_by="Narx.save",
    again="Copy the folder again, or train anew",
)
T = TypeVar("T", NarxConfig, TrainConfig)
_SEALED = ("parameters", "network", "result")


@dataclass(frozen=True, eq=False)
class Stored:
    """What a trained estimator is made of: its parameters as given, and the result of `fit`."""

    structure: NarxConfig | None
    train: TrainConfig | None
    dt_s: float
    result: FitResult


def save(folder: str | PathLike[str], stored: Stored, *, replace: bool = False) -> None:
    """Write a new folder, whole or not at all; raises as `narxcal.atomic.atomic_folder`."""
    network, arrays = stored.result.model.to_arrays()
    weights, entry = packed(arrays)
    sealed = {
        "parameters": {
            "structure": _dumped(stored.structure),
            "train": _dumped(stored.train),
            "dt_s": float(stored.dt_s),
        },
        "network": network,
        "result": {
            "status": stored.result.status,
            "score": _number(stored.result.score),
            "history": [
                {key: _number(value) for key, value in asdict(row).items()}
                for row in stored.result.history
            ],
        },
    }
    document = {
        "schema": _FORM.schema,
        **sealed,
        "sha256": seal(json.loads(json.dumps(sealed))),
        "weights": entry,
        "versions": versions(),
    }
    with atomic_folder(folder, replace) as part:
        atomic_write_bytes(part / WEIGHTS, weights)
        text = json.dumps(document, indent=1, allow_nan=False) + "\n"
        atomic_write_text(part / _FORM.document, text)


def load(folder: str | PathLike[str]) -> Stored:
    """Read what `save` wrote; `ModelError` for a folder that is another, damaged or altered."""
    source = Path(folder)
    document = _FORM.read_document(source)
    arrays = _FORM.read_arrays(source, document)
    sealed = {key: _FORM.part(source, document, key) for key in _SEALED}
    file = source / _FORM.document
    if seal(sealed) != document.get("sha256"):
        problem = f"{', '.join(_SEALED[:-1])} or {_SEALED[-1]} were altered"
        raise ModelError(problem, file=file, hint=_FORM.again)
    try:
        return _stored(sealed, NarxModel.from_arrays(sealed["network"], arrays))
    except (KeyError, TypeError, ConfigError) as error:
        raise ModelError(f"a part cannot be read: {error}", file=file, hint=_FORM.again) from None


def _stored(sealed: Mapping[str, Any], model: NarxModel) -> Stored:
    given, result = sealed["parameters"], sealed["result"]
    return Stored(
        structure=_parsed(NarxConfig, given["structure"]),
        train=_parsed(TrainConfig, given["train"]),
        dt_s=given["dt_s"],
        result=FitResult(
            model=model,
            status=result["status"],
            score=_known(result["score"]),
            history=tuple(_row(row) for row in result["history"]),
        ),
    )


def _row(row: Mapping[str, Any]) -> HistoryRow:
    return HistoryRow(**{key: _known(value) for key, value in row.items()})


def _dumped(section: NarxConfig | TrainConfig | None) -> dict[str, Any] | None:
    return None if section is None else section.model_dump(mode="json", by_alias=True)


def _parsed(kind: type[T], given: Any) -> T | None:
    return None if given is None else kind.parse(given)


def _number(value: float) -> float | None:
    """JSON has no NaN."""
    return value if math.isfinite(value) else None


def _known(value: Any) -> Any:
    return math.nan if value is None else value
