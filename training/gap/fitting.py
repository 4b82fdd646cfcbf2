"""Fits one hypothesis, one effect or several at once, to the gap of all flights.

Gauss-Newton with Levenberg's damping on the measure of `quadratic`; derivatives are differences,
all of one step in one batch of runs. Linear parameters are solved at every start, so that only
the others need starts. What a fit is worth on a flight that took no part in it comes from the
jackknife: one Gauss-Newton step without that flight, and the quadratic form there (Wu, *Annals
of Statistics* 14, 1986).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from narxcal.effects.base import Effect, Parameter
from narxcal.effects.running import Emulator, Flights, respond
from narxcal.support.arrays import FloatArray
from training.gap.bounded import least_within, room, without
from training.gap.quadratic import Misfit

_STEPS = 7
_GOOD = 2e-3  # relative progress of Q below which a fit has converged
_RIDGE = 1e-9
_EITHER = 0.5  # of a share that is all or nothing
_FEW = 4  # flights of which none may speak against an effect; of more, one
_End = tuple[FloatArray, FloatArray, FloatArray]  # theta, the response there, its slopes


@dataclass(frozen=True, eq=False)
class Problem:
    """What every hypothesis is fitted to."""

    flights: Flights
    emulator: Emulator | None
    misfit: Misfit


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted hypothesis.

    `theta` (p,) in the order of the effects' parameters; `left` Q per flight at it; `held_out` Q
    per flight at the parameters found without that flight, `others` (flights, p) those; `response`
    (flights, time, outputs), and its `slopes` (p, ...) by every parameter. `sizes` counts the
    parameters of each effect.
    """

    effects: tuple[Effect, ...]
    parameters: tuple[Parameter, ...]
    theta: FloatArray
    left: FloatArray
    held_out: FloatArray
    others: FloatArray
    response: FloatArray
    slopes: FloatArray
    sizes: tuple[int, ...]

    @property
    def name(self) -> str:
        """Names of the effects, joined by a plus."""
        return " + ".join(effect.name for effect in self.effects)

    @property
    def at_end(self) -> bool:
        """Whether the time constant or delay that an effect begins with lies on a bound."""
        first = np.cumsum((0, *self.sizes[:-1]))
        times = (
            (self.parameters[k], self.theta[k]) for k in first if self.parameters[k].unit == "s"
        )
        return any(value in (p.low, p.high) and value != p.neutral for p, value in times)

    @property
    def at_bound(self) -> bool:
        """Whether a size lies on its bound: what it follows is larger than the effect can be."""
        pairs = zip(self.parameters, self.theta, strict=True)
        return any(p.linear and value in (p.low, p.high) for p, value in pairs)

    @property
    def loopless(self) -> bool:
        """Whether an effect in a loop that the engine has was fitted outside of it."""
        return self.chose("outside")

    @property
    def by_control(self) -> bool:
        """Whether a slower deceleration was found to be the control's limit, not the rotors'."""
        return self.chose("by_control")

    def chose(self, name: str) -> bool:
        """Whether the parameter `name`, a share that is all or nothing, was found to be all."""
        pairs = zip(self.parameters, self.theta, strict=True)
        return any(p.name == name and value >= _EITHER for p, value in pairs)


def in_nearly_all(gained: FloatArray) -> bool:
    """Whether what is `gained` (flights,) is more than nothing in all but one; in all of a few."""
    return int((gained <= 0.0).sum()) <= (1 if len(gained) > _FEW else 0)


def fit(effects: Sequence[Effect], problem: Problem, start: FloatArray | None = None) -> Fit:
    """Fit `effects` together, from `start` (p,) or from the best of their own starts.

    Where an effect may be one of two mechanisms, both are fitted and the better one is taken: far
    from the answer, where starts are, one says little of the other. Where all end farther from the
    flights than no effect at all, the fit begins there.
    """
    parameters = tuple(p for effect in effects for p in effect.parameters(problem.flights.signals))
    starts = _best_starts(effects, parameters, problem) if start is None else [start]
    (theta, response, slopes), left = _best_end(effects, parameters, problem, starts)
    if float(left.sum()) > float(problem.misfit.size(problem.misfit.gap).sum()):
        none = np.array([p.neutral for p in parameters])
        (theta, response, slopes), left = _best_end(effects, parameters, problem, [none])
    rest = problem.misfit.gap - response
    held_out, others = _jackknife(problem.misfit, (rest, slopes, left), theta, parameters)
    sizes = tuple(len(e.parameters(problem.flights.signals)) for e in effects)
    return Fit(tuple(effects), parameters, theta, left, held_out, others, response, slopes, sizes)


def _best_end(
    effects: Sequence[Effect],
    parameters: Sequence[Parameter],
    problem: Problem,
    starts: Sequence[FloatArray],
) -> tuple[_End, FloatArray]:
    """Theta, response and slopes that leave least of those that the starts lead to; Q left."""
    ends = [_refine(effects, parameters, problem, begin) for begin in starts]
    sizes_left = [problem.misfit.size(problem.misfit.gap - response) for _, response, _ in ends]
    best = min(range(len(ends)), key=lambda k: float(sizes_left[k].sum()))
    return ends[best], sizes_left[best]


def _run(effects: Sequence[Effect], thetas: FloatArray, problem: Problem) -> FloatArray:
    """Change of the outputs (batch, flights, time, outputs) at `thetas` (batch, p)."""
    settings, at = [], 0
    for effect in effects:
        count = len(effect.parameters(problem.flights.signals))
        settings.append((effect, thetas[:, at : at + count]))
        at += count
    moved = respond(settings, problem.flights, problem.emulator) - problem.flights.y
    return np.where(np.isfinite(moved), moved, 1e6)


def _best_starts(
    effects: Sequence[Effect], parameters: Sequence[Parameter], problem: Problem
) -> list[FloatArray]:
    """Best of all combinations of starts, of each mechanism; linear parameters solved at each."""
    nodes = (effect.nodes(problem.flights.signals) for effect in effects)
    thetas = np.array([sum(each, ()) for each in product(*nodes)])
    linear = [j for j, p in enumerate(parameters) if p.linear]
    base = () if linear else _run(effects, thetas, problem)
    mechanism = [j for j, p in enumerate(parameters) if p.all_or_nothing]
    found: dict[tuple[float, ...], tuple[float, FloatArray]] = {}
    for k, start in enumerate(thetas):
        if linear:
            units = np.repeat(start[None], 1 + len(linear), axis=0)
            units[1 + np.arange(len(linear)), linear] = 1.0
            response, *moved = _run(effects, units, problem)
            slopes, rest = np.stack(moved) - response, problem.misfit.gap - response
            step = _solve(problem.misfit, slopes, rest, 0.0)
            theta = _clipped(_added(start, linear, step), parameters)
            rest = rest - np.tensordot(theta[linear], slopes, axes=1)
        else:
            theta, rest = start, problem.misfit.gap - base[k]
        size, which = float(problem.misfit.size(rest).sum()), tuple(start[mechanism])
        if which not in found or size < found[which][0]:
            found[which] = size, theta
    return [theta for _, theta in found.values()]


def _added(theta: FloatArray, places: Sequence[int], values: FloatArray) -> FloatArray:
    changed = theta.copy()
    changed[list(places)] = values
    return changed


def _refine(
    effects: Sequence[Effect],
    parameters: Sequence[Parameter],
    problem: Problem,
    theta: FloatArray,
) -> _End:
    """Damped Gauss-Newton; returns theta, the response there and its slopes."""
    damping, error = 1e-3, np.inf
    response, slopes = _linearised(effects, parameters, problem, theta)
    error = float(problem.misfit.size(problem.misfit.gap - response).sum())
    for _ in range(_STEPS):
        step = _solve(problem.misfit, slopes, problem.misfit.gap - response, damping)
        trial = _clipped(theta + step, parameters)
        there, steeper = _linearised(effects, parameters, problem, trial)
        found = float(problem.misfit.size(problem.misfit.gap - there).sum())
        if found < error:
            gained = (error - found) / error
            theta, response, slopes, error = trial, there, steeper, found
            damping *= 0.1
            if gained < _GOOD:
                break
        else:
            damping *= 30.0
            if damping > 1e3 or np.allclose(trial, theta, rtol=1e-3, atol=0.0):
                break
    return theta, response, slopes


def _linearised(
    effects: Sequence[Effect],
    parameters: Sequence[Parameter],
    problem: Problem,
    theta: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Response and its slopes (p, ...) by differences, away from the nearer bound."""
    steps = np.array([_difference(p, v) for p, v in zip(parameters, theta, strict=True)])
    thetas = np.concatenate([theta[None], theta + np.diag(steps)])
    found = _run(effects, thetas, problem)
    return found[0], (found[1:] - found[0]) / steps[:, None, None, None]


def _difference(parameter: Parameter, value: float) -> float:
    if parameter.linear:
        return 0.01 * (parameter.high - parameter.low)
    away, small = abs(value - parameter.neutral), _scale(parameter)
    if parameter.neutral != 0.0:  # of a limit far above it, or a factor, a share of itself
        away, small = min(away, abs(value)), min(small, abs(value))
    size = 0.03 * max(away, 0.3 * small)
    return size if value + size <= parameter.high else -size


def _scale(parameter: Parameter) -> float:
    """Size of a small effect of this kind: its start nearest to neutral."""
    return min(abs(s - parameter.neutral) for s in parameter.starts if s != parameter.neutral)


def _clipped(theta: FloatArray, parameters: Sequence[Parameter]) -> FloatArray:
    return np.clip(theta, [p.low for p in parameters], [p.high for p in parameters])


def _solve(misfit: Misfit, slopes: FloatArray, rest: FloatArray, damping: float) -> FloatArray:
    """Gauss-Newton step for what is left, `rest`, with a share `damping` of its own diagonal."""
    hessian = misfit.inner(slopes, slopes).sum(axis=0)
    toward = misfit.inner(slopes, rest[None]).sum(axis=0)[:, 0]
    return _newton(hessian, toward, damping)


def _newton(hessian: FloatArray, toward: FloatArray, damping: float = 0.0) -> FloatArray:
    diagonal = np.maximum(np.diag(hessian), 1e-300)
    scale = np.sqrt(diagonal)
    scaled = hessian / np.outer(scale, scale) + (damping + _RIDGE) * np.eye(len(hessian))
    return np.asarray(np.linalg.solve(scaled, toward / scale) / scale)


def _jackknife(
    misfit: Misfit,
    at: tuple[FloatArray, FloatArray, FloatArray],
    theta: FloatArray,
    parameters: Sequence[Parameter],
) -> tuple[FloatArray, FloatArray]:
    """Q of each flight (flights,) without it in the fit, and the parameters then (flights, p)."""
    rest, slopes, left = at
    hessian = misfit.inner(slopes, slopes)
    toward = misfit.inner(slopes, rest[None])[..., 0]
    held_out, others = left.copy(), np.repeat(theta[None], len(left), axis=0)
    if len(left) < 2:
        return held_out, others
    bounds = room(theta, parameters)
    for f in range(len(left)):
        step = least_within(*without((hessian, toward), f), bounds)
        others[f] = theta + step
        held_out[f] = left[f] - 2.0 * step @ toward[f] + step @ hessian[f] @ step
    return np.maximum(held_out, 0.0), others
