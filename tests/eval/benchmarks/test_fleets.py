"""More flights, and a bad one, on virtual fleets."""

from pathlib import Path

import numpy as np
import pytest

from eval.benchmarks.fleets import (
    FAULTS,
    fitted_prior,
    judged,
    mean_log_ratio,
    ratio_row,
    read_fleet,
    trained,
    with_faults,
    write_fleet,
)


def test_the_ratio_is_a_mean_over_fleets_with_the_scatter_between_them():
    old = np.full((6, 3), 2.0)
    pairs = [(old * 0.5, old), (old * 0.5, old), (old * 2.0, old)]
    mean, error = mean_log_ratio(pairs)
    assert mean == pytest.approx(-np.log(2.0) / 3.0)
    assert error == pytest.approx(np.std([-1.0, -1.0, 1.0], ddof=1) * np.log(2.0) / np.sqrt(3.0))
    assert mean_log_ratio(pairs[:1])[1] == np.inf


def test_a_ratio_is_missed_only_beyond_its_scatter():
    old = np.ones((6, 3))
    by_chance = ratio_row("g", "n", [(1.3 * old, old), (0.9 * old, old), (1.0 * old, old)])
    worse = ratio_row("g", "n", [(1.3 * old, old), (1.25 * old, old), (1.35 * old, old)])
    assert by_chance.reached is True
    assert worse.reached is False
    assert "each 1.30, 1.25, 1.35" in worse.note


@pytest.mark.parametrize("m", [1.0, 4.0])
def test_the_prior_that_fleets_were_drawn_from_is_recovered(m):
    draw = np.random.default_rng(7)
    scatter = 0.3 * np.sqrt(m / draw.chisquare(m, 800))
    found = fitted_prior([draw.normal(0.0, one, 6) for one in scatter])
    assert found == pytest.approx((m, 0.3), rel=0.2)


@pytest.fixture(scope="module")
def judged_fleets(tmp_path_factory):
    """Errors of models of 3 and of 6 flights over four that are held out."""
    found = []
    for number in (0, 1, 2):
        folder = tmp_path_factory.mktemp("fleet")
        write_fleet(folder, (4242, number), 10, rate_hz=5.0)
        case = read_fleet(folder)
        fast = case.config.having(train={"choice_s": 0.0, "iterations": (2, 2)})
        case = case._replace(config=fast)
        sizes = {n: judged(trained(case, case.logs[:n]), case.logs[6:]).rmse for n in (3, 6)}
        found.append((case, sizes))
    return found


@pytest.mark.slow
def test_more_flights_do_not_hurt(judged_fleets):
    assert ratio_row("", "", [(each[6], each[3]) for _, each in judged_fleets]).reached


@pytest.mark.slow
def test_a_lever_that_reads_too_much_in_one_flight_costs_no_more_than_that_flight(judged_fleets):
    case = judged_fleets[0][0]
    sound, bad, _ = with_faults(case.logs)
    assert np.allclose(bad[0]["TRA_deg"] - sound[0]["TRA_deg"], FAULTS["TRA_deg"])
    bundle = trained(case, bad)
    left_out = bundle.record.screening.contradicting
    assert [Path(row.log).name for row in left_out] == ["flight_01.csv"]
    others = judged(trained(case, bad[1:]), case.logs[6:]).rmse
    np.testing.assert_array_equal(judged(bundle, case.logs[6:]).rmse, others)
