"""Rest records, and what a network learns from them."""

import numpy as np

from narxcal.narx.config import NarxConfig
from narxcal.record import Record
from training.config import TrainConfig
from training.network import Material, fit_narx
from training.records import rest_records


def moving_record(seed=0, steps=600):
    rng = np.random.default_rng(seed)
    ss = np.repeat(rng.uniform(0, 1, steps // 30), 30)
    y = np.zeros(steps)
    rise = np.diff(ss, prepend=ss[0])
    for k in range(1, steps):
        y[k] = 0.9 * (y[k - 1] + rise[k])
    return Record(np.column_stack([rise, ss]), y)


def test_a_rest_record_stands_still_starts_displaced_and_ends_at_zero():
    record = moving_record()
    drawn = rest_records([record], moving=1, steps=40, seed=3)
    assert len(drawn) == 60
    for rest in drawn:
        assert (rest.u[:, 0] == 0.0).all()
        assert (rest.u == rest.u[0]).all()
        assert np.isfinite(rest.y[0]).all()
        assert np.isnan(rest.y[1:30]).all()
        assert (rest.y[30:] == 0.0).all()
    assert any(abs(rest.y[0, 0]) > 0.1 for rest in drawn)


def test_the_same_seed_draws_the_same_records():
    record = moving_record()
    one, other = (rest_records([record], 1, 20, seed=7) for _ in range(2))
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a.u, b.u)
        np.testing.assert_array_equal(a.y, b.y)


def test_rest_records_take_part_only_where_the_horizon_holds_them():
    record = moving_record()
    material = Material([record], [], 1.0, rest_records([record], 1, 40, seed=0))
    assert len(material.within(20.0)) == 1
    assert len(material.within(40.0)) == 61
    assert len(material.within(0.0)) == 61


def test_a_network_shown_rest_comes_to_rest_from_a_deviation_no_flight_had():
    record = moving_record()
    rest = rest_records([record], 1, 60, seed=0)
    config = TrainConfig(horizons_s=(60.0,), iterations=(15,), score_every_s=1.0)
    structure = NarxConfig(lags=1, taps=(0,), hidden=4, moving=1)
    model = fit_narx(Material([record], [], 1.0, rest), structure, config).model
    low, high = model.bounds
    for start in (0.9 * low, 0.9 * high):
        for level in (0.0, 0.5, 1.0):
            y = model.simulate(np.tile([0.0, level], (300, 1)), start)
            assert abs(y[-1, 0]) < 0.02
