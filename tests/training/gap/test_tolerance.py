"""Limits and idles within what one build has and another not are no news."""

from dataclasses import replace

import numpy as np
import pytest

from narxcal.effects import effect
from tests.training.gap.conftest import NOISE
from training.gap.fitting import Fit, Problem, fit
from training.gap.offsets import whole_gap
from training.gap.quadratic import misfit
from training.gap.tolerance import of_the_build
from training.gap.verdict import finding
from training.gap.work import Options, Work

OTHER = np.array([0.0, 0.5, 8.0])  # shifts of another build


@pytest.fixture
def problem_of(flights, engine):
    """Returns the problem of flights of the engine as simulated, shifted by `shift`."""
    return lambda shift: Problem(flights, engine, misfit(flights, flights.y + shift, NOISE))


def fit_of(flights, *settings):
    """Parameters as if they had been found."""
    active = replace(flights.signals, inputs=(*flights.signals.inputs, "Approach"))
    active = replace(active, active=(*active.active, "Approach"))
    effects = tuple(effect(name) for name, _ in settings)
    parameters = [one.parameters(active) for one in effects]
    none, nowhere = np.zeros(5), np.zeros((0, 0, 0, 0))
    return Fit(
        effects=effects,
        parameters=tuple(p for own in parameters for p in own),
        theta=np.array([value for _, values in settings for value in values]),
        left=none,
        held_out=none,
        others=nowhere,
        response=nowhere,
        slopes=nowhere,
        sizes=tuple(len(own) for own in parameters),
    )


LIMIT = "but a limit of acceleration 15 % off may be the build's own"


@pytest.mark.parametrize(
    ("name", "theta", "said"),
    [
        ("accel_limit", [0.85, 30.0], LIMIT),
        ("accel_limit", [1.15, 30.0], LIMIT),
        ("accel_limit", [0.75, 30.0], ""),
        ("accel_limit", [1.0, 4.0], ""),  # an absolute one
        ("accel_decel_asymmetry", [1.15, 1.0], LIMIT.replace("accel", "decel")),
        ("accel_decel_asymmetry", [1.15, 0.0], ""),  # of the rotors, not of the control
        ("accel_decel_asymmetry", [1.3, 1.0], ""),
        (
            "idle_schedule",
            [0.3, 1.6, -0.7, 10.0],
            "but an approach idle 0.7 % off may be the build's own",
        ),
        ("idle_schedule", [0.3, 1.6, 1.2, 10.0], ""),
        ("spool_lag", [1.05], ""),
    ],
)
def test_what_a_build_may_have_is_said(name, theta, said, flights, problem_of):
    tried = fit_of(flights, (name, theta))
    assert of_the_build(tried, (), problem_of(OTHER)) == said


def test_in_the_simulators_own_build_all_of_it_is_news(flights, problem_of):
    tried = fit_of(flights, ("accel_limit", [0.85, 30.0]))
    assert of_the_build(tried, (), problem_of(0.02 * OTHER)) == ""
    one_sensor = np.array([0.0, 0.0, 8.0])
    assert of_the_build(tried, (), problem_of(one_sensor)) == ""


def test_rotors_of_an_engine_without_a_control_have_no_limit_of_it(flights, problem_of):
    """Where fuel is the driver nothing says which of two mechanisms it is."""
    one, problem = fit_of(flights, ("accel_decel_asymmetry", [1.1, 1.0])), problem_of(OTHER)
    fuel = replace(one, parameters=one.parameters[:1], theta=one.theta[:1], sizes=(1,))
    assert of_the_build(one, (), problem)
    assert of_the_build(fuel, (), problem) == ""


def test_beside_another_effect_it_is_asked_of_what_is_more(flights, problem_of):
    """What leads is judged by itself, and two that were found together are no limit's doing."""
    lag, limit = ("sensor_lag:EGT_C", [1.0, 0.5]), ("accel_limit", [0.85, 30.0])
    pair, problem = fit_of(flights, lag, limit), problem_of(OTHER)
    assert of_the_build(pair, (effect("sensor_lag:EGT_C"),), problem) == LIMIT
    assert of_the_build(pair, (effect("accel_limit"),), problem) == ""
    assert of_the_build(pair, (), problem) == ""


@pytest.mark.parametrize(("shift", "kind"), [(OTHER, "unknown"), (0.0 * OTHER, "effects")])
def test_a_limit_that_leads_is_claimed_in_one_build_alone(shift, kind, flights, engine, recorded):
    real = recorded({"accel_limit": [0.85]}) + shift
    measure = misfit(flights, real, NOISE)
    problem, before = Problem(flights, engine, measure), measure.size(measure.gap)
    work = Work(problem, Options(), before, NOISE, whole_gap(flights, (real, NOISE)))
    work.fits = [fit([effect("accel_limit")], problem)]
    found = finding(work, work.fits[0], None, NOISE)
    assert found.kind == kind
    assert found.effects == (("accel_limit",) if kind == "effects" else ())
    assert found.reason.endswith(LIMIT) is (kind == "unknown")
    assert found.tried[0].effects == ("accel_limit",)
