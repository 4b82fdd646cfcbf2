"""Bands are orthogonal, and the inner product leaves unknown samples and other units out."""

from dataclasses import replace

import numpy as np
import pytest

from tests.training.diagnosis.conftest import recorded
from training.diagnosis.metric import BLOCK, Metric, assumed_variance, bands_of


def test_energies_of_bands_add_up_to_that_of_the_signal():
    v = np.random.default_rng(0).normal(size=(2, 4 * BLOCK**3, 3))
    parts = bands_of(v, 4)
    energy = sum(BLOCK**b * (part**2).sum() for b, part in enumerate(parts))
    assert energy == pytest.approx((v**2).sum())
    assert [part.shape[1] for part in parts] == [4 * BLOCK ** (3 - b) for b in range(4)]


def test_one_band_is_the_weighted_product_of_known_samples(flights):
    record = recorded(flights, flights.y + 1.0)
    real = record.real.copy()
    real[0, :100, 1] = np.nan
    record = replace(record, real=real)
    metric = Metric(record, assumed_variance(record))
    rows = metric.whiten(record.gap[None])
    expected = (record.gap**2 / assumed_variance(record)[0]).sum(axis=(1, 2))
    assert metric.gram(rows, rows)[:, 0, 0] == pytest.approx(expected)
