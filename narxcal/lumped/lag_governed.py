"""Lags of a two-spool engine whose control holds N1: governor, fuel, core, fan, temperatures.

`lumped.lag` lets every spool run to where it settles by itself. Behind a control that holds N1 the
core does not: it goes wherever the fan, which is slow, has to be driven to. `lag_governed_steps`
has the equations; they are for engines whose steady-state model says where the *lever* settles
them, not the fuel. The deviation is zero at rest, so the steady state is an equilibrium.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np

from narxcal.lumped.lag import (
    CASING,
    FAST,
    Drive,
    LagModel,
    air_columns,
    arrays_of,
    core_of,
    speeds_of,
    thickness,
)
from narxcal.lumped.lag_governed_sensitivity import run_sensitivities
from narxcal.lumped.lag_governed_steps import (
    HEAT,
    LINES,
    OTHER_LINES,
    REGRESSORS,
    ROWS,
    SLOPES,
    run_governed,
)
from narxcal.narx.network import AT_START
from narxcal.support.arrays import BoolArray, FloatArray, IntArray
from narxcal.support.errors import ModelError

_Columns = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
_Engine = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]
_FORM = "governed"
FITTED = ("lines", "slopes", "heat", "extra")  # arrays of what a fit can change


@dataclass(frozen=True, kw_only=True, eq=False)
class GovernedLags:
    """The lags of all outputs, of which two at least are speeds: the core's is the last.

    `lines` (8 + 2 k, 9) are logarithms over the `REGRESSORS`: those named `LINES` of core and fan,
    and `OTHER_LINES` of each of the k outputs that are neither. `slopes` (1 + k, 6) and `heat`
    (2 + k, 6) are named by `SLOPES` and `HEAT`; `extra` (2 + k,) are the valve's lag in s, what
    open clearances cost (0: nothing) and the share that each other output has of the fan's
    deviation. Outputs come with the core first, then the fan, then the others. `centre`, `half`
    and `limit` (n_out,) are as of `LagModel`, in the order of `output_names`.
    """

    output_names: tuple[str, ...]
    lines: FloatArray
    slopes: FloatArray
    heat: FloatArray
    extra: FloatArray
    centre: FloatArray
    half: FloatArray
    limit: FloatArray

    @cached_property
    def order(self) -> IntArray:
        """Columns with the core first and the fan behind it."""
        return governed_order(self.output_names)

    def drive(self, inputs: FloatArray, names: Sequence[str], ss: FloatArray) -> Drive:
        """What the lags follow, from inputs (T, n_in) called `names` and ss (T, n_out).

        `air` has the Mach number as a third column; without such an input it is zero.
        """
        root, air = thickness(inputs, names)
        column = air_columns(names)[1]
        mach = np.zeros(len(inputs)) if column < 0 else inputs[:, column]
        target = (ss / root[:, None] - self.centre) / self.half
        return Drive(ss, target, 1.0 / (root[:, None] * self.half), np.column_stack([air, mach]))

    def run(
        self,
        drive: Drive,
        starts: tuple[IntArray, FloatArray],
        dt_s: float,
        measured: FloatArray | None = None,
    ) -> FloatArray:
        """States (T, 6, n_out), the first three of which add up to the deviation.

        Arguments are as of `LagModel.run`.
        """
        order = self.order
        forced = np.empty((0, len(order))) if measured is None else measured[:, order]
        states = run_governed(
            *self._arrays(drive),
            (starts[0], np.ascontiguousarray(starts[1][:, :, order])),
            np.ascontiguousarray(forced),
            dt_s,
        )
        back: FloatArray = states[:, :, np.argsort(order)]
        return back

    def sensitivities(
        self,
        drive: Drive,
        run: tuple[FloatArray, float],
        wanted: Mapping[str, BoolArray],
        scored: tuple[Sequence[int] | IntArray, int],
    ) -> FloatArray:
        """Slopes (n, c, P) of deviations by P parameters: forward sensitivities along a free run.

        `run` are the states that `run` gave from a start at the first sample on, and the raster in
        s; `wanted` says by masks which numbers of the arrays `FITTED`, in that order. `scored` are
        c columns, and of how many samples one is scored: n = ceil(T / every).
        """
        order, (states, dt_s) = self.order, run
        where = [
            [array, *index, *[0] * (2 - len(index))]
            for array, name in enumerate(FITTED)
            for index in np.argwhere(wanted[name]).tolist()
        ]
        return run_sensitivities(
            *self._arrays(drive),
            (np.ascontiguousarray(states[:, :, order]), dt_s),
            np.array(where, dtype=np.int64).reshape(-1, 3),
            (np.argsort(order)[np.asarray(scored[0])], scored[1]),
        )

    def _arrays(self, drive: Drive) -> tuple[_Columns, _Engine]:
        """What the compiled functions take: what drives them and the engine, core first."""
        order = self.order
        columns = [np.ascontiguousarray(part[:, order]) for part in drive[:3]]
        air = np.ascontiguousarray(drive.air)
        engine = (self.lines, self.slopes, self.extra, self.heat, self.limit[order])
        return (columns[0], columns[1], columns[2], air), engine

    def deviations(
        self, drive: Drive, start: FloatArray, dt_s: float, measured: FloatArray | None = None
    ) -> FloatArray:
        """Deviations (T, n_out) from `start` (n_out,) on; a NaN there counts as zero."""
        first = self.start(np.nan_to_num(start))
        states = self.run(drive, (AT_START, first[None]), dt_s, measured)
        deviation: FloatArray = states[:, : CASING + 1].sum(axis=1)
        return deviation

    def start(self, deviation: FloatArray) -> FloatArray:
        """States (..., 6, n_out) where a run begins with `deviation` (..., n_out).

        Engines are mostly found at rest, and what is left then is the metal's heat. The fan, which
        the control holds, has none.
        """
        states = np.zeros((*deviation.shape[:-1], ROWS, deviation.shape[-1]))
        states[..., CASING, :] = deviation
        fan = self.order[1]
        states[..., CASING, fan], states[..., FAST, fan] = 0.0, deviation[..., fan]
        return states

    def to_arrays(self) -> tuple[dict[str, Any], dict[str, FloatArray]]:
        """Split into JSON-able structure and named arrays, for the bundle."""
        shapes = governed_shapes(len(self.output_names))
        meta = {"form": _FORM, "output_names": list(self.output_names)}
        return meta, {name: getattr(self, name) for name in shapes}

    @classmethod
    def from_arrays(cls, meta: Mapping[str, Any], arrays: Mapping[str, FloatArray]) -> Self:
        """Rebuild from `to_arrays`; `ModelError` where an array is missing or misshapen."""
        names = tuple(meta["output_names"])
        return cls(output_names=names, **arrays_of(governed_shapes(len(names)), arrays))


AnyLags = LagModel | GovernedLags


def lags_from_arrays(meta: Mapping[str, Any], arrays: Mapping[str, FloatArray]) -> AnyLags:
    """Lags of either form as `to_arrays` wrote them; `ModelError` where arrays do not fit."""
    kind: type[AnyLags] = GovernedLags if meta.get("form") == _FORM else LagModel
    return kind.from_arrays(meta, arrays)


def governed_order(names: Sequence[str]) -> IntArray:
    """Columns with the core first, then the fan, then the others.

    Raises `ModelError` without two speeds: then there is no fan for a control to hold.
    """
    speeds = np.flatnonzero(speeds_of(names))
    if len(speeds) < 2:
        raise ModelError(
            f"a governed engine has the speeds of a fan and a core, found {', '.join(names)}",
            hint="Add N1_pct and N2_pct to [narx] outputs, or set lag_governed = false",
        )
    core, fan = core_of(names), int(speeds[0])
    others = [column for column in range(len(names)) if column not in (core, fan)]
    return np.array([core, fan, *others], dtype=np.int64)


def governed_shapes(count: int) -> dict[str, tuple[int, ...]]:
    """Shapes of the arrays of `count` outputs."""
    others = count - 2
    return {
        "lines": (len(LINES) + len(OTHER_LINES) * others, len(REGRESSORS)),
        "slopes": (1 + others, len(SLOPES)),
        "heat": (count, len(HEAT)),
        "extra": (2 + others,),
        "centre": (count,),
        "half": (count,),
        "limit": (count,),
    }
