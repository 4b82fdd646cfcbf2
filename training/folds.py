"""Judging choices on recordings that took no part: who is left out when, and what is left over."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import numpy as np

from narxcal.support.arrays import FloatArray

T = TypeVar("T")
_LEAST = 1e-18  # of a mean square: outputs without any error compare, too


class Turn(NamedTuple):
    """Indices of what is fitted to, and of what is judged."""

    fitted: list[int]
    judged: list[int]

    def of(self, items: Sequence[T]) -> tuple[list[T], list[T]]:
        """The items of each."""
        return [items[k] for k in self.fitted], [items[k] for k in self.judged]


def turns(recordings: Sequence[str], most: int) -> list[Turn]:
    """Leave recordings out, each once, in at most `most` turns.

    `recordings` names the recording of each item; those of one recording stay together.
    """
    names = list(dict.fromkeys(recordings))
    turn = {name: number % most for number, name in enumerate(names)}
    of = [turn[name] for name in recordings]
    return [
        Turn(
            [k for k, one in enumerate(of) if one != number],
            [k for k, one in enumerate(of) if one == number],
        )
        for number in sorted(set(of))
    ]


def left_over(errors: Sequence[FloatArray]) -> float:
    """Geometric mean over the outputs of the RMS of `errors`, (time, outputs) each.

    Infinite where an output has no error that is a number.
    """
    square = np.concatenate([error**2 for error in errors]) if errors else np.empty((0, 1))
    known = np.isfinite(square)
    counts = known.sum(axis=0)
    if not counts.all():
        return np.inf
    mean = np.where(known, square, 0.0).sum(axis=0) / counts
    return float(np.exp(0.5 * np.mean(np.log(np.maximum(mean, _LEAST)))))
