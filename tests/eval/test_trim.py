"""Trim offsets follow what was seen, shrink where little was seen, and stay where it was seen."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eval.judging.trim import PRIORS, OffsetPrior, TrimConfig, TrimSamples, estimate_trim

NAMES = ("N1_pct", "EGT_C")
DT_S = 0.1


def seen(level, error, quasi_steady=True, altitude_ft=0.0):
    count = len(level)
    errors = np.column_stack([error * np.ones(count), 10.0 * error * np.ones(count)])
    altitude = altitude_ft * np.ones(count)
    return TrimSamples(errors, np.asarray(level), altitude, np.full(count, quasi_steady), DT_S)


def test_one_level_alone_gives_the_closed_form():
    """One bin: offset(x) = k(x, x0) e / (k(x0, x0) + width^2 / n), with n samples' worth."""
    prior = OffsetPrior(width=0.5, common=0.25, length=0.15)
    config = TrimConfig(priors={"N1_pct": prior}, correlation_s=60.0, spacing=0.25)
    trim = estimate_trim(seen(np.full(1200, 0.5), 0.4), 1200, NAMES, config)
    n, k0 = 1200 * DT_S / 60.0, 0.25**2 + 1.0
    weight = 0.4 / (k0 + 1.0 / n)
    for node, offset in zip(config.nodes, trim.offsets[0, :, 0], strict=True):
        reach = 0.25**2 + np.exp(-0.5 * ((node - 0.5) / 0.15) ** 2)
        assert offset == pytest.approx(reach * weight)


def test_an_offset_seen_at_idle_is_not_carried_to_full_power():
    trim = estimate_trim(seen(np.zeros(20000), 2.0), 20000, NAMES, TrimConfig())
    assert trim.offsets[0, 0, 0] > 1.8
    assert abs(trim.offsets[0, -1, 0]) < 0.15


def test_a_model_gone_astray_is_not_taken_for_an_offset():
    wrong, most = (
        estimate_trim(seen(np.zeros(20000), error), 20000, NAMES, TrimConfig())
        for error in (40.0, 2.0)
    )
    assert np.array_equal(wrong.offsets[0, :, 0], most.offsets[0, :, 0])


def test_seconds_count_less_than_minutes():
    short, long = (
        estimate_trim(seen(np.full(n, 0.6), 1.0), n, NAMES, TrimConfig()) for n in (50, 5000)
    )
    assert abs(short.offsets[0, 6, 0]) < 0.1
    assert long.offsets[0, 6, 0] > 0.8


def test_without_quasi_steady_samples_nothing_is_added():
    trim = estimate_trim(seen(np.full(500, 0.5), 1.0, quasi_steady=False), 500, NAMES, TrimConfig())
    assert np.array_equal(trim.offsets, np.zeros((1, 11, 2)))
    assert trim.samples == (0, 0)


def test_a_channel_without_a_prior_is_left_alone():
    samples = seen(np.full(500, 0.5), 1.0)
    trim = estimate_trim(samples, 500, ("FPR", "EGT_C"), TrimConfig())
    assert not trim.offsets[0, :, 0].any()
    assert trim.offsets[0, :, 1].any()
    assert trim.samples == (0, 500)


def test_a_prior_can_be_given():
    samples = seen(np.full(500, 0.5), 1.0)
    config = TrimConfig.parse({"priors": {"FPR": {"width": 0.1}}})
    assert estimate_trim(samples, 500, ("FPR", "EGT_C"), config).offsets[0, :, 0].any()


def test_masked_samples_take_no_part():
    samples = seen(np.full(2000, 0.5), 1.0)
    samples.error[::2, 0] = np.nan
    trim = estimate_trim(samples, 2000, NAMES, TrimConfig())
    assert trim.samples == (1000, 2000)
    assert np.isfinite(trim.offsets).all()


def test_offsets_are_linear_between_levels_and_held_beyond():
    trim = estimate_trim(seen(np.linspace(0, 1, 5000), 1.0), 5000, NAMES, TrimConfig())
    found = trim.at(np.array([-3.0, 0.0, 0.05, 0.1, 9.0]), np.zeros(5))
    assert found[0] == pytest.approx(trim.offsets[0, 0])
    assert found[2] == pytest.approx((trim.offsets[0, 0] + trim.offsets[0, 1]) / 2)
    assert found[4] == pytest.approx(trim.offsets[0, -1])


@given(
    levels=st.lists(st.floats(-0.5, 1.5), min_size=1, max_size=200),
    error=st.floats(-5.0, 5.0),
    common=st.floats(0.0, 2.0),
)
def test_a_constant_error_is_never_overcorrected_by_much(levels, error, common):
    trim = estimate_trim(
        seen(np.array(levels), error),
        len(levels),
        NAMES,
        TrimConfig(priors={"N1_pct": OffsetPrior(width=0.5, common=common)}),
    )
    assert np.isfinite(trim.offsets).all()
    assert np.abs(trim.offsets[0, :, 0]).max() <= 1.3 * abs(error) + 1e-12


def test_an_offset_seen_at_one_altitude_goes_back_to_the_common_part_at_another():
    """One bin: the offset falls with the altitude as exp(-(h - h')^2 / (2 H^2)), H = 10,000 ft."""
    altitude_ft = np.linspace(5000.0, 35000.0, 20000)
    samples = seen(np.full(20000, 0.5), 0.4, altitude_ft=altitude_ft)
    first = 100  # at 5,000 ft
    trim = estimate_trim(samples, first, NAMES, TrimConfig())
    assert trim.altitudes_ft == pytest.approx(np.arange(5000.0, 35001.0, 5000.0))
    by_altitude = trim.offsets[:, 5, 0] / trim.offsets[0, 5, 0]
    common = PRIORS["N1_pct"].common ** 2
    apart = (trim.altitudes_ft - altitude_ft[:first].mean()) / 10_000.0
    near = common + np.exp(-0.5 * apart[0] ** 2)
    assert by_altitude == pytest.approx((common + np.exp(-0.5 * apart**2)) / near)


def test_between_altitudes_offsets_are_linear_and_beyond_them_constant():
    samples = seen(np.full(1000, 0.5), 0.4, altitude_ft=np.linspace(0.0, 10000.0, 1000))
    trim = estimate_trim(samples, 1000, NAMES, TrimConfig())
    found = trim.at(np.full(5, 0.5), np.array([-900.0, 0.0, 2500.0, 10000.0, 40000.0]))[:, 0]
    assert found[:2] == pytest.approx([trim.offsets[0, 5, 0]] * 2)
    assert found[2] == pytest.approx((trim.offsets[0, 5, 0] + trim.offsets[1, 5, 0]) / 2)
    assert found[3:] == pytest.approx([trim.offsets[2, 5, 0]] * 2)
