"""Windows of an unlogged load: found where they are, and only there."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from narxcal.support.errors import DataError
from narxcal.turbofan import Unmodelled, VirtualEngine
from training.gap.window_search import Options
from training.gap.windows import find_windows

DT_S = 0.25
NOISE = np.array([0.1, 0.08, 1.5])  # N1, N2 in %, temperature in K
SHIFT = np.array([-0.8, -0.4, 12.0])


def coloured(seed, flights=3, duration_s=400.0):
    """AR(1) noise of 12 s, white noise, drift, and decays as metal that warms up leaves them."""
    random = np.random.default_rng(seed)
    steps = round(duration_s / DT_S)
    time = np.arange(steps) * DT_S
    phi = np.exp(-DT_S / 12.0)
    drive = random.standard_normal((flights, steps, 3)) * np.sqrt(1.0 - phi**2)
    noise = lfilter([1.0], [1.0, -phi], drive, axis=1)
    noise += 0.7 * random.standard_normal(noise.shape)
    for f in range(flights):
        noise[f] += 3.0 * random.standard_normal(3) * (time / duration_s)[:, None]
        for start in random.uniform(0.0, duration_s, round(duration_s / 120.0)):
            since = np.maximum(time - start, 0.0)
            soak = np.exp(-since / random.uniform(30.0, 120.0)) - np.exp(-since / 8.0)
            noise[f] += 2.0 * random.standard_normal(3) * soak[:, None]
    return noise * NOISE


def switched(flight_windows, steps):
    """What a load of SHIFT adds, which the engine takes up within a second or two."""
    time = np.arange(steps) * DT_S
    on = np.zeros((len(flight_windows), steps))
    for row, windows in zip(on, flight_windows, strict=True):
        for start, stop in windows:
            row[(time >= start) & (time < stop)] = 1.0
    kept = np.exp(-DT_S / 1.0)
    return lfilter([1.0 - kept], [1.0, -kept], on, axis=1)[..., None] * SHIFT


@pytest.mark.parametrize("seed", range(4))
def test_coloured_noise_holds_no_windows(seed):
    residual = coloured(seed)
    found = find_windows(
        residual, np.ones_like(residual), DT_S, Options(rising=2, seed=seed, draws=8)
    )
    assert found.found == ()
    assert not found.on.any()


@pytest.mark.parametrize("seed", range(2))
def test_windows_and_shift_are_those_of_the_load(seed):
    truth = [[(60.0, 160.0), (260.0, 330.0)], [(90.0, 130.0)], []]
    residual = coloured(10 + seed)
    residual += switched(truth, residual.shape[1])
    found = find_windows(
        residual, np.ones_like(residual) / NOISE**2, DT_S, Options(rising=2, draws=8)
    )
    windows = [[(w.start_s, w.stop_s) for w in found.found if w.flight == f] for f in range(3)]
    assert [len(row) for row in windows] == [2, 1, 0]
    for row, expected in zip(windows, truth, strict=True):
        np.testing.assert_allclose(np.array(row), np.array(expected), atol=1.5)
    assert found.gain > found.threshold > 0.0
    sizes = np.array([interval.value for interval in found.shift])
    np.testing.assert_allclose(sizes, SHIFT, rtol=0.15)
    for window in found.found:
        assert window.score > 0.0
        lows = np.array([interval.low for interval in window.shift])
        highs = np.array([interval.high for interval in window.shift])
        assert (lows < SHIFT + 2.0 * NOISE).all()
        assert (highs > SHIFT - 2.0 * NOISE).all()


def test_what_comes_and_goes_with_the_lever_is_no_load():
    truth = [[(60.0, 160.0), (260.0, 330.0)], [(90.0, 130.0)], []]
    residual = coloured(10)
    residual += switched(truth, residual.shape[1])
    time = np.arange(residual.shape[1]) * DT_S
    steady = np.ones(residual.shape[:2], dtype=np.bool_)
    for row, windows in zip(steady, truth, strict=True):
        for moved in (edge for window in windows for edge in window):
            row[(time >= moved - 1.0) & (time < moved + 8.0)] = False
    weights = np.ones_like(residual) / NOISE**2
    options = Options(rising=2, draws=4)
    assert find_windows(residual, weights, DT_S, options, steady).found == ()
    allowed = replace(options, at_rest=False)
    assert len(find_windows(residual, weights, DT_S, allowed, steady).found) >= 2
    assert len(find_windows(residual, weights, DT_S, options).found) == 3


def test_shapes_that_differ_are_refused():
    with pytest.raises(DataError, match="of one shape"):
        find_windows(np.zeros((1, 10, 3)), np.zeros((1, 10, 2)), DT_S)
    with pytest.raises(DataError, match="expected steady"):
        find_windows(
            np.zeros((1, 10, 3)), np.ones((1, 10, 3)), DT_S, steady=np.ones((2, 10), dtype=np.bool_)
        )


def test_an_unknown_residual_needs_weight_zero():
    residual = np.full((1, 10, 3), np.nan)
    with pytest.raises(DataError, match="not finite"):
        find_windows(residual, np.ones_like(residual), DT_S)
    assert find_windows(residual, np.zeros_like(residual), DT_S).found == ()


@pytest.mark.parametrize(("effect", "count"), [("unlogged_switch", 3), ("throttle_bias", 0)])
def test_virtual_flights_show_their_load_and_no_other_effect(effect, count):
    """Bleed at two places of the gas path of a component-level engine, lever governed."""
    windows = [((75.0, 108.0), (140.0, 215.0)), ((85.0, 155.0),)]
    size = {"unlogged_switch": {"bleed": 0.05}, "throttle_bias": {"bias_deg": 3.0}}[effect]
    random = np.random.default_rng(0)
    residual, steady = [], []
    for flight, own in enumerate(windows):
        given = {name: np.zeros(1920) for name in VirtualEngine("business_jet").input_names}
        lever = np.repeat([[40.0, 65.0, 25.0, 70.0], [60.0, 20.0, 75.0, 50.0]][flight], 480)
        given |= {"TRA_deg": lever, "ALT_ft": np.full(1920, 15000.0), "Mach": np.full(1920, 0.5)}
        told = Unmodelled(effect, size, own if effect == "unlogged_switch" else ())
        real = VirtualEngine("business_jet", unmodelled=[told]).simulate(given, DT_S / 2)
        sim = VirtualEngine("business_jet").simulate(given, DT_S / 2)
        names = ("N1_pct", "N2_pct", "EGT_C")
        gap = np.stack([(real[name] - sim[name])[::2] for name in names], axis=1)
        residual.append(gap + np.array([0.05, 0.05, 1.0]) * random.standard_normal(gap.shape))
        since = np.arange(960) % 240
        steady.append((since >= 40) | (np.arange(960) < 240))
    gap = np.array(residual)
    options = Options(rising=2, draws=4)
    found = find_windows(gap, np.ones_like(gap), DT_S, options, np.array(steady))
    assert len(found.found) == count
    times = [time for own in windows for time in own][: len(found.found)]
    for window, (start, stop) in zip(found.found, times, strict=True):
        assert window.start_s == pytest.approx(start, abs=2.5)
        assert window.stop_s == pytest.approx(stop, abs=2.5)
