"""Bands of frequency hold the energy where it is, and know what follows the lever."""

import numpy as np
import pytest

from eval.diagnosis.where import bands_of


def found_in(data):
    return bands_of(data, data.difference)


def test_a_wave_is_in_its_band_and_does_not_follow_the_lever(make_data):
    data = make_data()
    steps = np.arange(data.real.shape[1]) * data.flights.signals.dt_s
    data.real[..., 0] += np.sin(2.0 * np.pi * 0.5 * steps)
    bands = found_in(data)["N1_pct"]
    assert [band.low_hz for band in bands] == [0.0, 0.03, 0.1, 0.3, 1.0]
    assert bands[-1].high_hz == pytest.approx(4.0)
    assert bands[3].share > 0.95
    assert sum(band.share for band in bands) == pytest.approx(1.0)
    assert bands[3].coherence < 0.2


def test_a_lagging_probe_is_slow_and_follows_the_lever(make_data, probe):
    bands = found_in(make_data(probe))["EGT_C"]
    assert sum(band.share for band in bands[:3]) > 0.7
    assert max(band.coherence for band in bands) > 0.8


def test_unknown_samples_are_bridged(make_data, probe):
    data = make_data(probe)
    data.real[:, 100:110, 2] = np.nan
    assert all(np.isfinite(band.share) for band in found_in(data)["EGT_C"])


def test_intervals_hold_the_share_and_come_from_flights(make_data, probe):
    bands = found_in(make_data(probe))["EGT_C"]
    assert all(band.low <= band.share <= band.high for band in bands)
    largest = max(bands, key=lambda band: band.share)
    assert largest.high - largest.low < 0.2
    assert bands == found_in(make_data(probe))["EGT_C"]


def test_of_one_flight_no_share_is_sure(make_data, probe):
    bands = found_in(make_data(probe, flights=1))["EGT_C"]
    assert {(band.low, band.high) for band in bands} == {(0.0, 1.0)}


def test_a_wave_in_one_flight_of_four_is_unsure(make_data):
    data = make_data()
    steps = np.arange(data.real.shape[1]) * data.flights.signals.dt_s
    data.real[..., 0] += np.sin(2.0 * np.pi * 0.05 * steps)
    data.real[0, :, 0] += 2.0 * np.sin(2.0 * np.pi * 0.5 * steps)
    band = found_in(data)["N1_pct"][3]
    assert band.low < 0.05
    assert 0.4 < band.share < band.high
