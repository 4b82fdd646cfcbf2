"""What holds for every effect of the library alike."""

from dataclasses import replace

import numpy as np

from narxcal.effects import Flights, effect, respond
from narxcal.effects.base import Run


def test_at_its_neutral_value_it_leaves_every_bit(acting, neutral, flights, engine):
    found = respond([(acting, neutral(acting))], flights, engine)
    np.testing.assert_array_equal(found[0], flights.y)


def test_at_a_size_it_is_seen_and_finite(acting, sized, flights, engine):
    found = respond([(acting, sized(acting))], flights, engine)[0]
    assert np.isfinite(found).all()
    assert np.abs(found - flights.y).max() > 0.02


def test_its_parameters_are_in_order(acting, flights):
    for p in acting.parameters(flights.signals):
        assert p.low <= p.neutral <= p.high
        assert p.all_or_nothing or all(p.low < start < p.high for start in p.starts)
        assert (p.neutral == 0.0 and not p.starts) if p.linear else p.starts
        assert p.unit


def test_what_is_called_linear_is_linear(linear, sized, flights, engine):
    lines = [p.linear for p in linear.parameters(flights.signals)]
    thetas = np.repeat(sized(linear, 0.0), 4, axis=0)
    thetas[:2, lines] = np.random.default_rng(1).normal(size=(2, sum(lines)))
    thetas[2, lines] = 0.3 * thetas[0, lines] - 2.0 * thetas[1, lines]
    *moved, without = respond([(linear, thetas)], flights, engine)
    moved = np.array(moved) - without
    # A load slows the engine, and shapes that ride on its power with it: a second-order matter.
    near = 1e-3 if linear.takes_power else 1e-9
    np.testing.assert_allclose(moved[2], 0.3 * moved[0] - 2.0 * moved[1], atol=near)


def test_a_batch_is_its_runs_one_by_one(acting, neutral, sized, flights, engine):
    thetas = np.concatenate([neutral(acting), sized(acting)])
    together = respond([(acting, thetas)], flights, engine)
    alone = [respond([(acting, row[None])], flights, engine)[0] for row in thetas]
    np.testing.assert_array_equal(together, alone)


def test_a_flight_does_not_know_the_others(acting, sized, flights, engine):
    whole = respond([(acting, sized(acting))], flights, engine)[0]
    only = Flights(flights.signals, flights.u[1:2], flights.y[1:2], flights.lengths[1:2])
    alone = respond([(acting, sized(acting))], only, engine)[0, 0]
    np.testing.assert_array_equal(alone, whole[1])


def test_what_fills_a_flight_up_changes_nothing_before(acting, sized, flights, engine):
    n, signals, lengths = 150, flights.signals, np.full(3, 150)
    u, y = flights.u.copy(), flights.y.copy()
    u[:, n:], y[:, n:] = u[:, n - 1 : n], y[:, n - 1 : n]
    setting = (acting, sized(acting))
    filled = respond([setting], Flights(signals, u, y, lengths), engine)
    cut = respond([setting], Flights(signals, u[:, :n], y[:, :n], lengths), engine)
    np.testing.assert_array_equal(filled[:, :, :n], cut)


def test_a_sensor_leaves_all_other_channels_alone(sensor, sized, flights):
    found = respond([(sensor, sized(sensor))], flights, None)[0]
    others = [j for j, name in enumerate(flights.signals.outputs) if name != sensor.channel]
    np.testing.assert_array_equal(found[..., others], flights.y[..., others])


def test_a_reading_needs_no_emulator(reading, sized, flights, engine):
    alone = respond([(reading, sized(reading))], flights, None)
    np.testing.assert_array_equal(alone, respond([(reading, sized(reading))], flights, engine))


def test_a_load_that_takes_nothing_is_a_reading_and_one_that_does_slows_the_core(
    loading, sized, flights, engine
):
    theta = sized(loading)
    free = np.array([[*theta[0, :-1], 0.0]])
    reading = respond([(loading, free)], flights, None)
    np.testing.assert_array_equal(reading, respond([(loading, free)], flights, engine))
    loaded = respond([(loading, theta)], flights, engine)
    hotter = (reading - flights.y)[0, ..., 2]
    assert hotter.max() > 1.0
    slower = (reading - loaded)[0, ..., 1]
    assert slower.max() > 0.02
    assert slower.min() > -0.1 * slower.max()
    fuel = replace(flights.signals, driver="FF_kgph")
    own, theirs = ([p.name for p in loading.parameters(s)] for s in (flights.signals, fuel))
    assert own[-1] == "loss"
    assert {*own[:-1]} <= {*theirs}  # what a control holds, wear does not shift
    np.testing.assert_array_equal(loading.load(Run(fuel, free, flights.u[:1]), flights.y[:1]), 0.0)


def test_an_effect_on_rates_leaves_rest_alone(moving, sized, flights, fly, engine):
    """Where nothing moves, nothing can move slower."""
    long = fly(np.repeat(flights.u[:, :1], 300, axis=1))
    rest = np.repeat(long.y[:, -1:], 50, axis=1)
    still = Flights(flights.signals, long.u[:, :50], rest, long.lengths)
    found = respond([(moving, sized(moving))], still, engine)[0]
    np.testing.assert_allclose(found, rest, atol=1e-6)


def test_its_name_finds_it_again(acting):
    assert effect(acting.name) == acting
