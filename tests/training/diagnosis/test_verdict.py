"""A verdict says what it rests on: the flights there are, and how much builds may differ."""

import re

import numpy as np
import pytest

from narxcal.effects import effect, respond
from tests.training.diagnosis.conftest import flights_of, recorded
from training.diagnosis.budget import Phases
from training.diagnosis.layers import FEATURES, OF_CASE, Odds, prior
from training.diagnosis.metric import Record
from training.diagnosis.nuisances import BUILD, OFFSET, SMALL, nuisances
from training.diagnosis.remainder import left_of_build
from training.diagnosis.verdict import Engines, NullModel, concluded, weigh

SHIFT = np.array([0.0, 0.15, 6.0])  # of N2 in %, of EGT in K


class NoEmulator:
    """Effects inside the engine change nothing, so that sensors and steady shifts are left."""

    def run(self, flights, told, pace=None, shift=None):
        rows = np.arange(len(told) if pace is None else len(pace.limit)) % len(flights.y)
        return flights.y[rows] + (0.0 if shift is None else shift.settled)


def answer(record, build=1.0, odds=None, refused=""):
    phases = Phases(("steady",), np.zeros(record.unit.shape, dtype=int))
    evidence = weigh(record, Engines(NoEmulator()), NullModel(build=build), odds)
    return concluded(evidence, phases, refused=refused)


def test_a_shift_that_builds_differ_by_is_none_and_an_effect_of_this_very_engine(flights):
    record = recorded(flights, flights.y + SHIFT)
    type_, same = answer(record).verdict, answer(record, 0.0).verdict
    assert type_.kind == "none"
    assert type_.reason.startswith(
        "nothing acts beyond what builds and flights differ by; a steady shift of "
    )
    assert "N2 +0.1" in type_.reason
    assert "EGT +" in type_.reason
    assert type_.reason.endswith(
        " is within what builds of one type differ by: with --build same it would be read as "
        "deterioration, a bleed or a sensor"
    )
    assert same.kind in ("effects", "ambiguous")
    assert same.effects[0].partition(":")[0] in ("deterioration", "sensor_bias", "sensor_gain")


@pytest.mark.parametrize(
    ("tau_s", "build", "within"), [(0.05, 1.0, True), (0.3, 1.0, False), (0.05, 0.0, False)]
)
def test_a_lag_that_probes_of_one_type_differ_by_is_no_effect(flights, tau_s, build, within):
    lag = effect("sensor_lag:EGT_C")
    record = recorded(flights, respond([(lag, np.array([[tau_s, 0.0]]))], flights, None)[0])
    found = weigh(record, Engines(NoEmulator()), NullModel(build=build))
    one = next(each for each in found.singles if each.name == lag.name)
    assert one.theta[0] == pytest.approx(tau_s, rel=0.1)
    assert found.frame.within_build(one) == within
    named = answer(record, build).verdict.effects
    assert (named == ()) if within else (named[0] in (lag.name, "time_skew:EGT_C"))


def by_odds(record, none, unknown, refused=""):
    """The answer where none and unknown are so many times as likely as the best effect."""
    found = weigh(record, Engines(NoEmulator()))
    names = [one.name for one in found.singles]
    lead = max(row[0] + prior(n) for n, row in zip(names, found.effects, strict=True))
    flat, case = (0.0,) * len(FEATURES), (0.0,) * len(OF_CASE)
    scores = [(lead + np.log(times), *case[1:]) for times in (none, unknown)]
    return answer(record, 1.0, Odds((1.0, *flat[1:]), *scores, flat, case), refused)


@pytest.mark.parametrize(
    ("none", "unknown", "kind"), [(0.6, 0.6, "unknown"), (1.5, 0.1, "none"), (0.1, 1.5, "unknown")]
)
def test_nothing_acts_only_where_no_other_answer_is_likelier(flights, none, unknown, kind):
    found = by_odds(recorded(flights, flights.y + 3.5 * SHIFT), none, unknown)
    best = max(found.effects, key=lambda one: one.probability)
    assert found.none == pytest.approx(none * best.probability)
    assert (found.verdict.kind, found.verdict.effects) == (kind, ())
    reason = {
        1.5: "nothing acts beyond what builds and flights differ by",
        0.1: "something acts that no effect of the library explains",
        0.6: f"the best candidate is {best.name} ({100.0 * best.probability:.0f} %), which is not "
        f"likelier than that nothing acts ({100.0 * found.none:.0f} %) or something that the "
        f"library lacks ({100.0 * found.unknown:.0f} %)",
    }
    assert found.verdict.reason.startswith(reason[none])


@pytest.mark.parametrize(("none", "kind"), [(0.6, "unknown"), (1.5, "none")])
def test_a_refused_effect_that_is_likelier_than_none_leaves_the_answer_open(flights, none, kind):
    refused = "the best candidate is play, which takes -5 % to 54 % off what did not fit it"
    found = by_odds(recorded(flights, flights.y + 3.5 * SHIFT), none, 0.1, refused).verdict
    assert (found.kind, found.effects) == (kind, ())
    assert found.reason.endswith(refused)


PLACES = {  # where EGT is off, by N1 and the minutes of a flight, and what is said of it
    "power": (80.0, 0.0, r"( that grows with power)?, \+\d+ degC at 8\d % N1"),
    "time": (0.0, 4.0, r"( that grows with time)?, \+\d+ degC [45] min into a flight"),
}


@pytest.mark.parametrize("along", PLACES)
def test_what_is_left_beyond_noise_and_build_is_not_nothing_and_has_a_place(flights, along):
    speed, minutes, words = PLACES[along]
    time_min = np.arange(flights.y.shape[1]) * flights.signals.dt_s / 60.0
    there = np.clip((flights.y[..., 0] - speed) / 10.0, 0.0, 1.0) * (time_min >= minutes)
    y = flights.y + 150.0 * there[..., None] * np.array([0.0, 0.0, 1.0])
    found = by_odds(recorded(flights, y), 1.5, 0.1).verdict
    assert (found.kind, found.effects) == ("unknown", ())
    assert re.fullmatch(f"not in the library: a steady EGT error{words}", found.reason)


@pytest.mark.parametrize(("part", "kind"), [(0.4, "none"), (0.6, "unknown")])
def test_what_is_left_without_a_place_is_compared_with_what_builds_differ_by(flights, part, kind):
    wave = np.sin(np.arange(flights.y.shape[1]))[:, None] * np.array([0.0, 0.0, 1.0])
    whole = weigh(recorded(flights, flights.y + 10.0 * wave), Engines(NoEmulator())).frame
    y = flights.y + 10.0 * wave * part / left_of_build(whole)[1][2]
    found = by_odds(recorded(flights, y), 50.0, 0.1).verdict
    assert (found.kind, found.effects) == (kind, ())
    assert ("degC RMS in no one place" in found.reason) == (kind == "unknown")


@pytest.mark.parametrize("shape", ["place", "wave"])
def test_of_this_very_engine_what_is_left_is_never_nothing(flights, shape):
    time = np.broadcast_to(np.arange(flights.y.shape[1]), flights.y.shape[:2])
    wave = np.sin(flights.y[..., 0] / 8.0) if shape == "place" else np.sin(time)
    record = recorded(flights, flights.y + 30.0 * wave[..., None] * np.array([0.0, 0.0, 1.0]))
    flat, case = (0.0,) * len(FEATURES), (0.0,) * len(OF_CASE)
    odds = Odds((1.0, *flat[1:]), (50.0, *case[1:]), (50.0, *case[1:]), flat, case)
    found = answer(record, 0.0, odds)
    assert (found.verdict.kind, found.verdict.effects) == ("unknown", ())
    assert (found.none, found.unknown) == pytest.approx((0.0, 1.0))
    assert ("EGT error of 21 degC RMS" in found.verdict.reason) == (shape == "wave")


def test_of_this_very_engine_nothing_else_differs_but_flights(flights):
    record = recorded(flights, flights.y)
    for build in (0.0, 0.25, 1.0):
        found, whole = nuisances(record, NoEmulator(), build), nuisances(record, NoEmulator())
        kinds = np.array(found.kind)
        of_build = np.isin(kinds, (BUILD, SMALL))
        assert np.abs(found.columns[of_build]).max() == pytest.approx(
            build * np.abs(whole.columns[of_build]).max()
        )
        assert (found.limit[of_build] > 0.0).all() == (build > 0.0)
        same = kinds == OFFSET
        np.testing.assert_array_equal(found.columns[same], whole.columns[same])


@pytest.mark.parametrize(("steps", "kind"), [(2000, "unknown"), (2600, "effects")])
def test_one_flight_of_less_than_ten_minutes_gets_no_firm_answer(steps, kind):
    flights = flights_of(1, steps=steps)
    late = np.concatenate([flights.y[:, :1].repeat(6, axis=1), flights.y[:, :-6]], axis=1)
    record = recorded(flights, np.where([False, False, True], late, flights.y))
    halves = np.arange(steps)[None] * 2 // steps
    found = answer(Record(flights, record.real, record.noise, halves, (0,))).verdict
    assert found.kind in (kind, "ambiguous" if kind == "effects" else kind)
    if kind == "unknown":
        assert found.reason.startswith(
            "one flight of less than 10 minutes is no evidence, an effect has to act in others "
            "too; the best candidate is "
        )
    else:
        assert found.effects[0].endswith(":EGT_C")
