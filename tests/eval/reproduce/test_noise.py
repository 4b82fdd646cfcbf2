"""The noise experiment: what is added is what was asked for, and fusing pays at every ratio."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

from eval.reproduce.noise import Flight, noisy, snr_sweep, summarise

FLIGHTS = Path(__file__).parents[3] / "../shared/data/flights"
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


def test_noise_has_the_ratio_asked_for():
    signal = 70.0 + 10.0 * np.sin(np.linspace(0.0, 60.0, 100_001))
    measured, deviation = noisy(signal, (30.0, 0))
    assert 10.0 * np.log10((70.0**2 + 50.0) / deviation**2) == pytest.approx(30.0, abs=0.05)
    assert np.std(measured - signal) == pytest.approx(deviation, rel=0.01)
    signal[::3] = np.nan
    assert noisy(signal, (30.0, 0))[1] == pytest.approx(deviation, rel=1e-2)


def beats_both(table):
    return (table["fused"] < table[["raw", "free_run"]].min(axis=1)).all()


def test_fused_beats_raw_and_free_run_at_every_ratio():
    ratios = (20.0, 30.0, 45.0)
    sweep = snr_sweep(synthetic(), ratios, (0, 1))
    assert beats_both(sweep)
    assert sweep["mean_nis"].between(sweep["nis_low"], sweep["nis_high"]).all()
    np.testing.assert_allclose(sweep["raw"], sweep["noise_sd"], rtol=0.05)
    table = summarise(sweep)
    assert table["snr_db"].tolist() == list(ratios)
    assert table["raw"][0] == pytest.approx(sweep["raw"][:2].mean())
    assert (np.diff(table["fused"]) < 0.0).all()
    assert (table["fed_fused"] < table["fed_raw"]).all()


def test_samples_without_a_truth_are_not_scored_and_do_no_harm():
    flight = synthetic()
    truth = flight.truth.copy()
    truth[2_000:2_400] = np.nan
    holed = Flight(NAMES, 0.1, truth, flight.free_run, flight.feed)
    table = snr_sweep(holed, (30.0,), (0,))
    whole = snr_sweep(flight, (30.0,), (0,))
    assert table["fused"][0] == pytest.approx(whole["fused"][0], rel=0.2)
    assert beats_both(table)


@pytest.mark.parametrize("name", ["20180312_flight1", "20190312_flight2"])
def test_fused_beats_both_on_measured_speeds_with_an_imperfect_model(name):
    file = FLIGHTS / f"citation_{name}.csv.gz"
    if not file.is_file():
        pytest.skip(f"the measured flight {file.name} is not there")
    raw = pd.read_csv(file, usecols=["lh_engine_turbine_N2"])["lh_engine_turbine_N2"].to_numpy()
    truth = np.convolve(np.pad(raw, 5, mode="edge"), np.ones(11) / 11, "valid")[:, None]
    flight = Flight(("N2_pct",), 0.1, truth, imperfect_model(truth[:, 0], 0)[:, None], np.copy)
    table = snr_sweep(flight, (20.0, 30.0, 45.0), (0,))
    assert (table["fused"] < 0.6 * table[["raw", "free_run"]].min(axis=1)).all()
