"""The parts of a stored model as the C runtime takes them: a function and its table of numbers.

Each stored form describes itself by a `Part`: the name of the functions `NAME_start` and
`NAME_step` in `narxcal/export/c/NAME.c`, the numbers in its structure, and the size of its state.
The deviation of a model is the weighted sum of those of its parts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from narxcal.atmosphere import SIMILARITY, air_columns, similarity
from narxcal.calibration.calibration import Calibration
from narxcal.calibration.dynamic import DynamicCalibration
from narxcal.calibration.identified import (
    EngineDynamics,
    IdentifiedCalibration,
    NoDynamics,
    ResponseDynamics,
    StateSpaceDynamics,
)
from narxcal.calibration.members import Member
from narxcal.export.grid import Block, GriddedModel
from narxcal.lumped import governed
from narxcal.lumped.engine import LumpedEngine
from narxcal.lumped.limited import LIMITED
from narxcal.lumped.states import CASING, ROWS
from narxcal.output_error.engine import EngineFromSteady
from narxcal.steady.fitted import RATIOS, FittedSteadyState
from narxcal.steady.model import Envelope, SteadyStateModel
from narxcal.steady.table import SteadyTable
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ModelError

LAG_ROWS = ROWS + 2  # of lags.c: those of `lumped.states`, and two rows of the newest sample


@dataclass(frozen=True, eq=False)
class Struct:
    """Numbers of a C structure `kind` by field, and what has to stand before it.

    A value is a number, an array (NULL where it is empty), a structure, a list of structures, or
    the name of a function. `needs` are files of the runtime, `define` lines before them.
    """

    kind: str
    numbers: Mapping[str, Any]
    needs: tuple[str, ...] = ()
    define: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Part:
    """A part of the dynamics with `states` numbers in its state, weighted (n_out,) in the sum."""

    struct: Struct
    states: int
    weights: FloatArray


def steady_struct(steady: SteadyStateModel) -> tuple[Struct, tuple[str, ...]]:
    """A steady-state model, and the engines that it tells apart; the first is the one chosen."""
    if isinstance(steady, FittedSteadyState):
        # A model of one engine was wanted as such; else all are in the file.
        chosen = steady.engine in steady.engines
        return _fitted(steady), (steady.engine, *(() if chosen else steady.engines))
    if isinstance(steady, GriddedModel):
        known = steady.known
        masks = [None if known.all() else known, *[None] * len(steady.blocks)]
        grids = [_grid(block, mask) for block, mask in zip(steady.blocks, masks, strict=False)]
        return _table(steady.envelope, grids), ("",)
    if isinstance(steady, SteadyTable) and steady.interpolated is not None:
        columns = tuple(range(len(steady.input_names)))
        grids = [_grid(Block(columns, *steady.interpolated))]
        return _table(Envelope.of(steady.points), grids), ("",)
    raise ModelError(
        f"a steady state of kind '{getattr(steady, 'kind', type(steady).__name__)}' is no grid",
        hint="Sample it first: narxcal export does so",
    )


def is_exact(steady: SteadyStateModel) -> bool:
    """Whether the runtime computes a steady-state model as it is, without sampling it."""
    if isinstance(steady, SteadyTable):
        return steady.interpolated is not None
    return isinstance(steady, FittedSteadyState | GriddedModel)


def _table(envelope: Envelope, grids: list[Struct]) -> Struct:
    numbers = {"low": envelope.low, "high": envelope.high, "count": len(grids), "grids": grids}
    return Struct("table", numbers, ("grid", "table"))


def _grid(block: Block, known: NDArray[np.bool_] | None = None) -> Struct:
    numbers = {
        "dims": len(block.axes),
        "width": block.values.shape[-1],
        "columns": np.array(block.columns, dtype=np.int64),
        "lengths": np.array([len(axis) for axis in block.axes], dtype=np.int64),
        "nodes": np.concatenate([*block.axes, np.empty(0)]),
        "values": block.values,
        "known": np.empty(0) if known is None else known,
    }
    return Struct("grid", numbers, ("grid",))


def _kind(name: str, *, corrected: bool) -> int:
    """What the channel is corrected by, as `corrected_scale` of fitted.c numbers it."""
    return SIMILARITY.index(similarity(name)) if corrected else 0


def _fitted(model: FittedSteadyState) -> Struct:
    layout, names = model.layout, model.input_names
    taylor = model._splines.c[::-1]  # noqa: SLF001 (value, slope, curvature; piece; spline)
    chosen = model.engine in model.engines
    engines = [model.engine] if chosen else [model.engine, *model.engines]
    curves = np.stack([model.curve_of(engine) for engine in engines])
    pieces = np.einsum("tps,eovs->epovt", taylor, curves[..., 1:])
    pieces[..., 0] += curves[:, None, ..., 0]
    fuel = _kind(layout.driver, corrected=layout.corrected)
    numbers = {
        "air": air_columns(names),
        "kinds": np.array([_kind(o, corrected=layout.corrected) for o in model.output_names]),
        "driver": names.index(layout.driver),
        "fuel": fuel if layout.driver == "FF_kgph" else -1,
        "low": model.envelope.low,
        "high": model.envelope.high,
        "seen": model.seen,
        "knots": len(model.knots),
        "knot": model.knots,
        "curve": pieces,
        "blends": len(layout.blend),
        "switches": len(layout.switches),
        "ratios": len(layout.exponents),
        "blend": np.array([names.index(name) for name in layout.blend], dtype=np.int64),
        "switch_column": np.array([names.index(n) for n in layout.switches], dtype=np.int64),
        "switch_line": model.switch_lines,
        "ratio": np.array([RATIOS.index(name) for name in layout.exponents], dtype=np.int64),
        "ratio_seen": model.air_seen,
        "ratio_line": model.air_lines,
    }
    corners = {"FITTED_CORNERS": f"#define FITTED_CORNERS {2 ** len(layout.blend)}"}
    return Struct("fitted", numbers, ("air", "fitted"), corners)


def parts_of(model: Calibration) -> list[Part]:
    """Return the parts of a calibration's dynamics; `ModelError` names one that C lacks."""
    alone = np.ones(len(model.output_names))
    members = model.members.members
    for one in members:
        alone[one.channel] -= one.weight
    if isinstance(model, DynamicCalibration):
        own = [_narx(model, alone)]
    elif isinstance(model, IdentifiedCalibration):
        own = _identified(model, alone)
    else:
        raise ModelError(f"a model of type {type(model).__name__} cannot be exported")
    return [*own, *(_member(one, len(alone)) for one in members if one.kind != "steady_state")]


def _narx(model: DynamicCalibration, weights: FloatArray) -> Part:
    narx, config, net = model.narx, model.narx.config, model.narx.weights
    outputs, depth, width = len(weights), config.taps[-1], narx.inputs
    numbers = {
        "hidden": config.hidden,
        "lags": config.lags,
        "taps": len(config.taps),
        "depth": depth,
        "width": width,
        "moving": config.moving,
        "schedules": len(model.schedule),
        "tap": np.array(config.taps),
        "schedule": np.array([model.input_names.index(n) for n in model.schedule], dtype=np.int64),
        "in_centre": narx.input_scaling.centre,
        "in_scale": narx.input_scaling.scale,
        "out_centre": narx.output_scaling.centre,
        "out_scale": narx.output_scaling.scale,
        **{name: getattr(net, name) for name in ("w1", "b1", "w2", "b2", "a", "low", "high")},
        "keep": -1.0 if model.settle_s is None else math.exp(-model.dt_s / model.settle_s),
        "share": np.ones(outputs) if model.network_share is None else model.network_share,
    }
    states = outputs * (3 + config.lags) + (depth + 1) * width
    needs: tuple[str, ...] = ("narx",)
    define: Mapping[str, str] = {}
    if model.lag is not None:
        lags = _lags(model.lag, model)
        numbers |= {"lag_start": "lags_start", "lag_step": f"{lags.needs[-1]}_step", "lag": lags}
        states += LAG_ROWS * outputs
        needs, define = (*lags.needs, "narx"), lags.define
    return Part(Struct("narx", numbers, needs, define), states, weights)


def _lags(lag: LumpedEngine, model: DynamicCalibration) -> Struct:
    engine, slow = lag.compiled(), lag.start(np.ones(len(lag.output_names)))[CASING]
    numbers = {
        "air": air_columns(model.input_names),
        **{name: getattr(lag, name) for name in ("theta", "centre", "half", "limit", "order")},
        "own": engine.own,
        "rank": engine.rank,
        "slow": slow.astype(np.int64),
        "dt_s": model.dt_s,
    }
    define = _governed(len(slow)) if lag.governed else {"LIMITED": _enum("LIMITED", LIMITED)}
    form = "governed" if lag.governed else "limited"
    return Struct("lags", numbers, ("air", "lags", form), define)


def _enum(head: str, names: tuple[str, ...]) -> str:
    return f"enum {{ {', '.join(f'{head}_{name}' for name in (*names, 'SIZE'))} }};"


def _governed(count: int) -> dict[str, str]:
    """Places in theta of a governed engine of `count` outputs."""
    slopes, heat, extra = governed.places(count)
    places = {
        "REGRESSORS": len(governed.REGRESSORS),
        "REGRESSOR_Mach": governed.REGRESSORS.index("Mach"),
        "SLOPES": slopes,
        "SLOPE_TERMS": len(governed.SLOPES),
        "HEATS": heat,
        "HEAT_TERMS": len(governed.HEAT),
        "EXTRA": extra,
    }
    listed = ", ".join(f"{name} = {value}" for name, value in places.items())
    return {"LINES": _enum("LINE", governed.LINES), "PLACES": f"enum {{ {listed} }};"}


def _member(one: Member, outputs: int) -> Part:
    order = len(one.poles)
    numbers = {
        "channel": one.channel,
        "order": 0 if one.kind == "first_order" else order,
        "push": one.push,
        "pull": one.pull,
        "poles": np.array(one.poles),
        "gains": np.array(one.gains),
        "offset": one.offset,
    }
    weights = np.zeros(outputs)
    weights[one.channel] = one.weight
    return Part(Struct("member", numbers, ("member",)), max(order, 1) * (1 + outputs), weights)


def _identified(model: IdentifiedCalibration, weights: FloatArray) -> list[Part]:
    dynamics = model.dynamics
    if isinstance(dynamics, NoDynamics):
        return []
    if isinstance(dynamics, StateSpaceDynamics):
        return [_state_space(dynamics, weights)]
    if isinstance(dynamics, ResponseDynamics):
        return [_response(dynamics, model, weights)]
    if not isinstance(dynamics, EngineDynamics):
        raise ModelError(f"dynamics of kind '{dynamics.kind}' cannot be exported")
    values = dynamics.values
    if values["square_M"]:
        raise ModelError(
            "output error with square_M (it looks ahead) cannot be exported",
            hint="Identify it without, or by another method",
        )
    low, high = dynamics.span
    numbers = {
        "driver": model.input_names.index(dynamics.driver),
        "low": low,
        "high": high,
        "order": np.array(dynamics.order),
        **{name: values[name] / model.dt_s for name in ("tau_H", "tau_L", "tau_T", "tau_M")},
        **{name: values[name] for name in ("rate_H", "rate_L", "alpha", "beta")},
        "reference": EngineFromSteady(model.dt_s).reference,
    }
    return [Part(Struct("output_error", numbers, ("lag_step", "output_error")), 8, weights)]


def _state_space(dynamics: StateSpaceDynamics, weights: FloatArray) -> Part:
    own = dynamics.model
    numbers = {"order": own.order, "A": own.A, "B": own.B, "C": own.C}
    numbers["fade"] = float(np.abs(own.poles[0])) if own.order else 0.0
    most = {"STATE_SPACE_ORDER": f"#define STATE_SPACE_ORDER {max(own.order, 1)}"}
    struct = Struct("state_space", numbers, ("state_space",), most)
    return Part(struct, own.order + 2 * len(weights), weights)


def _response(dynamics: ResponseDynamics, model: Calibration, weights: FloatArray) -> Part:
    named = [name for name in dynamics.conditions if name != "level"]
    grids = [
        _grid(Block(tuple(range(len(one.axes))), tuple(map(np.array, one.axes)), one.values))
        for one in dynamics.schedules
    ]
    numbers = {
        "level": int("level" in dynamics.conditions),
        "conditions": len(named),
        "columns": np.array([model.input_names.index(name) for name in named], dtype=np.int64),
        "schedules": grids,
        "dt_s": dynamics.dt_s,
    }
    return Part(
        Struct("response", numbers, ("grid", "lag_step", "response")), 5 * len(weights), weights
    )
