"""Maximum-likelihood output error: parameters of any simulated model from measured outputs.

The model is simulated from its inputs alone; the residuals v(k) = z(k) - y(k, theta) are taken as
measurement noise of covariance R = diag(sigma^2). Minimised is (DeHoff et al., equation 6)

    J(theta) = 1/2 sum_k v(k)' R^-1 v(k)            R known
    J        = N/2 ln det R,  R = 1/N sum_k v v'    R estimated, in turns with theta

by Levenberg-Marquardt on M = sum S' R^-1 S and g = -sum S' R^-1 v with S = dy/dtheta.
Sensitivities are complex steps: `Model.simulate` is run once per free parameter with a value of
value + 1e-20 i, and has to be written so that it accepts that (arithmetic, and comparisons of real
parts); no difference is taken, so they are exact.

Hysteresis makes J continuous with kinks where the contact set changes. Between them the
sensitivities are exact, and a step that does not lower J is rejected, so the method goes downhill
through kinks and can only stop early at one. Then the status is "stalled".

Sources: Maine and Iliff, NASA RP-1168, 1985; Klein and Morelli, Aircraft System Identification,
2006, chapter 6; bounds by `training.dynamics.optimisers.within`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from narxcal.output_error.engine import Parameter
from narxcal.record import Record, check_measured, check_records
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError, DataError, ModelError
from training.dynamics.optimisers import Equations, minimise, stopped, within
from training.papers.likelihood_statistics import (
    coloured_covariance,
    information,
    whiteness,
)
from training.papers.output_error_result import OutputErrorFit, Status

_COMPLEX_STEP = 1e-20
# Newton decrement g' M^-1 g, twice the drop of J that a full step still promises: 1e-3 is a step
# of 0.03 standard deviations.
_CONVERGED = 1e-3
# A drop of J by less than this is a step of about 1e-3 standard deviations.
_SMALL_DROP = 1e-6


class Model(Protocol):
    """Outputs from inputs, for parameters by name.

    `simulate` gets inputs (time, m) and returns outputs (time, p) in the order of `output_names`,
    complex if a value is.
    """

    @property
    def parameters(self) -> Sequence[Parameter]: ...
    @property
    def output_names(self) -> Sequence[str]: ...
    def simulate(self, values: Mapping[str, complex], u: FloatArray) -> NDArray[Any]: ...


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Which parameters are estimated, and from where.

    `free` names them (None: as the model says); `fixed` gives values and takes them out of `free`;
    `tied` maps a parameter to the one whose value it takes (None: as the model says); parameters in
    `per_record` have a value of their own in each record (initial states, offsets), all others are
    shared; `start` and `bounds` replace the model's. `sigma` maps outputs to known noise standard
    deviations; None estimates them.
    """

    free: Sequence[str] | None = None
    fixed: Mapping[str, float] = field(default_factory=dict)
    tied: Mapping[str, str] | None = None
    per_record: Sequence[str] = ()
    start: Mapping[str, float] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    sigma: Mapping[str, float] | None = None
    iterations: int = 60


@dataclass(frozen=True)
class Coordinate:
    """One free number: a parameter, shared or of one record."""

    parameter: str
    record: int | None
    name: str
    start: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class Layout:
    """Free numbers in order, values of fixed parameters, and ties."""

    coordinates: tuple[Coordinate, ...]
    constants: Mapping[str, float]
    ties: Mapping[str, str]

    @property
    def names(self) -> tuple[str, ...]:
        """NAME, or NAME@RECORD where each record has its own."""
        return tuple(one.name for one in self.coordinates)

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper bounds (P,)."""
        low = np.array([one.low for one in self.coordinates])
        return low, np.array([one.high for one in self.coordinates])

    def values(self, theta: Sequence[complex], record: int) -> dict[str, complex]:
        """Every parameter by name in one record, for free numbers theta (P,)."""
        found: dict[str, complex] = dict(self.constants)
        for one, value in zip(self.coordinates, theta, strict=True):
            if one.record in (None, record):
                found[one.parameter] = value
        return found | {name: found[source] for name, source in self.ties.items()}


def layout_of(model: Model, records: Sequence[Record], plan: Plan) -> Layout:
    """Sort the parameters of the model into free, fixed and tied ones."""
    known = {one.name: one for one in model.parameters}
    ties = plan.tied
    if ties is None:
        ties = {one.name: one.tied_to for one in model.parameters if one.tied_to}
    named = [*(plan.free or ()), *plan.fixed, *plan.per_record, *plan.start, *plan.bounds, *ties,
             *ties.values()]  # fmt: skip
    for name in named:
        if name not in known:
            raise ConfigError(
                f"the model has no parameter {name!r}", hint=f"It has {', '.join(known)}"
            )
    free = [
        name
        for name, one in known.items()
        if (name in plan.free if plan.free is not None else one.free or name in plan.per_record)
        and name not in plan.fixed
        and name not in ties
    ]
    coordinates = []
    for name in free:
        low, high = plan.bounds.get(name, (known[name].low, known[name].high))
        start = plan.start.get(name, known[name].start)
        if not low <= start <= high:
            raise ConfigError(f"{name} starts at {start:g}, outside its bounds {low:g} to {high:g}")
        own = [*range(len(records))] if name in plan.per_record else [None]
        for k in own:
            label = name if k is None else f"{name}@{records[k].name}"
            coordinates.append(Coordinate(name, k, label, start, low, high, known[name].unit))
    if not coordinates:
        raise ConfigError("no parameter is free", hint="Name one in free, or take it out of fixed")
    rest = {
        name: plan.fixed.get(name, plan.start.get(name, one.start))
        for name, one in known.items()
        if name not in free and name not in ties
    }
    return Layout(tuple(coordinates), rest, ties)


@dataclass(frozen=True, eq=False)
class _Point(Equations):
    """Cost, its gradient and the information matrix at one theta, and what they are made of."""

    residuals: tuple[FloatArray, ...]
    sensitivities: tuple[FloatArray, ...]


@dataclass(frozen=True, eq=False)
class _Likelihood:
    """J of all records for a given sigma (p,): a problem for training.dynamics.optimisers."""

    model: Model
    records: Sequence[Record]
    layout: Layout
    sigma: FloatArray

    def residuals(self, theta: FloatArray) -> tuple[FloatArray, ...]:
        """Residuals (time, p) of each record; 0 where the output is masked."""
        return tuple(
            _masked(record, record.y - self._run(theta.tolist(), k).real)
            for k, record in enumerate(self.records)
        )

    def sensitivities(self, theta: FloatArray) -> tuple[FloatArray, ...]:
        """dy/dtheta (time, p, P) of each record by complex steps; 0 where masked."""
        found = []
        for k, record in enumerate(self.records):
            slopes = np.zeros((*record.y.shape, len(theta)))
            for j, one in enumerate(self.layout.coordinates):
                if one.record in (None, k):
                    stepped: list[complex] = theta.tolist()
                    stepped[j] = complex(theta[j], _COMPLEX_STEP)
                    slopes[:, :, j] = self._run(stepped, k).imag / _COMPLEX_STEP
            found.append(_masked(record, slopes))
        return tuple(found)

    def loss(self, theta: FloatArray) -> float:
        """Half the sum of squared residuals in units of sigma; infinite where a run diverges."""
        with np.errstate(over="ignore", invalid="ignore"):
            total = sum(float(((v / self.sigma) ** 2).sum()) for v in self.residuals(theta))
        return 0.5 * total if np.isfinite(total) else np.inf

    def normal_equations(self, theta: FloatArray) -> _Point:
        """Loss, gradient and information matrix."""
        residuals, slopes = self.residuals(theta), self.sensitivities(theta)
        size = len(theta)
        gradient, hessian = np.zeros(size), np.zeros((size, size))
        for v, s in zip(residuals, slopes, strict=True):
            scaled = (s / self.sigma[:, None]).reshape(-1, size)
            gradient -= scaled.T @ (v / self.sigma).ravel()
            hessian += scaled.T @ scaled
        return _Point(self.loss(theta), gradient, hessian, residuals, slopes)

    def _run(self, theta: Sequence[complex], record: int) -> NDArray[Any]:
        with np.errstate(over="ignore", invalid="ignore"):
            return self.model.simulate(self.layout.values(theta, record), self.records[record].u)


def _masked(record: Record, values: FloatArray) -> FloatArray:
    known = np.isfinite(record.y)
    return np.where(known if values.ndim == 2 else known[:, :, None], values, 0.0)


def fit(
    model: Model, records: Sequence[Record] | Record, plan: Plan | None = None
) -> OutputErrorFit:
    """Estimate the free parameters of `model` from inputs and outputs of `records`.

    Masked outputs (NaN) are left out; weights of records are not used. Raises `ConfigError` for a
    plan that does not fit the model, `DataError` for records that cannot determine anything, and
    `ModelError` where the model cannot be simulated at its start values.
    """
    plan, records = plan or Plan(), [records] if isinstance(records, Record) else list(records)
    layout = layout_of(model, records, plan)
    warnings = _check_records(model, records, layout)
    theta = np.array([one.start for one in layout.coordinates])
    if plan.sigma is None:
        check_measured(records, "estimation")
    problem = _Likelihood(model, records, layout, _known_sigma(model, plan))
    if not np.isfinite(problem.loss(theta)):
        raise ModelError(
            "the simulation is not finite at the start values", hint="Change Plan.start"
        )
    theta, problem, iterations = _search(problem, theta, plan)
    return _result(problem, theta, plan, (iterations, warnings))


def _check_records(model: Model, records: Sequence[Record], layout: Layout) -> list[str]:
    """Refuse records that determine nothing; warn of those that determine little."""
    check_records(records, longer_than=1)
    outputs = len(model.output_names)
    if records[0].y.shape[1] != outputs:
        raise DataError(
            f"expected {outputs} outputs ({', '.join(model.output_names)}), "
            f"found {records[0].y.shape[1]}",
            file=records[0].name,
        )
    names = [record.name for record in records]
    if len(set(names)) < len(names):
        raise DataError("two records have the same name", file=max(names, key=names.count))
    known = sum(int(np.isfinite(record.y).sum()) for record in records)
    if known <= len(layout.coordinates):
        raise DataError(
            f"{known} measured values cannot determine {len(layout.coordinates)} parameters",
            file=records[0].name,
            hint="Add records, or fix parameters",
        )
    still = [record.name for record in records if not np.ptp(record.u, axis=0).any()]
    if len(still) == len(records):
        raise DataError(
            "no input moves in any record: only offsets could be determined",
            file=records[0].name,
            hint="Choose records with transients",
        )
    return [f"{name}: its inputs never move; it determines only offsets" for name in still]


def _known_sigma(model: Model, plan: Plan) -> FloatArray:
    if plan.sigma is None:
        return np.ones(len(model.output_names))
    missing = [name for name in model.output_names if not plan.sigma.get(name, 0.0) > 0.0]
    if missing:
        raise ConfigError(f"no positive noise standard deviation is given for {missing[0]}")
    return np.array([plan.sigma[name] for name in model.output_names])


def _estimated_sigma(problem: _Likelihood, theta: FloatArray) -> FloatArray:
    """RMS residual (p,), at least 1e-8 of the outputs' spread, so that a perfect fit is finite."""
    outputs = np.vstack([record.y for record in problem.records])
    known = np.isfinite(outputs)
    count = np.maximum(known.sum(axis=0), 1)
    squares = (np.vstack(problem.residuals(theta)) ** 2).sum(axis=0)
    lowest = 1e-8 * np.std(np.where(known, outputs, 0.0), axis=0) + 1e-12
    return np.asarray(np.maximum(np.sqrt(squares / count), lowest))


def _search(
    problem: _Likelihood, theta: FloatArray, plan: Plan
) -> tuple[FloatArray, _Likelihood, int]:
    """Minimise over theta, in turns with R where it is not known; never both in one step."""
    if plan.sigma is not None:
        theta, count = _descend(problem, theta, plan.iterations)
        return theta, problem, count
    total, before = 0, np.inf
    while total < plan.iterations:
        problem = replace(problem, sigma=_estimated_sigma(problem, theta))
        cost = _log_likelihood_cost(problem, theta)
        theta, count = _descend(problem, theta, plan.iterations - total)
        total += max(count, 1)
        if before - cost < 1e-6 * max(1.0, abs(cost)):
            break
        before = cost
    return theta, problem, total


def _log_likelihood_cost(problem: _Likelihood, theta: FloatArray) -> float:
    """Negative logarithm of the likelihood."""
    known = np.sum([np.isfinite(record.y).sum(axis=0) for record in problem.records], axis=0)
    logs = float((known * np.log(2.0 * np.pi * problem.sigma**2)).sum())
    return problem.loss(theta) + 0.5 * logs


def _descend(problem: _Likelihood, theta: FloatArray, limit: int) -> tuple[FloatArray, int]:
    """Levenberg-Marquardt within the bounds until J drops by almost nothing."""
    low, high = problem.layout.bounds()
    before, count = problem.loss(theta), 0
    for step in islice(minimise(problem, theta, propose=within(low, high)), limit):
        theta, count = step.theta, count + 1
        if before - step.loss < _SMALL_DROP:
            break
        before = step.loss
    return theta, count


def _result(
    problem: _Likelihood, theta: FloatArray, plan: Plan, ending: tuple[int, list[str]]
) -> OutputErrorFit:
    iterations, warnings = ending
    layout, point = problem.layout, problem.normal_equations(theta)
    found = information(point.hessian, layout.names)
    cost = _log_likelihood_cost(problem, theta)
    noise_parameters = 0 if plan.sigma is not None else len(problem.sigma)
    limit = iterations >= plan.iterations
    status, advice = _status(problem, theta, point, (found.unidentifiable, limit))
    coloured = coloured_covariance(
        found.covariance, point.sensitivities, point.residuals, problem.sigma
    )
    low, high = layout.bounds()
    vague = np.flatnonzero(np.isfinite(found.sd) & (found.sd > high - low))
    warnings += [f"{layout.names[k]} is not determined within its bounds" for k in vague]
    return OutputErrorFit(
        names=layout.names,
        units=tuple(one.unit for one in layout.coordinates),
        values=theta,
        covariance=found.covariance,
        covariance_coloured=coloured,
        white=whiteness(point.residuals) > 0.01,
        by_record={
            record.name: {n: v.real for n, v in layout.values(theta.tolist(), k).items()}
            for k, record in enumerate(problem.records)
        },
        sigma=dict(zip(problem.model.output_names, problem.sigma.tolist(), strict=True)),
        residuals=point.residuals,
        cost=cost,
        aic=2.0 * (cost + found.rank + noise_parameters),
        iterations=iterations,
        status=status,
        advice=advice,
        unidentifiable=found.unidentifiable,
        weakest=found.weakest,
        warnings=tuple(warnings),
    )


def _status(
    problem: _Likelihood,
    theta: FloatArray,
    point: _Point,
    known: tuple[tuple[str, ...], bool],
) -> tuple[Status, str]:
    """Say how the search ended, and what to do next."""
    unidentifiable, limit = known
    low, high = problem.layout.bounds()
    move = np.flatnonzero(~stopped(theta, point.gradient, low, high))
    own = information(point.hessian[np.ix_(move, move)], [str(k) for k in move])
    inverse = np.where(np.isfinite(own.covariance), own.covariance, 0.0)
    decrement = float(point.gradient[move] @ inverse @ point.gradient[move])
    bound = [problem.layout.names[k] for k in np.flatnonzero((theta <= low) | (theta >= high))]
    if decrement > _CONVERGED and limit:
        return "not converged", "Raise Plan.iterations, or start closer (Plan.start)"
    if unidentifiable:
        return "unidentifiable", f"Fix or tie one parameter of each of: {'; '.join(unidentifiable)}"
    if decrement > _CONVERGED:
        return "stalled", "No step lowers the cost: fix the hysteresis, or change Plan.start"
    if bound:
        return "on a bound", f"Widen the bounds of {', '.join(bound)}, or fix it there"
    return "converged", "Check the residuals, and predict a record that was not used"
