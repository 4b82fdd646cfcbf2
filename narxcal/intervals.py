"""Intervals of free runs, from the errors of free runs that were held out.

    h(x, p) = q(x, p) t_nu((1 + p) / 2) / z((1 + p) / 2),      nu = 2 n / C
    C = (m C_0 + (n - 1) c) / (m + n - 1),      c = var(v) / mean(v)^2

| symbol | meaning |
|---|---|
| x | what errors grow with: samples since the start, or the distance from steady state |
| q | p quantile of the errors near x, every held-out piece with the same weight |
| n | held-out pieces (recordings, or blocks of one) |
| v | mean square error of each piece near x, divided by 1 - 1/n in its variance |
| nu | degrees of freedom of the pooled mean square (Satterthwaite, Biometrics Bulletin 2, 1946) |
| t, z | quantiles of Student's t and of the normal distribution |

Samples of one piece share its engine, day and sensors, so that few pieces say little about another
one however long they are: with pieces that are offset by a Gaussian draw each, c is 2 and nu = n,
as of the mean square of n draws; where all pieces err alike, c is 0 and nothing is widened. A few
pieces hardly show c either: C_0 = 2 is its prior, which counts as m pieces.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np
from scipy.special import ndtri, stdtrit

from narxcal.support.arrays import BoolArray, FloatArray, IntArray
from narxcal.support.errors import DataError, ModelError

LEVEL: Final = 0.9  # of intervals on pages and in replays
ENOUGH: Final = 8  # held-out pieces; with fewer it is said that intervals are widened
LEVELS: Final = (0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.95, 0.98, 0.99)
_PRIOR, _PRIOR_PIECES = 2.0, 1.5  # C_0 and m, which is as PRIOR_LOGS in training.redundancy
_LEAST = 20  # errors near x: a 90 % quantile needs 10; twice that
# Shares of samples below the lowest x of a bin: each bin holds half of what lies above.
_SHARES: Final = (0.0, 0.5, 0.75, 0.875, 0.9375)


@dataclass(frozen=True)
class Band:
    """A free run with its interval, each (time, outputs); start samples have no width."""

    y: FloatArray
    low: FloatArray
    high: FloatArray


@dataclass(frozen=True, eq=False)
class Conformal:
    """Absolute errors of free runs that were held out, by the samples since their start.

    `errors` (count, outputs) in the outputs' units belong to the horizons `after` (count,) and to
    the held-out pieces numbered in `piece` (count,).
    """

    after: FloatArray
    errors: FloatArray
    piece: IntArray

    @property
    def pieces(self) -> int:
        """How many pieces were held out."""
        return len(np.unique(self.piece)) if np.isfinite(self.errors).any() else 0

    def half_width(self, steps: int, share: float) -> FloatArray:
        """Half width (steps, outputs) of the interval that covers `share` of samples.

        By horizons of similar logarithm, never narrower than at nearer ones.
        """
        last = int(max(steps, self.after.max(), 2))
        edges = np.unique(np.geomspace(1, last, 9).astype(int)).astype(np.float64)
        horizon = np.arange(1.0, steps + 1.0)
        columns = [
            np.interp(horizon, *_curve((self.after, errors, self.piece), edges, share))
            for errors in self.errors.T
        ]
        return np.stack(columns, axis=1)


@dataclass(frozen=True, eq=False)
class HalfWidths:
    """Half-widths of intervals over `x`, one table per output, from `pieces` held-out pieces.

    `knots` (bins,) are values of x, `widths` (levels, bins) the half-widths there.
    """

    knots: tuple[FloatArray, ...]
    widths: tuple[FloatArray, ...]
    pieces: int

    @classmethod
    def of(cls, x: FloatArray, errors: FloatArray, piece: IntArray) -> Self:
        """Condense errors at `x`, both (count, outputs), of the pieces numbered in `piece`."""
        knots, widths = [], []
        for at, error in zip(x.T, np.abs(errors).T, strict=True):
            known = np.isfinite(error)
            edges = np.unique(np.quantile(at[known], _SHARES)) if known.any() else np.zeros(1)
            curves = [_curve((at, error, piece), edges, level) for level in LEVELS]
            knots.append(curves[0][0])
            # Wider at higher levels, whatever a few samples say.
            widths.append(np.maximum.accumulate([curve[1] for curve in curves], axis=0))
        used = piece[np.isfinite(errors).any(axis=1)]
        return cls(tuple(knots), tuple(widths), len(np.unique(used)))

    def at(self, x: FloatArray, share: float) -> FloatArray:
        """Half width at `x`, both (time, outputs), of the interval that covers `share`."""
        if not LEVELS[0] <= share <= LEVELS[-1]:
            raise DataError(
                f"expected an interval between {LEVELS[0]} and {LEVELS[-1]}, found {share}"
            )
        columns = []
        for column, knots, widths in zip(x.T, self.knots, self.widths, strict=True):
            level = [float(np.interp(share, LEVELS, each)) for each in widths.T]
            columns.append(np.interp(column, knots, level))
        return np.stack(columns, axis=1)

    def to_json(self) -> dict[str, Any]:
        """JSON-able."""
        return {
            "held_out": self.pieces,
            "levels": list(LEVELS),
            "outputs": [
                {"away": knots.tolist(), "half_width": widths.tolist()}
                for knots, widths in zip(self.knots, self.widths, strict=True)
            ],
        }

    @classmethod
    def from_json(cls, stored: Mapping[str, Any], outputs: int) -> Self:
        """Inverse of `to_json`; `ModelError` unless it is a table for each of `outputs`."""
        try:
            knots = tuple(np.array(one["away"], dtype=np.float64) for one in stored["outputs"])
            widths = tuple(
                np.array(one["half_width"], dtype=np.float64) for one in stored["outputs"]
            )
            pieces, levels = int(stored["held_out"]), tuple(stored["levels"])
        except (KeyError, TypeError, ValueError) as error:
            raise ModelError(f"'interval' cannot be read: {error}") from None
        fits = len(knots) == outputs and levels == LEVELS
        for x, wide in zip(knots, widths, strict=True):
            fits &= x.ndim == 1 and len(x) > 0 and wide.shape == (len(LEVELS), len(x))
            fits = fits and bool(np.isfinite(x).all() and (np.diff(x) >= 0.0).all())
            fits = fits and bool(np.isfinite(wide).all() and (wide >= 0.0).all())
        if not fits:
            raise ModelError("'interval' is no table of half-widths for each output")
        return cls(knots, widths, pieces)


def _curve(
    held: tuple[FloatArray, FloatArray, IntArray], edges: FloatArray, level: float
) -> tuple[FloatArray, FloatArray]:
    """Middle x and half-width of each bin from an edge to the next; widths do not fall.

    `held` are x, errors and pieces, (count,) each.
    """
    known = np.isfinite(held[1])
    x, errors, piece = held[0][known], held[1][known], held[2][known]
    knots, widths = [], []
    if not len(x):
        return edges, np.zeros(len(edges))
    for low, high in zip(edges, [*edges[1:], np.inf], strict=True):
        near: BoolArray = (x >= low) & (x < high)
        if near.sum() < _LEAST:
            near = x >= min(float(low), float(x.max()) / 2.0)
        inside = x[(x >= low) & (x < high)]
        knots.append(float(np.median(inside)) if len(inside) else float(low))
        widths.append(_half_width(errors[near], piece[near], level))
    return np.array(knots), np.maximum.accumulate(widths)


def _half_width(errors: FloatArray, piece: IntArray, level: float) -> float:
    """The formula of the module for errors (count,) of which all are known."""
    _, number, counts = np.unique(piece, return_inverse=True, return_counts=True)
    square = np.bincount(number, weights=errors**2) / counts
    order = np.argsort(errors)
    reached = np.cumsum(1.0 / counts[number][order]) / len(counts)
    quantile = float(np.interp(level, reached, errors[order]))
    upper = 0.5 * (1.0 + level)
    return quantile * float(stdtrit(_freedom(square), upper) / ndtri(upper))


def _freedom(square: FloatArray) -> float:
    """Degrees of freedom of the mean of mean squares (pieces,)."""
    n, mean = len(square), float(np.mean(square))
    seen = float(np.var(square, ddof=1)) / mean**2 if n > 1 and mean > 0.0 else 0.0
    variation = (_PRIOR_PIECES * _PRIOR + (n - 1) * seen) / (_PRIOR_PIECES + n - 1)
    return 2.0 * n / variation


def joined(parts: Sequence[tuple[FloatArray, FloatArray, str]]) -> HalfWidths | None:
    """Condense free runs: x and errors (time, outputs) of each, and the recording it is of."""
    if not any(np.isfinite(errors).any() for _, errors, _ in parts):
        return None
    numbers = {name: k for k, name in enumerate(dict.fromkeys(name for _, _, name in parts))}
    return HalfWidths.of(
        np.concatenate([x for x, _, _ in parts]),
        np.concatenate([errors for _, errors, _ in parts]),
        np.concatenate([np.full(len(x), numbers[name]) for x, _, name in parts]),
    )
