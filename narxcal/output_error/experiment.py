"""Flight test of the Spey engines, simulated: throttle programmes and measured records.

The paper's records are not available. Here the flight computer commands the throttle at a limited
rate; the command is known exactly, everything measured has the white noise of Table 1.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from narxcal.output_error.engine import (
    DuctPressures,
    EngineAndControl,
    EngineFromFuel,
    ThrottleLinkage,
)
from narxcal.output_error.paper import RECORD_POINTS, SAMPLING_S, noise_sd
from narxcal.record import Record
from narxcal.support.arrays import FloatArray

Chain = ThrottleLinkage | DuctPressures | EngineFromFuel | EngineAndControl
Programme = Literal["steps", "doublets", "random"]
PROGRAMMES: Final[tuple[Programme, ...]] = ("steps", "doublets", "random")
_RATE_DEG_S: Final = 20.0  # electromechanical servo: full travel in about two seconds


@dataclass(frozen=True, eq=False)
class FlightRecord:
    """One record of one engine: signals (time,) by name, the exact command delta_c among them."""

    name: str
    signals: Mapping[str, FloatArray]
    dt_s: float = SAMPLING_S

    def of(self, model: Chain) -> Record:
        """Give the inputs and outputs of one chain."""
        u, y = (
            np.column_stack([self.signals[name] for name in names])
            for names in (model.input_names, model.output_names)
        )
        return Record(u, y, self.name)


def throttle_programme(kind: Programme, points: int, amplitude_deg: float) -> FloatArray:
    """Commanded deflection (time,) in degrees below full power, at a limited rate.

    "steps" holds levels for 8 s; "doublets" are 3-2-1-1 sequences of shrinking size, so that the
    throttle reverses inside the play too; "random" draws levels and durations (always the same).
    """
    levels, durations = {
        "steps": (np.array([0.0, -1.0, 0.3, -0.6, 0.6, 0.0, 1.0, -0.3]), np.full(8, 8.0)),
        "doublets": (
            np.outer([1.0, 0.5, 0.25, 0.1], [0.0, 1.0, -1.0, 1.0, -1.0]).ravel(),
            np.tile([3.0, 3.0, 2.0, 1.0, 1.0], 4),
        ),
        "random": _random_levels(),
    }[kind]
    times = np.arange(points) * SAMPLING_S
    starts = np.concatenate([[0.0], np.cumsum(durations)])
    position = np.searchsorted(starts, times % starts[-1], side="right") - 1
    wanted = amplitude_deg * (levels[position] - 1.0)
    command = np.empty(points)
    command[0] = wanted[0]
    most = _RATE_DEG_S * SAMPLING_S
    for k in range(1, points):
        command[k] = command[k - 1] + np.clip(wanted[k] - command[k - 1], -most, most)
    return command


def _random_levels() -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(1979)
    return rng.uniform(-1.0, 1.0, 60), rng.uniform(0.5, 4.0, 60)


def fly(
    parameters: Mapping[str, float], seed: int, amplitude_deg: float = 5.0
) -> list[FlightRecord]:
    """Three records of 3000, 3000 and 2000 points of one engine, with noise by `seed`.

    `parameters` replace the start values of `EngineAndControl` (see `paper.table_4`).
    """
    engine = EngineAndControl(SAMPLING_S)
    values = {one.name: one.start for one in engine.parameters} | dict(parameters)
    rng = np.random.default_rng(seed)
    sd = np.array([noise_sd()[name] for name in engine.output_names])
    records = []
    for number, (kind, points) in enumerate(zip(PROGRAMMES, RECORD_POINTS, strict=True), 1):
        command = throttle_programme(kind, points, amplitude_deg)
        outputs = engine.simulate(values, command[:, None])
        noisy = outputs + sd * rng.normal(size=outputs.shape)
        signals = dict(zip(engine.output_names, noisy.T, strict=True))
        records.append(FlightRecord(f"record {number}", {"delta_c": command, **signals}))
    return records
