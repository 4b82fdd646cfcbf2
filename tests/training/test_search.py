"""Which form leads by its errors on held-out pieces."""

import numpy as np
import pytest

from narxcal.support.errors import DataError
from training.estimator.ladder import best_by_rung, leading, pseudo_bma, simplex, table
from training.estimator.search import Form, Tried, beats


def tried(rung, parameters, scores, *, whole=True):
    form = Form(rung, f"{parameters} parameters", parameters, 100)
    return Tried(form, np.array(scores), (), lambda: None, whole)


def test_a_score_is_the_geometric_mean_of_the_pieces():
    assert tried("a", 1, [0.1, 0.4]).score == pytest.approx(0.2)
    assert tried("a", 1, [0.0, 1.0]).score == pytest.approx(10**-4.5)
    assert tried("a", 1, [0.1, np.nan]).score == tried("a", 1, [0.1, np.inf]).score == np.inf


def test_one_piece_on_which_all_forms_err_much_does_not_decide():
    line = tried("line", 2, [0.20, 0.22, 0.18, 0.21, 2.0])
    curve = tried("curve", 20, [0.10, 0.11, 0.09, 0.12, 2.5])
    assert np.mean(line.scores) < np.mean(curve.scores)
    assert beats(curve, line)
    assert not beats(line, curve)
    assert leading([line, curve])[0] is curve


def test_the_simplest_form_leads_within_one_standard_error():
    line = tried("line", 2, [0.20, 0.22, 0.18, 0.21])
    curve = tried("curve", 20, [0.12, 0.30, 0.12, 0.24])
    first, reason = leading([curve, line])
    assert curve.score < line.score
    assert first is line
    assert reason == (
        "line (2 parameters) is the simplest form that none beats by more than one standard error: "
        "0.202 standard deviations of the outputs in held-out free runs, the best form, curve, "
        "0.179"
    )


def test_a_gain_below_two_percent_does_not_pay_for_parameters():
    line = tried("line", 2, [0.200, 0.300])
    assert leading([line, tried("curve", 20, [0.197, 0.2955])])[0] is line
    assert leading([line, tried("curve", 20, [0.195, 0.2925])])[0].form.rung == "curve"


def test_of_forms_with_as_many_parameters_the_best_leads():
    one, two = tried("a", 5, [0.3, 0.2, 0.3]), tried("a", 5, [0.2, 0.22, 0.3])
    assert not beats(two, one)
    assert leading([one, two])[0] is two
    assert best_by_rung([one, two]) == [two]


def test_a_form_judged_on_some_folds_or_without_a_finite_run_never_leads():
    line = tried("line", 2, [0.3, 0.3])
    part, wild = tried("b", 1, [0.1], whole=False), tried("c", 1, [0.1, np.inf])
    assert leading([part, wild, line])[0] is line
    rows = table([part, wild, line], line)
    assert rows["chosen"].sum() == 1
    assert rows.set_index("rung")["all_folds"].to_dict() == {"b": False, "c": True, "line": True}
    with pytest.raises(DataError, match=r"^no form has a finite free run"):
        leading([part, wild])


def test_weights_of_a_mean_are_the_least_squares_ones_and_never_negative():
    draw = np.random.default_rng(0)
    noise = draw.standard_normal((4000, 2))
    np.testing.assert_allclose(simplex(noise * [1.0, 2.0]), [0.8, 0.2], atol=0.02)
    same = noise[:, :1]
    np.testing.assert_allclose(simplex(np.hstack([same, 3.0 * same])), [1.0, 0.0], atol=1e-6)


def test_forms_are_averaged_by_the_likelihood_of_half_the_pieces():
    good, same, poor = (tried(name, 1, [e] * 4) for name, e in (("a", 0.1), ("b", 0.1), ("c", 0.2)))
    np.testing.assert_allclose(pseudo_bma([good, same, poor]), np.array([4, 4, 1]) / 9)
