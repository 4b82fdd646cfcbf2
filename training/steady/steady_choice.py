"""The steady-state model of a run: the maker's opened, or one fitted as the logs suggest.

What [steady_state] leaves to "auto" is chosen from quasi-steady samples of the training logs alone:

* `corrected`: whether the curves leave less in the samples that they are fitted to with the
  similarity laws, or without, as where a lever asks for a speed whatever the air. Both have as many
  parameters, so that this is a fair question.
* `blend`, `exponents` and `switches`: which altitude and Mach corners, whether the exponents of
  theta and delta are fitted, and whether the switches that the logs record shift the outputs. More
  of them always leave less, so the curves are judged on recordings that they were not fitted to, or
  on regions of one or two (`training.folds`).

Residuals are compared by their geometric mean over the outputs, fold by fold. The usual answer
stands unless another is clearly better (`training.folds.surely_below`), and by a tenth: corrected,
blended over Mach (over altitude without it), with fitted exponents, whose prior is similarity.
Between corners close together only noise is blended. A switch has to take a few percent away.

**Logs that contradict the others** as a whole are named, and not learned from.
A log with a wrong input (a lever rigged by some degrees, an air temperature with an offset, another
type of engine) agrees with itself, so that no fault of a channel shows, and shifts the steady state
of all. The steady state is fitted with and without each log. With v_io the geometric mean of the
RMS errors of log i in output o by both fits, which has the scatter of a log however much of the fit
it determines alone (studentised residuals; Cook and Weisberg 1982, section 2.2),

    d_i = sum_o v_io^2 / s_o^2,    s_o^2 = (p s_0^2 + sum_i w_i v_io^2) / (p + n)
    w_i = (1 - P_i) (nu + m) / (nu + d_i)
    P_i / (1 - P_i) = q / (1 - q) k^-m exp(d_i / 2 (1 - 1 / k^2))

for m outputs of n logs, with the scatter s_0 that engines of one type and their meters have, which
counts as p logs (`training.screening.levels`). Errors of one log are common to its outputs:
Student's t (Lange, Little and Taylor 1989) gives the weights. P_i is the probability that log i is
of the share q of logs with k times the scatter (Tukey's contaminated normal). Weights and fits are
found in turn. Logs with P_i > 0.95 are left out where they are a minority: of two logs neither can
be said to be wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Final

import numpy as np

from data_prep.equilibrium import quasi_steady
from data_prep.log import Log
from data_prep.prepare import hold_inputs
from narxcal.channels import CHANNELS, described, spools_of
from narxcal.steady.fitted import RATIOS, FittedSteadyState, Layout
from narxcal.steady.model import SteadyStateModel
from narxcal.steady.opening import open_steady
from narxcal.support.arrays import BoolArray, FloatArray
from narxcal.support.errors import DataError
from training.config import RunConfig, SteadyFitConfig
from training.dynamics.baselines import Run, lag_errors
from training.folds import geometric_rms, held_out_folds, regions, surely_below, thirds
from training.records import LEAST_WIDTHS
from training.screening.levels import PRIOR_LOGS, prior_scatter
from training.steady.steady_fit import (
    SteadyQuality,
    SteadySamples,
    fit_steady_state,
    linear_problem,
)

_BETTER = 0.9  # of the residual of the usual answer
_SWITCH = float(-np.log(0.97))  # of ln residual
# Share of the driver's range that settled samples span. Curves go on straight for as much again on
# either side ([steady_state.fit] reach): less than a third does not reach the rest from anywhere.
_LEAST_SETTLED = 1.0 / 3.0
_ROWS = 2000  # of a log; enough to choose by
_FOLDS = 5
_BLENDED = ("Mach", "ALT_ft")  # the usual one first
# Share of `LEAST_WIDTHS` between corners. Over it pressure changes by 3 %; with exponents that are
# off by a tenth, outputs by 0.3 %, which is about what any steady state leaves.
_APART = 0.1
_IDLES = ("WOW", "Approach")  # by them controls choose ground, flight and approach idle
_ON_S = 6.0  # quasi-steady time for which a switch has to be on, and off; the rest is judged
LEAST_LOGS: Final = 3
_NU: Final = 4.0  # Lange, Little and Taylor (1989), where data are too few to fit it
_SHARE, _WIDER = 0.05, 5.0  # q and k: one log in twenty, and errors beyond those of sound logs
_SURE: Final = 0.95  # as faults are masked: a sound log must not be lost
_ROUNDS, _SETTLED = 60, 1e-3


@dataclass(frozen=True, eq=False)
class _Taken:
    """Quasi-steady samples of one log, and the recording that they are of."""

    samples: SteadySamples
    recording: str


_Folds = Sequence[tuple[Sequence[_Taken], Sequence[_Taken]]]


def steady_state(
    config: RunConfig, base: Path, logs: Sequence[Log]
) -> tuple[SteadyStateModel, SteadyQuality | None]:
    """Fit the steady-state model to the logs' quasi-steady samples, or open the maker's."""
    section = config.steady_state
    if section.kind != "fitted":
        names = (section.inputs, config.narx.outputs)
        return open_steady(section.kind, section.source, names, base, section.options), None
    layout = chosen_layout(config, logs)
    settled = [_samples(config, layout, log) for log in logs]
    moving = [_moving(layout, log) for log in logs]
    widths = [
        _width(layout.drive(np.concatenate([one.inputs for one in each])))
        for each in (settled, moving)
    ]
    share = min(widths[0] / max(widths[1], 1e-12), 1.0)
    in_motion = share < _LEAST_SETTLED and _follows_better_in_motion(config, layout, logs)
    samples = moving if in_motion else settled
    model, quality = fit_steady_state(samples, layout, section.fit)
    return model, replace(quality, coverage=share)


def _follows_better_in_motion(config: RunConfig, layout: Layout, logs: Sequence[Log]) -> bool:
    """Whether curves fitted to the motion follow what is held out clearly better.

    Of recordings, or thirds of one, by the free run of a first-order lag behind either curve. Where
    settled samples are too few for a curve in every fold, the motion has to do.
    """
    parts, folds = thirds(logs)
    ratios = []
    for fold in folds:
        fitted, judged = fold.of(parts)
        try:
            settled = _error_behind_lag(config, layout, (fitted, judged), moving=False)
        except DataError:
            continue
        ratios.append(_error_behind_lag(config, layout, (fitted, judged), moving=True) - settled)
    return not ratios or bool(surely_below(np.array(ratios)))


def _error_behind_lag(
    config: RunConfig, layout: Layout, part: tuple[list[Log], list[Log]], *, moving: bool
) -> float:
    """Logarithm of the free-run error over logs by curves and lags fitted to others."""
    fitted, judged = part
    samples = [_moving(layout, log) if moving else _samples(config, layout, log) for log in fitted]
    model, _ = fit_steady_state(samples, layout, config.steady_state.fit)
    runs, others = ([_run(model, _moving(layout, log)) for log in some] for some in part)
    return float(np.log(geometric_rms(lag_errors(runs, others, judged[0].dt_s))))


def _run(model: FittedSteadyState, log: SteadySamples) -> Run:
    return Run(model.for_engine(log.engine).outputs(log.inputs), log.outputs)


def _width(drive: FloatArray) -> float:
    """Range of a driver without its outermost hundredths, 0 without samples."""
    return float(np.diff(np.quantile(drive, (0.01, 0.99)))[0]) if len(drive) else 0.0


def contradicting(config: RunConfig, logs: Sequence[Log]) -> list[Outlier]:
    """Logs that contradict the others as a whole, by the curves that all of them suggest."""
    section = config.steady_state
    if section.kind != "fitted" or len({_log_of(log) for log in logs}) < LEAST_LOGS:
        return []
    try:
        layout = chosen_layout(config, logs)
        samples = [_thinned(_samples(config, layout, log)) for log in logs]
        return outliers(samples, layout, section.fit)
    except DataError:  # the fit says what is missing
        return []


def without(logs: Sequence[Log], found: Sequence[Outlier]) -> tuple[Log, ...]:
    """Logs and parts of logs that are none of the outliers."""
    names = {each.log for each in found}
    return tuple(log for log in logs if _log_of(log) not in names)


def _log_of(log: Log) -> str:
    """Name of the whole log: parts of it have names of their own."""
    name = log.source.file or log.name
    return f"{name}:{log.source.engine}" if log.source.engine else name


def with_layout(config: RunConfig, logs: Sequence[Log]) -> RunConfig:
    """The configuration with the layout that the logs suggest in the place of "auto"."""
    if config.steady_state.kind != "fitted":
        return config
    layout = chosen_layout(config, logs)
    names = ("blend", "switches", "corrected", "exponents", "driver")
    return config.having(steady_state={name: getattr(layout, name) for name in names})


def chosen_layout(config: RunConfig, logs: Sequence[Log]) -> Layout:
    """What the fitted model is to be: as configured, and by the logs where that says "auto"."""
    section = config.steady_state
    switches = _switches(config, logs) if section.switches == "auto" else section.switches
    names = tuple(dict.fromkeys((*section.inputs, *switches)))
    layout = Layout(
        input_names=names,
        output_names=config.narx.outputs,
        driver=config.driver,
        blend=() if section.blend == "auto" else section.blend,
        corrected="ALT_ft" in names if section.corrected == "auto" else section.corrected,
        switches=() if section.switches == "auto" else section.switches,
        exponents=() if section.exponents == "auto" else section.exponents,
    )
    if "auto" not in (section.blend, section.switches, section.corrected, section.exponents):
        return layout
    taken = [_Taken(_thinned(_samples(config, layout, log)), log.source.file) for log in logs]
    known = np.concatenate([one.samples.inputs for one in taken])
    if not len(known):
        return layout  # the fit says what is missing
    widths = dict(zip(names, np.ptp(known, axis=0), strict=True))
    varying = [name for name in _BLENDED if widths.get(name, 0.0) >= _APART * LEAST_WIDTHS[name]]
    blends = _subsets(varying)
    if section.blend == "auto":
        layout = replace(layout, blend=tuple(varying[:1]))
    if section.corrected == "auto" and layout.corrected:
        layout = _corrected(layout, blends[-1] if section.blend == "auto" else layout.blend, taken)
    if section.exponents == "auto" and layout.corrected:
        layout = replace(layout, exponents=RATIOS)
    layout = _refined(config, layout, (blends, switches), taken)
    used = tuple(name for name in names if name in section.inputs or name in layout.switches)
    return replace(layout, input_names=used)


def _corrected(layout: Layout, blend: tuple[str, ...], taken: Sequence[_Taken]) -> Layout:
    """The layout with or without the similarity laws, by what each leaves in its own samples."""
    left = {}
    for corrected in (True, False):
        trial = replace(layout, blend=blend, corrected=corrected)
        left[corrected] = float(np.exp(_held_out_log_rms(trial, [(taken, taken)])[0]))
    return replace(layout, corrected=not left[False] < _BETTER * left[True])


def _refined(
    config: RunConfig,
    layout: Layout,
    offered: tuple[Sequence[tuple[str, ...]], tuple[str, ...]],
    taken: Sequence[_Taken],
) -> Layout:
    """The layout with what does best on recordings not fitted to: corners, exponents, switches."""
    section = config.steady_state
    folds = _folds(layout, taken)
    usual = _held_out_log_rms(layout, folds)
    blends = offered[0] if section.blend == "auto" else [layout.blend]
    either = section.exponents == "auto" and layout.corrected
    exponents = [(), RATIOS] if either else [layout.exponents]
    trials = [
        replace(layout, blend=blend, exponents=each) for blend, each in product(blends, exponents)
    ]
    for trial in sorted(trials, key=lambda one: (len(one.blend), len(one.exponents))):
        layout, usual = _better((layout, usual), trial, folds, -float(np.log(_BETTER)))
    if section.switches == "auto":
        layout = _switched(layout, offered[1], folds, usual)
    return layout


def _switched(layout: Layout, offered: tuple[str, ...], folds: _Folds, left: FloatArray) -> Layout:
    """The layout with those switches that help one after another, the best alone first, or all.

    One alone may not help where another that comes with it is unknown.
    """
    alone = {name: _held_out_log_rms(replace(layout, switches=(name,)), folds) for name in offered}
    known = {name: each[np.isfinite(each)] for name, each in alone.items()}
    helpful = [name for name in offered if len(known[name])]  # no fold where no curve can be fitted
    for name in sorted(helpful, key=lambda name: float(known[name].mean())):
        trial = replace(layout, switches=(*layout.switches, name))
        layout, left = _better((layout, left), trial, folds, _SWITCH)
    return _better((layout, left), replace(layout, switches=offered), folds, _SWITCH)[0]


def _better(
    known: tuple[Layout, FloatArray], trial: Layout, folds: _Folds, margin: float
) -> tuple[Layout, FloatArray]:
    """A layout and what it leaves: the trial, if it is clearly better, by the margin at least."""
    if trial == known[0]:
        return known
    less = _held_out_log_rms(trial, folds)
    ratios = less - known[1]
    ratios = ratios[np.isfinite(ratios)]
    return (trial, less) if len(ratios) and surely_below(ratios, margin) else known


def _folds(layout: Layout, taken: Sequence[_Taken]) -> _Folds:
    """Folds by recording; of one or two recordings also by regions."""
    recordings = [one.recording for one in taken]
    many = len(set(recordings))
    found: list[tuple[Sequence[_Taken], Sequence[_Taken]]] = []
    if many < 3:
        inputs = [one.samples.inputs for one in taken]
        time = np.concatenate([np.arange(len(each)) / max(len(each), 1) for each in inputs])
        rows = np.concatenate(inputs)
        altitude = layout.column(rows, "ALT_ft") if "ALT_ft" in layout.input_names else None
        ends = np.cumsum([len(each) for each in inputs])[:-1]
        for held in regions(time, layout.drive(rows), altitude).values():
            parts = [
                _parted(one, own) for one, own in zip(taken, np.split(held, ends), strict=True)
            ]
            found.append(([part[0] for part in parts], [part[1] for part in parts]))
    if many > 1:
        found += [fold.of(taken) for fold in held_out_folds(recordings, _FOLDS)]
    return found


def _parted(one: _Taken, held: BoolArray) -> tuple[_Taken, _Taken]:
    """Samples to fit to, and those held out."""
    whole = one.samples
    kept, out = (
        replace(whole, inputs=whole.inputs[rows], outputs=whole.outputs[rows])
        for rows in (~held, held)
    )
    return _Taken(kept, one.recording), _Taken(out, one.recording)


def _held_out_log_rms(layout: Layout, folds: _Folds) -> FloatArray:
    """Logarithm of the geometric mean over the outputs of the RMS left in each fold (folds,).

    NaN where too little is left to fit to, or to judge.
    """
    found = np.full(len(folds), np.nan)
    for k, (fitted, judged) in enumerate(folds):
        try:
            model, _ = fit_steady_state([one.samples for one in fitted], layout)
        except DataError:  # too little without the part that is judged
            continue
        rms = geometric_rms(
            [
                model.for_engine(one.samples.engine).outputs(one.samples.inputs)
                - one.samples.outputs
                for one in judged
                if len(one.samples.inputs)
            ]
        )
        found[k] = np.log(rms) if np.isfinite(rms) else np.nan
    return found


def _samples(config: RunConfig, layout: Layout, log: Log) -> SteadySamples:
    log = hold_inputs(log, layout.input_names)
    rows = quasi_steady(log, layout.driver, spools_of(layout.output_names), config.quasi_steady)
    return SteadySamples(
        log.matrix(layout.input_names)[rows],
        log.matrix(layout.output_names)[rows],
        log.source.engine,
        _log_of(log),
    )


def _moving(layout: Layout, log: Log) -> SteadySamples:
    """All samples of a log whose inputs are known, in motion."""
    log = hold_inputs(log, layout.input_names)
    inputs, outputs = log.matrix(layout.input_names), log.matrix(layout.output_names)
    return SteadySamples(inputs, outputs, log.source.engine, _log_of(log), log.dt_s)


def _thinned(samples: SteadySamples) -> SteadySamples:
    step = max(len(samples.inputs) // _ROWS, 1)
    return replace(samples, inputs=samples.inputs[::step], outputs=samples.outputs[::step])


def _switches(config: RunConfig, logs: Sequence[Log]) -> tuple[str, ...]:
    """Switches that every log records, on and off for some time of quasi-steady flight.

    Those that choose an idle change what a lever asks for, not what an engine makes of its fuel.
    """
    spools, found = spools_of(config.narx.outputs), []
    lever = described(config.driver).role == "lever"
    for name, channel in CHANNELS.items():
        if channel.role != "switch" or (name in _IDLES and not lever):
            continue
        if not all(name in log.channels and np.isfinite(log[name]).any() for log in logs):
            continue
        on, off = 0.0, 0.0
        for log in logs:
            rows = quasi_steady(log, config.driver, spools, config.quasi_steady)
            on += log.dt_s * int((log[name][rows] > 0.5).sum())
            off += log.dt_s * int((log[name][rows] <= 0.5).sum())
        if min(on, off) >= _ON_S:
            found.append(name)
    return tuple(found)


def _subsets(names: Sequence[str]) -> list[tuple[str, ...]]:
    """All subsets in the order of `names`, smallest first."""
    sets = [
        tuple(n for n, k in zip(names, kept, strict=True) if k)
        for kept in product((0, 1), repeat=len(names))
    ]
    return sorted(sets, key=len)


# ---- logs that contradict the others


@dataclass(frozen=True)
class Outlier:
    """A log that contradicts the others: RMS `errors` by output of the steady state of these."""

    log: str
    errors: dict[str, float]

    @property
    def words(self) -> str:
        """What to say of it."""
        known = {name: value for name, value in self.errors.items() if np.isfinite(value)}
        sizes = [f"{name} by {value:.3g} {described(name).unit}" for name, value in known.items()]
        return (
            f"{Path(self.log).name} contradicts the other logs as a whole: their steady state "
            f"misses its {', '.join(sizes)}, while its channels agree with each other; nothing was "
            "learned from it. Check its inputs (lever, air data) and its engine"
        )


def outliers(
    samples: Sequence[SteadySamples], layout: Layout, config: SteadyFitConfig
) -> list[Outlier]:
    """Logs whose quasi-steady samples contradict those of the others as a whole."""
    samples = [part for part in samples if len(part.inputs)]
    names = list(dict.fromkeys(part.log for part in samples))
    if len(names) < LEAST_LOGS:
        return []
    design, data = linear_problem(samples, layout, config)
    penalty = design.penalty(data.matrices[0].shape[1])
    logs = [data.logs == name for name in names]
    square = penalty.T @ penalty
    pairs = zip(data.matrices, data.corrected.T, strict=True)
    fits = [_Fits.of(matrix, column, logs, square) for matrix, column in pairs]
    levels = np.nanmedian(np.abs(data.outputs), axis=0)
    # Channel units per unit of a corrected parameter.
    unit = np.nanmedian(data.layout_unit(layout), axis=0)
    scatter = [prior_scatter(*each) for each in zip(layout.output_names, levels, strict=True)]
    outlying = _outlier_logs(fits, np.array(scatter) / unit, len(names))
    if not 0 < 2 * outlying.sum() < len(names):
        return []
    kept = np.where(outlying, 0.0, 1.0)
    errors = np.sqrt(np.stack([one.squares(kept)[1] for one in fits], axis=1)) * unit
    return [
        Outlier(names[k], dict(zip(layout.output_names, errors[k].tolist(), strict=True)))
        for k in np.flatnonzero(outlying).tolist()
    ]


def _outlier_logs(fits: Sequence[_Fits], scatter: FloatArray, count: int) -> BoolArray:
    """Whether each log (count,) is surely none of the type."""
    weights, probability = np.ones(count), np.zeros(count)
    for mixed in (False, True):  # from weights alike, the mixture takes all for sound
        for _ in range(_ROUNDS):
            pairs = [one.squares(weights) for one in fits]
            found = np.stack([np.sqrt(inside * outside) for inside, outside in pairs], axis=1)
            known = np.isfinite(found)
            spread = PRIOR_LOGS * scatter**2 + np.nansum(weights[:, None] * found, axis=0)
            far = np.nansum(found * (PRIOR_LOGS + known.sum(axis=0)) / spread, axis=1)
            outputs = known.sum(axis=1)
            if mixed:
                probability = _probability(far, outputs)
            before, weights = weights, (1.0 - probability) * (_NU + outputs) / (_NU + far)
            if np.abs(weights - before).max() < _SETTLED:
                break
    return np.asarray(probability > _SURE)


def _probability(far: FloatArray, outputs: FloatArray) -> FloatArray:
    odds = np.log(_SHARE / (1.0 - _SHARE)) - outputs * np.log(_WIDER)
    odds = odds + 0.5 * far * (1.0 - _WIDER**-2)
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(odds, -50.0, 50.0))))


@dataclass(frozen=True, eq=False)
class _Fits:
    """Normal equations of one output: of each log [X y]'[X y], its samples, and the penalty."""

    moments: FloatArray
    counts: FloatArray
    penalty: FloatArray

    @classmethod
    def of(
        cls,
        matrix: FloatArray,
        target: FloatArray,
        logs: Sequence[BoolArray],
        penalty: FloatArray,
    ) -> _Fits:
        """Sum over the known samples of `logs`, which are rows each."""
        both = np.column_stack([matrix, target])
        rows = [both[own & np.isfinite(target)] for own in logs]
        counts = np.array([float(len(each)) for each in rows])
        return cls(np.stack([each.T @ each for each in rows]), counts, penalty)

    def squares(self, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean squared errors (logs,) by the weighted fit to all logs, and to all others."""
        whole = np.tensordot(weights, self.moments, axes=1)
        total = float(weights @ self.counts)
        inside = np.full(len(weights), np.nan)
        outside, fit = inside.copy(), self._fit(whole, total)
        for k in np.flatnonzero(self.counts).tolist():
            left = total - weights[k] * self.counts[k]
            without = self._fit(whole - weights[k] * self.moments[k], left) if left > 0.0 else fit
            inside[k], outside[k] = self._square(k, fit), self._square(k, without)
        return inside, outside

    def _fit(self, moments: FloatArray, total: float) -> FloatArray:
        if not total > 0.0:
            return np.full(len(moments), np.nan)
        matrix = moments[:-1, :-1] / total + self.penalty
        found = np.linalg.lstsq(matrix, moments[:-1, -1] / total, rcond=None)[0]
        return np.append(found, -1.0)

    def _square(self, k: int, fit: FloatArray) -> float:
        square = float(fit @ self.moments[k] @ fit) / float(self.counts[k])
        return max(square, 0.0)
