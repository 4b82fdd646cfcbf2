"""Neighbours on one channel: quick moves say which it is, minutes that any engine spoils do not."""

import numpy as np
import pytest

from narxcal.effects import effect
from tests.training.gap.conftest import NOISE
from training.gap.allowance import Allowance
from training.gap.fitting import Problem, fit
from training.gap.kin import standings
from training.gap.quadratic import misfit
from training.gap.work import Options, Work

HEAT = [60.0, 0.0, 0.0, -0.6, 0.0]
NAMES = ("sensor_lag:EGT_C", "time_skew:EGT_C", "heat_soak", "sensor_lag:N2_pct")


@pytest.fixture
def worked(flights, engine):
    def run(real, names=NAMES):
        measure = misfit(flights, real, NOISE)
        problem = Problem(flights, engine, measure)
        work = Work(problem, Options(), measure.size(measure.gap), NOISE, measure)
        work.fits = [fit([effect(name)], problem) for name in names]
        work.allowance = Allowance(work.fits, problem)
        return work

    return run


def first(work):
    return max(work.fits, key=work.rank).name


def wandering(real, size=8.0):
    """A temperature that creeps after every flight's own fashion, over minutes."""
    time = np.arange(real.shape[1])
    wave = [size * np.sin(time / (60.0 + 9.0 * f) + f) for f in range(len(real))]
    return real + np.stack(wave)[..., None] * np.array([0.0, 0.0, 1.0])


def test_a_probe_beside_the_heat_that_is_there_anyway_comes_first(worked, recorded):
    """The heat takes more of the gap; at the moves it is the probe that explains it."""
    work = worked(recorded({"sensor_lag:EGT_C": [1.0, 0.5], "heat_soak": HEAT}))
    assert first(work) == "heat_soak"
    work.standing = standings(work)
    assert first(work) == "sensor_lag:EGT_C"


@pytest.mark.parametrize(
    ("name", "theta"),
    [
        ("heat_soak", [14.0, 0.0, 0.0, -0.5, 0.0]),
        ("sensor_lag:EGT_C", [1.0, 0.5]),
        ("time_skew:EGT_C", [0.8]),
    ],
)
def test_what_is_there_is_first_among_its_neighbours(name, theta, worked, recorded):
    work = worked(wandering(recorded({name: theta})))
    work.standing = standings(work)
    assert first(work) == name


def test_the_places_among_all_effects_stay(worked, recorded):
    """Neighbours exchange their ranks: no other effect comes before them or falls behind."""
    work = worked(recorded({"sensor_lag:EGT_C": [1.0, 0.5], "heat_soak": HEAT}))
    before = sorted(work.rank(one) for one in work.fits)
    work.standing = standings(work)
    assert sorted(work.rank(one) for one in work.fits) == pytest.approx(before)


def test_one_that_explains_little_is_no_neighbour(worked, recorded):
    work = worked(recorded({"sensor_lag:N2_pct": [0.3, 0.5]}))
    assert "sensor_lag:N2_pct" not in standings(work)
    assert standings(worked(recorded({}), ("sensor_lag:N2_pct",))) == {}
