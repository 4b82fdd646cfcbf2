"""Known faults of one sensor are found with their size inside the interval, nulls are nulls."""

from dataclasses import replace

import numpy as np
import pytest

from narxcal.effects import effect, respond
from tests.training.diagnosis.conftest import NOISE, recorded
from training.diagnosis.budget import interval, together
from training.diagnosis.dictionary import Dictionary
from training.diagnosis.fit import Frame
from training.diagnosis.layers import Layer, Setting, alike, further, stored_odds
from training.diagnosis.metric import Metric, assumed_variance
from training.diagnosis.nuisances import nuisances

NAMES = [
    f"{kind}:{channel}"
    for kind in ("time_skew", "sensor_lag", "sensor_bias", "sensor_drift", "sensor_gain")
    for channel in ("N1_pct", "N2_pct", "EGT_C")
]
PLANTED = {
    "time_skew:N2_pct": {"skew_s": 0.13},
    "sensor_lag:N1_pct": {"tau_s": 0.4},
    "sensor_gain:EGT_C": {"gain_pct": 4.0},
    "sensor_drift:N2_pct": {"rate_per_h": 20.0},
}
WHATEVER = replace(stored_odds(), enough=(-50.0, 0.0, 0.0, 0.0))  # whatever is found comes in


@pytest.fixture(name="dictionary", scope="module")
def given_dictionary(flights):
    return Dictionary([effect(name) for name in NAMES], flights, None)


def planted(flights, *names):
    y = flights.y
    for name in names:
        one = effect(name)
        own = [PLANTED[name].get(p.name, p.neutral) for p in one.parameters(flights.signals)]
        y = y + respond([(one, np.array([own]))], flights, None)[0] - flights.y
    return recorded(flights, y)


def frame_of(record):
    metric = Metric(record, assumed_variance(record))
    return Frame(record, metric, record.gap, nuisances(record))


@pytest.mark.parametrize("name", PLANTED)
def test_a_planted_fault_is_first_with_its_size_inside_the_interval(name, flights, dictionary):
    record = planted(flights, name)
    frame = frame_of(record)
    fits = [frame.refined(frame.fit(nodes), dictionary) for nodes in dictionary.nodes.values()]
    best = min(fits, key=lambda one: one.solved.cost)
    assert best.name == name
    joint = together(frame, [best])
    (key, size), *_ = PLANTED[name].items()
    place = [p.name for p in best.node.parameters].index(key)
    assert joint.theta[0][place] == pytest.approx(
        size, abs=max(3 * joint.spread[0][place], 0.03 * size)
    )


@pytest.mark.parametrize("bled", [("NAI",), ("ECS", "NAI")])
def test_a_bleed_has_the_parameters_of_the_switches_that_act(bled, flights):
    steps = np.arange(flights.u.shape[1])
    on = np.stack([(steps // 170 + f) % 2 for f in range(4)]), np.tile(steps // 230 % 2, (4, 1))
    u = np.concatenate([flights.u, np.stack(on, axis=-1)], axis=-1)
    names = ("TRA_deg", "ECS", "NAI")
    signals = replace(flights.signals, inputs=names, active=names)
    switched = replace(flights, signals=signals, u=u.astype(float))
    bleed = effect("bleed_extraction")
    parameters = bleed.parameters(signals)
    true = {f"{name}_EGT_C": 20.0 for name in bled}
    theta = np.array([[true.get(p.name, 0.0) for p in parameters]])
    dictionary = Dictionary([bleed], switched, AsItIs())
    frame = frame_of(recorded(switched, respond([(bleed, theta)], switched, None)[0]))
    found = frame.refined(frame.fit(dictionary.nodes[bleed.name]), dictionary)
    acting = {parameters[j].name.partition("_")[0] for j in found.node.free} - {"loss"}
    assert acting == {*bled}
    assert found.node.size == 3 * len(bled)
    values = dict(zip((p.name for p in parameters), found.theta, strict=True))
    assert values["NAI_EGT_C"] == pytest.approx(20.0, abs=1.0)


class AsItIs:
    """An engine that no load moves."""

    def run(self, flights, given, pace=None, _shift=None):
        return flights.y[np.arange(len(given if pace is None else pace.limit)) % len(flights.y)]


def test_the_shape_of_a_small_effect_is_found_too(flights):
    fuel = replace(flights, signals=replace(flights.signals, driver="FF_kgph"))
    soak = effect("heat_soak")
    names = [p.name for p in soak.parameters(fuel.signals)]
    theta = np.array([{"tau_s": 55.0, "share_EGT_C": -0.03}.get(name, 0.0) for name in names])
    frame = frame_of(recorded(fuel, respond([(soak, theta[None])], fuel, None)[0]))
    nodes = Dictionary([soak], fuel, None)
    found = frame.refined(frame.fit(nodes.nodes[soak.name]), nodes)
    assert dict(zip(names, found.theta, strict=True)) == {
        "tau_s": pytest.approx(55.0, rel=0.15),
        "rise_s": pytest.approx(0.0, abs=1.0),
        **{
            name: pytest.approx(value, abs=0.005)
            for name, value in zip(names[2:], theta[2:], strict=True)
        },
    }


def test_intervals_of_few_flights_that_differ_hold_the_true_size(flights, dictionary):
    random, inside, degrees = np.random.default_rng(7), [], []
    n2 = flights.signals.y("N2_pct")
    for seed in range(60):
        y = flights.y.copy()
        y[..., n2] *= 1.0 + 0.01 * (4.0 + random.normal(size=(4, 1)))
        frame = frame_of(recorded(flights, y, seed))
        joint = together(frame, [frame.fit(dictionary.nodes["sensor_gain:N2_pct"])])
        (value,), (spread,), (freedom,) = joint.theta[0], joint.spread[0], joint.freedom[0]
        _, low, high = interval(value, spread, -20.0, 20.0, freedom)
        inside.append(low <= 4.0 <= high)
        degrees.append(freedom)
    assert 3.0 <= min(degrees) <= max(degrees) < np.inf  # at least those of four flights
    assert sum(inside) >= 50  # 5 % point of 60 draws at 0.9


def test_an_interval_is_that_of_students_distribution():
    assert interval(0.0, 1.0, -9.0, 9.0, 3.0) == pytest.approx((0.0, -2.353, 2.353), abs=1e-3)
    assert interval(0.0, 1.0, -9.0, 9.0) == pytest.approx((0.0, -1.645, 1.645), abs=1e-3)
    assert interval(0.0, 1.0, -2.0, 1.0, 3.0) == (0.0, -2.0, 1.0)


def test_nothing_takes_anything_of_noise(flights, dictionary):
    frame = frame_of(recorded(flights, flights.y))
    before = frame.energy(frame.none)
    for nodes in dictionary.nodes.values():
        assert before - frame.energy(frame.fit(nodes).solved) < 0.01 * frame.floor


def test_two_faults_are_two_layers_and_their_shares_add_up(flights, dictionary):
    names = ("time_skew:N2_pct", "sensor_lag:N1_pct")
    record = planted(flights, *names)
    frame = frame_of(record)
    setting = Setting(record, assumed_variance(record), frame.nuisances, dictionary, stored_odds())
    first = frame.refined(frame.fit(dictionary.nodes[names[1]]), dictionary)
    layers, _ = further(setting, Layer(first, (), 0.0, 0.0), frame.energy(frame.none))
    assert {one.name for one in layers} == set(names)
    joint = together(frame, [one.single for one in layers])
    *effects, build, offsets = (each / record.span for each in joint.components())
    gap = record.gap / record.span
    assert ((gap - sum(effects)) ** 2).sum() < 0.2 * (gap**2).sum()
    assert ((gap - sum(effects) - build - offsets) ** 2).sum() <= (gap**2).sum()


@pytest.mark.parametrize(("times", "same"), [(60.0, NAMES[4:5]), (1.0, [])])
def test_what_flights_do_not_tell_apart_is_one_answer_and_never_added_up(flights, times, same):
    names = ("time_skew:N2_pct", "sensor_lag:N2_pct", "sensor_gain:EGT_C")
    nodes = Dictionary([effect(name) for name in names], flights, None)
    late = respond([(effect(names[0]), np.array([[0.1]]))], flights, None)[0]
    record = recorded(flights, late)  # with so many times the noise
    noise = (times - 1.0) * NOISE * np.random.default_rng(3).standard_normal(late.shape)
    record = replace(record, real=record.real + noise, noise=times * NOISE)
    frame = frame_of(record)
    fits = [frame.refined(frame.fit(each), nodes) for each in nodes.nodes.values()]
    assert alike(frame, fits[0], fits, nodes) == tuple(same)
    setting = Setting(record, assumed_variance(record), frame.nuisances, nodes, WHATEVER)
    layers, _ = further(setting, Layer(fits[0], (), 0.0, 0.0, tuple(same)), 1.0)
    assert not {*same} & {one.name for one in layers}


def test_no_effect_at_all_is_a_joint_fit_of_nuisances(flights):
    joint = together(frame_of(recorded(flights, flights.y)), [])
    assert joint.theta == ()
    assert joint.responses(joint.solved.x) == []


def joint_of(record, dictionary, name):
    frame = frame_of(record)
    return together(frame, [frame.fit(dictionary.nodes[name])])


def test_what_causes_do_in_a_flight_is_known_from_the_others(flights, dictionary):
    name = "sensor_gain:EGT_C"
    record = planted(flights, name)
    before = joint_of(record, dictionary, name).components()
    steps = record.real.shape[1]
    changed = record.real.copy()
    changed[0, steps // 2 :, 0] += 0.6 * np.sin(np.arange(steps - steps // 2) / 40.0)
    after = joint_of(replace(record, real=changed), dictionary, name).components()
    for own, other in zip(before[:-1], after[:-1], strict=True):
        assert other[0] == pytest.approx(own[0], abs=1e-9)  # effect and build, in that flight
    # Its offset in the second half is that of the first half, which is as it was.
    offsets, others = after[-1][0, :, 0], before[-1][0, :, 0]
    assert offsets[steps // 2 :] == pytest.approx(others[steps // 2 :], abs=1e-9)
    assert np.abs(offsets[: steps // 2] - others[: steps // 2]).max() > 0.01


def test_an_offset_of_one_flight_is_an_offset_in_both_of_its_halves(flights, dictionary):
    real = recorded(flights, flights.y).real.copy()
    real[1, :, 2] += 4.0
    record = replace(recorded(flights, flights.y), real=real)
    *_, build, offsets = joint_of(record, dictionary, "time_skew:N2_pct").components()
    level = (build + offsets)[..., 2].mean(axis=1)
    assert level == pytest.approx([0.0, 4.0, 0.0, 0.0], abs=0.5)
    assert offsets[1, :, 2].mean() > 3.0


def test_of_a_single_unit_components_are_those_of_its_own_fit(flights, dictionary):
    record = recorded(flights, flights.y)
    single = replace(record, unit=np.zeros_like(record.unit))
    joint = joint_of(single, dictionary, "time_skew:N2_pct")
    assert joint.left_out == ()
    assert joint.components()[0] == pytest.approx(joint.responses(joint.solved.x)[0])
