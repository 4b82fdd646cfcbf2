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
from training.budget.discrepancy import Discrepancy, activities
from training.budget.fitting import Frame, Single
from training.budget.metric import Metric, Record
from training.budget.nuisances import Nuisances

FORM: Final = 0.3  # share by which the form of a response is wrong
_FORM_S: Final = 4.0
MOST: Final = 4
_ENTERS: Final = 0.42  # log ratio of what is left, where form error counts
EVIDENCE: Final = 8.0  # that a layer has, where it was learned what chance has
PER_PARAMETER: Final = 6.0
_SHARE: Final = 0.005  # of the first energy


@dataclass(frozen=True, eq=False)
class Layer:
    """One effect of the sum, as fitted beside the others.

    `ratio` is the log ratio of what is left without and with it, `share` what it takes of the
    first energy, `confusable` every effect in its place with its own log ratio, best first.
    """

    single: Single
    ratio: float
    share: float
    confusable: tuple[tuple[str, float], ...]

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
    learned: Discrepancy | None = None

    def without(self, others: Sequence[Single]) -> Frame:
        """The frame of what `others` leave, their form error counted as variance."""
        gap, variance = self.record.gap, list(self.variance)
        for one in others:
            response = one.response
            gap = gap - response
            for b, square in enumerate(self._squares(response)):
                variance[b] = variance[b] + FORM**2 * square
        metric = Metric(self.record, variance)
        return Frame(self.record, metric, gap, self.nuisances, assumed=self.learned is None)

    def _squares(self, response: FloatArray) -> list[FloatArray]:
        """Mean squares of a response per band, over about four seconds or the band's own time."""
        if self.learned is not None:
            return activities(response)
        size = max(1, round(_FORM_S / self.record.flights.signals.dt_s))
        return [uniform_filter1d(response**2, size, axis=1, mode="nearest")]

    def score(self, frame: Frame, one: Single) -> float:
        """What an effect's place is worth: evidence where it was learned what none would gain."""
        if self.learned is None:
            return float(np.log(frame.energy(frame.none) / frame.energy(one.solved)))
        gain = (frame.none.cost - one.solved.cost) / one.solved.tau
        size = self.learned.spread(one.name)
        return gain / size - PER_PARAMETER * (len(one.node.parameters) - 1)

    def enters(self, layer: Layer) -> bool:
        """Whether a layer is evidence enough, and no trifle."""
        if self.learned is not None:
            return layer.ratio >= EVIDENCE
        return layer.ratio > _ENTERS and layer.share > _SHARE


def further(setting: Setting, first: Layer | None, energy: float) -> list[Layer]:
    """Layers from the `first` one on; `energy` is that of the whole gap."""
    layers = [] if first is None else [first]
    while len(layers) < MOST:
        found = _best(setting, [one.single for one in layers], energy)
        if found is None or not setting.enters(found):
            break
        layers.append(found)
        layers = _anew(setting, layers, energy)
    return layers


def candidate(setting: Setting, layers: Sequence[Layer], energy: float) -> Layer | None:
    """The next effect that would come in, whether it does or not."""
    return _best(setting, [one.single for one in layers], energy)


def _anew(setting: Setting, layers: list[Layer], energy: float) -> list[Layer]:
    """Each layer fitted again to what the others leave, by whichever effect is better now."""
    for k in range(len(layers)):
        others = [one.single for j, one in enumerate(layers) if j != k]
        found = _best(setting, others, energy)
        if found is not None:
            layers[k] = found
    return layers


def _best(setting: Setting, others: Sequence[Single], energy: float) -> Layer | None:
    """The effect that takes most of what `others` leave."""
    frame = setting.without(others)
    names = {one.name for one in others}
    tried = [
        frame.fit(nodes) for name, nodes in setting.dictionary.nodes.items() if name not in names
    ]
    tried.sort(key=lambda one: one.solved.cost)
    tried[:3] = [frame.refined(one, setting.dictionary, 1) for one in tried[:3]]
    scored = [(setting.score(frame, one), one) for one in tried]
    if setting.learned is None:
        scored.sort(key=lambda pair: -pair[0] * frame.explained(pair[1]))
    else:
        scored.sort(key=lambda pair: -pair[0])
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
