"""Steady-state models: the interface, the envelope, and what the kinds share.

A steady-state model maps operating conditions to the outputs at which the engine settles. It comes
as a table, a fit to flights, a Python function or an FMU; all meet `SteadyStateModel`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Protocol, Self, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from narxcal.record import by_name
from narxcal.support.arrays import BoolArray, FloatArray
from narxcal.support.errors import ModelError
from narxcal.support.settings import Section

Model = TypeVar("Model", bound="StorableSteadyState")
Arrays = Mapping[str, NDArray[Any]]
Names = tuple[Sequence[str], Sequence[str]]  # input and output channels
Method = Literal["linear", "pchip"]
ALTERED = "The bundle was altered; train it again"


class SteadyOptions(Section):
    """What differs between the kinds of sources; all optional.

    `method` interpolates a table. `ranges` `{input: (low, high)}` is the envelope of a function or
    an FMU, `variables` `{channel: variable}` names the FMU's variables where they differ, and
    `settle_s` is the time an FMU is run at constant inputs before its outputs are read.
    """

    method: Method = "linear"
    ranges: dict[str, tuple[float, float]] = Field(default_factory=dict)
    variables: dict[str, str] = Field(default_factory=dict)
    settle_s: float = Field(default=1.0, gt=0.0)


@runtime_checkable
class SteadyStateModel(Protocol):
    """Maps operating conditions to steady-state outputs.

    Columns are canonical channels in canonical units. Outside the envelope a model evaluates the
    nearest conditions inside (so its outputs stay bounded) and `inside` is False; a sample with NaN
    in any input is outside and gives NaN.
    """

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the input columns."""

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names of the output columns."""

    def outputs(self, inputs: FloatArray) -> FloatArray:
        """Steady-state outputs `(..., n_out)` at `inputs` `(..., n_in)`."""

    def inside(self, inputs: FloatArray) -> BoolArray:
        """Whether each sample of `inputs` `(..., n_in)` lies in the envelope: `(...,)`."""


@runtime_checkable
class StorableSteadyState(SteadyStateModel, Protocol):
    """A steady-state model that a bundle can store as plain JSON and plain arrays."""

    kind: ClassVar[str]

    def to_arrays(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Everything needed to rebuild the model: what JSON can hold, and the arrays."""

    @classmethod
    def from_arrays(cls, meta: Mapping[str, Any], arrays: Arrays) -> Self:
        """Rebuild the model; raises `ModelError` when the parts do not fit."""


@runtime_checkable
class CarriesFiles(Protocol):
    """A steady-state model that needs a file next to the bundle, such as an FMU.

    A bundle copies each file, and `meta["file"]` names the copy when it is loaded.
    """

    def files(self) -> tuple[str, ...]:
        """Paths of the files to copy; those that no longer exist are left out."""


@runtime_checkable
class Executes(Protocol):
    """A kind of steady-state model whose opening runs code that the bundle does not contain."""

    @classmethod
    def executed(cls, meta: Mapping[str, Any]) -> str:
        """Name what opening the stored model would run: function or FMU, file and hash.

        Empty where only code of narxcal itself would run.
        """


@dataclass(frozen=True)
class Envelope:
    """The box `low <= inputs <= high`, `(n_in,)` each, in which a model is valid."""

    low: FloatArray
    high: FloatArray

    @classmethod
    def of(cls, points: FloatArray) -> Self:
        """Return the smallest box around `points` `(n, n_in)`."""
        return cls(points.min(axis=0), points.max(axis=0))

    @classmethod
    def from_ranges(
        cls, names: Sequence[str], ranges: Mapping[str, tuple[float, float]] | None
    ) -> Self:
        """Build the box from `{name: (low, high)}`; an input without a range is unbounded."""
        ranges = ranges or {}
        for name, (low, high) in ranges.items():
            if name not in names:
                raise ModelError(
                    f"the envelope names '{name}', which is no input of the model",
                    hint=f"Inputs are {', '.join(names)}",
                )
            if not low < high:
                raise ModelError(f"the envelope is empty: low {low:g}, high {high:g}", channel=name)
        pairs = [ranges.get(name, (-np.inf, np.inf)) for name in names]
        box = np.array(pairs, dtype=np.float64).reshape(-1, 2)
        return cls(box[:, 0], box[:, 1])

    def inside(self, inputs: FloatArray) -> BoolArray:
        """Whether each sample of `(..., n_in)` lies in the box; NaN does not."""
        return np.asarray(((inputs >= self.low) & (inputs <= self.high)).all(axis=-1))

    def clamp(self, inputs: FloatArray) -> FloatArray:
        """Move each input to the nearest value in the box; NaN stays NaN."""
        return np.clip(inputs, self.low, self.high)


def envelope_of(model: SteadyStateModel) -> Envelope:
    """The box that a model states; unbounded where it states none."""
    found = getattr(model, "envelope", None)
    return found if isinstance(found, Envelope) else Envelope.from_ranges(model.input_names, None)


class BoxModel(ABC):
    """Base of models that evaluate a function inside a box of inputs.

    A subclass sets the names and `envelope` and defines `_evaluate((n, n_in)) -> (n, n_out)` for
    finite inputs.
    """

    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    envelope: Envelope

    @abstractmethod
    def _evaluate(self, inputs: FloatArray) -> FloatArray:
        """Outputs `(..., n_out)` at inputs inside the envelope."""

    def outputs(self, inputs: ArrayLike) -> FloatArray:
        """Steady-state outputs `(..., n_out)` at `inputs` `(..., n_in)`, clamped to the envelope.

        NaN where an input is NaN.
        """
        clamped = self.envelope.clamp(checked_inputs(inputs, self.input_names))
        return at_known(self._evaluate, clamped, len(self.output_names))

    def inside(self, inputs: ArrayLike) -> BoolArray:
        """Whether each sample lies within the ranges: `(...,)`."""
        array = checked_inputs(inputs, self.input_names)
        return np.asarray(self.envelope.inside(array) & np.isfinite(array).all(axis=-1))


def checked_inputs(inputs: ArrayLike, names: Sequence[str]) -> FloatArray:
    """Turn `inputs` into floats; raise `ModelError` unless the last axis has one entry per name.

    Tables are taken by name, and raise `DataError` for one that is missing or unknown.
    """
    array = np.asarray(by_name(inputs, names), dtype=np.float64)
    found = array.shape[-1] if array.ndim else 0
    if found != len(names):
        raise ModelError(
            f"the steady-state model expects {len(names)} inputs ({', '.join(names)}), got {found}"
        )
    return array


def at_known(
    function: Callable[[FloatArray], FloatArray], inputs: FloatArray, count: int
) -> FloatArray:
    """`function((n, n_in)) -> (n, count)` at `inputs` `(..., n_in)`, NaN where not finite."""
    flat = inputs.reshape(-1, inputs.shape[-1])
    known = np.isfinite(flat).all(axis=1)
    result = np.full((len(flat), count), np.nan)
    if known.any():
        result[known] = function(flat[known])
    return result.reshape(*inputs.shape[:-1], count)


REGISTRY: dict[str, type[StorableSteadyState]] = {}  # what `register_steady` has made loadable


def register_steady(model: type[Model]) -> type[Model]:
    """Class decorator: make `model.kind` loadable by `narxcal.steady.opening`."""
    REGISTRY[model.kind] = model
    return model


def stored(values: Mapping[str, Any], name: str, what: str) -> Any:
    """`values[name]` of a stored model; raises `ModelError` where it is missing."""
    if name not in values:
        raise ModelError(f"the stored {what} has no '{name}'", hint=ALTERED)
    return values[name]


def stored_names(meta: Mapping[str, Any], what: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Input and output names of a stored model; raises `ModelError` for anything but texts."""
    inputs, outputs = stored(meta, "input_names", what), stored(meta, "output_names", what)
    for names in (inputs, outputs):
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise ModelError(f"the names of the stored {what} are no list of texts", hint=ALTERED)
    return tuple(inputs), tuple(outputs)
