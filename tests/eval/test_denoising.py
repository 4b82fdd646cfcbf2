"""The noise experiment: what is added is what was asked for, and fusing pays at every ratio."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

from eval.denoising import Flight, SweepConfig, noise_deviation, snr_sweep, summarise
from narxcal.support.errors import ConfigError, DataError

FLIGHTS = Path(__file__).parents[2] / "../shared/data/flights"
NAMES = ("N1_pct", "N2_pct")


def imperfect_model(truth, seed, dt_s=0.1):
    """A free run with the errors of a real one: lag, wrong gain, drift, jumping offsets."""
    rng = np.random.default_rng(seed)
    keep = np.exp(-dt_s / 0.25)
    lagged = lfilter([1 - keep], [1, -keep], truth - truth[0]) + truth[0]
    drift = lfilter([0.001], [1, -0.999], np.cumsum(rng.normal(size=len(truth))))
    jumps = np.repeat(rng.normal(0, 0.4, len(truth) // 600 + 1), 600)[: len(truth)]
    drift *= 0.7 / max(drift.std(), 1e-9)
    return lagged + drift + np.convolve(jumps, np.ones(41) / 41, "same") + 0.03 * (lagged - 75.0)


def synthetic(samples=6_000, seed=0):
    rng = np.random.default_rng(seed)
    lever = np.repeat(rng.uniform(60.0, 95.0, samples // 200 + 1), 200)[:samples]
    n2 = lfilter([0.1], [1, -0.9], lever - lever[0]) + lever[0]
    truth = np.column_stack([n2 - 10.0, n2])
    free = np.column_stack([imperfect_model(truth[:, i], seed + i) for i in range(2)])

    def feed(measured):
        before = np.vstack([np.full((1, 2), np.nan), measured[:-1]])
        return before + 0.1 * (lever[:, None] - [[10.0, 0.0]] - before)

    return Flight(NAMES, 0.1, truth, free, feed)


@pytest.mark.parametrize("power", ["mean_square", "variance"])
def test_noise_has_the_ratio_asked_for(power):
    signal = 70.0 + 10.0 * np.sin(np.linspace(0.0, 60.0, 100_001))
    deviation = noise_deviation(signal, 30.0, power)
    strength = 70.0**2 + 50.0 if power == "mean_square" else 50.0
    assert 10.0 * np.log10(strength / deviation**2) == pytest.approx(30.0, abs=0.05)
    signal[::3] = np.nan
    assert noise_deviation(signal, 30.0, power) == pytest.approx(deviation, rel=1e-2)


@pytest.mark.parametrize("power", ["mean_square", "variance"])
def test_fused_beats_raw_and_free_run_at_every_ratio(power):
    sweep = snr_sweep(synthetic(), SweepConfig(power=power, seeds=(0, 1)))
    table = summarise(sweep)
    assert table["snr_db"].tolist() == [20, 25, 30, 35, 40, 45]
    assert table["beats_both"].all()
    assert table["consistent"].all()
    assert (np.diff(table["fused"]) < 0.0).all()
    np.testing.assert_allclose(sweep["raw"], sweep["noise_sd"], rtol=0.05)
    assert (table["fed_fused"] < table["fed_raw"]).all()


def test_samples_without_a_truth_are_not_scored_and_do_no_harm():
    flight = synthetic()
    truth = flight.truth.copy()
    truth[2_000:2_400] = np.nan
    holed = Flight(NAMES, 0.1, truth, flight.free_run, flight.feed)
    table = summarise(snr_sweep(holed, SweepConfig(snr_db=(30.0,), seeds=(0,))))
    whole = summarise(snr_sweep(flight, SweepConfig(snr_db=(30.0,), seeds=(0,))))
    assert table["fused"][0] == pytest.approx(whole["fused"][0], rel=0.2)
    assert table["beats_both"].all()


def test_same_seed_same_table_other_seed_other_noise():
    config = SweepConfig(snr_db=(25.0, 35.0), seeds=(3,))
    flight = synthetic(2_000)
    pd.testing.assert_frame_equal(snr_sweep(flight, config), snr_sweep(flight, config))
    other = snr_sweep(flight, SweepConfig(snr_db=(25.0, 35.0), seeds=(4,)))
    assert (other["raw"] != snr_sweep(flight, config)["raw"]).all()


def test_without_a_network_to_feed_the_rest_is_still_there():
    flight = synthetic(2_000)
    bare = Flight(flight.names, flight.dt_s, flight.truth, flight.free_run)
    sweep = snr_sweep(bare, SweepConfig(snr_db=(30.0,), seeds=(0,)))
    assert sweep[["fed_raw", "fed_fused"]].isna().all(axis=None)
    assert sweep["fused"].notna().all()


def test_one_lucky_seed_is_not_enough_to_beat_both():
    sweep = snr_sweep(synthetic(2_000), SweepConfig(snr_db=(30.0,), seeds=(0, 1)))
    sweep.loc[0, "fused"] = 100.0
    table = summarise(sweep)
    assert not table["beats_both"][0]
    assert table["fused_spread"][0] > 90.0


def test_an_unknown_channel_is_refused():
    with pytest.raises(DataError) as error:
        snr_sweep(synthetic(500), SweepConfig(channel="EGT_C"))
    assert str(error.value) == (
        "channel EGT_C: the flight has no such output. It has N1_pct, N2_pct"
    )


def test_a_channel_without_truth_is_refused():
    flight = synthetic(500)
    empty = Flight(NAMES, 0.1, np.full_like(flight.truth, np.nan), flight.free_run)
    with pytest.raises(DataError) as error:
        snr_sweep(empty)
    assert str(error.value) == "channel N2_pct: there is no truth to add noise to"


def test_a_power_that_does_not_exist_is_refused():
    with pytest.raises(ConfigError, match="key 'power': Input should be 'mean_square' or"):
        SweepConfig.parse({"power": "peak"})


@pytest.mark.parametrize("power", ["mean_square", "variance"])
@pytest.mark.parametrize("name", ["20180312_flight1", "20190312_flight2"])
def test_fused_beats_both_on_measured_speeds_with_an_imperfect_model(name, power):
    file = FLIGHTS / f"citation_{name}.csv.gz"
    if not file.is_file():
        pytest.skip(f"the measured flight {file.name} is not there")
    raw = pd.read_csv(file, usecols=["lh_engine_turbine_N2"])["lh_engine_turbine_N2"].to_numpy()
    truth = np.convolve(np.pad(raw, 5, mode="edge"), np.ones(11) / 11, "valid")
    flight = Flight(("N2_pct",), 0.1, truth[:, None], imperfect_model(truth, 0)[:, None])
    table = summarise(snr_sweep(flight, SweepConfig(power=power, seeds=(0,))))
    assert table["beats_both"].all()
    assert (table["fused"] < 0.6 * table[["raw", "free_run"]].min(axis=1)).all()
