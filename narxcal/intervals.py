"""Intervals of free runs, from the errors of free runs that were held out.

The error of a recording is an offset, which its engine, day and sensors make, and what is left:

    h(x, p)^2 = w(x, p)^2 + (1 + 1/n) (s t_(m+n)((1 + p) / 2))^2,
    s^2 = (m s_0^2 + sum_r b_r^2 (n - 1) / n) / (m + n)

| symbol | meaning |
|---|---|
| x | what errors grow with: samples since the start, or the distance from steady state |
| w | as h below, of the errors less the offset of their recording |
| n | recordings that were held out whole; without any s = s_0, of one that was fitted |
| b | offset of a held-out recording from a model of the others: its median error |
| s_0, m | scatter between engines of one type, days and meters, and its count of recordings |

s^2 of a fleet has an inverse-gamma prior of m recordings, and the offsets of fleets give s_0 and m
by its marginal likelihood: h is then a t interval. The offset of a `Conformal` is not known apart
from the rest; its half-width is

    w(x, p) = q(x, p) t_nu((1 + p) / 2) / z((1 + p) / 2),      nu = 2 k / C
    C = (1.5 C_0 + (k - 1) c) / (k + 0.5),      c = var(v) / mean(v)^2

| symbol | meaning |
|---|---|
| q | p quantile of the errors near x, every held-out piece with the same weight |
| k | held-out pieces: recordings, or regions or blocks of one |
| v | mean square error of each piece near x, divided by 1 - 1/k in its variance |
| nu | degrees of freedom of the pooled mean square (Satterthwaite, Biometrics Bulletin 2, 1946) |
| t, z | quantiles of Student's t and of the normal distribution |

Pieces that are offset by a Gaussian draw each have c = 2 and nu = k, as of the mean square of k
draws; where all pieces err alike, c is 0 and nothing is widened. A few pieces hardly show c: C_0 is
its prior, which counts as 1.5 pieces, 2 with the offsets in the errors, and 0.5 without.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, Self

import numpy as np
from scipy.special import ndtri, stdtrit

from narxcal.support.arrays import BoolArray, FloatArray, IntArray
from narxcal.support.errors import DataError, ModelError

LEVEL: Final = 0.9  # of intervals on pages and in replays
ENOUGH: Final = 8  # held-out pieces; with fewer it is said that intervals are widened
LEVELS: Final = (0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.95, 0.98, 0.99)
_PRIOR, _PRIOR_WITHIN, _PRIOR_PIECES = 2.0, 0.5, 1.5  # C_0 with offsets and without, and its count
_PRIOR_RECORDINGS = 2.0  # m: as fleets differ in s, by `python -m eval.bench --fleets` of 2f9145a
_LEAST = 20  # errors near x: a 90 % quantile needs 10; twice that
# Shares of samples below the lowest x of a bin: each bin holds half of what lies above.
_SHARES: Final = (0.0, 0.5, 0.75, 0.875, 0.9375)


class HeldErrors(NamedTuple):
    """A held-out free run: `x` and `errors` (time, outputs), and the `piece` that it counts for.

    `whole` tells a recording, whose offset is that of another day or engine, from a part.
    """

    x: FloatArray
    errors: FloatArray
    piece: str
    whole: bool = True


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

    `knots` (bins,) are values of x, `widths` (levels, bins) the half-widths there, `between` the
    standard deviations of another recording's offset that are part of them.
    """

    knots: tuple[FloatArray, ...]
    widths: tuple[FloatArray, ...]
    pieces: int
    between: tuple[float, ...]

    @classmethod
    def of(cls, held: Sequence[HeldErrors], prior: FloatArray) -> Self:
        """Condense held-out errors; `prior` (outputs,) is the scatter s_0 between recordings."""
        numbers = {one.piece: k for k, one in enumerate({one.piece: one for one in held}.values())}
        piece = np.concatenate([np.full(len(one.x), numbers[one.piece]) for one in held])
        whole = {numbers[one.piece] for one in held if one.whole}
        x = np.concatenate([one.x for one in held])
        errors = np.concatenate([one.errors for one in held])
        knots, widths, between = [], [], []
        for at, error, scatter in zip(x.T, errors.T, prior.tolist(), strict=True):
            known = np.isfinite(error)
            offsets = {k: float(np.median(error[known & (piece == k)])) for k in whole
                       if (known & (piece == k)).any()}  # fmt: skip
            away = np.array([offsets.get(int(k), 0.0) for k in piece])
            edges = np.unique(np.quantile(at[known], _SHARES)) if known.any() else np.zeros(1)
            near = at, np.abs(error - away), piece
            curves = [_curve(near, edges, level, _PRIOR_WITHIN) for level in LEVELS]
            spread, freedom = _between(list(offsets.values()), scatter)
            each = [float(stdtrit(freedom, 0.5 * (1.0 + level))) * spread for level in LEVELS]
            each = [one if known.any() else 0.0 for one in each]
            wide = [np.hypot(curve[1], one) for curve, one in zip(curves, each, strict=True)]
            knots.append(curves[0][0])
            between.append(spread)
            # Wider at higher levels, whatever a few samples say.
            widths.append(np.maximum.accumulate(wide, axis=0))
        used = piece[np.isfinite(errors).any(axis=1)]
        return cls(tuple(knots), tuple(widths), len(np.unique(used)), tuple(between))

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
        return {
            "held_out": self.pieces,
            "levels": list(LEVELS),
            "between": list(self.between),
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
            between = tuple(float(one) for one in stored["between"])
        except (KeyError, TypeError, ValueError) as error:
            raise ModelError(f"'interval' cannot be read: {error}") from None
        fits = len(knots) == outputs and levels == LEVELS and len(between) == outputs
        fits = fits and bool(np.isfinite(between).all())
        for x, wide in zip(knots, widths, strict=True):
            fits &= x.ndim == 1 and len(x) > 0 and wide.shape == (len(LEVELS), len(x))
            fits = fits and bool(np.isfinite(x).all() and (np.diff(x) >= 0.0).all())
            fits = fits and bool(np.isfinite(wide).all() and (wide >= 0.0).all())
        if not fits:
            raise ModelError("'interval' is no table of half-widths for each output")
        return cls(knots, widths, pieces, between)


def _curve(
    held: tuple[FloatArray, FloatArray, IntArray],
    edges: FloatArray,
    level: float,
    prior: float = _PRIOR,
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
        widths.append(_half_width(errors[near], piece[near], level, prior))
    return np.array(knots), np.maximum.accumulate(widths)


def _half_width(errors: FloatArray, piece: IntArray, level: float, prior: float) -> float:
    """The formula of the module for errors (count,) of which all are known."""
    _, number, counts = np.unique(piece, return_inverse=True, return_counts=True)
    square = np.bincount(number, weights=errors**2) / counts
    order = np.argsort(errors)
    reached = np.cumsum(1.0 / counts[number][order]) / len(counts)
    quantile = float(np.interp(level, reached, errors[order]))
    upper = 0.5 * (1.0 + level)
    return quantile * float(stdtrit(_freedom(square, prior), upper) / ndtri(upper))


def _freedom(square: FloatArray, prior: float) -> float:
    """Degrees of freedom of the mean of mean squares (pieces,)."""
    n, mean = len(square), float(np.mean(square))
    seen = float(np.var(square, ddof=1)) / mean**2 if n > 1 and mean > 0.0 else 0.0
    variation = (_PRIOR_PIECES * prior + (n - 1) * seen) / (_PRIOR_PIECES + n - 1)
    return 2.0 * n / variation


def _between(offsets: Sequence[float], prior: float) -> tuple[float, float]:
    """Standard deviation and degrees of freedom of another recording's offset from the model."""
    n = len(offsets)
    # Of one held-out recording the others are at least one, as for the next recording.
    square = sum(one**2 for one in offsets) * (max(n - 1, 1) / max(n, 2))
    freedom = _PRIOR_RECORDINGS + n
    variance = (_PRIOR_RECORDINGS * prior**2 + square) / freedom
    return float(np.sqrt((1.0 + 1.0 / max(n, 1)) * variance)), freedom


def joined(held: Sequence[HeldErrors], prior: FloatArray) -> HalfWidths | None:
    """Condense held-out free runs; None without a known error. `prior` as in `HalfWidths.of`."""
    if not any(np.isfinite(one.errors).any() for one in held):
        return None
    return HalfWidths.of(held, prior)
