"""Calibrations whose dynamics were identified: output error, responses, state space, none.

A dynamic model gets a drive (time, columns) that is made of the inputs and the steady state, and
advances a state:

    run(state, drive, measured) -> outputs (time, n_out), state

Row 0 of the drive is the sample that the state belongs to. A finite value of `measured`
(time, n_out) replaces an output after its sample, so that the free run, the one-step prediction and
a correction on line are one function.

| method | dynamic model | state |
|---|---|---|
| output-error | `narxcal.output_error.engine.EngineFromSteady` | N_H, N_L, T |
| transfer | a first- or second-order response per output | output and its rate |
| subspace | d = C x, x+ = A x + B (ss+ - ss): equilibria are kept | x, error added by a start |
| static:NAME | none: a static law is the steady state | |
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from narxcal.calibration.calibration import Calibration, Running
from narxcal.calibration.delay import TransportDelay
from narxcal.calibration.dynamic import DynamicCalibration
from narxcal.intervals import HalfWidths
from narxcal.output_error.engine import STEADY_OUTPUTS, EngineFromSteady, steady_drive
from narxcal.state_space import StateSpace
from narxcal.steady.model import ALTERED, SteadyStateModel
from narxcal.steady.opening import steady_from_json, steady_to_json
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ModelError, NarxcalError
from narxcal.transfer import Schedule, respond


class Dynamics(ABC):
    """A dynamic model behind a steady state."""

    kind: ClassVar[str]

    @property
    @abstractmethod
    def size(self) -> int:
        """Number of parameters."""

    @property
    @abstractmethod
    def words(self) -> str:
        """Describe the model."""

    def drive(self, steady: SteadyStateModel, inputs: FloatArray, ss: FloatArray) -> FloatArray:
        """Drive (time, columns) from inputs (time, n_in) and steady states (time, n_out)."""
        del steady, inputs
        return ss

    @abstractmethod
    def equilibrium(self, drive: FloatArray) -> FloatArray:
        """State (n,) in equilibrium at a drive (columns,)."""

    @abstractmethod
    def run(
        self, state: FloatArray, drive: FloatArray, measured: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Outputs (time, n_out) and the state after the last sample."""

    @abstractmethod
    def to_json(self) -> dict[str, Any]:
        """Everything needed to rebuild the model."""

    @classmethod
    @abstractmethod
    def from_json(cls, stored: Mapping[str, Any], steady: SteadyStateModel, dt_s: float) -> Self:
        """Inverse of `to_json`."""


@dataclass(frozen=True)
class NoDynamics(Dynamics):
    """Outputs are the steady state; `size` is that of the static law."""

    kind: ClassVar[str] = "none"
    size: int = 0
    words: str = "steady state without dynamics"

    def equilibrium(self, drive: FloatArray) -> FloatArray:
        return np.empty(0) * drive[:0]

    def run(
        self, state: FloatArray, drive: FloatArray, measured: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        del measured
        return drive, state

    def to_json(self) -> dict[str, Any]:
        return asdict(self)

    @classmethod
    def from_json(cls, stored: Mapping[str, Any], steady: SteadyStateModel, dt_s: float) -> Self:
        del steady, dt_s
        return cls(int(stored["size"]), str(stored["words"]))


@dataclass(frozen=True, eq=False)
class EngineDynamics(Dynamics):
    """Equation 1 of the Spey paper with steady-state curves; `free` of the values were estimated.

    `span` is the driver's range over which slopes are taken; `order` are the columns of N_H, N_L, T
    among the outputs.
    """

    kind: ClassVar[str] = "output-error"
    values: Mapping[str, float]
    free: tuple[str, ...]
    driver: str
    span: tuple[float, float]
    order: tuple[int, ...]
    dt_s: float

    @property
    def size(self) -> int:
        return len(self.free)

    @property
    def words(self) -> str:
        shown = ", ".join(f"{name} {self.values[name]:.2f} s" for name in ("tau_H", "tau_L"))
        return f"output error, {shown}"

    def drive(self, steady: SteadyStateModel, inputs: FloatArray, ss: FloatArray) -> FloatArray:
        """Steady values and slopes of N_H, N_L, T; then the steady values of other outputs."""
        own = steady_drive(steady, inputs, self.driver, self.span)
        return np.hstack([own, np.delete(ss, self.order, axis=1)])

    def equilibrium(self, drive: FloatArray) -> FloatArray:
        return drive[:3]

    def run(
        self, state: FloatArray, drive: FloatArray, measured: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Integrate equation 1; outputs that it does not have are steady."""
        order, size = list(self.order), 5  # columns of `steady_drive`
        outputs = np.empty_like(measured)
        outputs[:, order], end = EngineFromSteady(self.dt_s).run(
            self.values, drive[:, :size], state, measured[:, order]
        )
        outputs[:, np.delete(np.arange(measured.shape[1]), order)] = drive[:, size:]
        return outputs, end

    def to_json(self) -> dict[str, Any]:
        own = {"values": dict(self.values), "free": list(self.free)}
        return {**own, "driver": self.driver, "span": list(self.span)}

    @classmethod
    def from_json(cls, stored: Mapping[str, Any], steady: SteadyStateModel, dt_s: float) -> Self:
        values = {name: float(value) for name, value in stored["values"].items()}
        order = tuple(steady.output_names.index(name) for name in STEADY_OUTPUTS)
        low, high = map(float, stored["span"])
        driver = str(stored["driver"])
        return cls(values, tuple(stored["free"]), driver, (low, high), order, dt_s)


@dataclass(frozen=True, eq=False)
class ResponseDynamics(Dynamics):
    """A response per output; logarithms of its parameters over `conditions`, see `respond`.

    A condition is the name of an input, or "level", the steady value of the output itself.
    """

    kind: ClassVar[str] = "transfer"
    conditions: tuple[str, ...]
    schedules: tuple[Schedule, ...]
    dt_s: float

    @property
    def size(self) -> int:
        return sum(one.values.size for one in self.schedules)

    @property
    def words(self) -> str:
        orders = ", ".join(str(one.values.shape[-1]) for one in self.schedules)
        return f"responses of order {orders} over {', '.join(self.conditions) or 'nothing'}"

    def drive(self, steady: SteadyStateModel, inputs: FloatArray, ss: FloatArray) -> FloatArray:
        """Steady values, then the conditions that are inputs."""
        named = [steady.input_names.index(name) for name in self.conditions if name != "level"]
        return np.hstack([ss, inputs[:, named]])

    def equilibrium(self, drive: FloatArray) -> FloatArray:
        count = len(self.schedules)
        return np.concatenate([drive[:count], np.zeros(count)])

    def run(
        self, state: FloatArray, drive: FloatArray, measured: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        count = len(self.schedules)
        outputs, ends = np.empty_like(measured), np.empty((2, count))
        for k, schedule in enumerate(self.schedules):
            level = [drive[:, k]] if "level" in self.conditions else []
            logs = schedule.at(np.column_stack([*level, drive[:, count:]]))
            start = complex(state[k]), complex(state[count + k])
            outputs[:, k], ends[:, k] = respond(
                drive[:, k], logs, self.dt_s, start, measured[:, k].copy()
            )
        return outputs, ends.ravel()

    def to_json(self) -> dict[str, Any]:
        rows = [{"axes": one.axes, "logs": one.values.tolist()} for one in self.schedules]
        return {"conditions": list(self.conditions), "outputs": rows}

    @classmethod
    def from_json(cls, stored: Mapping[str, Any], steady: SteadyStateModel, dt_s: float) -> Self:
        del steady
        schedules = tuple(
            Schedule(tuple(map(tuple, one["axes"])), np.array(one["logs"], dtype=np.float64))
            for one in stored["outputs"]
        )
        return cls(tuple(stored["conditions"]), schedules, dt_s)


@dataclass(frozen=True, eq=False)
class StateSpaceDynamics(Dynamics):
    """Deviation d = ss - y of a linear system driven by the increments of the steady state.

    Without increments d fades: every equilibrium is that of the steady state.
    """

    kind: ClassVar[str] = "subspace"
    model: StateSpace

    @property
    def size(self) -> int:
        """Parameters of a canonical form: n (inputs + outputs)."""
        return self.model.order * sum(self.model.D.shape)

    @property
    def words(self) -> str:
        shown = ", ".join(f"{tau:.3g}" for tau in self.model.time_constants_s)
        return f"state space of order {self.model.order}, time constants {shown} s"

    def equilibrium(self, drive: FloatArray) -> FloatArray:
        return np.zeros(self.model.order + len(drive))

    def run(
        self, state: FloatArray, drive: FloatArray, measured: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Simulate; what a measurement adds to C x fades with the slowest time constant."""
        n, A, B = self.model.order, self.model.A, self.model.B
        moved = np.vstack([np.diff(drive, axis=0) @ B.T, np.zeros(n)])
        eye = np.eye(n)
        x = StateSpace(A, eye, eye, np.zeros((n, n)), 1.0).simulate(moved, state[:n])
        outputs = drive - x @ self.model.C.T
        added, fade = state[n:], float(np.abs(self.model.poles[0]))
        extra = np.empty_like(drive)
        for k in range(len(drive)):
            extra[k] = fade * added if k else added
            known = np.isfinite(measured[k])
            added = np.where(known, measured[k] - outputs[k], extra[k])
        return outputs + extra, np.concatenate([x[-1], added])

    def to_json(self) -> dict[str, Any]:
        return self.model.to_dict()

    @classmethod
    def from_json(cls, stored: Mapping[str, Any], steady: SteadyStateModel, dt_s: float) -> Self:
        del steady, dt_s
        return cls(StateSpace.from_dict(dict(stored)))


_KINDS: dict[str, type[Dynamics]] = {
    one.kind: one for one in (NoDynamics, EngineDynamics, ResponseDynamics, StateSpaceDynamics)
}


class IdentifiedCalibration(Calibration):
    """A steady-state model and an identified dynamic model behind it."""

    def __init__(self, steady: SteadyStateModel, dynamics: Dynamics, dt_s: float) -> None:
        super().__init__(steady, dt_s)
        self.dynamics = dynamics

    @property
    def words(self) -> str:
        return self.dynamics.words

    @property
    def size(self) -> int:
        return self.dynamics.size

    def _started(self, inputs: FloatArray, ss: FloatArray, deviation: FloatArray) -> Running:
        drive = self.dynamics.drive(self.steady, inputs[None], ss[None])
        state = self.dynamics.equilibrium(drive[0])
        started = _Running(self, drive, state)
        started.correct(np.where(deviation == 0.0, np.nan, ss - deviation))
        return started

    def _prediction(self, given: FloatArray, ss: FloatArray, known: FloatArray) -> FloatArray:
        drive = self.dynamics.drive(self.steady, given, ss)
        found, _ = self.dynamics.run(self.dynamics.equilibrium(drive[0]), drive, known)
        unknown = np.ones(len(found), dtype=np.bool_)
        unknown[1:] = np.isnan(known[:-1]).any(axis=1)
        return np.where(unknown[:, None], np.nan, found)

    def to_arrays(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        steady, arrays = steady_to_json(self.steady)
        dynamics = {"kind": self.dynamics.kind, **self.dynamics.to_json()}
        meta = {"dt_s": self.dt_s, "steady": steady, "dynamics": dynamics}
        meta |= self._common_rows()
        return meta, {f"steady/{name}": value for name, value in arrays.items()}

    @classmethod
    def from_arrays(
        cls, meta: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]], *, trust: bool = False
    ) -> Self:
        """Rebuild from `to_arrays`; raises `ModelError` where the parts do not fit each other."""
        own = {name.removeprefix("steady/"): value for name, value in arrays.items()}
        try:
            steady = steady_from_json(meta["steady"], own, trust=trust)
            stored, dt_s = meta["dynamics"], float(meta["dt_s"])
            if stored["kind"] not in _KINDS:
                raise ModelError(
                    f"unknown kind of dynamics '{stored['kind']}'",
                    hint=f"Known kinds: {', '.join(_KINDS)}",
                )
            if not 0.0 < dt_s < np.inf:
                raise ModelError(f"'dt_s' has to be positive, found {dt_s}", hint=ALTERED)
            return cls(steady, _KINDS[stored["kind"]].from_json(stored, steady, dt_s), dt_s)
        except NarxcalError:
            raise
        except (KeyError, TypeError, ValueError, IndexError) as error:
            raise ModelError(f"the stored dynamics cannot be read: {error}", hint=ALTERED) from None


class _Running:
    """State of an `IdentifiedCalibration` and the drive of its newest sample."""

    def __init__(self, model: IdentifiedCalibration, drive: FloatArray, state: FloatArray) -> None:
        self._steady, self._dynamics = model.steady, model.dynamics
        self._drive, self._state = drive, state

    @property
    def vector(self) -> FloatArray:
        return self._state.copy()

    @vector.setter
    def vector(self, values: FloatArray) -> None:
        self._state = values.copy()

    def correct(self, outputs: FloatArray) -> None:
        _, self._state = self._dynamics.run(self._state, self._drive, outputs[None])

    def advance(self, inputs: FloatArray, ss: FloatArray) -> FloatArray:
        drive = np.vstack([self._drive, self._dynamics.drive(self._steady, inputs, ss)])
        none = np.full((len(drive), ss.shape[1]), np.nan)
        outputs, self._state = self._dynamics.run(self._state, drive, none)
        self._drive = drive[-1:]
        return np.asarray(ss - outputs[1:])


def calibration_from_arrays(
    meta: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]], *, trust: bool = False
) -> Calibration:
    """Rebuild a calibration of any kind from its `to_arrays`."""
    found: Calibration
    if "dynamics" in meta:
        found = IdentifiedCalibration.from_arrays(meta, arrays, trust=trust)
    else:
        found = DynamicCalibration.from_arrays(meta, arrays, trust=trust)
    reach, interval = meta.get("reach"), meta.get("interval")
    if reach is not None:
        found = found.with_input_limits(reach["low"], reach["high"])
    if meta.get("delay") is not None:
        found = found.with_delay(TransportDelay.from_json(meta["delay"], found.input_names))
    if interval is not None:
        found = found.with_interval(HalfWidths.from_json(interval, len(found.output_names)))
    return found
