"""Probabilities of effects by one conditional logit, whose weights a calibration wrote.

    P(k) ~ exp(w' f_k) over all effects, exp(v' g) for "none" and exp(u' g) for "unknown"

f are the features of an effect, g those of the case. The weights are in `odds.json` beside this
module, with date, seeds and cases that they were fitted on (`python -m eval.gap.calibrate`).
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.special import softmax

from narxcal.support.arrays import FloatArray

FEATURES = ("bare", "ratio", "explained", "size", "gain", "response")
OF_CASE = ("one", "energy", "bare", "explained")


@dataclass(frozen=True)
class Odds:
    """Weights of the features of effects, and of the case for none and for unknown."""

    effect: tuple[float, ...]
    none: tuple[float, ...]
    unknown: tuple[float, ...]

    def probabilities(self, effects: FloatArray, case: FloatArray) -> FloatArray:
        """Probabilities (n + 2,) of n effects of features (n, ...), of none, and of unknown."""
        scores = [*(effects @ np.array(self.effect)), case @ self.none, case @ self.unknown]
        return np.asarray(softmax(scores))


def load(path: Path | None = None) -> Odds:
    """The weights that the last calibration wrote."""
    found: Mapping[str, Sequence[float]] = json.loads(
        (path or Path(__file__).with_name("odds.json")).read_text(encoding="utf-8")
    )
    return Odds(tuple(found["effect"]), tuple(found["none"]), tuple(found["unknown"]))
