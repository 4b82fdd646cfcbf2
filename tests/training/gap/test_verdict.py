"""What is said of a claim: its rivals, none where nothing is named, and none that is made up."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from narxcal.effects import effect
from tests.training.gap.conftest import NOISE
from training.gap.diagnosis import made_up
from training.gap.fitting import Problem, fit
from training.gap.offsets import offset_fits, unexplained, whole_gap
from training.gap.quadratic import misfit
from training.gap.verdict import bearable, finding
from training.gap.work import Options, Work

LOOSE = Options(close=100.0)  # nearly anything is a rival
# As much as nothing explains, of a gap of more than all of every range.
UNBEARABLE = Options(
    close=100.0, unexplained=-1.0, telling=(2.0, 1.0), apart=(2.0, 1.0), distinct=2.0, quiet=2.0
)


def work_on(real, flights, engine, options):
    measured = misfit(flights, real, NOISE)
    problem = Problem(flights, engine, measured)
    tight = whole_gap(flights, (real, NOISE))
    return Work(problem, options, measured.size(measured.gap), NOISE, tight)


def told(left, aligned, *, same_engine):
    """A work whose shares are given: of the gap that is left, and explained where it acts."""
    return SimpleNamespace(
        options=Options(),
        same_engine=same_engine,
        left=lambda _: left,
        aligned=lambda _: aligned,
        tells=lambda _: True,
    )


@pytest.mark.parametrize(
    ("name", "shares", "borne"),
    [
        ("throttle_backlash", (0.15, 0.6), True),
        ("throttle_backlash", (0.35, 0.6), False),  # what a dead band leaves
        ("throttle_backlash", (0.60, 0.8), True),  # of a gap that is hardly heard
        ("sensor_lag:EGT_C", (0.35, 0.6), True),
        ("sensor_lag:EGT_C", (0.45, 0.6), False),
        ("spool_lag", (0.50, 0.6), True),
        ("spool_lag", (0.60, 0.6), False),
    ],
)
def test_of_the_same_engine_nothing_excuses_what_is_left(name, shares, borne):
    claimed = SimpleNamespace(effects=(effect(name),))
    assert bearable(told(*shares, same_engine=True), claimed) is borne
    assert bearable(told(*shares, same_engine=False), claimed)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (LOOSE, ("ambiguous", ("sensor_lag:N2_pct",), ("time_skew:N2_pct",))),
        (UNBEARABLE, ("none", (), ())),
    ],
)
def test_where_nothing_is_named_nothing_is_a_rival(options, said, flights, engine, recorded):
    effects = {"sensor_lag:N2_pct": [0.6, 0.5], "sensor_lag:EGT_C": [0.1, 0.5]}
    work = work_on(recorded(effects), flights, engine, options)
    lag, skew = (
        fit([effect(name)], work.problem) for name in ("sensor_lag:N2_pct", "time_skew:N2_pct")
    )
    work.fits = [lag, skew]
    found = finding(work, lag, None, NOISE)
    assert (found.kind, found.effects, found.ambiguous_with) == said, found.reason


def test_a_claim_tells_what_each_flight_would_be_given_by_the_others(flights, engine, recorded):
    work = work_on(recorded({"sensor_lag:N2_pct": [0.6, 0.5]}), flights, engine, LOOSE)
    work.fits = [lag] = [fit([effect("sensor_lag:N2_pct")], work.problem)]
    found = finding(work, lag, None, NOISE).by_others
    measured = work.problem.misfit
    for f in range(len(lag.others)):
        step = np.tensordot(lag.others[f] - lag.theta, lag.slopes[:, f], axes=1)
        np.testing.assert_allclose(found[f], step, rtol=1e-12)
    left = measured.size(measured.gap - lag.response - found)
    np.testing.assert_allclose(left, lag.held_out, rtol=1e-6)
    work.options = UNBEARABLE
    assert finding(work, lag, None, NOISE).by_others is None


@pytest.mark.parametrize(("play", "needless"), [(0.0, True), (3.0, False)])
def test_what_only_follows_a_lever_that_is_read_wrong_is_made_up(
    play, needless, flights, engine, recorded
):
    beside = {"throttle_backlash": [play]} if play else {}
    work = work_on(recorded({"throttle_bias": [4.0], **beside}), flights, engine, Options())
    claimed = fit([effect("throttle_backlash")], work.problem)
    left = unexplained(work.tight, claimed.response)
    fits = offset_fits(work.problem, left, [effect("throttle_bias")])
    offset = fits, left.size(left.gap), work.whole
    assert made_up(work, claimed, offset) is needless
    assert not made_up(work, claimed, None)


def test_sizes_of_gaps_stay_as_they_were(flights, engine, recorded):
    """An offset that does nothing while the engine moves takes nothing from any effect."""
    shift = np.array([0.0, 0.0, 60.0])
    real = recorded({"sensor_lag:N2_pct": [0.8, 0.5]}) + shift
    work = work_on(real, flights, engine, Options())
    claimed = fit([effect("sensor_lag:N2_pct")], work.problem)
    left = unexplained(work.tight, claimed.response)
    fits = offset_fits(work.problem, left, [effect("sensor_bias:EGT_C")])
    assert not made_up(work, claimed, (fits, left.size(left.gap), work.whole))


@pytest.mark.parametrize(
    ("limit_and_shift", "kind"),
    [
        ((0.85, 1.0), "unknown"),
        ((0.6, 1.0), "ambiguous"),  # more than any build has
        ((0.85, 0.0), "ambiguous"),  # the simulator's own build
    ],
)
def test_what_a_build_explains_as_well_is_no_claim(
    limit_and_shift, kind, flights, engine, recorded
):
    share, shift = limit_and_shift
    real = recorded({"altitude_lag": [0.4]}) + shift * np.array([0.12, -0.2, 2.0])
    work = work_on(real, flights, engine, Options())
    lag = fit([effect("altitude_lag")], work.problem)
    limit = effect("accel_limit")
    known = limit.parameters(flights.signals)
    same = replace(
        lag,
        effects=(limit,),
        parameters=known,
        theta=np.array([share, *(p.neutral for p in known[1:])]),
    )
    work.fits = [lag, same]
    found = finding(work, lag, None, NOISE)
    assert found.kind == kind, found.reason
    words = "but a limit of acceleration 15 % off may be the build's own, and explains as much"
    assert found.reason.endswith(words) is (kind == "unknown")
    assert (found.effects == ("altitude_lag",)) is (kind != "unknown")
