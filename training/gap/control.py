"""Which kind of control a simulator's engine is under, where its own logs leave that open.

A control holds the fan's speed or the core's, and a two-spool engine under either follows the same
logs about equally well. What the two kinds disagree on is a fan that is heavier than simulated: a
governor of the fan makes up for it with fuel, so that the core overshoots; one of the core leaves
the fan to trail. On the way it schedules fuel or the core's acceleration, and the logs are the
same. What those disagree on is a heavier core: held to its acceleration it takes more fuel instead
of more time, and only the fan trails. So the recorded flights are asked, by the effects that tell.
"""

from __future__ import annotations

from collections.abc import Sequence

from narxcal.effects.base import Effect, FloatArray
from narxcal.effects.dynamic import SpoolCoupling, SpoolLag
from narxcal.effects.running import Flights
from training.gap.emulator import GreyBoxEmulator
from training.gap.fitting import Problem, fit
from training.gap.quadratic import misfit

_CLEARLY = 0.1  # of the gap: less is no reason to doubt what follows the logs better


def suited(
    emulators: Sequence[GreyBoxEmulator], flights: Flights, measured: tuple[FloatArray, FloatArray]
) -> GreyBoxEmulator:
    """The emulator under whose control heavier rotors take clearly more of the gap, or the first.

    Both, or the fan alone, whichever takes more. `measured` are the recorded outputs (flights,
    time, outputs), NaN where unknown, and the standard deviation of their noise (outputs,).
    """
    heavier: tuple[Effect, ...] = (SpoolCoupling(), SpoolLag())
    if len(emulators) == 1 or not all(each.applies(flights.signals) for each in heavier):
        return emulators[0]
    measure = misfit(flights, *measured)
    least = _CLEARLY * float(measure.size(measure.gap).sum())
    left = [
        min(float(fit([each], Problem(flights, one, measure)).held_out.sum()) for each in heavier)
        for one in emulators
    ]
    best = min(range(len(left)), key=left.__getitem__)
    return emulators[best] if left[best] < left[0] - least else emulators[0]
