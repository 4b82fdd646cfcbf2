"""Fit the lumped engine to training logs in free run, and choose its form.

**Fit.** An output-error estimate (Jategaonkar, *Flight Vehicle System Identification*, chapter 4)
by least squares with a soft-L1 loss, so that what no lag explains, an unlogged bleed, hardly biases
it. Slopes are exact (`narxcal.support.dual`). With the deviation d of column o, its measured value
dm, its weight g and the standard deviation S of dm, the residuals are

    g (d - dm) / S        one sample in `_EVERY_S`
    c (theta - start) / unit,    c = prior soft sqrt(n / per)      n: number of those samples

The weight g is 0.3 over the swing where the core moves, so that each response is judged by its own
size, and 1 elsewhere.

| form | scored | fitted together |
|---|---|---|
| plain, limited | stretches in which the core moves | each column |
| governed | whole logs, for heat shows long after a move | core and fan |

Core and fan of a governed engine close a loop. Otherwise the core comes first, since the others
follow it; its limits depend on the fan, which is taken as measured meanwhile.

**Choice.** How an engine settles depends on its control, which no log names. Where [narx] says
"auto", the usual form stands: governed where a lever drives a fan and a core, plain elsewhere. Each
other form is fitted to some of the recordings and judged by its free run over the rest; a single
recording is cut into stretches. Another form is taken if it has clearly less loss of response times
(`training.responses.transients`, `training.folds.clearly_less`). Where neither has, it is taken if

    mean r < -s,   r = ln(e_form / e_usual) by fold,   s = standard error of mean r,
                   widened by Student's t

with e the geometric mean over the outputs of the RMS errors while the core moves. Of two recordings
each fold would learn one flight from another, and two folds have hardly a standard error: the usual
form stands.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import count
from typing import Final, NamedTuple

import numpy as np
from scipy.ndimage import binary_dilation
from scipy.optimize import least_squares

from data_prep.equilibrium import peak_to_peak
from data_prep.log import Log
from narxcal.atmosphere import air_at
from narxcal.channels import described
from narxcal.lumped.engine import LumpedEngine, Slopes, Starts, core_of
from narxcal.lumped.states import Drive
from narxcal.steady.model import SteadyStateModel
from narxcal.support.arrays import BoolArray, FloatArray, IntArray, spans
from narxcal.support.errors import DataError
from narxcal.support.progress import Progress, silent
from training.config import NarxSection, RunConfig
from training.dynamics.lag_priors import Form, Priors, start_engine
from training.folds import clearly_less, geometric_rms, surely_below
from training.records import LagSamples, lag_samples
from training.responses.transients import responses

_GRID_S: Final = 0.1  # the limited form is exact between samples: no finer grid is needed
_EVERY_S: Final = 0.2  # one sample in this time is scored
_MARGIN: Final = 1.5  # the limit, as a multiple of the largest deviation of the logs
_MOVING: Final = 0.03  # of the core's range within some seconds: the core moves
_MOVES_S, _AROUND_S = 5.0, 1.0  # what moves within these seconds is scored, and around
_SWING_S: Final = 15.0  # a response with its settling
_LEAST_SWING, _USUAL_SWING = 0.05, 0.3  # shares of the output's range; the latter has weight 1
_ROUNDS: Final = 3  # of lags and static error, each found with the other; more change little

PLAIN, LIMITS, GOVERNED = "plain", "limits", "governed"
_FOLDS: Final = 3
_STRETCH_S, _STRETCHES = 30.0, 15  # at least so long, at most so many, of a single recording
_CHOICE_GRID_S: Final = 0.2  # the ranking is the same on a grid twice as coarse as the fit's
_STEEPEST: Final = (
    1e6  # limits per unit; a deviation moves by 2 limits at most, sound fits have < 5
)
_ENOUGH_S: Final = 3.0 * 3600.0  # of logs to choose by; more take long and change little


class _Loss(NamedTuple):
    """Scale of the soft-L1 loss, cost of a unit once `per` so many samples, evaluations at most."""

    soft: float
    prior: float
    per: float
    evaluations: int


_LOSS: Final = {
    PLAIN: _Loss(0.15, 2.0, 1000.0, 15),
    LIMITS: _Loss(0.15, 2.0, 1000.0, 25),
    GOVERNED: _Loss(0.1, 1.0, 3000.0, 10),
}


# ---- fit


def fit_lags(
    config: RunConfig, steady: SteadyStateModel, logs: Sequence[Log]
) -> LumpedEngine | None:
    """Fit the lumped engine in front of the network to training logs; None if [narx] wants none.

    No form in [narx] may be "auto" any more (see `choose_form`). What spools driven by heat still
    have before them is no static error, so that both are found in turn.
    """
    if not config.narx.lag:
        return None
    engine: LumpedEngine | None = None
    for _ in range(1 if config.narx.lag_governed else _ROUNDS):
        samples = [lag_samples(log, steady, config, engine) for log in logs]
        engine = fitted_form(config, samples, steady, logs[0].dt_s)
    return engine


def fitted_form(
    config: RunConfig, samples: Sequence[LagSamples], steady: SteadyStateModel, dt_s: float
) -> LumpedEngine:
    """Fit the form that [narx] names; errors are those of `fit_engine`."""
    names = (steady.input_names, tuple(steady.output_names))
    return fit_engine(samples, names, dt_s, form_of(config.narx), config.train.threads)


def form_of(section: NarxSection) -> Form:
    """The form that a resolved [narx] names."""
    return Form(
        governed=section.lag_governed is True,
        limited=section.lag_limits is True,
    )


def fit_engine(
    samples: Sequence[LagSamples],
    names: tuple[Sequence[str], tuple[str, ...]],
    dt_s: float,
    form: Form = Form(),  # noqa: B008 (immutable)
    threads: int = 1,
) -> LumpedEngine:
    """Fit an engine of one form; `names` are those of the inputs and of the outputs.

    The result does not depend on `threads`. Raises `ModelError` for a governed engine without the
    speeds of a fan and a core, `DataError` where the core never moves.
    """
    input_names, output_names = names
    samples, dt_s = thinned(samples, dt_s)
    engine, table = start_engine(output_names, form, scales_of(samples, input_names))
    full = 2.0 * engine.half[engine.core]
    core, span_s = [one.ss[:, engine.core] for one in samples], _MOVES_S
    rows = [moving(ss, full, dt_s) for ss in core]
    while not any(moves.any() for moves in rows) and span_s < max(map(len, core)) * dt_s:
        span_s *= 2.0  # an engine that nobody moves fast
        rows = [moving(ss, full, dt_s, span_s) for ss in core]
    if not any(moves.any() for moves in rows):
        raise DataError(
            "the outputs never move, so no lag can be fitted",
            channel=output_names[engine.core],
            hint="Add logs with lever moves, or set lag = false in [narx]",
        )
    parts = [
        _part(engine, one, input_names, weight, np.ones_like(moves) if form.governed else moves)
        for one, moves in zip(samples, rows, strict=True)
        for weight in [_weight(one, engine, moves, dt_s)]
    ]
    with ThreadPoolExecutor(threads) as pool:  # compiled runs release Python's lock
        first = 2 if form.governed else 1
        for group in [engine.order[:first], *engine.order[first:, None]]:
            engine = _Fit(engine, table, form, parts, group, dt_s, pool).fitted()
    return engine


def thinned(
    samples: Sequence[LagSamples], dt_s: float, grid_s: float = _GRID_S
) -> tuple[list[LagSamples], float]:
    """Take every so many-th sample, so that the grid is at most `grid_s`; return the grid, too."""
    every = max(int(grid_s / dt_s + 1e-6), 1)
    return [one.rows(slice(None, None, every)) for one in samples], every * dt_s


def scales_of(samples: Sequence[LagSamples], input_names: Sequence[str]) -> dict[str, FloatArray]:
    """Centre and half range of the corrected outputs, and the limit of deviations, (n_out,)."""
    roots = [np.sqrt(air_at(one.inputs, input_names).theta2)[:, None] for one in samples]
    corrected = np.concatenate([one.ss / root for one, root in zip(samples, roots, strict=True)])
    low, high = corrected.min(axis=0), corrected.max(axis=0)
    deviations = np.concatenate([one.ss - one.measured for one in samples])
    largest = np.nanmax(np.abs(_zero_if_unknown(deviations)), axis=0)
    return {
        "centre": 0.5 * (low + high),
        "half": np.maximum(0.5 * (high - low), 1e-9),
        "limit": _MARGIN * np.maximum(largest, 1e-9),
    }


def moving(ss: FloatArray, full: float, dt_s: float, span_s: float = _MOVES_S) -> BoolArray:
    """Rows (time,) in and around the moves of a steady-state value `ss` whose range is `full`."""
    around = max(round(_AROUND_S / dt_s), 1)
    moves = peak_to_peak(ss, max(round(span_s / dt_s), 2)) > _MOVING * full
    rows: BoolArray = binary_dilation(moves, iterations=around)
    return rows


def _zero_if_unknown(deviations: FloatArray) -> FloatArray:
    """`deviations` (time, ...), 0 for an output without a single known sample."""
    return np.where(np.isfinite(deviations).any(axis=0), deviations, 0.0)


def _weight(one: LagSamples, engine: LumpedEngine, moves: BoolArray, dt_s: float) -> FloatArray:
    """Weights g (time, n_out) of the errors of a log."""
    known = np.where(np.isfinite(one.measured), one.measured, one.ss)
    share = peak_to_peak(known, max(round(_SWING_S / dt_s), 2)) / (2.0 * engine.half)
    return np.where(moves[:, None], _USUAL_SWING / np.maximum(share, _LEAST_SWING), 1.0)


class _Part(NamedTuple):
    """The scored rows of one log, end to end: drive, deviations and weights (time, n_out)."""

    drive: Drive
    deviation: FloatArray
    weight: FloatArray
    starts: Starts


def _part(
    engine: LumpedEngine,
    one: LagSamples,
    input_names: Sequence[str],
    weight: FloatArray,
    wanted: BoolArray,
) -> _Part:
    rows = np.flatnonzero(wanted)
    begins = np.flatnonzero(np.diff(rows, prepend=-2) > 1)
    deviation = (one.ss - one.measured)[rows]
    starts = begins, engine.start(np.nan_to_num(deviation[begins]))
    drive = engine.drive(one.inputs, input_names, one.ss).rows(rows)
    return _Part(drive, deviation, weight[rows], starts)


@dataclass(frozen=True, eq=False)
class _Fit:
    """The fit of one `group` of columns (c,) of `engine`; those before it are fitted already."""

    engine: LumpedEngine
    table: Priors
    form: Form
    parts: Sequence[_Part]
    group: IntArray
    dt_s: float
    pool: ThreadPoolExecutor

    def fitted(self) -> LumpedEngine:
        """The engine with the parameters of the group fitted."""
        start, unit = self.engine.theta[self.free], self.table.unit[self.free]
        prior = self.prior / unit

        def residuals(values: FloatArray) -> FloatArray:
            return np.concatenate([*self.errors(self.trial(values)), prior * (values - start)])

        def slopes(values: FloatArray) -> FloatArray:
            return np.concatenate([*self.slopes(self.trial(values)), np.diag(prior)])

        found = least_squares(
            residuals,
            start,
            slopes,
            x_scale="jac",
            loss="soft_l1",
            f_scale=self.loss.soft,
            max_nfev=self.loss.evaluations,
        )
        return self.trial(found.x)

    @property
    def loss(self) -> _Loss:
        """Settings of the loss."""
        if self.form.governed:
            return _LOSS[GOVERNED]
        return _LOSS[LIMITS if self.form.limited else PLAIN]

    @cached_property
    def free(self) -> IntArray:
        """Numbers of the parameters that are fitted; a governed fan's count as the core's."""
        return np.flatnonzero(self.table.fitted & (self.table.column == self.group[0]))

    @cached_property
    def measured_fan(self) -> IntArray:
        """Column of a fan that limits the core and is not fitted yet, if there is one."""
        first = self.form.limited and self.group[0] == self.engine.core
        fan = first and not self.engine.governed and self.engine.speeds.sum() > 1
        return self.engine.order[1:2] if fan else self.engine.order[:0]

    @cached_property
    def outputs(self) -> IntArray:
        """Columns to be run; none of the others acts on the group."""
        before = self.engine.order[: 2 if self.engine.governed else 1]
        return np.unique(np.concatenate([before, self.group, self.measured_fan]))

    @cached_property
    def every(self) -> int:
        """One sample of so many is scored."""
        return max(round(_EVERY_S / self.dt_s), 1)

    @cached_property
    def scored(self) -> list[tuple[FloatArray, FloatArray]]:
        """Deviations (n, c) of each part and weights over their spread, both 0 where masked."""
        known = [part.deviation[:, self.group] for part in self.parts]
        spread = np.nanstd(_zero_if_unknown(np.concatenate(known)), axis=0)
        spread = np.where(spread > 1e-9, spread, 1.0)
        weights = [part.weight[:, self.group] / spread for part in self.parts]
        rows = slice(None, None, self.every)
        return [
            (np.nan_to_num(value)[rows], np.where(np.isfinite(value), weight, 0.0)[rows])
            for value, weight in zip(known, weights, strict=True)
        ]

    @cached_property
    def prior(self) -> float:
        """Residual of a parameter that has moved by one unit."""
        scored = sum(weight.size for _, weight in self.scored)
        return float(self.loss.prior * self.loss.soft * np.sqrt(scored / self.loss.per))

    def trial(self, values: FloatArray) -> LumpedEngine:
        """The engine with other values of the free parameters."""
        theta = self.engine.theta.copy()
        theta[self.free] = values
        return replace(self.engine, theta=theta)

    def errors(self, engine: LumpedEngine) -> Iterator[FloatArray]:
        """Weighted errors of each part."""

        def of(part: _Part, scored: tuple[FloatArray, FloatArray]) -> FloatArray:
            found, _ = engine.run(*self._course(part), self.outputs)
            return np.ravel((found[:: self.every, self.group] - scored[0]) * scored[1])

        return self.pool.map(of, self.parts, self.scored)

    def slopes(self, engine: LumpedEngine) -> Iterator[FloatArray]:
        """Slopes (errors, free parameters) of the errors of each part."""

        def of(part: _Part, scored: tuple[FloatArray, FloatArray]) -> FloatArray:
            wanted = Slopes(self.free, self.group, self.every, self.outputs)
            found = engine.slopes(wanted, *self._course(part))
            # Slopes of an unstable trial grow until they overflow; the deviation stays bounded.
            most = _STEEPEST * engine.limit[self.group, None]
            found = np.clip(np.nan_to_num(found, nan=0.0), -most, most)
            return (found * scored[1][:, :, None]).reshape(-1, len(self.free))

        return self.pool.map(of, self.parts, self.scored)

    def _course(self, part: _Part) -> tuple[Drive, Starts, float, FloatArray | None]:
        """Arguments of a run: drive, starts, grid in s and what is taken as measured."""
        taken = None
        if len(self.measured_fan):
            taken = np.full_like(part.deviation, np.nan)
            taken[:, self.measured_fan] = part.deviation[:, self.measured_fan]
        return part.drive, part.starts, self.dt_s, taken


# ---- choice


@dataclass(frozen=True)
class LagChoice:
    """The `form` that was chosen, and the mean loss of the response times by each form.

    `left` is empty where nothing was compared, `form` where [narx] wants no lags.
    """

    form: str
    left: Mapping[str, float] = field(default_factory=dict)

    def row(self) -> dict[str, object]:
        """As JSON-able values."""
        return {"form": self.form, "left": dict(self.left)}


def choose_form(
    config: RunConfig,
    steady: SteadyStateModel,
    logs: Sequence[Log],
    progress: Progress = silent,
) -> tuple[RunConfig, LagChoice]:
    """Replace "auto" in [narx] by the form that follows left-out logs best; raises no errors.

    Where no form can be judged (two recordings, or one without moves), it is the usual one.
    `progress` counts the fits.
    """
    forms = _offered(config, steady)
    if len(forms) < 2 or len({log.source.file for log in logs}) == 2:
        return with_form(config, forms[0]), LagChoice(forms[0] if config.narx.lag else "")
    trial = Trial(steady, _enough(logs), config)
    total, done = len(forms) * len(trial.folds), count()

    def begins() -> None:
        progress(next(done), total, "choosing the lags")

    judged = {form: trial.judged(with_form(config, form), begins) for form in forms}
    best = _best(judged)
    losses = {form: np.concatenate([each.losses for each in one]) for form, one in judged.items()}
    known = {
        name: float(np.nanmean(each)) for name, each in losses.items() if np.isfinite(each).any()
    }
    return with_form(config, best), LagChoice(best, known)


def _best(judged: Mapping[str, Sequence[_Judged]]) -> str:
    """The first form, or one that clearly has a lower loss of response times; ties by RMSE."""
    usual, *others = judged
    for form in others:
        pairs = list(zip(judged[form], judged[usual], strict=True))
        differences = [each.losses - other.losses for each, other in pairs]
        if clearly_less(differences):
            usual = form
        elif not clearly_less([-each for each in differences]):
            ratios = np.array([each.error - other.error for each, other in pairs])
            usual = form if surely_below(ratios) else usual
    return usual


def _offered(config: RunConfig, steady: SteadyStateModel) -> list[str]:
    """The forms that [narx] leaves open, the usual one first."""
    section = config.narx
    if not section.lag:
        return [PLAIN]
    if section.lag_governed is True:
        return [GOVERNED]
    if section.lag_limits != "auto":
        return [LIMITS if section.lag_limits else PLAIN]
    # Governed: a lever drives a fan and a core.
    spools = {"N1_pct", "N2_pct"} <= set(steady.output_names)
    governed = spools and described(config.driver).role == "lever"
    return [*([GOVERNED] if governed and section.lag_governed == "auto" else []), PLAIN, LIMITS]


def with_form(config: RunConfig, form: str) -> RunConfig:
    """The configuration with lags of this form."""
    return config.having(narx={"lag_limits": form == LIMITS, "lag_governed": form == GOVERNED})


def _enough(logs: Sequence[Log]) -> list[Log]:
    """Every so many-th recording, with all its engines, where there are hours of them."""
    names = list(dict.fromkeys(log.source.file for log in logs))
    every = int(sum(len(log) * log.dt_s for log in logs) // _ENOUGH_S) + 1
    every = max(min(every, len(names) // _FOLDS), 1)
    taken = set(names[::every])
    return [log for log in logs if log.source.file in taken]


class _Judged(NamedTuple):
    """Losses (transients, outputs) of a form in one fold, and ln of its error while the core moves.

    The error is the geometric mean over the outputs, each over its range.
    """

    losses: FloatArray
    error: float


@dataclass(frozen=True, eq=False)
class Trial:
    """What forms are judged on: whole recordings in turn, or stretches of a single one."""

    steady: SteadyStateModel
    logs: Sequence[Log]
    config: RunConfig

    @cached_property
    def folds(self) -> list[list[BoolArray]]:
        """Of each fold, which rows of each log are held out."""
        files = list(dict.fromkeys(log.source.file for log in self.logs))
        if len(files) > 1:
            fold = {name: number % _FOLDS for number, name in enumerate(files)}
            numbers = [np.full(len(log), fold[log.source.file]) for log in self.logs]
        else:
            numbers = []
            for log in self.logs:
                many = int(np.clip(len(log) * log.dt_s / _STRETCH_S, _FOLDS, _STRETCHES))
                numbers.append(np.arange(len(log)) * many // len(log) % _FOLDS)
        found = sorted(set(np.concatenate(numbers).tolist()))
        return [[each == number for each in numbers] for number in found]

    def judged(self, config: RunConfig, begins: Callable[[], None] = lambda: None) -> list[_Judged]:
        """Judge a form in each fold; all NaN where one has nothing to fit to.

        `begins` is called as each fit begins.
        """
        found = []
        for held in self.folds:
            begins()
            parts = [
                one.rows(slice(start, stop))
                for one, out in zip(self._samples, held, strict=True)
                for start, stop in spans(~out)
            ]
            coarse, dt_s = thinned(parts, self.logs[0].dt_s, _CHOICE_GRID_S)
            try:
                engine = fitted_form(config, coarse, self.steady, dt_s)
            except DataError:  # the core never moves without what is judged
                nothing = np.full((0, len(self.steady.output_names)), np.nan)
                return [_Judged(nothing, np.nan)] * len(self.folds)
            known = np.concatenate([np.isfinite(one.measured) for one in parts]).any(axis=0)
            found.append(self._judged(engine, held, np.asarray(known)))
        return found

    def _judged(self, engine: LumpedEngine, held: Sequence[BoolArray], known: BoolArray) -> _Judged:
        losses, errors = [], []
        names = list(self.steady.output_names)
        core = core_of(tuple(names))
        for log, one, out in zip(self.logs, self._samples, held, strict=True):
            if not out.any():
                continue
            deviation = one.ss - one.measured
            drive = engine.drive(one.inputs, self.steady.input_names, one.ss)
            run = engine.deviations(drive, deviation[0], log.dt_s)
            found = responses(log, one.ss - run, names, self.config)
            losses.append(found.losses[out[found.rows]])
            rows = out & moving(one.ss[:, core], self._range[core], log.dt_s)
            errors.append((run - deviation)[rows] / self._range)
        error = np.concatenate(errors)
        known &= np.isfinite(error).any(axis=0)
        left = np.log(geometric_rms([error[:, known]])) if known.any() else np.nan
        return _Judged(np.concatenate(losses), float(left))

    @cached_property
    def _samples(self) -> list[LagSamples]:
        return [lag_samples(log, self.steady, self.config) for log in self.logs]

    @cached_property
    def _range(self) -> FloatArray:
        """Of each output over all samples (outputs,)."""
        ss = np.concatenate([one.ss for one in self._samples])
        width: FloatArray = np.maximum(np.ptp(ss, axis=0), 1e-9)
        return width
