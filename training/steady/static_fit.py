"""Estimate a static model from columns, by any of the estimators, and score it.

The residual is relative, (y_model - y)/y, because the criterion (5 %) is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, differential_evolution

from narxcal.static_models.model import Columns, StaticModel
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import DataError, ModelError
from training.dynamics.optimisers import Equations, minimise, within
from training.papers.swarm import Draws, swarm

Estimator = Literal["levenberg-marquardt", "swarm", "swarm-paper", "evolution"]
SEARCHES: tuple[Estimator, ...] = ("levenberg-marquardt", "swarm", "swarm-paper", "evolution")
_STEP = 1e-6  # of central differences, of the box: error 1e-12 of truncation, 1e-10 of rounding
_MOST_STEPS, _LEAST_DECREASE = 300, 1e-9
_NO_VALUE = 1.0  # relative residual of a row at which the equation has no value
_SINGULAR = 1e-7  # singular value over the largest, of the scaled Jacobian: not identifiable
_ON_BOUND = 1e-3  # of the range


@dataclass(frozen=True, kw_only=True)
class FitSettings:
    """How to fit: estimator, seed of the searches, polish of the searches by a local fit.

    `fixed` (name -> value) replaces the model's own choice of what is fixed, where it is given.
    """

    estimator: Estimator = "levenberg-marquardt"
    seed: int = 0
    polish: bool = False
    fixed: Mapping[str, float] | None = None


@dataclass(frozen=True, eq=False)
class StaticScore:
    """Relative errors of one model on some rows (section 2.7): a success is within 5 %."""

    mean_pct: float
    max_pct: float
    success_pct: float
    rows: int


@dataclass(frozen=True, eq=False)
class StaticFit:
    """A fitted static model: values and standard deviations (P,), status and advice."""

    model: StaticModel
    values: FloatArray
    sd: FloatArray
    score: StaticScore
    aic: float
    estimator: str
    status: str
    advice: tuple[str, ...]

    def predict(self, columns: Columns) -> FloatArray:
        """Output (rows,); raises as `StaticModel.predict`."""
        return self.model.predict(self.values, columns)

    def document(self) -> dict[str, Any]:
        """JSON-able: model, options, parameters with units and deviations, status, advice."""
        triples = zip(self.model.parameters, self.values.tolist(), self.sd.tolist(), strict=True)
        return {
            "model": self.model.name,
            "recipe": dict(self.model.recipe),
            "reconstruction": self.model.reconstruction,
            "estimator": self.estimator,
            "parameters": {
                p.name: {"value": value, "unit": p.unit, "sd": sd if np.isfinite(sd) else None,
                         "low": p.low, "high": p.high}
                for p, value, sd in triples
            },
            "status": self.status,
            "advice": list(self.advice),
        }  # fmt: skip


def score(predicted: FloatArray, measured: FloatArray, criterion: float = 0.05) -> StaticScore:
    """Mean, largest and share within `criterion` of the relative error; NaN rows are left out."""
    error = np.abs(predicted - measured) / np.abs(measured)
    error = error[np.isfinite(error)]
    if not len(error):
        raise DataError("no row has both a prediction and a measurement")
    share = float(np.mean(error <= criterion))
    return StaticScore(
        100.0 * float(error.mean()), 100.0 * float(error.max()), 100.0 * share, len(error)
    )


def fit(model: StaticModel, columns: Columns, settings: FitSettings | None = None) -> StaticFit:
    """Fit the free parameters of `model` to its output among `columns`.

    A model that is linear in its parameters is solved directly, unless a search is chosen.
    Rows with NaN are left out and counted in the advice. Raises `DataError` for a missing column,
    too few rows, or coefficients that the rows do not determine; `ModelError` naming the rows
    where the fitted equation has no value.
    """
    settings = settings or FitSettings()
    problem, dropped = _problem(model, columns, settings)
    if model.design is not None and settings.estimator == "levenberg-marquardt":
        free, how = _solved(problem, model.design(problem.columns)), ("linear", "solved directly")
    else:
        free, status = _searched(problem, settings)
        how = settings.estimator, status
    return _result(problem, free, how, dropped)


def fit_correction(model: StaticModel, base: StaticFit, columns: Columns) -> StaticFit:
    """Fit only the correction of `model` (made by `corrected`), its base kept as fitted.

    Linear least squares on the relative residual of the base.
    """
    count = len(base.values)
    names = [p.name for p in model.parameters[:count]]
    fixed = dict(zip(names, base.values.tolist(), strict=True))
    problem, dropped = _problem(model, columns, FitSettings(fixed=fixed))
    start = np.zeros(len(problem.free))
    jacobian = problem.residuals(np.eye(len(start))) - problem.residuals(start)
    free = _least_squares(jacobian.T, -problem.residuals(start), problem)
    return _result(problem, free, ("linear", "solved directly"), dropped)


@dataclass(frozen=True, eq=False)
class _Problem:
    """Relative residuals of a model over its free parameters."""

    model: StaticModel
    columns: Columns
    measured: FloatArray
    base: FloatArray  # (P,), in which the free ones are replaced
    free: NDArray[np.int64]

    def values(self, free: FloatArray) -> FloatArray:
        """All parameters (..., P)."""
        whole = np.broadcast_to(self.base, (*free.shape[:-1], len(self.base))).copy()
        whole[..., self.free] = free
        return whole

    def residuals(self, free: FloatArray) -> FloatArray:
        """(..., F) -> (..., rows)."""
        with np.errstate(all="ignore"):
            found = self.model.equation(self.values(free), self.columns) / self.measured - 1.0
        return np.where(np.isfinite(found), found, _NO_VALUE)

    def costs(self, free: FloatArray) -> FloatArray:
        """Mean square of the relative residual, (..., F) -> (...)."""
        return np.asarray(np.mean(np.square(self.residuals(free)), axis=-1))

    @property
    def box(self) -> tuple[FloatArray, FloatArray]:
        low, high = self.model.bounds
        return low[self.free], high[self.free]


@dataclass(frozen=True, eq=False)
class Boxed:
    """Least squares over a box, as a problem of `training.dynamics.optimisers`.

    `residuals` maps (..., F) to (..., rows). The unknown is x = (theta - low)/(high - low).
    """

    residuals: Callable[[FloatArray], FloatArray]
    low: FloatArray
    high: FloatArray

    def theta(self, x: FloatArray) -> FloatArray:
        """Parameters at x, clipped to the box."""
        return np.asarray(self.low + (self.high - self.low) * np.clip(x, 0.0, 1.0))

    def loss(self, x: FloatArray) -> float:
        """Half the sum of squares."""
        r = self.residuals(self.theta(x))
        return 0.5 * float(r @ r)

    def normal_equations(self, x: FloatArray) -> Equations:
        """Gradient and Gauss-Newton matrix from differences, central inside the box."""
        r, steps = self.residuals(self.theta(x)), _STEP * np.eye(len(x))
        ahead, behind = np.minimum(x + steps, 1.0), np.maximum(x - steps, 0.0)
        ends = self.residuals(self.theta(np.concatenate([ahead, behind])))
        J = (ends[: len(x)] - ends[len(x) :]) / np.diag(ahead - behind)[:, np.newaxis]
        return Equations(0.5 * float(r @ r), J @ r, J @ J.T)

    def minimum(self, start: FloatArray) -> tuple[FloatArray, str]:
        """Minimise from `start` (F,) by Levenberg-Marquardt; returns theta and the status."""
        x, last = (start - self.low) / (self.high - self.low), np.inf
        inside = within(np.zeros_like(x), np.ones_like(x))
        for count, step in enumerate(minimise(self, x, propose=inside), start=1):
            x = step.theta
            if last - step.loss <= _LEAST_DECREASE * step.loss:
                return self.theta(x), f"converged in {count} steps"
            if count == _MOST_STEPS:
                return self.theta(x), f"stopped after {count} steps: start elsewhere"
            last = step.loss
        return self.theta(x), "converged: no step lowers the loss"


def _problem(model: StaticModel, columns: Columns, settings: FitSettings) -> tuple[_Problem, int]:
    if model.output not in columns:
        raise DataError(f"the fit of '{model.name}' needs {model.output}", channel=model.output)
    used = model.checked(columns)
    y = np.asarray(columns[model.output], dtype=np.float64)
    good = np.isfinite(np.array([y, *(used[name] for name in model.inputs)])).all(axis=0)
    good &= y != 0.0  # a relative error needs a value
    fixed = settings.fixed
    if fixed is None:
        fixed = {p.name: p.start for p in model.parameters if p.fixed}
    unknown = set(fixed) - {p.name for p in model.parameters}
    if unknown:
        raise ModelError(f"'{model.name}' has no parameter named {', '.join(sorted(unknown))}")
    base = np.array([fixed.get(p.name, p.start) for p in model.parameters])
    free = np.array([k for k, p in enumerate(model.parameters) if p.name not in fixed], dtype=int)
    rows = int(good.sum())
    if rows <= len(free):
        raise DataError(
            f"{rows} usable rows for the {len(free)} free parameters of '{model.name}'",
            hint="Add rows, lower the degrees or fix parameters",
        )
    kept = {name: array[good] for name, array in used.items()}
    return _Problem(model, kept, y[good], base, free), len(good) - rows


def _solved(problem: _Problem, matrix: FloatArray) -> FloatArray:
    offset = matrix @ problem.values(np.zeros(len(problem.free)))
    weighted = matrix[:, problem.free] / problem.measured[:, np.newaxis]
    return _least_squares(weighted, 1.0 - offset / problem.measured, problem)


def _least_squares(matrix: FloatArray, target: FloatArray, problem: _Problem) -> FloatArray:
    scale = np.linalg.norm(matrix, axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    solution, _, rank, _ = np.linalg.lstsq(matrix / scale, target, rcond=1e-12)
    if rank < matrix.shape[1]:
        raise DataError(
            f"the rows determine {rank} of the {matrix.shape[1]} coefficients of "
            f"'{problem.model.name}'",
            hint="Lower the degrees, or fly more lever angles, altitudes or Mach numbers",
        )
    return np.asarray((solution.T / scale).T)


def _searched(problem: _Problem, settings: FitSettings) -> tuple[FloatArray, str]:
    low, high = problem.box
    start = np.clip(problem.base[problem.free], low, high)
    boxed = Boxed(problem.residuals, low, high)
    if settings.estimator == "levenberg-marquardt":
        return boxed.minimum(start)
    if settings.estimator == "evolution":

        def columnwise(x: FloatArray, /) -> Any:
            return problem.costs(x.T)

        found = differential_evolution(
            columnwise, Bounds(low, high), vectorized=True, updating="deferred", polish=False,
            rng=settings.seed, maxiter=100, tol=1e-8,
        )  # fmt: skip
        best, status = np.asarray(found.x), "converged" if found.success else str(found.message)
    else:
        draws: Draws = "uniform" if settings.estimator == "swarm" else "binary"
        swarmed = swarm(problem.costs, low, high, settings.seed, draws)
        best, status = swarmed.best, swarmed.status
    if settings.polish:
        best, local = boxed.minimum(best)
        status = f"{status}; polish {local}"
    return best, status


def _result(problem: _Problem, free: FloatArray, how: tuple[str, str], dropped: int) -> StaticFit:
    model, values = problem.model, problem.values(free)
    predicted = model.predict(values, problem.columns)
    r = predicted / problem.measured - 1.0
    n, count = len(r), len(free)
    variance = float(r @ r) / max(n - count, 1)
    sd, blind = _deviations(problem, free, variance)
    advice = [
        *([f"{dropped} rows with NaN or a zero output were left out"] if dropped else []),
        *_at_bounds(problem, free),
        *blind,
    ]
    whole = np.zeros(len(values))
    whole[problem.free] = sd
    aic = n * float(np.log(max(float(r @ r) / n, 1e-300))) + 2.0 * count
    return StaticFit(
        model, values, whole, score(predicted, problem.measured), aic, how[0], how[1],
        tuple(advice),
    )  # fmt: skip


def _deviations(
    problem: _Problem, free: FloatArray, variance: float
) -> tuple[FloatArray, list[str]]:
    """Standard deviations (F,); infinite along a direction that is not determined (named)."""
    low, high = problem.box
    steps = _STEP * (high - low)
    ends = np.concatenate([free + np.diag(steps), free - np.diag(steps)])
    r = problem.residuals(ends)
    J = ((r[: len(free)] - r[len(free) :]) / (2.0 * steps[:, np.newaxis])).T
    scale = np.linalg.norm(J, axis=0)
    dead = scale == 0.0
    _, s, Vt = np.linalg.svd(J / np.where(dead, 1.0, scale), full_matrices=False)
    determined = s > _SINGULAR * s[0]
    covariance = (Vt[determined].T / s[determined] ** 2) @ Vt[determined]
    sd = np.sqrt(variance * np.diag(covariance)) / np.where(dead, 1.0, scale)
    names = [problem.model.parameters[k].name for k in problem.free]
    advice, lost = [], dead.copy()
    for direction in Vt[~determined]:
        parts = np.abs(direction) > 0.1
        lost |= parts
        advice.append("not identifiable together: " + ", ".join(np.array(names)[parts].tolist()))
    return np.where(lost, np.inf, sd), advice


def _at_bounds(problem: _Problem, free: FloatArray) -> list[str]:
    low, high = problem.box
    found = []
    for k, value, a, b in zip(problem.free, free, low, high, strict=True):
        p = problem.model.parameters[k]
        found += [
            f"{p.name} ends on its bound {bound:g} {p.unit}".removesuffix(" -")
            for bound in (a, b)
            if abs(value - bound) <= _ON_BOUND * (b - a)
        ]
    return found
