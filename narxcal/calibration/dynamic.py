"""The calibration with a NARX network, behind lags or alone.

Source: the calibration paper, section 2.1 and figure 1.

    d(k) = ss(k) - y(k)
    d(k) = NARX( d(k-1).., ss(k) - ss(k-1).., schedule(k).. )
    y(k) = ss(k) - d(k)

| symbol | meaning |
|---|---|
| ss, y | outputs of the steady-state model, outputs |
| d | deviation; with a lumped engine (`narxcal.lumped`) the sum of its own and the network's |
| schedule | the steady-state values themselves and the flight condition |
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from narxcal.calibration.calibration import Calibration, blocks
from narxcal.calibration.members import Member
from narxcal.calibration.register import Parts, Register, Sample, stacked
from narxcal.lumped.engine import LumpedEngine
from narxcal.narx.network import AT_START, NarxModel
from narxcal.steady.model import ALTERED, SteadyStateModel
from narxcal.steady.opening import steady_from_json, steady_to_json
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ModelError

_ROUNDING = 1e-9  # of weights that sum to one
# Bounds may be infinite: an input without a range, an output without a clamp.
_UNBOUNDED = ("narx/low", "narx/high", "steady/low", "steady/high")


class DynamicCalibration(Calibration):
    """Steady-state model, lags and NARX network.

    `settle_s` is the fading bound: the network's deviation may not be larger than twice that of a
    first-order lag of this time constant, so that it never outlives the movement that caused it. It
    needs a network whose outputs vanish in equilibrium (an anchored one); None means none.
    `with_lag` puts lags in front of the network, of whose own deviation an output takes the share
    `network_share` (n_out,): between 0, the lags alone, and 1, which None stands for.
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
        super().__init__(steady, dt_s)
        self.narx = narx
        self.schedule = tuple(schedule)
        self.settle_s = settle_s
        self._columns = [steady.input_names.index(name) for name in schedule]
        self.lag: LumpedEngine | None = None
        self.network_share: FloatArray | None = None

    @property
    def words(self) -> str:
        return f"NARX, lags {self.narx.config.lags}, hidden units {self.narx.config.hidden}"

    @property
    def size(self) -> int:
        lag = 0 if self.lag is None else np.count_nonzero(self.lag.theta)
        return int(self.narx.weights.theta.size + lag)

    def with_lag(self, lag: LumpedEngine | None) -> Self:
        """The calibration with `lag` in front of a network that was trained for that."""
        if lag is not None and lag.output_names != self.output_names:
            raise ModelError(
                f"the lags are those of {', '.join(lag.output_names)}, "
                f"the steady-state model's outputs {', '.join(self.output_names)}"
            )
        return self._with(lag=lag)

    def with_decay(self, settle_s: float) -> Self:
        return self._with(settle_s=settle_s)

    def with_network_share(self, share: ArrayLike | None) -> Self:
        """The calibration with this share (n_out,) of the network's deviation; None means all."""
        if share is None:
            return self._with(network_share=None, interval=None)
        shares = np.asarray(share, dtype=np.float64)
        fits = self.lag is not None and shares.shape == (len(self.output_names),)
        if not fits or not ((shares >= 0.0) & (shares <= 1.0)).all():
            raise ModelError("'network_share' is no share for each output", hint=ALTERED)
        return self._with(network_share=shares, interval=None)

    def own_alone(self) -> Self:
        """The calibration with its own model alone, and all of the network's deviation."""
        return super().own_alone().with_network_share(None)

    def _prediction(self, given: FloatArray, ss: FloatArray, known: FloatArray) -> FloatArray:
        """With lags in front of the network, the network's own share is that of the free run."""
        if self.lag is None:
            features = narx_features(ss, given[:, self._columns])
            return np.asarray(ss - self.narx.predict(features, ss - known))
        first = np.nan_to_num(ss[0] - known[0])
        running = self._started(given[0], ss[0], first)
        state = alone = self.lag.start(first)
        last, found = first[None], np.full_like(ss, np.nan)
        for block in blocks(len(ss), 1):
            # The states are those of the row before.
            rows = slice(block.start - 1, block.stop)
            free = np.concatenate([last, running.advance(given[block], ss[block])])
            drive = self.lag.drive(given[rows], self.input_names, ss[rows])
            lags, alone = self.lag.run(drive, (AT_START, alone[None]), self.dt_s)
            share, last = free - lags, free[-1:]
            own = ss[rows] - known[rows] - share
            lags, state = self.lag.run(drive, (AT_START, state[None]), self.dt_s, own)
            found[block] = (ss[rows] - lags - share)[1:]
        found[1:][np.isnan(known[:-1]).any(axis=1)] = np.nan
        return found

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        low, high = self.narx.bounds
        if self.lag is None:
            return low, high
        return low - self.lag.limit, high + self.lag.limit

    def _decay(self) -> FloatArray:
        if self.settle_s is None:
            return np.empty(0)
        return np.array([np.exp(-self.dt_s / self.settle_s)])

    def to_arrays(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        narx, narx_arrays = self.narx.to_arrays()
        steady, steady_arrays = steady_to_json(self.steady)
        arrays = {f"narx/{name}": value for name, value in narx_arrays.items()}
        arrays |= {f"steady/{name}": value for name, value in steady_arrays.items()}
        lag_meta = None
        if self.lag is not None:
            lag_meta, lag_arrays = self.lag.to_arrays()
            arrays |= {f"lag/{name}": value for name, value in lag_arrays.items()}
        meta = {
            "dt_s": self.dt_s,
            "schedule": list(self.schedule),
            "settle_s": self.settle_s,
            "narx": narx,
            "steady": steady,
            "lag": lag_meta,
        }
        meta |= self._common_rows()
        if self.members.members:
            meta["members"] = [one.to_json() for one in self.members.members]
        if self.network_share is not None:
            meta["network_share"] = self.network_share.tolist()
        return meta, arrays

    @classmethod
    def from_arrays(
        cls,
        meta: Mapping[str, Any],
        arrays: Mapping[str, NDArray[Any]],
        *,
        trust: bool = False,
    ) -> Self:
        """Rebuild from `to_arrays`; `trust` as in `steady_from_json`."""
        part: dict[str, dict[str, NDArray[Any]]] = {"narx": {}, "steady": {}, "lag": {}}
        for name, value in arrays.items():
            unusable = np.isnan if name in _UNBOUNDED else lambda each: ~np.isfinite(each)
            if unusable(value).any():
                raise ModelError(f"array '{name}' has a number that is not finite", hint=ALTERED)
            room, _, rest = name.partition("/")
            if room in part:
                part[room][rest] = value
        try:
            narx = NarxModel.from_arrays(meta["narx"], part["narx"])
            steady = steady_from_json(meta["steady"], part["steady"], trust=trust)
            settle_s = meta["settle_s"]
            loaded = cls(steady, narx, float(meta["dt_s"]), meta["schedule"], settle_s)
            if meta["lag"] is not None:
                loaded = loaded.with_lag(LumpedEngine.from_arrays(meta["lag"], part["lag"]))
            loaded = loaded.with_members([Member.from_json(one) for one in meta.get("members", ())])
            if meta.get("network_share") is not None:
                loaded = loaded.with_network_share(meta["network_share"])
        except KeyError as error:
            raise ModelError(f"the stored calibration has no {error}", hint=ALTERED) from None
        loaded.check()
        return loaded

    def check(self) -> None:
        """Raise `ModelError` for parts that do not fit each other."""
        count = len(self.output_names)
        features = (2 if self.lag is None else 3) * count + len(self.schedule)
        if (self.narx.inputs, self.narx.outputs) != (features, count):
            raise ModelError(
                f"expected a network of {features} inputs and {count} outputs, "
                f"found one of {self.narx.inputs} and {self.narx.outputs}",
                hint=ALTERED,
            )
        shares = np.zeros(count)
        for one in self.members.members:
            if not one.fits(count):
                raise ModelError("a member of the mixture does not fit the outputs", hint=ALTERED)
            shares[one.channel] += one.weight
        if (shares > 1.0 + _ROUNDING).any():
            raise ModelError("the weights of the mixture exceed one", hint=ALTERED)
        times: dict[str, Any] = {"dt_s": self.dt_s}
        if self.settle_s is not None:
            times["settle_s"] = self.settle_s
        for name, value in times.items():
            number = isinstance(value, int | float) and not isinstance(value, bool)
            if not number or not 0.0 < value < np.inf:
                raise ModelError(f"'{name}' has to be positive, found {value}", hint=ALTERED)

    def _started(self, inputs: FloatArray, ss: FloatArray, deviation: FloatArray) -> Register:
        parts = Parts(
            self.narx,
            self.lag,
            self.dt_s,
            self.settle_s,
            self.input_names,
            self._columns,
            self.network_share,
        )
        return Register(parts, Sample(inputs, ss, deviation))


def narx_features(
    ss: FloatArray, schedule: FloatArray, lagged: FloatArray | None = None
) -> FloatArray:
    """Stack increments of `ss` (time, n_out), `ss` itself and the flight condition.

    The deviation of lags in front of the network, where there are any, follows the increments.
    """
    shown = np.empty((len(ss), 0)) if lagged is None else lagged
    return stacked(np.diff(ss, axis=0, prepend=ss[:1]), shown, ss, schedule)
