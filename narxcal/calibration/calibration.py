"""A dynamic model behind a steady state: what every calibration does over time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from copy import copy
from typing import Any, Protocol, Self, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from narxcal.calibration.delay import DelayLine, TransportDelay
from narxcal.calibration.members import Member, Members, MembersState
from narxcal.channels import described
from narxcal.intervals import Band, HalfWidths
from narxcal.record import by_name
from narxcal.steady.model import ALTERED, Envelope, SteadyStateModel
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError, DataError, ModelError

_DIFFERENCE = 1e-4  # of a state, by which the step is linearised
_BLOCK = 2**16  # rows at a time, so that a flight of days takes little more memory than its results


class Running(Protocol):
    """State of a calibration between samples.

    `vector` (n,) is what a step at constant inputs depends on; it can be set.
    """

    @property
    def vector(self) -> FloatArray: ...
    @vector.setter
    def vector(self, values: FloatArray) -> None: ...

    def correct(self, outputs: FloatArray) -> None:
        """Replace the newest outputs by measured ones (n_out,); NaN keeps the model's own."""

    def advance(self, inputs: FloatArray, ss: FloatArray) -> FloatArray:
        """Deviations (n, n_out) at the next samples: inputs (n, n_in), steady states (n, n_out)."""


class Calibration(ABC):
    """Turns inputs into outputs over time: `simulate` for whole logs, `step` for one sample.

    All methods give the same numbers. Columns are canonical channels: `input_names` are those of
    the steady-state model, `output_names` those that it gives. Data frames are taken by these
    names; one that is missing or unknown is a `DataError`. `dt_s` is the sampling interval.
    A subclass has a dynamic model of its own behind the steady state; `with_members` mixes simple
    models with it, and `own_alone` is the same without them.
    """

    def __init__(self, steady: SteadyStateModel, dt_s: float) -> None:
        self.steady = steady
        self.dt_s = dt_s
        self.reach: Envelope | None = None
        self.delay: TransportDelay | None = None
        self.members = Members()
        self.interval: HalfWidths | None = None
        self._register: Running | None = None
        self._member_state: MembersState | None = None
        self._line: DelayLine | None = None

    def __repr__(self) -> str:
        names = f"{', '.join(self.input_names)} -> {', '.join(self.output_names)}"
        return f"<{type(self).__name__} {names} every {self.dt_s:.6g} s>"

    @property
    @abstractmethod
    def words(self) -> str:
        """Describe the dynamic model."""

    @property
    @abstractmethod
    def size(self) -> int:
        """Number of parameters of the dynamic model."""

    @abstractmethod
    def _started(self, inputs: FloatArray, ss: FloatArray, deviation: FloatArray) -> Running:
        """State at inputs (n_in,) that were constant, with this deviation (n_out,)."""

    @abstractmethod
    def _prediction(self, given: FloatArray, ss: FloatArray, known: FloatArray) -> FloatArray:
        """One-step prediction from measured outputs `known`, before simple models lead."""

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Guaranteed (low, high) of the deviation of each output; infinite where there are none."""
        none = np.full(len(self.output_names), np.inf)
        return -none, none

    @abstractmethod
    def to_arrays(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Split into JSON-able structure and named arrays, for the bundle."""

    def with_members(self, members: Sequence[Member]) -> Self:
        """The calibration as a mixture of its own model and `members`, each with its weight."""
        return self._with(members=Members(tuple(members)), interval=None)

    def with_interval(self, interval: HalfWidths | None) -> Self:
        """The calibration with half-widths over the distance from steady state of each output."""
        return self._with(interval=interval)

    def with_delay(self, delay: TransportDelay | None) -> Self:
        """The calibration with inputs that act late, in every model of the mixture."""
        for name in () if delay is None else delay.channels:
            if name not in self.input_names:
                raise ModelError(
                    f"the delay names '{name}', which is no input",
                    hint=f"Inputs are {', '.join(self.input_names)}",
                )
        return self._with(delay=delay)

    def delayed_inputs(self, inputs: FloatArray) -> FloatArray:
        """Inputs (time, n_in) as they act on the engine: behind the delay, where there is one."""
        if self.delay is None:
            return inputs
        return self.delay.line(self.input_names, inputs[0], self.dt_s).advance(inputs)

    def settled(self, inputs: ArrayLike) -> FloatArray:
        """Steady states (time, n_out) that a run over `inputs` (time, n_in) follows."""
        return self._steady_over(self.delayed_inputs(self._checked(inputs)))

    def _steady_over(self, given: FloatArray) -> FloatArray:
        """Steady states (time, n_out) at inputs as they act."""
        parts = [self.steady.outputs(given[rows]) for rows in blocks(len(given))]
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def own_alone(self) -> Self:
        """The calibration with its own model alone in every output."""
        return self.with_members(())

    def with_steady(self, steady: SteadyStateModel) -> Self:
        return self._with(steady=steady)

    def with_input_limits(self, low: ArrayLike, high: ArrayLike) -> Self:
        """The calibration with inputs (n_in,) that saturate at these limits.

        Whatever the inputs, the outputs are then those of conditions in a box: bounded. Raises
        `ModelError` for limits that are no range for each input.
        """
        low, high = (by_name(limit, self.input_names) for limit in (low, high))
        box = Envelope(*(np.asarray(limit, dtype=np.float64) for limit in (low, high)))
        fits = box.low.shape == box.high.shape == (len(self.input_names),)
        if not fits or not (box.low <= box.high).all():
            raise ModelError("'reach' is no range for each input", hint=ALTERED)
        return self._with(reach=box)

    def _common_rows(self) -> dict[str, Any]:
        """Limits of the inputs and interval as JSON can hold them, where there are any."""
        rows: dict[str, Any] = {}
        if self.reach is not None:
            rows["reach"] = {"low": self.reach.low.tolist(), "high": self.reach.high.tolist()}
        if self.interval is not None:
            rows["interval"] = self.interval.to_json()
        if self.delay is not None:
            rows["delay"] = self.delay.to_json()
        return rows

    @property
    def input_names(self) -> tuple[str, ...]:
        return self.steady.input_names

    @property
    def output_names(self) -> tuple[str, ...]:
        return self.steady.output_names

    @property
    def engines(self) -> tuple[str, ...]:
        """Engines whose build the steady-state model distinguishes; () where it does not."""
        return tuple(getattr(self.steady, "engines", ()))

    def for_engine(self, engine: str, *, or_mean: bool = False) -> Self:
        """The calibration with the build of `engine`, where the model distinguishes engines.

        "" is their mean, and with `or_mean` any other that the model was not fitted to is, too.
        Else that raises `ConfigError` with the engines.
        """
        if engine and self.engines and engine not in self.engines and not or_mean:
            raise ConfigError(
                f"expected one of the engines {', '.join(self.engines)}, found {engine!r}",
                hint='"" is the mean of these engines',
            )
        return self._with(steady=steady_for_engine(self.steady, engine))

    def _with(self, **changed: Any) -> Self:
        chosen = copy(self)
        vars(chosen).update(changed, _register=None, _member_state=None, _line=None)
        return chosen

    @overload
    def simulate(self, inputs: ArrayLike, start: ArrayLike | None = None) -> FloatArray: ...
    @overload
    def simulate(
        self, inputs: ArrayLike, start: ArrayLike | None = None, *, interval: float
    ) -> Band: ...
    def simulate(
        self, inputs: ArrayLike, start: ArrayLike | None = None, *, interval: float | None = None
    ) -> FloatArray | Band:
        """Free run over `inputs` (time, n_in); returns (time, n_out).

        `start` (n_out,) are measured outputs at the first sample; where it is None, NaN or
        physically impossible the engine starts in equilibrium. With `interval`, such as 0.9, a
        `Band` that covers this share of samples. Raises `DataError` for inputs that are not finite,
        `ModelError` as `half_width`.
        """
        given = self.delayed_inputs(self._checked(inputs))
        outputs = self.run(given, self._steady_over(given), start)
        if interval is None:
            return outputs
        half = self.half_width(inputs, outputs, interval)
        return Band(outputs, outputs - half, outputs + half)

    def half_width(self, inputs: ArrayLike, outputs: FloatArray, share: float) -> FloatArray:
        """Half-width (time, n_out) of the interval of a free run over `inputs` (time, n_in).

        It covers `share` of the samples of other logs, as prepared for training, by the errors on
        training logs that were held out at the same distance of `outputs` from steady state.
        Raises `ModelError` where none were held out.
        """
        if self.interval is None:
            raise ModelError(
                "no errors of held-out logs are stored with this model, so it has no interval",
                hint="Train it again with several logs and choice_s > 0, or with validation logs",
            )
        return self.interval.at(np.abs(self.settled(inputs) - outputs), share)

    def run(self, inputs: FloatArray, ss: FloatArray, start: ArrayLike | None) -> FloatArray:
        """Free run over inputs as they act, of which the steady states `ss` (time, n_out) are."""
        first = self._first_deviation(ss[0], start)
        running = self._started(inputs[0], ss[0], first)
        outputs: FloatArray = np.array(ss)
        outputs[0] -= first
        for rows in blocks(len(inputs), 1):
            outputs[rows] -= running.advance(inputs[rows], ss[rows])
        if self.members.members:
            later = self.members.started(ss[0], outputs[0]).advance(ss[1:])
            outputs[1:] = self.members.mixed(outputs[1:], later)
        return outputs

    def poles(self, inputs: FloatArray) -> NDArray[np.complex128]:
        """Poles of the step, linearised where it is in equilibrium at `inputs` (n_in,).

        By central differences; those of the members are added. Where they are the whole of every
        output there are no others.
        """
        found_of = [one.poles_of() for one in self.members.members]
        if not self.members.rest(len(self.output_names)).any():
            return np.concatenate(found_of).astype(np.complex128)
        given = self._checked(inputs[None])
        ss = self.steady.outputs(given)
        none = np.zeros(len(self.output_names))

        def step(values: FloatArray) -> FloatArray:
            running = self._started(given[0], ss[0], none)
            running.vector = values
            running.advance(given, ss)
            return running.vector

        rest = self._started(given[0], ss[0], none).vector
        moves = _DIFFERENCE * np.eye(len(rest))
        columns = [(step(rest + one) - step(rest - one)) / (2.0 * _DIFFERENCE) for one in moves]
        found = np.linalg.eigvals(np.array(columns)) if columns else np.empty(0)
        return np.concatenate([found, self._decay(), *found_of])

    def _decay(self) -> FloatArray:
        """Poles that no state shows at rest."""
        return np.empty(0)

    def predict(self, inputs: ArrayLike, measured: ArrayLike) -> FloatArray:
        """One-step-ahead prediction (time, n_out) from measured outputs (time, n_out).

        NaN where the past is unknown: at sample 0 and after a masked one.
        """
        given = self.delayed_inputs(self._checked(inputs))
        ss = self._steady_over(given)
        known = np.asarray(by_name(measured, self.output_names), dtype=np.float64)
        outputs = self._prediction(given, ss, known)
        if self.members.members:
            outputs = self.members.mixed(outputs, self.members.predict(ss, known))
        return outputs

    def reset(self, inputs: ArrayLike, start: ArrayLike | None = None) -> FloatArray:
        """Fill the register as if the inputs had been constant at `inputs` (n_in,).

        Returns the outputs (n_out,) at that sample, which are sample 0 of `simulate`.
        """
        given = self._checked(np.atleast_2d(self._inputs(inputs)))
        ss = self.steady.outputs(given)
        first = self._first_deviation(ss[0], start)
        self._register = self._started(given[0], ss[0], first)
        value: FloatArray = ss[0] - first
        self._member_state = self.members.started(ss[0], value)
        if self.delay is not None:
            self._line = self.delay.line(self.input_names, given[0], self.dt_s)
        return value

    def step(self, inputs: ArrayLike, correction: ArrayLike | None = None) -> FloatArray:
        """Outputs (n_out,) at the next sample, from `inputs` (n_in,) at that sample.

        `correction` (n_out,), such as a fused estimate, replaces the newest outputs in the
        register before the step; NaN keeps the model's own. The first call resets.
        """
        if correction is not None and self._register is not None:
            corrected = np.asarray(by_name(correction, self.output_names), dtype=np.float64)
            self._register.correct(corrected)
            if self._member_state is not None:
                self._member_state.correct(corrected)
        outputs: FloatArray = self.extend(self._inputs(inputs)[None])[0]
        return outputs

    def extend(self, inputs: ArrayLike) -> FloatArray:
        """Outputs (time, n_out) at the next samples, from `inputs` (time, n_in), as by `step`."""
        given = self._checked(inputs)
        if self._register is None:
            first = self.reset(given[0])[None]
            return np.concatenate([first, self.extend(given[1:])]) if len(given) > 1 else first
        if self._line is not None:
            given = self._line.advance(given)
        ss = self.steady.outputs(given)
        outputs: FloatArray = ss - self._register.advance(given, ss)
        if self.members.members and self._member_state is not None:
            outputs = self.members.mixed(outputs, self._member_state.advance(ss))
        return outputs

    def _inputs(self, inputs: ArrayLike) -> FloatArray:
        return np.asarray(by_name(inputs, self.input_names), dtype=np.float64)

    def _checked(self, inputs: ArrayLike) -> FloatArray:
        given = self._inputs(inputs)
        if given.ndim != 2 or given.shape[1] != len(self.input_names) or not len(given):
            raise DataError(
                f"expected inputs of shape (time, {len(self.input_names)}) "
                f"({', '.join(self.input_names)}), found {given.shape}"
            )
        if not np.isfinite(given).all():
            row, column = np.argwhere(~np.isfinite(given))[0]
            raise DataError(
                f"expected a finite input, found {given[row, column]}",
                channel=self.input_names[column],
                row=int(row),
                hint="Hold the last good value, or cut the log there",
            )
        return given if self.reach is None else self.reach.clamp(given)

    def _first_deviation(self, ss: FloatArray, start: ArrayLike | None) -> FloatArray:
        if start is None:
            return np.zeros(len(self.output_names))
        given = np.asarray(by_name(start, self.output_names), dtype=np.float64)
        if given.shape != ss.shape:
            raise DataError(
                f"expected start values of shape ({len(ss)},) ({', '.join(self.output_names)}), "
                f"found {given.shape}"
            )
        low, high = np.transpose([described(name).limits for name in self.output_names])
        return np.where((given >= low) & (given <= high), ss - given, 0.0)


def blocks(rows: int, first: int = 0) -> list[slice]:
    return [slice(start, min(start + _BLOCK, rows)) for start in range(first, rows, _BLOCK)]


def steady_for_engine(steady: SteadyStateModel, engine: str) -> SteadyStateModel:
    chooser = getattr(steady, "for_engine", None)
    chosen: SteadyStateModel = steady if chooser is None else chooser(engine)
    return chosen
