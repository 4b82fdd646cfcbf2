"""Rotors that are slower both ways, or only while they speed up: what slowing down says of it.

Of rotors that are heavier both ways an asymmetry explains all that speeding up shows, and a
simulator whose decelerations are a little off, or that are governed, hides the rest: on engines of
other makers heavier rotors, and valves that are late, were taken for asymmetric ones. Where an
asymmetry was there, rotors slower both ways took three quarters of its gain at most in fourteen of
fifteen cases of nine engines; where it was not and led, nine tenths and more in five of seven. So
where both explain about as much, the plain one takes the other's place.
"""

from __future__ import annotations

from typing import Final

from narxcal.effects.base import Effect
from narxcal.effects.dynamic import AccelDecelAsymmetry, SpoolLag
from training.gap.fitting import Fit
from training.gap.work import Work

_AS_WELL: Final = 0.85  # of the asymmetry's gain


def places(work: Work) -> dict[str, float]:
    """What the ranks of an asymmetry and of rotors slower both ways are to be multiplied by.

    Nothing where the asymmetry does not lead the other, is of the control's limit of deceleration,
    or explains what the other does not.
    """
    one_way, both = _single(work, AccelDecelAsymmetry), _single(work, SpoolLag)
    if one_way is None or both is None or one_way.by_control:
        return {}
    first, second = work.rank(one_way), work.rank(both)
    as_well = work.gain(both) >= _AS_WELL * work.gain(one_way)
    if not (first > second > 0.0 and as_well):
        return {}
    return {both.name: first / second, one_way.name: second / first}


def _single(work: Work, kind: type[Effect]) -> Fit | None:
    alone = (one for one in work.fits if len(one.effects) == 1)
    return next((one for one in alone if isinstance(one.effects[0], kind)), None)
