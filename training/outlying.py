"""Which training logs contradict the others as a whole: they are named, and not learned from.

A log with a wrong input (a lever rigged by some degrees, an air temperature with an offset, another
type of engine) agrees with itself, so that no fault of a channel shows, and shifts the steady state
of all. The steady state is fitted with and without each log. With v_io the geometric mean of the
RMS errors of log i in output o by both fits, which has the scatter of a log however much of the fit
it determines alone (studentised residuals; Cook and Weisberg 1982, section 2.2),

    d_i = sum_o v_io^2 / s_o^2,    s_o^2 = (p s_0^2 + sum_i w_i v_io^2) / (p + n)
    w_i = (1 - P_i) (nu + m) / (nu + d_i)
    P_i / (1 - P_i) = q / (1 - q) k^-m exp(d_i / 2 (1 - 1 / k^2))

for m outputs of n logs, with the scatter s_0 that engines of one type and their meters have, which
counts as p logs (`training.levels`). Errors of one log are common to its outputs: Student's t
(Lange, Little and Taylor 1989) gives the weights. P_i is the probability that log i is of the share
q of logs with k times the scatter (Tukey's contaminated normal). Weights and fits are found in
turn. Logs with P_i > 0.95 are left out where they are a minority: of two logs neither can be said
to be wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from narxcal.channels import described
from narxcal.steady.fitted import Layout
from narxcal.support.arrays import BoolArray, FloatArray
from training.config import SteadyFitConfig
from training.levels import PRIOR_LOGS, prior_scatter
from training.steady_fit import SteadySamples, linear_problem

LEAST_LOGS: Final = 3
_NU: Final = 4.0  # Lange, Little and Taylor (1989), where data are too few to fit it
_SHARE, _WIDER = 0.05, 5.0  # q and k: one log in twenty, and errors beyond those of sound logs
_SURE: Final = 0.95  # as faults are masked: a sound log must not be lost
_ROUNDS, _SETTLED = 60, 1e-3


@dataclass(frozen=True)
class Outlier:
    """A log that contradicts the others: RMS `errors` by output of the steady state of these."""

    log: str
    errors: dict[str, float]

    @property
    def words(self) -> str:
        """What to say of it."""
        known = {name: value for name, value in self.errors.items() if np.isfinite(value)}
        sizes = [f"{name} by {value:.3g} {described(name).unit}" for name, value in known.items()]
        return (
            f"{Path(self.log).name} contradicts the other logs as a whole: their steady state "
            f"misses its {', '.join(sizes)}, while its channels agree with each other; nothing was "
            "learned from it. Check its inputs (lever, air data) and its engine"
        )


def outliers(
    samples: Sequence[SteadySamples], layout: Layout, config: SteadyFitConfig
) -> list[Outlier]:
    """Logs whose quasi-steady samples contradict those of the others as a whole."""
    samples = [part for part in samples if len(part.inputs)]
    names = list(dict.fromkeys(part.log for part in samples))
    if len(names) < LEAST_LOGS:
        return []
    design, data = linear_problem(samples, layout, config)
    penalty = design.penalty(data.matrix.shape[1])
    logs = [data.logs == name for name in names]
    fits = [_Fits.of(data.matrix, column, logs, penalty.T @ penalty) for column in data.corrected.T]
    levels = np.nanmedian(np.abs(data.outputs), axis=0)
    # Channel units per unit of a corrected parameter.
    unit = np.nanmedian(data.layout_unit(layout), axis=0)
    scatter = [prior_scatter(*each) for each in zip(layout.output_names, levels, strict=True)]
    spoilt = _spoilt(fits, np.array(scatter) / unit, len(names))
    if not 0 < 2 * spoilt.sum() < len(names):
        return []
    kept = np.where(spoilt, 0.0, 1.0)
    errors = np.sqrt(np.stack([one.squares(kept)[1] for one in fits], axis=1)) * unit
    return [
        Outlier(names[k], dict(zip(layout.output_names, errors[k].tolist(), strict=True)))
        for k in np.flatnonzero(spoilt).tolist()
    ]


def _spoilt(fits: Sequence[_Fits], scatter: FloatArray, count: int) -> BoolArray:
    """Whether each log (count,) is surely none of the type."""
    weights, probability = np.ones(count), np.zeros(count)
    for mixed in (False, True):  # from weights alike, the mixture takes all for sound
        for _ in range(_ROUNDS):
            pairs = [one.squares(weights) for one in fits]
            found = np.stack([np.sqrt(inside * outside) for inside, outside in pairs], axis=1)
            known = np.isfinite(found)
            spread = PRIOR_LOGS * scatter**2 + np.nansum(weights[:, None] * found, axis=0)
            far = np.nansum(found * (PRIOR_LOGS + known.sum(axis=0)) / spread, axis=1)
            outputs = known.sum(axis=1)
            if mixed:
                probability = _probability(far, outputs)
            before, weights = weights, (1.0 - probability) * (_NU + outputs) / (_NU + far)
            if np.abs(weights - before).max() < _SETTLED:
                break
    return np.asarray(probability > _SURE)


def _probability(far: FloatArray, outputs: FloatArray) -> FloatArray:
    odds = np.log(_SHARE / (1.0 - _SHARE)) - outputs * np.log(_WIDER)
    odds = odds + 0.5 * far * (1.0 - _WIDER**-2)
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(odds, -50.0, 50.0))))


@dataclass(frozen=True, eq=False)
class _Fits:
    """Normal equations of one output: of each log [X y]'[X y], its samples, and the penalty."""

    moments: FloatArray
    counts: FloatArray
    penalty: FloatArray

    @classmethod
    def of(
        cls,
        matrix: FloatArray,
        target: FloatArray,
        logs: Sequence[BoolArray],
        penalty: FloatArray,
    ) -> _Fits:
        """Sum over the known samples of `logs`, which are rows each."""
        both = np.column_stack([matrix, target])
        rows = [both[own & np.isfinite(target)] for own in logs]
        counts = np.array([float(len(each)) for each in rows])
        return cls(np.stack([each.T @ each for each in rows]), counts, penalty)

    def squares(self, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean squared errors (logs,) by the weighted fit to all logs, and to all others."""
        whole = np.tensordot(weights, self.moments, axes=1)
        total = float(weights @ self.counts)
        inside = np.full(len(weights), np.nan)
        outside, fit = inside.copy(), self._fit(whole, total)
        for k in np.flatnonzero(self.counts).tolist():
            left = total - weights[k] * self.counts[k]
            without = self._fit(whole - weights[k] * self.moments[k], left) if left > 0.0 else fit
            inside[k], outside[k] = self._square(k, fit), self._square(k, without)
        return inside, outside

    def _fit(self, moments: FloatArray, total: float) -> FloatArray:
        if not total > 0.0:
            return np.full(len(moments), np.nan)
        matrix = moments[:-1, :-1] / total + self.penalty
        found = np.linalg.lstsq(matrix, moments[:-1, -1] / total, rcond=None)[0]
        return np.append(found, -1.0)

    def _square(self, k: int, fit: FloatArray) -> float:
        square = float(fit @ self.moments[k] @ fit) / float(self.counts[k])
        return max(square, 0.0)
