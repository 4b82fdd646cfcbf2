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

from narxcal.effects.base import Signals
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ModelError
from narxcal.two_spool import TwoSpool
from training.diagnosis.emulator import GreyBoxEmulator
from training.diagnosis.settled import SettledModel

SCHEMA = "narxcal.emulator/3"
EMULATOR = "emulator"  # folder next to gap.json
DOCUMENT, WEIGHTS = "emulator.json", "weights.safetensors"
_AGAIN = "Diagnose again, or copy the folder again"


def write_emulator(folder: Path, emulator: GreyBoxEmulator) -> None:
    """Write into an existing folder."""
    settled, engine = emulator.settled, emulator.engine
    arrays = {
        "theta": engine.theta,
        "thermal": engine.thermal,
        "weights": settled.weights,
        "low": settled.low,
        "high": settled.high,
    }
    weights = save_arrays({name: np.array(value, order="C") for name, value in arrays.items()})
    document = {
        "schema": SCHEMA,
        "signals": signals_to_json(settled.signals),
        "conditions": list(settled.conditions),
        "switches": list(settled.switches),
        "core": {"low_pct": engine.low, "span_pct": engine.span},
        "governed": engine.governed,
        "dt_s": engine.dt_s,
        "sha256": hashlib.sha256(weights).hexdigest(),
    }
    (folder / WEIGHTS).write_bytes(weights)
    (folder / DOCUMENT).write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def read_emulator(folder: Path) -> GreyBoxEmulator:
    """Read what `write_emulator` wrote; raises `ModelError` where it is missing or altered."""
    document = _document(folder / DOCUMENT)
    arrays = _arrays(folder / WEIGHTS, str(document.get("sha256")))
    try:
        settled = SettledModel(
            signals_from_json(document["signals"]),
            tuple(document["conditions"]),
            tuple(document["switches"]),
            arrays["low"],
            arrays["high"],
            arrays["weights"],
        )
        core = document["core"]
        engine = TwoSpool(
            arrays["theta"],
            arrays["thermal"],
            float(core["low_pct"]),
            float(core["span_pct"]),
            int(document["governed"]),
            float(document["dt_s"]),
        )
    except KeyError as error:
        raise ModelError(
            f"the stored emulator has no {error}", file=folder / DOCUMENT, hint=_AGAIN
        ) from None
    except (TypeError, ValueError, IndexError, OverflowError) as error:
        problem = f"a part of the stored emulator is damaged: {error}"
        raise ModelError(problem, file=folder / DOCUMENT, hint=_AGAIN) from None
    return GreyBoxEmulator(settled, engine)


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
    except (OSError, ValueError, RecursionError) as error:
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
