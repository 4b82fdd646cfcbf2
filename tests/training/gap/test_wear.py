"""Less acceleration is a part of wear where a worn engine has no more to spare."""

from dataclasses import replace

import numpy as np
import pytest

from narxcal.effects import effect
from tests.training.gap.conftest import NOISE
from training.gap import wear
from training.gap.fitting import Problem, fit
from training.gap.offsets import offset_fits, unexplained, whole_gap
from training.gap.quadratic import misfit
from training.gap.verdict import finding
from training.gap.wear import with_its_limit
from training.gap.work import Options, Work

SHIFT = np.array([0.0, 1.5, 30.0])  # of a core and a temperature


@pytest.fixture(scope="module")
def work(flights, engine, recorded):
    """Flights of an engine that is shifted and accelerates at 0.85 of its limit."""
    real = recorded({"accel_limit": [0.85]}) + SHIFT
    measured = misfit(flights, real, NOISE)
    problem = Problem(flights, engine, measured)
    tight = whole_gap(flights, (real, NOISE))
    found = Work(problem, Options(), measured.size(measured.gap), NOISE, tight)
    found.fits = [fit([effect(name)], problem) for name in ("accel_limit", "spool_lag")]
    return found


@pytest.fixture
def at_one_speed(monkeypatch):
    """Returns what sets how much hotter the engine is, and how much more it burns, in %."""

    def set_to(hotter, more):
        shifts = {"EGT_C": np.broadcast_to(hotter, 5), "FF_kgph": np.broadcast_to(more, 5)}
        monkeypatch.setattr(wear, "at_one_speed", lambda *_: shifts)

    return set_to


def offset_of(work, name):
    left = unexplained(work.tight, work.fits[0].response)
    return offset_fits(work.problem, left, [effect(name)]), left.size(left.gap), work.whole


@pytest.mark.parametrize(
    ("hotter", "more", "said"),
    [
        (4.0, 4.0, ["deterioration", "accel_limit"]),
        (4.0, 2.0, ["accel_limit", "deterioration"]),  # fuel flow within scatter of builds
        (4.0, 1.0, ["accel_limit"]),
        (2.0, 4.0, ["accel_limit"]),  # five times as much is less than the limit has lost
        ([-0.1, 4.0, 4.0, 4.0, 4.0], 4.0, ["accel_limit"]),
        ([np.nan, np.nan, 4.0, 4.0, 4.0], 4.0, ["deterioration", "accel_limit"]),
        ([np.nan, np.nan, np.nan, 4.0, 4.0], 4.0, ["accel_limit"]),
    ],
)
def test_a_limit_may_be_a_part_of_wear_that_is_not_claimed(hotter, more, said, work, at_one_speed):
    """The claim, and what else may be meant."""
    at_one_speed(hotter, more)
    claimed, offset, rivals, _ = with_its_limit(work, work.fits[0], None)
    assert [(offset[0][0] if claimed is None else claimed).name, *rivals] == said


def test_a_slightly_lower_limit_of_a_slightly_hotter_engine_is_wear_s_rival(work, at_one_speed):
    """Within build scatter wear never leads."""
    at_one_speed(2.3, 3.0)
    mild = replace(work.fits[0], theta=np.array([0.9]))
    claimed, offset, others, _ = with_its_limit(work, mild, None)
    assert claimed is mild
    assert offset is None
    assert others == ("deterioration",)


def test_beside_wear_its_own_limit_is_no_second_effect(work, at_one_speed):
    at_one_speed(4.0, 0.0)
    offset = offset_of(work, "deterioration")
    found = finding(work, work.fits[0], offset, NOISE)
    assert found.effects == ("deterioration",)
    lost = 100.0 * (1.0 - work.fits[0].theta[0])
    assert found.reason == "explains flights that had no part in the fit"
    assert found.besides == f"{lost:.0f} % less acceleration beside it may be the wear's own"
    assert found.ambiguous_with == ()


@pytest.mark.parametrize(("hotter", "name"), [(2.0, "deterioration"), (4.0, "sensor_bias:N2_pct")])
def test_beside_another_offset_or_too_little_wear_a_limit_stays(hotter, name, work, at_one_speed):
    at_one_speed(hotter, 4.0)
    offset = offset_of(work, name)
    answer = with_its_limit(work, work.fits[0], offset)
    assert (answer.claimed, answer.offset, answer.rivals, answer.why) == (
        work.fits[0],
        offset,
        (),
        "",
    )


def test_what_wear_takes_is_said(work, at_one_speed):
    at_one_speed(4.0, 2.0)
    found = finding(work, work.fits[0], None, NOISE)
    assert (found.kind, found.effects) == ("ambiguous", ("accel_limit",))
    assert found.ambiguous_with == ("deterioration",)
    lost = 100.0 * (1.0 - work.fits[0].theta[0])
    assert found.reason == "other effects explain held-out flights as well"
    assert found.besides == (
        f"wear takes {lost:.0f} % of acceleration, too: "
        "at one fan speed the engine is 4.0 % hotter and burns 2.0 % more"
    )


def test_what_is_no_lower_limit_is_no_part_of_wear(work, at_one_speed):
    at_one_speed(4.0, 4.0)
    higher = replace(work.fits[0], theta=np.array([1.05]))
    for claimed in (None, work.fits[1], higher):
        assert with_its_limit(work, claimed, None) == (claimed, None, (), "")


def test_an_engine_that_wear_would_cool_is_not_worn(flights, work, at_one_speed):
    """The recorded engine is cooler throughout, though not at one fan speed."""
    at_one_speed(4.0, 4.0)
    colder = replace(work.tight, gap=work.tight.gap - 2.0 * SHIFT)
    anew = replace(work, tight=colder)
    assert with_its_limit(anew, work.fits[0], None).rivals == ()


def test_a_limit_that_explains_too_little_says_nothing_of_wear(work, at_one_speed):
    at_one_speed(4.0, 4.0)
    most = Options(unexplained_inside=-1.0, telling=(2.0, 1.0), apart=(2.0, 1.0), distinct=2.0)
    found = finding(replace(work, options=most), work.fits[0], None, NOISE)
    assert (found.kind, found.effects, found.ambiguous_with) == ("unknown", (), ())
    assert found.besides == ""
