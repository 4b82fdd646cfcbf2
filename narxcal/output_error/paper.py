"""Tables 1, 3 and 4 of DeHoff et al. as data, and their flight test, simulated.

The paper prints no units and some labels twice. `reading` says how a row is read; rows without it
are as printed. Table 3 is of the left engine, with fuel flow as the input.

The paper's records are not available. Here the flight computer commands the throttle at a limited
rate; the command is known exactly, everything measured has the white noise of Table 1.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Final, Literal

import numpy as np

from narxcal.output_error.engine import (
    DuctPressures,
    EngineAndControl,
    EngineFromFuel,
    ThrottleLinkage,
)
from narxcal.record import Record
from narxcal.support.arrays import FloatArray

Side = Literal["left", "right"]

_TABLES = tomllib.loads(files(__package__).joinpath("paper.toml").read_text("utf-8"))
NOISE_PERCENT: Final[Mapping[str, float]] = _TABLES["noise_percent"]  # Table 1
FULL_SCALE: Final[Mapping[str, float]] = _TABLES["full_scale"]
# Not printed either; the flowmeter's 13 rad/s needs less than 0.1 s.
SAMPLING_S: Final = 0.05
RECORD_POINTS: Final = (3000, 3000, 2000)


def noise_sd() -> dict[str, float]:
    """Standard deviation of each sensor in its own unit (Table 1 times full scale)."""
    return {name: NOISE_PERCENT[name] * FULL_SCALE[name] / 100.0 for name in NOISE_PERCENT}


@dataclass(frozen=True)
class RepeatedEstimate:
    """A row of Table 3: estimates of three records and their standard deviations in percent."""

    name: str
    estimates: tuple[float, float, float]
    sd_percent: tuple[float, float, float]
    reading: str = ""

    @property
    def sd(self) -> FloatArray:
        """Standard deviations (3,) in the unit of the estimates."""
        return np.asarray(np.abs(self.estimates) * np.array(self.sd_percent) / 100.0)


TABLE_3: Final[Sequence[RepeatedEstimate]] = tuple(
    RepeatedEstimate(name, tuple(estimates), tuple(sd), *reading)
    for name, estimates, sd, *reading in _TABLES["tables"]["table_3"]
)


@dataclass(frozen=True)
class FinalEstimate:
    """A row of Table 4; `sd` is its "+-", taken as one standard deviation (the paper is silent).

    A standard deviation of 0 stands for a value that was fixed.
    """

    name: str
    left: float
    left_sd: float
    right: float
    right_sd: float
    reading: str = ""

    def side(self, side: Side) -> tuple[float, float]:
        return (self.left, self.left_sd) if side == "left" else (self.right, self.right_sd)

    @property
    def z(self) -> float:
        """(right - left) / sqrt(sum of variances); NaN where both were fixed."""
        sd = np.hypot(self.left_sd, self.right_sd)
        return float((self.right - self.left) / sd) if sd > 0 else float("nan")


TABLE_4: Final[Sequence[FinalEstimate]] = tuple(
    FinalEstimate(*row) for row in _TABLES["tables"]["table_4"]
)
TAU_ENGINE: Final = FinalEstimate("tau_engine", 0.65, 0.05, 0.89, 0.05, "engine with governor")


def table_4(side: Side) -> dict[str, float]:
    """Parameters of one engine by Table 4, with C_FB = C_FH; the model is linear, without mu."""
    values = {row.name: row.side(side)[0] for row in TABLE_4 if row.name != "mu"}
    return {**values, "C_FB": values["C_FH"]}


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
