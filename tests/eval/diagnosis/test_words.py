"""Effects are named in words that need no list of names, sizes to the digits that are known."""

from __future__ import annotations

import math

import pytest

from eval.diagnosis.words import (
    in_words,
    is_sure,
    listed,
    parameter_words,
    sentences,
    size_words,
    surest_words,
)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("sensor_lag:EGT_C", "lag of the EGT sensor (sensor_lag:EGT_C)"),
        ("time_skew:N2_pct", "N2 recorded late (time_skew:N2_pct)"),
        ("unlogged_switch", "a load or bleed that no channel records (unlogged_switch)"),
    ],
)
def test_an_effect_is_named_in_words(name, words):
    assert in_words(name) == words


@pytest.mark.parametrize(
    ("words", "text"),
    [([], ""), (["a"], "a"), (["a", "b"], "a and b"), (["a", "b", "c"], "a, b and c")],
)
def test_a_list_reads_as_a_sentence(words, text):
    assert listed(words) == text


def size(value, low, high, unit="-"):
    return {"value": value, "low": low, "high": high, "unit": unit}


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (size(8.546, 8.0, 11.131, "s"), "8.5 s (8.0 to 11.1)"),
        (size(-1.606, -1.887, -1.334, "%"), "-1.61 % (-1.89 to -1.33)"),
        (size(217.4, 176.1, 258.3, "deg/s"), "217 °/s (176 to 258)"),
        (size(0.0, 0.0, 0.0073), "0 (0 to 0.0073)"),
        (size(2.5, 2.5, 2.5, "s"), "2.50 s (2.50 to 2.50)"),
        (size(2.5, None, None, "s"), "2.50 s (– to –)"),  # noqa: RUF001 - the dash of the page
        (size(math.nan, 0.0, 1.0), "– (0 to 1.00)"),  # noqa: RUF001
    ],
)
def test_a_size_has_the_digits_of_its_interval(found, words):
    assert size_words(found) == words


def test_sizes_that_may_be_nothing_are_only_named():
    sizes = {"a": size(1.0, 0.8, 1.2), "b": size(0.1, -0.1, 0.3)}
    row = {"id": "deterioration", "parameters": sizes}
    assert surest_words(row) == "a 1.00 (0.80 to 1.20); b may as well be 0"
    row["parameters"] |= {f"c{k}": size(0.0, -1.0, 1.0) for k in range(3)}
    assert surest_words(row).endswith("; 4 others may as well be 0")
    row["parameters"] = {"b": sizes["b"]}
    assert surest_words(row) == "b 0.10 (-0.10 to 0.30)"


def test_a_size_at_which_it_does_nothing_is_left_out():
    sizes = {"share": size(0.82, 0.81, 0.83), "most_pctps": size(30.0, 30.0, 30.0, "%/s")}
    row = {"id": "accel_limit", "parameters": sizes}
    assert surest_words(row) == "share 0.820 (0.810 to 0.830)"
    row["parameters"] = {"share": size(1.0, 0.9, 1.1)}
    assert surest_words(row) == "share 1.00 (0.90 to 1.10)"


@pytest.mark.parametrize(("share", "said"), [(0.22, "22 %"), (1.21, "All"), (0.004, "No part")])
def test_what_is_left_is_at_most_all_of_the_gap(share, said):
    verdict = {"kind": "none", "effects": [], "reason": "noise", "ambiguous_with": []}
    left = {"cause": "unexplained", "share": share}
    found = sentences({"verdict": verdict, "effects": [], "budget": [left]})
    assert found[-1] == (
        f"{said} of the gap is left over that no effect known to narxcal explains."
    )


def test_each_effect_that_is_named_bears_its_probability():
    rows = [
        {"id": name, "probability": probability, "parameters": {"tau_s": size(1.0, 0.8, 1.2)}}
        for name, probability in (("deterioration", 0.993), ("unlogged_switch", 0.47))
    ]
    named = [row["id"] for row in rows]
    verdict = {"kind": "effects", "effects": named, "reason": "", "ambiguous_with": []}
    document = {"verdict": verdict, "effects": rows, "budget": []}
    first, second = sentences(document)
    assert "(deterioration), 99 % probable, tau_s 1.00" in first
    assert "(unlogged_switch), 47 % probable, tau_s 1.00" in second
    assert [is_sure(document, names) for names in (named, named[:1])] == [False, True]


def test_effects_that_flights_do_not_tell_apart_are_one_answer():
    rows = [
        {"id": name, "probability": p, "parameters": {"tau_s": size(1.0, 0.8, 1.2)}}
        for name, p in (("actuator_lag", 0.62), ("accel_limit", 0.33))
    ]
    verdict = {
        "kind": "ambiguous", "effects": ["actuator_lag"], "ambiguous_with": ["accel_limit"],
        "reason": "", "separating_manoeuvre": "a slow ramp",
    }  # fmt: skip
    _, *said = sentences({"verdict": verdict, "effects": rows, "budget": []})
    assert " ".join(said) == (
        "One answer, which these flights do not divide: lag of the fuel metering valve "
        "(actuator_lag) (62 %) or acceleration limited by the control (accel_limit) (33 %). "
        "What would: a slow ramp."
    )


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("NAI_EGT_C", "EGT with NAI"),
        ("base_N2_pct", "N2 at idle"),
        ("per_10K_FF_kgph", "FF per 10 K"),
        ("loss", "acceleration lost over the range of EGT"),
        ("tau_s", "tau_s"),
        ("own_s", "the lag that the simulated channel has already"),
    ],
)
def test_an_amplitude_is_named_in_words(name, words):
    assert parameter_words(name) == words
