"""What lever moves tell of a run's parameters, before they are flown.

**Parameters.** Those of the lags, or of an identified response or engine, with the slopes of the
free run; and of each output a static error of the steady state,

    a . [1, p, p^2, h, p h]        p, h: shares of the lever and altitude range, -1/2 to 1/2

Before any log they are Gaussian about the run's values: a lag's by the unit of its fit
(`training.dynamics.lag_priors`), static errors by the offsets of held-out recordings. Network and
simple models of the mixture are taken as they are.

**Information.** A log's slopes s are whitened by the run's noise model
(`narxcal.calibration.noise`), so that errors of a free run that last, and grow while the engine
moves, count as such. That of the training logs is known before the flight. The predictive variance
is that over all candidate moves, in shares of each output's held-out mean squared error e^2:

    A = mean of s s' / e^2 over samples and outputs
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from data_prep.prepare import with_outputs
from eval.run_logs import run_config
from narxcal.calibration.bundle import Bundle
from narxcal.calibration.calibration import Calibration
from narxcal.calibration.dynamic import DynamicCalibration
from narxcal.calibration.identified import EngineDynamics, IdentifiedCalibration, ResponseDynamics
from narxcal.calibration.noise import NoiseModel, activity
from narxcal.flight_test.moves import Limits
from narxcal.lumped.engine import LumpedEngine, Slopes
from narxcal.narx.network import AT_START
from narxcal.support.arrays import BoolArray, FloatArray
from narxcal.support.compiled import compiled
from narxcal.support.errors import ModelError
from narxcal.support.progress import Progress, silent
from training.dynamics.lag_priors import start_engine
from training.dynamics.lags import form_of
from training.pipeline import read_split

_STATIC: Final = ("1", "p", "p^2", "h", "p h")
_DIFFERENCE: Final = 1e-4  # of a unit, by which an identified model is differenced


class Parameters(NamedTuple):
    """Dynamic parameters: names, standard deviations (P,) before any log, and slopes.

    `slopes` takes inputs (time, n_in) and gives those of the outputs (time, n_out, P), per
    standard deviation.
    """

    names: tuple[str, ...]
    unit: FloatArray
    slopes: Callable[[FloatArray], FloatArray]


def parameters_of(bundle: Bundle) -> Parameters:
    """The dynamic parameters of a run; raises `ModelError` for one without any."""
    own = bundle.calibration
    if isinstance(own, DynamicCalibration) and own.lag is not None:
        return _of_lags(bundle, own, own.lag)
    if isinstance(own, IdentifiedCalibration):
        if isinstance(own.dynamics, ResponseDynamics):
            return _of_responses(own, own.dynamics)
        if isinstance(own.dynamics, EngineDynamics):
            return _of_engine(own, own.dynamics)
    raise ModelError(
        f"a card needs parameters of responses, and this run has none: {own.words}",
        hint="Train with [narx] lag = true, or identify --method transfer or output-error",
    )


def _of_lags(bundle: Bundle, own: DynamicCalibration, lag: LumpedEngine) -> Parameters:
    """Fitted parameters of the lags; their deviation counts by the model's share of an output."""
    section = run_config(bundle)[0].narx
    scales = {"centre": lag.centre, "half": lag.half, "limit": lag.limit}
    table = start_engine(lag.output_names, form_of(section), scales)[1]
    free = np.flatnonzero(table.fitted)
    wanted = Slopes(free, np.arange(len(own.output_names)))
    share = own.members.rest(len(own.output_names))[:, None] * table.unit[free]

    def slopes(inputs: FloatArray) -> FloatArray:
        given = own.delayed_inputs(inputs)
        drive = lag.drive(given, own.input_names, own.settled(inputs))
        start = lag.start(np.zeros(len(own.output_names)))
        return -share * lag.slopes(wanted, drive, (AT_START, start[None]), own.dt_s)

    names = lag.parameter_names
    return Parameters(tuple(names[k] for k in free), table.unit[free], slopes)


def _of_responses(own: IdentifiedCalibration, dynamics: ResponseDynamics) -> Parameters:
    """Logarithms of the responses' parameters at every node."""
    sizes = [one.values.size for one in dynamics.schedules]
    theta = np.concatenate([one.values.ravel() for one in dynamics.schedules])
    names = tuple(
        f"{output}: ln parameter {k + 1}"
        for output, size in zip(own.output_names, sizes, strict=True)
        for k in range(size)
    )

    def at(values: FloatArray) -> Calibration:
        parts = np.split(values, np.cumsum(sizes)[:-1])
        schedules = tuple(
            replace(one, values=part.reshape(one.values.shape))
            for one, part in zip(dynamics.schedules, parts, strict=True)
        )
        return IdentifiedCalibration(own.steady, replace(dynamics, schedules=schedules), own.dt_s)

    return Parameters(names, np.ones(len(theta)), _differenced(at, theta, np.ones(len(theta))))


def _of_engine(own: IdentifiedCalibration, dynamics: EngineDynamics) -> Parameters:
    """Estimated parameters of the engine, each as uncertain as it is large."""
    theta = np.array([dynamics.values[name] for name in dynamics.free])
    unit = np.maximum(np.abs(theta), _DIFFERENCE)

    def at(values: FloatArray) -> Calibration:
        free = dict(zip(dynamics.free, values.tolist(), strict=True))
        return IdentifiedCalibration(
            own.steady, replace(dynamics, values={**dynamics.values, **free}), own.dt_s
        )

    return Parameters(dynamics.free, unit, _differenced(at, theta, unit))


def _differenced(
    at: Callable[[FloatArray], Calibration], theta: FloatArray, unit: FloatArray
) -> Callable[[FloatArray], FloatArray]:
    """Central differences of the free run per unit of each parameter."""

    def slopes(inputs: FloatArray) -> FloatArray:
        steps = _DIFFERENCE * np.diag(unit)
        columns = [at(theta + one).simulate(inputs) - at(theta - one).simulate(inputs)
                   for one in steps]  # fmt: skip
        return np.stack(columns, axis=-1) / (2.0 * _DIFFERENCE)

    return slopes


class Information(NamedTuple):
    """Of inputs: `information` (P, P), and the sum of `outer` products over `samples`."""

    information: FloatArray
    outer: FloatArray
    samples: int


@dataclass(frozen=True, eq=False)
class Experiment:
    """A run whose parameters are to be known better within `limits`; `lever` is what is moved."""

    bundle: Bundle
    limits: Limits
    lever: str

    @cached_property
    def noise(self) -> NoiseModel:
        """Noise of the run; raises `ModelError` for a run without it."""
        found = self.bundle.record.noise
        if found is None:
            raise ModelError(
                "the run has no noise model, by which information is measured",
                hint="Train it again with this version",
            )
        return found

    @cached_property
    def parameters(self) -> Parameters:
        return parameters_of(self.bundle)

    @cached_property
    def errors(self) -> FloatArray:
        """Standard deviation (n_out,) of a free run's error on recordings that were held out."""
        record, names = self.bundle.record, self.bundle.calibration.output_names
        held = {} if record.held_out is None else record.held_out.rmse
        fit = {} if record.free_run is None else record.free_run.rmse
        squares = [np.square(held.get(name, (fit.get(name, np.nan),))) for name in names]
        means = [np.nanmean(each) if np.isfinite(each).any() else np.nan for each in squares]
        found = np.sqrt(np.array(means, dtype=np.float64))
        known = np.isfinite(found) & (found > 0.0)
        return np.where(known, found, np.sqrt(self.noise.initial_variance))

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters, static errors behind those of the dynamics."""
        outputs = self.bundle.calibration.output_names
        static = [f"{output}: static {term}" for output in outputs for term in _STATIC]
        return (*self.parameters.names, *static)

    @property
    def unit(self) -> FloatArray:
        """Standard deviation of each before any log."""
        return np.concatenate([self.parameters.unit, np.repeat(self._offset, len(_STATIC))])

    @property
    def _offset(self) -> FloatArray:
        """Standard deviation (n_out,) of the offset of another recording."""
        interval = self.bundle.calibration.interval
        between = np.array(() if interval is None else interval.between)
        return between if len(between) and (between > 0.0).all() else self.errors

    def information_of(self, inputs: FloatArray, known: BoolArray | None = None) -> Information:
        """Information of a log of these inputs where its outputs are `known` (time, n_out)."""
        y = self.bundle.calibration.simulate(inputs)
        slopes = self._slopes(inputs)
        seen = np.ones(y.shape, dtype=np.bool_) if known is None else known
        size = slopes.shape[2]
        found, outer = np.zeros((size, size)), np.zeros((size, size))
        for k in range(y.shape[1]):
            change = np.diff(y[:, k], prepend=y[0, k])
            rows = whitened(slopes[:, k], change, seen[:, k], self._noise_of(k))
            found += rows.T @ rows
            outer += slopes[:, k].T @ slopes[:, k] / self.errors[k] ** 2
        return Information(found, outer, len(y) * y.shape[1])

    def _noise_of(self, k: int) -> FloatArray:
        """What `whitened` takes of the noise of output k."""
        one = self.noise
        fields = (one.bias_decay, one.process_variance, one.transient_gain, one.activity_decay,
                  one.measurement_variance, one.initial_variance)  # fmt: skip
        return np.array([each[k] for each in fields])

    def _slopes(self, inputs: FloatArray) -> FloatArray:
        """Slopes (time, n_out, P) by all parameters, per standard deviation before any log."""
        names, count = self.bundle.calibration.input_names, len(self._offset)
        p = _share(inputs[:, names.index(self.lever)], self.limits.lever)
        h = np.zeros_like(p)
        if "ALT_ft" in names:
            h = _share(inputs[:, names.index("ALT_ft")], self.limits.altitude_ft)
        terms = np.stack([np.ones_like(p), p, p * p, h, p * h], axis=1)
        static = np.zeros((len(p), count, count, len(_STATIC)))
        for k, size in enumerate(self._offset.tolist()):
            static[:, k, k] = size * terms
        own = self.parameters.slopes(inputs)
        return np.concatenate([own, static.reshape(len(p), count, -1)], axis=2)


def _share(values: FloatArray, span: tuple[float, float]) -> FloatArray:
    """Values as shares of a range, 0 in its middle."""
    return (values - 0.5 * (span[0] + span[1])) / max(span[1] - span[0], 1e-9)


@compiled
def whitened(
    columns: FloatArray, change: FloatArray, known: BoolArray, noise: FloatArray
) -> FloatArray:
    """Whiten slopes (time, P) of one output by its noise; rows that are not `known` are zero.

    The innovations of a Kalman filter of the error b, divided by their standard deviations, are a
    linear map with independent rows of variance one. `change` (time,) is that of the prediction,
    `noise` phi, q, g, rho, r and p0 of `narxcal.calibration.noise`.
    """
    phi, q, g, rho, r, variance = noise
    found = np.zeros(columns.shape)
    state = np.zeros(columns.shape[1])
    moving = 0.0
    for k in range(len(columns)):
        moving = activity(moving, change[k], rho)
        if k > 0:
            variance = phi * phi * variance + q + g * moving
            state = phi * state
        if known[k]:
            total = variance + r
            ahead = columns[k] - state
            found[k] = ahead / np.sqrt(total)
            state = state + variance / total * ahead
            variance = variance * r / total
    return found


def of_training(
    experiment: Experiment, data: Path | None, progress: Progress = silent
) -> FloatArray:
    """Information (P, P) of the run's training logs; `data` is their folder where they have moved.

    Raises `DataError` where they are not at hand.
    """
    bundle = experiment.bundle
    config = run_config(bundle)[0]
    if data is not None:
        config = config.with_logs_in(data.resolve())
    split, _ = read_split(config, config.logs.resolve(Path(bundle.record.base)))
    own, found = bundle.calibration, []
    for number, log in enumerate(split.train):
        progress(number, len(split.train), log.name)
        known = np.isfinite(with_outputs(log, own.output_names).matrix(own.output_names))
        found.append(experiment.information_of(log.matrix(own.input_names), known))
    return np.asarray(np.sum([one.information for one in found], axis=0))
