"""Identify the dynamics behind a steady state by the methods of the two older papers.

Logs have complete inputs. Each function raises `DataError` for logs that lack a channel or do not
determine the model.

| method | fitted to | by |
|---|---|---|
| output-error | whole logs, an offset per log and output | `training.papers.output_error.fit` |
| transfer | whole logs, steady state trimmed where in equilibrium | the same, per output |
| subspace | uninterrupted parts of the same | `training.papers.subspace.subspace` |
| static:NAME | quasi-steady samples | `training.steady.static_fit.fit` |
"""

from __future__ import annotations

import inspect
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from data_prep.equilibrium import quasi_steady
from data_prep.log import Log
from narxcal import static_models
from narxcal.calibration.calibration import steady_for_engine
from narxcal.calibration.identified import (
    Dynamics,
    EngineDynamics,
    NoDynamics,
    ResponseDynamics,
    StateSpaceDynamics,
)
from narxcal.channels import spools_of
from narxcal.output_error.engine import STEADY_OUTPUTS, EngineFromSteady, steady_drive
from narxcal.record import Record
from narxcal.static_models.model import MODELS, Columns, StaticLaws, StaticModel
from narxcal.steady.model import Envelope, SteadyStateModel
from narxcal.support.arrays import FloatArray, IntArray, spans
from narxcal.support.errors import ConfigError, DataError
from narxcal.transfer import ResponseFromSteady, Schedule, node_weights
from training.config import STATIC, RunConfig
from training.papers.output_error import Plan, fit
from training.papers.output_error_result import OutputErrorFit
from training.papers.subspace import SubspaceSettings, subspace
from training.records import LagSamples, lag_samples
from training.steady.static_fit import fit as fit_law

OFFSETS = ("N_HO", "N_LO", "T_O")
_ENOUGH = 1.05  # the simpler response is kept up to this ratio of errors, as in `subspace`
_TALL_FT = 5000.0  # altitude range from which on parameters are scheduled over altitude
_LEAST_MOTION = 0.02  # share of all motion below which a node of a schedule is a hole
_APART = 1e-3  # singular value over the largest from which on outputs count as moving apart
_ENDS = (10.0, 90.0)  # percentiles of the motion at which a schedule has its nodes
_LAW_ROWS = 20000  # more quasi-steady samples than this tell nothing new
_COMPOSED = ("tensor", "corrected", "drag")  # made of other models or of fitted axes


@dataclass(frozen=True)
class Identified:
    """A dynamic model, and what identify.json says of it."""

    dynamics: Dynamics
    parameters: Mapping[str, Any]
    status: str
    advice: str
    warnings: tuple[str, ...] = ()

    def document(self) -> dict[str, Any]:
        """JSON-able, without the dynamic model."""
        names = ("parameters", "status", "advice", "warnings")
        return {name: getattr(self, name) for name in names}


def steady_record(log: Log, steady: SteadyStateModel, driver: str) -> Record:
    """Record of a log for `EngineFromSteady`; raises `DataError` as `steady_drive` does."""
    moved = log[driver]
    span = float(moved.min()), float(moved.max())
    try:
        drive = steady_drive(steady, log.matrix(steady.input_names), driver, span)
    except DataError as error:
        raise DataError(
            error.problem, file=log.name, channel=error.channel, hint=error.hint
        ) from None
    return Record(drive, log.measured(STEADY_OUTPUTS), log.name)


def output_error(config: RunConfig, steady: SteadyStateModel, logs: Sequence[Log]) -> Identified:
    """Fit an engine of first-order spools to whole logs, with offsets of each."""
    driver = config.driver
    records = [
        steady_record(log, steady_for_engine(steady, log.source.engine), driver)
        for log in _numbered(logs)
    ]
    model = EngineFromSteady(logs[0].dt_s)
    shared = [one.name for one in model.parameters if one.free and one.name not in OFFSETS]
    free = (*shared, "tau_M")
    found = fit(model, records, Plan(free=(*free, *OFFSETS), per_record=OFFSETS, iterations=100))
    values = {**found.parameters(), **dict.fromkeys(OFFSETS, 0.0)}
    moved = np.concatenate([log[driver] for log in logs])
    order = tuple(steady.output_names.index(name) for name in STEADY_OUTPUTS)
    span = float(moved.min()), float(moved.max())
    dynamics = EngineDynamics(values, free, driver, span, order, logs[0].dt_s)
    return _of_fits(dynamics, {"": found})


def _numbered(logs: Sequence[Log]) -> list[Log]:
    """Name the parts of one log NAME, NAME.2 and so on: a fit tells records by their names."""
    seen: Counter[str] = Counter()
    named = []
    for log in logs:
        seen[log.name] += 1
        number = seen[log.name]
        named.append(replace(log, name=f"{log.name}.{number}") if number > 1 else log)
    return named


def _of_fits(
    dynamics: Dynamics, fits: Mapping[str, OutputErrorFit], warnings: Sequence[str] = ()
) -> Identified:
    """Join the documents of fits; status and advice are of the worst, named by its output."""
    rows = {name: one.document() for name, one in fits.items()}
    parameters = {key: row for part in rows.values() for key, row in part["parameters"].items()}
    bad = [(name, row) for name, row in rows.items() if row["status"] != "converged"]
    status = "; ".join(f"{name}: {row['status']}".lstrip(": ") for name, row in bad)
    advice = "; ".join(f"{name}: {row['advice']}".lstrip(": ") for name, row in bad)
    said = [text for row in rows.values() for text in (*row["warnings"], *row["unidentifiable"])]
    return Identified(
        dynamics, parameters, status or "converged", advice or "none", (*warnings, *said)
    )


@dataclass(frozen=True, eq=False)
class _Part:
    """Trimmed samples of one log, and its steady state (time, n_out) as the model has it."""

    trimmed: LagSamples
    ss: FloatArray


def _parts(config: RunConfig, steady: SteadyStateModel, logs: Sequence[Log]) -> list[_Part]:
    """Samples of logs; raises `DataError` where no steady state moves."""
    parts = []
    for log in logs:
        own = steady_for_engine(steady, log.source.engine)
        parts.append(
            _Part(lag_samples(log, steady, config), own.outputs(log.matrix(own.input_names)))
        )
    if not any(np.ptp(part.ss, axis=0).any() for part in parts):
        raise DataError(
            "the steady state never moves in the training logs: no response can be identified",
            file=logs[0].name,
            hint="Choose logs with transients",
        )
    return parts


def transfer(config: RunConfig, steady: SteadyStateModel, logs: Sequence[Log]) -> Identified:
    """Fit the response of each output to its steady state, scheduled over level and altitude."""
    parts, dt_s = _parts(config, steady, logs), logs[0].dt_s
    names = steady.input_names
    conditions, axes, warnings = _mesh(config, steady, parts)
    fits, schedules = {}, []
    for k, output in enumerate(steady.output_names):
        grid = tuple(axes[name] if name != "level" else axes[f"level {k}"] for name in conditions)
        nodes = [_node(conditions, at) for at in product(*grid)]
        records = []
        for part, log in zip((one.trimmed for one in parts), _numbered(logs), strict=True):
            named = [part.inputs[:, names.index(name)] for name in conditions if name != "level"]
            level = [part.ss[:, k]] if "level" in conditions else []
            at = np.column_stack([np.empty((len(part.ss), 0)), *level, *named])
            u = np.column_stack([part.ss[:, k], node_weights(grid, at)])
            records.append(Record(u, part.measured[:, [k]], log.name))
        model, found = _response(config, output, (nodes, dt_s), records)
        logarithms = model.logs(found.parameters()).real
        shape = (*map(len, grid), logarithms.shape[1])
        schedules.append(Schedule(grid, logarithms.reshape(shape)))
        fits[output] = found
    return _of_fits(ResponseDynamics(conditions, tuple(schedules), dt_s), fits, warnings)


def _response(
    config: RunConfig, output: str, grid: tuple[Sequence[str], float], records: Sequence[Record]
) -> tuple[ResponseFromSteady, OutputErrorFit]:
    """Fit the first order, then the second from there; the simpler one that does nearly as well."""
    nodes, dt_s = grid
    wanted = config.identify.response
    first = ResponseFromSteady(output, "first", nodes, dt_s)
    found = fit(first, records, Plan(iterations=100))
    if wanted == "first":
        return first, found
    taus = np.exp(first.logs(found.parameters()).real)
    start_s = float(np.clip(np.median(taus), 2.0 * dt_s, 60.0))
    second = ResponseFromSteady(output, "second", nodes, dt_s, start_s)
    better = fit(second, records, Plan(iterations=100))
    if wanted == "second" or found.sigma[output] > _ENOUGH * better.sigma[output]:
        return second, better
    return first, found


def _mesh(
    config: RunConfig, steady: SteadyStateModel, parts: Sequence[_Part]
) -> tuple[tuple[str, ...], dict[str, tuple[float, ...]], list[str]]:
    """Conditions that parameters are scheduled over, their nodes, and warnings.

    Nodes lie at percentiles of the motion of the steady state. A node with little motion is a hole:
    an error where the configuration names the nodes, else the altitude is left out with a warning.
    """
    section, count = config.identify, len(steady.output_names)
    inputs = np.concatenate([part.trimmed.inputs for part in parts])
    ss = np.concatenate([part.ss for part in parts])
    motion = np.concatenate(
        [np.abs(np.diff(part.ss, axis=0, prepend=part.ss[:1])) for part in parts]
    )
    axes = {f"level {k}": section.levels or _nodes(ss[:, k], motion[:, k]) for k in range(count)}
    if "ALT_ft" not in steady.input_names:
        return ("level",), axes, []
    altitude = inputs[:, steady.input_names.index("ALT_ft")]
    axes["ALT_ft"] = section.altitudes_ft or _nodes(altitude, motion.sum(axis=1))
    if not section.altitudes_ft and np.ptp(axes["ALT_ft"]) < _TALL_FT:
        return ("level",), axes, []
    holes = _holes((ss, altitude, motion), axes)
    if not holes:
        return ("level", "ALT_ft"), axes, []
    text = f"the mesh of level x altitude has holes: hardly any motion near {'; '.join(holes[:3])}"
    if section.altitudes_ft:
        raise DataError(text, hint="Leave an altitude out of [identify] altitudes_ft, or add logs")
    return ("level",), axes, [f"{text}; parameters are not scheduled over altitude"]


def _nodes(values: FloatArray, motion: FloatArray) -> tuple[float, ...]:
    """Two percentiles of values (time,) by motion (time,); one value where they agree."""
    order = np.argsort(values)
    total = np.cumsum(motion[order])
    if not total[-1] > 0.0:
        return (float(values[0]),)
    at = np.searchsorted(total, np.array(_ENDS) / 100.0 * total[-1])
    low, high = np.round(values[order][at], 6).tolist()
    return (low, high) if high > low else (low,)


def _holes(
    found: tuple[FloatArray, FloatArray, FloatArray], axes: Mapping[str, tuple[float, ...]]
) -> list[str]:
    """Nodes nearest to which less than a fiftieth of the motion is."""
    ss, altitude, motion = found
    holes = []
    for k in range(ss.shape[1]):
        grid = (axes[f"level {k}"], axes["ALT_ft"])
        near = [_nearest(nodes, at) for nodes, at in zip(grid, (ss[:, k], altitude), strict=True)]
        for i, node in enumerate(product(*grid)):
            here = near[0] * len(grid[1]) + near[1] == i
            if motion[here, k].sum() < _LEAST_MOTION * motion[:, k].sum():
                holes.append(_node(("level", "ALT_ft"), node))
    return list(dict.fromkeys(holes))


def _nearest(nodes: Sequence[float], values: FloatArray) -> IntArray:
    middles = 0.5 * (np.array(nodes[1:]) + np.array(nodes[:-1]))
    return np.searchsorted(middles, values)


def _node(conditions: Sequence[str], at: Sequence[float]) -> str:
    return ",".join(f"{name}={value:.4g}" for name, value in zip(conditions, at, strict=True))


def subspace_model(config: RunConfig, steady: SteadyStateModel, logs: Sequence[Log]) -> Identified:
    """Fit a linear state space from increments of the steady state to the deviation from it."""
    section, records = config.identify, []
    parts = _parts(config, steady, logs)
    ways = _ways(np.concatenate([np.diff(part.ss, axis=0) for part in parts]))
    for part in parts:
        deviation = (part.trimmed.ss - part.trimmed.measured)[:-1]
        moved = np.diff(part.ss, axis=0) @ ways
        for start, stop in spans(np.asarray(np.isfinite(deviation).all(axis=1))):
            if stop - start >= 4 * section.block_rows:
                records.append((moved[start:stop], deviation[start:stop]))
    if not records:
        raise DataError(
            f"no part of a training log has all outputs for {4 * section.block_rows} samples",
            hint="Lower [identify] block_rows, or take an output out of [narx] outputs",
        )
    settings = SubspaceSettings(dt_s=logs[0].dt_s, polish=False, most=6)
    found = subspace(records, section.order or None, section.block_rows, settings)
    model = replace(
        found.model, B=found.model.B @ ways.T, D=np.zeros((len(found.model.C), len(ways)))
    )
    taus = model.time_constants_s.tolist()
    parameters = {
        f"tau_{k}": _row(value, "s") for k, value in enumerate(taus, 1) if np.isfinite(value)
    }
    advice = "; ".join(found.advice) or "none"
    return Identified(StateSpaceDynamics(model), parameters, found.status, advice)


def _ways(moved: FloatArray) -> FloatArray:
    """Directions (n_out, k) in which increments of the steady state (time, n_out) move apart.

    Outputs that move together, as straight lines over one driver do, are one input: two would make
    the Hankel matrix of the inputs rank-deficient whatever was flown.
    """
    size = np.sqrt(np.mean(moved**2, axis=0))
    size = np.where(size > 0.0, size, 1.0)
    _, singular, rows = np.linalg.svd(moved / size, full_matrices=False)
    return np.asarray((rows[singular > _APART * singular[0]] / size).T)


def _row(value: float, unit: str, **known: Any) -> dict[str, Any]:
    """One parameter of identify.json; null for what the method does not give."""
    blank = dict.fromkeys(("sd", "sd_coloured", "low", "high"))
    return {"value": value, "unit": unit, **blank, **known}


def static_laws(config: RunConfig, logs: Sequence[Log]) -> tuple[RunConfig, StaticLaws, Identified]:
    """Fit the static law that [identify] method names to quasi-steady samples of `logs`.

    Returns the configuration with the law's inputs and outputs, the laws, and the document. Raises
    `ConfigError` for an unknown law or a missing argument, `DataError` for a missing channel.
    """
    name = config.identify.method.removeprefix(STATIC)
    columns = _steady_columns(config, logs)
    fits = [fit_law(model, columns) for model in _laws(config, name, columns)]
    inputs = tuple(dict.fromkeys(n for one in fits for n in one.model.inputs))
    if "dT_C" in columns and "dT_C" not in inputs:
        inputs = (*inputs, "dT_C")
    box = np.column_stack([columns[one] for one in inputs])
    steady = StaticLaws(
        inputs, [(one.model, one.values) for one in fits],
        Envelope.of(box[np.isfinite(box).all(axis=1)]),
    )  # fmt: skip
    parameters = {
        f"{key}_{one.model.output}" if len(fits) > 1 else key: {**_row(0.0, ""), **row}
        for one in fits
        for key, row in one.document()["parameters"].items()
    }
    advice = "; ".join(text for one in fits for text in one.advice) or "none"
    words = f"static law {', '.join(dict.fromkeys(one.model.name for one in fits))}"
    dynamics = NoDynamics(len(parameters), f"{words}, no dynamics")
    found = Identified(dynamics, parameters, fits[0].status, advice)
    config = config.having(
        steady_state={"kind": "static", "source": name, "inputs": inputs},
        narx={"outputs": steady.output_names, "schedule": ()},
    )
    return config, steady, found


def _steady_columns(config: RunConfig, logs: Sequence[Log]) -> Columns:
    """Quasi-steady samples of the channels that every log has, at most 20 000."""
    names = set.intersection(*(set(log.channels) for log in logs))
    spools = tuple(name for name in spools_of(config.narx.outputs) if name in names)
    kept = [quasi_steady(log, config.events.driver, spools, config.quasi_steady) for log in logs]
    step = max(sum(int(one.sum()) for one in kept) // _LAW_ROWS, 1)
    return {
        name: np.concatenate([log[name][rows] for log, rows in zip(logs, kept, strict=True)])[
            ::step
        ]
        for name in sorted(names)
    }


def _laws(config: RunConfig, name: str, columns: Columns) -> list[StaticModel]:
    """Models of the law: one, or a black box for every output."""
    given = dict(config.identify.static)
    if name in ("polynomial", "spline-table"):
        outputs = [given.pop("output")] if "output" in given else list(config.narx.outputs)
        lacking = [one for one in outputs if one not in columns]
        if lacking:
            raise DataError("a static law needs its output in every log", channel=lacking[0])
        if name == "polynomial":
            given.setdefault("degrees", _degrees(config))
            make: Callable[..., StaticModel] = static_models.polynomial
        else:
            make = static_models.spline_table
        return [_made(make, name, {"columns": columns, "output": one, **given}) for one in outputs]
    if name not in MODELS or name in _COMPOSED:
        known = [one for one in MODELS if one not in _COMPOSED]
        raise ConfigError(
            f"unknown static law '{name}'",
            hint=f"Laws are {', '.join((*known, 'polynomial', 'spline-table'))}",
        )
    return [_made(MODELS[name], name, given)]


def _degrees(config: RunConfig) -> dict[str, int]:
    """Third degree in the driver, first in altitude and Mach: more oscillates between flights."""
    degrees = {config.driver: 3, "ALT_ft": 1, "Mach": 1}
    return {name: degrees[name] for name in config.steady_state.inputs if name in degrees}


def _made(make: Callable[..., StaticModel], name: str, given: Mapping[str, Any]) -> StaticModel:
    try:
        inspect.signature(make).bind(**given)
    except TypeError as error:
        wanted = [
            one for one in inspect.signature(make).parameters if one not in ("columns", "output")
        ]
        raise ConfigError(
            f"the static law '{name}': {error}",
            hint=f"Set it under [identify.static]; it takes {', '.join(wanted)}",
        ) from None
    return make(**given)
