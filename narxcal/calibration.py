"""Dynamic calibration: a steady-state model and the NARX network that says how far it is off.

Source: papers/narx calibration, section 2.1 and figure 1. With `ss` the steady-state value,

    d(k) = ss(k) - y(k)                          (the deviation)
    d(k) = NARX( d(k-1).., ss(k) - ss(k-1).., schedule(k).. )
    y(k) = ss(k) - d(k)

where the schedule holds the steady-state values themselves and the flight condition. The
parameter register keeps the past deviations and inputs between steps.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import copy
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from narxcal import kernels
from narxcal.errors import DataError, ModelError
from narxcal.narx import AT_START, NarxModel, Weights
from narxcal.steady_state import SteadyStateModel, steady_from_json, steady_to_json

FloatArray = NDArray[np.float64]
# An EGT overshoots its final value by up to 1.6 times the change (FACTS: frozen-speed response).
_OVERSHOOT = 2.0


class DynamicCalibration:
    """Turns inputs into outputs over time: `simulate` for whole logs, `step` for one sample.

    `settle_s` is the fading bound: a deviation may not be larger than twice that of a first-order
    lag of this time constant, so that it never outlives the movement that caused it. It needs a
    network whose outputs are deviations that vanish at rest (an anchored one); None means none.

    Both give the same numbers. Columns are canonical channels: `input_names` are those of
    the steady-state model, `output_names` those that it gives.
    """

    def __init__(
        self,
        steady: SteadyStateModel,
        narx: NarxModel,
        dt_s: float,
        schedule: Sequence[str] = (),
        settle_s: float | None = None,
    ) -> None:
        unknown = [name for name in schedule if name not in steady.input_names]
        if unknown:
            raise ModelError(
                f"the schedule names '{unknown[0]}', which is no input of the steady-state model",
                hint=f"Inputs are {', '.join(steady.input_names)}",
            )
        self.steady = steady
        self.narx = narx
        self.dt_s = dt_s
        self.schedule = tuple(schedule)
        self.settle_s = settle_s
        self._columns = [steady.input_names.index(name) for name in schedule]
        self._register: _Register | None = None

    @property
    def input_names(self) -> tuple[str, ...]:
        """Channels that `simulate` and `step` take, in this order."""
        return self.steady.input_names

    @property
    def output_names(self) -> tuple[str, ...]:
        """Channels that they return, in this order."""
        return self.steady.output_names

    def for_engine(self, engine: str) -> DynamicCalibration:
        """The calibration with the build scatter of `engine`, where the model knows that one."""
        chosen = copy(self)
        chosen.steady = steady_for_engine(self.steady, engine)
        chosen._register = None  # noqa: SLF001 (a copy of ourselves)
        return chosen

    def features(self, inputs: FloatArray, ss: FloatArray) -> FloatArray:
        """What the network is driven by, (time, features): increments, values, schedule."""
        return narx_features(ss, inputs[:, self._columns])

    def simulate(self, inputs: ArrayLike, start: ArrayLike | None = None) -> FloatArray:
        """Free run over `inputs` (time, n_in); returns (time, n_out).

        `start` (n_out,) are measured outputs at the first sample; where it is None or NaN the
        engine starts settled. Raises `DataError` for inputs that are not finite.
        """
        given = self._checked(inputs)
        ss = self.steady.outputs(given)
        first = self._first_deviation(ss[0], start)
        features = self.features(given, ss)
        register = _Register(self, ss[0], first, features[0])
        deviation = first[None]
        if len(given) > 1:
            later = register.extend(ss[1:], features[1:])
            deviation = np.concatenate([deviation, later])
        return ss - deviation

    def predict(self, inputs: ArrayLike, measured: ArrayLike) -> FloatArray:
        """One-step-ahead prediction (time, n_out) from measured outputs (time, n_out).

        NaN where the register would hold an unknown value: at sample 0 and after a masked one.
        """
        given = self._checked(inputs)
        ss = self.steady.outputs(given)
        deviation = ss - np.asarray(measured, dtype=np.float64)
        return ss - self.narx.predict(self.features(given, ss), deviation)

    def reset(self, inputs: ArrayLike, start: ArrayLike | None = None) -> FloatArray:
        """Fill the register as if the engine had stood still at `inputs` (n_in,).

        Returns the outputs (n_out,) at that sample, which are sample 0 of `simulate`.
        """
        given = self._checked(np.atleast_2d(np.asarray(inputs, dtype=np.float64)))
        ss = self.steady.outputs(given)
        first = self._first_deviation(ss[0], start)
        self._register = _Register(self, ss[0], first, self.features(given, ss)[0])
        value: FloatArray = ss[0] - first
        return value

    def step(self, inputs: ArrayLike, correction: ArrayLike | None = None) -> FloatArray:
        """Outputs (n_out,) at the next sample, from `inputs` (n_in,) at that sample.

        `correction` (n_out,), such as a fused estimate, replaces the newest outputs in the
        register before the step; NaN keeps the model's own. The first call resets.
        """
        given = np.asarray(inputs, dtype=np.float64)
        if self._register is None:
            return self.reset(given)
        row = self._checked(given[None])
        register = self._register
        if correction is not None:
            register.correct(np.asarray(correction, dtype=np.float64))
        ss = self.steady.outputs(row)[0]
        feature = np.concatenate([ss - register.ss, ss, row[0, self._columns]])
        value: FloatArray = ss - register.advance(ss, feature)
        return value

    def extend(self, inputs: ArrayLike) -> FloatArray:
        """`step` through `inputs` (time, n_in) in one call, from where the register stands.

        Returns (time, n_out): the numbers of `step`, at a small part of its cost.
        """
        given = self._checked(inputs)
        if self._register is None:
            first = self.reset(given[0])[None]
            return np.concatenate([first, self.extend(given[1:])]) if len(given) > 1 else first
        ss = self.steady.outputs(given)
        before = np.concatenate([self._register.ss[None], ss[:-1]])
        features = np.concatenate([ss - before, ss, given[:, self._columns]], axis=1)
        return ss - self._register.extend(ss, features)

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Guaranteed (low, high) of the deviation of every output, in the outputs' units."""
        return self.narx.bounds

    def to_arrays(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Split into JSON-able structure and named arrays, for the bundle."""
        narx, narx_arrays = self.narx.to_arrays()
        steady, steady_arrays = steady_to_json(self.steady)
        arrays = {f"narx/{name}": value for name, value in narx_arrays.items()}
        arrays |= {f"steady/{name}": value for name, value in steady_arrays.items()}
        meta = {
            "dt_s": self.dt_s,
            "schedule": list(self.schedule),
            "settle_s": self.settle_s,
            "narx": narx,
            "steady": steady,
        }
        return meta, arrays

    @classmethod
    def from_arrays(cls, meta: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> Self:
        """Rebuild from `to_arrays`; raises `ModelError` where the parts do not fit."""
        part: dict[str, dict[str, NDArray[Any]]] = {"narx": {}, "steady": {}}
        for name, value in arrays.items():
            room, _, rest = name.partition("/")
            if room in part:
                part[room][rest] = value
        try:
            narx = NarxModel.from_arrays(meta["narx"], part["narx"])
            steady = steady_from_json(meta["steady"], part["steady"])
            return cls(steady, narx, float(meta["dt_s"]), meta["schedule"], meta["settle_s"])
        except KeyError as error:
            raise ModelError(
                f"the stored calibration has no {error}",
                hint="The bundle was altered; train it again",
            ) from None

    def _checked(self, inputs: ArrayLike) -> FloatArray:
        given = np.asarray(inputs, dtype=np.float64)
        if given.ndim != 2 or given.shape[1] != len(self.input_names) or not len(given):
            raise DataError(
                f"expected inputs of shape (time, {len(self.input_names)}) "
                f"({', '.join(self.input_names)}), found {given.shape}"
            )
        if not np.isfinite(given).all():
            row, column = np.argwhere(~np.isfinite(given))[0]
            raise DataError(
                f"expected a finite input, found {given[row, column]}",
                channel=self.input_names[column],
                row=int(row),
                hint="Hold the last good value, or cut the log there",
            )
        return given

    def _first_deviation(self, ss: FloatArray, start: ArrayLike | None) -> FloatArray:
        if start is None:
            return np.zeros(len(self.output_names))
        given = np.asarray(start, dtype=np.float64)
        if given.shape != ss.shape:
            raise DataError(
                f"expected start values of shape ({len(ss)},) ({', '.join(self.output_names)}), "
                f"found {given.shape}"
            )
        return np.where(np.isfinite(given), ss - given, 0.0)


def narx_features(ss: FloatArray, schedule: FloatArray) -> FloatArray:
    """Stack increments of `ss` (time, n_out), `ss` itself and the flight condition."""
    return np.concatenate([np.diff(ss, axis=0, prepend=ss[:1]), ss, schedule], axis=1)


def steady_for_engine(steady: SteadyStateModel, engine: str) -> SteadyStateModel:
    """The steady-state model of one engine, where it tells engines apart."""
    chooser = getattr(steady, "for_engine", None)
    chosen: SteadyStateModel = steady if chooser is None else chooser(engine)
    return chosen


class _Register:
    """The paper's parameter register: past deviations, features and the last steady state."""

    def __init__(
        self,
        owner: DynamicCalibration,
        ss: FloatArray,
        deviation: FloatArray,
        feature: FloatArray,
    ) -> None:
        narx = owner.narx
        self.keep = None if owner.settle_s is None else math.exp(-owner.dt_s / owner.settle_s)
        self.fading = np.stack([np.zeros_like(deviation), np.abs(deviation)])
        self.weights = Weights.of(narx.net)
        self.inputs, self.outputs = narx.input_scaling, narx.output_scaling
        self.taps = np.array(narx.config.taps)
        self.ss = ss
        self.history = np.tile(self.outputs.down(deviation), narx.config.lags)
        self.past = np.tile(self.inputs.down(feature), (int(self.taps[-1]) + 1, 1))

    def correct(self, outputs: FloatArray) -> None:
        newest = self.history[: len(outputs)]
        scaled = self.outputs.down(self.ss - outputs)
        newest[:] = np.where(np.isfinite(outputs), scaled, newest)
        self.fading[1] = np.maximum(self.fading[1], np.abs(self.outputs.up(newest)))

    def advance(self, ss: FloatArray, feature: FloatArray) -> FloatArray:
        deviation: FloatArray = self.extend(ss[None], feature[None])[0]
        return deviation

    def extend(self, ss: FloatArray, features: FloatArray) -> FloatArray:
        """Deviations (time, n_out) at steady states and features (time, ...) to come."""
        rows = np.concatenate([self.past, self.inputs.down(features)])
        newest = np.arange(len(self.past), len(rows))
        tapped = rows[newest[:, None] - self.taps].reshape(len(features), -1)
        limit = self._limit(features[:, : len(self.ss)])
        deviation, _, fed = self.weights.run(tapped, (AT_START, self.history[None]), limit)
        self.history = np.concatenate([deviation[-1], fed[-1, : -deviation.shape[1]]])
        self.past = rows[-len(self.past) :]
        self.ss = ss[-1]
        return self.outputs.up(deviation)

    def _limit(self, increments: FloatArray) -> FloatArray | None:
        if self.keep is None:
            return None
        envelope = kernels.fading(np.ascontiguousarray(increments), self.fading, self.keep)
        limit: FloatArray = _OVERSHOOT * envelope / self.outputs.scale
        return limit
