"""What a run says of its steady-state model."""

from narxcal.cli.origin import steady_words


def test_a_fitted_one_tells_samples_coverage_and_what_is_left():
    rms = {"N1_pct": 0.12345, "EGT_C": 12.3, "EPR": 0.01}
    meta = {"steady_state": {"fitted": True, "samples": 640, "rms": rms, "coverage": 0.6}}
    assert steady_words(meta) == (
        "fitted to 640 quasi-steady samples over 60 % of the driver's range; "
        "RMS left: N1_pct 0.123 %, EGT_C 12.3 degC, EPR 0.01"
    )


def test_the_makers_tells_its_kind_and_name():
    for kind, word in (("fmu", "FMU"), ("callable", "function"), ("table", "table")):
        section = {"kind": kind, "source": "deck"}
        meta = {"steady_state": {"fitted": False}, "config": {"steady_state": section}}
        assert steady_words(meta) == f"the maker's {word} deck"


def test_a_bundle_that_does_not_say_is_passed_over():
    assert steady_words({}) == ""
