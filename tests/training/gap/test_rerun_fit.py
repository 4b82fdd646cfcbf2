"""A simulator that can be run again gives the sizes itself, whatever the emulator makes of them."""

from dataclasses import replace

import numpy as np
import pytest

from narxcal import two_spool
from narxcal.effects import effect
from tests.training.gap.conftest import NOISE
from training.gap.diagnosis import diagnose
from training.gap.fitting import Problem, fit
from training.gap.offsets import offset_fits, unexplained, whole_gap
from training.gap.quadratic import misfit
from training.gap.rerun_fit import on_inputs, told_anew
from training.gap.work import Options, Simulators, Work

QUICK = Options()


@pytest.fixture(scope="module")
def coarse(engine):
    """An emulator of the engine that is a quarter too slow, and lazier at the fan."""
    spools = engine.engine
    theta = spools.theta.copy()
    theta[two_spool.GAIN] -= np.log(1.25)
    theta[two_spool.FAN] -= np.log(1.25)
    return replace(engine, engine=replace(spools, theta=theta))


class Asked:
    """The engine itself, and how often it was told something else."""

    def __init__(self, engine):
        self.engine, self.told = engine, 0

    def run(self, flights, told, pace=None):
        self.told += told is not flights.u
        return self.engine.run(flights, told, pace)


@pytest.mark.slow
@pytest.mark.parametrize("lever", [("throttle_backlash", 3.0), ("throttle_rate_limit", 12.0)])
def test_sizes_are_the_simulators_own(lever, flights, engine, coarse, recorded):
    name, size = lever
    real = recorded({name: [size]})
    guessed = diagnose(flights, (real, NOISE), Simulators(coarse), QUICK)
    found = diagnose(flights, (real, NOISE), Simulators(coarse, engine), QUICK)
    assert guessed.effects == found.effects == (name,)
    before, after = (next(iter(f.tried[0].parameters[name].values())) for f in (guessed, found))
    assert abs(after.value - size) < 0.01 * size < abs(before.value - size)
    assert after.low <= size <= after.high
    assert found.tried[0].gain > guessed.tried[0].gain


@pytest.mark.parametrize("lag", [True, False])
def test_an_offset_that_says_all_needs_no_help(lag, flights, engine, coarse, recorded):
    """What was claimed beside it stays only if there is something for it to explain."""
    beside = {"sensor_lag:N1_pct": [0.8, 0.5]} if lag else {}
    real = recorded({"throttle_bias": [3.0], **beside})
    measured = misfit(flights, real, NOISE)
    problem = Problem(flights, coarse, measured)
    before, tight = measured.size(measured.gap), whole_gap(flights, (real, NOISE))
    work = Work(problem, QUICK, before, NOISE, tight, itself=engine)
    claimed = fit([effect("sensor_lag:N1_pct")], problem)
    left = unexplained(work.tight, claimed.response)
    offset = offset_fits(problem, left, [effect("throttle_bias")])
    work.fits = [claimed]
    found, (fits, _, _) = told_anew(work, claimed, (offset, left.size(left.gap), work.whole), None)
    assert found is (claimed if lag else None)
    assert fits[0].theta == pytest.approx([3.0], rel=0.01)


@pytest.mark.slow
def test_nothing_is_run_again_for_what_acts_on_readings(flights, engine, coarse, recorded):
    again = Asked(engine)
    real = recorded({"sensor_lag:EGT_C": [1.2, 0.5]})
    guessed = diagnose(flights, (real, NOISE), Simulators(coarse), QUICK)
    found = diagnose(flights, (real, NOISE), Simulators(coarse, again), QUICK)
    assert again.told == 0
    assert found == guessed


@pytest.mark.parametrize(
    ("name", "needed"),
    [
        ("throttle_backlash", True),
        ("throttle_delay", False),
        ("sensor_lag:EGT_C", False),
        ("spool_lag", False),
    ],
)
def test_only_what_changes_inputs_is_told(name, needed):
    assert on_inputs(effect(name)) is needed
