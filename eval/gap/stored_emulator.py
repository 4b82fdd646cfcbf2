"""The emulator of a simulator as a folder: what `simulate --effects` needs and no pickle.

`emulator.json` holds the structure, `weights.safetensors` every array.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load as load_arrays
from safetensors.numpy import save as save_arrays

from eval.gap.data import FloatArray
from narxcal.effects.base import Signals
from narxcal.errors import ModelError
from narxcal.narx import NarxModel
from narxcal.steady_state import steady_from_json, steady_to_json
from training.gap.emulator import NarxEmulator
from training.gap.settled import SettledModel

SCHEMA = "narxcal.emulator/1"
DOCUMENT, WEIGHTS = "emulator.json", "weights.safetensors"
_AGAIN = "Diagnose again, or copy the folder again"


def write_emulator(folder: Path, emulator: NarxEmulator) -> None:
    """Write into an existing folder; raises `ModelError` for a model that cannot be stored."""
    settled = emulator.settled
    narx, narx_arrays = emulator.narx.to_arrays()
    curves, curve_arrays = steady_to_json(settled.curves)
    arrays = {f"narx/{name}": value for name, value in narx_arrays.items()}
    arrays |= {f"curves/{name}": value for name, value in curve_arrays.items()}
    arrays["shifts"] = settled.shifts
    weights = save_arrays({name: np.array(value, order="C") for name, value in arrays.items()})
    document = {
        "schema": SCHEMA,
        "signals": signals_to_json(settled.signals),
        "dt_s": emulator.dt_s,
        "schedule": list(emulator.schedule),
        "columns": list(settled.columns),
        "switches": list(settled.switches),
        "narx": narx,
        "curves": curves,
        "sha256": hashlib.sha256(weights).hexdigest(),
    }
    (folder / WEIGHTS).write_bytes(weights)
    (folder / DOCUMENT).write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def read_emulator(folder: Path) -> NarxEmulator:
    """Read what `write_emulator` wrote; raises `ModelError` where it is missing or altered."""
    document = _document(folder / DOCUMENT)
    arrays = _arrays(folder / WEIGHTS, str(document.get("sha256")))
    parts: dict[str, dict[str, FloatArray]] = {"narx": {}, "curves": {}}
    for name, value in arrays.items():
        room, _, rest = name.partition("/")
        if room in parts:
            parts[room][rest] = value
    try:
        settled = SettledModel(
            signals_from_json(document["signals"]),
            steady_from_json(document["curves"], parts["curves"]),
            tuple(document["columns"]),
            tuple(document["switches"]),
            arrays["shifts"],
        )
        network = NarxModel.from_arrays(document["narx"], parts["narx"])
        return NarxEmulator(settled, network, tuple(document["schedule"]), float(document["dt_s"]))
    except KeyError as error:
        raise ModelError(
            f"the stored emulator has no {error}", file=folder / DOCUMENT, hint=_AGAIN
        ) from None


def signals_to_json(signals: Signals) -> dict[str, Any]:
    """Plain values."""
    return {
        name: value.tolist() if isinstance(value, np.ndarray) else value
        for name, value in asdict(signals).items()
    }


def signals_from_json(stored: Mapping[str, Any]) -> Signals:
    """Rebuild from `signals_to_json`; raises `KeyError` where a part is missing."""
    return Signals(
        inputs=tuple(stored["inputs"]),
        outputs=tuple(stored["outputs"]),
        dt_s=float(stored["dt_s"]),
        driver=stored["driver"],
        low=np.array(stored["low"], dtype=np.float64),
        high=np.array(stored["high"], dtype=np.float64),
        lever=(float(stored["lever"][0]), float(stored["lever"][1])),
        active=tuple(stored["active"]),
    )


def _document(file: Path) -> dict[str, Any]:
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ModelError(f"cannot be read: {error}", file=file, hint=_AGAIN) from None
    found = document.get("schema") if isinstance(document, dict) else None
    if found != SCHEMA:
        raise ModelError(f"expected schema '{SCHEMA}', found {found!r}", file=file, hint=_AGAIN)
    return dict(document)


def _arrays(file: Path, sha256: str) -> dict[str, FloatArray]:
    if not file.is_file():
        raise ModelError("the weights are missing", file=file, hint=_AGAIN)
    data = file.read_bytes()
    if hashlib.sha256(data).hexdigest() != sha256:
        raise ModelError("the weights were altered or cut off", file=file, hint=_AGAIN)
    try:
        return load_arrays(data)
    except (SafetensorError, ValueError) as error:
        raise ModelError(f"not safetensors: {error}", file=file, hint=_AGAIN) from None
