"""The lumped two-spool engine: parameters by name, start, free run, slopes, storage.

`narxcal.lumped.limited` and `governed` have the equations and the names of the parameters. The
steady state is an exact equilibrium, which is stable whatever the parameters are.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, Self

import numpy as np

from narxcal.atmosphere import air_columns
from narxcal.channels import SPOOLS
from narxcal.lumped.governed import (
    EXTRA,
    HEAT,
    LINES,
    OTHER_LINES,
    REGRESSORS,
    SLOPES,
    governed,
)
from narxcal.lumped.limited import LIMITED, limited
from narxcal.lumped.states import CASING, FAST, ROWS, SOAK, Drive, Engine, conditions, deviation
from narxcal.narx.network import AT_START, shaped
from narxcal.support.arrays import BoolArray, FloatArray, IntArray
from narxcal.support.compiled import compiled
from narxcal.support.dual import WIDTH, get, put, seeded
from narxcal.support.errors import ModelError

Starts = tuple[IntArray, FloatArray]  # positions (n,) of windows, and states (n, ROWS, n_out)
_SCALES = ("centre", "half", "limit")


class Slopes(NamedTuple):
    """Which slopes: by the parameters `free` (P,), of `columns` (c,), in one row of `every`.

    Only `outputs` are run; see `LumpedEngine.compiled`.
    """

    free: IntArray
    columns: IntArray
    every: int = 1
    outputs: IntArray | None = None


def shapes_of(count: int, *, governed: bool) -> dict[str, tuple[int, ...]]:
    """Shapes of the stored arrays of parameters of `count` outputs; `theta` has them in a row."""
    if not governed:
        return {"parameters": (count, len(LIMITED))}
    return {
        "lines": (len(LINES) + len(OTHER_LINES) * (count - 2), len(REGRESSORS)),
        "slopes": (count - 1, len(SLOPES)),
        "heat": (count, len(HEAT)),
        "extra": (len(EXTRA) + count - 2,),
    }


@dataclass(frozen=True, kw_only=True, eq=False)
class LumpedEngine:
    """Dynamics of all outputs about their steady state.

    | field | meaning |
    |---|---|
    | `governed` | whether a control governs N1 (two outputs at least are speeds), else limited |
    | `theta` (P,) | parameters; `arrays` are views of them by stored name |
    | `centre`, `half` (n_out,) | scale the corrected outputs to [-1, 1] |
    | `limit` (n_out,) | bounds the magnitude of each deviation |

    The core is the last output that is a speed, or the first output of an engine without one.
    """

    output_names: tuple[str, ...]
    governed: bool
    theta: FloatArray
    centre: FloatArray
    half: FloatArray
    limit: FloatArray

    @classmethod
    def of(
        cls,
        output_names: tuple[str, ...],
        arrays: Mapping[str, FloatArray],
        scales: Mapping[str, FloatArray],
    ) -> Self:
        """Build an engine from its stored arrays; `scales` are centre, half and limit."""
        governed = "lines" in arrays
        shapes = shapes_of(len(output_names), governed=governed)
        theta = np.concatenate([np.ravel(arrays[name]) for name in shapes])
        centre, half, limit = (scales[name] for name in _SCALES)
        return cls(
            output_names=output_names,
            governed=governed,
            theta=theta,
            centre=centre,
            half=half,
            limit=limit,
        )

    @cached_property
    def arrays(self) -> dict[str, FloatArray]:
        """Views of `theta` in the shapes of `shapes_of`."""
        views, at = {}, 0
        for name, shape in shapes_of(len(self.output_names), governed=self.governed).items():
            size = int(np.prod(shape))
            views[name] = self.theta[at : at + size].reshape(shape)
            at += size
        return views

    @property
    def parameter_names(self) -> tuple[str, ...]:
        if not self.governed:
            return tuple(f"{output}: {name}" for output in self.output_names for name in LIMITED)
        core, *others = (self.output_names[k] for k in self.order)
        rest = others[1:]
        lines = [*(f"control {each}" for each in LINES)]
        lines += [f"{output} {each}" for output in rest for each in OTHER_LINES]
        parts = (lines, REGRESSORS), (others, SLOPES), ([core, *others], HEAT)
        named = [f"{row}: {name}" for rows, names in parts for row in rows for name in names]
        return (*named, *EXTRA, *(f"{output}: share" for output in rest))

    @property
    def speeds(self) -> BoolArray:
        return speeds_of(self.output_names)

    @property
    def core(self) -> int:
        return core_of(self.output_names)

    @cached_property
    def order(self) -> IntArray:
        """Columns with the core first, then the fan (if there is one), then the others."""
        columns, speeds = np.arange(len(self.output_names)), np.flatnonzero(self.speeds)
        if self.governed and len(speeds) < 2:
            raise ModelError(
                "a governed engine has the speeds of a fan and a core, found "
                f"{', '.join(self.output_names)}",
                hint="Add N1_pct and N2_pct to [narx] outputs, or set lag_governed = false",
            )
        first = [self.core, *([int(speeds[0])] if len(speeds) > 1 else [])]
        return np.array([*first, *np.setdiff1d(columns, first)], dtype=np.int64)

    @cached_property
    def used(self) -> BoolArray:
        """Which states (ROWS, n_out) take part: those of control and metal are the core's."""
        used = np.zeros((ROWS, len(self.output_names)), dtype=np.bool_)
        used[FAST : CASING + 1] = True
        used[:, self.core] |= self.governed
        return used

    def drive(self, inputs: FloatArray, names: Sequence[str], ss: FloatArray) -> Drive:
        """What the engine follows, from inputs (T, n_in) called `names` and ss (T, n_out)."""
        ss = np.ascontiguousarray(ss)
        air = np.ascontiguousarray(inputs[:, air_columns(names)])
        air[:, air_columns(names) < 0] = 0.0
        return Drive(ss, *conditions(air, ss, self.centre, self.half))

    @cached_property
    def _all(self) -> Engine:
        columns = np.arange(len(self.output_names))
        own, rank = np.where(self.speeds, columns, self.core), np.argsort(self.order)
        return Engine(self.theta, self.limit, self.order, own, rank, self.governed)

    def compiled(self, outputs: IntArray | None = None) -> Engine:
        """The numbers that compiled functions take, to run all outputs or some.

        The core has to be among `outputs`; under a governor, the fan as well.
        """
        if outputs is None:
            return self._all
        return self._all._replace(outputs=self.order[np.isin(self.order, outputs)])

    def start(self, deviation: FloatArray) -> FloatArray:
        """States (..., ROWS, n_out) at which a run begins with `deviation` (..., n_out).

        Engines mostly are in equilibrium at the start of a log. What deviates then is the metal's
        heat, where the model has it, which decays in minutes; under a governor the fan has none.
        """
        states = np.zeros((*deviation.shape[:-1], ROWS, deviation.shape[-1]))
        if self.governed:
            slow = np.arange(deviation.shape[-1]) != self.order[1]
        else:
            slow = self.arrays["parameters"][:, LIMITED.index("casing_share")] != 0.0
        states[..., FAST, :] = np.where(slow, 0.0, deviation)
        states[..., CASING, :] = np.where(slow, deviation, 0.0)
        return states

    def run(
        self,
        drive: Drive,
        starts: Starts,
        dt_s: float,
        measured: FloatArray | None = None,
        outputs: IntArray | None = None,
    ) -> tuple[FloatArray, FloatArray]:
        """Deviations (T, n_out) and last states (ROWS, n_out) of a free run.

        `measured` (T, n_out) deviations, where they are finite, replace the model's own before each
        step (one-step prediction). Of `outputs` see `compiled`.
        """
        return free_run(self.compiled(outputs), drive, starts, _rows(measured, drive), dt_s)

    def slopes(
        self,
        wanted: Slopes,
        drive: Drive,
        starts: Starts,
        dt_s: float,
        measured: FloatArray | None = None,
    ) -> FloatArray:
        """Slopes (n, c, P) of the deviations that `run` gives, by parameters."""
        free, columns, every, outputs = wanted
        engine, parts = self.compiled(outputs), []
        for first in range(0, len(free), WIDTH):
            some = free[first : first + WIDTH]
            dual = engine._replace(theta=seeded(self.theta, some))
            numbers, _ = free_run(dual, drive, starts, _rows(measured, drive), dt_s)
            parts.append(numbers[::every, columns, 1 : 1 + len(some)])
        return np.concatenate(parts, axis=2)

    def deviations(
        self, drive: Drive, start: FloatArray, dt_s: float, measured: FloatArray | None = None
    ) -> FloatArray:
        """Deviations (T, n_out) from `start` (n_out,) on; a NaN there counts as zero."""
        first = self.start(np.nan_to_num(start))
        return self.run(drive, (AT_START, first[None]), dt_s, measured)[0]

    def to_arrays(self) -> tuple[dict[str, Any], dict[str, FloatArray]]:
        names = {"output_names": list(self.output_names)}
        own = {"form": "governed"} if self.governed else {"parameter_names": list(LIMITED)}
        return {**own, **names}, {**self.arrays, **{name: getattr(self, name) for name in _SCALES}}

    @classmethod
    def from_arrays(cls, meta: Mapping[str, Any], arrays: Mapping[str, FloatArray]) -> Self:
        """Rebuild from `to_arrays`; `ModelError` where an array is missing or misshapen."""
        names = tuple(meta["output_names"])
        shapes = shapes_of(len(names), governed="form" in meta)
        scales = dict.fromkeys(_SCALES, (len(names),))
        found = shaped(arrays, shapes | scales, "lag array")
        return cls.of(names, found, found)


def speeds_of(names: Sequence[str]) -> BoolArray:
    return np.array([name in SPOOLS for name in names])


def core_of(names: Sequence[str]) -> int:
    """Column of the core spool: the last speed, or 0."""
    speeds = np.flatnonzero(speeds_of(names))
    return int(speeds[-1]) if len(speeds) else 0


def _rows(measured: FloatArray | None, drive: Drive) -> FloatArray:
    none = np.empty((0, drive.ss.shape[1]))
    return none if measured is None else np.ascontiguousarray(measured)


@compiled(exact=False)
def free_run(
    engine: Engine,
    drive: Drive,
    starts: tuple[IntArray, FloatArray],
    measured: FloatArray,
    dt_s: float,
) -> tuple[FloatArray, FloatArray]:
    """Deviations (T, o) and the states (`ROWS`, o) at the end; of dual numbers with slopes behind.

    `starts` are positions (n,) at which a window begins, and the states there (n, `ROWS`, o).
    `measured` (T, o), if it has rows, replaces the deviation before each step where it is finite
    (one-step prediction). Columns that are not in `engine.outputs` stay zero.
    """
    count = drive.ss.shape[1]
    found = np.zeros(drive.ss.shape + engine.theta.shape[1:])
    x = np.zeros((ROWS, count) + engine.theta.shape[1:])  # noqa: RUF005 (numba unpacks no tuples)
    window = 0
    for k in range(len(found)):
        if window < len(starts[0]) and starts[0][window] == k:
            for row in range(ROWS):
                for o in range(count):
                    put(x, (row, o), starts[1][window, row, o])
            window += 1
        else:
            for o in range(count if len(measured) > 0 else 0):
                if math.isfinite(measured[k - 1, o]):
                    slow = get(x, (SOAK, o)) + get(x, (CASING, o))
                    put(x, (FAST, o), measured[k - 1, o] - slow)
            if engine.governed:
                governed(engine, drive, x, k, dt_s)
            else:
                limited(engine, drive, x, k, dt_s)
        for j in range(len(engine.outputs)):
            o = engine.outputs[j]
            put(found, (k, o), deviation(x, o))
    return found, x
