"""An exported ONNX graph run by onnxruntime."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from narxcal.support.arrays import FloatArray

BOUND = 1e-5


def runtime() -> Any:
    """The module onnxruntime, None where it is not installed."""
    try:
        import onnxruntime  # noqa: PLC0415  (no extra of narxcal has it)
    except ImportError:
        return None
    return onnxruntime


def run(file: Path, inputs: Sequence[FloatArray]) -> list[FloatArray]:
    """Free runs (time, n_out) from equilibrium over inputs (time, n_in), all as one batch."""
    ort = runtime()
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    session = ort.InferenceSession(str(file), options, providers=["CPUExecutionProvider"])
    width, longest = session.get_inputs()[0].shape[1], max(map(len, inputs))
    state, rows = np.full((len(inputs), width), np.nan), []
    for k in range(longest):
        given = np.array([one[min(k, len(one) - 1)] for one in inputs])
        state, output = session.run(["next_state", "output"], {"state": state, "input": given})
        rows.append(output)
    found = np.array(rows)
    return [found[: len(one), k] for k, one in enumerate(inputs)]
