"""An unlogged load: its windows and shifts are recovered, and nothing is found where none is."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from narxcal.effects import effect
from narxcal.effects.operators import lag
from narxcal.effects.steady import FOLLOW_S
from tests.training.diagnosis.conftest import recorded
from training.diagnosis import load
from training.diagnosis.dictionary import Dictionary
from training.diagnosis.fit import Frame
from training.diagnosis.layers import Setting, features, stored_odds
from training.diagnosis.metric import Metric, assumed_variance
from training.diagnosis.nuisances import nuisances
from training.diagnosis.verdict import Evidence, Phases, concluded


def frame_of(record):
    return Frame(record, Metric(record, assumed_variance(record)), record.gap, nuisances(record))


@given(st.lists(st.floats(-5, 5), min_size=1, max_size=9), st.floats(0.0, 4.0))
def test_the_path_is_the_best_of_all_paths(gain, penalty):
    gain = np.array(gain)

    def value(path):
        return gain @ path - penalty * np.abs(np.diff([0, *path])).sum()

    best = max(value(path) for path in product((0, 1), repeat=len(gain)))
    assert value(load._viterbi(gain, penalty).astype(int)) == pytest.approx(best, abs=1e-9)


def test_windows_and_shifts_of_a_load_are_recovered(flights):
    on = np.zeros(flights.y.shape[:2], dtype=bool)
    on[0, 300:700], on[1, 100:420], on[2, 800:1100] = True, True, True
    shift = np.array([0.0, 0.8, 25.0])
    (found,) = load.found(frame_of(recorded(flights, flights.y + on[..., None] * shift)))
    assert (found.node.on != on).mean() < 0.01
    assert found.theta == pytest.approx(shift, rel=0.03, abs=0.03)
    assert found.node.switches == 6


def test_intervals_of_edges_hold_the_true_ones(flights):
    on = np.zeros(flights.y.shape[:2], dtype=bool)
    on[0, 301:703], on[1, 101:421] = True, True
    true = [[301, 703], [101, 421], [], []]
    follows = lag(on.astype(float), np.full(4, FOLLOW_S), 0.25)
    widths = []
    for size in (1.0, 0.2):
        shift = size * np.array([0.0, 0.8, 25.0])
        frame = frame_of(recorded(flights, flights.y + follows[..., None] * shift))
        (found,) = load.found(frame)
        edges = load.edges(frame, found)
        assert [len(each) for each in edges] == [len(each) for each in true]
        for ends, at in zip(edges, true, strict=True):
            assert all(low <= step <= high for (low, high), step in zip(ends, at, strict=True))
        widths.append(np.mean([high - low for ends in edges for low, high in ends]))
    assert max(widths) <= 8  # steps of a block of two seconds


def test_engines_of_one_flight_share_their_windows(flights):
    on = np.zeros(flights.y.shape[:2], dtype=bool)
    on[:2, 300:700] = on[2:, 100:420] = True
    loud = np.random.default_rng(3).normal(size=flights.y.shape) * np.array([0.4, 0.4, 8.0])
    record = recorded(flights, flights.y + loud + on[..., None] * np.array([0.0, 1.0, 20.0]))
    (alone,) = load.found(frame_of(record))
    (shared,) = load.found(frame_of(replace(record, group=(0, 0, 2, 2))))
    assert shared.node.switches == 4 < alone.node.switches
    assert (shared.node.on != on).mean() < 0.01
    assert (shared.node.on[0] == shared.node.on[1]).all()


def test_a_load_of_one_engine_alone_is_not_shared(flights):
    on = np.zeros(flights.y.shape[:2], dtype=bool)
    on[0, 300:700] = on[2, 100:420] = True
    record = recorded(flights, flights.y + on[..., None] * np.array([0.0, 0.8, 25.0]))
    (found,) = load.found(frame_of(replace(record, group=(0, 0, 2, 2))))
    assert (found.node.on != on).mean() < 0.01


def test_a_load_that_is_on_most_of_the_time_is_the_one_with_fewer_switches(flights):
    off = np.zeros(flights.y.shape[:2], dtype=bool)
    off[:, 500:700] = True
    record = recorded(flights, flights.y + off[..., None] * np.array([0.0, 0.8, 25.0]))
    (found,) = load.found(frame_of(record))
    assert (found.node.on == off).mean() > 0.99
    assert (found.theta[1:] > 0.0).all()


def test_windows_of_a_load_of_known_size_are_found_in_other_flights(flights):
    on = np.zeros(flights.y.shape[:2], dtype=bool)
    on[0, 300:700] = on[3, 100:420] = True
    shift = np.array([0.0, 0.8, 25.0])
    frame = frame_of(recorded(flights, flights.y + on[..., None] * shift))
    assert (load.windows_of(frame, shift) != on).mean() < 0.01
    assert not load.windows_of(frame_of(recorded(flights, flights.y)), shift).any()


def test_noise_alone_has_no_windows(flights):
    assert load.found(frame_of(recorded(flights, flights.y))) == []


def test_a_load_that_only_shows_beside_another_effect_is_in_the_answer(flights):
    on = np.zeros(flights.y.shape[:2], dtype=bool)
    on[0, 300:700], on[1, 100:420], on[2, 800:1100] = True, True, True
    late = np.concatenate([flights.y[:, :1].repeat(8, axis=1), flights.y[:, :-8]], axis=1)
    y = np.where([False, True, False], late, flights.y)
    record = recorded(flights, y + on[..., None] * np.array([0.0, 0.0, 3.0]))
    frame = frame_of(record)
    sensors = [effect(name) for name in ("time_skew:N2_pct", "sensor_lag:N1_pct")]
    dictionary = Dictionary(sensors, flights, None)
    singles = tuple(frame.fit(nodes) for nodes in dictionary.nodes.values())
    odds = replace(stored_odds(), enough=(-50.0, 0.0, 0.0, 0.0))  # whatever is found comes in
    variance = assumed_variance(record)
    setting = Setting(record, variance, frame.nuisances, dictionary, odds)
    evidence = Evidence(frame, singles, *features(frame, singles), setting)
    found = concluded(evidence, Phases(("steady",), np.zeros(on.shape, dtype=int)))
    assert "unlogged_switch" in found.verdict.effects
    assert (found.on != on).mean() < 0.1
    rows = {one.name: one.probability for one in found.effects}
    assert set(found.verdict.effects) <= set(rows)
    assert found.claimed.keys() == set(found.verdict.effects)
    assert sum(one.share for one in found.causes) == pytest.approx(1.0)


@pytest.mark.parametrize("rising", [True, False])
def test_intervals_of_an_edge_are_those_of_every_place_tried(rising):
    random = np.random.default_rng(4)
    n, lag, at = 120, 5.0, 50
    behind = np.maximum(np.arange(n)[None, :] - np.arange(n + 1)[:, None] + 1.0, 0.0)
    followed = 1.0 - np.exp(-behind / lag) if rising else np.exp(-behind / lag)
    shift, weight = np.array([0.5, -3.0]), random.uniform(0.01, 0.1, (n, 2))
    left = followed[at][:, None] * shift + random.normal(0.0, 3.0, (n, 2))
    cost = [float((weight * (left - own[:, None] * shift) ** 2).sum()) for own in followed]
    chance = np.exp(-0.5 * (np.array(cost) - min(cost)))
    total = np.cumsum(chance) / chance.sum()
    low, high = (int(np.searchsorted(total, level)) for level in (0.05, 0.95))
    found = load._edge((left, weight, shift, lag), 0, at, n, rising=rising)
    assert found == (min(low, at), max(high, at))
    assert high > low
