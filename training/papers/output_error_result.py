"""Result of an output-error fit: estimates, their precision, and what to do next."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.stats import norm

from narxcal.support.arrays import FloatArray

Status = Literal["converged", "on a bound", "unidentifiable", "stalled", "not converged"]


@dataclass(frozen=True, eq=False, kw_only=True)
class OutputErrorFit:
    """Estimates of the free parameters and how far they can be trusted.

    Free parameters stand in the order of `names`; one with a value per record is `NAME@RECORD`.
    `covariance` (P, P) is Cramer-Rao's, `covariance_coloured` corrected for residuals that are
    correlated in time. `white` is whether they pass for white (p > 1 %): then the former is used
    for intervals, otherwise the latter. `by_record` maps record names to all parameters, fixed and
    tied ones too. `cost` is the negative log-likelihood. `unidentifiable` names directions that
    change no output (their parameters have an infinite variance), `weakest` the least determined of
    the others; `warnings` what the records lack.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray
    covariance_coloured: FloatArray
    white: bool
    by_record: Mapping[str, Mapping[str, float]]
    sigma: Mapping[str, float]
    residuals: tuple[FloatArray, ...]
    cost: float
    aic: float
    iterations: int
    status: Status
    advice: str
    unidentifiable: tuple[str, ...]
    weakest: str
    warnings: tuple[str, ...]

    @property
    def sd(self) -> FloatArray:
        """Cramer-Rao standard deviations (P,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def sd_coloured(self) -> FloatArray:
        """Standard deviations (P,) corrected for coloured residuals."""
        return np.sqrt(np.maximum(np.diag(self.covariance_coloured), 0.0))

    @property
    def sd_used(self) -> FloatArray:
        """Standard deviations (P,) of the intervals."""
        return self.sd if self.white else self.sd_coloured

    def interval(self, name: str, level: float = 0.9) -> tuple[float, float]:
        k = self.names.index(name)
        half = float(norm.ppf(0.5 + level / 2.0) * self.sd_used[k])
        return float(self.values[k]) - half, float(self.values[k]) + half

    def estimates(self) -> dict[str, tuple[float, float]]:
        """(value, sd used) of each free parameter, for `combine` and `compare`."""
        pairs = zip(self.values.tolist(), self.sd_used.tolist(), strict=True)
        return dict(zip(self.names, pairs, strict=True))

    def parameters(self) -> dict[str, float]:
        """Every parameter of the model by name; the mean of those that differ between records."""
        each = list(self.by_record.values())
        return {name: float(np.mean([one[name] for one in each])) for name in each[0]}

    def document(self) -> dict[str, Any]:
        """`parameters`, `status` and `advice` of identify.json; null for infinite deviations."""
        rows = {}
        for k, name in enumerate(self.names):
            numbers = (self.values[k], self.sd[k], self.sd_coloured[k], *self.interval(name))
            value, *rest = (float(x) if np.isfinite(x) else None for x in numbers)
            keys = ("sd", "sd_coloured", "low", "high")
            spread = dict(zip(keys, rest, strict=True))
            rows[name] = {"value": value, "unit": self.units[k], **spread}
        return {
            "parameters": rows,
            "sigma": dict(self.sigma),
            "aic": self.aic,
            "status": self.status,
            "advice": self.advice,
            "unidentifiable": list(self.unidentifiable),
            "warnings": list(self.warnings),
        }
