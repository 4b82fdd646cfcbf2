"""What the tests of the virtual engine share: logs at rest, and gas paths at random points."""

from typing import NamedTuple

import numpy as np
import pytest

from narxcal.atmosphere import isa
from narxcal.turbofan.cycle import Stations
from narxcal.turbofan.engine import INPUT_NAMES, VirtualEngine, _core
from narxcal.turbofan.solve import (
    BLEED,
    CONDITIONS,
    MACH,
    N1,
    OFFTAKE_W,
    STATIC_K,
    STATIC_PA,
    steady_points,
)

PRESET_NAMES = ("business_jet", "single_aisle")


class Point(NamedTuple):
    """A flight condition and what is asked of the engine there."""

    altitude_ft: float = 0.0
    mach: float = 0.0
    dT_C: float = 0.0
    n1: float = 1.0
    bleed: float = 0.0
    offtake_W: float = 0.0

    def condition(self):
        row = np.zeros(CONDITIONS)
        temperature, pressure = isa(self.altitude_ft)
        row[STATIC_K], row[STATIC_PA] = temperature + self.dT_C, pressure
        row[MACH], row[N1] = self.mach, self.n1
        row[BLEED], row[OFFTAKE_W] = self.bleed, self.offtake_W
        return row


class Bench:
    """An engine of a preset without its control."""

    point = Point

    def __init__(self, name):
        self.name = name
        self.engine = VirtualEngine(name)
        self.core = _core(name)
        self.machine, self.line, self.body = self.core.machine, self.core.line, self.core.body

    def rest(self, point, machine=None):
        return self.settled(point.condition(), machine)

    def settled(self, condition, machine=None):
        unknowns, rows, good = steady_points(
            machine or self.machine, self.line, condition[np.newaxis]
        )
        assert good.all(), condition
        return unknowns[0], Stations(*rows[0])


@pytest.fixture(scope="session", params=PRESET_NAMES)
def bench(request):
    return Bench(request.param)


@pytest.fixture(scope="session")
def log():
    """Builds inputs of `samples`, zero but for those named."""

    def built(samples, **values):
        return {
            name: np.broadcast_to(np.asarray(values.get(name, 0.0), float), (samples,)).copy()
            for name in INPUT_NAMES
        }

    return built
