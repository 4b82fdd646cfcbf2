"""Static laws as a steady-state model: thrust, fuel flow or any output from measured columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from narxcal.static_models import StaticModel, build
from narxcal.steady.model import (
    ALTERED,
    Arrays,
    BoxModel,
    Envelope,
    register_steady,
    stored,
    stored_names,
)
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ModelError

_WHAT = "static law"
Law = tuple[StaticModel, FloatArray]


@register_steady
class StaticLaws(BoxModel):
    """One fitted law (`narxcal.static_models`) per output, within the box of its rows.

    `laws` are models with their parameters (P,). Inputs are moved to the box; a law that has no
    value there raises `ModelError` naming the rows.
    """

    kind: ClassVar[str] = "static"

    def __init__(self, input_names: Sequence[str], laws: Sequence[Law], box: Envelope) -> None:
        self.input_names = tuple(input_names)
        self.output_names = tuple(model.output for model, _ in laws)
        self.laws = tuple(laws)
        self.envelope = box

    def _evaluate(self, inputs: FloatArray) -> FloatArray:
        columns = dict(zip(self.input_names, inputs.T, strict=True))
        return np.column_stack([model.predict(values, columns) for model, values in self.laws])

    def to_arrays(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Names and recipes, and the arrays of parameters and box."""
        meta = {
            "input_names": list(self.input_names),
            "output_names": list(self.output_names),
            "recipes": [dict(model.recipe) for model, _ in self.laws],
        }
        values = {f"values_{k}": values for k, (_, values) in enumerate(self.laws)}
        return meta, {"low": self.envelope.low, "high": self.envelope.high, **values}

    @classmethod
    def from_arrays(cls, meta: Mapping[str, Any], arrays: Arrays) -> Self:
        """Inverse of `to_arrays`; raises `ModelError` where a part is missing or does not fit."""
        names, _ = stored_names(meta, _WHAT)
        laws = [
            (build(recipe), np.asarray(stored(arrays, f"values_{k}", _WHAT), dtype=np.float64))
            for k, recipe in enumerate(stored(meta, "recipes", _WHAT))
        ]
        for model, values in laws:
            if values.shape != (len(model.parameters),):
                raise ModelError(
                    f"'{model.name}' has {len(model.parameters)} parameters, found {values.shape}",
                    hint=ALTERED,
                )
        low, high = (stored(arrays, name, _WHAT) for name in ("low", "high"))
        return cls(names, laws, Envelope(low, high))
