"""A record made from the simulator itself settles as simulated, and small effects count."""

from dataclasses import replace

import numpy as np
import pytest

from narxcal.effects import Flights, Signals, effect
from narxcal.effects.running import respond
from tests.training.gap.conftest import DT, INPUTS, NOISE, OUTPUTS, engine_of, simulate
from training.gap.diagnosis import Simulators, diagnose
from training.gap.quadratic import misfit
from training.gap.same_engine import needs_no_shift, settles_alike

HOLD = round(60.0 / DT)


def flights_at(*levels):
    """Three flights that hold lever angles for a minute each, with slams between them."""
    random = np.random.default_rng(5)
    u = np.zeros((3, HOLD * len(levels), len(INPUTS)))
    for f in range(3):
        u[f, :, 0] = np.repeat(random.permutation(levels), HOLD)
    u[..., 1], u[..., 2] = np.array([1000.0, 9000.0, 20000.0])[:, None], 0.4
    y = simulate(u)
    limits = (y.min(axis=(0, 1)), y.max(axis=(0, 1)))
    signals = Signals(INPUTS, OUTPUTS, DT, "TRA_deg", *limits, (2.0, 80.0), ("TRA_deg", "ALT_ft"))
    return Flights(signals, u, y, np.full(3, u.shape[1]))


@pytest.fixture(scope="module")
def flights():
    return flights_at(5.0, 30.0, 55.0, 80.0, 20.0, 65.0, 5.0, 80.0)


def noisy(y, seed=2):
    return y + NOISE * np.random.default_rng(seed).standard_normal(y.shape)


def build(flights, y):
    """The same of another build: N2 and EGT settle elsewhere, more so at some powers."""
    power = flights.signals.power(flights.y)[..., None]
    return y + np.array([0.0, 0.3, 4.0]) * (1.0 - 2.0 * power**2)


def asked(flights, real, response=None):
    measure = misfit(flights, real, NOISE)
    return settles_alike(
        flights, measure, np.zeros_like(flights.y) if response is None else response, NOISE
    )


def shifted(flights, real, response=None):
    measure = misfit(flights, real, NOISE)
    return not needs_no_shift(
        flights, measure, np.zeros_like(flights.y) if response is None else response
    )


def both(flights, real):
    """What the two say of an engine at rest; of one that never rests the second alone knows."""
    assert asked(flights, real) is not shifted(flights, real)
    return asked(flights, real)


def test_noise_alone_is_the_same_engine(flights):
    assert both(flights, noisy(flights.y))


@pytest.mark.parametrize("shift", [(0.04, 0.04, 0.0), (0.0, 0.04, 0.5)])
def test_where_two_outputs_settle_a_twentieth_of_a_percent_off_it_is_another(shift, flights):
    assert not asked(flights, noisy(flights.y + np.array(shift)))


@pytest.mark.parametrize("shift", [(0.15, 0.15, 0.0), (0.0, 0.15, 2.0)])
def test_offsets_of_two_outputs_by_a_fifth_of_a_percent_are_another_build(shift, flights):
    assert not both(flights, noisy(flights.y + np.array(shift)))


@pytest.mark.parametrize(("channel", "shift"), [(0, 0.4), (1, 0.4), (2, 5.0)])
def test_one_sensor_that_is_off_or_drifts_says_nothing_of_the_engine(channel, shift, flights):
    off, drift = np.zeros(3), np.zeros((flights.y.shape[1], 3))
    off[channel] = shift
    drift[:, channel] = shift * np.linspace(0.0, 1.0, len(drift))
    assert both(flights, noisy(flights.y + off))
    assert both(flights, noisy(flights.y + drift))


@pytest.mark.parametrize("channel", [1, 2])
def test_at_rest_one_output_may_be_off_as_it_will(channel, flights):
    """Builds shift the others too; where nothing rests it is not told from a build."""
    off = np.zeros(3)
    off[channel] = 1.0
    real = noisy(np.where(off, build(flights, flights.y), flights.y))
    assert asked(flights, real)
    assert shifted(flights, real)


def test_of_two_outputs_neither_may_be_off(flights):
    low, high = flights.signals.low[:2], flights.signals.high[:2]
    two = replace(flights.signals, outputs=OUTPUTS[:2], low=low, high=high)
    own = replace(flights, signals=two, y=flights.y[..., :2])
    real = noisy(flights.y)[..., :2]
    nothing = np.zeros_like(own.y)
    assert settles_alike(own, misfit(own, real, NOISE[:2]), nothing, NOISE[:2])
    real[..., 1] += 0.5
    assert not settles_alike(own, misfit(own, real, NOISE[:2]), nothing, NOISE[:2])


def test_an_effect_on_how_it_moves_leaves_it_the_same(flights):
    slower = respond([(effect("spool_lag"), np.array([[1.3]]))], flights, engine_of())[0]
    assert asked(flights, noisy(slower))
    assert not shifted(flights, noisy(slower), slower - flights.y)


def test_an_effect_on_where_it_settles_does_once_that_is_taken_out(flights):
    bleed = np.where(flights.u[..., :1] > 15.0, [0.0, 0.2, 8.0], 0.0)
    real = noisy(flights.y + bleed)
    assert not asked(flights, real)
    assert asked(flights, real, bleed)


@pytest.mark.parametrize(("above", "same"), [(40.0, True), (75.0, True), (15.0, False)])
def test_an_effect_may_be_on_two_thirds_of_the_time(above, same, flights):
    bleed = np.where(flights.u[..., :1] > above, [0.0, 0.2, 8.0], 0.0)
    assert asked(flights, noisy(flights.y + bleed)) is same


def test_beside_an_offset_nothing_else_is_off(flights):
    measure = misfit(flights, noisy(flights.y + np.array([0.0, 0.5, 0.0])), NOISE)
    nothing = np.zeros_like(flights.y)
    offset = np.broadcast_to([0.0, 0.5, 0.0], nothing.shape)
    assert not settles_alike(flights, measure, nothing, NOISE, beside=True)
    assert settles_alike(flights, measure, offset, NOISE, beside=True)


def test_at_one_power_or_never_at_rest_nobody_knows(flights):
    one = flights_at(30.0, 30.0, 31.0, 30.0)
    wide = replace(one.signals, low=flights.signals.low, high=flights.signals.high)
    assert not asked(replace(one, signals=wide), noisy(one.y))
    restless = replace(flights, y=flights.y + 2.0 * np.sin(np.arange(flights.y.shape[1]))[:, None])
    assert not asked(restless, noisy(restless.y))
    assert not shifted(restless, noisy(restless.y))
    assert shifted(restless, noisy(build(flights, restless.y)))


def test_what_is_unknown_or_behind_the_end_tells_nothing(flights):
    real, half = noisy(flights.y), flights.y.shape[1] // 2
    real[:, :100, 1] = np.nan
    real[:, half // 2 :] += 5.0
    short = replace(flights, lengths=np.full(3, half // 2))
    assert not asked(flights, real)
    assert shifted(flights, real)
    assert both(short, real)


@pytest.mark.parametrize(("other", "said"), [(False, ("spool_lag",)), (True, ())])
def test_a_small_effect_is_claimed_of_the_same_engine_alone(other, said, flights):
    """0.1 % of every range: of any other simulator nobody would have to explain it."""
    engine = engine_of()
    slower = respond([(effect("spool_lag"), np.array([[1.03]]))], flights, engine)[0]
    real = noisy(build(flights, slower) if other else slower)
    found = diagnose(flights, (real, NOISE), Simulators(engine))
    assert found.effects == said
    assert said or found.kind == "none"


@pytest.mark.slow
def test_without_an_effect_the_same_engine_has_none(flights):
    for seed in range(3):
        measured = noisy(flights.y, seed), NOISE
        assert diagnose(flights, measured, Simulators(engine_of())).kind == "none"


@pytest.mark.parametrize(("other", "said"), [(False, ("sensor_bias:N1_pct",)), (True, ())])
def test_a_small_bias_is_claimed_where_all_else_settles_as_simulated(other, said, flights):
    """0.15 % of a speed, which any build may have."""
    biased = flights.y + np.array([0.08, 0.0, 0.0])
    real = noisy(build(flights, biased) if other else biased)
    assert diagnose(flights, (real, NOISE), Simulators(engine_of())).effects == said
