"""The verdict over all that was tried: none, effects, ambiguous or unknown, and why."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import t

from narxcal.effects.base import RateEffect
from narxcal.support.arrays import FloatArray
from training.budget.result import Interval, Kind
from training.gap.answer import Worth, channels, probabilities, shrink, tried
from training.gap.finding import Finding, Tried
from training.gap.fitting import Fit
from training.gap.foils import foil
from training.gap.offsets import Offset
from training.gap.work import Work

_LEFT = 0.01  # of the gap: nobody can tell two models that both leave less
_KIN = 0.75  # of what the leader takes
_HALF = 0.5  # of what the leader takes beyond small misfit: one that takes less is no rival
_APART = 0.2  # in what two explain where they act: they are about different things
_SMALL = 0.25  # of the mean gap of a flight: less is none to take shares of
_AGREED = 0.95  # level at which flights agree on who is ahead


def finding(
    work: Work,
    claimed: Fit | None,
    offset: Offset | None,
    noise: FloatArray,
) -> Finding:
    """The verdict over all that was tried."""
    order = sorted(work.fits, key=work.rank, reverse=True)
    if claimed is not None:
        order = [claimed, *(one for one in order if one is not claimed)]
    rows = _rows(work, claimed, offset, order)
    models = ([] if claimed is None else [claimed]) + ([] if offset is None else offset[0][:1])
    response = sum((one.response for one in models), start=np.zeros_like(work.problem.flights.y))
    kind, reason = _verdict(work, claimed, offset)
    rivals = () if claimed is None else _rivals(work, claimed, order)
    if kind == "effects" and rivals:
        kind, reason = "ambiguous", "other effects explain held-out flights as well"
    silent = kind in ("none", "unknown")
    names = () if silent else _names(work, claimed, offset)
    leader = claimed or (offset[0][0] if offset else None)
    signals = work.problem.flights.signals
    return Finding(
        kind=kind,
        effects=names,
        ambiguous_with=() if silent else rivals,
        reason=reason,
        separating_manoeuvre="" if leader is None else leader.effects[0].manoeuvre,
        tried=tuple(rows),
        predicted=_predicted(work, claimed, offset, response),
        channels=channels(work.problem.misfit, response, noise, signals.outputs),
        gap_share=work.audible / float(work.before.sum()),
        left_share=1.0 if claimed is None else work.left(claimed),
        by_others=None if silent else _by_others(models, response),
    )


def _rows(
    work: Work, claimed: Fit | None, offset: Offset | None, order: Sequence[Fit]
) -> list[Tried]:
    """All that was tried, best first; offsets where one is claimed, or nothing is."""
    odds = probabilities([one.held_out for one in order])
    rows = [
        tried(model, Worth(work.gain(model), work.gains(model), work.left(model)), float(p))
        for model, p in zip(order, odds, strict=True)
    ]
    if offset is not None:
        rows = _with_offsets(rows, offset, claimed)
    elif claimed is None and work.offered:
        whole = work.tight.size(work.tight.gap)
        rows += _offsets((work.offered, whole, work.whole))
    return rows


def _by_others(models: Sequence[Fit], response: FloatArray) -> FloatArray:
    """What the parameters that the other flights give change of the response in each flight."""
    steps = (np.einsum("fp,pftn->ftn", one.others - one.theta, one.slopes) for one in models)
    return sum(steps, start=np.zeros_like(response))


def _predicted(
    work: Work, claimed: Fit | None, offset: Offset | None, response: FloatArray
) -> Interval:
    """Share of the squared gap, offsets and all, that the claim takes off flights unseen.

    What each flight loses by having had no part in the fit is added to what is left of it.
    """
    whole = work.tight.size(work.tight.gap)
    known = work.tight.weights > 0.0
    left = work.tight.size(np.where(known, work.tight.gap - response, 0.0))
    for model in ([] if claimed is None else [claimed]) + ([] if offset is None else offset[0][:1]):
        left = left + model.held_out - model.left
    return shrink(1.0 - left / whole, 1.0 - float(left.sum() / whole.sum()))


def _with_offsets(
    rows: Sequence[Tried],
    offset: Offset,
    claimed: Fit | None,
) -> list[Tried]:
    """Rows with the offsets among them: first where nothing else was claimed, else second."""
    own = _offsets(offset)
    return [rows[0], *own, *rows[1:]] if claimed is not None else [*own, *rows]


def _offsets(offset: Offset) -> list[Tried]:
    """Offsets as rows; what they gain is a share of the whole gap."""
    fits, before, audible = offset
    odds = probabilities([one.held_out for one in fits])
    own = []
    for one, p in zip(fits, odds, strict=True):
        gain = float((before - one.held_out).sum()) / audible
        worth = Worth(gain, 1.0 - one.held_out / before, 1.0 - gain)
        own.append(tried(one, worth, float(p)))
    return own


def _names(work: Work, claimed: Fit | None, offset: Offset | None) -> tuple[str, ...]:
    """What is claimed, an offset first where it takes more of the gap than what moves."""
    names = () if claimed is None else tuple(effect.name for effect in claimed.effects)
    if offset is None:
        return names
    fits, before, _ = offset
    moving = 0.0 if claimed is None else float((work.before - claimed.held_out).sum())
    first = float((before - fits[0].held_out).sum()) > moving
    return (fits[0].name, *names) if first else (*names, fits[0].name)


def _verdict(work: Work, claimed: Fit | None, offset: Offset | None) -> tuple[Kind, str]:
    """Kind of the answer and the reason for it, rivals aside."""
    heard = work.audible / float(work.problem.misfit.floor.sum())
    if (offset is not None) if claimed is None else bearable(work, claimed):
        return "effects", "explains flights that had no part in the fit"
    if offset is None and work.offered and work.offered[0].at_bound:
        name = work.offered[0].name
        return "unknown", f"no {name} is as large as this: is the simulator one of this engine?"
    if heard < work.options.audible:
        return "none", "no gap beyond noise and build scatter"
    if offset is None and work.loudest < work.options.quiet:
        return "none", "what is left beyond build scatter is below what has to be explained"
    if claimed is not None:
        left = 100.0 * work.left(claimed)
        return "unknown", f"the best effect leaves {left:.0f} % of the gap unexplained"
    return "unknown", _too_little(work, work.fits[0])


def _too_little(work: Work, best: Fit) -> str:
    """Why the best effect is no answer to a gap that is real."""
    takes = f"the best one takes {100.0 * work.gain(best):.0f} % of it"
    problem = work.problem
    instead = foil(best, problem.misfit, problem.flights.signals.outputs)
    if instead:
        return f"{takes}, {instead}"
    beyond = float(work.beyond(best).sum()) >= work.options.beyond * work.audible
    if beyond and not work.holds(work.before - best.held_out, best):
        rows = work.witnesses(best)
        return f"{takes}, but not in nearly all flights: {rows.sum()} of {len(rows)} tell of it"
    if beyond or work.gain(best) <= work.options.material:
        return takes
    return f"{takes}, hardly more than small misfit of any simulator does"


def bearable(work: Work, claimed: Fit) -> bool:
    """Whether what is left unexplained may be left."""
    options = work.options
    most = options.unexplained
    if len(claimed.effects) > 1:
        most = options.unexplained_together
    elif isinstance(claimed.effects[0], RateEffect):
        most = options.unexplained_inside
    if work.left(claimed) <= most or work.tells(claimed) or work.stands_out(claimed):
        return True
    # A part of what nobody would call a gap is no more worth naming than the rest of it.
    distinct = work.gain(claimed) >= options.distinct and work.loudest >= options.quiet
    return distinct and work.aligned(claimed) >= options.aligned


def _rivals(work: Work, claimed: Fit, order: Sequence[Fit]) -> tuple[str, ...]:
    """Effects that may be meant instead of those claimed, by models of as many effects.

    Those that leave hardly more of held-out flights, or of which the flights do not agree that they
    are worse; and where a single leader leaves much, those of its family that take three quarters
    of what it takes: its form, not its kind, may be what does not fit.
    """
    many = len(claimed.effects)
    others = [one for one in order if one is not claimed and len(one.effects) == many]
    alike = [one for one in others if _equal(work, claimed, one)]
    if many == 1 and work.left(claimed) > work.options.unexplained:
        family = claimed.effects[0].family
        kin = [one for one in others if one.effects[0].family == family and one not in alike]
        alike += [one for one in kin if work.gain(one) >= _KIN * work.gain(claimed)]
    mine = {effect.name for effect in claimed.effects}
    names = [effect.name for one in alike for effect in one.effects if effect.name not in mine]
    return tuple(dict.fromkeys(names))


def _equal(work: Work, claimed: Fit, other: Fit) -> bool:
    """Whether held-out flights do not tell the two apart, nor what they explain where they act."""
    if work.aligned(other) < work.aligned(claimed) - _APART:
        return False
    mine, theirs = (float(work.beyond(one).sum()) for one in (claimed, other))
    if theirs < _HALF * mine:
        return False
    left = 1.0 - work.gain(claimed)
    if 1.0 - work.gain(other) <= work.options.close * left + _LEFT:
        return True
    gap = work.before - work.problem.misfit.floor  # flights of any length count the same
    worse = (other.held_out - claimed.held_out) / np.maximum(gap, _SMALL * gap.mean())
    count = len(worse)
    if count < 2 or work.gain(other) < 0.5 * work.gain(claimed):
        return False
    error = worse.std(ddof=1) / np.sqrt(count)
    return bool(worse.mean() < t.ppf(_AGREED, count - 1) * error)
