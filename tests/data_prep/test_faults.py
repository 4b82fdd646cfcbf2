"""Sensor faults: what is masked, with which reason, and what must never be."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_prep.cleaning.clean import CleanConfig, clean
from data_prep.cleaning.faults import (
    FaultsConfig,
    excursions,
    expected_beyond,
    frozen,
    out_of_range,
    repeats,
)
from data_prep.log import Log
from narxcal.channels import described

DT = 1 / 32
COUNT = 9600


def engine(seed=0, noise=1.0, moves=True):
    """Five minutes of a noisy engine with a push and a pull, at 32 Hz."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(COUNT) * DT
    power = 0.5 * (np.tanh((time_s - 100) / 2) - np.tanh((time_s - 200) / 2)) * moves
    hiss = rng.normal(0, noise, (6, COUNT))
    channels = {
        "TRA_deg": 20 + 45 * power,
        "ALT_ft": 10000 + 5 * time_s + hiss[0],
        "Mach": 0.5 + 1e-4 * time_s + 0.0005 * hiss[1],
        "WOW": np.zeros(COUNT),
        "N1_pct": 50 + 40 * power + 0.05 * hiss[2],
        "N2_pct": 70 + 25 * power + 0.05 * hiss[3],
        "EGT_C": 500 + 300 * power + 1.5 * hiss[4],
        "FF_kgph": 400 + 1000 * power + 3 * hiss[5],
    }
    return Log("flight:left", time_s, channels)


def broken(log, channel, start, stop, value):
    values = log[channel].copy()
    values[start:stop] = value
    return log.with_channels({channel: values})


def masked(log):
    return clean(log).audit.masked()


OUTPUTS = ["N1_pct", "N2_pct", "EGT_C", "FF_kgph"]


def paused(log, channels, start, stop, value=None):
    """Channels that repeat a value, their own by default."""
    for name in channels:
        log = broken(log, name, start, stop, log[name][start] if value is None else value)
    return log


def coarse(log):
    return log.with_channels({name: np.round(values) for name, values in log.channels.items()})


def only(log, name):
    return Log(log.name, log.time_s, {name: log[name]})


OTHER = engine().with_channels({"P3_bar": engine()["N2_pct"] / 10})
MASKED = {
    "nothing of a sound engine": (engine(), {}),
    "nothing of one that rests": (engine(moves=False), {}),
    "a recorder that dropped everything": (
        paused(engine(), OUTPUTS, 4000, 4100, 0.0),
        {name: {"out of range": 100} for name in OUTPUTS},
    ),
    "a dropout during a slam": (
        broken(engine(), "N1_pct", 3160, 3256, 0.0),
        {"N1_pct": {"out of range": 96}},
    ),
    "fuel flow at zero while the spools run": (
        broken(engine(), "FF_kgph", 7000, 8000, 0.0),
        {"FF_kgph": {"out of range": 1000}},
    ),
    "no constant within the resolution": (broken(coarse(engine()), "N2_pct", 3160, 3560, 71.0), {}),
    "no levers and air data at rest": (
        paused(engine(), ("TRA_deg", "ALT_ft", "Mach"), 2000, 8000),
        {},
    ),
    "no pause of the whole recording": (
        paused(engine(), ("ALT_ft", "Mach", *OUTPUTS), 1000, 2000),
        {},
    ),
    "a lone channel by itself": (
        broken(only(engine(), "N1_pct"), "N1_pct", 1000, 2000, 50.0),
        {"N1_pct": {"frozen": 1000}},
    ),
    "no short freeze": (paused(engine(), ("N1_pct",), 1000, 1060), {}),
    "equal samples across missing ones": (
        broken(broken(engine(), "N1_pct", 1000, 2000, 50.0), "N1_pct", 1200, 1300, np.nan),
        {"N1_pct": {"frozen": 900}},
    ),
    "a channel outside the table": (
        broken(OTHER, "P3_bar", 1000, 2000, 7.0),
        {"P3_bar": {"frozen": 1000}},
    ),
}


@pytest.mark.parametrize(("log", "lost"), MASKED.values(), ids=MASKED)
def test_what_is_masked_and_what_never(log, lost):
    assert masked(log) == lost


@pytest.mark.parametrize("channel", OUTPUTS)
@pytest.mark.parametrize("start", [1000, 3100, 5000])
def test_a_frozen_channel_is_masked_for_its_time_and_only_it(channel, start):
    log = engine()
    bad = broken(log, channel, start, start + 1280, log[channel][start])
    cleaned = clean(bad)
    assert cleaned.audit.masked() == {channel: {"frozen": 1280}}
    assert np.isnan(cleaned[channel][start : start + 1280]).all()
    (entry,) = [e for e in cleaned.audit.entries if e.action == "masked"]
    np.testing.assert_allclose(entry.spans_s, [(start * DT, (start + 1280) * DT)], atol=DT)
    for other in log.channels:
        if other != channel:
            np.testing.assert_array_equal(cleaned[other], clean(log)[other])


@pytest.mark.parametrize("channel", OUTPUTS)
@pytest.mark.parametrize("level", [0.0, 9999.0])
@pytest.mark.parametrize("seconds", [3, 30])
def test_a_dropout_or_an_overflow_is_out_of_range(channel, level, seconds):
    bad = broken(engine(), channel, 3000, 3000 + 32 * seconds, level)
    assert masked(bad) == {channel: {"out of range": 32 * seconds}}


@pytest.mark.parametrize(("channel", "size"), [("EGT_C", 200.0), ("N1_pct", 20.0), ("ALT_ft", 4e3)])
@pytest.mark.parametrize("share", [0.1, 0.3, 0.5])
def test_a_burst_of_spikes_is_masked_as_a_whole(channel, size, share):
    rng = np.random.default_rng(5)
    log = engine()
    values = log[channel].copy()
    hit = 3000 + np.flatnonzero(rng.random(640) < share)
    values[hit] += size * rng.uniform(0.5, 1.5, len(hit)) * rng.choice([-1, 1], len(hit))
    cleaned = clean(log.with_channels({channel: values}))
    touched = cleaned[channel] != values
    assert touched[hit].mean() > 0.98
    assert list(cleaned.audit.masked()) == [channel]
    assert list(cleaned.audit.masked()[channel]) == ["spiking"]
    assert cleaned.audit.masked()[channel]["spiking"] > 580
    assert not np.isnan(cleaned[channel][:2990]).any()
    assert not np.isnan(cleaned[channel][3650:]).any()


@settings(max_examples=15)
@given(seed=st.integers(0, 1000), step=st.sampled_from([0.0, 0.001, 0.02]))
def test_a_simulation_without_noise_may_rest_for_minutes(seed, step):
    log = engine(seed, noise=0.0)
    if step:
        log = log.with_channels({n: np.round(log[n] / step) * step for n in ("N1_pct", "N2_pct")})
    assert masked(log) == {}


def test_a_flame_out_is_no_sensor_fault():
    """Fuel is cut, the spools run down, the metal cools: every channel tells the truth."""
    log = engine()
    after = np.maximum(log.time_s - 230, 0)
    decay = np.exp(-after / 4)
    out = log.with_channels(
        {
            "FF_kgph": np.where(after > 0, 0.0, log["FF_kgph"]),
            "N1_pct": np.round(log["N1_pct"] * decay, 2),
            "N2_pct": np.round(log["N2_pct"] * decay, 2),
            "EGT_C": np.round(30 + (log["EGT_C"] - 30) * np.exp(-after / 30), 1),
        }
    )
    assert masked(out) == {}


def test_a_relight_within_the_minute_is_no_sensor_fault_either():
    log = engine()
    time_s = log.time_s
    cut = (time_s > 230) & (time_s < 260)
    fall = np.where(time_s > 260, np.exp(-(time_s - 260) / 4), 1 - np.exp(-(time_s - 230) / 4))
    spool = log["N1_pct"] * (1 - 0.9 * np.clip(np.where(time_s > 230, fall, 0), 0, 1))
    out = log.with_channels({"FF_kgph": np.where(cut, 0.0, log["FF_kgph"]), "N1_pct": spool})
    assert masked(out) == {}


def test_exponential_exposures_are_expected_as_often_as_the_distribution_says():
    draw = np.random.default_rng(2).exponential(3.0, 20_000)
    far = np.r_[draw, 60.0]
    assert expected_beyond(far, far)[-1] == pytest.approx(20_000 * np.exp(-20.0), rel=2.0)
    assert (expected_beyond(draw, draw) < 0.01).sum() == 0


def test_few_runs_show_no_tail():
    few = np.array([1.0, 1.0, 900.0])
    assert np.isinf(expected_beyond(few, few)).all()


def test_physical_limits_hold_with_some_slack():
    mach = np.array([-4e-6, 0.0, 1.2, 1.3, -0.1, np.nan])
    outside = [False] * 3 + [True] * 2 + [False]
    assert out_of_range(described("Mach"), mach).tolist() == outside
    switch = np.array([0.0, 0.5, 1.0, 2.0])
    assert out_of_range(described("WOW"), switch).tolist() == [False] * 3 + [True]
    assert out_of_range(described("own"), np.array([1e30, np.inf])).tolist() == [False, True]


@given(values=st.lists(st.sampled_from([1.0, 2.0, np.nan]), max_size=40))
def test_runs_of_equal_samples_match_a_slow_twin(values):
    values = np.array(values, dtype=float)
    expected, last = [], None
    for index in np.flatnonzero(np.isfinite(values)).tolist():
        if last is not None and values[index] == last:
            expected[-1][1] = index + 1
        else:
            expected.append([index, index + 1])
        last = values[index]
    starts, stops = repeats(values)
    assert [list(pair) for pair in zip(starts.tolist(), stops.tolist(), strict=True)] == expected


def test_long_excursions_are_beyond_the_limit_that_a_config_sets():
    bad = broken(engine(), "EGT_C", 3000, 3320, 0.0)
    assert excursions(bad, "EGT_C", FaultsConfig()) == [(3000, 3320)]
    assert excursions(bad, "EGT_C", FaultsConfig(excursion_s=5.0)) == []


def test_frozen_time_is_configurable():
    bad = broken(engine(), "N1_pct", 1000, 2000, 50.0)
    patient = CleanConfig(faults=FaultsConfig(frozen_s=60.0))
    assert clean(bad, patient).audit.masked() == {}
    assert not frozen(bad, "N1_pct", patient.faults).any()


@pytest.mark.parametrize("count", [0, 1, 2, 3, 50])
def test_tiny_or_empty_channels_pass_through(count):
    nothing = np.full(count, np.nan)
    log = Log("f", np.arange(count) * DT, {"N1_pct": nothing, "EGT_C": np.full(count, 500.0)})
    cleaned = clean(log)
    assert cleaned.audit.entries == ()
    np.testing.assert_array_equal(cleaned["N1_pct"], nothing)


@pytest.mark.parametrize("sizes", [(100, -100), (100, 100), (-80, -120), (90, -60)])
@pytest.mark.parametrize("apart", [1, 2, 7])
def test_good_samples_between_two_spikes_are_not_taken_for_the_fault(sizes, apart):
    log = engine(moves=False)
    truth = log["EGT_C"]
    values = truth.copy()
    values[4000] += sizes[0]
    values[4000 + apart] += sizes[1]
    cleaned = clean(log.with_channels({"EGT_C": values}))
    assert cleaned.audit.masked() == {}
    near = slice(3990, 4020)
    assert np.abs(cleaned["EGT_C"][near] - truth[near]).max() < 10


@pytest.mark.parametrize(("level", "rests"), [(1040.0, True), (1300.0, True), (1300.0, False)])
def test_a_coarse_channel_at_idle_is_not_stuck(level, rests):
    """Pressure of a piston engine: constant where lever, load and speed are, at its stop or not."""
    draw, time_s = np.random.default_rng(0), np.arange(900.0)
    lever = np.where((time_s < 230) | (time_s > 700), 0.0, 40.0 + 30.0 * np.sin(time_s / 9.0))
    moved = lever if rests else 40.0 + 30.0 * np.sin(time_s / 9.0)
    noise = np.where(lever > 0.0, 6.0, 0.0) * draw.standard_normal(900)
    channels = {
        "TRA_deg": moved,
        "Load_pct": moved,
        "NP_rpm": np.round(705.0 + 20.0 * moved + 2.0 * draw.standard_normal(900)),
        "MAP_kPa": np.round(level + (10.0 if level < 1200.0 else -3.0) * lever + noise) / 10.0,
    }
    stuck = frozen(Log("run", time_s, channels), "MAP_kPa", FaultsConfig())
    assert stuck.any() != rests
