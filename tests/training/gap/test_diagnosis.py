"""The verdict: right effects are claimed, nulls and what is in no library are not."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from narxcal.effects import effect
from narxcal.effects.running import respond
from tests.training.gap.conftest import INPUTS, NOISE
from training.gap.diagnosis import _beyond, _least, diagnose
from training.gap.work import Options, Simulators

QUICK = Options()
ANOTHER = np.array([0.12, -0.2, 2.0])  # another build settles elsewhere


def answer(flights, engine, real):
    return diagnose(flights, (real, NOISE), Simulators(engine), QUICK)


@pytest.mark.parametrize(
    ("name", "theta"),
    [
        ("throttle_delay", [0.4]),
        ("throttle_backlash", [3.0]),
        ("sensor_lag:EGT_C", [1.2, 0.5]),
        ("time_skew:N2_pct", [0.5]),
        ("altitude_lag", [0.7]),
    ],
)
def test_a_single_effect_is_named_with_its_size(name, theta, flights, engine, recorded):
    found = answer(flights, engine, recorded({name: theta}))
    assert (found.kind, found.effects) == ("effects", (name,)), found.reason
    row = found.tried[0]
    value = next(iter(row.parameters[name].values()))
    assert value.low <= theta[0] * 1.02
    assert value.high >= theta[0] * 0.98
    assert found.predicted.value > 0.9
    assert found.left_share < 0.1
    assert row.probability >= found.tried[-1].probability


@pytest.mark.parametrize(("switched", "kind"), [(3, "effects"), (2, "effects"), (1, "unknown")])
def test_what_a_switch_does_is_named_if_it_moves_in_two_of_the_flights(
    switched, kind, flights, engine
):
    """Flights in which it does not move say nothing against it; one alone is no evidence."""
    u = flights.u.copy()
    u[switched:, :, INPUTS.index("NAI")] = 0.0
    own = replace(flights, u=u)
    setting = (effect("bleed_extraction"), np.array([[0.0, -0.6, 15.0, 0.0]]))
    real = respond([setting], own, engine)[0]
    found = answer(own, engine, real + NOISE * np.random.default_rng(4).normal(size=real.shape))
    assert found.kind == kind, found.reason
    assert found.tried[0].effects == ("bleed_extraction",)
    few = "% of it, but not in nearly all flights: 1 of 5 tell of it"
    assert found.reason.endswith(few) is (kind == "unknown")


def test_an_offset_larger_than_build_scatter_is_named(flights, engine, recorded):
    real = recorded({"throttle_bias": [3.0]})
    found = answer(flights, engine, real)
    assert (found.kind, found.effects) == ("effects", ("throttle_bias",)), found.reason


def test_an_error_that_follows_the_day_is_named_beside_build_scatter(flights, engine, recorded):
    """Offsets that all days share, as large as what the days differ by, do not hide it."""
    days = flights.u[..., [3]] * np.array([0.06, 0.03, 0.5])
    found = answer(flights, engine, recorded({}) + days + np.array([0.2, -0.3, 8.0]))
    assert (found.kind, found.effects) == ("effects", ("temperature_effect",)), found.reason
    rate = found.tried[0].parameters["temperature_effect"]["per_10K_N1_pct"]
    assert rate.value == pytest.approx(0.6, abs=0.03)


@pytest.mark.parametrize(("degrees", "kind"), [(0.1, "none"), (1.0, "effects")])
def test_days_that_are_alike_say_nothing_of_the_temperature(
    degrees, kind, flights, engine, recorded
):
    """An error of each day, as large in both; air of +-1.5 K is no cause of any of it."""
    days = flights.u[..., [3]] * np.array([0.06, 0.03, 0.5])
    u = flights.u * np.array([1.0, 1.0, 1.0, degrees, 1.0])
    found = answer(replace(flights, u=u), engine, recorded({}) + days)
    assert found.kind == kind, found.reason
    assert found.effects == (("temperature_effect",) if kind == "effects" else ())


def test_offsets_within_build_scatter_are_told_of(flights, engine, recorded):
    """Nothing is claimed, but who reads on sees what there is, after all that moves."""
    found = answer(flights, engine, recorded({}) + np.array([0.03, 0.03, 9.0]))
    assert (found.kind, found.effects) == ("none", ())
    offsets = [one for one in found.tried if one.effects == ("sensor_bias:EGT_C",)]
    assert [one in found.tried[-3:] for one in offsets] == [True]
    assert offsets[0].gain > 0.9
    bias = offsets[0].parameters["sensor_bias:EGT_C"]["bias"]
    assert bias.low < 9.0 < bias.high


@pytest.mark.parametrize("channel", [1, 2])
def test_an_offset_larger_than_any_is_another_engine(channel, flights, engine, recorded):
    off = np.zeros(3)
    off[channel] = 0.6 * (flights.signals.high - flights.signals.low)[channel]
    found = answer(flights, engine, recorded({}) + off)
    name = f"sensor_bias:{flights.signals.outputs[channel]}"
    assert (found.kind, found.effects) == ("unknown", ())
    assert found.reason == f"no {name} is as large as this: is the simulator one of this engine?"


def test_offsets_that_all_days_share_do_not_follow_them(flights, engine, recorded):
    found = answer(flights, engine, recorded({}) + np.array([0.2, -0.3, 8.0]))
    assert (found.kind, found.effects) == ("none", ())


@pytest.mark.parametrize("share", [-0.15, -1.5])
def test_of_two_effects_a_heat_soak_is_named_last(share, flights, engine, recorded):
    """However much of the gap it takes: it follows anything slow, the other does not."""
    real = recorded({"heat_soak": [60.0, 0.0, 0.0, share, 0.0], "sensor_lag:N2_pct": [0.8, 0.5]})
    found = answer(flights, engine, real)
    assert found.effects == ("sensor_lag:N2_pct", "heat_soak"), found.reason


@pytest.mark.parametrize("channel", ["N2_pct", "EGT_C"])
def test_one_wrong_sensor_is_no_wear(channel, flights, engine, recorded):
    """The others scatter a little, which wear would follow."""
    column = flights.signals.y(channel)
    shift = np.array([0.0, 0.2, 3.0])
    shift[column] = (1.8, 40.0)[column - 1]
    found = answer(flights, engine, recorded({}) + shift)
    assert (found.kind, found.effects) == ("effects", (f"sensor_bias:{channel}",)), found.reason


@pytest.mark.parametrize(
    ("shift", "named"),
    [
        ([0.03, 0.62, 0.0], ("sensor_bias:N2_pct",)),
        ([0.03, 0.62, 6.0], ()),
        ([0.03, 0.3, 0.0], ()),
        ([0.03, 0.03, 12.0], ()),
        ([0.03, 0.03, 20.0], ("sensor_bias:EGT_C",)),
        ([0.0, 0.3, 0.0], ("sensor_bias:N2_pct",)),
        ([0.0, 0.0, 12.0], ("sensor_bias:EGT_C",)),
        ([0.03, 0.03, 3.0], ()),
    ],
)
def test_a_sensor_that_is_off_while_nothing_else_is_needs_less_than_scatter(
    shift, named, flights, engine, recorded
):
    """Build scatter that shifts a speed shifts the temperature, too; that alone by a percent.

    Where all others are where they were simulated, both are one engine, and less is a sensor's.
    """
    found = answer(flights, engine, recorded({}) + np.array(shift))
    assert found.effects == named, found.reason


def test_shifts_of_several_outputs_that_grow_with_power_are_wear(flights, engine, recorded):
    real = recorded({"deterioration": [0.4, 1.2, 12.0, 25.0]})
    found = answer(flights, engine, real)
    assert (found.kind, found.effects) == ("effects", ("deterioration",)), found.reason


def test_an_offset_is_named_by_itself_where_what_moves_explains_little(flights, engine, recorded):
    """A temperature that swings by itself is no effect, and does not hide the lever's bias."""
    time = np.arange(flights.y.shape[1])
    real = recorded({"throttle_bias": [3.0]})
    for f, row in enumerate(real):
        row[:, 2] += 6.0 * np.sin(time / (7.0 + f))
    found = answer(flights, engine, real)
    assert (found.kind, found.effects) == ("effects", ("throttle_bias",)), found.reason


def test_an_offset_comes_before_a_second_effect_that_takes_less(flights, engine, recorded):
    real = recorded({"sensor_lag:EGT_C": [2.5, 0.5], "throttle_delay": [0.1]})
    real[..., 1] += 3.0
    found = answer(flights, engine, real)
    assert set(found.effects) == {"sensor_lag:EGT_C", "sensor_bias:N2_pct"}, found.reason


def test_two_effects_that_each_take_much_are_named_beside_an_offset(flights, engine, recorded):
    real = recorded({"sensor_lag:EGT_C": [2.5, 0.5], "throttle_delay": [0.5]})
    real[..., 1] += 6.0
    found = answer(flights, engine, real)
    assert found.effects[0] == "sensor_bias:N2_pct"
    assert set(found.effects[1:]) == {"sensor_lag:EGT_C", "throttle_delay"}, found.reason


@pytest.mark.parametrize(
    ("shift", "first"), [(1.2, "sensor_lag:EGT_C"), (6.0, "sensor_bias:N2_pct")]
)
def test_what_takes_more_of_the_gap_is_named_first(shift, first, flights, engine, recorded):
    real = recorded({"sensor_lag:EGT_C": [2.5, 0.5]})
    real[..., 1] += shift
    found = answer(flights, engine, real)
    assert found.effects[0] == first
    assert set(found.effects) == {"sensor_lag:EGT_C", "sensor_bias:N2_pct"}


@pytest.mark.parametrize("seed", [0, 1])
def test_noise_alone_is_no_gap(seed, flights, engine, recorded):
    found = answer(flights, engine, recorded({}, seed))
    assert (found.kind, found.effects) == ("none", ())
    assert found.reason == "no gap beyond noise and build scatter"


def test_build_scatter_is_no_effect(flights, engine, recorded):
    real = recorded({}) + np.array([0.0, 0.3, 5.0])
    real[..., 2] += 4.0 * flights.signals.power(flights.y)
    found = answer(flights, engine, real)
    assert found.kind == "none"
    assert found.effects == found.ambiguous_with == ()


def test_what_is_in_no_library_is_not_named(flights, engine, recorded):
    """A temperature that swings slowly by itself, differently in each flight."""
    time = np.arange(flights.y.shape[1])
    random = np.random.default_rng(9)
    swing = [np.sin(time / random.uniform(5, 15) + random.uniform(0, 6)) for _ in flights.y]
    real = recorded({})
    real[..., 2] += 15.0 * np.array(swing)
    real[..., 1] += 1.5 * np.array(swing)
    found = answer(flights, engine, real)
    assert (found.kind, found.effects) == ("unknown", ())
    assert "of it" in found.reason or "unexplained" in found.reason


def test_a_dead_band_of_the_lever_is_no_play(flights, engine, recorded):
    """The lever is heard only once it is 3 degrees from where it was last heard."""
    u = flights.u.copy()
    for f, heard in np.ndindex(u.shape[0], u.shape[1] - 1):
        if abs(u[f, heard + 1, 0] - u[f, heard, 0]) <= 3.0:
            u[f, heard + 1, 0] = u[f, heard, 0]
    moved = engine.run(flights, u) - engine.run(flights, flights.u)
    found = answer(flights, engine, recorded({}) + moved)
    assert (found.kind, found.effects) == ("unknown", ()), found.reason


def test_small_misfit_that_any_simulator_has_is_not_named(flights, engine, recorded):
    quiet = NOISE / 30.0
    little = {"throttle_backlash": [0.25], "sensor_lag:EGT_C": [0.05, 0.0]}
    real = recorded(little, noise=quiet)
    found = diagnose(flights, (real + ANOTHER, quiet), Simulators(engine), QUICK)
    assert found.effects == (), found.reason
    assert found.tried[0].gain > 0.2


def test_an_effect_that_stands_out_is_named_whatever_else_is_wrong(flights, engine, recorded):
    """Most of the gap is a swing of another channel, of no effect."""
    time = np.arange(flights.y.shape[1])
    random = np.random.default_rng(9)
    swing = [np.sin(time / random.uniform(20, 50) + random.uniform(0, 6)) for _ in flights.y]
    real = recorded({"time_skew:N2_pct": [0.25]})
    real[..., 2] += 30.0 * np.array(swing)
    found = answer(flights, engine, real)
    assert found.tried[0].gain < 0.15
    assert found.kind in ("effects", "ambiguous"), found.reason
    assert found.effects == ("time_skew:N2_pct",)
    assert set(found.ambiguous_with) <= {"sensor_lag:N2_pct"}


def test_an_effect_that_leaves_little_may_be_followed_by_one_of_what_is_left(
    flights, engine, recorded
):
    """A second effect of less than a tenth of the gap, but of most of what the first leaves."""
    real = recorded({"sensor_lag:EGT_C": [3.0, 0.5], "time_skew:N2_pct": [0.3]})
    found = answer(flights, engine, real)
    alone = next(row for row in found.tried if row.effects == ("sensor_lag:EGT_C",))
    assert alone.gain > 0.88
    assert set(found.effects) == {"sensor_lag:EGT_C", "time_skew:N2_pct"}, found.reason


@pytest.mark.parametrize(
    ("taken", "aligned", "enough"),
    [(0.19, 0.80, True), (0.05, 0.86, True), (0.05, 0.81, False), (0.005, 0.95, False)],
)
def test_a_second_effect_takes_something_beyond_small_misfit(taken, aligned, enough):
    """A good part of what is left beside it, or less if what both touch is explained better."""
    first, both = object(), object()
    work = SimpleNamespace(
        beyond=lambda one: np.array([0.4 + (taken if one is both else 0.0)]),
        aligned=lambda one: aligned if one is both else 0.80,
        still=lambda one: 1.2 if one is first else np.nan,
        audible=1.0,
    )
    assert _beyond(work, both, first) is enough


@pytest.mark.parametrize(("explained", "asked"), [(0.75, 0.10), (0.65, 0.15)])
def test_less_of_what_is_left_is_enough_if_it_is_explained_where_it_acts(explained, asked):
    work = SimpleNamespace(
        unexplained=lambda _: 0.6,
        explained=lambda own, rest: explained if (own, rest) == (1.0, 5.0) else np.nan,
        options=Options(),
        problem=SimpleNamespace(misfit=SimpleNamespace(gap=7.0)),
    )
    first, both = SimpleNamespace(response=2.0), SimpleNamespace(response=3.0)
    assert _least(work, both, first) == pytest.approx(asked)


def test_two_effects_are_both_named(flights, engine, recorded):
    real = recorded({"throttle_delay": [0.5], "sensor_lag:EGT_C": [2.5, 0.5]})
    found = answer(flights, engine, real)
    assert set(found.effects) == {"throttle_delay", "sensor_lag:EGT_C"}, found.reason


def test_the_same_logs_give_the_same_answer(flights, engine, recorded):
    real = recorded({"sensor_lag:EGT_C": [1.2, 0.5]})
    assert answer(flights, engine, real) == answer(flights, engine, real)


def test_the_model_at_work_is_reported(flights, engine, recorded):
    seen = []
    real = recorded({"sensor_lag:EGT_C": [1.2, 0.5]})
    diagnose(
        flights,
        (real, NOISE),
        Simulators(engine),
        QUICK,
        lambda name, k, n: seen.append((name, k, n)),
    )
    assert seen[0][1] == 0
    assert all(k < n for _, k, n in seen)


def test_what_small_misfit_explains_as_well_is_no_claim_and_said_so(flights, engine, recorded):
    """A fifth of a degree of play gains most of a gap that any linkage makes."""
    quiet = NOISE / 30.0
    real = recorded({"throttle_backlash": [0.28]}, noise=quiet)
    strict = Options(quiet=1e-6)
    found = diagnose(flights, (real + ANOTHER, quiet), Simulators(engine), strict)
    assert (found.kind, found.effects) == ("unknown", ())
    assert "hardly more than small misfit of any simulator does" in found.reason
    assert found.tried[0].effects == ("throttle_backlash",)
