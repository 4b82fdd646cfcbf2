"""Scatter of levels between logs: limits at the stated rate, and evidence for the prior."""

import numpy as np
import pytest

from training.screening.scatter import ScatterPrior

PRIOR = ScatterPrior({"%": 0.005, "degC": 0.008}, 0.01, 0.15, 1.3, 0.6)


def test_a_limit_is_where_the_tail_is_as_large_as_stated():
    known = PRIOR.of_levels({"N1_pct": [0.002, -0.001], "EGT_C": []})
    for each in known.values():
        for share in (0.3, 1e-2, 1e-4):
            assert each.tail(each.limit(share)) == pytest.approx(share, rel=1e-6)
    assert known["N1_pct"].limit(1e-3) < known["EGT_C"].limit(1e-3)


def test_other_channels_of_a_quiet_recorder_narrow_a_limit():
    alone = PRIOR.of_levels({"EGT_C": []})["EGT_C"]
    quiet = {name: [2e-4, -1e-4, -1e-4] for name in ("N1_pct", "N2_pct", "N3_pct")}
    among = PRIOR.of_levels({"EGT_C": [], **quiet})["EGT_C"]
    assert among.limit(1e-3) < 0.3 * alone.limit(1e-3)


def drawn(draw, prior, channels, logs):
    """Levels of logs of one recorder, each against the mean of the others, and one more."""
    recorder = prior.recorders * draw.standard_normal()
    seen, last = {}, {}
    for name in channels:
        size = prior.level(name) * np.exp(recorder + prior.channels * draw.standard_normal())
        x = size * draw.standard_normal(logs + 1)
        seen[name] = [x[k] - np.mean(np.delete(x[:logs], k)) for k in range(logs)]
        last[name] = x[logs] - np.mean(x[:logs])
    return seen, last


def test_levels_of_one_more_log_exceed_limits_at_the_stated_rate():
    draw, above = np.random.default_rng(4), []
    for _ in range(300):
        seen, last = drawn(draw, PRIOR, ("N1_pct", "N2_pct"), 3)
        known = PRIOR.of_levels(seen)
        above += [abs(last[name]) > known[name].limit(0.02) for name in seen]
    assert np.mean(above) == pytest.approx(0.02, abs=0.008)


@pytest.mark.parametrize("off", [{"median": {"%": 0.015}}, {"recorders": 4.0}, {"channels": 2.0}])
def test_the_evidence_is_largest_near_the_prior_that_was_drawn_from(off):
    draw, true = np.random.default_rng(8), ScatterPrior({"%": 0.005}, 0.01, 0.15, 1.3, 0.6)
    seen = [drawn(draw, true, ("N1_pct", "N2_pct"), 5)[0] for _ in range(60)]

    def evidence(prior):
        return sum(prior.log_evidence(each, {}) for each in seen)

    other = ScatterPrior(**{**vars(true), **off})
    assert evidence(true) > evidence(other) + 3.0
