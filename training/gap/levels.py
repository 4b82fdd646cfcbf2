r"""Finds when a load was on by the levels it shifts: two states, one shift, the same everywhere.

In blocks of a second, with what every flight may have for itself (offsets, slopes over power and
altitude, slow wandering) in N,

    r[k] = N[k] a + shift on[k] + e

Shift and nuisances are fitted by robust least squares for given on/off paths; the paths are the
shortest ones through `p[k]`, the share of the shift that is there at k, for given shift (Viterbi,
*IEEE Trans. Inf. Theory* 13, 1967). The start that explains most is kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from narxcal.support.arrays import BoolArray, FloatArray
from narxcal.support.compiled import compiled

EDGE, SETTLED = 8, 4  # blocks that tell a level, and those after a change that do not yet
_SWITCH = 4.0  # blocks of a whole shift that a change has to be worth
_ROUNDS, _TRUST, _BOUND = 8, 2.0, 2.5
_OFF = np.linspace(-0.6, 0.4, 11)  # levels of what is off, in shifts
_RIDGE = 1e-3
_MOST, _LEAST = 0.9, 0.02  # share of the known blocks in which a load may be on


@dataclass(frozen=True, eq=False)
class Levels:
    """Residuals in blocks (flights, blocks, channels), which are `known` (flights, blocks).

    `nuisances` (flights, blocks, k) is what every flight may have for itself; flights of one of
    the `groups` share their path; `rising` is a channel that being on raises.
    """

    residual: FloatArray
    known: BoolArray
    nuisances: FloatArray
    groups: tuple[tuple[int, ...], ...]
    rising: int | None


@dataclass(frozen=True, eq=False)
class Found:
    """A `shift` (channels,), the paths `on` (flights, blocks), and what the nuisances are then.

    `left` (flights, blocks, channels) is what is left, `there` (flights, blocks) the share of the
    shift that is there, `explained` the part of the robust sum of squares that the load takes.
    """

    shift: FloatArray
    on: BoolArray
    left: FloatArray
    there: FloatArray
    explained: float


def search_levels(levels: Levels, starts: int = 5) -> Found | None:
    """The best of several starts; None where none leads anywhere."""
    left = without_nuisances(levels)
    scale = _scale(left, levels.known)
    best: Found | None = None
    for start in _starts(left / scale, levels, starts):
        found = climb(levels, start * scale, left)
        if found is not None and (best is None or found.explained > best.explained):
            best = found
    return best


def without_nuisances(levels: Levels) -> FloatArray:
    """The residual less what its nuisances take up, if there are no windows."""
    return levels.residual - _own(levels, levels.residual, _trust(levels, levels.residual))


def of_paths(on: BoolArray, levels: Levels, known: FloatArray | None = None) -> Found:
    """Shift, unless it is `known` (channels,), and nuisances for given paths (flights, blocks)."""
    left = without_nuisances(levels)
    rest, shift = left, np.zeros(left.shape[2]) if known is None else known
    for _ in range(_ROUNDS):
        trust = _trust(levels, rest)
        if known is None:
            shift = _fitted(levels, on, trust)[0]
        unshifted = levels.residual - on[..., None] * shift
        rest = unshifted - _own(levels, unshifted, trust)
    return _found(levels, (shift, on, rest), left)


def climb(
    levels: Levels,
    shift: FloatArray,
    left: FloatArray,
    *,
    fixed: bool = False,
    begin: BoolArray | None = None,
) -> Found | None:
    """Paths, then shift (unless `fixed`) and nuisances, in turn until the paths stay.

    From the paths `begin`, or those by what is `left` without windows.
    """
    before, rest, on = left, left, np.zeros(levels.known.shape, dtype=np.bool_)
    for k in range(_ROUNDS):
        there = share_there(left, shift, inverse_of(rest, levels.known))
        again = paths(there, levels) if begin is None or k > 0 else begin
        share = float(again[levels.known].mean())
        if not _LEAST < share < _MOST:
            return None
        same = np.array_equal(again, on)
        on = again
        if same:
            break
        trust = _trust(levels, rest)
        if not fixed:
            shift = _fitted(levels, on, trust)[0]
        if levels.rising is not None and shift[levels.rising] <= 0.0:
            return None
        own = _own(levels, levels.residual - on[..., None] * shift, trust)
        left = levels.residual - own
        rest = left - on[..., None] * shift
    return _found(levels, (shift, on, rest), before)


def _found(
    levels: Levels, answer: tuple[FloatArray, BoolArray, FloatArray], before: FloatArray
) -> Found:
    shift, on, rest = answer
    inverse = inverse_of(rest, levels.known)
    explained = 1.0 - _size(rest, levels.known, inverse) / _size(before, levels.known, inverse)
    there = share_there(rest + on[..., None] * shift, shift, inverse)
    return Found(shift, on, rest, there, explained)


def _fitted(levels: Levels, on: BoolArray, trust: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Common shift (channels,), by what each flight tells of it, and the nuisances beside it."""
    toward, known = np.zeros(levels.residual.shape[2]), 0.0
    for f, row in enumerate(on):
        shape = row.astype(np.float64)
        design, weight = levels.nuisances[f], trust[f]
        gram = _gram(design, weight)
        alone = shape - design @ np.linalg.solve(gram, design.T @ (weight * shape))
        toward += (weight * alone) @ levels.residual[f]
        known += float(weight @ (alone * shape))
    shift = toward / max(known, 1e-9)
    return shift, _own(levels, levels.residual - on[..., None] * shift, trust)


def _own(levels: Levels, values: FloatArray, trust: FloatArray) -> FloatArray:
    """Each flight's nuisances in `values`, (flights, blocks, channels)."""
    own = np.empty_like(values)
    for f, design in enumerate(levels.nuisances):
        gram = _gram(design, trust[f])
        own[f] = design @ np.linalg.solve(gram, design.T @ (trust[f][:, None] * values[f]))
    return own


def _gram(design: FloatArray, weight: FloatArray) -> FloatArray:
    gram = design.T @ (design * weight[:, None])
    return np.asarray(gram + _RIDGE * max(float(weight.sum()), 1.0) * np.eye(len(gram)))


def _trust(levels: Levels, rest: FloatArray) -> FloatArray:
    """Huber's weights (flights, blocks), none where nothing is known; `rest` centred if need be."""
    trust = np.zeros(levels.known.shape)
    for f, known in enumerate(levels.known):
        if known.any():
            own = rest[f] - np.median(rest[f][known], axis=0)
            scale = np.maximum(1.4826 * np.median(np.abs(own[known]), axis=0), 1e-9)
            size = np.sqrt(np.mean((own / scale) ** 2, axis=1))
            trust[f] = known * np.minimum(1.0, _TRUST / np.maximum(size, 1e-9))
    return trust


def _scale(rest: FloatArray, known: BoolArray) -> FloatArray:
    return np.asarray(np.maximum(1.4826 * np.median(np.abs(rest[known]), axis=0), 1e-9))


def inverse_of(rest: FloatArray, known: BoolArray) -> FloatArray:
    """Inverse of the robust covariance (channels, channels); half of the correlation counts."""
    scale = _scale(rest, known)
    bounded = np.clip(rest[known] / scale, -2.5, 2.5)
    count = rest.shape[2]
    alike = np.corrcoef(bounded.T).reshape(count, count)
    half = 0.5 * (np.nan_to_num(alike) + np.eye(count))
    return np.asarray(np.linalg.inv(half * np.outer(scale, scale)))


def share_there(left: FloatArray, shift: FloatArray, inverse: FloatArray) -> FloatArray:
    """Share of the shift at every block: 0 where off, 1 where on."""
    toward = inverse @ shift
    return np.asarray(left @ toward / max(float(shift @ toward), 1e-12))


def _size(rest: FloatArray, known: BoolArray, inverse: FloatArray) -> float:
    square = np.einsum("kc,cd,kd->k", rest[known], inverse, rest[known])
    return float(np.minimum(square, 25.0 * rest.shape[2]).sum())


def _starts(z: FloatArray, levels: Levels, count: int) -> list[FloatArray]:
    """Shifts to start from, in deviations: what high and low have apart, and sharp edges.

    High and low of each channel in turn, and of the main axis of all that varies.
    """
    known = z[levels.known]
    bounded = np.clip(known, -_BOUND, _BOUND)
    axes = np.linalg.svd(bounded - bounded.mean(axis=0), full_matrices=False)[2]
    found = []
    for along in (bounded @ axes[0], *bounded.T):
        low, high = np.quantile(along, [0.1, 0.9])
        up = along > 0.5 * (low + high)
        if up.any() and not up.all():
            found.append(np.median(known[up], axis=0) - np.median(known[~up], axis=0))
    found += _edges(np.clip(z, -2.0 * _BOUND, 2.0 * _BOUND), levels, count)
    if levels.rising is None:
        return [sign * each for each in found for sign in (1.0, -1.0)]
    return [each if each[levels.rising] > 0.0 else -each for each in found]


def _edges(z: FloatArray, levels: Levels, count: int) -> list[FloatArray]:
    """Changes of level at the sharpest edges of all groups."""
    found: list[tuple[float, FloatArray]] = []
    for group in levels.groups:
        rows = list(group)
        step = np.mean([contrast(z[f], levels.known[f]) for f in rows], axis=0)
        size = np.nan_to_num(np.sqrt((step**2).sum(axis=1)))
        for _ in range(count):
            k = int(np.argmax(size))
            if size[k] > 0.0:
                found.append((float(size[k]), step[k]))
            size[max(0, k - EDGE) : k + EDGE + 1] = 0.0
    found.sort(key=lambda pair: -pair[0])
    return [step for _, step in found[: 3 * count : 3]]


def contrast(
    values: FloatArray, known: BoolArray, edge: int = EDGE, late: int = SETTLED
) -> FloatArray:
    """Mean level after a change at each block less that before, (blocks, ...), NaN if unknown.

    Levels are means of `edge` blocks, of which half has to be known; the later one is heard
    `late` blocks after the change.
    """
    many = known.reshape(-1, *([1] * (values.ndim - 1)))
    total = np.cumsum(np.concatenate([0.0 * values[:1], values * many]), axis=0)
    count = np.concatenate([[0], np.cumsum(known)])
    last, at = len(known), np.arange(len(known))
    means = []
    for low, high in (
        (np.minimum(at + late, last), np.minimum(at + late + edge, last)),
        (np.maximum(at - edge, 0), at),
    ):
        heard = (count[high] - count[low]).astype(np.float64)
        heard[heard < 0.5 * edge] = np.nan
        means.append((total[high] - total[low]) / heard.reshape(many.shape))
    return np.asarray(means[0] - means[1])


def paths(there: FloatArray, levels: Levels) -> BoolArray:
    """Best on/off path of every group, for the share of the shift that is there."""
    on = np.zeros(levels.known.shape, dtype=np.bool_)
    for group in levels.groups:
        rows = list(group)
        tried = [_path(there[rows] - off, levels.known[rows]) for off in _OFF]
        on[rows] = min(tried, key=lambda each: each[0])[1]
    return on


def _path(there: FloatArray, known: BoolArray) -> tuple[float, BoolArray]:
    """Cost and path (blocks,) of flights that share it."""
    away = np.minimum(np.abs(np.stack([there, there - 1.0])), 1.0) ** 2 * known
    return _shortest(away.mean(axis=1), _SWITCH)


@compiled(exact=False)
def _shortest(away: FloatArray, switch: float) -> tuple[float, BoolArray]:
    """Cost and path (blocks,) of the least sum of `away` (2, blocks) and switches."""
    count = away.shape[1]
    came = np.zeros((2, count), dtype=np.bool_)
    total = np.array([0.0, 0.5 * switch])
    for k in range(count):
        after = np.empty(2)
        for s in range(2):
            came[s, k] = total[1 - s] + switch < total[s]
            after[s] = (total[1 - s] + switch if came[s, k] else total[s]) + away[s, k]
        total = after
    path = np.zeros(count, dtype=np.bool_)
    total[1] += 0.5 * switch
    s = 1 if total[1] < total[0] else 0
    least = total[s]
    for k in range(count - 1, -1, -1):
        path[k] = s == 1
        if came[s, k]:
            s = 1 - s
    return least, path
