"""Tables 1, 3 and 4 of DeHoff et al. as data, and what each row is read as.

The paper prints no units and some labels twice. `reading` says how a row is read; rows without it
are as printed. Table 3 is of the left engine, with fuel flow as the input.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

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
        """Estimate and standard deviation of one engine."""
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
    """Parameters of one engine by Table 4, with C_FB = C_FH."""
    values = {row.name: row.side(side)[0] for row in TABLE_4}
    return {**values, "C_FB": values["C_FH"]}
