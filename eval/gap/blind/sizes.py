"""Finds sizes that make a wanted share of the squared gap, and says what share a content makes.

    g = 1 - MSE(recorded - (simulated with the effect)) / MSE(recorded - simulated)

GAP section 2; the MSE of a channel counts over the square of its simulated range, channels alike.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from eval.gap.blind.catalogue import Dose
from eval.gap.blind.truth import NOTHING, Channels, Content, outputs_of

_TRIES: Final = 3
_CLOSE: Final = 0.1  # of the energy: the next size will do
_LEAST: Final = 1e-3  # of the energy asked for: the size does nothing yet
_SMALLEST: Final = 0.03  # of the first size
Measure = Callable[[float], float]


def ranges(simulated: Sequence[Channels]) -> dict[str, float]:
    """Range of each output over all simulated flights."""
    return {
        name: max(max(np.nanmax(s[name]) for s in simulated) - low, 1e-9)
        for name in outputs_of(simulated[0])
        for low in [min(np.nanmin(s[name]) for s in simulated)]
    }


def energy(one: Channels, other: Channels, spans: Mapping[str, float]) -> float:
    """Mean over the outputs of the squared difference, in squares of their ranges."""
    squares = [np.nanmean((one[name] - other[name]) ** 2) / spans[name] ** 2 for name in spans]
    return float(np.mean(squares))


def gap_share(
    recorded: Sequence[Channels],
    simulated: Sequence[Channels],
    told: Sequence[Channels],
) -> float:
    """Share of the squared gap that the true content takes away: `told` is simulated with it."""
    spans = ranges(simulated)
    before = sum(energy(r, s, spans) for r, s in zip(recorded, simulated, strict=True))
    after = sum(energy(r, t, spans) for r, t in zip(recorded, told, strict=True))
    return 1.0 - after / before if before > 0.0 else 0.0


def sized(specimen: Any, flights: Sequence[Any], simulated: Sequence[Channels]) -> Content:
    """Give the case's content the sizes that come to its share on some flights.

    Several effects get equal parts. A share that the largest size does not make is left at that.
    """
    case = specimen.case
    if case.kind == "null":
        return NOTHING
    spans = ranges(simulated)
    recorded = [specimen.both(flight, NOTHING)[1] for flight in flights]
    rest = sum(energy(r, s, spans) for r, s in zip(recorded, simulated, strict=True))
    wanted = rest * case.share / (1.0 - case.share)

    def measured(content: Content) -> float:
        # By itself: what it shares with the errors of the base would make it look larger.
        told = [specimen.simulated(flight, content) for flight in flights]
        return sum(energy(t, s, spans) for t, s in zip(told, simulated, strict=True))

    if case.strange is not None:
        size = size_for(lambda s: measured(Content(strange=s)), wanted, case.strange[3:5])
        return Content(strange=size)
    doses = []
    for scale, sign in zip(case.effects, case.signs, strict=True):

        def alone(size: float, dose: Dose = Dose(scale, sign)) -> float:  # noqa: B008 - bound now
            return measured(Content((dose._replace(size=dose.size * size),)))

        part = wanted / len(case.effects)
        doses.append(Dose(scale, sign * size_for(alone, part, (scale.first, scale.most))))
    return Content(tuple(doses))


def size_for(measured: Measure, wanted: float, sizes: tuple[float, float]) -> float:
    """Size, up to the second of `sizes`, whose energy is as wanted: few tries from the first.

    Energies go with a power of the size, about the second; the power is taken from the last two.
    """
    size, most = sizes
    least = _SMALLEST * size
    power, last = 2.0, (0.0, 0.0)
    for _ in range(_TRIES):
        made = measured(size)
        if made < _LEAST * wanted:
            if size >= most:
                return most
            size = min(3.0 * size, most)
            continue
        if last[1] > 0.0 and abs(math.log(size / last[0])) > 0.02:
            power = math.log(made / last[1]) / math.log(size / last[0])
        last = (size, made)
        size = size * (wanted / made) ** (1.0 / min(max(power, 0.7), 4.0))
        size = min(max(size, least), most)
        if abs(math.log(wanted / made)) < _CLOSE:
            break
    return size
