"""The gap as a sum of single effects: layer by layer, each refitted to what the others leave.

After Wang, Sarkar, Carbonetto & Stephens, *A simple new approach to variable selection in
regression*, J. R. Statist. Soc. B 82 (2020): a further effect is judged where the form error of
those in force counts as variance, `phi^2 <R^2>` over about four seconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.ndimage import uniform_filter1d

from narxcal.support.arrays import FloatArray
from training.budget.dictionary import Dictionary
from training.budget.fitting import Frame, Single
from training.budget.metric import Metric, Record
from training.budget.nuisances import Nuisances

FORM: Final = 0.3  # share by which the form of a response is wrong
_FORM_S: Final = 4.0
MOST: Final = 4
_ENTERS: Final = 0.42  # log ratio of what is left, where form error counts
_SHARE: Final = 0.005  # of the first energy


@dataclass(frozen=True, eq=False)
class Layer:
    """One effect of the sum, as fitted beside the others.

    `ratio` is the log ratio of what is left without and with it, `share` what it takes of the
    first energy, `rivals` every effect in its place with its own log ratio, best first.
    """

    single: Single
    ratio: float
    share: float
    rivals: tuple[tuple[str, float], ...]

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.single.name


@dataclass(frozen=True, eq=False)
class Setting:
    """What layers are fitted in: the record, its variance without any layer, and the nuisances."""

    record: Record
    variance: Sequence[FloatArray]
    nuisances: Nuisances
    dictionary: Dictionary

    def beside(self, others: Sequence[Single]) -> Frame:
        """The frame of what `others` leave, their form error counted as variance."""
        gap = self.record.gap - sum((one.response for one in others), np.zeros_like(self.record.gap))
        size = max(1, round(_FORM_S / self.record.flights.signals.dt_s))
        variance = self.variance[0]
        for one in others:
            square = uniform_filter1d(one.response**2, size, axis=1, mode="nearest")
            variance = variance + FORM**2 * square
        return Frame(self.record, Metric(self.record, [variance]), gap, self.nuisances)


def further(setting: Setting, first: Single, energy: float) -> list[Layer]:
    """Layers from the `first` effect on; `energy` is that of the whole gap."""
    layers = [Layer(first, 0.0, 0.0, ())]
    while len(layers) < MOST:
        found = _best(setting, [one.single for one in layers], energy)
        if found is None or found.ratio <= _ENTERS or found.share <= _SHARE:
            break
        layers.append(found)
        layers = _anew(setting, layers, energy)
    return layers


def candidate(setting: Setting, layers: Sequence[Layer], energy: float) -> Layer | None:
    """The next effect that would come in, whether it does or not."""
    return _best(setting, [one.single for one in layers], energy)


def _anew(setting: Setting, layers: list[Layer], energy: float) -> list[Layer]:
    """Each layer fitted again to what the others leave; another effect takes its place if better."""
    for k in range(len(layers)):
        others = [one.single for j, one in enumerate(layers) if j != k]
        found = _best(setting, others, energy)
        if found is not None:
            layers[k] = found
    return layers


def _best(setting: Setting, others: Sequence[Single], energy: float) -> Layer | None:
    """The effect that takes most of what `others` leave."""
    frame = setting.beside(others)
    names = {one.name for one in others}
    before = frame.energy(frame.none)
    tried = [frame.fit(nodes) for name, nodes in setting.dictionary.nodes.items() if name not in names]
    tried.sort(key=lambda one: one.solved.cost)
    tried[:3] = [frame.refined(one, setting.dictionary, 1) for one in tried[:3]]
    scored = [(float(np.log(before / frame.energy(one.solved))), one) for one in tried]
    scored.sort(key=lambda pair: -pair[0] * frame.explained(pair[1]))
    if not scored:
        return None
    ratio, best = scored[0]
    share = _plain(frame, best) / energy
    return Layer(best, ratio, share, tuple((one.name, r) for r, one in scored))


def _plain(frame: Frame, one: Single) -> float:
    """Energy that an effect takes of what is left, in noise alone."""
    record = frame.record
    weight = record.known / (record.noise**2 + (1e-3 * record.span) ** 2)
    before = frame.cleaned(frame.none)
    after = frame.cleaned(one.solved) - one.response
    return float((weight * (before**2 - after**2)).sum())
