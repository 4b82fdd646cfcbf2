"""A limit of acceleration that is wear's own: a worn engine has less power to spare.

A control schedules the fuel that an engine may accelerate with. That is a fifth more than what
holds the speed at least, and two fifths in most slams, so that of the surplus an engine that
needs s more to hold its speed loses up to five times s. On five engines of different makers the
limit fell by 2.8 to 4.4 times the rise of temperature at one fan speed; on three whose control
schedules the rate of the core's speed, or fuel above what holds it, by 0.3 times at most. Less
power to spare is no second effect beside wear, and where scatter of builds would hide the wear it
is a part of what tells of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np

from narxcal.effects import effect
from narxcal.effects.dynamic import AccelLimit
from narxcal.effects.steady import Deterioration
from narxcal.support.arrays import FloatArray
from training.gap.at_speed import at_one_speed, burns_more, typical
from training.gap.fitting import Fit, in_nearly_all
from training.gap.offsets import MAYBE, SURELY, Offset, offset_fits, unexplained
from training.gap.work import Work

_OF_SURPLUS: Final = 5.0  # share of the limit that goes with as much of the temperature, at most
_HOTTER_PCT: Final = 2.4  # at one fan speed: more than build scatter makes an engine


class Answer(NamedTuple):
    """What moves and what shifts, as claimed; the names of what else may be meant, and why."""

    claimed: Fit | None
    offset: Offset | None
    rivals: tuple[str, ...] = ()
    why: str = ""


def with_its_limit(work: Work, claimed: Fit | None, offset: Offset | None) -> Answer:
    """The answer with a limit of acceleration as a part of wear, where it may be one.

    Beside wear it is not named. By itself it is, and wear as well where the engine is hotter and
    burns more at one fan speed; wear first where that is more than scatter of builds.
    """
    plain = Answer(claimed, offset)
    if claimed is None or not all(isinstance(one, AccelLimit) for one in claimed.effects):
        return plain
    shifts, lost = at_one_speed(work.problem.flights, work.tight), 1.0 - float(claimed.theta[0])
    if not _is_its_own(lost, shifts):
        return plain
    if offset is not None:
        own = f"{100.0 * lost:.0f} % less acceleration beside it may be the wear's own"
        worn = isinstance(offset[0][0].effects[0], Deterioration)
        return Answer(None, offset, (), own) if worn else plain
    wear = _wear(work, claimed)
    if wear is None or not burns_more(shifts, MAYBE):
        return plain
    hotter, more = (typical(shifts[name]) for name in ("EGT_C", "FF_kgph"))
    why = f"wear takes {100.0 * lost:.0f} % of acceleration, too: {_seen(hotter, more)}"
    if burns_more(shifts, SURELY) and hotter > _HOTTER_PCT:
        return Answer(None, wear, (claimed.name,), why)
    return Answer(claimed, None, (wear[0][0].name,), why)


def _is_its_own(lost: float, shifts: Mapping[str, FloatArray]) -> bool:
    """Whether an engine as much hotter, in all flights that tell, may lose that of its limit."""
    hotter = shifts.get("EGT_C", np.zeros(1))
    if (hotter <= 0.0).any():
        return False
    return 0.0 < lost <= 0.01 * _OF_SURPLUS * typical(hotter)


def _wear(work: Work, claimed: Fit) -> Offset | None:
    """Wear beside what is claimed, however small, as long as (nearly) all flights have it."""
    wear = effect("deterioration")
    if not wear.applies(work.problem.flights.signals):
        return None
    left = unexplained(work.tight, claimed.response)
    fits, before = offset_fits(work.problem, left, [wear]), left.size(left.gap)
    if not fits or fits[0].at_bound or not in_nearly_all(before - fits[0].held_out):
        return None
    return fits, before, work.whole


def _seen(hotter: float, more: float) -> str:
    return f"at one fan speed the engine is {hotter:.1f} % hotter and burns {more:.1f} % more"
