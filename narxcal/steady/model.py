"""What a steady-state model is, how its envelope works, and how any of them is stored.

A model is read-only: it says where the engine settles, never how it gets there. Tables,
callables, FMUs and models fitted from flights all meet the same `Protocol`.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, Self, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from narxcal.support.errors import ModelError

Model = TypeVar("Model", bound="StorableSteadyState")
Floats = NDArray[np.float64]
Arrays = Mapping[str, NDArray[Any]]


@runtime_checkable
class SteadyStateModel(Protocol):
    """Maps operating conditions to where the outputs settle.

    Columns are canonical channels in canonical units. Outside the envelope a model evaluates
    the nearest conditions it knows (so its outputs stay bounded) and `inside` says so; a
    sample with NaN in any input is outside and gives NaN.
    """

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the input columns."""

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names of the output columns."""

    def outputs(self, inputs: Floats) -> Floats:
        """Settled outputs `(..., n_out)` at `inputs` `(..., n_in)`."""

    def inside(self, inputs: Floats) -> NDArray[np.bool_]:
        """Whether each sample of `inputs` `(..., n_in)` lies in the envelope: `(...,)`."""


@runtime_checkable
class StorableSteadyState(SteadyStateModel, Protocol):
    """A steady-state model that a bundle can carry: plain JSON and plain arrays."""

    kind: ClassVar[str]

    def to_arrays(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Everything needed to rebuild the model: what JSON can hold, and the arrays."""

    @classmethod
    def from_arrays(cls, meta: Mapping[str, Any], arrays: Arrays) -> Self:
        """Rebuild the model; raises `ModelError` when the parts do not fit."""


@runtime_checkable
class CarriesFiles(Protocol):
    """A steady-state model that needs a file beside the bundle, such as an FMU.

    A bundle copies each file, and points `meta["file"]` at the copy when it is loaded.
    """

    def files(self) -> tuple[str, ...]:
        """Paths of the files to copy; those that no longer exist are left out."""


@dataclass(frozen=True)
class Envelope:
    """The box `low <= inputs <= high`, `(n_in,)` each, in which a model was made."""

    low: Floats
    high: Floats

    @classmethod
    def of(cls, points: Floats) -> Self:
        """Return the smallest box around `points` `(n, n_in)`."""
        return cls(points.min(axis=0), points.max(axis=0))

    @classmethod
    def from_ranges(
        cls, names: Sequence[str], ranges: Mapping[str, tuple[float, float]] | None
    ) -> Self:
        """Build the box from `{name: (low, high)}`; an input without a range is unbounded.

        Raises `ModelError` for a range that is empty or names no input.
        """
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

    def inside(self, inputs: Floats) -> NDArray[np.bool_]:
        """Whether each sample of `(..., n_in)` lies in the box; NaN does not."""
        return np.asarray(((inputs >= self.low) & (inputs <= self.high)).all(axis=-1))

    def clamp(self, inputs: Floats) -> Floats:
        """Move each input to the nearest value in the box; NaN stays NaN."""
        return np.clip(inputs, self.low, self.high)


def checked_inputs(inputs: ArrayLike, names: Sequence[str]) -> Floats:
    """Turn `inputs` into floats; raise `ModelError` unless the last axis has one entry per name."""
    array = np.asarray(inputs, dtype=np.float64)
    found = array.shape[-1] if array.ndim else 0
    if found != len(names):
        raise ModelError(
            f"the steady-state model expects {len(names)} inputs ({', '.join(names)}), got {found}"
        )
    return array


def at_known(function: Callable[[Floats], Floats], inputs: Floats, count: int) -> Floats:
    """`function((n, n_in)) -> (n, count)` at `inputs` `(..., n_in)`, NaN where not finite."""
    flat = inputs.reshape(-1, inputs.shape[-1])
    known = np.isfinite(flat).all(axis=1)
    result = np.full((len(flat), count), np.nan)
    if known.any():
        result[known] = function(flat[known])
    return result.reshape(*inputs.shape[:-1], count)


# Importing the module registers its class, so that a bundle opens without the caller
# knowing which kind of model is in it.
_HOMES = {
    "table": "narxcal.steady.table",
    "callable": "narxcal.steady.function",
    "fmu": "narxcal.steady.fmu",
    "fitted": "narxcal.steady.fitted",
}
_REGISTRY: dict[str, type[StorableSteadyState]] = {}


def register_steady(model: type[Model]) -> type[Model]:
    """Class decorator: make `model.kind` loadable by `steady_from_json`."""
    _REGISTRY[model.kind] = model
    return model


def steady_to_json(
    model: SteadyStateModel,
) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Split a model into a JSON-able dict with its `kind` and a dict of arrays.

    Raises `ModelError` if the model cannot be stored.
    """
    if not isinstance(model, StorableSteadyState):
        raise ModelError(
            f"steady-state model {type(model).__name__} cannot be stored in a bundle",
            hint="Give it kind, to_arrays and from_arrays, or load it as module:function",
        )
    meta, arrays = model.to_arrays()
    return {"kind": model.kind, **meta}, arrays


def steady_from_json(meta: Mapping[str, Any], arrays: Arrays) -> SteadyStateModel:
    """Rebuild what `steady_to_json` split; raises `ModelError` for an unknown kind."""
    kind = str(meta.get("kind"))
    if kind not in _REGISTRY and kind in _HOMES:
        importlib.import_module(_HOMES[kind])
    if kind not in _REGISTRY:
        known = ", ".join(sorted({*_REGISTRY, *_HOMES}))
        raise ModelError(
            f"unknown kind of steady-state model '{kind}'", hint=f"Known kinds: {known}"
        )
    return _REGISTRY[kind].from_arrays(meta, arrays)


def stored(values: Mapping[str, Any], name: str, what: str) -> Any:
    """`values[name]` of a stored model; raises `ModelError` where it is missing."""
    if name not in values:
        raise ModelError(
            f"the stored {what} has no '{name}'", hint="The bundle was altered; train it again"
        )
    return values[name]
