"""What an effect explains where it acts is not lessened by what is wrong elsewhere."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from narxcal.effects import effect
from narxcal.effects.running import respond
from tests.training.gap.conftest import NOISE
from training.gap.fitting import Problem, fit
from training.gap.offsets import whole_gap
from training.gap.quadratic import misfit
from training.gap.work import Options, Work


def test_other_misfit_elsewhere_says_nothing_of_an_effect(flights, engine, recorded):
    real = recorded({"sensor_lag:N2_pct": [0.3, 0.5]})
    time = np.arange(real.shape[1])
    real[..., 2] += 8.0 * np.sin(time / 30.0)  # on another channel, and of no effect
    measure = misfit(flights, real, NOISE)
    problem = Problem(flights, engine, measure)
    tight = whole_gap(flights, (real, NOISE))
    work = Work(problem, Options(), measure.size(measure.gap), NOISE, tight)
    found = fit([effect("sensor_lag:N2_pct")], problem)
    assert work.left(found) > 0.4
    assert work.aligned(found) > 0.95
    assert work.aligned(fit([effect("sensor_lag:EGT_C")], problem)) < 0.5


def test_what_does_next_to_nothing_ranks_last(flights, engine, recorded):
    """Nearly no response, where there is nearly no gap, leads nobody."""
    measure = misfit(flights, recorded({"sensor_lag:EGT_C": [1.2, 0.5]}), NOISE)
    problem = Problem(flights, engine, measure)
    work = Work(problem, Options(), measure.size(measure.gap), NOISE, measure)
    right, other = (fit([effect(n)], problem) for n in ("sensor_lag:EGT_C", "time_skew:N2_pct"))
    for one in (right, other):
        assert 0.0 <= work.aligned(one) <= 1.0
    assert work.rank(right) > 0.9
    assert work.rank(other) < 0.1


@pytest.mark.parametrize(("tau_s", "told"), [(0.3, True), (0.02, True), (0.01, False)])
def test_a_small_gap_that_an_effect_explains_wherever_it_acts_tells(
    tau_s, told, flights, engine, recorded
):
    """Not a lag of a hundredth of a second, nor what a larger one is mistaken for."""
    quiet = NOISE / 100.0
    measure = misfit(flights, recorded({"sensor_lag:EGT_C": [tau_s, 0.5]}, noise=quiet), quiet)
    problem = Problem(flights, engine, measure)
    work = Work(problem, Options(), measure.size(measure.gap), quiet, measure)
    right, other = (fit([effect(n)], problem) for n in ("sensor_lag:EGT_C", "heat_soak"))
    assert work.aligned(right) > 0.95
    assert work.tells(right) is told
    assert not work.tells(other)


@pytest.mark.parametrize(
    ("name", "truth"),
    [("heat_soak", [12.0, 0.0, 0.0, -0.6, 0.0]), ("sensor_lag:EGT_C", [4.5, 0.5])],
)
def test_thin_metal_and_a_slow_probe_are_told_apart(name, truth, flights, engine, recorded):
    """Both are a pole behind a zero; which has which is where the range of either ends."""
    measure = misfit(flights, recorded({name: truth}), NOISE)
    problem = Problem(flights, engine, measure)
    work = Work(problem, Options(), measure.size(measure.gap), NOISE, measure)
    fits = {n: fit([effect(n)], problem) for n in ("heat_soak", "sensor_lag:EGT_C")}
    assert max(fits, key=lambda one: work.rank(fits[one])) == name
    assert fits[name].theta[0] == pytest.approx(truth[0], rel=0.1)


def test_a_time_constant_on_its_bound_counts_less(flights, engine, recorded):
    """Metal twice as slow as any probe, for which only a probe is offered."""
    measure = misfit(flights, recorded({"sensor_lag:EGT_C": [12.0, 0.5]}), NOISE)
    problem = Problem(flights, engine, measure)
    work = Work(problem, Options(), measure.size(measure.gap), NOISE, measure)
    found = fit([effect("sensor_lag:EGT_C")], problem)
    assert found.theta[0] == found.parameters[0].high
    assert found.at_end
    assert work.rank(found) == pytest.approx(0.8 * work.worth(found) * work.aligned(found))
    assert not fit([effect("sensor_lag:N2_pct")], problem).at_end


def test_where_a_delay_and_a_valve_outside_the_loop_say_the_same_it_is_the_delay(
    flights, engine, recorded
):
    measure = misfit(flights, recorded({"throttle_delay": [0.03]}), NOISE)
    problem = Problem(flights, engine, measure)
    work = Work(problem, Options(), measure.size(measure.gap), NOISE, measure)
    delay = fit([effect("throttle_delay")], problem)
    tau_s = delay.theta[0]
    valve = fit([effect("actuator_lag")], problem, np.array([tau_s, 1.0, 1.0]))
    assert valve.loopless
    assert not delay.loopless
    assert work.gain(valve) == pytest.approx(work.gain(delay), abs=0.02)
    assert work.rank(delay) > work.rank(valve)
    inside = fit([effect("actuator_lag")], problem, np.array([tau_s, 1.0, 0.0]))
    assert not inside.loopless


@pytest.mark.parametrize(
    ("switched", "much", "told"),
    [(3, 1.0, True), (2, 1.0, True), (2, 0.01, False), (1, 1.0, False), (5, 1.0, True)],
)
def test_flights_in_which_no_switch_moves_say_nothing_of_what_it_does(
    switched, much, told, flights, engine
):
    """It holds in those in which one does, if these are three, or two of which it takes most."""
    u = flights.u.copy()
    u[switched:, :, 4] = 0.0
    own = replace(flights, u=u)
    named, shift = effect("bleed_extraction"), much * np.array([[0.0, -0.3, 9.0]])
    real = respond([(named, shift)], own, engine)[0]
    real = real + NOISE * np.random.default_rng(4).standard_normal(real.shape)
    measure = misfit(own, real, NOISE)
    problem = Problem(own, engine, measure)
    work = Work(problem, Options(), measure.size(measure.gap), NOISE, measure)
    found = fit([named], problem)
    np.testing.assert_array_equal(work.witnesses(found), np.arange(5) < switched)
    assert work.holds(work.before - found.held_out, found) is told
    beside = fit([effect("sensor_lag:EGT_C"), named], problem)
    assert work.witnesses(beside).all()
    lag = fit([effect("sensor_lag:EGT_C")], problem)
    np.testing.assert_array_equal(work.witnesses(beside, lag), np.arange(5) < switched)


@pytest.mark.parametrize(
    ("name", "aligned", "out"),
    [
        ("throttle_delay", 0.5, True),
        ("throttle_delay", 0.3, False),
        ("throttle_backlash", 0.5, False),
        ("throttle_backlash", 0.75, True),
        ("heat_soak", 0.5, False),
    ],
)
def test_what_follows_anything_slow_or_small_has_to_explain_more_where_it_acts(name, aligned, out):
    """A dead band of the lever is half explained by a play."""
    work = SimpleNamespace(
        beyond=lambda _: np.full(4, 0.05),
        aligned=lambda _: aligned,
        audible=1.0,
        options=Options(),
        holds=lambda _taken, _tried: True,
    )
    assert Work.stands_out(work, SimpleNamespace(effects=(effect(name),))) is out
