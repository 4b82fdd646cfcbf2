"""What any simulator may be wrong in by a little, refitted within bounds under every hypothesis.

A linkage has some play, a probe is not quite the simulated one, metal takes up a little more heat:
no simulator is free of it, and where nothing else is wrong the effect nearest to such misfit gains
most of what there is to gain (GAP, section 5, "wrong base"). So small amounts of these effects are
nuisances, of any size up to the bounds below, under every hypothesis and under none. What an effect
takes beyond them is evidence for it; what it takes of them is hardly any.

They are linear in their amounts, so that all is done with inner products: least squares within
bounds, each flight by the others.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np

from narxcal.support.arrays import FloatArray
from training.gap.bounded import least_within, room, without
from training.gap.fitting import Fit, Problem
from training.gap.scatter import build_scatter

_LEVER_DEG: Final = 85.0  # way of a lever of which the play below is a share
# What a control's limit leaves to accelerate with is the difference of two large torques, about a
# third of either: where components scatter by a percent, it does by up to ten times as much.
_BY_SCATTER, _LIMIT = 10.0, (0.03, 0.10)  # of acceleration and deceleration: least, most
_SOUND: Final = 2.0  # of the gap: a shape that leaves more, by the other flights, is none
_SMALL: Final = 1e-9  # way of a parameter that is none


class Little(NamedTuple):
    """How far a parameter may be off without anyone calling it an effect.

    Where `of` names another parameter of the effect that is found above 1, it is that share of it;
    of what `outside` names, a share, the rest is allowed. A control's `limit` may be off by ten
    times as much as components scatter, and `low` and `high` do not count; where `only_if` names a
    parameter, it is one if that is 1.
    """

    parameter: str
    low: float
    high: float
    of: str = ""
    outside: str = ""
    limit: bool = False
    only_if: str = ""


# Tolerances of build and modelling: play of a new linkage, a valve and a probe known to hundredths
# of a second (a slow probe to 6 %), inertias to 2 %, 3 % of a step of temperature stored in metal.
ALLOWED: Final = {
    "throttle_backlash": Little("width_deg", 0.0, 0.3),
    "actuator_lag": Little("tau_s", -0.03, 0.03, outside="outside"),
    "sensor_lag:EGT_C": Little("tau_s", -0.06, 0.06, of="own_s"),
    "spool_lag": Little("factor", -0.02, 0.02),
    "accel_decel_asymmetry": Little("ratio", -0.02, 0.02, limit=True, only_if="by_control"),
    "accel_limit": Little("share", 0.0, 0.0, limit=True),
    "spool_coupling": Little("factor", -0.02, 0.02),
    "heat_soak": Little("share_EGT_C", -0.03, 0.03),
}


class Allowance:
    """Shapes of small misfit (k, flights, time, outputs) and how much of each may be there."""

    def __init__(self, fits: Sequence[Fit], problem: Problem) -> None:
        """Take the shapes from `fits` of one effect each."""
        lever = problem.flights.signals.lever
        scale = (lever[1] - lever[0]) / _LEVER_DEG
        limit = float(
            np.clip(_BY_SCATTER * build_scatter(problem.flights, problem.misfit), *_LIMIT)
        )
        self._misfit = problem.misfit
        every = [row for one in fits for row in _shapes(one, scale, limit)]
        rows = [row for row in every if self._is_sound(*row[1:])]
        self._names = [name for name, *_ in rows]
        empty = np.zeros((0, *problem.misfit.gap.shape))
        self._shapes = np.stack([shape for _, shape, _ in rows]) if rows else empty
        self._bounds = np.array([bounds for *_, bounds in rows]).reshape(-1, 2)

    def held_out(self, tried: Fit | None = None) -> FloatArray:
        """Q per flight (flights,) with what is allowed refitted, beside `tried` or by itself.

        The parameters of `tried` are refitted with it, by a linear step within their bounds, and
        each flight is predicted by the others.
        """
        own = set() if tried is None else {effect.name for effect in tried.effects}
        use = [k for k, name in enumerate(self._names) if name not in own]
        shapes, bounds, rest = self._shapes[use], self._bounds[use], self._misfit.gap
        if tried is not None:
            shapes = np.concatenate([shapes, tried.slopes])
            bounds = np.concatenate([bounds, room(tried.theta, tried.parameters)])
            rest = rest - tried.response
        return _left_out(self._forms(shapes, rest), bounds, len(use))

    def _is_sound(self, shape: FloatArray, bounds: tuple[float, float]) -> bool:
        """Whether a shape is a simulator's misfit, and not what running the emulator made of it.

        A step so small that an emulated engine only flutters has a slope of its own in one flight,
        which the others cannot know.
        """
        left = _left_out(self._forms(shape[None], self._misfit.gap), np.array([bounds]), 1)
        return float(left.sum()) <= _SOUND * float(self._misfit.size(self._misfit.gap).sum())

    def _forms(
        self, shapes: FloatArray, rest: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Hessian (flights, p, p), gradient (flights, p) and Q (flights,) of what is left."""
        every = self._misfit.inner(np.concatenate([shapes, rest[None]]), shapes)
        return every[:, :-1], every[:, -1], self._misfit.size(rest)


def _shapes(
    one: Fit, scale: float, limit: float
) -> Iterator[tuple[str, FloatArray, tuple[float, float]]]:
    """The effect's name, the shape of a unit of what is allowed of it, and its bounds, if any.

    A play that is small beside the moves acts in proportion to its width, but its slope at no play
    at all says nothing: shapes are responses over what is fitted.
    """
    little = ALLOWED.get(one.name)
    places = {parameter.name: k for k, parameter in enumerate(one.parameters)}
    if little is None or little.parameter not in places:
        return
    at = places[little.parameter]
    parameter, away = one.parameters[at], float(one.theta[at]) - one.parameters[at].neutral
    secant = not parameter.linear and abs(away) > _SMALL
    shape = one.response / away if secant else one.slopes[at]
    by = scale if parameter.unit == "deg" else 1.0
    if little.of:
        by *= max(1.0, float(one.theta[places[little.of]]))
    if little.outside in places:
        by *= 1.0 - float(one.theta[places[little.outside]])
    if little.limit and (not little.only_if or one.chose(little.only_if)):
        yield one.name, shape, (-limit, limit)
    else:
        yield one.name, shape, (by * little.low, by * little.high)


def _left_out(
    forms: tuple[FloatArray, FloatArray, FloatArray], bounds: FloatArray, little: int
) -> FloatArray:
    """Q per flight at the best amounts within `bounds` (p, 2) for all other flights.

    The first ones are so many amounts of what is allowed.
    """
    hessian, toward, size = forms
    left = size.copy()
    if hessian.shape[1] == 0 or len(size) < 2:
        return left
    for f in range(len(size)):
        step = least_within(*without((hessian, toward), f, little), bounds)
        left[f] = size[f] - 2.0 * step @ toward[f] + step @ hessian[f] @ step
    return np.maximum(left, 0.0)
