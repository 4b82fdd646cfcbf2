"""A log against physics: units, staircases, stuck air data, air data against each other."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_prep.cleaning.plausibility import checked, rounding_step, unchecked_air, update_interval
from data_prep.log import Finding, Log
from data_prep.prepare import prepare
from data_prep.sources.units import conversions, to_canonical
from narxcal.atmosphere import KELVIN, SOUND_KT, T0_K, isa, mach_of_cas

DT_S = 0.5
ROWS = 2400


def flight(**changed):
    """Twenty minutes of climb, cruise and descent with all air data, without noise but in them."""
    draw = np.random.default_rng(3)
    share = np.linspace(0.0, 1.0, ROWS)
    alt = 25000.0 * np.minimum(1.0, 3.0 * np.minimum(share, 1.0 - share)) + 1000.0
    alt += 3.0 * draw.standard_normal(ROWS)
    cas = 180.0 + 60.0 * np.sin(3.0 * share) + 0.2 * draw.standard_normal(ROWS)
    mach = mach_of_cas(cas, alt)
    sat = isa(alt)[0] - KELVIN + 5.0
    n1 = 70.0 + 20.0 * np.sin(20.0 * share) + 0.05 * draw.standard_normal(ROWS)
    channels = {
        "N1_pct": n1,
        "N2_pct": 60.0 + 0.4 * n1,
        "FF_kgph": 0.1 * n1**2,
        "EGT_C": 300.0 + 4.0 * n1,
        "ALT_ft": alt,
        "CAS_kt": cas,
        "Mach": mach,
        "TAS_kt": SOUND_KT * mach * np.sqrt((sat + KELVIN) / T0_K),
        "SAT_C": sat,
        "TAT_C": (sat + KELVIN) * (1.0 + 0.2 * mach**2) - KELVIN,
    }
    for name, change in changed.items():
        channels[name] = change(channels[name]) if callable(change) else change
    return Log("flight", DT_S * np.arange(ROWS), channels)


def found(log):
    return [(fault.kind, fault.channels) for fault in checked(log).findings]


@pytest.mark.parametrize("change", [{}, {"SAT_C": lambda x: np.round(2.0 * x) / 2.0}])
def test_a_sound_flight_has_no_fault_in_coarse_steps_neither(change):
    assert found(flight(**change)) == []


@pytest.mark.parametrize(
    ("channel", "factor", "text"),
    [
        ("N1_pct", 0.01, "looks like a fraction: median 0.7"),
        ("N1_pct", 60.0, "looks like rpm: median 4299 %"),
        ("Mach", 100.0, "looks like percent: median 4"),
    ],
)
def test_units_outside_of_the_physical_range_are_named(channel, factor, text):
    [fault] = checked(flight(**{channel: lambda x: factor * x})).findings
    assert (fault.kind, fault.channel, fault.local) == ("unit", channel, False)
    assert fault.evidence.startswith(text)


@pytest.mark.parametrize("channel", ["N1_pct", "EGT_C", "FF_kgph", "ALT_ft", "CAS_kt"])
def test_a_conversion_of_what_is_in_the_right_unit_is_undone(channel):
    found, values = conversions(channel), np.linspace(-3.0, 700.0, 9)
    for words in (each for each in found if ", taken for " in each):
        wrong = to_canonical(values, found[words.rpartition(", taken for ")[2]])
        np.testing.assert_allclose(to_canonical(wrong, found[words]), values, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "step"),
    [
        (lambda x: 0.5 * np.round(2.0 * x), 0.5),
        (lambda x: 1.8 * np.round(x) + 32.0, 1.8),
        (lambda x: x, 0.0),
        (lambda x: np.repeat(x[::10], 10), 0.0),  # held, at values of no grid
    ],
)
def test_the_steps_of_a_rounded_channel_are_known(change, step):
    n1 = flight()["N1_pct"]
    assert rounding_step(change(n1)) == pytest.approx(step)


@pytest.mark.parametrize("channel", ["ALT_ft", "CAS_kt", "Mach", "SAT_C"])
def test_air_data_that_stay_while_the_others_move_are_stuck(channel):
    def stop(x):
        return np.where(np.arange(ROWS) > 800, x[800], x)

    faults = checked(flight(**{channel: stop})).findings
    [stuck] = [each for each in faults if (each.kind, each.channel) == ("stuck", channel)]
    assert stuck.start_s == pytest.approx(400.0, abs=1.0)


def test_airspeed_at_zero_all_along_is_stuck():
    assert ("stuck", ("CAS_kt",)) in found(flight(CAS_kt=np.zeros(ROWS)))


@pytest.mark.parametrize(
    ("channel", "change", "expected"),
    [
        ("Mach", lambda x: 0.8 * x, ("inconsistent", ("Mach",))),
        ("Mach", lambda x: 0.5 * x, ("scale", ("Mach",))),
        ("CAS_kt", lambda x: 0.5 * x, ("scale", ("CAS_kt",))),
        ("CAS_kt", lambda x: x * 1852.0 / 3600.0, ("unit", ("CAS_kt",))),
        ("ALT_ft", lambda x: 0.3048 * x, ("unit", ("ALT_ft",))),
        ("TAT_C", lambda x: x + KELVIN, ("unit", ("TAT_C",))),
        ("TAS_kt", lambda x: x + 40.0, ("inconsistent", ("TAS_kt",))),
    ],
)
def test_the_channel_of_all_failed_relations_is_at_fault(channel, change, expected):
    assert expected in found(flight(**{channel: change}))


def test_two_airspeeds_alone_cannot_say_which_is_wrong():
    log = flight(Mach=lambda x: 0.8 * x)
    few = {name: log[name] for name in ("N1_pct", "ALT_ft", "CAS_kt", "Mach")}
    [fault] = checked(Log("flight", log.time_s, few)).findings
    assert (fault.kind, fault.channels) == ("inconsistent", ("Mach", "ALT_ft"))
    both = "Mach and ALT_ft and CAS_kt contradict each other"
    expected = f"{both}: Mach is 0.8 times what CAS and altitude say"
    assert fault.evidence == expected


@given(st.integers(4, 40))
def test_update_interval_of_a_staircase_is_its_step(size):
    smooth = np.cumsum(np.random.default_rng(size).uniform(0.5, 1.5, 2000))
    held = smooth[np.arange(2000) // size * size]
    assert update_interval(held) == pytest.approx(size, rel=1e-9)


@pytest.mark.parametrize(("began_s", "date"), [(0.0, ""), (1741907464.0, " (2025-03-13 23:1")])
def test_preparing_keeps_the_faults_and_adds_what_cleaning_masks(began_s, date):
    draw = np.random.default_rng(0)
    n2 = flight()["N2_pct"] + 0.05 * draw.standard_normal(ROWS)
    n2[1000:1200] = n2[1000]
    log = flight(N2_pct=n2)
    [one] = prepare([replace(log, time_s=began_s + log.time_s)])
    [fault] = [each for each in one.log.findings if each.channel == "N2_pct"]
    assert fault.kind == "stuck"
    span_s = fault.start_s - began_s, fault.end_s - began_s
    assert span_s == pytest.approx((500.0, 600.0), abs=1.0)
    assert fault.origin_s == began_s
    assert Finding.from_row(json.loads(json.dumps(fault.row()))).caution == fault.caution
    assert re.match("flight: N2_pct stuck, t[+]8:[^ ]+ to t[+](9|10):[^ ]+", fault.caution)
    assert date in fault.caution


def without(log, *names):
    return Log(log.name, log.time_s, {k: v for k, v in log.channels.items() if k not in names})


def test_an_altitude_whose_noise_stops_in_flight_is_stuck_without_other_air_data():
    def stuck(values):
        return np.r_[values[:900], np.full(600, values[900]), values[1500:]]

    alone = without(flight(ALT_ft=stuck), "SAT_C", "TAT_C", "CAS_kt", "TAS_kt")
    (fault,) = checked(alone).findings
    assert (fault.kind, fault.channel) == ("stuck", "ALT_ft")
    assert (fault.start_s, fault.end_s) == (900 * DT_S, 1499 * DT_S)


@pytest.mark.parametrize("on_ground", [True, False])
def test_a_constant_altitude_is_none_on_the_ground_or_without_noise(on_ground):
    log = without(flight(), "SAT_C", "TAT_C", "CAS_kt", "TAS_kt")
    alt, mach = log["ALT_ft"].copy(), log["Mach"].copy()
    alt[900:1500] = alt[900]
    if on_ground:
        mach[900:1500] = 0.0
    else:
        alt = 100.0 * np.round(alt / 100.0)
    assert checked(log.with_channels({"ALT_ft": alt, "Mach": mach})).findings == ()


def test_what_no_other_air_data_can_contradict_is_told():
    log = flight()
    assert unchecked_air(log) == ()
    assert unchecked_air(without(log, "CAS_kt", "TAS_kt", "TAT_C")) == ("ALT_ft", "Mach")
    assert unchecked_air(without(log, "TAS_kt", "TAT_C", "SAT_C")) == ()
