"""Rotors slower both ways take the place of an asymmetry that decelerations do not tell of."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from narxcal.effects import effect
from tests.training.gap.conftest import NOISE
from training.gap.both_ways import places
from training.gap.fitting import Problem, fit
from training.gap.quadratic import misfit
from training.gap.work import Options, Work

ASYMMETRY, BOTH = "accel_decel_asymmetry", "spool_lag"


@pytest.fixture
def work_of(flights, engine, recorded):
    """Returns the work on flights with effects in them, both kinds of rotors tried."""

    def make(effects):
        measure = misfit(flights, recorded(effects), NOISE)
        problem = Problem(flights, engine, measure)
        work = Work(problem, Options(), measure.size(measure.gap), NOISE, measure)
        work.fits = [fit([effect(name)], problem) for name in (ASYMMETRY, BOTH, "accel_limit")]
        return work

    return make


@pytest.mark.parametrize("truth", [{ASYMMETRY: [1.4, 0.0]}, {BOTH: [1.3]}])
def test_where_one_of_them_is_right_nothing_changes(truth, work_of):
    work = work_of(truth)
    assert places(work) == {}
    assert max(work.fits, key=work.rank).name == next(iter(truth))


def said(gains, ranks, by_control=0.0):
    """Places by the gains and ranks of an asymmetry and of rotors slower both ways."""
    rows = [(effect(ASYMMETRY), by_control > 0.0), (effect(BOTH), False)]
    fits = [
        SimpleNamespace(effects=(one,), name=one.name, by_control=control, gain=gain, rank=rank)
        for (one, control), gain, rank in zip(rows, gains, ranks, strict=True)
    ]
    work = SimpleNamespace(fits=fits, gain=lambda one: one.gain, rank=lambda one: one.rank)
    found = places(work)
    return {one.name: one.rank * found.get(one.name, 1.0) for one in fits}


def test_they_exchange_their_places_where_both_explain_about_as_much():
    assert said((0.8, 0.7), (0.5, 0.4)) == pytest.approx({ASYMMETRY: 0.4, BOTH: 0.5})


@pytest.mark.parametrize(
    ("gains", "ranks", "by_control"),
    [
        ((0.8, 0.6), (0.5, 0.4), 0.0),  # decelerations tell
        ((0.8, 0.7), (0.3, 0.4), 0.0),  # the plain one leads anyway
        ((0.8, 0.7), (0.5, 0.4), 1.0),  # the control's limit of deceleration
        ((0.0, 0.0), (0.0, 0.0), 0.0),  # neither explains anything
    ],
)
def test_else_each_keeps_its_own(gains, ranks, by_control):
    assert said(gains, ranks, by_control) == dict(zip((ASYMMETRY, BOTH), ranks, strict=True))


def test_without_one_of_them_there_is_nothing_to_exchange(work_of):
    work = work_of({BOTH: [1.3]})
    for name in (ASYMMETRY, BOTH):
        fits = [one for one in work.fits if one.name != name]
        assert places(replace(work, fits=fits)) == {}


def test_a_place_is_a_part_of_the_rank(work_of):
    work = work_of({BOTH: [1.3]})
    before = work.rank(work.fits[0])
    work.place = {ASYMMETRY: 0.5}
    assert work.rank(work.fits[0]) == pytest.approx(0.5 * before)
