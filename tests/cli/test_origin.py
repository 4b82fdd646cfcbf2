"""What a run says of its steady-state model and its lags."""

import pytest

from narxcal.calibration.run_record import RunRecord
from narxcal.cli.results import lag_words, steady_words


def test_a_fitted_one_tells_samples_coverage_and_what_is_left():
    rms = {"N1_pct": 0.12345, "EGT_C": 12.3, "EPR": 0.01}
    meta = {"steady_state": {"fitted": True, "samples": 640, "rms": rms, "coverage": 0.6}}
    assert steady_words(RunRecord.parse(meta)) == (
        "fitted to 640 quasi-steady samples over 60 % of the driver's range; "
        "RMS left: N1_pct 0.123 %, EGT_C 12.3 degC, EPR 0.01"
    )


def test_the_makers_tells_its_kind_and_name():
    for kind, word in (("fmu", "FMU"), ("callable", "function"), ("table", "table")):
        section = {"kind": kind, "source": "deck"}
        meta = {"steady_state": {"fitted": False}, "config": {"steady_state": section}}
        assert steady_words(RunRecord.parse(meta)) == f"the maker's {word} deck"


def test_a_bundle_that_does_not_say_is_passed_over():
    assert steady_words(RunRecord()) == ""
    assert lag_words(RunRecord()) == ""


def test_lags_that_the_logs_chose_tell_what_each_form_left():
    left = {"plain": 0.0381, "limits": 0.02655}
    assert lag_words(RunRecord.parse({"lag_form": {"form": "limits", "left": left}})) == (
        "with limits of acceleration and deceleration; "
        "loss of Ti and Tt on logs that were left out: plain 0.038, limits 0.027"
    )


@pytest.mark.parametrize(
    ("form", "words"),
    [
        ("", ""),
        ("plain", "without limits of acceleration"),
        ("governed", "with N1 governed by the control"),
    ],
)
def test_lags_that_the_configuration_says_are_named(form, words):
    assert lag_words(RunRecord.parse({"lag_form": {"form": form, "left": {}}})) == words
