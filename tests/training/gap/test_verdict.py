"""What is said of a claim: its rivals, none where nothing is named, and none that is made up."""

import numpy as np
import pytest

from narxcal.effects import effect
from tests.training.gap.conftest import NOISE
from training.gap.fitting import Problem, fit
from training.gap.offsets import whole_gap
from training.gap.quadratic import misfit
from training.gap.verdict import finding
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
