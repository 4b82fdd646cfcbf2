"""A static model: one output of an engine in steady flight from measured columns and parameters.

Thrust, fuel and black-box models are functions that return one `StaticModel`;
`training.steady.static_fit` estimates its parameters. All columns are those of `narxcal.channels`,
in their units, `(rows,)`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, is_dataclass, replace
from functools import wraps
from inspect import signature
from typing import Any, ClassVar, ParamSpec, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from narxcal.atmosphere import AirState, air_state
from narxcal.steady.model import (
    ALTERED,
    Arrays,
    BoxModel,
    Envelope,
    SteadyStateModel,
    register_steady,
    stored,
    stored_names,
)
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError, DataError, ModelError

P = ParamSpec("P")
Columns = Mapping[str, FloatArray]
GAS_R = 287.05287  # J/kg/K
CP = 3.5 * GAS_R  # J/kg/K, gamma = 1.4
K = 2.0 / 7.0  # (gamma - 1) / gamma
_MOST_ROWS = 5  # named in a message
_WHAT = "static law"
MODELS: dict[str, Callable[..., StaticModel]] = {}  # filled by the decorator `registered`


@dataclass(frozen=True)
class Parameter:
    """One parameter: unit, start value, bounds; a `fixed` one keeps its start value in a fit."""

    name: str
    start: float
    low: float
    high: float
    unit: str = "-"
    fixed: bool = False

    def __post_init__(self) -> None:
        if not self.low <= self.start <= self.high or self.low == self.high:
            raise ConfigError(
                f"parameter '{self.name}': expected low <= start <= high and low < high, found "
                f"{self.low:g}, {self.start:g}, {self.high:g}"
            )


@dataclass(frozen=True, kw_only=True, eq=False)
class StaticModel:
    """`equation(parameters (..., P), columns)` returns the output (..., rows), NaN where undefined.

    `design` (rows, P), where present, is the matrix of an equation linear in its parameters.
    `reconstruction` says what of the form is not in the paper; `undefined` why a row can be NaN;
    `recipe` is the JSON-able document from which `build` makes the model again.
    """

    name: str
    output: str
    inputs: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    equation: Callable[[FloatArray, Columns], FloatArray]
    design: Callable[[Columns], FloatArray] | None = None
    reconstruction: str = ""
    undefined: str = "a value is not finite"
    recipe: Mapping[str, Any] = field(default_factory=dict)

    @property
    def starts(self) -> FloatArray:
        return np.array([parameter.start for parameter in self.parameters])

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        low = np.array([parameter.low for parameter in self.parameters])
        return low, np.array([parameter.high for parameter in self.parameters])

    def predict(self, parameters: ArrayLike, columns: Columns) -> FloatArray:
        """Output (rows,) at `parameters` (P,); NaN only in rows with NaN in an input.

        Raises `DataError` for a missing column or columns of different length, `ModelError` naming
        the rows at which the equation has no value.
        """
        used = self.checked(columns)
        values = self.equation(np.asarray(parameters, dtype=np.float64), used)
        finite = np.isfinite(np.array([used[name] for name in self.inputs])).all(axis=0)
        bad = ~np.isfinite(values) & finite
        if bad.any():
            raise ModelError(f"{self.name}: {self.undefined} in {row_list(bad)}")
        return values

    def checked(self, columns: Columns) -> Columns:
        """Input columns as float arrays of one length, `dT_C` among them (zero if missing)."""
        missing = [name for name in self.inputs if name not in columns]
        if missing:
            raise DataError(
                f"the model '{self.name}' needs {', '.join(self.inputs)}; missing: "
                f"{', '.join(missing)}",
                hint="Add the channel to the logs or choose a model without it",
            )
        used = {name: np.asarray(columns[name], dtype=np.float64) for name in self.inputs}
        lengths = {name: array.size for name, array in used.items()}
        if any(array.ndim != 1 for array in used.values()) or len(set(lengths.values())) > 1:
            raise DataError(f"{self.name}: expected columns of one length, found {lengths}")
        size = next(iter(lengths.values()))
        return used | {"dT_C": np.asarray(columns.get("dT_C", np.zeros(size)), dtype=np.float64)}

    def with_start(self, name: str, value: float) -> StaticModel:
        """Same model, with another start value of one parameter."""
        changed = (replace(p, start=value) if p.name == name else p for p in self.parameters)
        return replace(self, parameters=tuple(changed))

    def renamed(self, name: str) -> StaticModel:
        return replace(self, name=name)


def registered(name: str) -> Callable[[Callable[P, StaticModel]], Callable[P, StaticModel]]:
    """Enter a function that returns a `StaticModel` in `MODELS`, and note its arguments.

    A model or a basis among the arguments is noted by its own document.
    """

    def entered(function: Callable[P, StaticModel]) -> Callable[P, StaticModel]:
        @wraps(function)
        def made(*args: P.args, **kwargs: P.kwargs) -> StaticModel:
            given = signature(function).bind(*args, **kwargs)
            given.apply_defaults()
            noted = {key: _noted(value) for key, value in given.arguments.items()}
            return replace(function(*args, **kwargs), recipe={"model": name} | noted)

        MODELS[name] = made
        return made

    return entered


def build(recipe: Mapping[str, Any]) -> StaticModel:
    """Make a model from its `recipe`; raises `ModelError` for a name that is unknown."""
    name = recipe.get("model")
    if name not in MODELS:
        raise ModelError(f"unknown static model '{name}'", hint=f"Known: {', '.join(MODELS)}")
    return MODELS[name](**{k: _made(v) for k, v in recipe.items() if k != "model"})


def _noted(value: Any) -> Any:
    if isinstance(value, StaticModel):
        return dict(value.recipe)
    if isinstance(value, tuple | list):
        return [_noted(part) for part in value]
    return asdict(value) if is_dataclass(value) and not isinstance(value, type) else value


def _made(value: Any) -> Any:
    return build(value) if isinstance(value, dict) and "model" in value else value


def component_level(engine: SteadyStateModel, output: str, inputs: Iterable[str]) -> StaticModel:
    """Component-level model (CLM): `scale` times the `output` of an engine model.

    `inputs` are the columns that drive it; its other inputs are zero.
    """
    names, at = tuple(inputs), engine.output_names.index(output)

    def equation(p: FloatArray, columns: Columns) -> FloatArray:
        given = [columns.get(name, np.zeros_like(columns[names[0]])) for name in engine.input_names]
        (scale,) = unpack(p)
        return np.asarray(scale * engine.outputs(np.column_stack(given))[:, at])

    scale = Parameter("scale", 1.0, 0.5, 2.0)
    return StaticModel(
        name="CLM", output=output, inputs=names, parameters=(scale,), equation=equation
    )


def unpack(parameters: FloatArray) -> FloatArray:
    """Parameters (..., P) as (P, ..., 1): each broadcasts against a column of rows."""
    return np.moveaxis(parameters, -1, 0)[..., np.newaxis]


def ambient(columns: Columns) -> AirState:
    return air_state(columns["ALT_ft"], columns["Mach"], columns["dT_C"])


def true_airspeed(columns: Columns, air: AirState) -> FloatArray:
    """True airspeed in m/s."""
    return np.asarray(columns["Mach"] * np.sqrt(1.4 * GAS_R * air.T_K))


def density(air: AirState) -> FloatArray:
    """Static density in kg/m^3."""
    return np.asarray(air.P_Pa / (GAS_R * air.T_K))


def row_list(rows: NDArray[np.bool_]) -> str:
    """Name the first true rows and count them: `rows 3, 7, 9 (3 of 240)`."""
    found = np.flatnonzero(rows)
    named = ", ".join(map(str, found[:_MOST_ROWS].tolist()))
    more = ", ..." if len(found) > _MOST_ROWS else ""
    return f"rows {named}{more} ({len(found)} of {len(rows)})"


Law = tuple[StaticModel, FloatArray]


@register_steady
class StaticLaws(BoxModel):
    """One fitted law (`StaticModel`) per output, within the box of its rows.

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
