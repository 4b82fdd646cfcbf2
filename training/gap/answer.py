"""Puts what was fitted into words and intervals: the finding."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import norm, t

from narxcal.support.arrays import FloatArray
from training.budget.result import Interval
from training.gap.finding import ChannelShrink, Tried
from training.gap.fitting import Fit
from training.gap.quadratic import Misfit

_LEVEL = 0.90
_ALIKE = 0.2  # how much of other misfit looks like an effect: what blind cases showed


class Worth(NamedTuple):
    """What a model takes of the gap on held-out flights, in all and in each (flights,); and leaves.

    `left` is the share that it leaves of the gap it was fitted to.
    """

    gain: float
    flights: FloatArray
    left: float


def interval(values: FloatArray, centre: float, beside: float = 0.0) -> Interval:
    """90 % interval of `centre` by the jackknife values (flights,) (Efron & Tibshirani, 11).

    `beside` is a further reach that the flights do not show, since it is the same in all.
    """
    count = len(values)
    if count < 2:
        return Interval(centre, -np.inf, np.inf)
    spread = np.sqrt((count - 1) / count * np.sum((values - values.mean()) ** 2))
    reach = float(np.hypot(t.ppf(0.5 + 0.5 * _LEVEL, count - 1) * spread, beside))
    return Interval(centre, centre - reach, centre + reach)


def shrink(gains: FloatArray, pooled: float) -> Interval:
    """Interval of a mean over flights, by Student's t, round the pooled value."""
    count = len(gains)
    if count < 2:
        return Interval(pooled, -np.inf, 1.0)
    reach = float(t.ppf(0.5 + 0.5 * _LEVEL, count - 1) * gains.std(ddof=1) / np.sqrt(count))
    return Interval(pooled, pooled - reach, min(pooled + reach, 1.0))


def probabilities(held_out: Sequence[FloatArray]) -> FloatArray:
    """Weight of each model from its misfit on held-out flights, best first; they sum to one.

    A model's weight is the chance that it would come out ahead of the best on other flights: the
    paired differences over flights against their standard error.
    """
    best, weights = held_out[0], [1.0]
    count = len(best)
    for other in held_out[1:]:
        worse = other - best
        error = worse.std(ddof=1) / np.sqrt(count) if count > 1 else abs(worse.mean())
        # No model is told from another more sharply than a twentieth of what it leaves.
        error = float(np.hypot(error, 0.05 * best.mean()))
        weights.append(2.0 * float(norm.sf(worse.mean() / max(error, 1e-12))))
    total = np.minimum(np.array(weights), 1.0)
    return np.asarray(total / total.sum())


def tried(model: Fit, worth: Worth, probability: float) -> Tried:
    """One model as a row of the finding.

    What it leaves is other misfit, not noise, and much the same in all flights: it moves an effect
    by its likeness to it, which the jackknife over flights does not show.
    """
    alike = _ALIKE * float(np.sqrt(np.clip(worth.left, 0.0, 1.0)))
    parameters: dict[str, dict[str, Interval]] = {}
    units: dict[str, dict[str, str]] = {}
    bound, at = [], 0
    own = iter(model.parameters)
    for effect, count in _counts(model):
        for _ in range(count):
            p, value = next(own), float(model.theta[at])
            found = interval(model.others[:, at], value, alike * abs(value - p.neutral))
            parameters.setdefault(effect, {})[p.name] = Interval(
                value, max(found.low, p.low), min(found.high, p.high)
            )
            units.setdefault(effect, {})[p.name] = p.unit
            if value in (p.low, p.high):
                bound.append(f"{effect} {p.name}")
            at += 1
    families = " + ".join(dict.fromkeys(effect.family for effect in model.effects))
    return Tried(
        effects=tuple(effect.name for effect in model.effects),
        family=families,
        gain=worth.gain,
        flights=tuple(worth.flights.tolist()),
        probability=probability,
        parameters=parameters,
        units=units,
        at_bound=tuple(bound),
    )


def _counts(model: Fit) -> list[tuple[str, int]]:
    """Name of each effect of a model and how many parameters it has."""
    return list(zip((e.name for e in model.effects), model.sizes, strict=True))


def channels(
    measure: Misfit, response: FloatArray, noise: FloatArray, names: Sequence[str]
) -> dict[str, ChannelShrink]:
    """RMSE of the gap of each channel before and after, nuisances taken out of both."""
    known = measure.weights > 0.0
    rows = {}
    for c, name in enumerate(names):
        use = known[..., c]
        before = measure.cleaned(measure.gap)[..., c][use]
        after = measure.cleaned(measure.gap - response)[..., c][use]
        rows[name] = ChannelShrink(
            float(np.sqrt(np.mean(before**2))), float(np.sqrt(np.mean(after**2))), float(noise[c])
        )
    return rows
