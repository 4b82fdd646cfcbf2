"""One engine of a replay: inputs held over gaps, the model stepped, its prediction fused."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from narxcal.errors import DataError
from narxcal.fuser import NoiseModel, estimate_noise
from narxcal.fuser_fast import FastFuser
from narxcal.fuser_noise import MIN_SAMPLES

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from data_prep.log import FloatArray
    from data_prep.raster_stream import Piece
    from eval.replay_setup import ReplayModel, ReplayOptions

    BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Rows:
    """Finished samples: `time_s` `(time,)`, the three results `(time, n_out)`, flags `(time,)`."""

    time_s: FloatArray
    prediction: FloatArray
    fused: FloatArray
    innovation: FloatArray
    inside: BoolArray
    held: BoolArray
    gap: BoolArray


@dataclass(frozen=True, eq=False)
class _Predicted:
    """Samples that wait for the fuser; `runs` are (start, stop, fresh) without a break inside."""

    piece: Piece
    measured: FloatArray
    prediction: FloatArray
    runs: list[tuple[int, int, bool]]
    inside: BoolArray
    held: BoolArray
    gap: BoolArray


class EngineReplay:
    """Feeds the pieces of one engine's log through a calibration and a fuser of its own.

    A missing input keeps its last value up to `hold_s`; after that there is no prediction until
    all inputs are back, and the model starts anew there, as it does after a gap of the log.
    """

    def __init__(self, model: ReplayModel, options: ReplayOptions, engine: str, file: str) -> None:
        # A copy: each engine has a register of its own.
        self._calibration = calibration = model.calibration.for_engine(engine)
        self._model = model
        self._options = options
        self._file = file
        self._inputs = tuple(calibration.input_names)
        self.outputs = tuple(calibration.output_names)
        steady = calibration.steady.input_names
        self._steady = [self._inputs.index(name) for name in steady]
        self._hold_samples = round(options.hold_s / calibration.dt_s)
        self._carried = np.full(len(self._inputs), np.nan)
        self._age = np.zeros(len(self._inputs), dtype=np.intp)
        self._running = self._begun = False
        self._waiting: list[_Predicted] = []
        stored = model.noise if options.stored_noise else None
        self.fuser = None if stored is None else FastFuser(stored, model.fuser)
        self._fusable = np.ones(len(self.outputs), dtype=np.bool_)
        self._held = np.zeros(len(self._inputs), dtype=np.int64)
        self._drawn: dict[str, int] = {}
        self._samples = 0
        self.restarts = self.outside = 0

    @property
    def held(self) -> dict[str, int]:
        """Samples at which an input's last value stood in."""
        return {name: int(n) for name, n in zip(self._inputs, self._held, strict=True) if n}

    @property
    def slow(self) -> dict[str, float]:
        """Mean time in s between two measurements of a channel slower than the model's raster."""
        return {
            name: self._calibration.dt_s * self._samples / (self._samples - drawn)
            for name, drawn in self._drawn.items()
            if drawn
        }

    @property
    def gated(self) -> dict[str, int]:
        """Measurements that the fuser refused."""
        counts = self.fuser.gated_samples if self.fuser else np.zeros(len(self.outputs))
        return {name: int(n) for name, n in zip(self.outputs, counts, strict=True)}

    @property
    def unfused(self) -> tuple[str, ...]:
        """Outputs that were not measured well enough to know their noise."""
        known = zip(self.outputs, self._fusable, strict=True)
        return tuple(name for name, fusable in known if not fusable)

    def feed(self, pieces: Sequence[Piece], *, last: bool = False) -> list[Rows]:
        """Finished samples; none while the noise is still being estimated."""
        self._waiting += [self._predict(piece) for piece in pieces]
        seconds = sum(len(each.held) for each in self._waiting) * self._calibration.dt_s
        if self.fuser is None and self._waiting and (last or seconds >= self._options.warmup_s):
            self.fuser = FastFuser(self._noise(), self._model.fuser)
        if self.fuser is None:
            return []
        ready, self._waiting = self._waiting, []
        return [self._fuse(each, self.fuser) for each in ready]

    def _matrix(self, piece: Piece, names: Sequence[str]) -> FloatArray:
        missing = np.full(len(piece.time_s), np.nan)
        return np.column_stack([piece.channels.get(name, missing) for name in names])

    def _measured(self, piece: Piece) -> FloatArray:
        """Outputs (time, n_out), NaN where nothing was measured: a straight line tells no news."""
        never = np.zeros(len(piece.time_s), dtype=np.bool_)
        self._samples += len(never)
        for name in (*self._inputs, *self.outputs):
            self._drawn[name] = self._drawn.get(name, 0) + int(piece.drawn.get(name, never).sum())
        between = np.column_stack([piece.drawn.get(name, never) for name in self.outputs])
        return np.where(between, np.nan, self._matrix(piece, self.outputs))

    def _predict(self, piece: Piece) -> _Predicted:
        for name in self._inputs:
            if name not in piece.channels:
                raise DataError(
                    "the model needs this input, and the log neither has nor implies it",
                    file=self._file,
                    channel=name,
                    hint=f"The log has {', '.join(piece.channels)}",
                )
        if piece.starts:
            self._carried[:], self._running = np.nan, False
        inputs, held, alive = self._hold(self._matrix(piece, self._inputs))
        measured = self._measured(piece)
        prediction = np.full(measured.shape, np.nan)
        gap = ~alive
        runs = list(self._runs(alive))
        for start, stop, fresh in runs:
            if fresh:
                prediction[start] = self._reset(inputs[start], measured[start])
                gap[start] = self._begun
                self.restarts += self._begun
                self._begun = True
            if start + fresh < stop:
                rest = slice(start + fresh, stop)
                prediction[rest] = self._calibration.extend(inputs[rest])
        inside = alive & self._calibration.steady.inside(inputs[:, self._steady])
        self.outside += int((alive & ~inside).sum())
        return _Predicted(piece, measured, prediction, runs, inside, held & alive, gap)

    def _hold(self, inputs: FloatArray) -> tuple[FloatArray, BoolArray, BoolArray]:
        """Fill inputs with their last values; say where that was done, and where it may be."""
        rows = np.vstack([self._carried, inputs])
        count = np.arange(len(rows))[:, None]
        at = np.maximum.accumulate(np.where(np.isfinite(rows), count, 0), axis=0)
        age = (count - at + np.where(at == 0, self._age, 0))[1:]
        filled = np.take_along_axis(rows, at, axis=0)[1:]
        alive: BoolArray = (np.isfinite(filled) & (age <= self._hold_samples)).all(axis=1)
        self._carried, self._age = filled[-1].copy(), age[-1]
        self._held += ((age > 0) & alive[:, None]).sum(axis=0)
        held = np.asarray((age > 0).any(axis=1))
        return filled, held, alive

    def _runs(self, alive: BoolArray) -> Iterator[tuple[int, int, bool]]:
        """Stretches the model can run, and whether it starts anew there."""
        edges = np.flatnonzero(np.diff(np.concatenate([[False], alive, [False]]).astype(np.int8)))
        for start, stop in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
            yield start, stop, start > 0 or not self._running
        self._running = bool(alive[-1])

    def _reset(self, inputs: FloatArray, measured: FloatArray) -> FloatArray:
        known = self._options.start == "measured" and bool(np.isfinite(measured).all())
        return self._calibration.reset(inputs, measured if known else None)

    def _noise(self) -> NoiseModel:
        """Estimate the noise from what waits; a channel hardly ever measured is left out."""
        records: list[tuple[list[FloatArray], list[FloatArray]]] = []
        for each in self._waiting:
            for start, stop, fresh in each.runs:
                if fresh or not records:
                    records.append(([], []))
                records[-1][0].append(each.measured[start:stop])
                records[-1][1].append(each.prediction[start:stop])
        measured = [np.concatenate(z) for z, _ in records]
        predicted = [np.concatenate(p) for _, p in records]
        seen = sum((np.isfinite(z).sum(axis=0) for z in measured), np.zeros(len(self.outputs)))
        self._fusable = seen >= MIN_SAMPLES
        fit = np.flatnonzero(self._fusable)
        found = _blind(len(self.outputs), self._calibration.dt_s)
        if not len(fit):
            return found
        part = estimate_noise(
            [z[:, fit] for z in measured], [p[:, fit] for p in predicted], found.dt_s
        )
        for name in ("retention", "process", "motion", "linger", "measurement", "spread"):
            getattr(found, name)[fit] = getattr(part, name)
        if self._model.noise is None:
            return found
        return self._with_stored(self._model.noise, found)

    def _with_stored(self, stored: NoiseModel, found: NoiseModel) -> NoiseModel:
        """The log's own sensors beside the model's errors as the bundle knows them.

        Those are of steps of the raster. Errors of a model go on in one direction for a while, so
        that over the longer way to the next measurement of a slow channel they grow by more than
        such steps add up to: what its own measurements say holds there.
        """
        slow = np.array([name in self.slow for name in self.outputs])
        parts = {
            name: np.where(slow, getattr(found, name), getattr(stored, name))
            for name in ("retention", "process", "motion", "linger", "spread")
        }
        return replace(stored, measurement=found.measurement, **parts)

    def _fuse(self, each: _Predicted, fuser: FastFuser) -> Rows:
        measured = np.where(self._fusable, each.measured, np.nan)
        fused = np.full(measured.shape, np.nan)
        innovation = fused.copy()
        for start, stop, fresh in each.runs:
            fuse = fuser.run if fresh else fuser.extend
            result = fuse(each.prediction[start:stop], measured[start:stop])
            fused[start:stop], innovation[start:stop] = result.values, result.innovations
        return Rows(
            each.piece.time_s, each.prediction, fused, innovation, each.inside, each.held, each.gap
        )


def _blind(n_out: int, dt_s: float) -> NoiseModel:
    """Noise with which a fuser repeats the prediction, as it must where nothing was measured."""
    zero = [np.zeros(n_out) for _ in range(5)]
    return NoiseModel(
        dt_s,
        retention=zero[0],
        process=zero[1],
        motion=zero[2],
        linger=zero[3],
        measurement=np.ones(n_out),
        spread=zero[4],
        correlation=np.eye(n_out),
    )
