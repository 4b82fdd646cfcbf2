"""Fits the two-spool grey box to a simulator's logs: rotors by output error, flows linearly.

The rotors' coefficients minimise the free run's error over whole flights, with a robust loss (what
the settled values miss must not bend the dynamics) and priors that hold the slopes where the logs
say nothing. Temperatures and flows depend on them linearly once their lag is known; what they
would be in equilibrium at another core speed is not fitted to moves, in which the power that the
core has to spare says nearly the same, but to the settled values: an engine has one working line.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from scipy.optimize import least_squares, minimize_scalar
from scipy.signal import lfilter

from narxcal import two_spool
from narxcal.effects.base import as_simulated
from narxcal.support.arrays import FloatArray
from narxcal.two_spool import (
    DAMP,
    DOWN,
    FAN,
    FLOW,
    GAIN,
    LINE,
    PUSH,
    RESET,
    SIZE,
    UP,
    VALVE,
    TwoSpool,
)

GOVERNED_FAN, GOVERNED_CORE = 0, 1
_TOLERANCE: Final = 0.01  # share of the range that counts as one standard error
_ROBUST: Final = 2.0  # standard errors beyond which an error counts linearly
_EVERY_S: Final = 0.25  # errors nearer in time tell nothing new
_INDEPENDENT_S: Final = 1.0  # and those within this are one observation
_RIDGE, _SLIGHT = 1e-3, 1e-5
_FAR, _INSIDE = 3.0, 2.99  # standard deviations that a coefficient may be off, and begin with
_FINE: Final = 1e-3  # change of the cost, and of coefficients, at which a fit ends
_LAGS_S: Final = (0.05, 6.0)
_APART_S: Final = (2.0, 8.0)  # moves of the lever take that long, the air hardly changes meanwhile


class Course(NamedTuple):
    """Flights in the order fan, core, flows: logged `y` and settled values (flights, time, n).

    `air` is `ln(delta / sqrt(theta))`, (flights, time); `inside` one up to a flight's end, then 0.
    """

    y: FloatArray
    steady: FloatArray
    air: FloatArray
    inside: FloatArray
    dt_s: float

    @property
    def low(self) -> FloatArray:
        """Bottom of each channel."""
        return np.asarray(self.y.min(axis=(0, 1)))

    @property
    def span(self) -> FloatArray:
        """Range of each channel."""
        return np.asarray(np.maximum(np.ptp(self.y, axis=(0, 1)), 1e-9))


def fit_two_spool(
    course: Course, governed: int, begin: TwoSpool | None = None
) -> tuple[TwoSpool, float]:
    """Fit under one kind of control; returns the engine and the robust cost of its speeds.

    The search starts from an engine to `begin` with, if there is one.
    """
    rotors = Course(course.y[..., :2], course.steady[..., :2], *course[2:])
    prior, spread = _prior(rotors, governed)
    blank = TwoSpool(
        prior,
        np.zeros((0, FLOW)),
        float(course.low[1]),
        float(course.span[1]),
        governed,
        course.dt_s,
    )
    problem = _Rotors(rotors, blank, prior, spread)
    start = np.zeros(SIZE) if begin is None else (begin.theta - prior) / spread
    found = least_squares(
        problem.errors,
        np.clip(start, -_INSIDE, _INSIDE),
        problem.slopes,
        bounds=(-_FAR, _FAR),
        loss="soft_l1",
        f_scale=_ROBUST * problem.root,
        x_scale=1.0,
        ftol=_FINE,
        xtol=_FINE,
        max_nfev=30 if begin is None else 8,
    )
    theta = prior + spread * found.x
    thermal = np.array([_flow(course, j) for j in range(2, course.y.shape[-1])]).reshape(-1, FLOW)
    engine = TwoSpool(theta, thermal, blank.low, blank.span, governed, course.dt_s)
    return engine, float(found.cost)


def _prior(rotors: Course, governed: int) -> tuple[FloatArray, FloatArray]:
    """Where the fit begins, and standard deviations about it: (SIZE,) each."""
    rate = np.diff(rotors.y[..., 1], axis=1)[rotors.inside[:, 1:] > 0.0] / rotors.dt_s
    prior, spread = np.zeros(SIZE), np.full(SIZE, 1.5)
    prior[DAMP] = 0.3 if governed == GOVERNED_FAN else 0.0
    prior[UP] = np.log(max(float(np.quantile(rate, 0.998)), 0.5))
    prior[DOWN] = np.log(max(-float(np.quantile(rate, 0.002)), 0.5))
    prior[UP + 2] = prior[DOWN + 2] = 1.0  # power to spare goes with the density of the air
    prior[FAN], prior[VALVE] = np.log(0.8), np.log(0.3)
    prior[RESET] = 0.15
    prior[LINE] = np.polyfit(rotors.y[..., 1].ravel(), rotors.y[..., 0].ravel(), 1)[0]
    spread[[GAIN, DAMP, UP, DOWN, FAN, LINE]] = 2.0
    spread[VALVE], spread[PUSH], spread[RESET] = 1.0, 1.0, 0.2
    if governed == GOVERNED_CORE:
        spread[DAMP : DAMP + 3] = 1e-6
    return prior, spread


class _Rotors:
    """Errors of the speeds as a function of z, the coefficients in standard deviations."""

    def __init__(
        self, rotors: Course, blank: TwoSpool, prior: FloatArray, spread: FloatArray
    ) -> None:
        self._rotors, self._blank, self._prior, self._spread = rotors, blank, prior, spread
        self._every = max(1, round(_EVERY_S / rotors.dt_s))
        # Errors are weighted so that all within a second count as one observation.
        self.root = float(np.sqrt(self._every * rotors.dt_s / _INDEPENDENT_S))

    def errors(self, z: FloatArray) -> FloatArray:
        """Weighted errors, then z itself for the priors."""
        return np.asarray(self._many(z[None])[0])

    def slopes(self, z: FloatArray) -> FloatArray:
        """Differences, all in one batch of runs."""
        step = 1e-4
        found = self._many(np.concatenate([z[None], z + step * np.eye(len(z))]))
        return np.asarray((found[1:] - found[0]).T / step)

    def _many(self, z: FloatArray) -> FloatArray:
        rotors, flights = self._rotors, len(self._rotors.y)
        theta = np.repeat(self._prior + self._spread * z, flights, axis=0)
        pace = np.stack(as_simulated(len(theta)), axis=1)
        which = np.tile(np.arange(flights), len(z))
        start = np.ascontiguousarray(rotors.y[which, 0])
        flown = (rotors.steady, rotors.air, np.zeros_like(rotors.air), start)
        blank = self._blank
        y = two_spool.run(
            np.concatenate([theta, pace], axis=1),
            blank.thermal,
            flown,
            which,
            (blank.dt_s, blank.low, blank.span, blank.governed, 1),
        )
        wrong = y.reshape(len(z), *rotors.y.shape)[:, :, :: self._every]
        wrong -= rotors.y[:, :: self._every]  # in place: these arrays are the largest of a fit
        wrong *= rotors.inside[:, :: self._every, None]
        wrong /= rotors.span
        wrong *= self.root / _TOLERANCE
        return np.concatenate([wrong.reshape(len(z), -1), z * self.root], axis=1)


def _flow(course: Course, j: int) -> FloatArray:
    """Coefficients (FLOW,) of one temperature or flow: Y and b with their slopes, its lag in s."""
    power = np.gradient(course.y[..., 1], course.dt_s, axis=1)
    away = course.y[..., 1] - course.steady[..., 1]
    x, z = (_place(course, speed[..., 1]) for speed in (course.y, course.steady))
    one, line = np.ones_like(x), working_line(course, j)
    match = course.steady[..., j] + away * np.tensordot(line, _chords(x, z, course.air), axes=1)
    columns = [power * shape for shape in (one, x, x * x, course.air)]

    def solved(log_lag: float) -> tuple[float, FloatArray]:
        tau_s = float(np.exp(log_lag))
        rows = np.stack([_lagged(column, tau_s, course.dt_s) for column in columns], axis=-1)
        target = course.y[..., j] - _lagged(match, tau_s, course.dt_s)
        use = course.inside > 0.0
        a, b = rows[use], target[use]
        w = _ridge(a, b, _RIDGE)
        return float(np.mean((b - a @ w) ** 2)), np.concatenate([line, w, [tau_s]])

    low, high = (float(np.log(lag)) for lag in _LAGS_S)
    best = minimize_scalar(lambda z: solved(z)[0], bounds=(low, high), method="bounded")
    return solved(float(best.x))[1]


def working_line(course: Course, j: int) -> FloatArray:
    """Slope of channel j over core speed along the settled values: constant, x, x^2 and L, (4,).

    By least squares over what the settled values change within seconds: that does the lever, along
    the working line (Walsh & Fletcher, *Gas Turbine Performance*, ch. 7).
    """
    moves: list[tuple[FloatArray, FloatArray]] = []
    for apart_s in _APART_S:
        k = max(1, round(apart_s / course.dt_s))
        use = course.inside[:, k:] > 0.0
        change = course.steady[:, k:] - course.steady[:, :-k]
        x = _place(course, course.steady[..., 1])
        shapes = _chords(x[:, k:], x[:, :-k], 0.5 * (course.air[:, k:] + course.air[:, :-k]))
        moves.append(((change[..., 1] * shapes)[:, use].T, change[use][:, j]))
    a, b = (np.concatenate(part) for part in zip(*moves, strict=True))
    return _ridge(a, b, _SLIGHT)


def _place(course: Course, speed: FloatArray) -> FloatArray:
    """Core speed as a share of its range, as the engine counts it."""
    return np.asarray(np.clip((speed - course.low[1]) / course.span[1], -0.2, 1.2))


def _chords(x: FloatArray, z: FloatArray, air: FloatArray) -> FloatArray:
    """Means of 1, x and x^2 between x and z, and L: `(4, ...)`."""
    return np.stack([np.ones_like(x), 0.5 * (x + z), (x * x + x * z + z * z) / 3.0, air])


def _ridge(a: FloatArray, b: FloatArray, share: float) -> FloatArray:
    gram = a.T @ a
    return np.asarray(np.linalg.solve(gram + np.diag(share * np.diag(gram) + 1e-9), a.T @ b))


def _lagged(value: FloatArray, tau_s: float, dt_s: float) -> FloatArray:
    kept = np.exp(-dt_s / tau_s)
    found, _ = lfilter([1.0 - kept], [1.0, -kept], value, axis=1, zi=kept * value[:, :1])
    return np.asarray(found)
