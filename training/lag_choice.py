"""Which lags stand in front of the network, where [narx] says "auto": chosen by the training logs.

How an engine comes to rest is its control's doing, and nobody tells what that does: nothing that
matters (`lumped.lag`), limits of acceleration and deceleration (the same with `lag_limits`), or
hold N1 (`lumped.lag_governed`). The richer form always fits better, so each is fitted to some of
the recordings and judged by its free run over the others, where the core moves; of a single
recording stretches take turns. Errors are compared by the geometric mean over the outputs, and the
plainer form stands unless a richer one is better by two percent.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count, pairwise

import numpy as np

from data_prep.log import Log
from narxcal.channels import CHANNELS
from narxcal.lumped.lag import core_of
from narxcal.lumped.lag_governed import AnyLags
from narxcal.steady.model import SteadyStateModel
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import DataError
from training.config import NarxSection, RunConfig
from training.folds import Turn, left_over, turns
from training.lag_fit import LagSamples, moving, thinned_for_lags
from training.records import fitted_lags, lag_samples

_BETTER = 0.98  # of the plainer form's error; fewer logs than in the end hold richer forms back
_TURNS = 3
_STRETCH_S, _STRETCHES = 30.0, 15  # at least so long, at most so many, of a single recording
_RASTER_S = 0.2  # twice that of the fit; forms compare alike
_ENOUGH_S = 3.0 * 3600.0  # of logs; to choose by more of them takes long and tells little
PLAIN, LIMITS, GOVERNED = "plain", "limits", "governed"


@dataclass(frozen=True)
class LagChoice:
    """The `form` that was taken, and what each form left, as a share of the outputs' range.

    `left` is empty where there was nothing to choose, `form` where there are no lags.
    """

    form: str
    left: Mapping[str, float] = field(default_factory=dict)

    def row(self) -> dict[str, object]:
        """As JSON-able values."""
        return {"form": self.form, "left": dict(self.left)}


def chosen_lags(
    config: RunConfig,
    steady: SteadyStateModel,
    logs: Sequence[Log],
    watch: Callable[[int, int], None] = lambda _done, _total: None,
) -> tuple[RunConfig, LagChoice]:
    """The configuration without "auto" in [narx], and what was chosen; raises nothing of its own.

    Where no form can be judged (nothing moves in some recording), the plainest stands. `watch` is
    told how many of all fits are done.
    """
    forms = _offered(config, steady)
    if len(forms) < 2:
        return _with(config, forms[0]), LagChoice(forms[0] if config.narx.lag else "")
    logs = _enough(logs)
    samples = [lag_samples(log, steady, config) for log in logs]
    samples, dt_s = thinned_for_lags(samples, logs[0].dt_s, _RASTER_S)
    samples, recordings = _stretches(samples, [log.source.file for log in logs], dt_s)
    task = _Task(steady, samples, turns(recordings, _TURNS), dt_s)
    total, done = len(forms) * len(task.turns), count()

    def begins() -> None:
        watch(next(done), total)

    left, best = {form: task.left(_with(config, form), begins) for form in forms}, forms[0]
    for form in forms[1:]:
        if left[form] < _BETTER * left[best]:
            best = form
    known = {form: value for form, value in left.items() if np.isfinite(value)}
    return _with(config, best), LagChoice(best, known)


def _offered(config: RunConfig, steady: SteadyStateModel) -> list[str]:
    """The forms that [narx] leaves open, the plainest first."""
    section = config.narx
    if not section.lag:
        return [PLAIN]
    if section.lag_governed is True:
        return [GOVERNED]
    if section.lag_limits != "auto":
        return [LIMITS if section.lag_limits else PLAIN]
    forms = [PLAIN, LIMITS]
    if section.lag_governed == "auto" and _can_be_governed(config, steady):
        forms.append(GOVERNED)
    return forms


def _can_be_governed(config: RunConfig, steady: SteadyStateModel) -> bool:
    """Whether lags behind a control can be: between a lever and the speeds of a fan and a core.

    They have their own errors and heat; where [narx] says what these are to be, they are out.
    """
    section = config.narx
    driver = config.steady_state.driver or config.events.driver
    spools = {"N1_pct", "N2_pct"} <= set(steady.output_names)
    plain = section.lag_errors == "absolute" and not section.lag_heat
    return spools and plain and CHANNELS[driver].role == "lever"


def _with(config: RunConfig, form: str) -> RunConfig:
    said = {"lag_limits": form == LIMITS, "lag_governed": form == GOVERNED}
    section: NarxSection = config.narx.model_copy(update=said)
    return config.model_copy(update={"narx": section})


def _enough(logs: Sequence[Log]) -> list[Log]:
    """Every so many-th recording, with all its engines, where there are hours of them."""
    names = list(dict.fromkeys(log.source.file for log in logs))
    every = int(sum(len(log) * log.dt_s for log in logs) // _ENOUGH_S) + 1
    every = max(min(every, len(names) // _TURNS), 1)
    taken = set(names[::every])
    return [log for log in logs if log.source.file in taken]


def _stretches(
    samples: Sequence[LagSamples], recordings: Sequence[str], dt_s: float
) -> tuple[list[LagSamples], list[str]]:
    """Samples with the names of their recordings; of a single one stretches that take turns."""
    if len(set(recordings)) > 1:
        return list(samples), list(recordings)
    parts, names = [], []
    for one in samples:
        many = int(np.clip(len(one.ss) * dt_s / _STRETCH_S, _TURNS, _STRETCHES))
        edges = np.linspace(0, len(one.ss), many + 1).astype(int).tolist()
        for number, (start, stop) in enumerate(pairwise(edges)):
            parts.append(one.rows(slice(start, stop)))
            names.append(str(number % _TURNS))
    return parts, names


@dataclass(frozen=True, eq=False)
class _Task:
    """What forms are judged on: samples, in turns, on the raster `dt_s`."""

    steady: SteadyStateModel
    samples: Sequence[LagSamples]
    turns: Sequence[Turn]
    dt_s: float

    def left(self, config: RunConfig, begins: Callable[[], None]) -> float:
        """What the lags of a form leave in free run, as a share of the outputs' range.

        `begins` is called as each fit begins. An output that nothing was fitted to is not judged.
        """
        errors: list[FloatArray] = []
        for turn in self.turns:
            begins()
            fitted, judged = turn.of(self.samples)
            try:
                lag = fitted_lags(config, fitted, self.steady, self.dt_s)
            except DataError:  # nothing moves without what is judged
                return np.inf
            known = np.concatenate([np.isfinite(one.measured) for one in fitted]).any(axis=0)
            errors += [np.where(known, self._error(lag, one), np.nan) for one in judged]
        return left_over(errors)

    def _error(self, lag: AnyLags, one: LagSamples) -> FloatArray:
        """Error (rows, outputs) of the free run where the core moves, over the outputs' range."""
        deviation = one.ss - one.measured
        drive = lag.drive(one.inputs, self.steady.input_names, one.ss)
        error = lag.deviations(drive, deviation[0], self.dt_s) - deviation
        core = core_of(tuple(self.steady.output_names))
        rows = moving(one.ss[:, core], self._range[core], self.dt_s)
        left: FloatArray = error[rows] / self._range
        return left

    @property
    def _range(self) -> FloatArray:
        """Of each output over all samples (outputs,)."""
        ss = np.concatenate([one.ss for one in self.samples])
        width: FloatArray = np.maximum(np.ptp(ss, axis=0), 1e-9)
        return width
