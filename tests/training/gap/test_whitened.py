"""The size of a probe's lag comes from quick moves where slow heat is there as well."""

import numpy as np
import pytest

from tests.training.gap.test_kin import first, wandering, worked  # noqa: F401 - a fixture
from training.gap.kin import standings
from training.gap.whitened import by_octave, sized_by_moves, whitened

TRUE = 1.0
BOTH = {"sensor_lag:EGT_C": [TRUE, 0.5], "heat_soak": [30.0, 0.0, 0.0, -0.4, 0.0]}


def test_a_lag_that_had_grown_to_follow_the_heat_gets_its_own_size(worked, recorded):  # noqa: F811
    work = worked(wandering(recorded(BOTH)), ("sensor_lag:EGT_C", "heat_soak"))
    work.standing = standings(work)
    before = max(work.fits, key=work.rank)
    assert before.name == "sensor_lag:EGT_C"
    assert before.theta[0] > 2.0 * TRUE
    after = sized_by_moves(work, before)
    assert after.theta[0] == pytest.approx(TRUE, rel=0.3)
    assert after in work.fits
    assert before not in work.fits
    assert (after.held_out >= 0.9 * after.left).all()


def test_what_no_heat_could_be_keeps_its_size(worked, recorded):  # noqa: F811
    work = worked(recorded({"sensor_lag:N2_pct": [0.3, 0.5]}))
    work.standing = standings(work)
    claimed = max(work.fits, key=work.rank)
    assert sized_by_moves(work, claimed) is claimed
    assert sized_by_moves(work, None) is None


def test_heat_that_leads_keeps_its_size(worked, recorded):  # noqa: F811
    work = worked(wandering(recorded({"heat_soak": [14.0, 0.0, 0.0, -0.5, 0.0]})))
    work.standing = standings(work)
    claimed = max(work.fits, key=work.rank)
    assert claimed.name == "heat_soak"
    assert sized_by_moves(work, claimed) is claimed


def test_every_octave_counts_by_what_is_left_in_it(worked, recorded):  # noqa: F811
    """Of the rest itself there is one per independent sample, as far as noise leaves it."""
    work = worked(wandering(recorded({})), ("sensor_lag:EGT_C",))
    measure = whitened(work, np.zeros_like(work.problem.flights.y))
    count = len(measure.gap) * measure.power.size
    assert float(measure.size(measure.gap).sum()) < count
    assert float(measure.size(measure.gap).sum()) > 0.3 * count
    assert measure.power[0, 2] > 100.0 * measure.power[-1, 2]


def test_octaves_are_means_over_twice_as_many_each():
    power = np.arange(1.0, 8.0)[:, None]
    assert by_octave(power)[:, 0] == pytest.approx([1.0, 2.5, 2.5, 5.5, 5.5, 5.5, 5.5])
