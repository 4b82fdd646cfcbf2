"""Edges of a load's windows: where the gap says, and no surer than it can be."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from narxcal.effects import Flights, Signals
from training.gap.load_edges import Change, Heard, Moment, moments, taken
from training.gap.load_noise import noise_at_moves, restless
from training.gap.load_windows import _changes, _Span
from training.gap.quadratic import misfit
from training.gap.unlogged import find_load

DT_S, STEPS = 0.25, 1400
TIME = np.arange(STEPS) * DT_S
OUTPUTS = ("N1_pct", "N2_pct", "EGT_C")
NOISE, SHIFT = np.array([0.03, 0.03, 0.5]), np.array([-0.3, -0.4, 9.0])
WEAVING = [(100.0, 135.0), (220.0, 255.0), (40.0, 75.0), (150.0, 185.0)]
# One edge of every window is in the weaving of the lever, the other one at rest.
WINDOWS = [(117.0, 190.0), (160.0, 238.0), (62.0, 130.0), (90.0, 167.0)]
HIDDEN = [117.0, 238.0, 62.0, 167.0]


def followed(values, tau_s):
    kept = np.exp(-DT_S / tau_s)
    return lfilter([1.0 - kept], [1.0, -kept], values, axis=1)


def flown():
    """Four flights: the lever rests, goes elsewhere, and weaves for 35 s."""
    lever = np.empty((4, STEPS))
    for f, (start, stop) in enumerate(WEAVING):
        lever[f] = 30.0 + 30.0 * (20.0 + 7.0 * f < TIME) - 20.0 * (300.0 + 5.0 * f < TIME)
        weaves = (start <= TIME) & (stop > TIME)
        lever[f, weaves] += 8.0 * np.sin(2.0 * np.pi * (TIME[weaves] - start) / 7.0)
    share = followed(lever - lever[:, :1], 1.2) + lever[:, :1]
    y = np.array([25.0, 55.0, 400.0]) + share[..., None] / 80.0 * np.array([75.0, 45.0, 350.0])
    names = ("TRA_deg",)
    signals = Signals(
        names, OUTPUTS, DT_S, "TRA_deg", y.min((0, 1)), y.max((0, 1)), (0.0, 80.0), names
    )
    return Flights(signals, lever[..., None], y, np.full(4, STEPS))


FLIGHTS = flown()


def recorded(lag_s, seed):
    """The flights with the load, an engine a little slower than simulated, noise and offsets."""
    random = np.random.default_rng(seed)
    on = np.stack([(start <= TIME) & (stop > TIME) for start, stop in WINDOWS])
    load = followed(on.astype(np.float64), lag_s)[..., None] * SHIFT
    error = np.stack([followed(FLIGHTS.y[..., c] - FLIGHTS.y[:, :1, c], 0.1) for c in range(3)], 2)
    error -= FLIGHTS.y - FLIGHTS.y[:, :1]
    colour = lfilter([0.2], [1.0, -0.97], random.standard_normal((4, STEPS, 3)), axis=1)
    scatter = 6.0 * random.standard_normal((4, 1, 3))
    noise = random.standard_normal((4, STEPS, 3)) + colour + scatter
    return FLIGHTS.y + load + error + NOISE * noise


def edges_of(found):
    """Windows of the four flights, which have to be one of each, in pairs of an edge and a time."""
    assert [window.flight for window in found.windows] == [0, 1, 2, 3]
    pairs = []
    for window, (start, stop) in zip(found.windows, WINDOWS, strict=True):
        pairs.append((window.start_span_s, window.start_s, start))
        pairs.append((window.stop_span_s, window.stop_s, stop))
    return pairs


@pytest.mark.parametrize("lag_s", [0.5, 2.5])
def test_edges_are_where_they_were_also_within_moves_of_the_lever(lag_s):
    edges = edges_of(find_load(FLIGHTS, misfit(FLIGHTS, recorded(lag_s, 0), NOISE)))
    off = [abs(at - truth) for _, at, truth in edges]
    assert max(off) < 3.0
    assert np.median(off) < 0.5 * max(lag_s, 1.0)
    assert sum(low <= truth <= high for (low, high), _, truth in edges) >= 7
    for (low, high), at, _ in edges:
        assert 0.0 <= low <= at <= high <= STEPS * DT_S


def heard(unknown=()):
    """A change at 50.2 s in blocks of half a second, nothing known within `unknown`."""
    random = np.random.default_rng(4)
    ends = 0.5 * np.arange(1, 201)
    share = np.ones((1, 200, 2))
    for low, high in unknown:
        share[:, (ends > low) & (ends <= high)] = 0.0
    shift = np.array([1.0, -2.0])
    level = taken(ends - 50.2, (1.2, 0.6), 0.5)[None, :, None] * shift
    mean = level + 0.1 * random.standard_normal((1, 200, 2))
    return Heard(mean * share, share, np.zeros(1), shift, 0.5)


def test_what_nothing_is_known_of_may_hold_the_edge_anywhere():
    change, still = [Change((0,), 56.0, 1.0, 20.0, 90.0)], np.zeros((1, 200))
    (sharp,) = moments(heard(), change, still)
    assert sharp.low_s <= 50.2 <= sharp.high_s
    assert sharp.high_s - sharp.low_s < 5.0  # one edge alone hardly tells its shape
    (wide,) = moments(heard([(40.0, 60.0)]), change, still)
    assert wide.low_s < 43.0
    assert wide.high_s > 55.0
    assert moments(heard(), [], still) == []


def test_an_edge_lies_between_the_rests_that_the_path_knows():
    """A move 90 s before it, to another power, has another level, and is no switch."""
    known = np.ones((1, 400), dtype=bool)
    known[:, 80:110] = False
    searched = SimpleNamespace(
        flights=SimpleNamespace(signals=SimpleNamespace(dt_s=0.5), lengths=np.array([800])),
        measure=SimpleNamespace(gap=np.zeros((1, 800, 2))),
        levels=SimpleNamespace(known=known),
    )
    window = _Span((0,), Moment(100.0, 100.0, 100.0), Moment(200.0, 200.0, 200.0))
    found = _changes([window], searched)
    assert found[0, 1.0] == Change((0,), 100.0, 1.0, 65.0, 125.0)
    assert found[0, -1.0] == Change((0,), 200.0, -1.0, 185.0, 215.0)
    known[:] = False
    assert _changes([window], searched)[0, 1.0] == Change((0,), 100.0, 1.0, 50.0, 150.0)


def test_a_change_is_taken_up_by_two_lags_in_a_row():
    time = np.arange(0.0, 12.0, 0.001)
    step = 1.0 - (2.0 * np.exp(-time / 2.0) - 0.5 * np.exp(-time / 0.5)) / 1.5
    ends = np.array([-1.0, 0.25, 0.5, 3.0, 12.0])
    expected = [
        step[(time >= end - 0.5) & (time < end)].sum() * 0.001 / 0.5 if end > 0.0 else 0.0
        for end in ends
    ]
    np.testing.assert_allclose(taken(ends, (2.0, 0.5), 0.5), expected, atol=2e-3)


def test_noise_is_loud_where_the_lever_moves():
    moving = restless(FLIGHTS, 2)
    assert moving.shape == (4, STEPS // 2)
    weaves = (TIME[::2] > 105.0) & (TIME[::2] < 133.0)
    assert moving[0, weaves].min() > moving[0, (TIME[::2] > 160.0) & (TIME[::2] < 280.0)].max()
    random = np.random.default_rng(1)
    rest = random.standard_normal((4, STEPS // 2, 2)) * np.where(moving > -5.0, 5.0, 1.0)[..., None]
    loud = noise_at_moves(rest, np.ones_like(rest), moving).loud
    assert np.median(loud[moving > -5.0]) > 2.0 * np.median(loud[moving < -8.0])
