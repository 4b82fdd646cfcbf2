"""How fast an engine moves against its simulator: what effects on rates say of it.

A two-spool engine moves by the power its core has to spare. What can be different is how fast
either spool turns that into speed, up or down; what thin air makes of it; how much acceleration the
control allows; how late the fuel valve follows what the control asks for; and what metal that is
colder than the gas, or warmer, takes of the power or gives to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from narxcal.support.arrays import FloatArray

UNLIMITED: Final = 1e6  # %/s: no limit at all


class Pace(NamedTuple):
    """Each field is `(batch,)`.

    Rates of the fan and of the core are so many times as fast while they speed up and while they
    slow down, and go with `thin_air` as a further power of `delta / sqrt(theta)`. `limit` is the
    greatest acceleration that the control asks for over the simulator's own, `fall` the greatest
    deceleration; `valve_s` is a further lag between what it asks for and the fuel. What fuel does
    to the core depends on the core's own time constant `core_s` at constant fuel, which no log of a
    governed engine shows. The core lacks `loss` (%/s) per unit of a temperature by which the
    metal, behind a lag of `metal_s`, trails the blades, behind one of `rise_s`. `most` is the
    greatest acceleration (%/s) that the control asks for at any speed and altitude.
    """

    fan_up: FloatArray
    fan_down: FloatArray
    core_up: FloatArray
    core_down: FloatArray
    thin_air: FloatArray
    limit: FloatArray
    valve_s: FloatArray
    core_s: FloatArray
    fall: FloatArray
    loss: FloatArray
    metal_s: FloatArray
    rise_s: FloatArray
    most: FloatArray


def as_simulated(batch: int) -> Pace:
    """The simulator's own pace."""
    one, none = np.ones(batch), np.zeros(batch)
    return Pace(one, one, one, one, none, one, none, one, one, none, one, one, UNLIMITED * one)


def together(paces: Sequence[Pace]) -> Pace:
    """Several at once: factors multiply, powers, lags and losses add up.

    One alone has a `core_s`, and one alone has metal.
    """
    found = paces[0]
    for other in paces[1:]:
        products = [a * b for a, b in zip(found, other, strict=True)]
        found = Pace(*products)._replace(
            thin_air=found.thin_air + other.thin_air,
            valve_s=found.valve_s + other.valve_s,
            loss=found.loss + other.loss,
            most=np.minimum(found.most, other.most),
        )
    return found
