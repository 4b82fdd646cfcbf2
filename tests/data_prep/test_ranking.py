"""Pearson ranking against scipy, its gaps, and the choice of the driving channel."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from data_prep.log import Log
from data_prep.ranking import flight_table, is_strong, other_driver, pearson, ranked
from narxcal.support.errors import DataError


def flight(seed=0, count=500, **more):
    rng = np.random.default_rng(seed)
    lever = rng.uniform(0, 70, count)
    channels = {
        "TRA_deg": lever,
        "ALT_ft": rng.uniform(0, 30000, count),
        "Mach": 0.005 * lever + rng.uniform(0, 0.5, count),
        "N1_pct": 30 + lever + rng.normal(0, 5, count),
        "N2_pct": 60 + 0.5 * lever + rng.normal(0, 5, count),
        **more,
    }
    return Log(f"flight_{seed}", np.arange(count) / 32, channels)


@given(seed=st.integers(0, 1000), missing=st.floats(0, 0.9))
def test_matches_scipy_over_the_samples_both_channels_have(seed, missing):
    rng = np.random.default_rng(seed)
    first, second = rng.normal(size=(2, 80))
    second += rng.normal() * first
    first[rng.random(80) < missing] = np.nan
    second[rng.random(80) < missing / 2] = np.nan
    both = np.isfinite(first) & np.isfinite(second)
    log = Log("f", np.arange(80.0), {"TRA_deg": first, "N1_pct": second})
    rho = pearson(log, ["TRA_deg"], ["N1_pct"]).loc["TRA_deg", "N1_pct"]
    if both.sum() < 2:
        assert np.isnan(rho)
    else:
        assert rho == pytest.approx(stats.pearsonr(first[both], second[both])[0], abs=1e-12)


@given(scale=st.floats(1e-3, 1e3), offset=st.floats(-1e3, 1e3))
def test_is_free_of_scale_and_offset_and_turns_with_the_sign(scale, offset):
    log = flight()
    base = pearson(log, ["TRA_deg"], ["N1_pct"]).iloc[0, 0]
    for sign in (1, -1):
        other = log.with_channels({"TRA_deg": sign * scale * log["TRA_deg"] + offset})
        rho = pearson(other, ["TRA_deg"], ["N1_pct"]).iloc[0, 0]
        assert rho == pytest.approx(sign * base, abs=1e-9)


def test_a_constant_channel_is_undefined_with_a_reason_and_without_a_warning():
    log = flight(dT_C=np.full(500, 0.1 + 0.2))
    table = pearson(log, ["TRA_deg", "dT_C"], ["N1_pct"])
    assert np.isnan(table.loc["dT_C", "N1_pct"])
    assert table.attrs["reasons"] == {"dT_C, N1_pct": "dT_C is constant"}
    assert not is_strong(table).loc["dT_C", "N1_pct"]


def test_channels_without_a_common_sample_are_undefined_with_a_reason():
    log = flight()
    lever, speed = log["TRA_deg"].copy(), log["N1_pct"].copy()
    lever[:250], speed[250:] = np.nan, np.nan
    log = log.with_channels({"TRA_deg": lever, "N1_pct": speed})
    table = pearson(log, ["TRA_deg"], ["N1_pct"])
    assert table.attrs["reasons"] == {
        "TRA_deg, N1_pct": "TRA_deg and N1_pct have fewer than two samples in common"
    }


def test_strong_rule_starts_at_zero_point_eight():
    table = pearson(flight(), ["TRA_deg", "ALT_ft"], ["N1_pct"])
    table.iloc[:, 0] = [-0.8, 0.7999]
    assert is_strong(table).iloc[:, 0].tolist() == [True, False]


def test_ranking_orders_by_strength():
    table = pearson(flight(), ["ALT_ft", "Mach", "TRA_deg"], ["N1_pct", "N2_pct"])
    order = ranked(table)
    assert list(order.index) == ["TRA_deg", "Mach", "ALT_ft"]
    assert (order.loc["Mach"] == table.loc["Mach"]).all()


def test_what_has_no_correlation_comes_last_with_its_reason():
    log = flight(dT_C=np.zeros(500))
    order = ranked(pearson(log, ["dT_C", "ALT_ft", "TRA_deg"], ["N1_pct"]))
    assert list(order.index) == ["TRA_deg", "ALT_ft", "dT_C"]
    assert order.attrs["reasons"] == {"dT_C, N1_pct": "dT_C is constant"}


def test_flight_table_has_the_layout_of_the_papers_tables():
    logs = [flight(0), flight(1, dT_C=np.zeros(500)), flight(2)]
    logs[0] = logs[0].with_channels({"dT_C": np.ones(500)})
    logs[2] = logs[2].with_channels({"dT_C": logs[2]["ALT_ft"]})
    table = flight_table(logs, ["TRA_deg", "dT_C"], "N1_pct")
    assert list(table.index) == ["flight_0", "flight_1", "flight_2"]
    assert list(table.columns) == ["TRA_deg", "dT_C"]
    assert table.loc["flight_2", "TRA_deg"] == pytest.approx(
        pearson(logs[2], ["TRA_deg"], ["N1_pct"]).iloc[0, 0]
    )
    assert table.attrs["reasons"] == {
        "flight_0, dT_C, N1_pct": "dT_C is constant",
        "flight_1, dT_C, N1_pct": "dT_C is constant",
    }


def test_a_missing_channel_is_an_error():
    with pytest.raises(DataError) as error:
        pearson(flight(), ["WOW"], ["N1_pct"])
    assert str(error.value) == (
        "flight_0, channel WOW: the log has no such channel. "
        "It has TRA_deg, ALT_ft, Mach, N1_pct, N2_pct"
    )


def test_the_channel_that_does_drive_the_engine_is_named():
    draw = np.random.default_rng(0)
    fuel = np.repeat(draw.uniform(200.0, 900.0, 20), 50)
    lever = np.repeat(draw.uniform(0.0, 60.0, 20), 50)
    channels = {"TRA_deg": lever, "FF_kgph": fuel, "N1_pct": 20.0 + 0.08 * fuel}
    log = Log("a", 0.1 * np.arange(1000), channels)
    assert other_driver(log, "FF_kgph") == ""
    own = abs(np.corrcoef(lever, fuel)[0, 1])
    assert other_driver(log, "TRA_deg") == (
        f"N1_pct moves without TRA_deg (correlation {own:.2f}), FF_kgph drives it (1.00): "
        "set [events] driver and [steady_state] inputs accordingly"
    )
    assert other_driver(log.with_channels({"TRA_deg": fuel / 10.0}), "TRA_deg") == ""
