r"""An emulator in rate form, fitted to a simulator's own logs.

It has the form of the product's own model, a steady state and a NARX network of one lag over the
deviation from it, read as a rate: one step of the network from `y` under inputs `u`, less `y`,
over the length of the step. One lag makes the outputs the whole state, so that scaling or
delaying the rate means what it says.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from narxcal.effects.base import FloatArray
from narxcal.effects.running import Flights
from narxcal.narx import NarxConfig, NarxModel, Weights
from narxcal.records import Record
from training.config import TrainConfig
from training.gap.settled import SettledModel, fit_settled
from training.rest import rest_records
from training.trainer import Material, fit_narx

CONDITIONS = ("ALT_ft", "Mach")
_REST_S = 20.0
_MARGIN = 0.5


@dataclass(frozen=True, eq=False)
class NarxEmulator:
    """A steady state and a network of one lag as a rate form; `schedule` are columns of inputs."""

    settled: SettledModel
    narx: NarxModel
    schedule: tuple[int, ...]
    dt_s: float
    _weights: Weights = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_weights", Weights.of(self.narx.net))

    def drive(self, u: FloatArray) -> FloatArray:
        """Steady outputs at a sample and the next, and the network's drive there.

        (rows, time, 3 outputs + hidden units); the last sample is driven by itself.
        """
        return np.stack([self._drive(row) for row in u])

    def _drive(self, u: FloatArray) -> FloatArray:
        weights, ss = self._weights, self.settled.outputs(u)
        tapped = self.narx.input_scaling.down(_features(ss, u[:, list(self.schedule)]))
        hidden, linear = weights.b1 + tapped @ weights.w1u.T, weights.b2 + tapped @ weights.au.T
        rest = tapped * weights.fixed
        linear -= weights.b2 + weights.at_rest(tapped) @ weights.w2.T + rest @ weights.au.T
        later = np.minimum(np.arange(len(u)) + 1, len(u) - 1)
        return np.concatenate([ss, ss[later], linear[later], hidden[later]], axis=1)

    def rate(self, y: FloatArray, drive: FloatArray) -> FloatArray:
        """Rates (..., outputs) at `y` under `drive`, for one step of the network."""
        weights, scale, count = self._weights, self.narx.output_scaling.scale, y.shape[-1]
        left = (drive[..., :count] - y) / scale
        active = np.tanh(drive[..., 3 * count :] + left @ weights.w1y.T)
        after = drive[..., 2 * count : 3 * count] + left @ weights.ay.T + active @ weights.w2.T
        after = np.minimum(np.maximum(after, weights.low), weights.high)
        return np.asarray((drive[..., count : 2 * count] - after * scale - y) / self.dt_s)

    def free_run(self, flights: Flights) -> FloatArray:
        """Its own outputs (flights, time, outputs) from each flight's first sample on."""
        drive, y = self.drive(flights.u), flights.y.copy()
        for k in range(y.shape[1] - 1):
            y[:, k + 1] = y[:, k] + self.dt_s * self.rate(y[:, k], drive[:, k])
        return y

    def errors(self, flights: Flights) -> FloatArray:
        """RMSE (outputs,) of the free run over whole flights."""
        wrong = self.free_run(flights) - flights.y
        rows = [e[:n] for e, n in zip(wrong, flights.lengths.tolist(), strict=True)]
        return np.asarray(np.sqrt(np.mean(np.concatenate(rows) ** 2, axis=0)))


def _features(ss: FloatArray, schedule: FloatArray) -> FloatArray:
    """Increments of the steady outputs, which move; the steady outputs, and the conditions."""
    return np.concatenate([np.diff(ss, axis=0, prepend=ss[:1]), ss, schedule], axis=1)


def fit_emulator(flights: Flights, hidden: int = 8, seed: int = 0) -> NarxEmulator:
    """Train on the simulated flights themselves.

    Raises `DataError` where they hold too little at rest to fit a steady state to.
    """
    signals = flights.signals
    settled = fit_settled(flights)
    schedule = [signals.u(name) for name in CONDITIONS if name in signals.active]
    records = [
        _record(settled, u[:n], y[:n], schedule)
        for u, y, n in zip(flights.u, flights.y, flights.lengths.tolist(), strict=True)
    ]
    count = len(signals.outputs)
    rest = rest_records(records, count, round(_REST_S / signals.dt_s), seed)
    structure = NarxConfig(lags=1, taps=(0,), hidden=hidden, margin=_MARGIN, moving=count)
    material = Material(records, [], signals.dt_s, rest)
    fitted = fit_narx(material, structure, _training(seed))
    return NarxEmulator(settled, fitted.model, tuple(schedule), signals.dt_s)


def _record(settled: SettledModel, u: FloatArray, y: FloatArray, schedule: Sequence[int]) -> Record:
    ss = settled.outputs(u)
    return Record(_features(ss, u[:, list(schedule)]), ss - y, "simulated flight")


def _training(seed: int) -> TrainConfig:
    return TrainConfig(decay=1e-5, iterations=(10, 15), seed=seed, threads=1, local_trim=False)
