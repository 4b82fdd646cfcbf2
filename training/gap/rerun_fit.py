"""What a simulator that can be run again says itself of effects on its inputs.

The search asks an emulator, hundreds of times. What it finds, and whatever comes near it, is fitted
anew from there with the simulator itself in the emulator's place: sizes, gains and what the flights
cannot tell apart are then its own, not those of a stand-in.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from narxcal.effects.base import Effect, InputEffect, ShiftEffect
from training.gap.fitting import Fit, Problem, fit
from training.gap.offsets import Offset, unexplained
from training.gap.work import Watch, Work

_NOTHING = 0.03  # of the whole gap: nobody asks for what takes that
_NEAR = 0.5  # of what the claimed model gains: one that gains less is no rival of it


def told_anew(
    work: Work, claimed: Fit | None, offset: Offset | None, watch: Watch | None
) -> tuple[Fit | None, Offset | None]:
    """The claimed model and offset by the simulator itself, its rivals among `work.fits` too.

    All stay as they are if the simulator cannot be run again, or nothing in them acts on inputs. An
    offset that then leaves nothing to explain is the answer by itself: what else was claimed made
    up for the emulator.
    """
    if work.itself is None:
        return claimed, offset
    own = replace(work.problem, emulator=work.itself)
    if claimed is not None and offset is not None and on_inputs(offset[0][0].effects[0]):
        alone = _offset_anew(work, None, offset, watch)
        left = float((alone[0][0].held_out - work.tight.floor).sum())
        if left <= _NOTHING * work.whole:
            return None, alone
    if claimed is not None:
        found = _anew(_rivals(work, claimed), own, watch)
        work.fits = [found.get(one, one) for one in work.fits]
        claimed = found.get(claimed, claimed)
    return claimed, None if offset is None else _offset_anew(work, claimed, offset, watch)


def on_inputs(effect: Effect) -> bool:
    """Whether only a run of the simulator says what an effect does; a delay shifts its outputs."""
    return isinstance(effect, InputEffect) and not isinstance(effect, ShiftEffect)


def _rivals(work: Work, claimed: Fit) -> list[Fit]:
    """The claimed model and those of as many effects that come near it, if they act on inputs."""
    alike = [one for one in work.fits if len(one.effects) == len(claimed.effects)]
    near = [one for one in alike if work.gain(one) >= _NEAR * work.gain(claimed)]
    models = [claimed, *(one for one in near if one is not claimed)]
    return [one for one in models if any(map(on_inputs, one.effects))]


def _anew(models: list[Fit], problem: Problem, watch: Watch | None) -> dict[Fit, Fit]:
    found = {}
    for k, one in enumerate(models):
        if watch is not None:
            watch(f"{one.name}, the simulator run again", k, len(models))
        found[one] = fit(one.effects, problem, one.theta)
    return found


def _offset_anew(work: Work, claimed: Fit | None, offset: Offset, watch: Watch | None) -> Offset:
    """The leading offset, fitted to what the claimed model leaves."""
    fits, _, audible = offset
    if not any(map(on_inputs, fits[0].effects)):
        return offset
    explained = np.zeros_like(work.problem.flights.y) if claimed is None else claimed.response
    left = unexplained(work.tight, explained)
    own = replace(work.problem, emulator=work.itself, misfit=left)
    found = _anew(fits[:1], own, watch)
    return [found[fits[0]], *fits[1:]], left.size(left.gap), audible
