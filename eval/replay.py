"""Replay: a flight streamed through model and fuser, sample by sample, as on line.

`replay` reads a log as a stream, puts each engine's rows on the model's sampling grid, runs one
`EngineReplay` per engine over them and writes the results as CSV.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from statistics import NormalDist
from typing import Any, Literal, Self, TextIO

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from data_prep.cleaning.faults import out_of_range
from data_prep.config import LogsConfig
from data_prep.log import Finding
from data_prep.sources.csv_source import Pace
from data_prep.sources.log_file import open_log
from data_prep.sources.stream import Piece
from narxcal.calibration.bundle import Bundle
from narxcal.calibration.calibration import Calibration
from narxcal.calibration.fuser import FastFuser
from narxcal.calibration.fuser_config import FuserConfig
from narxcal.calibration.noise import MIN_SAMPLES, STORED, NoiseModel, estimate_noise
from narxcal.channels import described
from narxcal.intervals import LEVEL, LEVELS
from narxcal.support.arrays import BoolArray, FloatArray, last_true, spans
from narxcal.support.csv_text import TIME_FORMAT
from narxcal.support.errors import ConfigError, DataError
from narxcal.support.files import atomic_stream
from narxcal.support.interrupt import held_interrupt
from narxcal.support.settings import Section

# At full speed rows can wait until the next measurement of a slow channel is known.
# Rows per sample of the model, half of what minutes read as seconds give.
_CROWDED = 30
_LOOK_AHEAD_S = 5.0


class ReplayOptions(Section):
    """How to replay.

    `engine` picks one of several engines; else all are replayed. A missing input keeps its last
    value up to `hold_s`. `start` says where the model begins after a gap: in equilibrium, or at the
    measured outputs. With `follow` a growing file is read until it has not grown for `idle_s`.

    Live, the noise is that of the bundle. At full speed the sensors' is estimated from the first
    `warmup_s` of the log itself, and the model's is that of the bundle, which was estimated from
    whole flights. For a bundle without noise both are estimated from the log, which delays the
    output so long. `interval` is the share of samples that the intervals cover, that of the free
    run only where the bundle has one.
    """

    engine: str | None = None
    realtime: bool = False
    follow: bool = False
    idle_s: float = Field(default=10.0, gt=0.0)
    hold_s: float = Field(default=2.0, ge=0.0)
    start: Literal["steady", "measured"] = "steady"
    warmup_s: float = Field(default=300.0, gt=0.0)
    interval: float = Field(default=LEVEL, ge=LEVELS[0], le=LEVELS[-1])

    @property
    def live(self) -> bool:
        """Whether rows are written as soon as they are known."""
        return self.realtime or self.follow


@dataclass(frozen=True)
class ReplayModel:
    """What a replay needs of a bundle: the model, the columns of its logs, and the fuser.

    `findings` are those of the log; a channel counts as not measured where one masks it.
    """

    calibration: Calibration
    logs: LogsConfig = field(default_factory=LogsConfig)
    fuser: FuserConfig = field(default_factory=FuserConfig)
    noise: NoiseModel | None = None
    findings: tuple[Finding, ...] = ()

    @classmethod
    def of(cls, bundle: Bundle) -> Self:
        """Read tables `logs` and `fuser` of the configuration, and the noise for the fuser."""
        config = bundle.record.config
        return cls(
            bundle.calibration,
            LogsConfig.parse(config.get("logs", {})).for_inputs(bundle.calibration.input_names),
            FuserConfig.parse(config.get("fuser", {})),
            bundle.record.noise,
        )


@dataclass(frozen=True, eq=False)
class Rows:
    """Samples of one engine, `(time,)` or `(time, n_out)`; NaN until they are fused.

    `valid` (time, n_out) is true where the inputs were measured and no fault masks the output,
    `half_width` (time, n_out) that of the interval of the prediction, NaN without one,
    `fused_half_width` that of the fused value, by the filter's variance, NaN where none is fused.

    `runs` are (start, stop, fresh) without a gap inside; with `fresh` the model starts anew.
    """

    time_s: FloatArray
    measured: FloatArray
    prediction: FloatArray
    fused: FloatArray
    innovation: FloatArray
    inside: BoolArray
    held: BoolArray
    gap: BoolArray
    valid: BoolArray
    half_width: FloatArray
    fused_half_width: FloatArray
    runs: list[tuple[int, int, bool]]


class EngineReplay:
    """One engine: run the pieces of its log through a calibration and a fuser of its own.

    A missing input keeps its last value up to `hold_s`; after that there is no prediction until
    all inputs are back, and the model starts anew there, as it does after a gap of the log.
    """

    def __init__(self, model: ReplayModel, options: ReplayOptions, engine: str, file: str) -> None:
        calibration = model.calibration.for_engine(engine, or_mean=True)  # with its own register
        self._calibration = calibration
        self._model, self._options, self._file = model, options, file
        self._inputs = tuple(calibration.input_names)
        self.outputs = tuple(calibration.output_names)
        self._steady = [self._inputs.index(name) for name in calibration.steady.input_names]
        self._longest = round(options.hold_s / calibration.dt_s)  # samples
        self._last = np.full(len(self._inputs), np.nan)  # last known inputs, and samples since
        self._age = np.zeros(len(self._inputs), dtype=np.intp)
        self._running = self._begun = False
        self._waiting: list[Rows] = []
        self._findings = [one for one in model.findings if one.masks and one.engine == engine]
        stored = model.noise if options.live else None
        self.fuser = None if stored is None else FastFuser(stored, model.fuser)
        self._fusable = np.ones(len(self.outputs), dtype=np.bool_)
        self._held = np.zeros(len(self._inputs), dtype=np.int64)
        self._interpolated: dict[str, int] = {}
        self._samples = 0
        # By missing input, samples at which the model could not run.
        self._lost = np.zeros(len(self._inputs), dtype=np.int64)
        self.restarts = self.outside = 0

    @property
    def lost(self) -> dict[str, int]:
        """Input -> samples at which the model could not run for want of it."""
        return _counted(self._inputs, self._lost)

    @property
    def held(self) -> dict[str, int]:
        """Input -> samples at which its last value was used."""
        return _counted(self._inputs, self._held)

    @property
    def slow(self) -> dict[str, float]:
        """Channel slower than the sampling grid -> mean time between two measurements in s."""
        return {
            name: self._calibration.dt_s * self._samples / (self._samples - interpolated)
            for name, interpolated in self._interpolated.items()
            if interpolated
        }

    @property
    def gated(self) -> dict[str, int]:
        """Output -> measurements that the fuser rejected as outliers."""
        counts = self.fuser.gated_samples if self.fuser else np.zeros(len(self.outputs))
        return {name: int(n) for name, n in zip(self.outputs, counts, strict=True)}

    @property
    def unfused(self) -> tuple[str, ...]:
        """Outputs with too few measurements to estimate their noise."""
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
        return np.column_stack(
            [
                np.where(self._faulty(piece, name), np.nan, piece.channels.get(name, missing))
                for name in names
            ]
        )

    def _faulty(self, piece: Piece, name: str) -> BoolArray:
        """Where a fault masks a channel, or its values are physically impossible (time,)."""
        bad = np.zeros(len(piece.time_s), dtype=np.bool_)
        if name in piece.channels:
            bad |= out_of_range(
                self._model.logs.declared.get(name) or described(name), piece.channels[name]
            )
        for one in self._findings:
            if name == one.channel:
                bad |= one.rows(piece.time_s)
        return bad

    def _measured(self, piece: Piece) -> FloatArray:
        """Outputs (time, n_out), NaN where not measured: interpolated values are no information."""
        never = np.zeros(len(piece.time_s), dtype=np.bool_)
        self._samples += len(never)
        for name in (*self._inputs, *self.outputs):
            flags = piece.interpolated.get(name, never)
            self._interpolated[name] = self._interpolated.get(name, 0) + int(flags.sum())
        between = np.column_stack([piece.interpolated.get(name, never) for name in self.outputs])
        return np.where(between, np.nan, self._matrix(piece, self.outputs))

    def _predict(self, piece: Piece) -> Rows:
        for name in self._inputs:
            if name not in piece.channels:
                raise DataError(
                    "the model needs this input, and the log neither has nor implies it",
                    file=self._file,
                    channel=name,
                    hint=f"The log has {', '.join(piece.channels)}",
                )
        if piece.starts:
            self._last[:], self._running = np.nan, False
        given = self._matrix(piece, self._inputs)
        inputs, held, alive = self._filled(given)
        self._lost += (~np.isfinite(given) & ~alive[:, None]).sum(axis=0)
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
        blank = np.full(measured.shape, np.nan)
        faulty = np.column_stack([self._faulty(piece, name) for name in self.outputs])
        valid = np.isfinite(prediction) & ~faulty & ~held[:, None]
        half = self._half_width(inputs, prediction, alive)
        return Rows(
            piece.time_s, measured, prediction, blank, blank, inside, held & alive, gap, valid,
            half, blank, runs,
        )  # fmt: skip

    def _half_width(
        self, inputs: FloatArray, prediction: FloatArray, alive: BoolArray
    ) -> FloatArray:
        half = np.full(prediction.shape, np.nan)
        if self._calibration.interval is not None and alive.any():
            half[alive] = self._calibration.half_width(
                inputs[alive], prediction[alive], self._options.interval
            )
        return half

    def _filled(self, inputs: FloatArray) -> tuple[FloatArray, BoolArray, BoolArray]:
        """Inputs filled with their last values, where that was done, and where all are usable."""
        rows = np.vstack([self._last, inputs])
        at = np.maximum(last_true(np.isfinite(rows)), 0)
        age = (np.arange(len(rows))[:, None] - at + np.where(at == 0, self._age, 0))[1:]
        filled = np.take_along_axis(rows, at, axis=0)[1:]
        alive: BoolArray = (np.isfinite(filled) & (age <= self._longest)).all(axis=1)
        self._last, self._age = filled[-1].copy(), age[-1]
        self._held += ((age > 0) & alive[:, None]).sum(axis=0)
        held = np.asarray((age > 0).any(axis=1))
        return filled, held, alive

    def _runs(self, alive: BoolArray) -> Iterator[tuple[int, int, bool]]:
        """Runs of usable inputs, and whether the model starts anew there."""
        for start, stop in spans(alive):
            yield start, stop, start > 0 or not self._running
        self._running = bool(alive[-1])

    def _reset(self, inputs: FloatArray, measured: FloatArray) -> FloatArray:
        known = self._options.start == "measured" and bool(np.isfinite(measured).all())
        return self._calibration.reset(inputs, measured if known else None)

    def _noise(self) -> NoiseModel:
        """Estimate the noise from the waiting samples, channels with too few of them left out."""
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
        found = _no_fusion(len(self.outputs), self._calibration.dt_s)
        if not len(fit):
            return found
        part = estimate_noise(
            [z[:, fit] for z in measured], [p[:, fit] for p in predicted], found.dt_s
        )
        for name in STORED:
            getattr(found, name)[fit] = getattr(part, name)
        if self._model.noise is None:
            return found
        return self._with_stored(self._model.noise, found)

    def _with_stored(self, stored: NoiseModel, found: NoiseModel) -> NoiseModel:
        """Sensor noise from the log, model errors from the bundle.

        The bundle's model errors are per sample. They are correlated over time, so that over the
        many samples between two measurements of a slow channel they grow by more than independent
        steps would: for slow channels those estimated from the log are used.
        """
        slow = np.array([name in self.slow for name in self.outputs])
        parts = {
            name: np.where(slow, getattr(found, name), getattr(stored, name))
            for name in STORED
            if name != "measurement_variance"
        }
        return replace(stored, measurement_variance=found.measurement_variance, **parts)

    def _fuse(self, rows: Rows, fuser: FastFuser) -> Rows:
        measured = np.where(self._fusable, rows.measured, np.nan)
        fused, innovation = rows.fused.copy(), rows.innovation.copy()
        half = rows.fused_half_width.copy()
        z = NormalDist().inv_cdf(0.5 + 0.5 * self._options.interval)
        for start, stop, fresh in rows.runs:
            fuse = fuser.run if fresh else fuser.extend
            result = fuse(rows.prediction[start:stop], measured[start:stop])
            fused[start:stop], innovation[start:stop] = result.values, result.innovations
            half[start:stop] = np.where(self._fusable, z * np.sqrt(result.variances), np.nan)
        return replace(rows, fused=fused, innovation=innovation, fused_half_width=half)


def _counted(names: Sequence[str], counts: NDArray[np.int64]) -> dict[str, int]:
    return {name: int(count) for name, count in zip(names, counts, strict=True) if count}


def _no_fusion(n_out: int, dt_s: float) -> NoiseModel:
    """Noise with which a fuser repeats the prediction, for outputs that are not measured."""
    zero = {name: np.zeros(n_out) for name in STORED}
    return NoiseModel(dt_s, **{**zero, "measurement_variance": np.ones(n_out)})


MOST_BLANK = 0.1  # share of rows without a prediction from which on a replay is no result


@dataclass(frozen=True)
class ReplaySummary:
    """What a replay did.

    | field | meaning |
    |---|---|
    | `held` | engine -> input -> samples at which its last value was used |
    | `restarts` | engine -> gaps after which the model began anew |
    | `blank` | engine -> input that is missing -> samples at which the model could not run |
    | `outside` | engine -> samples outside the steady-state model's envelope |
    | `gated` | engine -> output -> measurements that the fuser rejected |
    | `unfused` | engine -> outputs with too few measurements to fuse |
    | `slow` | engine -> channel slower than the sampling grid -> s between measurements |
    | `read` | rows of the file, those of all engines together |
    | `dropped` | rows without a usable time stamp |
    | `truncated` | the file ends in mid-line, and that line was left out |
    | `faults` | faults of the log, as in `evaluate.json` |

    Inputs are interpolated between slow measurements; outputs are not fused there.
    """

    rows: int
    engines: tuple[str, ...]
    log_s: float
    wall_s: float
    held: dict[str, dict[str, int]]
    restarts: dict[str, int]
    blank: dict[str, dict[str, int]]
    outside: dict[str, int]
    gated: dict[str, dict[str, int]]
    unfused: dict[str, tuple[str, ...]]
    slow: dict[str, dict[str, float]]
    dropped: int
    truncated: bool
    findings: tuple[Finding, ...] = ()
    read: int = 0

    @property
    def times_real_time(self) -> float:
        """Seconds of log per second of replay, all engines together."""
        return self.log_s / self.wall_s if self.wall_s > 0.0 else float("inf")

    @property
    def missed(self) -> list[str]:
        """Why too many rows are blank for the output to be one; empty where it is."""
        found = []
        for engine, lost in self.blank.items():
            share = max(lost.values(), default=0) * len(self.engines) / max(self.rows, 1)
            if share > MOST_BLANK:
                name = max(lost, key=lambda each: lost[each])
                found.append(
                    f"{f'{engine}: ' if engine else ''}the model could not run at "
                    f"{100.0 * share:.0f} % of the samples, for {name} is missing or out of its "
                    "physical range: check its column and unit under [logs.columns]"
                )
        return found

    @property
    def cautions(self) -> list[str]:
        """Findings, and slow channels; ambient ones change slowly, and nothing is lost there."""
        texts = [each.caution for each in self.findings]
        for engine, slow in self.slow.items():
            named = [
                f"{name} about every {every_s:.2g} s"
                for name, every_s in slow.items()
                if described(name).role != "ambient"
            ]
            if named:
                texts.append(
                    f"{f'{engine}: ' if engine else ''}sampled more coarsely than the model's grid "
                    f"are {', '.join(named)}: outputs are fused only where they were measured, "
                    "inputs are interpolated between"
                )
        if self.read > _CROWDED * max(self.rows, 1):
            texts.append(
                f"{self.read} rows of the log are {self.log_s:.3g} s, {self.rows} samples of the "
                "model: are its stamps seconds? Set unit of time_s under [logs.columns]"
            )
        return texts

    def to_dict(self) -> dict[str, Any]:
        return {
            **asdict(self), "missed": self.missed,
            "findings": [each.row() for each in self.findings],
            "times_real_time": self.times_real_time, "cautions": self.cautions
        }  # fmt: skip


@dataclass(frozen=True)
class Clock:
    """Wall time and waiting; tests replace it."""

    now: Callable[[], float] = time.monotonic
    sleep: Callable[[float], None] = time.sleep


def replay(
    model: ReplayModel,
    log: str | Path,
    out: str | Path,
    options: ReplayOptions | None = None,
    clock: Clock | None = None,
) -> ReplaySummary:
    """Stream `log` through model and fuser, and write the CSV `out`.

    | column | meaning |
    |---|---|
    | `time_s` | time on the model's sampling grid, as of `data_prep.read_logs` |
    | `engine` | its name, where several are replayed |
    | `X_free_run` | free run of output X, from inputs up to and including this sample |
    | `X_free_run_low`, `X_free_run_high` | its interval, where the bundle has one |
    | `X_fused` | free run and measurement merged |
    | `X_fused_low`, `X_fused_high` | its interval, by the fuser's variance |
    | `X_innovation` | measured minus expected, blank where not measured or only interpolated |
    | `inside_envelope` | 1 inside the envelope of the steady-state model |
    | `held` | 1 where the last value of a missing input was used |
    | `gap` | 1 where the model started anew, or, with blank predictions, could not run |
    | `X_valid` | 1 where all inputs were measured and no fault masks output X |

    `OUT` appears when all rows are there; live, they can be read in `OUT.part` as they come. Ctrl-C
    ends a `follow` with the rows so far, and any other replay with no file.

    Raises `DataError` for the log, `ConfigError` for options or an output that cannot be written.
    """
    return _Replay(model, Path(log), options or ReplayOptions(), clock or Clock()).write(Path(out))


class _Replay:
    def __init__(self, model: ReplayModel, log: Path, options: ReplayOptions, clock: Clock) -> None:
        self.options = options
        self.model = model
        self.clock = clock
        self.pace = Pace(
            lines=1 if options.realtime else 4096,
            live=True,
            follow=options.follow,
            idle_s=options.idle_s,
            clock=clock.now,
            sleep=clock.sleep,
        )
        self.file = open_log(log, model.logs)
        names = self._engines(log)
        self.engines = {name: EngineReplay(model, options, name, str(log)) for name in names}
        ahead = 0.0 if options.live else _LOOK_AHEAD_S
        dt_s = model.calibration.dt_s
        self.streams = {name: self.file.stream(dt_s, ahead) for name in names}
        self.outputs = tuple(model.calibration.output_names)
        self.rows = self.read = 0
        self._first_s: float | None = None
        self._began = clock.now()

    @property
    def _has_interval(self) -> bool:
        return self.model.calibration.interval is not None

    def _engines(self, log: Path) -> tuple[str, ...]:
        known = self.file.engines
        if self.options.engine is None:
            return known
        if self.options.engine not in known:
            listed = ", ".join(name for name in known if name)
            raise ConfigError(
                f"unknown engine '{self.options.engine}'",
                file=log,
                hint=f"Its engines: {listed}" if listed else "It holds one engine, without a name",
            )
        return (self.options.engine,)

    def write(self, out: Path) -> ReplaySummary:
        with atomic_stream(out, live=self.options.live) as file:
            self._write_all(file)
        return self._summary()

    def _write_all(self, file: TextIO) -> None:
        file.write(",".join(self._header()) + "\n")
        if not self.options.follow:
            self._write_rows(file)
            return
        with held_interrupt() as interrupt:
            self.pace.stop = lambda: interrupt.requested
            self._write_rows(file)

    def _write_rows(self, file: TextIO) -> None:
        for rows in self._samples():
            self._emit(file, rows)

    def _header(self) -> list[str]:
        band = ("free_run_low", "free_run_high") if self._has_interval else ()
        parts = ("free_run", *band, "fused", "fused_low", "fused_high", "innovation")
        per_channel = [f"{name}_{part}" for name in self.outputs for part in parts]
        engine = ["engine"] if len(self.engines) > 1 else []
        valid = [f"{name}_valid" for name in self.outputs]
        return ["time_s", *engine, *per_channel, "inside_envelope", "held", "gap", *valid]

    def _samples(self) -> Iterator[dict[str, list[Rows]]]:
        """Finished rows per engine, as they become certain."""
        names = tuple(self.engines)
        for block in self.file.blocks(names, self.pace):
            self.read += sum(len(rows["time_s"]) for rows in block.values())
            yield {
                name: self.engines[name].feed(list(self.streams[name].push(block[name])))
                for name in names
            }
        yield {
            name: self.engines[name].feed(list(self.streams[name].push({}, last=True)), last=True)
            for name in names
        }
        if not any(stream.samples for stream in self.streams.values()):
            raise DataError(
                "expected samples at two or more times", file=self.file.path, channel="time_s"
            )

    def _emit(self, file: TextIO, rows: dict[str, list[Rows]]) -> None:
        """Write one block, rows of several engines in order of time."""
        lines: list[tuple[float, str]] = []
        for name, parts in rows.items():
            for part in parts:
                lines += self._lines(part, name if len(self.engines) > 1 else None)
        if len(rows) > 1:
            lines.sort(key=lambda line: line[0])
        self.rows += len(lines)
        if not self.options.realtime:
            file.write("".join(text for _, text in lines))
        for at, text in lines if self.options.realtime else ():
            self._wait(at)
            file.write(text)
            file.flush()
        if self.options.follow:
            file.flush()

    def _lines(self, rows: Rows, engine: str | None) -> list[tuple[float, str]]:
        free, fused, half = rows.prediction, rows.fused, rows.fused_half_width
        band = [free - rows.half_width, free + rows.half_width] if self._has_interval else []
        parts = [free, *band, fused, fused - half, fused + half, rows.innovation]
        results = np.stack(parts, axis=2).reshape(len(rows.time_s), -1)
        table = np.column_stack([rows.time_s, results]).tolist()
        flags = np.column_stack([rows.inside, rows.held, rows.gap, rows.valid]).astype(int)
        form = ",".join([TIME_FORMAT, *([engine] if engine else []), *["%.10g"] * results.shape[1]])
        tail = ",%d" * flags.shape[1] + "\n"
        return [
            (row[0], (form % tuple(row)).replace("nan", "") + tail % tuple(flag))
            for row, flag in zip(table, flags.tolist(), strict=True)
        ]

    def _wait(self, at_s: float) -> None:
        """Sleep until the wall clock has advanced as far as the log."""
        if self._first_s is None:
            self._first_s, self._began = at_s, self.clock.now()
        ahead = (at_s - self._first_s) - (self.clock.now() - self._began)
        if ahead > 0.0:
            self.clock.sleep(ahead)

    def _summary(self) -> ReplaySummary:
        names = ("held", "restarts", "lost", "outside", "gated", "unfused", "slow")
        of = {
            name: {engine: getattr(one, name) for engine, one in self.engines.items()}
            for name in names
        }
        return ReplaySummary(
            rows=self.rows,
            engines=tuple(self.engines),
            log_s=self.rows * next(iter(self.streams.values())).dt_s,
            wall_s=self.clock.now() - self._began,
            blank=of.pop("lost"),
            **of,
            dropped=sum(stream.dropped for stream in self.streams.values()),
            truncated=self.file.truncated,
            findings=self.model.findings,
            read=self.read,
        )
