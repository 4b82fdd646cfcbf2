"""State-dependent lags: how each output follows its steady-state value, in physical parameters.

A spool is a first-order lag whose time constant depends on its speed and on the air (NACA
TR-1011: coefficients are corrected for altitude like steady-state data; FACTS A2), behind a control
that limits how fast it may move. This is a state-dependent parameter model (Young, McKenna and
Bruun 2001, Int. J. Control 74); `narxcal.lag_steps` has its equations. The deviation that it gives
decays wherever the inputs stand still, so the steady state is an exact equilibrium.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from narxcal.atmosphere import air_state
from narxcal.errors import ModelError
from narxcal.lag_steps import CASING, FAST, HEAT_PARAMETERS, PARAMETERS, STATES, run_lags
from narxcal.narx import AT_START

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
_ARRAYS = ("parameters", "centre", "half", "limit")
_COLD = list(PARAMETERS[: -len(HEAT_PARAMETERS)])  # of folders from before there was `heat`


class Drive(NamedTuple):
    """What the lags follow, row by row; row 0 is the sample before the first step.

    `ss` (T, o) are the steady-state values, `target` (T, o) the same, corrected and scaled to
    [-1, 1], `per_unit` (T, o) the scaled speed per unit of the output, `air` (T, 2) the logarithms
    of sqrt(theta2) / delta2 and of sqrt(theta2).
    """

    ss: FloatArray
    target: FloatArray
    per_unit: FloatArray
    air: FloatArray

    def rows(self, part: slice | IntArray) -> Drive:
        """Some of the rows."""
        return Drive(*(np.ascontiguousarray(column[part]) for column in self))

    def after(self, before: Drive) -> Drive:
        """These rows behind those of `before`."""
        pairs = zip(before, self, strict=True)
        return Drive(*(np.concatenate(pair) for pair in pairs))


class Wiring(NamedTuple):
    """What goes by which speed.

    `order` (o,) are the columns with the core spool first. Column k goes by speed `own[k]`, and
    `sign[k]` is -1 where it is no speed itself.
    """

    order: IntArray
    own: IntArray
    sign: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class LagModel:
    """The lags of all outputs.

    `parameters` (n_out, 38) are named by `PARAMETERS`. `centre` and `half` (n_out,) scale the
    corrected outputs; `limit` (n_out,) bounds the magnitude of each deviation. The core spool is
    the last output that is a speed, or the first output of an engine without one.
    """

    output_names: tuple[str, ...]
    parameters: FloatArray
    centre: FloatArray
    half: FloatArray
    limit: FloatArray

    @property
    def core(self) -> int:
        """Column of the core spool."""
        return core_of(self.output_names)

    @cached_property
    def wiring(self) -> Wiring:
        """What goes by which speed."""
        columns = np.arange(len(self.output_names))
        speeds = speeds_of(self.output_names)
        own = np.where(speeds, columns, self.core)
        sign = np.where(speeds | (columns == self.core), 1.0, -1.0)
        return Wiring(core_first(self.output_names), own, sign)

    def of(self, columns: IntArray) -> LagModel:
        """Some of the outputs; the core spool has to be among them."""
        return LagModel(
            output_names=tuple(self.output_names[k] for k in columns),
            parameters=self.parameters[columns],
            centre=self.centre[columns],
            half=self.half[columns],
            limit=self.limit[columns],
        )

    def drive(self, inputs: FloatArray, names: Sequence[str], ss: FloatArray) -> Drive:
        """What the lags follow, from inputs (T, n_in) called `names` and ss (T, n_out)."""
        root, air = thickness(inputs, names)
        scale = root[:, None] * self.half
        target = (ss / root[:, None] - self.centre) / self.half
        _, own, sign = self.wiring
        return Drive(ss, target[:, own], sign / scale[:, own], air)

    def run(
        self,
        drive: Drive,
        starts: tuple[IntArray, FloatArray],
        dt_s: float,
        measured: FloatArray | None = None,
    ) -> FloatArray:
        """States (T, 3, n_out), whose sum is the deviation; arguments as of `run_lags`."""
        order = self.wiring.order
        back = np.argsort(order)
        ss, target, per_unit = (np.ascontiguousarray(part[:, order]) for part in drive[:3])
        forced = np.empty((0, len(order))) if measured is None else measured[:, order]
        states = run_lags(
            (ss, target, per_unit, drive.air),
            (self.parameters[order], self.limit[order]),
            (starts[0], np.ascontiguousarray(starts[1][:, :, order])),
            np.ascontiguousarray(forced),
            dt_s,
        )
        return states[:, :, back]

    def deviations(
        self, drive: Drive, start: FloatArray, dt_s: float, measured: FloatArray | None = None
    ) -> FloatArray:
        """Deviations (T, n_out) from `start` (n_out,) on; a NaN there counts as zero."""
        first = self.start(np.nan_to_num(start))
        states = self.run(drive, (AT_START, first[None]), dt_s, measured)
        deviation: FloatArray = states.sum(axis=1)
        return deviation

    def start(self, deviation: FloatArray) -> FloatArray:
        """States (..., 3, n_out) where a run begins with `deviation` (..., n_out).

        Engines are mostly found at rest. What is left then is the metal's heat, where the model
        knows of it, and it goes in minutes.
        """
        states = np.zeros((*deviation.shape[:-1], len(STATES), deviation.shape[-1]))
        warm = self.parameters[:, PARAMETERS.index("casing_share")] != 0.0
        states[..., FAST, :] = np.where(warm, 0.0, deviation)
        states[..., CASING, :] = np.where(warm, deviation, 0.0)
        return states

    def to_arrays(self) -> tuple[dict[str, Any], dict[str, FloatArray]]:
        """Split into JSON-able structure and named arrays, for the bundle."""
        meta = {"output_names": list(self.output_names), "parameter_names": list(PARAMETERS)}
        return meta, {name: getattr(self, name) for name in _ARRAYS}

    @classmethod
    def from_arrays(cls, meta: Mapping[str, Any], arrays: Mapping[str, FloatArray]) -> Self:
        """Rebuild from `to_arrays`; `ModelError` where an array is missing or misshapen.

        Parameters of before there was `heat` are completed: they had none.
        """
        names = tuple(meta["output_names"])
        shapes: dict[str, tuple[int, ...]] = dict.fromkeys(_ARRAYS, (len(names),))
        cold = meta.get("parameter_names") == _COLD
        shapes["parameters"] = (len(names), len(_COLD if cold else PARAMETERS))
        kept = arrays_of(shapes, arrays)
        missing = len(PARAMETERS) - kept["parameters"].shape[1]
        kept["parameters"] = np.pad(kept["parameters"], ((0, 0), (0, missing)))
        return cls(output_names=names, **kept)


def arrays_of(
    shapes: Mapping[str, tuple[int, ...]], arrays: Mapping[str, FloatArray]
) -> dict[str, FloatArray]:
    """Copies of the arrays named in `shapes`; `ModelError` where one is missing or misshapen."""
    kept = {}
    for name, shape in shapes.items():
        found = arrays.get(name)
        if found is None or found.shape != shape:
            given = None if found is None else found.shape
            raise ModelError(
                f"lag array '{name}' has to be of shape {shape}, found {given}",
                hint="Train again if another version of narxcal wrote the folder",
            )
        kept[name] = np.array(found, dtype=np.float64)
    return kept


def speeds_of(names: Sequence[str]) -> NDArray[np.bool_]:
    """Which outputs are spool speeds."""
    return np.array([name.endswith("_pct") for name in names])


def core_of(names: Sequence[str]) -> int:
    """Column of the core spool: the last speed, or 0."""
    speeds = np.flatnonzero(speeds_of(names))
    return int(speeds[-1]) if len(speeds) else 0


def core_first(names: Sequence[str]) -> IntArray:
    """Columns with the core spool first."""
    columns = np.arange(len(names))
    core = core_of(names)
    return np.concatenate([[core], columns[columns != core]])


def thickness(inputs: FloatArray, names: Sequence[str]) -> tuple[FloatArray, FloatArray]:
    """Return sqrt(theta2) (T,) and logarithms (T, 2) of sqrt(theta2) / delta2 and sqrt(theta2).

    What is missing is zero.
    """
    zero = np.zeros(len(inputs))
    air = air_state(*(zero if k < 0 else inputs[:, k] for k in air_columns(names)))
    root = np.sqrt(air.theta2)
    return root, np.log(np.stack([root / air.delta2, root], axis=1))


def air_columns(names: Sequence[str]) -> IntArray:
    """Columns of altitude, Mach number and temperature deviation; -1 for one that is missing."""
    wanted = ("ALT_ft", "Mach", "dT_C")
    return np.array([list(names).index(name) if name in names else -1 for name in wanted])
