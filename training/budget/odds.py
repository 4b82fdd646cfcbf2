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
from typing import Final

import numpy as np
from scipy.special import softmax

from narxcal.support.arrays import FloatArray

_SCALES: Final = ("sensor_gain", "driver_gain")
_RARE: Final = -1.6  # one to five
FEATURES = ("bare", "ratio", "explained", "size", "gain", "response")
OF_CASE = ("one", "energy", "bare", "explained")


@dataclass(frozen=True)
class Odds:
    """Weights of the features of effects, and of the case for none and for unknown."""

    effect: tuple[float, ...]
    none: tuple[float, ...]
    unknown: tuple[float, ...]

    def probabilities(
        self, names: Sequence[str], effects: FloatArray, case: FloatArray
    ) -> FloatArray:
        """Probabilities (n + 2,) of n effects of features (n, ...), of none, and of unknown."""
        own = effects @ np.array(self.effect) + np.array([prior(name) for name in names])
        return np.asarray(softmax([*own, case @ self.none, case @ self.unknown]))


def prior(name: str) -> float:
    """Log odds of an effect before anything is seen, against one of the calibration's catalogue.

    No case there has a wrong scale; a scale is rarer than an offset.
    """
    return _RARE if name.partition(":")[0] in _SCALES else 0.0


def load(path: Path | None = None) -> Odds:
    """The weights that the last calibration wrote."""
    found: Mapping[str, Sequence[float]] = json.loads(
        (path or Path(__file__).with_name("odds.json")).read_text(encoding="utf-8")
    )
    return Odds(tuple(found["effect"]), tuple(found["none"]), tuple(found["unknown"]))
