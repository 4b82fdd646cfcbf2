"""How far build scatter shifts an output, and that an offset has to go beyond it."""

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from narxcal.effects import Signals, effect
from training.gap.offsets import beyond_scatter, plainest

OUTPUTS = ("N1_pct", "N2_pct", "EGT_C")


@dataclass(frozen=True, eq=False)
class Offset:
    """What is asked of the fit of one offset."""

    effects: Any
    theta: Any
    response: Any
    held_out: Any

    @property
    def name(self):
        return self.effects[0].name


def offset(shift, driver, name="deterioration"):
    """A fit that explains all of the gap by `shift` (outputs,) in percent of the level."""
    level = np.full((4, 50, 3), [80.0, 90.0, 726.85])  # K of EGT: 1000
    kelvin = level + np.array([0.0, 0.0, 273.15])
    signals = Signals(("ALT_ft",), OUTPUTS, 0.25, driver, level[0, 0] - 50.0, level[0, 0] + 50.0)
    u, lengths = np.zeros((4, 50, 1)), np.full(4, 50)
    flights = SimpleNamespace(signals=signals, y=level, u=u, lengths=lengths)
    tried = SimpleNamespace(
        effects=(effect(name),), response=kelvin * np.array(shift) / 100.0, held_out=np.zeros(4)
    )
    return tried, flights


def left(shift=(0.0, 0.1, 1.0)):
    """A gap of `shift` (outputs,) throughout, of Q 10 in each flight, 1 of them noise.

    Unless said otherwise two outputs are off by a thousandth, as of two builds.
    """
    gap = np.full((4, 50, len(shift)), shift)
    return SimpleNamespace(
        gap=gap,
        weights=np.ones_like(gap),
        floor=np.full(4, 1.0),
        size=lambda _: np.full(4, 10.0),
    )


@pytest.mark.parametrize(
    ("shift", "driver", "beyond"),
    [
        ([0.0, 1.3, 0.0], "TRA_deg", True),
        ([0.0, 1.1, 0.0], "TRA_deg", False),
        ([1.9, 0.0, 0.0], "FF_kgph", False),  # the same fuel turns another fan at another speed
        ([2.1, 0.0, 0.0], "FF_kgph", True),
        ([0.0, 1.3, 0.0], "FF_kgph", True),
        ([0.0, 0.0, 2.3], "FF_kgph", False),
        ([0.0, 0.0, 2.5], "FF_kgph", True),
    ],
)
def test_wear_is_more_than_build_scatter_makes_it(shift, driver, beyond):
    tried, flights = offset(shift, driver)
    found = beyond_scatter(tried, left(), flights)
    assert bool(found) is beyond


@pytest.mark.parametrize(
    ("percent", "rest", "beyond"),
    [(1.6, 1.2, True), (1.5, 1.2, False), (1.6, 1.6, False), (2.5, 1.6, True)],
)
def test_one_temperature_that_is_all_of_the_gap_may_be_off_by_less(percent, rest, beyond):
    """Of nine parts beyond noise it explains 0.98 or 0.93."""
    tried, flights = offset([0.0, 0.0, percent], "TRA_deg", "sensor_bias:EGT_C")
    tried.held_out = np.full(4, rest)
    assert bool(beyond_scatter(tried, left(), flights)) is beyond


@pytest.mark.parametrize(("points", "beyond"), [(0.5, False), (0.7, True)])
def test_a_slow_fan_at_idle_makes_no_offset_large(points, beyond):
    """Half of the time at 20 %: 0.5 is 2 % of most speeds, but 0.9 % of all that was flown."""
    tried, flights = offset([0.0, 0.0, 0.0], "TRA_deg", "sensor_bias:N1_pct")
    flights.y[:, :25, 0] = 20.0
    tried.response[..., 0] = points
    tried.held_out = np.full(4, 2.0)
    assert bool(beyond_scatter(tried, left(), flights)) is beyond


@pytest.mark.parametrize(
    ("percent", "others", "beyond"),
    [(0.7, 0.01, True), (0.5, 0.01, False), (0.7, 0.03, False)],
)
def test_where_nothing_else_is_off_at_all_a_sensor_may_be_off_by_less(percent, others, beyond):
    """Both are one build where no second output is off by a fifth of a thousandth."""
    tried, flights = offset([0.0, 0.0, percent], "TRA_deg", "sensor_bias:EGT_C")
    tried.held_out = np.full(4, 1.8)
    gap = left((80.0 * others / 100.0, 0.0, 10.0 * percent))
    assert bool(beyond_scatter(tried, gap, flights)) is beyond


def test_an_offset_that_explains_less_of_it_has_to_be_larger():
    tried, flights = offset([0.0, 1.3, 0.0], "TRA_deg")
    tried.held_out = np.full(4, 4.0)
    assert not beyond_scatter(tried, left(), flights)
    tried, flights = offset([0.0, 1.9, 0.0], "TRA_deg")
    tried.held_out = np.full(4, 4.0)
    assert beyond_scatter(tried, left(), flights)


@pytest.mark.parametrize(
    ("percent", "fan", "beyond"),
    [(0.8, 1.0, True), (0.8, -1.0, False), (1.1, -1.0, False), (1.3, -1.0, True)],
)
def test_a_lever_that_one_output_contradicts_is_as_far_off_as_scatter_shifts_any(
    percent, fan, beyond
):
    """The core is as far off as the lever says, of the fan `fan` times that."""
    tried, flights = offset([percent, percent, 0.0], "TRA_deg", "throttle_bias")
    shift = tried.response[0, 0] * np.array([fan, 1.0, 0.0])
    assert beyond_scatter(tried, left(shift), flights) is beyond


def wear_and_bias(shift, share, growth=0.0):
    """Wear of `shift` (outputs,) in percent, and the bias of EGT that takes `share` of the gap.

    The shift of EGT falls by `growth` of itself from idle to full power.
    """
    wear, flights = offset(shift, "TRA_deg")
    speed = np.linspace(50.0, 100.0, 4)[:, None]  # each flight at one
    flights.y[..., 0] = speed
    wear.response[..., 2] *= 1.0 - growth * (speed - 75.0) / 50.0
    bias, _ = offset([0.0, 0.0, shift[2]], "TRA_deg", "sensor_bias:EGT_C")
    fits = [
        Offset(wear.effects, np.zeros(6), wear.response, np.full(4, 1.0)),
        Offset(bias.effects, np.zeros(1), bias.response, np.full(4, 10.0 - 9.0 * share)),
    ]
    return fits, flights


@pytest.mark.parametrize(("growth", "first"), [(0.2, 1), (-0.2, 0)])
def test_a_shift_that_falls_with_power_is_no_wear(growth, first):
    """Beside a core that is off by what scatter may be, more than half as much."""
    fits, flights = wear_and_bias([0.0, 0.9, 3.0], 0.8, growth)
    assert plainest(fits, flights, left())[0] is fits[first]


@pytest.mark.parametrize(("fuel", "first"), [(0.0, 1), (-4.0, 1), (1.5, 1), (4.0, 0)])
def test_what_needs_more_fuel_as_well_may_be_worn(fuel, first):
    """The temperature is 3 % up: a wrong probe, unless the fuel flow is up with it."""
    fits, flights = wear_and_bias([0.0, 0.2, 3.0], 0.8, 0.2)
    flow = np.full((4, 50, 1), 2000.0)
    names = (*OUTPUTS, "FF_kgph")
    low, high = (np.append(edge, 2000.0) for edge in (flights.signals.low, flights.signals.high))
    signals = Signals(("ALT_ft",), names, 0.25, "TRA_deg", low, high)
    own = SimpleNamespace(**vars(flights))
    own.signals, own.y = signals, np.concatenate([flights.y, flow], axis=-1)
    shifts = (fuel / 100.0 * flow, 0.0 * flow)
    wider = [
        replace(one, response=np.concatenate([one.response, shift], axis=-1))
        for one, shift in zip(fits, shifts, strict=True)
    ]
    gap = left((0.0, 0.2, 30.0, 20.0 * fuel))
    assert plainest(wider, own, gap)[0] is wider[first]
