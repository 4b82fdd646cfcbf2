"""Stretches of a residual: their heights, the strongest of them, and limits at the stated rate."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from training.screening.scatter import (
    BLOCK_S,
    LEAST_STRETCH_S,
    Blocks,
    StepPrior,
    heights,
    octave,
    strongest_step,
)

LEAST = round(LEAST_STRETCH_S / BLOCK_S)


def blocks(r):
    return Blocks(BLOCK_S * np.arange(len(r)), np.asarray(r, dtype=np.float64))


def slow_height(r, start, stop):
    inside = np.zeros(len(r), dtype=bool)
    inside[start:stop] = True
    return float(np.mean(r[inside]) - np.mean(r[~inside]))


@given(seed=st.integers(0, 10_000), count=st.integers(2 * LEAST, 90))
def test_heights_are_among_those_of_all_stretches_and_the_strongest_is_one_of_them(seed, count):
    r = np.random.default_rng(seed).standard_normal(count)
    slow = {}
    for start in range(count):
        for stop in range(start + LEAST, min(count, start + count - LEAST) + 1):
            k = octave(stop - start, count)
            slow[k] = max(slow.get(k, 0.0), abs(slow_height(r, start, stop)))
    found = heights(blocks(r))
    assert all(each <= slow[k] + 1e-12 for k, each in found.items())
    assert found[0] == pytest.approx(slow[0], rel=0.5)
    step = strongest_step(blocks(r), dict.fromkeys(found, 1.0))
    assert step.height == pytest.approx(slow_height(r, step.start, step.stop))
    assert step.excess == pytest.approx(max(found.values()))


@pytest.mark.parametrize(("start", "stop"), [(0, 40), (33, 71), (20, 160), (150, 200)])
def test_a_step_is_found_where_it_is(start, stop):
    r = 0.01 * np.random.default_rng(start).standard_normal(200)
    r[start:stop] += 0.1
    found = strongest_step(blocks(r), dict.fromkeys(heights(blocks(r)), 0.05))
    assert (found.start, found.stop) in {(start, stop), (stop, start)} or (
        abs(found.start - start) <= 1 and abs(found.stop - stop) <= 1
    )
    assert found.excess > 1.5


def test_too_short_a_log_has_no_stretch():
    assert heights(blocks(np.zeros(2 * LEAST - 1))) == {}
    assert strongest_step(blocks(np.zeros(5)), {0: 1.0}).excess == 0.0


PRIOR = StepPrior(0.015, 0.72, 0.6, 6.0, 0.15)


def drawn(draw, prior, logs):
    """Heights of logs of one engine, whose mean and scatter are drawn from the prior."""
    variance = prior.dof * prior.spread**2 / draw.chisquare(prior.dof)
    mean = np.log(prior.median) + np.sqrt(variance / prior.logs) * draw.standard_normal()
    return np.exp(mean + np.sqrt(variance) * draw.standard_normal(logs)).tolist()


def test_sound_logs_exceed_the_limits_at_the_stated_rate_at_most():
    draw, share, above = np.random.default_rng(3), 0.02, []
    for _ in range(3000):
        *known, last = drawn(draw, PRIOR, 4)
        above.append(last > PRIOR.limits({"a": {0: known}}, share)["a"][0])
    assert np.mean(above) == pytest.approx(share, abs=0.008)


@pytest.mark.parametrize("off", [{"median": 0.15}, {"spread": 1.8}, {"logs": 3.0}])
def test_the_evidence_is_largest_near_the_prior_that_was_drawn_from(off):
    draw = np.random.default_rng(9)
    seen = [{"a": {0: drawn(draw, PRIOR, 6)}} for _ in range(60)]

    def evidence(prior):
        return sum(prior.log_evidence(each) for each in seen)

    assert evidence(PRIOR) > evidence(replace(PRIOR, **off)) + 3.0


def test_limits_fall_with_the_logs_that_they_are_known_from_and_with_the_length():
    few, many = (PRIOR.limits({"a": {0: [0.02] * n, 3: [0.01] * n}}, 1e-3)["a"] for n in (2, 20))
    assert few[0] > many[0] > 0.02
    assert many[3] == pytest.approx(0.5 * many[0], rel=0.02)
