"""Level and lag of a free run over a whole log, and what held-out logs allow of them.

    level = median(model - measured),   lag = delay at which their rates of change are most alike

With x_1 .. x_n of held-out training logs, an x of another log is beyond their spread where

    |x| > t(1 - 0.05 / 2 m, p + n - 1) s,   s^2 = (p s_0^2 + sum x_i^2) / (p + n)

for m outputs (Bonferroni), with the scatter s_0 that engines of one type and their meters have,
which counts as p logs (`training.redundancy`). Of fewer than three logs nothing is judged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.stats import t as student

from narxcal.channels import channel
from narxcal.support.arrays import FloatArray
from training.delays import DELAY_PRIOR_S, delay_of
from training.redundancy import PRIOR_LOGS, prior_scatter

LEAST_LOGS = 3
_FALSE_ALARMS = 0.05  # of one log in any output, as that of the faults that are masked


def level_of(model: FloatArray, measured: FloatArray) -> FloatArray:
    """Median error (n_out,) of a free run (time, n_out); NaN without a measured sample."""
    error = model - measured
    found = [each[np.isfinite(each)] for each in error.T]
    return np.array([np.median(each) if len(each) else np.nan for each in found])


def lag_of(model: FloatArray, measured: FloatArray, dt_s: float) -> FloatArray:
    """Delay (n_out,) of a free run (time, n_out) behind the measurement in s; NaN if unclear."""
    pairs = zip(model.T, measured.T, strict=True)
    return np.array([delay_of(ours, theirs, dt_s) for ours, theirs in pairs])


@dataclass(frozen=True)
class LevelCheck:
    """Level and lag of one output over one log; `allowed` are None with too few held-out logs."""

    channel: str
    error: float
    allowed: float | None
    lag_s: float
    allowed_lag_s: float | None
    held_out_logs: int

    @property
    def open(self) -> bool:
        """Whether the level is known, and too few logs were held out to judge it."""
        return self.allowed is None and bool(np.isfinite(self.error))

    @property
    def ok(self) -> bool | None:
        """Whether the level is within the spread; None where that is not known."""
        if self.allowed is None or not np.isfinite(self.error):
            return None
        return bool(abs(self.error) <= self.allowed)

    @property
    def late(self) -> bool:
        """Whether the lag is beyond the spread."""
        return self.allowed_lag_s is not None and abs(self.lag_s) > self.allowed_lag_s

    def row(self) -> dict[str, Any]:
        """One entry of `levels` in JSON."""
        return {**asdict(self), "ok": self.ok}


def checks(
    stored: Mapping[str, Any],
    names: Sequence[str],
    signals: tuple[FloatArray, FloatArray],
    dt_s: float,
) -> tuple[LevelCheck, ...]:
    """Check a free run and the measurement (time, n_out) of the outputs `names`.

    `stored` (channel -> `held_out_level`, `held_out_lag_s`) is what training kept.
    """  # fmt: skip
    model, measured = signals
    found = []
    for name, error, lag_s, values in zip(
        names, level_of(model, measured), lag_of(model, measured, dt_s), measured.T, strict=True
    ):
        own = stored.get(name) or {}
        known = [
            np.array([x for x in own.get(key) or () if x is not None], dtype=np.float64)
            for key in ("held_out_level", "held_out_lag_s")
        ]
        typical = np.nanmedian(np.abs(values)) if np.isfinite(values).any() else 0.0
        prior = prior_scatter(name, float(typical))
        found.append(
            LevelCheck(
                name,
                float(error),
                _allowed(known[0], prior, len(names)),
                float(lag_s),
                _allowed(known[1], DELAY_PRIOR_S, len(names)),
                len(known[0]),
            )
        )
    return tuple(found)


def _allowed(seen: FloatArray, prior: float, outputs: int) -> float | None:
    """Largest size of another one within the spread; None of too few."""
    if len(seen) < LEAST_LOGS:
        return None
    square = (PRIOR_LOGS * prior**2 + np.sum(seen**2)) / (PRIOR_LOGS + len(seen))
    tail = float(student.isf(0.5 * _FALSE_ALARMS / outputs, PRIOR_LOGS + len(seen) - 1.0))
    return tail * float(np.sqrt(square))


def words(check: LevelCheck) -> str:
    """Size of a level error with its unit."""
    return f"{check.channel} {check.error:+.3g} {channel(check.channel).unit}"
