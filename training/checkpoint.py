"""Writes a training's progress to one file after every step, and reads it back.

The file is safetensors: the arrays as they are, everything else as one JSON text in its header.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from narxcal.support.errors import ModelError
from narxcal.support.files import atomic_write_bytes
from training.adam import Moments
from training.levenberg_marquardt import Damping
from training.network import HistoryRow, TrainingState

_SCHEMA = "narxcal.checkpoint/1"


def fingerprint(*parts: str) -> str:
    """One hash of all that decides a training: its configuration and its data."""
    return sha256("\n".join(parts).encode()).hexdigest()


def write_checkpoint(file: Path, progress: TrainingState, key: str) -> None:
    """Write atomically: a kill at any time leaves the last complete step."""
    arrays = {"theta": progress.theta}
    if progress.best_theta is not None:
        arrays["best_theta"] = progress.best_theta
    if progress.moments is not None:
        arrays["first"] = progress.moments.first
        arrays["second"] = progress.moments.second
    state = {
        "start": progress.start,
        "stage": progress.stage,
        "iteration": progress.iteration,
        "damping": [progress.damping.value, progress.damping.growth],
        "adam_steps": None if progress.moments is None else progress.moments.steps,
        "best_score": float(progress.best_score).hex(),
        "since_best": progress.since_best,
        "history": [asdict(row) for row in progress.history],
    }
    header = {"schema": _SCHEMA, "key": key, "state": json.dumps(state)}
    # A copy makes every array contiguous and its own, which is what gets written.
    arrays = {name: np.array(value) for name, value in arrays.items()}
    header["sha256"] = _digest(arrays, header["state"])
    atomic_write_bytes(file, save(arrays, header))


def _digest(arrays: Mapping[str, NDArray[Any]], state: str) -> str:
    """Hash of all that a training goes on from."""
    parts = (
        f"{name} {array.dtype} {array.shape} {sha256(array.tobytes()).hexdigest()}"
        for name, array in sorted(arrays.items())
    )
    return fingerprint(state, *parts)


def read_checkpoint(file: Path, key: str) -> TrainingState:
    """Read what `write_checkpoint` wrote.

    Raises `ModelError` if it cannot be read, or if it is of another training.
    """
    arrays, state, found = _read(file)
    if found != key:
        raise ModelError(
            "the checkpoint belongs to a training with another configuration or other data",
            file=file,
            hint="Restore them, or train without --resume into another folder",
        )
    try:
        return _progress(arrays, state)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise _unreadable(file, error) from None


def _progress(arrays: dict[str, Any], state: dict[str, Any]) -> TrainingState:
    moments = None
    if state["adam_steps"] is not None:
        moments = Moments(arrays["first"], arrays["second"], state["adam_steps"])
    return TrainingState(
        theta=arrays["theta"],
        start=state["start"],
        stage=state["stage"],
        iteration=state["iteration"],
        damping=Damping(*state["damping"]),
        moments=moments,
        best_theta=arrays.get("best_theta"),
        best_score=float.fromhex(state["best_score"]),
        since_best=state["since_best"],
        history=tuple(HistoryRow(**row) for row in state["history"]),
    )


def _read(file: Path) -> tuple[dict[str, Any], dict[str, Any], str | None]:
    """Arrays and state of a checkpoint, and the key of its training."""
    try:
        with safe_open(file, framework="numpy") as stored:
            header = stored.metadata()
            arrays = {name: stored.get_tensor(name) for name in stored.keys()}  # noqa: SIM118
        state, stated, key = json.loads(header["state"]), header["sha256"], header.get("key")
    except (SafetensorError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise _unreadable(file, error) from None
    if stated != _digest(arrays, header["state"]):
        raise _unreadable(file, ValueError("it was altered"))
    return arrays, state, key


def _unreadable(file: Path, error: Exception) -> ModelError:
    problem = f"the checkpoint cannot be read: {type(error).__name__}: {error}"
    return ModelError(problem, file=file, hint="Train without --resume")
