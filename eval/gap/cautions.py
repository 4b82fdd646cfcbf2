"""What a reader has to know before he believes the answer, in a sentence each."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from eval.gap.claimed import Values, claimed
from eval.gap.data import GapData, Pair
from eval.gap.evidence import Evidence
from eval.gap.parts import FEWEST
from narxcal.effects.base import InputEffect, RateEffect, SettledEffect, ShiftEffect
from narxcal.effects.library import effect
from narxcal.support.arrays import FloatArray

_UNKNOWN = 0.01  # of the samples
_COARSE, _LOUD = 0.5, 0.1  # an emulator's error against the gap, a channel's share of the gap
_KELVIN, _NEAR_K = 273.15, 15.0
_FAR = 0.08  # of a speed: no wear and no sensor is that far off


def cautions(pairs: Sequence[Pair], data: GapData) -> list[str]:
    """What the logs give reason to be careful about."""
    return [*_few(pairs, data), *_left_out(pairs), *_unknown(pairs), *_kelvin(data), *_far(data)]


def coarse_emulator(evidence: Evidence, *, again: bool) -> list[str]:
    """Say so where the emulator's own error is no match for the gap that it has to explain.

    That matters where a claimed effect acts inside the engine, or before it and the simulator
    cannot be run `again`, on channels that hold a tenth of the gap or more.
    """
    if not rests_on_emulator(claimed(evidence.finding), again=again):
        return []
    gap = np.sqrt(np.nanmean(evidence.data.gap**2, axis=(0, 1)))
    own = evidence.finding.emulator_rmse
    coarse = [
        f"{name} ({own[name]:.3g} of {size:.3g})"
        for name, size in zip(evidence.data.flights.signals.outputs, gap.tolist(), strict=True)
        if own[name] > _COARSE * size and evidence.where.channels[name].value >= _LOUD
    ]
    if not coarse:
        return []
    words = (
        f"the emulator's own error is more than half of the gap in {', '.join(coarse)}: sizes of "
        "effects inside the engine are less sure than their intervals say"
    )
    return [words]


def rests_on_emulator(values: Values, *, again: bool) -> bool:
    """Whether what any of the effects does is the emulator's answer."""
    return any(_emulated(name, own, again=again) for name, own in values.items())


def _emulated(name: str, values: Mapping[str, float], *, again: bool) -> bool:
    """Whether what it does rests on the emulator: of loads and heat what they take of the core."""
    kind = effect(name)
    told = isinstance(kind, InputEffect) and not isinstance(kind, ShiftEffect)
    takes = values.get("loss", 0.0) > 0.0
    return isinstance(kind, (RateEffect, SettledEffect)) or takes or (told and not again)


def _few(pairs: Sequence[Pair], data: GapData) -> Iterator[str]:
    if len(pairs) < FEWEST:
        words = f"{len(pairs)} flight{'s' if len(pairs) > 1 else ''}: the uncertainty is wider"
        if len(data.names) > len(pairs):
            words += f"; {len(data.names)} parts of them stand for flights"
        yield words


def _left_out(pairs: Sequence[Pair]) -> Iterator[str]:
    """Channels that are not diagnosed, and why."""
    found = dict.fromkeys(item for pair in pairs for item in pair.lone.items())
    return (f"{name} is {why}: it is left out" for name, why in found)


def _unknown(pairs: Sequence[Pair]) -> Iterator[str]:
    unknown = 1.0 - float(np.mean([np.isfinite(v).mean() for p in pairs for v in p.real.values()]))
    if unknown > _UNKNOWN:
        yield f"{100.0 * unknown:.1f} % of the recorded samples are unknown"
    cut = sum(pair.counts.get("cut at the end", 0) for pair in pairs)
    if cut:
        yield f"{cut} samples at the ends of flights have no partner and are cut"


def _kelvin(data: GapData) -> Iterator[str]:
    for k, name in enumerate(data.flights.signals.outputs):
        apart = _middle(data.gap[..., k])
        if name.endswith("_C") and abs(abs(apart) - _KELVIN) < _NEAR_K:
            yield (
                f"recorded {name} stands {apart:.0f} off the simulated one throughout: one of them "
                "looks like kelvin"
            )


def _far(data: GapData) -> Iterator[str]:
    for k, name in enumerate(data.flights.signals.outputs):
        level = _middle(np.where(np.isfinite(data.gap[..., k]), data.flights.y[..., k], np.nan))
        apart = _middle(data.gap[..., k]) / level if level > 0.0 else 0.0
        if name.endswith("_pct") and abs(apart) > _FAR:
            yield (
                f"recorded {name} stands {100.0 * apart:+.0f} % of its level off the simulated one "
                "throughout: another engine, or another speed for 100 %?"
            )


def _middle(values: FloatArray) -> float:
    return float(np.nanmedian(values))
