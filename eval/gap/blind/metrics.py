"""Measures of how good answers are: plain functions of counts, labels and probabilities."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

_Z = 1.959964  # two-sided 95 %


class Rate(NamedTuple):
    """A share `hits / of` with its 95 % interval by Wilson; NaN of nothing."""

    hits: int
    of: int
    value: float
    low: float
    high: float

    def row(self) -> dict[str, Any]:
        """Give it as plain values."""
        return self._asdict()


def rate(hits: Sequence[bool]) -> Rate:
    """Share of hits with its interval (E. B. Wilson, J. Am. Stat. Assoc. 22, 1927, 209)."""
    n, k = len(hits), sum(map(bool, hits))
    if n == 0:
        return Rate(0, 0, math.nan, math.nan, math.nan)
    p = k / n
    middle = (p + _Z**2 / (2 * n)) / (1 + _Z**2 / n)
    half = _Z / (1 + _Z**2 / n) * math.sqrt(p * (1 - p) / n + _Z**2 / (4 * n**2))
    return Rate(k, n, p, max(0.0, middle - half), min(1.0, middle + half))


def macro_f1(truths: Sequence[str], answers: Sequence[str]) -> float:
    """Mean over the true labels of `2 tp / (2 tp + fp + fn)`; NaN of nothing."""
    scores = []
    for label in sorted(set(truths)):
        both = [(t == label, a == label) for t, a in zip(truths, answers, strict=True)]
        hit = sum(t and a for t, a in both)
        wrong = sum(t != a for t, a in both)
        scores.append(2 * hit / (2 * hit + wrong))
    return mean(scores)


def kappa(truths: Sequence[str], answers: Sequence[str]) -> float:
    """Agreement beyond chance (J. Cohen, Educ. Psychol. Meas. 20, 1960, 37); NaN of nothing."""
    n = len(truths)
    if n == 0:
        return math.nan
    seen = sum(t == a for t, a in zip(truths, answers, strict=True)) / n
    labels = {*truths, *answers}
    chance = sum(truths.count(each) * answers.count(each) for each in labels) / n**2
    return (seen - chance) / (1.0 - chance) if chance < 1.0 else 1.0


def brier(probabilities: Sequence[Mapping[str, float]], truths: Sequence[Collection[str]]) -> float:
    """Mean over cases of the squared errors of all probabilities, summed over effects.

    G. W. Brier, Mon. Weather Rev. 78, 1950, 1. A true effect that was not listed had none.
    """
    found = [
        sum((p.get(name, 0.0) - (name in true)) ** 2 for name in {*p, *true})
        for p, true in zip(probabilities, truths, strict=True)
    ]
    return mean(found)


def calibration_error(
    probabilities: Sequence[float], hits: Sequence[bool], bins: int = 10
) -> float:
    """Expected calibration error: |share of hits - mean probability| over equal bins, weighted."""
    if not probabilities:
        return math.nan
    p, hit = np.asarray(probabilities, np.float64), np.asarray(hits, np.float64)
    place = np.minimum((p * bins).astype(np.int64), bins - 1)
    error = 0.0
    for number in np.unique(place):
        inside = place == number
        error += float(inside.mean() * abs(hit[inside].mean() - p[inside].mean()))
    return error


def log_score(probabilities: Sequence[float], least: float = 0.01) -> float:
    """Mean of `-ln p` of what was true (I. J. Good, J. R. Stat. Soc. B 14, 1952, 107).

    One that was thought less probable than `least` counts as that.
    """
    return mean([-math.log(max(p, least)) for p in probabilities])


def area_under_curve(positive: Sequence[float], negative: Sequence[float]) -> float:
    """Probability that a positive one exceeds a negative one, ties half.

    J. A. Hanley, B. J. McNeil, Radiology 143, 1982, 29. NaN where either is missing.
    """
    if not len(positive) or not len(negative):
        return math.nan
    apart = np.subtract.outer(np.asarray(positive), np.asarray(negative))
    return float(np.mean((apart > 0.0) + 0.5 * (apart == 0.0)))


def selective_accuracy(
    sureness: Sequence[float], hits: Sequence[bool], coverage: float = 0.8
) -> float:
    """Share of hits among the surest part of the answers; NaN of nothing."""
    count = math.ceil(coverage * len(hits))
    order = np.argsort(-np.asarray(sureness, np.float64), kind="stable")[:count]
    return mean([float(hits[k]) for k in order.tolist()])


def slope(x: Sequence[float], y: Sequence[float]) -> float:
    """Slope of `y` over `x` by least squares; NaN where `x` does not vary."""
    if len(x) < 2 or float(np.ptp(x)) <= 0.0:
        return math.nan
    return float(np.polyfit(x, y, 1)[0])


def overlap(one: Collection[str], other: Collection[str]) -> float:
    """Intersection over union; 1 for two empty sets."""
    union = {*one} | {*other}
    return len({*one} & {*other}) / len(union) if union else 1.0


def mean(values: Sequence[float]) -> float:
    """Arithmetic mean; NaN of nothing."""
    return float(np.mean(values)) if len(values) else math.nan


def median(values: Sequence[float]) -> float:
    """Median; NaN of nothing."""
    return float(np.median(values)) if len(values) else math.nan
