"""An exported ONNX graph run by onnxruntime, to compare it with `simulate`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from narxcal.calibration.calibration import Calibration
from narxcal.export.proof import Case, held, row_of
from narxcal.support.arrays import FloatArray

BOUND = 1e-5


def runtime() -> Any:
    """The module onnxruntime, None where it is not installed."""
    try:
        import onnxruntime  # noqa: PLC0415  (no extra of narxcal has it)
    except ImportError:
        return None
    return onnxruntime


def run(file: Path, inputs: FloatArray) -> FloatArray:
    """Free runs (time, batch, n_out) from equilibrium over inputs (time, batch, n_in)."""
    ort = runtime()
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    session = ort.InferenceSession(str(file), options, providers=["CPUExecutionProvider"])
    width = session.get_inputs()[0].shape[1]
    state, rows = np.full((inputs.shape[1], width), np.nan), []
    for row in inputs:
        state, output = session.run(["next_state", "output"], {"state": state, "input": row})
        rows.append(output)
    return np.array(rows)


def compare(model: Calibration, file: Path, cases: Sequence[Case]) -> list[dict[str, Any]]:
    """Compare free runs and restarts in mid-flight, all as one batch.

    The file has one engine, that of `model`. Inputs without a number are held by the caller.
    """
    runs = []
    for case in cases:
        inputs = held(case.inputs)
        runs.append(("free run", case, inputs))
        runs.append(("restart in mid-flight", case, inputs[len(inputs) // 2 :]))
    longest = max(len(inputs) for _, _, inputs in runs)
    padded = [inputs[np.minimum(np.arange(longest), len(inputs) - 1)] for _, _, inputs in runs]
    found = run(file, np.stack(padded, axis=1))
    return [
        row_of(model, case, what, np.abs(found[: len(inputs), k] - model.simulate(inputs)))
        for k, (what, case, inputs) in enumerate(runs)
    ]
