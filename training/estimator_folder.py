"""The folder of a trained `Narx`: `narx.json` and `weights.safetensors`.

    schema      "narxcal.narx/1" of a network, "narxcal.narx/2" of a chosen form
    parameters  structure, train, dt_s, and of /2 time_limit_s and seed, as given; null or "auto"
                for what was left to the default
    network     structure and sizes of the trained model
    result      how the training ended: status, score, every step; of /2 status, rung, reason,
                work and everything that was tried; inputs and outputs, names of the columns
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
from typing import Any, Literal, TypeVar

import numpy as np
import pandas as pd

from narxcal.calibration.bundle import WEIGHTS, ModelFolder, packed, seal
from narxcal.intervals import Conformal
from narxcal.narx.config import NarxConfig
from narxcal.narx.forms import pack, unpack
from narxcal.narx.network import NarxModel
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError, ModelError
from narxcal.support.files import (
    Results,
    atomic_folder,
    atomic_write_bytes,
    atomic_write_text,
    versions,
)
from training.choice import Choice
from training.config import TrainConfig
from training.network import FitResult, HistoryRow

_NETWORK, _CHOSEN = "narxcal.narx/1", "narxcal.narx/2"
_FORM = ModelFolder(
    what="stored Narx",
    document="narx.json",
    schemas=(_NETWORK, _CHOSEN),
    made_by="Narx.save",
    again="Copy the folder again, or train anew",
)
T = TypeVar("T", NarxConfig, TrainConfig)
Structure = NarxConfig | Literal["auto"] | None
_SEALED = ("parameters", "network", "result")
_INTERVALS = "intervals."


@dataclass(frozen=True, eq=False)
class Stored:
    """What a trained estimator is made of: its parameters as given, and what `fit` found.

    `inputs` and `outputs` name the columns, where the records had names.
    """

    structure: Structure
    train: TrainConfig | None
    dt_s: float
    time_limit_s: float
    seed: int
    result: FitResult | Choice
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()


def save(folder: str | PathLike[str], stored: Stored, *, replace: bool = False) -> None:
    """Write a new folder, whole or not at all; raises as `narxcal.support.files.atomic_folder`."""
    parameters: dict[str, Any] = {
        "structure": _dumped(stored.structure),
        "train": _dumped(stored.train),
        "dt_s": float(stored.dt_s),
    }
    if isinstance(stored.result, Choice):
        schema = _CHOSEN
        parameters |= {"time_limit_s": float(stored.time_limit_s), "seed": int(stored.seed)}
        network, result, arrays = _chosen_parts(stored.result)
    else:
        schema = _NETWORK
        network, arrays = stored.result.model.to_arrays()
        result = _network_result(stored.result)
    result |= {"inputs": list(stored.inputs), "outputs": list(stored.outputs)}
    weights, entry = packed(arrays)
    sealed = {"parameters": parameters, "network": network, "result": result}
    document = {
        "schema": schema,
        **sealed,
        "sha256": seal(json.loads(json.dumps(sealed))),
        "weights": entry,
        "versions": versions(),
    }
    content = Results("narxcal.narx/", _FORM.document, (WEIGHTS,))
    with atomic_folder(folder, content if replace else None) as part:
        atomic_write_bytes(part / WEIGHTS, weights)
        text = json.dumps(document, indent=1, allow_nan=False) + "\n"
        atomic_write_text(part / _FORM.document, text)


# What a document of unforeseen types and values raises where it is taken apart.
_UNREADABLE = (
    LookupError, TypeError, ValueError, AttributeError, ArithmeticError, RecursionError,
    ConfigError,
)  # fmt: skip


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
        return _stored(sealed, arrays, chosen=document["schema"] == _CHOSEN)
    except _UNREADABLE as error:
        raise ModelError(f"a part cannot be read: {error}", file=file, hint=_FORM.again) from None


def _stored(sealed: Mapping[str, Any], arrays: Mapping[str, FloatArray], *, chosen: bool) -> Stored:
    given = sealed["parameters"]
    structure = given["structure"]
    return Stored(
        structure=structure if structure == "auto" else _parsed(NarxConfig, structure),
        train=_parsed(TrainConfig, given["train"]),
        dt_s=given["dt_s"],
        time_limit_s=given.get("time_limit_s", TIME_LIMIT_S),
        seed=given.get("seed", 0),
        result=_choice(sealed, arrays) if chosen else _fit_result(sealed, arrays),
        inputs=tuple(sealed["result"].get("inputs", ())),
        outputs=tuple(sealed["result"].get("outputs", ())),
    )


TIME_LIMIT_S = 120.0  # default of `Narx`


def _network_result(result: FitResult) -> dict[str, Any]:
    return {
        "status": result.status,
        "score": _number(result.score),
        "history": [
            {key: _number(value) for key, value in asdict(row).items()} for row in result.history
        ],
    }


def _fit_result(sealed: Mapping[str, Any], arrays: Mapping[str, FloatArray]) -> FitResult:
    result = sealed["result"]
    return FitResult(
        model=NarxModel.from_arrays(sealed["network"], arrays),
        status=result["status"],
        score=_known(result["score"]),
        history=tuple(_row(row) for row in result["history"]),
    )


def _chosen_parts(
    choice: Choice,
) -> tuple[dict[str, Any], dict[str, Any], dict[str, FloatArray]]:
    network, arrays = pack(choice.model)
    tried = [
        {key: _number(value) if isinstance(value, float) else value for key, value in row.items()}
        for row in choice.tried.to_dict("records")
    ]
    result = {
        "status": choice.status,
        "rung": choice.rung,
        "reason": choice.reason,
        "budget": choice.budget,
        "spent": choice.spent,
        "tried": tried,
    }
    arrays = dict(arrays)
    arrays[f"{_INTERVALS}after"] = choice.intervals.after
    arrays[f"{_INTERVALS}errors"] = choice.intervals.errors
    arrays[f"{_INTERVALS}piece"] = choice.intervals.piece.astype(np.float64)
    return network, result, arrays


def _choice(sealed: Mapping[str, Any], arrays: Mapping[str, FloatArray]) -> Choice:
    result = sealed["result"]
    parts = ("after", "errors", "piece")
    after, errors, piece = (np.asarray(arrays[f"{_INTERVALS}{name}"]) for name in parts)
    own = {name: array for name, array in arrays.items() if not name.startswith(_INTERVALS)}
    rows = [{key: _known(value) for key, value in row.items()} for row in result["tried"]]
    return Choice(
        model=unpack(sealed["network"], own),
        rung=result["rung"],
        tried=pd.DataFrame(rows),
        reason=result["reason"],
        status=result["status"],
        budget=result["budget"],
        spent=result["spent"],
        intervals=Conformal(after, errors, piece.astype(np.int64)),
    )


def _row(row: Mapping[str, Any]) -> HistoryRow:
    return HistoryRow(**{key: _known(value) for key, value in row.items()})


def _dumped(section: Structure | TrainConfig) -> dict[str, Any] | str | None:
    if section is None or isinstance(section, str):
        return section
    return section.model_dump(mode="json", by_alias=True)


def _parsed(kind: type[T], given: Any) -> T | None:
    return None if given is None else kind.parse(given)


def _number(value: float) -> float | None:
    """JSON has no NaN."""
    return value if math.isfinite(value) else None


def _known(value: Any) -> Any:
    return math.nan if value is None else value
