"""Tables 1, 3 and 4 of DeHoff et al. as data, and their flight test, simulated.

The paper prints no units and some labels twice. `reading` says how a row is read; rows without it
are as printed. Table 3 is of the left engine, with fuel flow as the input.

The paper's records are not available. Here the flight computer commands the throttle at a limited
rate; the command is known exactly, everything measured has the white noise of Table 1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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

# Table 1: white sensor noise, one standard deviation in percent of full scale.
NOISE_PERCENT: Final[Mapping[str, float]] = {
    "delta_c": 1.0,
    "delta_TM": 1.0,
    "W_FM": 2.0,
    "N_HM": 0.5,
    "N_LM": 0.5,
    "P_TM": 2.0,
    "P_DM": 2.0,
}
# Full scales are not printed. Percent for speeds, pressures and fuel flow; the pickoff's counts
# over a lever travel of 982 / 26.3 = 37.3 deg.
FULL_SCALE: Final[Mapping[str, float]] = {
    "delta_c": 37.3,
    "delta_TM": 982.0,
    "W_FM": 100.0,
    "N_HM": 100.0,
    "N_LM": 100.0,
    "P_TM": 100.0,
    "P_DM": 100.0,
}
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


TABLE_3: Final[Sequence[RepeatedEstimate]] = (
    RepeatedEstimate("tau_H", (0.246, 0.210, 0.281), (1.8, 1.3, 1.7), "label illegible"),
    RepeatedEstimate("C_FH", (0.113, 0.110, 0.132), (0.2, 0.3, 0.5), "printed C_F"),
    RepeatedEstimate("alpha", (0.606, 0.710, 0.648), (6.5, 8.3, 4.7)),
    RepeatedEstimate("C_HL", (2.71, 3.07, 3.56), (1.1, 0.7, 0.3)),
    RepeatedEstimate("tau_L", (0.396, 0.403, 0.472), (0.8, 3.5, 0.6), "printed tau_F"),
    RepeatedEstimate("K_EH", (4.91, 4.72, 4.04), (0.4, 0.3, 0.6)),
    RepeatedEstimate("K_DL", (1.47, 1.14, 1.33), (1.4, 0.6, 0.8)),
    RepeatedEstimate("P_DO", (-3.20, -3.93, -4.59), (5.4, 1.6, 4.2)),
    RepeatedEstimate("P_TO", (-1.75, -1.94, -8.53), (5.3, 3.8, 2.4)),
    RepeatedEstimate("N_LO", (0.274, 0.324, 0.388), (2.1, 2.3, 0.3)),
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


TABLE_4: Final[Sequence[FinalEstimate]] = (
    FinalEstimate("a_fixed", 0.252, 0.062, 0.254, 0.060, "printed a0, in deg; as a half width"),
    FinalEstimate("b0", 982.0, 5.0, 942.0, 5.0, "counts"),
    FinalEstimate("b1", -26.3, 0.22, -24.8, 0.18, "counts per deg"),
    FinalEstimate("K_TH", 0.7212, 0.0, 0.7212, 0.0, "from the steady operating line"),
    FinalEstimate("mu", 0.0, 0.0, 0.0, 0.0, "no significant estimate"),
    FinalEstimate("K_AF", 3.11, 0.07, 2.96, 0.07),
    FinalEstimate("C_FH", 0.114, 0.001, 0.118, 0.002, "footnote: equal to C_FB"),
    FinalEstimate("zeta", 0.2, 0.2, 0.2, 0.2, "printed xi; by inspection"),
    FinalEstimate("omega", 13.0, 3.0, 13.0, 3.0, "by inspection"),
    FinalEstimate("tau_H", 0.232, 0.011, 0.312, 0.022),
    FinalEstimate("alpha", 0.64, 0.13, 0.56, 0.10),
    FinalEstimate("C_HL", 3.39, 0.07, 3.02, 0.07),
    FinalEstimate("tau_L", 0.437, 0.02, 0.423, 0.02, "printed tau_F"),
    FinalEstimate("tau_E", 0.0, 0.001, 0.0, 0.001, "printed 1/tau_E: then P_E would never move"),
    FinalEstimate("K_EH", 4.10, 0.10, 4.35, 0.40),
    FinalEstimate("tau_D", 0.05, 0.0, 0.05, 0.0, "printed 1/tau_D: 20 s would not be small"),
    FinalEstimate("K_DL", 1.36, 0.01, 1.40, 0.3),
    FinalEstimate("K_SF", 1.0, 0.0, 1.0, 0.0, "no significant estimate"),
    FinalEstimate("W_F0", 0.0, 0.0, 0.0, 0.0, "no significant estimate"),
    FinalEstimate("P_TO", -3.02, 0.09, -3.53, 2.75),
    FinalEstimate("P_DO", 5.41, 0.5, -1.82, 2.18),
    FinalEstimate("N_LO", 0.382, 0.03, 0.370, 0.03),
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
