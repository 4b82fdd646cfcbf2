"""Small misfit that any simulator has is no evidence for the effect that it resembles."""

from dataclasses import replace

import numpy as np
import pytest

from narxcal.effects import candidates, effect
from tests.training.gap.conftest import NOISE
from training.gap.allowance import ALLOWED, Allowance
from training.gap.fitting import Problem, fit
from training.gap.quadratic import misfit
from training.gap.work import Options, Work

LITTLE = {"throttle_backlash": [0.25], "sensor_lag:EGT_C": [0.06, 0.0]}
QUIET = NOISE / 30.0


@pytest.fixture(scope="module")
def asked(flights, engine, recorded):
    """Returns the work on a gap of `effects`, its allowance, and the fit of each effect by name.

    Core speed and temperature are off by a `scatter` of their levels.
    """

    def ask(effects, scatter=0.0):
        levels = np.array([0.0, 75.0, 800.0])
        real = recorded(effects, noise=QUIET) + scatter * levels
        measure = misfit(flights, real, QUIET)
        problem = Problem(flights, engine, measure)
        names = {*ALLOWED, *effects, "time_skew:N2_pct", "bleed_extraction"}
        fits = {name: fit([effect(name)], problem) for name in sorted(names)}
        work = Work(problem, Options(), measure.size(measure.gap), QUIET, measure)
        work.fits = list(fits.values())
        work.allowance = Allowance(work.fits, problem)
        return work, fits

    return ask


def test_little_misfit_is_explained_under_no_hypothesis(asked):
    work, fits = asked(LITTLE)
    floor = work.problem.misfit.floor
    assert work.allowance.held_out().sum() - floor.sum() < 0.1 * (work.before - floor).sum()
    assert work.gain(fits["throttle_backlash"]) > 0.2
    for one in fits.values():
        assert work.beyond(one).sum() / work.audible < 0.05


def test_an_effect_counts_by_what_it_takes_beyond_little_misfit(asked):
    """The play gains more than the late channel, but any simulator may have that much play."""
    work, fits = asked({"throttle_backlash": [0.25], "time_skew:N2_pct": [0.03]})
    play, late = fits["throttle_backlash"], fits["time_skew:N2_pct"]
    assert work.gain(play) > work.gain(late)
    assert work.beyond(late).sum() > 5.0 * abs(work.beyond(play).sum())
    assert work.rank(late) > work.rank(play)


@pytest.mark.parametrize("name", ["throttle_backlash", "sensor_lag:EGT_C", "spool_coupling"])
def test_more_than_little_of_an_effect_is_evidence_for_it(name, asked):
    size = {"throttle_backlash": [2.0], "sensor_lag:EGT_C": [0.8, 0.0], "spool_coupling": [1.4]}
    work, fits = asked({name: size[name]})
    assert work.beyond(fits[name]).sum() / work.audible > 0.4
    assert max(work.fits, key=work.rank) is fits[name]


@pytest.mark.parametrize(("own_s", "evidence"), [(0.5, True), (2.2, False)])
def test_a_slow_probe_is_known_less_well(own_s, evidence, asked):
    """A tenth of a second is a fifth of a fast probe's lag, and within 6 % of a slow one's."""
    work, fits = asked({"sensor_lag:EGT_C": [0.1, own_s]})
    beyond = work.beyond(fits["sensor_lag:EGT_C"]).sum() / work.audible
    assert bool(beyond > work.options.beyond) is evidence


@pytest.mark.parametrize(("outside", "evidence"), [(0.0, False), (1.0, True)])
def test_only_a_valve_inside_the_loop_is_known_by_little(outside, evidence, asked):
    """A lag of all outputs looks like nothing that a valve a little slower would do."""
    work, fits = asked({"actuator_lag": [0.02, 1.0, outside]})
    beyond = work.beyond(fits["actuator_lag"]).sum() / work.audible
    assert bool(beyond > work.options.beyond) is evidence


@pytest.mark.parametrize("name", ["accel_decel_asymmetry", "accel_limit"])
@pytest.mark.parametrize(("scatter", "evidence"), [(0.0, True), (0.003, True), (0.009, False)])
def test_limits_may_be_off_by_as_much_as_components_that_scatter_make_them(
    name, scatter, evidence, asked
):
    """By a tenth where the engine settles just where it was simulated, or a percent off."""
    size = {"accel_decel_asymmetry": [0.9, 1.0], "accel_limit": [0.9]}[name]
    work, fits = asked({name: size}, scatter)
    beyond = work.beyond(fits[name]).sum() / work.audible
    assert bool(beyond > work.options.beyond) is evidence


def test_what_gains_nothing_takes_nothing_beyond(asked):
    work, fits = asked({"throttle_backlash": [2.0]})
    assert abs(work.beyond(fits["bleed_extraction"]).sum()) < 0.02 * work.audible


def test_a_slope_that_fluttered_in_one_flight_is_no_misfit(asked):
    work, fits = asked({"time_skew:N2_pct": [0.03], "actuator_lag": [0.05, 1.0, 0.0]})
    lag = fits["actuator_lag"]
    slopes = lag.slopes.copy()
    slopes[0, 0] *= 3e3
    wild = replace(lag, slopes=slopes, theta=np.array([0.0, 1.0, 0.0]))
    others = [one for one in fits.values() if one is not lag]
    found, known = (Allowance(rows, work.problem) for rows in ([*others, wild], others))
    np.testing.assert_allclose(found.held_out(), known.held_out())


def test_without_shapes_nothing_is_allowed(flights, engine, recorded):
    measure = misfit(flights, recorded({"throttle_delay": [0.4]}), NOISE)
    problem = Problem(flights, engine, measure)
    found = fit([effect("throttle_delay")], problem)
    nothing = Allowance([found], problem)
    np.testing.assert_allclose(nothing.held_out(), measure.size(measure.gap))
    np.testing.assert_allclose(nothing.held_out(found), found.held_out, rtol=0.05)


def test_all_that_is_allowed_is_an_effect_of_the_library(flights):
    known = {one.name: one for one in candidates(flights.signals)}
    for name, little in ALLOWED.items():
        parameters = {p.name: p for p in known[name].parameters(flights.signals)}
        assert little.parameter in parameters
        assert little.low <= 0.0 < little.high or (little.limit and little.low == little.high)
