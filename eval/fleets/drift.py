"""Slow trends, steps and single outliers in series over flights, judged over a whole fleet.

A series y_t at flight hours h_t with standard errors s_t is a level that wanders, and what flights
differ by beyond their standard errors:

    y_t = mu_t + x_t' beta + e_t,              e_t ~ N(0, k (s_t^2 + v))
    mu_t+1 = mu_t + w_t,                       w_t ~ N(0, k q (h_t+1 - h_t))
    k ~ nu / chi^2(nu)

All series of one kind share v, q and nu; v and nu maximise the marginal likelihood of the fleet. k
is the scale of a series, which a short one takes from the others and a long one shows by itself.
`statsmodels` filters and smooths. A change adds a column x to beta: hours (a trend), 1 from a
flight on (a step), 1 at a flight (an outlier). With M = W - W X (X'W X)^-1 X'W, W the inverse of
the covariance and X the level and the changes found before, the likelihood-ratio statistic of x is

    tau^2 = (x'M y)^2 / x'M x,     t^2 = tau^2 (nu + d - 1) / (nu + y'M y - tau^2),

Student's t with nu + d - 1 degrees of freedom, d = n - columns of X. M y are the smoothing errors
of y, and x'M x is theirs for an outlier and that of the scaled state for a step, so that one pass
gives all positions (de Jong and Penzer, JASA 93, 1998; Harvey and Koopman, JBES 10, 1992). A series
that seems calmer than the fleet is judged by the scatter of the fleet (k at least 1): where a few
flights happen to be alike, the next one is no change.

A p-value counts three times, once for each kind, and that of a step or an outlier as often as there
are flights. Benjamini and Yekutieli's adjustment then bounds the share of false ones among the
changes that are found in the fleet, whatever the dependence of its series. A found change enters X,
and the next one is looked for; a change is kept while it is significant next to the others. Steps
would teach that levels wander, and so hide each other: q is the median of the series' own likeliest
values (0 in two of three where nothing wanders), which a sixth of them do not move; variances are
learned anew without the changes that were found, and without those that are significant at 1 % in
their own series.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal

import numpy as np
from scipy.optimize import minimize
from scipy.special import gammaln, logsumexp
from scipy.stats import false_discovery_control
from scipy.stats import t as student

from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError

Kind = Literal["trend", "step", "outlier"]
Quantity = tuple[str, str]  # output and what of it; its series share a prior
KINDS: Final[tuple[Kind, ...]] = ("trend", "step", "outlier")
FALSE_DISCOVERIES: Final = 0.05
LEAST_FLIGHTS: Final = 3  # a trend and a level leave one degree of freedom
_VAGUE = 1e7  # prior variance of level and changes, in that of flights: no prior at all
_MOST_ROUNDS = 8
_SUSPECT = 0.01  # of series without a change one in a hundred loses a step or outlier for learning
_MOST_LEARNED = 128  # series of a kind: standard error of a log variance below 0.13 / sqrt(n)
_FREEDOM = (1.0, 1e4)  # of the scales; at the upper end all are equal
_SIMPLEX = np.vstack([np.zeros(2), np.diag([0.7, 1.5])])
_WALKS = np.array([0.0, *np.geomspace(1e-4, 1.0, 9)])  # per flight, in the variance of flights


@dataclass(frozen=True, eq=False)
class Series:
    """Values y (n,) in order of flight, at flight hours (n,), with standard errors (n,)."""

    hours: FloatArray
    y: FloatArray
    errors: FloatArray

    def column(self, kind: Kind, at: int) -> FloatArray:
        """Column (n,) of a change; that of a trend is the hours since the first flight."""
        if kind == "trend":
            return np.asarray(self.hours - self.hours[0], dtype=np.float64)
        place = np.arange(len(self.hours))
        return np.asarray(place >= at if kind == "step" else place == at, dtype=np.float64)


@dataclass(frozen=True)
class Prior:
    """What all series of a kind share: v, q per flight hour, nu of the module's formulas."""

    variance: float
    walk: float
    freedom: float


@dataclass(frozen=True)
class Change:
    """A change of a series at flight `at`, which lies in `first` to `last` with 95 %.

    `size` and its standard error `error` are in the unit of the series, of a trend per hour;
    `p` is that of its test over all positions, `adjusted` over the fleet.
    """

    kind: Kind
    at: int
    first: int
    last: int
    size: float = 0.0
    error: float = 0.0
    p: float = 1.0
    adjusted: float = 1.0


@dataclass(frozen=True, eq=False)
class Drift:
    """Changes of a series; its smoothed level (n,) without outliers, and standard error (n,)."""

    changes: tuple[Change, ...]
    level: FloatArray
    level_error: FloatArray


def detect(
    series: Sequence[Series], kinds: Sequence[Quantity], share: float = FALSE_DISCOVERIES
) -> tuple[list[Drift], dict[Quantity, Prior]]:
    """Find the changes of all series of a fleet, `kinds` their kinds; at most `share` are false.

    Every series has at least `LEAST_FLIGHTS` flights. Raises `ConfigError` without statsmodels.
    """
    found: list[tuple[Change, ...]] = [() for _ in series]
    taken = list(found)  # out of the series from which variances are learned
    members: dict[Quantity, list[int]] = {}
    for k, kind in enumerate(kinds):
        members.setdefault(kind, []).append(k)
    priors: dict[Quantity, Prior] = {}
    changed = set(members)
    for _ in range(_MOST_ROUNDS):
        for kind in filter(changed.__contains__, members):
            own = members[kind]
            priors[kind] = learn([series[k] for k in own], [taken[k] for k in own])
        judged = _judged(series, [priors[kind] for kind in kinds], found)
        kept = [tuple(one for one in own if one.adjusted <= share) for own in judged]
        suspect = [
            tuple(one for one in own if one.adjusted <= share or one.p <= _SUSPECT)
            for own in judged
        ]
        same = [_places(one) for one in kept] == [_places(one) for one in found]
        changed = {
            kind for kind, new, old in zip(kinds, suspect, taken, strict=True)
            if _places(new) != _places(old)
        }  # fmt: skip
        found, taken = kept, suspect
        if same and not changed:
            break
    curves = [
        _level(one, priors[kind], own) for one, kind, own in zip(series, kinds, found, strict=True)
    ]
    return curves, priors


def _places(changes: Sequence[Change]) -> list[tuple[str, int]]:
    return [(one.kind, one.at) for one in changes]


def _judged(
    series: Sequence[Series], priors: Sequence[Prior], found: Sequence[tuple[Change, ...]]
) -> list[list[Change]]:
    """Test the changes that were found, and the best further one of each series, together."""
    judged: list[list[Change]] = []
    for one, prior, own in zip(series, priors, found, strict=True):
        ours = [_tested(one, prior, change, own[:k] + own[k + 1 :]) for k, change in enumerate(own)]
        judged.append(ours + ([best] if (best := candidate(one, prior, own)) else []))
    p = [one.p for own in judged for one in own]
    adjusted = iter(false_discovery_control(p, method="by").tolist() if p else [])
    return [[replace(one, adjusted=next(adjusted)) for one in own] for own in judged]


# --- one series ---


def candidate(series: Series, prior: Prior, found: Sequence[Change] = ()) -> Change | None:
    """The likeliest change next to those that were found; None where nothing is left to judge.

    Kinds are compared by the mean of exp(tau^2 / 2) over their positions.
    """
    smoothed = _Smoothed(series, prior, found)
    if smoothed.freedom < 2:
        return None
    places = {kind: smoothed.statistics(kind) for kind in KINDS}
    likelihood = {kind: logsumexp(0.5 * tau**2) - np.log(len(tau)) for kind, tau in places.items()}
    kind = max(KINDS, key=likelihood.__getitem__)
    at = int(np.argmax(places[kind] ** 2))
    first, last = _range(places[kind]) if kind == "step" else (at, at)
    return _tested(series, prior, Change(kind, at, first, last), found)


def _range(tau: FloatArray) -> tuple[int, int]:
    """First and last of the likeliest positions that hold 95 % of the likelihood, a flat prior."""
    likelihood = np.exp(0.5 * tau**2 - logsumexp(0.5 * tau**2))
    order = np.argsort(-likelihood)
    held = order[: int(np.searchsorted(np.cumsum(likelihood[order]), 0.95)) + 1]
    return int(held.min()), int(held.max())


def _tested(series: Series, prior: Prior, change: Change, others: Sequence[Change]) -> Change:
    """The change with size, standard error and p-value next to the others."""
    smoothed = _Smoothed(series, prior, others)
    column = series.column(change.kind, change.at)
    weight = float(column @ smoothed.projected(column))
    if weight <= 0.0:
        return replace(change, p=1.0)
    size = float(column @ smoothed.residual) / weight
    p = smoothed.p(size * np.sqrt(weight), change.kind)
    scale = smoothed.scale(size**2 * weight)
    return replace(change, size=size, error=float(np.sqrt(scale / weight)), p=p)


@dataclass(eq=False)
class _Smoothed:
    """A series smoothed with changes in X: M y, y'M y and d of the module's formulas."""

    series: Series
    prior: Prior
    found: Sequence[Change]
    freedom: int = field(init=False)

    def __post_init__(self) -> None:
        self._columns = [self.series.column(one.kind, one.at) for one in self.found]
        self._model = _state_space(self.series, self.prior, self._columns)
        centred = self.series.y - np.median(self.series.y)
        self._model.bind(centred[:, None].copy())
        self._y = self._model.smooth()
        self.residual: FloatArray = self._y.smoothing_error[0].copy()
        self._square = float(centred @ self.residual)
        self.freedom = len(centred) - 1 - len(self._columns)

    def projected(self, column: FloatArray) -> FloatArray:
        """M x of a column (n,)."""
        model = _state_space(self.series, self.prior, self._columns)
        model.bind(column[:, None].copy())
        errors: FloatArray = model.smooth().smoothing_error[0]
        return errors

    def statistics(self, kind: Kind) -> FloatArray:
        """Signed tau (n,) of a change at each flight; of a trend (1,)."""
        if kind == "trend":
            column = self.series.column(kind, 0)
            above, below = column @ self.residual, column @ self.projected(column)
            return _ratio(np.array([above]), np.array([below]))
        if kind == "outlier":
            found = self._y.smoothed_measurement_disturbance_cov[0, 0]
            noise = self._model["obs_cov", 0, 0]
            return _ratio(self.residual, (noise - found) / noise**2)
        # The scaled state at t sums the smoothing errors after t: a step at 0 is the level itself.
        above = self._y.scaled_smoothed_estimator[0, :-1]
        below = self._y.scaled_smoothed_estimator_cov[0, 0, :-1]
        return np.concatenate([[0.0], _ratio(above, below)])

    def level(self, shown: Sequence[bool]) -> tuple[FloatArray, FloatArray]:
        """Level with the changes that are `shown`, and its variance for k = 1, (n,) each."""
        design = self._model["design"][0] * np.array([1.0, *shown])[:, None]
        state, cov = self._y.smoothed_state, self._y.smoothed_state_cov
        level = np.einsum("st,st->t", design, state) + float(np.median(self.series.y))
        return level, np.einsum("st,sut,ut->t", design, cov, design)

    def scale(self, explained: float = 0.0) -> float:
        """Posterior mean of k without what a change explains of y'M y; at least 1."""
        nu = self.prior.freedom
        return max((nu + self._square - explained) / max(nu + self.freedom - 1, 1.0), 1.0)

    def p(self, tau: float, kind: Kind) -> float:
        """P-value of the largest |tau| over all positions and kinds (Bonferroni)."""
        freedom = self.prior.freedom + self.freedom - 1
        count = len(KINDS) * (1 if kind == "trend" else len(self.series.hours))
        value = student.sf(abs(tau) / np.sqrt(self.scale(tau**2)), freedom)
        return float(min(1.0, 2.0 * count * value))


def _ratio(above: FloatArray, below: FloatArray) -> FloatArray:
    """tau, 0 where the changes in X leave nothing of the column."""
    known = below > 1e3 / _VAGUE * np.max(below, initial=0.0)
    return np.divide(above, np.sqrt(np.where(known, below, 1.0)), where=known,
                     out=np.zeros(len(above)))  # fmt: skip


def _level(series: Series, prior: Prior, found: tuple[Change, ...]) -> Drift:
    smoothed = _Smoothed(series, prior, found)
    level, variance = smoothed.level([one.kind != "outlier" for one in found])
    return Drift(found, level, np.sqrt(smoothed.scale() * np.maximum(variance, 0.0)))


def _state_space(series: Series, prior: Prior, columns: Sequence[FloatArray]) -> Any:
    """State [mu, beta] with the covariances of the module's formulas for k = 1."""
    try:
        from statsmodels.tsa.statespace.kalman_smoother import (  # noqa: PLC0415 - an extra
            KalmanSmoother,
        )
    except ImportError:
        raise ConfigError(
            "the watch needs statsmodels", hint="Install it with: pip install 'narxcal[fleet]'"
        ) from None
    n, states = len(series.hours), 1 + len(columns)
    model = KalmanSmoother(k_endog=1, k_states=states, k_posdef=1)
    model.bind(np.zeros((n, 1)))
    scales = [float(np.sqrt(np.mean(one**2))) for one in columns]
    model["design"] = np.stack([np.ones(n), *columns])[None]
    model["transition"] = np.eye(states)
    model["selection"] = np.eye(states)[:, :1]
    noise = series.errors**2 + prior.variance
    model["obs_cov"] = noise[None, None]
    steps = np.diff(series.hours, append=series.hours[-1])
    model["state_cov"] = (prior.walk * steps)[None, None]
    vague = _VAGUE * float(np.mean(noise)) / np.array([1.0, *scales]) ** 2
    model.initialize_known(np.zeros(states), np.diag(vague))
    return model


# --- what is learned over the fleet ---


def learn(series: Sequence[Series], found: Sequence[Sequence[Change]]) -> Prior:
    """Learn v, q and nu of series of one kind, q robustly, v and nu by marginal likelihood.

    Level, trend and the changes that were found are taken out of each series first (REML), so
    that a fleet that wears does not teach that levels wander. nu is at most the degrees of freedom
    that the other series have: fewer do not know the scale of one better than that.
    """
    chosen = np.unique(np.linspace(0, len(series) - 1, _MOST_LEARNED).astype(int)).tolist()
    start = _start([series[k] for k in chosen])
    hours = max(float(np.median([np.median(np.diff(series[k].hours)) for k in chosen])), 1e-9)
    models, freedom = [], np.zeros(len(chosen))
    for place, k in enumerate(chosen):
        one, other = series[k], [each for each in found[k] if each.kind != "trend"]
        columns = [one.column("trend", 0), *(one.column(each.kind, each.at) for each in other)]
        model = _state_space(one, start, columns)
        model.bind((one.y - np.median(one.y))[:, None].copy())
        models.append((one, model))
        freedom[place] = max(len(one.y) - 1 - len(columns), 0)
    unit = np.array([start.variance, start.freedom])
    free = (math.log(_FREEDOM[0] / start.freedom), math.log(_FREEDOM[1] / start.freedom))

    def fitted(walk: float) -> Prior:
        def loss(logs: FloatArray) -> float:
            variance, nu = (unit * np.exp(logs)).tolist()
            return -float(likelihoods(Prior(variance, walk, nu)).sum())

        best = minimize(
            loss, np.zeros(2), method="Nelder-Mead", bounds=[(-12.0, 12.0), free],
            options={"initial_simplex": _SIMPLEX, "xatol": 0.05, "fatol": 0.02, "maxfev": 100},
        )  # fmt: skip
        variance, nu = (unit * np.exp(best.x)).tolist()
        return Prior(variance, walk, nu)

    def likelihoods(prior: Prior) -> FloatArray:
        square, log_det = np.array([_filtered(*one, prior) for one in models]).T
        return _likelihood(prior.freedom, freedom, square, log_det)

    still = fitted(0.0)
    walks = still.variance / hours * _WALKS
    own = walks[np.argmax([likelihoods(replace(still, walk=each)) for each in walks], axis=0)]
    walk = float(np.median(own))
    found_prior = still if walk == 0.0 else fitted(walk)
    others = max(float(freedom.sum() - freedom.max()), _FREEDOM[0])
    return replace(found_prior, freedom=min(found_prior.freedom, others))


def _start(series: Sequence[Series]) -> Prior:
    """Where the search starts: v by differences of flights that follow each other.

    Half their median square over 0.455, the median of chi^2(1), less the stated variances.
    """
    y = np.concatenate([one.y for one in series])
    errors = np.concatenate([one.errors for one in series])
    total = float(np.median(np.concatenate([np.diff(one.y) ** 2 for one in series]))) / 0.91
    floor = 1e-12 * (1.0 + float(np.mean(y**2)))  # of values that do not change at all
    variance = max(total - float(np.mean(errors**2)), 0.1 * total, floor)
    return Prior(variance, 0.0, 20.0)


def _filtered(series: Series, model: Any, prior: Prior) -> tuple[float, float]:
    """Return y'M y and the log determinant that belongs to it."""
    model["obs_cov", 0, 0] = series.errors**2 + prior.variance
    model["state_cov", 0, 0] = prior.walk * np.diff(series.hours, append=series.hours[-1])
    found = model.filter()
    variance = found.forecasts_error_cov[0, 0]
    return float(np.sum(found.forecasts_error[0] ** 2 / variance)), float(np.sum(np.log(variance)))


def _likelihood(
    nu: float, freedom: FloatArray, square: FloatArray, log_det: FloatArray
) -> FloatArray:
    """Log density of series whose k is integrated out, multivariate t; all arrays (series,)."""
    half = 0.5 * (nu + freedom)
    scale = gammaln(half) - gammaln(0.5 * nu) - 0.5 * freedom * np.log(nu * np.pi)
    found: FloatArray = scale - 0.5 * log_det - half * np.log1p(square / nu)
    return found
