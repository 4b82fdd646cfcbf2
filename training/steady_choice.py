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
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from data_prep.equilibrium import quasi_steady
from data_prep.log import Log
from data_prep.prepare import hold_inputs
from narxcal.channels import CHANNELS, described, spools_of
from narxcal.steady.fitted import RATIOS, Layout
from narxcal.steady.model import SteadyStateModel
from narxcal.steady.opening import open_steady
from narxcal.support.arrays import BoolArray, FloatArray
from narxcal.support.errors import DataError
from training.config import RunConfig
from training.folds import geometric_rms, held_out_folds, regions, surely_below
from training.outlying import LEAST_LOGS, Outlier, outliers
from training.records import LEAST_WIDTHS
from training.steady_fit import SteadyQuality, SteadySamples, fit_steady_state

_BETTER = 0.9  # of the residual of the usual answer
_SWITCH = float(-np.log(0.97))  # of ln residual
_ROWS = 2000  # of a log; enough to choose by
_FOLDS = 5
_BLENDED = ("Mach", "ALT_ft")  # the usual one first
# Share of `LEAST_WIDTHS` between corners. Over it pressure changes by 3 %; with exponents that are
# off by a tenth, outputs by 0.3 %, which is about what any steady state leaves.
_APART = 0.1
_IDLES = ("WOW", "Approach")  # by them controls choose ground, flight and approach idle
_ON_S = 6.0  # quasi-steady time for which a switch has to be on, and off; the rest is judged


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
    return fit_steady_state([_samples(config, layout, log) for log in logs], layout, section.fit)


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
        left[corrected] = float(np.exp(_left(trial, [(taken, taken)])[0]))
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
    usual = _left(layout, folds)
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
    alone = {name: _left(replace(layout, switches=(name,)), folds) for name in offered}
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
    less = _left(trial, folds)
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


def _left(layout: Layout, folds: _Folds) -> FloatArray:
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
