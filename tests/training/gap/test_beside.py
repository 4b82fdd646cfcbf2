"""Where slow heat or a limit leads, what is wrong besides comes first; alone it stays."""

import numpy as np
import pytest

from narxcal.effects import effect
from tests.training.gap.conftest import NOISE
from training.gap.allowance import Allowance
from training.gap.beside import beside, stands
from training.gap.diagnosis import diagnose
from training.gap.fitting import Problem, fit
from training.gap.quadratic import misfit
from training.gap.verdict import _equal
from training.gap.work import Options, Simulators, Work

HEAT = {"heat_soak": [60.0, 0.0, 0.0, -1.0, 0.0]}
MOVERS = ("throttle_delay", "sensor_lag:N2_pct", "sensor_lag:EGT_C", "accel_limit")
SLOW = ("heat_soak", "sensor_drift:EGT_C")


@pytest.fixture
def worked(flights, engine):
    """A diagnosis under way: every effect of a few is fitted to what was recorded."""

    def run(real, names=(*MOVERS, *SLOW)):
        measure = misfit(flights, real, NOISE)
        problem = Problem(flights, engine, measure)
        options = Options(draws=40)
        work = Work(problem, options, measure.size(measure.gap), NOISE, measure)
        work.fits = [fit([effect(name)], problem) for name in names]
        work.allowance = Allowance(work.fits, problem)
        return work

    return run


def wandering(real):
    """EGT that wanders by 6 degC, otherwise in every flight, as no effect of the library does."""
    time = np.arange(real.shape[1])
    wave = [6.0 * np.sin(time / (25.0 + 3.0 * f) + f) for f in range(len(real))]
    return real + np.stack(wave)[..., None] * np.array([0.0, 0.0, 1.0])


@pytest.mark.parametrize(
    ("name", "theta"), [("throttle_delay", [0.2]), ("sensor_lag:N2_pct", [0.3, 0.5])]
)
def test_what_is_small_against_the_heat_is_seen_beside_it(name, theta, worked, recorded):
    work = worked(recorded({**HEAT, name: theta}))
    heat = work.fits[len(MOVERS)]
    assert max(work.fits, key=work.rank) is heat
    pair = beside(work)
    assert pair is not None
    assert [one.name for one in pair.effects] == [name, "heat_soak"]
    assert pair.theta[0] == pytest.approx(theta[0], rel=0.15)
    assert pair in work.fits


@pytest.mark.parametrize("share", [0.8, 1.2])
def test_what_is_small_against_a_limit_of_its_own_is_named_beside_it(share, worked, recorded):
    work = worked(recorded({"accel_limit": [share], "sensor_lag:N2_pct": [0.1, 0.5]}), MOVERS)
    limit = work.fits[MOVERS.index("accel_limit")]
    assert max(work.fits, key=work.rank) is limit
    pair = beside(work)
    assert pair is not None
    assert [one.name for one in pair.effects] == ["sensor_lag:N2_pct", "accel_limit"]
    assert stands(work, pair, limit)


def test_a_limit_that_no_build_has_hides_nothing(worked, recorded):
    work = worked(recorded({"accel_limit": [0.6], "sensor_lag:N2_pct": [0.1, 0.5]}), MOVERS)
    assert max(work.fits, key=work.rank).name == "accel_limit"
    assert beside(work) is None


def test_a_limit_alone_has_nothing_beside_it(worked, recorded):
    assert beside(worked(recorded({"accel_limit": [0.8]}), MOVERS)) is None


def test_heat_alone_has_nothing_beside_it(worked, recorded):
    assert beside(worked(wandering(recorded(HEAT)))) is None


def test_where_something_else_leads_nothing_is_asked(worked, recorded):
    work = worked(recorded({**HEAT, "throttle_delay": [1.5]}))
    assert beside(work) is None
    assert len(work.fits) == len(MOVERS) + len(SLOW)


def test_a_drift_is_no_effect_of_moves(worked, recorded):
    work = worked(recorded({**HEAT, "sensor_drift:EGT_C": [150.0]}), SLOW)
    assert beside(work) is None


@pytest.mark.parametrize(("tau_s", "named"), [(0.3, False), (1.0, True)])
def test_what_is_seen_is_named_if_it_is_large_enough(tau_s, named, worked, recorded):
    work = worked(wandering(recorded({**HEAT, "sensor_lag:N2_pct": [tau_s, 0.5]})))
    pair = beside(work)
    assert pair is not None
    assert stands(work, pair, work.fits[len(MOVERS)]) is named


def test_heat_that_two_pairs_share_makes_no_rivals_of_them(worked, recorded):
    work = worked(wandering(recorded({**HEAT, "sensor_lag:N2_pct": [0.6, 0.5]})))
    claimed = beside(work)
    pairs = [one for one in work.fits if len(one.effects) == 2 and one is not claimed]
    assert pairs
    for other in pairs:
        assert float(work.beyond(other).sum()) > 0.5 * float(work.beyond(claimed).sum())
        assert not _equal(work, claimed, other)


def test_it_leads_where_nothing_can_be_claimed(flights, engine, recorded):
    """Other misfit leaves too much for any claim, and the lag is a few hundredths of the gap."""
    real = wandering(recorded({**HEAT, "sensor_lag:N2_pct": [0.8, 0.5]}))
    real += 9.0 * (wandering(flights.y) - flights.y)
    found = diagnose(flights, (real, NOISE), Simulators(engine), Options(draws=40))
    assert (found.kind, found.effects) == ("unknown", ()), found.reason
    assert found.leading == ("sensor_lag:N2_pct", "heat_soak")


def test_watched_it_tells_what_it_fits(worked, recorded):
    told = []
    beside(worked(recorded(HEAT)), lambda *step: told.append(step))
    assert [step[1:] for step in told] == [(k, 4) for k in range(4)]
    assert all(step[0].endswith(" + heat_soak") for step in told)
