"""Probabilities of effects by two conditional logits, whose weights a calibration wrote.

    P(k) ~ exp(w' f_k) over all effects, exp(v' g) for "none" and exp(u' g) for "unknown"

f are the features of an effect, g those of the case. The second logit is for a further effect:
features are those of what the effects in force leave, and it says "none further" or which.
The softmax divides one: where two effects act, each gets half, and of a small gap "none" is as
right as what acts. Whether the likeliest effect acts is another question, whose answer is Platt's
(*Probabilistic outputs for support vector machines*, 1999): a logistic curve over the log odds.

The weights are in `odds.json` of this folder, with the date, and how many cases of which engines
they were fitted on (`python -m eval.diagnosis.blind.calibrate`).
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from scipy.special import expit, log_softmax, logit

from narxcal.support.arrays import FloatArray
from training.diagnosis.fit import Frame, Single, solve

_SCALES: Final = ("sensor_gain", "driver_gain")
_RARE: Final = -1.6  # one to five
# A parameter costs evidence of the whole record, and log ratios are per sample: sizes count by
# effective samples, in such units that five are 1 in the calibration's flights of eight minutes.
_CALIBRATED: Final = 15.0
_EDGE: Final = 1e-6  # no probability is nearer to 0 or 1
_FAINT: Final = 0.03  # log ratio below which all are alike: about that of nulls
FEATURES = ("bare", "ratio", "log_ratio", "explained", "size", "gain", "response")
OF_CASE = ("one", "bare", "ratio", "explained")


@dataclass(frozen=True)
class Odds:
    """Weights of the features of an effect and of the case, in both logits.

    `effect`, `none` and `unknown` are those of the first effect; `further` and `enough` those of
    one more, and of none further. `acts` are offset and slope over the log odds of the likeliest.
    """

    effect: tuple[float, ...]
    none: tuple[float, ...]
    unknown: tuple[float, ...]
    further: tuple[float, ...]
    enough: tuple[float, ...]
    acts: tuple[float, ...] = (0.0, 1.0)

    def first(self, names: Sequence[str], effects: FloatArray, case: FloatArray) -> FloatArray:
        """Log probabilities (n + 2,) of n effects of features (n, ...), of none, of unknown."""
        own = effects @ np.array(self.effect) + np.array([prior(name) for name in names])
        return np.asarray(log_softmax([*own, case @ self.none, case @ self.unknown]))

    def more(self, names: Sequence[str], effects: FloatArray, case: FloatArray) -> FloatArray:
        """Log probabilities (n + 1,) of a further effect, and of none."""
        own = effects @ np.array(self.further) + np.array([prior(name) for name in names])
        return np.asarray(log_softmax([*own, case @ self.enough]))

    def sure(self, leading: float) -> float:
        """Probability that the likeliest effect acts, from its probability among all answers."""
        offset, slope = self.acts
        return float(expit(offset + slope * log_odds(leading)))


def log_odds(chance: float) -> float:
    """Log odds of a probability, which is never taken for 0 or 1."""
    return float(logit(np.clip(chance, _EDGE, 1.0 - _EDGE)))


def prior(name: str) -> float:
    """Log odds of an effect before anything is seen, against one of the calibration's catalogue.

    No case there has a wrong scale; a scale is rarer than an offset.
    """
    return _RARE if name.partition(":")[0] in _SCALES else 0.0


def features(frame: Frame, singles: Sequence[Single]) -> tuple[FloatArray, FloatArray]:
    """Features (effects, ...) of single fits, and those of the case, as `FEATURES`, `OF_CASE`."""
    record = frame.record
    before, floor, bare = frame.energy(frame.none), max(frame.floor, 1.0), frame.bare()
    without = bare.energy(bare.none)
    rows = []
    for one in singles:
        alone = solve(bare.grams, one.columns, begin=bare.none.tau)
        gain = before - frame.energy(one.solved)
        ratio = np.log(before / frame.energy(one.solved))
        size = np.sqrt(np.mean(((one.response / record.span) ** 2)[record.known]))
        rows.append(
            (
                np.log(without / bare.energy(alone)),
                ratio,
                np.log(max(ratio, 0.0) + _FAINT),
                frame.explained(one),
                _CALIBRATED * one.node.size / record.independent,
                np.log10(max(gain, 0.0) / floor + 0.01),
                np.log10(size + 1e-5),
            )
        )
    effects = np.array(rows)
    return effects, np.array([1.0, *effects[:, [0, 1, 3]].max(axis=0)])


def stored_odds(path: Path | None = None) -> Odds:
    """The weights that the last calibration wrote."""
    found: Mapping[str, Sequence[float]] = json.loads(
        (path or Path(__file__).with_name("odds.json")).read_text(encoding="utf-8")
    )
    keys = ("effect", "none", "unknown", "further", "enough", "acts")
    return Odds(**{key: tuple(found[key]) for key in keys})
