"""How far apart two builds are, by where the recorded one settles."""

from types import SimpleNamespace

import numpy as np
import pytest

from narxcal.effects import Flights, Signals
from training.gap.scatter import build_scatter, levels

LEVEL = np.array([80.0, 90.0, 726.85])  # K of EGT: 1000


def problem(percent, known=(1.0, 1.0, 1.0)):
    """Outputs that are off by `percent` of their levels throughout, but for a lever move."""
    names = ("N1_pct", "N2_pct", "EGT_C")
    y = np.tile(LEVEL, (3, 60, 1))
    signals = Signals(("TRA_deg",), names, 0.25, "TRA_deg", LEVEL - 50.0, LEVEL + 50.0)
    flights = Flights(signals, np.zeros((3, 60, 1)), y, np.full(3, 60))
    kelvin = np.add(LEVEL, (0.0, 0.0, 273.15))
    gap = np.tile(kelvin * np.array(percent) / 100.0, (3, 60, 1))
    gap[:, :20] += 30.0
    weights = np.ones_like(gap) * np.array(known)
    return flights, SimpleNamespace(gap=gap, weights=weights)


@pytest.mark.parametrize(
    ("percent", "scatter"),
    [
        ([0.0, 0.0, 0.0], 0.0),
        ([0.0, -0.7, 1.5], 0.7),
        ([0.0, 0.0, 5.0], 0.0),  # a wrong sensor says nothing of the components
        ([1.0, 0.5, -0.2], 0.5),
    ],
)
def test_scatter_is_the_second_largest_shift_in_the_median(percent, scatter):
    assert 100.0 * build_scatter(*problem(percent)) == pytest.approx(scatter)


def test_what_is_not_recorded_tells_nothing():
    assert 100.0 * build_scatter(*problem([1.0, 0.5, 2.0], (1.0, 1.0, 0.0))) == pytest.approx(0.5)
    assert 100.0 * build_scatter(*problem([1.0, 0.5, 2.0], (0.0, 1.0, 0.0))) == pytest.approx(0.5)
    assert build_scatter(*problem([1.0, 0.5, 2.0], (0.0, 0.0, 0.0))) == 0.0


def test_percents_of_a_temperature_are_of_kelvin():
    y = np.array([[80.0, 26.85, -273.15], [20.0, 726.85, 0.0]])
    names = ("N1_pct", "EGT_C", "T5_C")
    found = levels(y, names)
    np.testing.assert_allclose(found, [[80.0, 300.0, 0.0], [20.0, 1000.0, 273.15]])
    np.testing.assert_array_equal(levels(y[:, :1], names[:1]), y[:, :1])
