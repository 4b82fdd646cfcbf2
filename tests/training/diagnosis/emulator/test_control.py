"""Heavier rotors show which speed an engine's control holds, and what it holds on the way."""

from dataclasses import replace

import numpy as np
import pytest

from narxcal.effects import effect
from narxcal.effects.running import respond
from narxcal.two_spool import DAMP, DOWN, GAIN, HOLDS_FUEL, HOLDS_RATE, UP
from tests.training.diagnosis.emulator.conftest import NOISE
from training.diagnosis.emulator import choose_control, fit_emulators
from training.diagnosis.metric import Record
from training.diagnosis.two_spool_fit import GOVERNED_CORE, GOVERNED_FAN


@pytest.fixture(scope="module")
def kinds(engine):
    """The same rotors under a control of the fan, and under one of the core."""
    core = replace(engine, engine=replace(engine.engine, governed=GOVERNED_CORE))
    return engine, core


def flown(kind, flights, effects):
    settings = [(effect(name), np.array([theta])) for name, theta in effects.items()]
    y = respond(settings, flights, kind)[0]
    return recorded(flights, y + NOISE * np.random.default_rng(1).standard_normal(y.shape))


def recorded(flights, y):
    unit = np.repeat(np.arange(len(y))[:, None], y.shape[1], axis=1)
    return Record(flights, y, NOISE, unit, tuple(range(len(y))))


@pytest.mark.parametrize("true", [GOVERNED_FAN, GOVERNED_CORE])
@pytest.mark.parametrize("first", [GOVERNED_FAN, GOVERNED_CORE])
def test_a_heavier_fan_tells_the_control(true, first, kinds, flights):
    offered = (kinds[first], kinds[1 - first])
    measured = flown(kinds[true], flights, {"spool_coupling": [1.6]})
    assert choose_control(offered, measured) is kinds[true]


@pytest.mark.parametrize("true", [GOVERNED_FAN, GOVERNED_CORE])
@pytest.mark.parametrize("effects", [{"spool_lag": [1.5]}, {"spool_coupling": [1.5]}])
def test_a_heavier_core_tells_a_control_of_acceleration(true, effects, kinds, flights):
    """A heavier fan alone does not: either control answers it alike, and the first stays."""
    plain = kinds[true]
    holding = replace(plain, engine=replace(plain.engine, governed=true + HOLDS_RATE))
    measured = flown(holding, flights, effects)
    heavy_core = "spool_lag" in effects
    assert choose_control((plain, holding), measured) is (holding if heavy_core else plain)
    measured = flown(plain, flights, effects)
    assert choose_control((plain, holding), measured) is plain


def test_what_overshoots_tells_a_reset_that_holds_fuel(kinds, flights):
    """Under a slow governor, whose reset has time to run ahead."""
    theta = kinds[0].engine.theta.copy()
    theta[GAIN], theta[DAMP], theta[UP], theta[DOWN] = np.log(0.7), 0.2, np.log(9), np.log(10)
    plain = replace(kinds[0], engine=replace(kinds[0].engine, theta=theta))
    holding = replace(plain, engine=replace(plain.engine, governed=HOLDS_FUEL))
    lazy = replace(flights, y=plain.free_run(flights))
    for true in (plain, holding):
        assert choose_control((plain, holding), flown(true, lazy, {"spool_lag": [1.5]})) is true


def test_as_simulated_no_kind_of_control_differs(kinds, flights):
    plain = kinds[0]
    for what in (HOLDS_RATE, HOLDS_FUEL):
        holding = replace(plain, engine=replace(plain.engine, governed=what))
        assert np.array_equal(holding.free_run(flights), plain.free_run(flights))


def test_a_slower_engine_overshoots_if_its_reset_holds_fuel(kinds, flights):
    """It gets the fuel of one that is already as fast as the simulator is."""
    plain = kinds[0]
    holding = replace(plain, engine=replace(plain.engine, governed=HOLDS_FUEL))
    slower = [(effect("spool_lag"), np.array([[1.5]]))]
    most = [respond(slower, flights, kind)[0][..., 1].max(axis=1) for kind in (plain, holding)]
    over = [float(np.mean(each - flights.y[..., 1].max(axis=1))) for each in most]
    assert over[1] > over[0] + 0.5


def test_what_says_nothing_of_the_control_leaves_the_better_emulator(kinds, flights):
    measured = flown(kinds[0], flights, {"sensor_lag:EGT_C": [1.0, 0.5]})
    for offered in (kinds, kinds[::-1]):
        assert choose_control(offered, measured) is offered[0]


def test_one_emulator_is_chosen(kinds, flights):
    assert choose_control(kinds[:1], recorded(flights, flights.y)) is kinds[0]


def test_where_fuel_is_the_driver_there_is_one_kind(flights):
    inputs = ("FF_kgph", *flights.signals.inputs[1:])
    driven = replace(flights.signals, inputs=inputs, driver="FF_kgph")
    assert len(fit_emulators(replace(flights, signals=driven))) == 1


def test_every_control_of_a_lever_is_offered_with_either_schedule(flights):
    found = [each.engine.governed for each in fit_emulators(flights)]
    plain = [kind for kind in found if kind < HOLDS_RATE]
    assert plain[0] == GOVERNED_FAN
    assert found == [kind + what for what in (0, HOLDS_RATE, HOLDS_FUEL) for kind in plain]
