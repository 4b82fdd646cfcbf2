"""The gap as a sum of effects: layer by layer, each refitted to what the others leave.

After Wang, Sarkar, Carbonetto & Stephens, *A simple new approach to variable selection in
regression*, J. R. Statist. Soc. B 82 (2020): a further effect is judged where the form error of
those in force counts as variance, `phi^2 <R^2>` over about four seconds, by the evidence where it
was learned what chance has, and by a logit elsewhere.

Probabilities of effects are those of two conditional logits, whose weights a calibration wrote:

    P(k) ~ exp(w' f_k) over all effects, exp(v' g) for "none" and exp(u' g) for "unknown"

f are the features of an effect, g those of the case. The second logit is for a further effect:
features are those of what the effects in force leave, and it says "none further" or which.
The softmax divides one: where two effects act, each gets half, and of a small gap "none" is as
right as what acts. Whether the likeliest effect acts is another question, whose answer is Platt's
(*Probabilistic outputs for support vector machines*, 1999): a logistic curve over the log odds.

The weights are in `odds.json` of this folder, with the date, and how many cases of which engines
they were fitted on (`python -m eval.diagnosis.blind.calibrate`).
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.special import expit, log_softmax, logit, logsumexp, ndtri

from narxcal.effects.library import LIBRARY, RARE
from narxcal.effects.steady import UNLOGGED_SWITCH
from narxcal.intervals import LEVEL
from narxcal.support.arrays import FloatArray
from training.diagnosis import load
from training.diagnosis.dictionary import Dictionary
from training.diagnosis.discrepancy import Discrepancy, activities
from training.diagnosis.fit import Frame, Single, solve
from training.diagnosis.metric import Metric, Record
from training.diagnosis.nuisances import Nuisances

_RARE: Final = -1.6  # one to five
# A parameter costs evidence of the whole record, and log ratios are per sample: sizes count by
# effective samples, in such units that five are 1 in the calibration's flights of eight minutes.
_CALIBRATED: Final = 15.0
_EDGE: Final = 1e-6  # no probability is nearer to 0 or 1
_FAINT: Final = 0.03  # log ratio below which all are alike: about that of nulls
FEATURES = ("bare", "ratio", "log_ratio", "explained", "size", "gain", "response")
OF_CASE = ("one", "bare", "ratio", "explained")


@dataclass(frozen=True)
class Odds:
    """Weights of the features of an effect and of the case, in both logits.

    `effect`, `none` and `unknown` are those of the first effect; `further` and `enough` those of
    one more, and of none further. `acts` are offset and slope over the log odds of the likeliest.
    """

    effect: tuple[float, ...]
    none: tuple[float, ...]
    unknown: tuple[float, ...]
    further: tuple[float, ...]
    enough: tuple[float, ...]
    acts: tuple[float, ...] = (0.0, 1.0)

    def first(self, names: Sequence[str], effects: FloatArray, case: FloatArray) -> FloatArray:
        """Log probabilities (n + 2,) of n effects of features (n, ...), of none, of unknown."""
        own = effects @ np.array(self.effect) + np.array([prior(name) for name in names])
        return np.asarray(log_softmax([*own, case @ self.none, case @ self.unknown]))

    def more(self, names: Sequence[str], effects: FloatArray, case: FloatArray) -> FloatArray:
        """Log probabilities (n + 1,) of a further effect, and of none."""
        own = effects @ np.array(self.further) + np.array([prior(name) for name in names])
        return np.asarray(log_softmax([*own, case @ self.enough]))

    def sure(self, leading: float) -> float:
        """Probability that the likeliest effect acts, from its probability among all answers."""
        offset, slope = self.acts
        return float(expit(offset + slope * log_odds(leading)))


def log_odds(chance: float) -> float:
    """Log odds of a probability, which is never taken for 0 or 1."""
    return float(logit(np.clip(chance, _EDGE, 1.0 - _EDGE)))


def prior(name: str) -> float:
    """Log odds of an effect before anything is seen, against one of the calibration's catalogue.

    No case there has a wrong scale or air data; a scale is rarer than an offset.
    """
    return _RARE if LIBRARY.get(name.partition(":")[0]) in RARE else 0.0


def features(frame: Frame, singles: Sequence[Single]) -> tuple[FloatArray, FloatArray]:
    """Features (effects, ...) of single fits, and those of the case, as `FEATURES`, `OF_CASE`."""
    record = frame.record
    before, floor, bare = frame.energy(frame.none), max(frame.floor, 1.0), frame.bare()
    without = bare.energy(bare.none)
    rows = []
    for one in singles:
        alone = solve(bare.grams, one.columns, begin=bare.none.tau)
        gain = before - frame.energy(one.solved)
        ratio = np.log(before / frame.energy(one.solved))
        size = np.sqrt(np.mean(((one.response / record.span) ** 2)[record.known]))
        rows.append(
            (
                np.log(without / bare.energy(alone)),
                ratio,
                np.log(max(ratio, 0.0) + _FAINT),
                frame.explained(one),
                _CALIBRATED * one.node.size / record.independent,
                np.log10(max(gain, 0.0) / floor + 0.01),
                np.log10(size + 1e-5),
            )
        )
    effects = np.array(rows)
    return effects, np.array([1.0, *effects[:, [0, 1, 3]].max(axis=0)])


def stored_odds(path: Path | None = None) -> Odds:
    """The weights that the last calibration wrote."""
    found: Mapping[str, Sequence[float]] = json.loads(
        (path or Path(__file__).with_name("odds.json")).read_text(encoding="utf-8")
    )
    keys = ("effect", "none", "unknown", "further", "enough", "acts")
    return Odds(**{key: tuple(found[key]) for key in keys})


FORM: Final = 0.3  # share by which the form of a response is wrong
_FORM_S: Final = 4.0
MOST: Final = 4
_REFINED: Final = 3  # of all that are tried, those that leave least
APART: Final = 2.0 * float(ndtri(LEVEL))  # distance from which on the likelier one is right
EVIDENCE: Final = 8.0  # that a layer has, where it was learned what chance has
PER_PARAMETER: Final = 6.0


@dataclass(frozen=True, eq=False)
class Layer:
    """One effect of the sum, as fitted beside the others.

    `chances` are the log probabilities of all effects in its place, best first, and `none` that of
    no effect there; `share` is what the effect takes of the first energy. `alike` are the effects
    that these flights do not tell from it.
    """

    single: Single
    chances: tuple[tuple[str, float], ...]
    none: float
    share: float
    alike: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.single.name

    @property
    def odds(self) -> float:
        """Log odds of the effect, or of one that is alike, against none in its place."""
        one = {self.name, *self.alike}
        return (
            float(logsumexp([chance for name, chance in self.chances if name in one])) - self.none
        )


def alike(
    frame: Frame, one: Single, tried: Sequence[Single], dictionary: Dictionary
) -> tuple[str, ...]:
    """Effects whose records these flights do not tell from those of `one`, best first.

    The likelier one of two would be right with a probability below that of an interval. Where an
    effect leaves more of the gap than `one` and such a distance together, no distance is formed.
    """
    reach = one.solved.cost**0.5 + APART * one.solved.tau**0.5
    near = [each for each in tried if each.name != one.name and each.solved.cost**0.5 <= reach]
    return tuple(
        each.name
        for each in near
        if frame.apart(one, dictionary.nodes.get(each.name, [each.node])) < APART
    )


@dataclass(frozen=True, eq=False)
class Setting:
    """What layers are fitted in: the record, its variance without any layer, and the nuisances."""

    record: Record
    variance: Sequence[FloatArray]
    nuisances: Nuisances
    dictionary: Dictionary
    odds: Odds
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

    def chances(self, frame: Frame, tried: Sequence[Single]) -> FloatArray:
        """Log probabilities (n + 1,) of each effect in a place of the sum, and of none."""
        if self.learned is None:
            return self.odds.more([one.name for one in tried], *features(frame, tried))
        evidence = [_evidence(frame, one, self.learned.spread(one.name)) for one in tried]
        return np.asarray(log_softmax(0.5 * np.array([*evidence, EVIDENCE])))


def further(
    setting: Setting, first: Layer | None, energy: float
) -> tuple[list[Layer], Layer | None]:
    """Layers from the `first` one on, and the next that would come in and does not.

    `energy` is that of the whole gap.
    """
    layers = [] if first is None else [first]
    while (found := _best(setting, layers, energy)) is not None:
        if found.odds <= 0.0 or len(layers) == MOST:
            break
        layers = _refit_each(setting, [*layers, found], energy)
    return layers, found


def _refit_each(setting: Setting, layers: list[Layer], energy: float) -> list[Layer]:
    """Each layer fitted again to what the others leave, by whichever effect is better now."""
    for k in range(len(layers)):
        found = _best(setting, [one for j, one in enumerate(layers) if j != k], energy)
        if found is not None:
            layers[k] = found
    return layers


def _best(setting: Setting, others: Sequence[Layer], energy: float) -> Layer | None:
    """The likeliest effect for what `others` leave, none that is alike to one of them."""
    frame, tried = compound_fits(setting, [one.single for one in others])
    known = {name for one in others for name in one.alike}
    tried = [one for one in tried if one.name not in known and not frame.within_build(one)]
    if not tried:
        return None
    chances = setting.chances(frame, tried)
    best = tried[int(np.argmax(chances[:-1]))]
    names = [one.name for one in tried]
    order = sorted(zip(names, chances[:-1].tolist(), strict=True), key=lambda pair: -pair[1])
    same = alike(frame, best, tried, setting.dictionary)
    share = _plain(frame, best) / energy
    return Layer(best, tuple(order), float(chances[-1]), share, same)


def compound_fits(setting: Setting, others: Sequence[Single]) -> tuple[Frame, list[Single]]:
    """The frame of what `others` leave, and every further effect fitted there, best first."""
    frame = setting.without(others)
    known = {one.name for one in others}
    tried = [frame.fit(nodes) for n, nodes in setting.dictionary.nodes.items() if n not in known]
    tried += [] if UNLOGGED_SWITCH.id in known else load.found(frame)
    tried.sort(key=lambda one: one.solved.cost)
    tried[:_REFINED] = [frame.refined(one, setting.dictionary, 1) for one in tried[:_REFINED]]
    return frame, tried


def _evidence(frame: Frame, one: Single, spread: float) -> float:
    """What an effect gains, in units of what it gains where none acts."""
    gain = (frame.none.cost - one.solved.cost) / one.solved.tau
    chosen = sum(p.all_or_nothing for p in one.node.parameters)
    count = len(one.node.free) + chosen + one.node.switches
    return float(gain / spread - PER_PARAMETER * (count - 1))


def _plain(frame: Frame, one: Single) -> float:
    """Energy that an effect takes of what is left, in noise alone."""
    record = frame.record
    weight = record.known / record.variance
    before = frame.cleaned(frame.none)
    after = frame.cleaned(one.solved) - one.response
    return float((weight * (before**2 - after**2)).sum())
