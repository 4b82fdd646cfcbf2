"""An unlogged load: its windows are found where they are, and what only looks like them is not."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from narxcal.effects import Flights, Signals
from narxcal.effects.running import with_load
from narxcal.effects.sensor_side import SensorDrift
from narxcal.effects.steady import UNLOGGED, BleedExtraction, HeatSoak, UnloggedSwitch
from narxcal.turbofan import Unmodelled, VirtualEngine
from training.gap import diagnosis as module
from training.gap.diagnosis import diagnose
from training.gap.fitting import Problem, fit
from training.gap.load_checks import as_the_lever
from training.gap.quadratic import misfit
from training.gap.unlogged import (
    find_known_load,
    find_load,
    has_load,
    priced,
    witnesses,
)
from training.gap.work import Options, Simulators

DT_S, STEPS = 0.25, 1400
INPUTS, OUTPUTS = ("TRA_deg", "ALT_ft", "NAI"), ("N1_pct", "N2_pct", "EGT_C")
NOISE = np.array([0.03, 0.03, 0.5])
SHIFT = np.array([-0.3, -0.4, 9.0])
WINDOWS = [
    [(62.0, 120.0), (223.0, 301.0)],
    [(41.0, 97.0)],
    [(110.0, 158.0), (262.0, 318.0)],
    [],
]
TIME = np.arange(STEPS) * DT_S


def flown():
    """Four flights: the lever at a new place every 25 s, climbing, with anti-ice switched."""
    random = np.random.default_rng(5)
    u = np.zeros((4, STEPS, 3))
    u[..., 0] = np.repeat(random.uniform(5.0, 80.0, (4, STEPS // 100)), 100, axis=1)
    u[..., 1] = random.uniform(0.0, 2e4, 4)[:, None] + 30.0 * TIME
    for f, row in enumerate(u[..., 2]):
        row[(70.0 + 20.0 * f < TIME) & (190.0 + 7.0 * f > TIME)] = 1.0
    kept = np.exp(-DT_S / 1.2)
    share = lfilter([1.0 - kept], [1.0, -kept], u[..., 0] - u[:, :1, 0], axis=1) + u[:, :1, 0]
    y = np.array([25.0, 55.0, 400.0]) + share[..., None] / 80.0 * np.array([75.0, 45.0, 350.0])
    signals = Signals(
        INPUTS, OUTPUTS, DT_S, "TRA_deg", y.min((0, 1)), y.max((0, 1)), (0.0, 80.0), INPUTS
    )
    return Flights(signals, u, y, np.full(4, STEPS))


FLIGHTS = flown()


def on_in(windows):
    on = np.zeros((len(windows), STEPS))
    for row, own in zip(on, windows, strict=True):
        for start, stop in own:
            row[(start <= TIME) & (stop > TIME)] = 1.0
    return on


def shifted(on, shift=SHIFT):
    kept = np.exp(-DT_S)
    return lfilter([1.0 - kept], [1.0, -kept], on, axis=1)[..., None] * shift


def recorded(change=0.0, seed=0):
    """Noise with some colour, an offset and a slope over power of each flight, and the change."""
    random = np.random.default_rng(seed)
    colour = lfilter([0.2], [1.0, -0.97], random.standard_normal((4, STEPS, 3)), axis=1)
    power = FLIGHTS.signals.power(FLIGHTS.y)[..., None]
    scatter = 6.0 * random.standard_normal((4, 1, 3)) + 4.0 * random.standard_normal(3) * power
    noise = random.standard_normal((4, STEPS, 3)) + colour + scatter
    return FLIGHTS.y + NOISE * noise + change


def load_in(real, groups=(), flights=FLIGHTS):
    return find_load(flights, misfit(flights, real, NOISE), groups)


@pytest.mark.parametrize("seed", range(3))
def test_windows_are_found_with_times_and_sizes(seed):
    found = load_in(recorded(shifted(on_in(WINDOWS)), seed))
    assert found.reason == ""
    told = [[(w.start_s, w.stop_s) for w in found.windows if w.flight == f] for f in range(4)]
    assert [len(own) for own in told] == [2, 1, 2, 0]
    for own, expected in zip(told, WINDOWS, strict=True):
        np.testing.assert_allclose(np.array(own), np.array(expected), atol=1.5)
    for window in found.windows:
        sizes = np.array([each.value for each in window.shift])
        assert (np.abs(sizes - SHIFT) < 4.0 * NOISE).all()
        assert window.start_span_s[0] <= window.start_s <= window.start_span_s[1]
        assert window.stop_span_s[0] <= window.stop_s <= window.stop_span_s[1]
    np.testing.assert_array_equal(found.price > 0.0, [True, True, True, False])


@pytest.mark.parametrize("seed", range(4))
def test_noise_and_build_scatter_hold_no_load(seed):
    found = load_in(recorded(seed=seed))
    assert found.windows == ()
    assert found.reason
    assert not found.on.any()
    assert not found.price.any()


@pytest.mark.parametrize(("fan", "load"), [(1.0, False), (-0.3, True), (0.0, True)])
def test_what_shifts_all_outputs_as_the_lever_does_is_no_load(fan, load):
    """A lever that sticks for a minute arrives a degree higher; N1 that is held tells a load."""
    shift = np.array([75.0 * fan, 45.0, 350.0]) / 60.0
    found = load_in(recorded(shifted(on_in(WINDOWS), shift)))
    assert len(found.windows) == (5 if load else 0)
    assert found.reason == (
        ""
        if load
        else "all outputs are shifted as by a move of the driver: it arrives elsewhere, no load"
    )


def test_only_both_speeds_tell_a_lever_from_a_load():
    signals = replace(FLIGHTS.signals, outputs=("Nf_pct", "N2_pct", "EGT_C"))
    shift = np.array([75.0, 45.0, 350.0])
    assert as_the_lever(shift, FLIGHTS)
    assert not as_the_lever(shift, replace(FLIGHTS, signals=signals))


def test_engines_of_one_aircraft_share_their_windows():
    twins = replace(
        FLIGHTS, u=np.repeat(FLIGHTS.u[:2], 2, axis=0), y=np.repeat(FLIGHTS.y[:2], 2, axis=0)
    )
    on = np.repeat(on_in(WINDOWS[:2]), 2, axis=0)
    real = recorded()[[0, 1, 2, 3]] - FLIGHTS.y + twins.y + shifted(on)
    found = load_in(real, [(0, 1), (2, 3)], twins)
    times = [[(w.start_s, w.stop_s) for w in found.windows if w.flight == f] for f in range(4)]
    assert times[0] == times[1]
    assert times[2] == times[3]
    assert len(times[0]) == 2


def cycle(windows=((89.0, 120.0), (179.0, 210.0), (269.0, 300.0))):
    return [list(windows)] * 4


LEVER = [[(50.25, 100.0), (200.25, 250.0)], [(75.25, 125.0)], [(25.25, 75.0)], [(150.25, 200.0)]]
SWITCH = [[(70.0 + 20.0 * f, 190.0 + 7.0 * f)] for f in range(4)]


@pytest.mark.parametrize(
    ("windows", "shift", "reason"),
    [
        (SWITCH, SHIFT, "logged switch"),
        ([[(0.0, 30.0), *own] for own in cycle()], SHIFT, "by the clock"),
        (WINDOWS, [0.0, 0.0, 9.0], "one channel alone"),
        (LEVER, SHIFT, "with the lever"),
        ([WINDOWS[0], [], [], []], SHIFT, "one flight alone"),
    ],
)
def test_what_comes_otherwise_is_no_unlogged_load(windows, shift, reason):
    found = load_in(recorded(shifted(on_in(windows), np.array(shift))))
    assert found.windows == ()
    assert reason in found.reason


@pytest.mark.slow
def test_a_second_channel_that_hardly_answers_is_heard_at_the_edges():
    """A control that holds N1: the load is a thousand squares of noise in EGT, and few in N2."""
    on, reasons = on_in(WINDOWS), []
    for n2_pct in (0.1, 0.0):
        shift = np.array([0.0, n2_pct, 9.0])
        reasons.append([load_in(recorded(shifted(on, shift), seed)).reason for seed in range(8)])
    held, alone = reasons
    assert held == [""] * 8
    assert sum("one channel alone" in reason for reason in alone) >= 7


def test_a_drift_is_no_load():
    found = load_in(recorded(0.1 * SHIFT * TIME[:, None] / 10.0))
    assert found.windows == ()


def test_the_claimed_size_finds_the_windows_of_other_flights():
    real = recorded(shifted(on_in(WINDOWS)), 7)
    found = find_known_load(FLIGHTS, misfit(FLIGHTS, real, NOISE), SHIFT)
    assert (found.on != on_in(WINDOWS)).mean() < 0.02
    none = find_known_load(FLIGHTS, misfit(FLIGHTS, recorded(), NOISE), SHIFT)
    assert not none.on.any()


def test_windows_of_a_switch_that_is_half_on_for_a_sample_are_its_own():
    """On a raster of block means a switch changes in two steps of a half each."""
    flights = with_load(FLIGHTS, on_in(WINDOWS))
    column = np.array(flights.u[..., -1:])
    half = np.maximum(column, np.roll(column, -1, axis=1) * 0.5)
    signals = replace(FLIGHTS.signals, inputs=(*INPUTS, "WAI"), active=(*INPUTS, "WAI"))
    told = replace(FLIGHTS, signals=signals, u=np.concatenate([FLIGHTS.u, half], axis=2))
    assert set(np.unique(half)) == {0.0, 0.5, 1.0}
    found = load_in(recorded(shifted(on_in(WINDOWS))), (), told)
    assert found.reason == "the windows follow a logged switch"


def test_the_windows_are_an_input_that_the_effect_acts_through():
    flights = with_load(FLIGHTS, on_in(WINDOWS))
    assert flights.signals.inputs[-1] == flights.signals.active[-1] == UNLOGGED
    assert UnloggedSwitch().applies(flights.signals)
    off = np.zeros((4, STEPS))
    assert with_load(FLIGHTS, off) is FLIGHTS
    assert with_load(FLIGHTS, off, always=True).u.shape == flights.u.shape


class Unmoved:
    """An emulator of an engine that is the same at any pace, however it is loaded."""

    def run(self, flights, told, pace=None, _shift=None):
        rows = np.arange(len(told if pace is None else pace[0])) % len(flights.y)
        return flights.y[rows]


def test_the_price_is_paid_by_the_load_alone_and_flights_without_it_are_no_witnesses():
    flights = with_load(FLIGHTS, on_in(WINDOWS))
    real = recorded(shifted(on_in(WINDOWS)))
    tried = fit([UnloggedSwitch()], Problem(flights, Unmoved(), misfit(flights, real, NOISE)))
    price = np.array([3.0, 1.0, 2.0, 0.0])
    paid = priced(tried, price)
    assert has_load(tried)
    np.testing.assert_allclose(paid.held_out - tried.held_out, price)
    np.testing.assert_array_equal(witnesses(tried, price), [True, True, True, False])
    other = replace(tried, effects=())
    assert priced(other, price) is other
    assert witnesses(other, price).all()


def test_the_diagnosis_names_the_load_with_its_size(monkeypatch):
    rivals = (UnloggedSwitch(), BleedExtraction(), HeatSoak(), SensorDrift("EGT_C"))
    monkeypatch.setattr(module, "candidates", lambda _signals: rivals)
    real = recorded(shifted(on_in(WINDOWS)))
    found = load_in(real)
    told = with_load(FLIGHTS, found.on, found.price)
    answer = diagnose(told, (real, NOISE), Simulators(Unmoved()))
    assert answer.effects == ("unlogged_switch",), answer.reason
    size = answer.tried[0].parameters["unlogged_switch"]["on_EGT_C"]
    assert size.low < SHIFT[2] < size.high


VIRTUAL = [((60.0, 109.0), (170.0, 232.0)), ((45.0, 131.0),), ((98.0, 170.0), (205.0, 252.0))]


@pytest.fixture(scope="module")
def virtual_inputs():
    """Three flights of a business jet: the lever moves every 37 s, anti-ice is on in between."""
    random, steps = np.random.default_rng(1), 2240
    flown = []
    for f in range(3):
        given = {name: np.zeros(steps) for name in VirtualEngine("business_jet").input_names}
        lever = np.repeat(random.uniform(15.0, 75.0, 8), 296)[:steps]
        given |= {"TRA_deg": lever, "ALT_ft": np.full(steps, 1.2e4), "Mach": np.full(steps, 0.45)}
        given["NAI"][500 + 100 * f : 1500 + 60 * f] = 1.0
        flown.append(given)
    return flown


def simulated(inputs, unmodelled=()):
    engines = [VirtualEngine("business_jet", unmodelled=list(own)) for own in unmodelled]
    found = [e.simulate(u, DT_S / 2) for e, u in zip(engines, inputs, strict=True)]
    columns = [np.stack([each[name] for name in OUTPUTS], axis=1) for each in found]
    return np.stack([own.reshape(-1, 2, 3).mean(axis=1) for own in columns])


@pytest.mark.parametrize(
    ("effect", "size", "count"),
    [
        ("unlogged_switch", {"bleed": 0.04}, 5),
        ("bleed_extraction", {"share": 0.04}, 0),
        ("heat_soak", {"factor": 3.0}, 0),
        ("deterioration", {"hpt_efficiency_pct": 2.0, "hpc_efficiency_pct": 1.2}, 0),
    ],
)
def test_a_gas_path_shows_its_load_and_no_other_effect(effect, size, count, virtual_inputs):
    """Bleed at its place in a component-level engine, whose control answers it."""
    told = [
        [Unmodelled(effect, size, own if effect == "unlogged_switch" else ())] for own in VIRTUAL
    ]
    sim, real = simulated(virtual_inputs, [[]] * 3), simulated(virtual_inputs, told)
    real += np.array([0.05, 0.05, 1.0]) * np.random.default_rng(0).standard_normal(real.shape)
    u = np.stack([np.column_stack([own[name] for name in INPUTS])[::2] for own in virtual_inputs])
    limits = sim.min((0, 1)), sim.max((0, 1))
    signals = Signals(INPUTS, OUTPUTS, DT_S, "TRA_deg", *limits, (0.0, 80.0), ("TRA_deg", "NAI"))
    flights = Flights(signals, u, sim, np.full(3, sim.shape[1]))
    found = load_in(real, (), flights)
    assert len(found.windows) == count, found.reason
    times = [time for own in VIRTUAL for time in own][: len(found.windows)]
    for window, (start, stop) in zip(found.windows, times, strict=True):
        assert window.start_s == pytest.approx(start, abs=2.0)
        assert window.stop_s == pytest.approx(stop, abs=2.0)


def test_what_a_flight_without_the_load_has_does_not_speak_against_it(monkeypatch):
    monkeypatch.setattr(module, "candidates", lambda _signals: (UnloggedSwitch(), HeatSoak()))
    real = recorded(shifted(on_in(WINDOWS)))
    real[3, :, 2] += 9.0 * np.sin(TIME / 15.0)
    found = load_in(real)
    options = Options(unexplained=0.3)
    told = with_load(FLIGHTS, found.on, found.price)
    answer = diagnose(told, (real, NOISE), Simulators(Unmoved()), options)
    assert (answer.kind, answer.effects) == ("effects", ("unlogged_switch",)), answer.reason
    assert answer.left_share > options.unexplained
