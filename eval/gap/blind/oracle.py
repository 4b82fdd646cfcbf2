"""Where a case's content truly is: what is so with it less what would be without, no noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from eval.gap.bands import bands_of
from eval.gap.bins import MOVES, sort_samples
from eval.gap.blind.truth import Channels, outputs_of
from eval.gap.blocks import batch
from eval.gap.data import GapData, Pair
from eval.gap.excitation import events_of
from training.gap.quadratic import TOLERANCE

Shares = dict[str, float]  # "channel|direction|phase" -> share of the energy


def bin_name(channel: str, direction: str, phase: str) -> str:
    """Name of a bin, in the key and in the score."""
    return f"{channel}|{direction}|{phase}"


def located(
    effect: Sequence[tuple[Channels, Channels]],
    simulated: Sequence[Channels],
    recorded: Sequence[Channels],
) -> dict[str, Any]:
    """Give where the content is, as rows of the key: bins, and each channel's bands of frequency.

    Arguments as for `true_shares`; nothing where there is no content.
    """
    if not effect:
        return {"where": {}, "bands": {}}
    data = _moved_by(effect, simulated)
    quiet = replace(data, noise=np.zeros_like(data.noise))
    bands = {name: [each.share for each in every] for name, every in bands_of(quiet).items()}
    return {"where": true_shares(effect, simulated, recorded), "bands": bands}


def true_shares(
    effect: Sequence[tuple[Channels, Channels]],
    simulated: Sequence[Channels],
    recorded: Sequence[Channels],
) -> Shares:
    """Share of each bin in the energy of what the content does, in the weights of the diagnosis.

    `effect` is what is so with the content, and without it; what else is wrong with the simulator
    (its build, its structure) is in both and cancels. The recorded flights give nothing but the
    noise in the weights, the simulated ones the bins. Bins without any are left out.
    """
    noise = batch(_pairs(recorded, simulated)).noise
    data = _moved_by(effect, simulated)
    move = sort_samples(data, events_of(data)).move
    scale = np.sqrt(noise**2 + (TOLERANCE * data.span) ** 2)
    sample = np.nan_to_num((data.gap / scale) ** 2)
    found: Shares = {}
    for k, channel in enumerate(data.flights.signals.outputs):
        per_move = np.bincount(
            move[move >= 0], weights=sample[..., k][move >= 0], minlength=len(MOVES)
        )
        names = [bin_name(channel, *each) for each in MOVES]
        found.update(zip(names, per_move.tolist(), strict=True))
    whole = sum(found.values())
    return {name: value / whole for name, value in found.items() if whole > 0.0 and value > 0.0}


def core(shares: Mapping[str, float], held: float = 0.7) -> set[str]:
    """The smallest set of bins that holds 70 % of the energy."""
    found, total = set(), 0.0
    for name in sorted(shares, key=lambda each: (-shares[each], each)):
        if total >= held * sum(shares.values()):
            break
        found.add(name)
        total += shares[name]
    return found


def channel_of_most(shares: Mapping[str, float]) -> str | None:
    """Channel with the largest share; None where there is nothing."""
    return share_of_most(shares, 0)


def share_of_most(shares: Mapping[str, float], part: int) -> str | None:
    """The part of the name (0 channel, 1 direction, 2 phase) with the largest share in all."""
    totals: dict[str, float] = {}
    for name, value in shares.items():
        key = name.split("|")[part]
        totals[key] = totals.get(key, 0.0) + value
    return max(totals, key=lambda each: totals[each]) if totals else None


def _moved_by(
    effect: Sequence[tuple[Channels, Channels]], simulated: Sequence[Channels]
) -> GapData:
    moved = [_moved(s, *both) for s, both in zip(simulated, effect, strict=True)]
    return batch(_pairs(moved, simulated))


def _moved(simulated: Channels, true: Channels, without: Channels) -> Channels:
    """What was simulated, and the difference that the content makes."""
    outputs = {n: simulated[n] + true[n] - without[n] for n in outputs_of(simulated)}
    return {**simulated, **outputs}


def _pairs(real: Sequence[Channels], simulated: Sequence[Channels]) -> list[Pair]:
    return [
        Pair(
            f"flight_{k}",
            sim["time_s"],
            {n: v for n, v in sim.items() if n not in ("time_s", *outputs_of(sim))},
            {name: each[name] for name in outputs_of(sim)},
            {name: sim[name] for name in outputs_of(sim)},
        )
        for k, (each, sim) in enumerate(zip(real, simulated, strict=True))
    ]
