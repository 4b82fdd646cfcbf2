"""What an output-error fit estimates: the model, the plan, and free numbers by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from narxcal.output_error.engine import Parameter
from narxcal.record import Record
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError


class Model(Protocol):
    """Outputs from inputs, for parameters by name.

    `simulate` gets inputs (time, m) and returns outputs (time, p) in the order of `output_names`,
    complex if a value is.
    """

    @property
    def parameters(self) -> Sequence[Parameter]: ...  # noqa: D102
    @property
    def output_names(self) -> Sequence[str]: ...  # noqa: D102
    def simulate(self, values: Mapping[str, complex], u: FloatArray) -> NDArray[Any]: ...  # noqa: D102


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Which parameters are estimated from where, and how.

    `free` names them (None: as the model says); `fixed` gives values and takes them out of `free`;
    `tied` maps a parameter to the one whose value it takes (None: as the model says); parameters in
    `per_record` have a value of their own in each record (initial states, offsets), all others are
    shared; `start` and `bounds` replace the model's. `sigma` maps outputs to known noise standard
    deviations; None estimates them.
    """

    free: Sequence[str] | None = None
    fixed: Mapping[str, float] = field(default_factory=dict)
    tied: Mapping[str, str] | None = None
    per_record: Sequence[str] = ()
    start: Mapping[str, float] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    sigma: Mapping[str, float] | None = None
    method: Literal["levenberg-marquardt", "quasi-newton"] = "levenberg-marquardt"
    iterations: int = 60


@dataclass(frozen=True)
class Coordinate:
    """One free number: a parameter, shared or of one record."""

    parameter: str
    record: int | None
    name: str
    start: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class Layout:
    """Free numbers in order, values of fixed parameters, and ties."""

    coordinates: tuple[Coordinate, ...]
    constants: Mapping[str, float]
    ties: Mapping[str, str]

    @property
    def names(self) -> tuple[str, ...]:
        """NAME, or NAME@RECORD where each record has its own."""
        return tuple(one.name for one in self.coordinates)

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper bounds (P,)."""
        low = np.array([one.low for one in self.coordinates])
        return low, np.array([one.high for one in self.coordinates])

    def values(self, theta: Sequence[complex], record: int) -> dict[str, complex]:
        """Every parameter by name in one record, for free numbers theta (P,)."""
        found: dict[str, complex] = dict(self.constants)
        for one, value in zip(self.coordinates, theta, strict=True):
            if one.record in (None, record):
                found[one.parameter] = value
        return found | {name: found[source] for name, source in self.ties.items()}


def layout_of(model: Model, records: Sequence[Record], plan: Plan) -> Layout:
    """Sort the parameters of the model into free, fixed and tied ones."""
    known = {one.name: one for one in model.parameters}
    ties = plan.tied
    if ties is None:
        ties = {one.name: one.tied_to for one in model.parameters if one.tied_to}
    named = [*(plan.free or ()), *plan.fixed, *plan.per_record, *plan.start, *plan.bounds, *ties,
             *ties.values()]  # fmt: skip
    for name in named:
        if name not in known:
            raise ConfigError(
                f"the model has no parameter {name!r}", hint=f"It has {', '.join(known)}"
            )
    free = [
        name
        for name, one in known.items()
        if (name in plan.free if plan.free is not None else one.free or name in plan.per_record)
        and name not in plan.fixed
        and name not in ties
    ]
    coordinates = []
    for name in free:
        low, high = plan.bounds.get(name, (known[name].low, known[name].high))
        start = plan.start.get(name, known[name].start)
        if not low <= start <= high:
            raise ConfigError(f"{name} starts at {start:g}, outside its bounds {low:g} to {high:g}")
        own = [*range(len(records))] if name in plan.per_record else [None]
        for k in own:
            label = name if k is None else f"{name}@{records[k].name}"
            coordinates.append(Coordinate(name, k, label, start, low, high, known[name].unit))
    if not coordinates:
        raise ConfigError("no parameter is free", hint="Name one in free, or take it out of fixed")
    rest = {
        name: plan.fixed.get(name, plan.start.get(name, one.start))
        for name, one in known.items()
        if name not in free and name not in ties
    }
    return Layout(tuple(coordinates), rest, ties)
