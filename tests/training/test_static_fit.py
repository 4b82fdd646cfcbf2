"""Fits of static models: recovered parameters, oracles, estimators compared, advice, refusals."""

import json

import numpy as np
import pytest
from scipy.optimize import least_squares, minimize_scalar

from narxcal.static_models import (
    bada3,
    cold_thrust,
    corrected,
    mattingly,
    polynomial,
    torenbeek,
    wanner,
    with_drag,
    yoder,
    yoder_plus,
)
from narxcal.support.errors import DataError, ModelError
from training.steady.static_fit import (
    SEARCHES,
    Boxed,
    FitSettings,
    fit,
    fit_correction,
    score,
)


def flights(count=300, seed=0):
    random = np.random.default_rng(seed)
    return {
        "ALT_ft": random.uniform(5e3, 4e4, count), "Mach": random.uniform(0.3, 0.85, count),
        "TRA_deg": random.uniform(30.0, 80.0, count), "FPR": random.uniform(1.25, 1.75, count),
        "FN_kN": random.uniform(0.5, 25.0, count),
    }  # fmt: skip


def with_output(model, parameters, noise=0.0, seed=1, **more):
    columns = flights() | more
    values = model.predict(parameters, columns)
    random = np.random.default_rng(seed)
    return columns | {model.output: values * (1.0 + noise * random.standard_normal(len(values)))}


TRUTHS = [
    (mattingly(30.0), [30.0, 0.5, 0.3, 0.7, 1.4, 0.6]),
    (wanner(30.0), [25.0, 0.2, 1.0, 1.4, 0.6]),
    (with_drag(mattingly(30.0, throttle_degree=1), 1), [30.0, 0.5, 0.3, 0.7, 1.4, 0.3]),
    (cold_thrust(flow="nozzle"), [0.6, 0.85, 0.92, 1.0, 0.75]),
    (bada3(), [0.9, 1500.0, 1.0, 5.0, 8e4]),
    (yoder(30.0), [0.35, 0.5, 0.8, 5.0]),
    (yoder_plus(30.0), [0.3, 0.4, 0.7, 4.0, 0.1, 0.2, 0.45]),
]


@pytest.mark.parametrize(("model", "truth"), TRUTHS, ids=lambda x: getattr(x, "name", ""))
def test_known_parameters_are_recovered(model, truth):
    found = fit(model, with_output(model, truth))
    assert found.score.max_pct < 1e-3
    np.testing.assert_allclose(found.values, truth, rtol=5e-3, atol=5e-3)


def test_deviations_are_those_of_repeated_noise():
    model, truth = bada3(), [0.9, 1500.0, 1.0, 5.0, 8e4]
    found = [fit(model, with_output(model, truth, 0.01, seed)) for seed in range(60)]
    spread = np.std([f.values[0] for f in found], ddof=1)
    reported = np.mean([f.sd[0] for f in found])
    assert reported == pytest.approx(spread, rel=0.3)  # 60 draws: sd within 9 %, three of them


def test_yoder_by_variable_projection():
    # For a given beta_3 the law is linear in the other three parameters.
    model = yoder(30.0)
    columns = with_output(model, [0.35, 0.5, 0.8, 5.0], 0.02)
    y = columns["FF_kgph"]

    def remaining(beta_3):
        units = [model.predict([*unit, beta_3], columns) / y for unit in np.eye(3)]
        design = np.column_stack(units)
        solution = np.linalg.lstsq(design, np.ones(len(y)), rcond=None)[0]
        return np.sum((design @ solution - 1.0) ** 2)

    best = minimize_scalar(remaining, bounds=(0.5, 30.0), method="bounded", options={"xatol": 1e-9})
    found = fit(model, columns)
    assert found.values[3] == pytest.approx(best.x, rel=1e-3)
    assert np.sum((found.predict(columns) / y - 1.0) ** 2) == pytest.approx(best.fun, rel=1e-6)


def test_wanner_by_logarithms():
    # ln F = ln k + ln rho + lambda ln V is linear; equal where residuals are small.
    model = wanner(30.0, throttle_degree=0)
    columns = with_output(model, [25.0, 0.2, 1.0], 1e-4)
    unit = model.predict([1.0, 0.0, 1.0], columns), model.predict([1.0, 1.0, 1.0], columns)
    design = np.column_stack([np.ones(300), np.log(unit[1] / unit[0])])
    slope = np.linalg.lstsq(design, np.log(columns["FN_kN"] / unit[0]), rcond=None)[0]
    found = fit(model, columns)
    assert found.values[:2] == pytest.approx([np.exp(slope[0]), slope[1]], rel=1e-4)


@pytest.mark.parametrize("estimator", SEARCHES)
@pytest.mark.parametrize(("model", "truth"), TRUTHS, ids=lambda x: getattr(x, "name", ""))
def test_every_estimator_reaches_the_same_minimum(estimator, model, truth):
    columns = with_output(model, truth, 0.01)
    best = fit(model, columns)
    found = fit(model, columns, FitSettings(estimator=estimator, polish=True))
    assert found.score.mean_pct == pytest.approx(best.score.mean_pct, rel=1e-4)
    assert found.estimator == estimator


def test_a_search_is_repeatable_and_knows_its_seed():
    columns = with_output(*TRUTHS[5], 0.01)
    one, same, other = (
        fit(yoder(30.0), columns, FitSettings(estimator="swarm", seed=seed)).values
        for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one, same)
    assert not np.array_equal(one, other)


def test_the_boxed_minimum_is_that_of_scipy_on_a_bound():
    t = np.linspace(0.0, 3.0, 40)
    data = 2.0 * np.exp(-1.5 * t) + 0.3

    def residuals(p):
        return p[..., :1] * np.exp(-p[..., 1:2] * t) + p[..., 2:] - data

    low, high = np.array([0.0, 0.1, 0.0]), np.array([5.0, 1.2, 1.0])
    ours, status = Boxed(residuals, low, high).minimum(np.array([1.0, 0.5, 0.5]))
    oracle = least_squares(residuals, [1.0, 0.5, 0.5], bounds=(low, high), xtol=1e-14, ftol=1e-14)
    np.testing.assert_allclose(ours, oracle.x, atol=1e-5)
    assert ours[1] == 1.2
    assert status.startswith("converged")


def test_a_linear_model_is_solved_directly_and_searched_alike():
    columns = flights()
    columns["FN_kN"] = 5.0 + columns["Mach"] * columns["FPR"]
    model = polynomial(columns, "FN_kN", {"Mach": 1, "FPR": 1})
    direct = fit(model, columns)
    assert (direct.estimator, direct.status) == ("linear", "solved directly")
    assert direct.score.max_pct < 1e-9
    swarm = fit(model, columns, FitSettings(estimator="swarm", polish=True))
    np.testing.assert_allclose(swarm.values, direct.values, atol=1e-5)


def test_a_correction_removes_what_the_theory_lacks_and_keeps_its_values():
    base = cold_thrust(flow="nozzle")
    columns = with_output(base, TRUTHS[3][1])
    theory = fit(base, columns)
    columns["FN_kN"] += 0.2 * (columns["FPR"] - 1.5) ** 2 * columns["Mach"]
    model = corrected(base, polynomial(columns, "FN_kN", {"Mach": 1, "FPR": 2}))
    found = fit_correction(model, theory, columns)
    assert found.score.max_pct < 1e-3
    np.testing.assert_array_equal(found.values[: len(theory.values)], theory.values)


def test_more_terms_have_to_pay_in_aic():
    # A superfluous parameter costs 2 and wins chi^2 with one degree of freedom: 1 on average.
    columns, extra = flights(), []
    models = [polynomial(columns, "FN_kN", {"Mach": degree}) for degree in (1, 2)]
    for seed in range(40):
        noise = np.random.default_rng(seed).standard_normal(300)
        columns["FN_kN"] = (5.0 + columns["Mach"]) * (1.0 + 0.01 * noise)
        low, high = (fit(model, columns).aic for model in models)
        extra.append(high - low)
    assert np.mean(extra) == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / 40.0))


def test_what_a_fit_reports():
    found = fit(*[bada3(), with_output(bada3(), TRUTHS[4][1])])
    document = json.loads(json.dumps(found.document()))
    assert document["parameters"]["C_f2"]["unit"] == "kt"
    assert document["parameters"]["C_f2"]["low"] == 100.0
    assert document["recipe"] == {"model": "bada3", "phase": "cruise"}


# Advice.
def test_a_parameter_on_its_bound_is_named():
    model = cold_thrust(flow="nozzle")
    columns = with_output(model, [0.6, 0.5, 0.92, 1.0, 0.75])  # fan efficiency below the bound
    assert "eta_f ends on its bound 0.6" in fit(model, columns).advice


def test_parameters_that_cannot_be_told_apart_are_named():
    # C_f1 and C_fcr are one factor.
    free = FitSettings(fixed={"C_f3": 5.0, "C_f4": 8e4, "C_f2": 1500.0})
    found = fit(bada3(), with_output(bada3(), TRUTHS[4][1]), free)
    assert "not identifiable together: C_f1, C_fcr" in found.advice
    assert np.isinf(found.sd[[0, 2]]).all()


def test_rows_with_nan_are_left_out_and_counted():
    columns = with_output(bada3(), TRUTHS[4][1])
    columns["Mach"] = np.where(np.arange(300) < 7, np.nan, columns["Mach"])
    found = fit(bada3(), columns)
    assert found.advice[0] == "7 rows with NaN or a zero output were left out"
    assert found.score.rows == 293


# Refusals.
def test_fewer_rows_than_parameters():
    columns = {name: values[:2] for name, values in with_output(*TRUTHS[4]).items()}
    message = (
        r"^2 usable rows for the 2 free parameters of 'BADA 3'\. Add rows, lower the degrees or "
        r"fix parameters$"
    )
    with pytest.raises(DataError, match=message):
        fit(bada3(), columns)


def test_coefficients_that_the_rows_do_not_determine():
    columns = flights()
    columns["FPR"] = np.where(columns["FPR"] > 1.5, 1.6, 1.4)  # two values, three coefficients
    model = polynomial(columns, "FN_kN", {"FPR": 2})
    message = (
        r"^the rows determine 2 of the 3 coefficients of 'polynomial \(FPR\)'\. Lower the degrees, "
        r"or fly more lever angles, altitudes or Mach numbers$"
    )
    with pytest.raises(DataError, match=message):
        fit(model, columns)


def test_a_generator_function_below_zero_names_the_rows_after_the_fit():
    columns = flights() | {"EGT_C": np.full(300, 626.85), "EPR": np.full(300, 12.0)}
    columns["EPR"][[3, 5]] = 1.02
    message = r"^Torenbeek: the generator function is not above zero .* in rows 3, 5 \(2 of 300\)$"
    with pytest.raises(ModelError, match=message):
        fit(torenbeek(30.0, 5.0), columns)


def test_a_missing_output_and_an_unknown_parameter():
    with pytest.raises(DataError, match=r"^channel FF_kgph: the fit of 'BADA 3' needs FF_kgph$"):
        fit(bada3(), flights())
    with pytest.raises(ModelError, match=r"^'BADA 3' has no parameter named C_f9$"):
        fit(bada3(), with_output(*TRUTHS[4]), FitSettings(fixed={"C_f9": 1.0}))


def test_the_criterion_of_five_percent():
    found = score(np.array([1.0, 1.04, 1.06, np.nan]), np.ones(4))
    assert (found.mean_pct, found.max_pct) == pytest.approx((10.0 / 3.0, 6.0))
    assert found.success_pct == pytest.approx(200.0 / 3.0)
    assert found.rows == 3
    with pytest.raises(DataError, match=r"^no row has both a prediction and a measurement$"):
        score(np.array([np.nan]), np.ones(1))
