"""Output-error estimation against closed forms, and what it reports of poor data."""

import json
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import norm

from narxcal.output_error.blocks import lag, play
from narxcal.output_error.engine import Parameter
from narxcal.record import Record
from narxcal.support.errors import ConfigError, DataError, ModelError
from training.papers.output_error import Plan, fit


@dataclass(frozen=True)
class Line:
    """y = a + b u: everything has a closed form."""

    parameters: tuple = (Parameter("a", 0.3), Parameter("b", 0.7, -5.0, 5.0))
    output_names: tuple = ("y",)

    def simulate(self, values, u):
        return values["a"] + values["b"] * u


@dataclass(frozen=True)
class Lag:
    """First-order lag with gain, offset and initial state."""

    parameters: tuple = (
        Parameter("gain", 1.0, 0.0, 10.0),
        Parameter("tau", 1.0, 0.05, 10.0, "s"),
        Parameter("offset", 0.0, -50.0, 50.0),
        Parameter("start", 0.0, -50.0, 50.0, free=False),
    )
    output_names: tuple = ("y",)

    def simulate(self, values, u):
        system = lag(values["gain"], values["tau"])
        start = system.equilibrium(u[0]) + values["start"]
        return system.respond(u, 0.1, start=start) + values["offset"]


@dataclass(frozen=True)
class Play:
    """Play, to be found from the position behind it."""

    parameters: tuple = (Parameter("r", 0.3, 0.0, 3.0, "deg"), Parameter("gain", 1.0))
    output_names: tuple = ("y",)

    def simulate(self, values, u):
        return values["gain"] * play(u[:, 0], values["r"])[:, None]


@dataclass(frozen=True)
class Product:
    """y = a b u + c: only a b is seen, and `idle` moves nothing."""

    parameters: tuple = (
        Parameter("a", 1.0), Parameter("b", 2.0), Parameter("c", 0.0), Parameter("idle", 1.0)
    )  # fmt: skip
    output_names: tuple = ("y",)

    def simulate(self, values, u):
        return values["a"] * values["b"] * u + values["c"] + 0.0 * values["idle"]


def line_record(seed=0, points=60, sd=0.5, name="one"):
    rng = np.random.default_rng(seed)
    u = rng.normal(size=(points, 1))
    return Record(u, 1.0 + 2.0 * u + sd * rng.normal(size=u.shape), name)


def lag_record(seed=0, points=600, sd=0.1, name="one", **given):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.normal(size=points // 20), 20)[:, None]
    values = {one.name: one.start for one in Lag().parameters}
    y = Lag().simulate(values | {"gain": 2.0, "tau": 0.6, "offset": 3.0} | given, u)
    return Record(u, y + sd * rng.normal(size=y.shape), name)


def autoregression(rng, points, rho):
    noise = rng.normal(size=points)
    for k in range(1, points):
        noise[k] = rho * noise[k - 1] + np.sqrt(1 - rho**2) * noise[k]
    return noise


def ordinary_least_squares(record):
    x = np.column_stack([np.ones(len(record)), record.u[:, 0]])
    inverse = np.linalg.inv(x.T @ x)
    return inverse @ x.T @ record.y[:, 0], inverse


def test_on_a_line_it_is_ordinary_least_squares():
    record = line_record()
    found = fit(Line(), record, Plan(sigma={"y": 0.5}))
    expected, inverse = ordinary_least_squares(record)
    np.testing.assert_allclose(found.values, expected, rtol=1e-5)
    np.testing.assert_allclose(found.covariance, 0.25 * inverse, rtol=1e-9)
    assert (found.status, found.names) == ("converged", ("a", "b"))


def test_estimated_noise_is_the_rms_residual_and_aic_counts_it():
    record = line_record()
    found = fit(Line(), [record])
    expected, _ = ordinary_least_squares(record)
    residual = record.y[:, 0] - expected[0] - expected[1] * record.u[:, 0]
    sigma = np.sqrt(np.mean(residual**2))
    assert found.sigma["y"] == pytest.approx(sigma, rel=1e-9)
    likelihood = norm.logpdf(residual, 0.0, sigma).sum()
    assert found.aic == pytest.approx(-2.0 * likelihood + 2.0 * 3.0, rel=1e-9)


def test_masked_samples_count_as_little_as_absent_ones():
    record = line_record()
    masked = record.y.copy()
    masked[::3] = np.nan
    keep = np.isfinite(masked[:, 0])
    with_gaps = fit(Line(), Record(record.u, masked))
    without = fit(Line(), Record(record.u[keep], masked[keep]))
    np.testing.assert_allclose(with_gaps.values, without.values)
    np.testing.assert_allclose(with_gaps.covariance, without.covariance)
    assert with_gaps.aic == pytest.approx(without.aic)


@pytest.mark.slow
def test_parameters_of_a_lag_come_back():
    found = fit(Lag(), lag_record())
    truth = np.array([2.0, 0.6, 3.0])
    assert np.all(np.abs(found.values - truth) < 4.0 * found.sd)
    assert found.sigma["y"] == pytest.approx(0.1, rel=0.1)
    exact = fit(Lag(), lag_record(sd=0.0))
    np.testing.assert_allclose(exact.values, truth, rtol=1e-6)


def test_offsets_and_initial_states_of_each_record():
    own = [
        lag_record(1, name="one", offset=3.0, start=1.0),
        lag_record(2, name="two", offset=-4.0, start=-2.0),
    ]
    found = fit(Lag(), own, Plan(per_record=("offset", "start")))
    assert found.names == ("gain", "tau", "offset@one", "offset@two", "start@one", "start@two")
    truth = np.array([2.0, 0.6, 3.0, -4.0, 1.0, -2.0])
    assert np.all(np.abs(found.values - truth) < 4.0 * found.sd)
    assert found.by_record["two"]["offset"] == found.values[3]
    assert found.parameters()["offset"] == pytest.approx(found.values[2:4].mean())


def test_shared_parameters_are_better_known_than_those_of_one_record():
    records = [lag_record(k, name=f"record {k}") for k in range(4)]
    together, alone = fit(Lag(), records), fit(Lag(), records[0])
    np.testing.assert_allclose(together.sd, alone.sd / 2.0, rtol=0.25)


def test_fixed_tied_and_renamed_starts():
    record = lag_record()
    fixed = fit(Lag(), record, Plan(fixed={"offset": 3.0}))
    assert fixed.names == ("gain", "tau")
    assert fixed.parameters()["offset"] == 3.0
    tied = fit(Line(), line_record(), Plan(tied={"b": "a"}))
    u, y = line_record().u[:, 0], line_record().y[:, 0]
    assert tied.values[0] == pytest.approx(((1 + u) @ y) / ((1 + u) @ (1 + u)))
    assert tied.parameters()["b"] == tied.parameters()["a"]


def test_a_minimum_beyond_a_bound_ends_on_it_and_says_so():
    found = fit(Line(), line_record(), Plan(bounds={"b": (0.0, 1.5)}))
    assert found.values[1] == 1.5
    mean = np.mean(line_record().y - 1.5 * line_record().u)
    assert found.values[0] == pytest.approx(mean, abs=1e-4)
    assert found.status == "on a bound"
    assert found.advice == "Widen the bounds of b, or fix it there"


def test_parameters_that_all_end_on_their_bounds_are_named():
    bounds = {"a": (0.0, 0.5), "b": (0.0, 1.5)}
    found = fit(Line(), line_record(), Plan(bounds=bounds))
    np.testing.assert_array_equal(found.values, [0.5, 1.5])
    assert found.advice == "Widen the bounds of a, b, or fix it there"


def test_directions_that_change_nothing_are_named():
    record = line_record()
    found = fit(Product(), record)
    assert found.status == "unidentifiable"
    assert found.unidentifiable == ("idle (+1.00)", "a (+1.00), b (-1.00)")
    assert found.advice == (
        "Fix or tie one parameter of each of: idle (+1.00); a (+1.00), b (-1.00)"
    )
    sd = dict(zip(found.names, found.sd, strict=True))
    assert np.isinf([sd["a"], sd["b"], sd["idle"]]).all()
    assert sd["c"] == pytest.approx(fit(Line(), record).sd[0], rel=1e-6)
    assert found.parameters()["a"] * found.parameters()["b"] == pytest.approx(
        fit(Line(), record).values[1], rel=1e-6
    )
    # No parameter that data do not determine costs anything in the criterion.
    assert found.aic == pytest.approx(fit(Line(), record).aic, abs=1e-6)


def test_the_document_is_json_and_has_null_for_what_is_open():
    document = json.loads(json.dumps(fit(Product(), line_record()).document(), allow_nan=False))
    row = document["parameters"]["idle"]
    assert row == {
        "value": 1.0, "unit": "-", "sd": None, "sd_coloured": None, "low": None, "high": None
    }  # fmt: skip
    assert document["status"] == "unidentifiable"
    c = document["parameters"]["c"]
    assert c["low"] < c["value"] < c["high"]


def test_a_parameter_vaguer_than_its_bounds_is_named():
    record = Record(
        np.array([[0.0], [1e-3], [0.0], [1e-3]]), np.array([[1.0], [1.1], [0.9], [1.0]])
    )
    found = fit(Line(), record, Plan(sigma={"y": 0.1}))
    assert found.warnings == ("b is not determined within its bounds",)


@pytest.mark.parametrize("start", [0.05, 0.8])
def test_hysteresis_comes_back_from_either_side(start):
    rng = np.random.default_rng(1)
    u = np.cumsum(rng.normal(size=(3000, 1)), axis=0) * 0.1
    y = play(u[:, 0], 0.252)[:, None] + 0.05 * rng.normal(size=u.shape)
    found = fit(Play(), Record(u, y), Plan(start={"r": start}, sigma={"y": 0.05}))
    assert found.status in ("converged", "stalled")
    assert abs(found.values[0] - 0.252) < 4.0 * found.sd[0]


@dataclass(frozen=True)
class Kink:
    """A cost with a corner at p = 2, where one output pulls down and another up."""

    parameters: tuple = (Parameter("p", 3.0),)
    output_names: tuple = ("y",)

    def simulate(self, values, u):
        p = values["p"]
        return u * (p - 2.0 if p.real >= 2.0 else 2.0 * (2.0 - p))


def test_a_search_that_ends_in_a_corner_says_that_it_stalled():
    u = np.linspace(1.0, 2.0, 50)[:, None]
    found = fit(Kink(), Record(u, -1.0 * u), Plan(sigma={"y": 0.1}))
    assert found.values[0] == pytest.approx(2.0, abs=1e-6)
    assert found.status == "stalled"
    assert found.advice == ("No step lowers the cost: fix the hysteresis, or change Plan.start")


def test_too_few_iterations_are_no_convergence():
    found = fit(Lag(), lag_record(), Plan(iterations=1, start={"tau": 8.0}, sigma={"y": 0.1}))
    assert found.status == "not converged"
    assert found.advice == "Raise Plan.iterations, or start closer (Plan.start)"


@pytest.mark.parametrize("rho", [0.5, 0.9])
def test_coloured_residuals_widen_a_mean_by_the_closed_form(rho):
    rng = np.random.default_rng(5)
    growth = []
    for _ in range(8):
        u = np.repeat(rng.normal(size=30), 200)[:, None]
        noise = autoregression(rng, 6000, rho)[:, None]
        found = fit(Line(), Record(u, 1.0 + 2.0 * u + noise))
        assert not found.white
        assert found.sd_used[0] == found.sd_coloured[0]
        growth.append(found.sd_coloured[0] / found.sd[0])
    assert np.mean(growth) == pytest.approx(np.sqrt((1 + rho) / (1 - rho)), rel=0.12)


def test_white_residuals_keep_the_cramer_rao_deviation():
    found = fit(Line(), line_record(points=5000))
    assert found.white
    np.testing.assert_array_equal(found.sd_used, found.sd)
    np.testing.assert_allclose(found.sd_coloured, found.sd, rtol=0.1)


def test_coloured_intervals_cover_where_plain_ones_do_not():
    plain = coloured = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        u = np.repeat(rng.normal(size=20), 50)[:, None]
        found = fit(Line(), Record(u, 1.0 + 2.0 * u + autoregression(rng, 1000, 0.8)[:, None]))
        error, half = abs(found.values[1] - 2.0), norm.ppf(0.95)
        plain += error < half * found.sd[1]
        coloured += error < half * found.sd_coloured[1]
    assert plain < 36  # 60 % at most
    assert coloured > 46  # 77 % at least: 90 % less three deviations of 60 draws


@pytest.mark.slow
def test_intervals_of_90_percent_cover_90_percent():
    hits = []
    truth = np.array([2.0, 0.6, 3.0])
    for seed in range(300):
        found = fit(Lag(), lag_record(seed, 300), Plan(sigma={"y": 0.1}))
        ends = np.array([found.interval(name) for name in found.names])
        hits.append((ends[:, 0] < truth) & (truth < ends[:, 1]))
    each = np.mean(hits, axis=0)
    assert 0.88 < np.mean(hits) < 0.92
    assert np.all((each > 0.82) & (each < 0.97))


STILL = Record(np.ones((9, 1)), np.arange(9.0)[:, None], "still")


@pytest.mark.parametrize(
    ("model", "records", "plan", "kind", "message"),
    [
        (Line(), [STILL], Plan(), DataError,
         ("still: no input moves in any record: only offsets could be determined. "
          "Choose records with transients")),
        (Line(), [line_record(points=2)], Plan(), DataError,
         "one: 2 measured values cannot determine 2 parameters. Add records, or fix parameters"),
        (Line(), [line_record(), line_record(1)], Plan(), DataError,
         "one: two records have the same name"),
        (Line(), [Record(np.ones((5, 1)), np.ones((5, 2)), "wide")], Plan(), DataError,
         "wide: expected 1 outputs (y), found 2"),
        (Line(), [line_record()], Plan(free=("a", "slope")), ConfigError,
         "the model has no parameter 'slope'. It has a, b"),
        (Line(), [line_record()], Plan(fixed={"a": 1.0, "b": 1.0}), ConfigError,
         "no parameter is free. Name one in free, or take it out of fixed"),
        (Line(), [line_record()], Plan(start={"b": 9.0}), ConfigError,
         "b starts at 9, outside its bounds -5 to 5"),
        (Line(), [line_record()], Plan(sigma={"x": 1.0}), ConfigError,
         "no positive noise standard deviation is given for y"),
        (Line(), [line_record()], Plan(start={"a": np.inf}), ModelError,
         "the simulation is not finite at the start values. Change Plan.start"),
    ],
)  # fmt: skip
def test_what_cannot_be_estimated_is_refused(model, records, plan, kind, message):
    with pytest.raises(kind) as error:
        fit(model, records, plan)
    assert str(error.value) == message


def test_one_still_record_among_others_is_a_warning():
    found = fit(Line(), [line_record(), STILL])
    assert found.warnings == ("still: its inputs never move; it determines only offsets",)
