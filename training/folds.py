"""Held-out folds of recordings, and the score by which choices on them are compared."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import numpy as np
from scipy.special import ndtr, stdtrit

from narxcal.support.arrays import BoolArray, FloatArray, known_mean

T = TypeVar("T")
_LEAST = 1e-18  # of a mean square: outputs without any error compare, too


class Fold(NamedTuple):
    """Indices of the items to fit to and of those to judge on."""

    fitted: list[int]
    judged: list[int]

    def of(self, items: Sequence[T]) -> tuple[list[T], list[T]]:
        """Items to fit to, and items to judge on."""
        return [items[k] for k in self.fitted], [items[k] for k in self.judged]


def held_out_folds(recordings: Sequence[str], most: int) -> list[Fold]:
    """Leave each recording out once, in at most `most` folds.

    `recordings` names the recording of each item; those of one recording stay together.
    """
    names = list(dict.fromkeys(recordings))
    fold = {name: number % most for number, name in enumerate(names)}
    of = [fold[name] for name in recordings]
    return [
        Fold(
            [k for k, one in enumerate(of) if one != number],
            [k for k, one in enumerate(of) if one == number],
        )
        for number in sorted(set(of))
    ]


def geometric_rms(errors: Sequence[FloatArray]) -> float:
    """Geometric mean over the outputs of the RMS of `errors`, (time, outputs) each.

    Infinite where an output has no error that is a number.
    """
    square = np.concatenate([error**2 for error in errors]) if errors else np.empty((0, 1))
    mean = known_mean(square)
    if np.isnan(mean).any():
        return np.inf
    return float(np.exp(0.5 * np.mean(np.log(np.maximum(mean, _LEAST)))))


def surely_below(ratios: FloatArray) -> BoolArray:
    """Whether means (...,) of logarithms of ratios (folds, ...) lie below 0 by a standard error.

    The standard error of few folds is uncertain itself: it is widened by Student's t, so that the
    risk of a ratio of one is 16 % for any number of folds. One fold alone says nothing.
    """
    count = len(ratios)
    if count < 2:
        return np.zeros(ratios.shape[1:], dtype=bool)
    error = ratios.std(axis=0, ddof=1) / np.sqrt(count) * stdtrit(count - 1, ndtr(1.0))
    return np.asarray(ratios.mean(axis=0) < -error)
