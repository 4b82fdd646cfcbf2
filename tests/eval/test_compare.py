"""Comparison of models on the same rows, and which differences are significant."""

import numpy as np
import pytest

from eval.compare import Recording, Row, compare, significance
from narxcal.support.errors import DataError

CHANNELS = ("N1_pct", "EGT_C")


def recording(name="log", size=1200, seed=0, **models):
    """Truth of noise; each model is off by noise of the size given for both channels."""
    rng = np.random.default_rng(seed)
    truth = rng.normal(50.0, 10.0, (size, 2))
    outputs = {one: truth + rng.normal(0.0, sd, (size, 2)) for one, sd in models.items()}
    blocks = tuple(range(20, size, 40))
    return Recording(name, np.arange(size) * 0.1, CHANNELS, truth, outputs,
                     np.ones(size, dtype=bool), (), blocks)  # fmt: skip


def rows(*names):
    return [Row(name, "test") for name in names]


def test_a_clear_difference_is_significant_and_equal_models_are_not():
    found = compare([recording(good=1.0, same=1.0, bad=2.0)], rows("good", "same", "bad"))
    claims = {(one.channel, one.better, one.worse) for one in found.significant}
    assert claims == {(c, b, "bad") for c in CHANNELS for b in ("good", "same")}
    for one in found.significant:
        assert one.low < one.ratio < one.high
        assert one.ratio == pytest.approx(0.5, abs=0.06)
        assert one.p <= 0.05
    assert found.blocks == 31
    assert found.summary()[0].startswith("N1_pct: least ")
    assert "significantly more: bad" in found.summary()[0]
    assert "not significantly different: " in found.summary()[0]


def test_the_family_wise_error_is_five_percent():
    """Equal models with errors that are alike within a block: a claim in about 5 of 100 tables."""
    rng, claims, tables = np.random.default_rng(1), 0, 100
    for number in range(tables):
        size = np.exp(rng.normal(0.0, 0.5, (40, 4, 2)))
        sums = 30.0 * size * rng.chisquare(10, (40, 4, 2)) / 10
        found = significance(sums, list("abcd"), CHANNELS, number)
        claims += bool(found)
    # 5 %, and four standard deviations of a count of 100.
    assert 0 < claims <= 13


def test_a_channel_that_a_model_lacks_is_no_row_of_it():
    one = recording(whole=1.0, part=1.0)
    one.outputs["part"][:, 1] = np.nan
    found = compare([one], rows("whole", "part"))
    assert set(found.rows[0].channels) == {"N1_pct", "EGT_C"}
    assert set(found.rows[1].channels) == {"N1_pct"}
    assert found.document()["rows"][1]["channels"].keys() == {"N1_pct"}


def test_rows_that_a_model_lacks_are_left_out_for_all():
    one = recording(first=1.0, second=1.0)
    one.outputs["second"][:100] = np.nan
    one.outputs["first"][:100] = 1e6
    found = compare([one], rows("first", "second"))
    assert found.rows[0].channels["N1_pct"]["rmse"] < 2.0
    assert found.document()["logs"] == {"log": {"rows": 1200, "scored": 1100}}


def test_errors_are_those_of_all_recordings_as_one():
    both = [recording("a", seed=1, model=1.0), recording("b", seed=2, model=3.0)]
    found = compare(both, rows("model")).rows[0].channels["N1_pct"]["rmse"]
    errors = np.concatenate([one.outputs["model"][:, 0] - one.measured[:, 0] for one in both])
    assert found == pytest.approx(np.sqrt(np.mean(errors**2)))


def test_few_events_give_no_claim_and_a_remark():
    one = recording(size=200, good=1.0, bad=9.0)
    found = compare([one], rows("good", "bad"))
    assert found.significant == ()
    assert found.remarks == (
        "6 events are too few to say which differences are significant (at least 10)",
    )


def test_no_common_row_is_an_error():
    one = recording(first=1.0, second=1.0)
    one.outputs["first"][:700] = np.nan
    one.outputs["second"][600:] = np.nan
    with pytest.raises(DataError) as error:
        compare([one], rows("first", "second"))
    assert str(error.value) == (
        "there is no row at which every model has a value: nothing to compare"
    )


def test_the_table_marks_the_least_error():
    found = compare([recording(good=1.0, bad=3.0)], rows("good", "bad")).table()
    assert [row[2].mark for row in found.rows] == ["best", ""]
    assert len(found.head) == len(found.rows[0])


def test_models_that_differ_by_rounding_are_not_different():
    one = recording(first=1.0, bad=3.0)
    one.outputs["again"] = one.outputs["first"] * (1.0 + 1e-14)
    found = compare([one], rows("first", "again", "bad"))
    assert {(d.better, d.worse) for d in found.significant} == {("first", "bad"), ("again", "bad")}
