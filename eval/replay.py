"""Replay: a flight streamed through model and fuser, sample by sample, as on line.

`replay` reads a log as a stream, puts each engine's rows on the model's sampling grid, runs one
`EngineReplay` per engine over them and writes the results as CSV.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from statistics import NormalDist
from typing import Any, Self, TextIO

import numpy as np

from data_prep.cleaning.faults import out_of_range
from data_prep.config import LogsConfig
from data_prep.log import Finding
from data_prep.sources.csv_source import Pace
from data_prep.sources.log_file import Rows, open_log
from data_prep.sources.stream import Piece
from narxcal.calibration.bundle import Bundle
from narxcal.calibration.calibration import Calibration
from narxcal.calibration.fuser import FastFuser
from narxcal.calibration.fuser_config import FuserConfig
from narxcal.calibration.noise import MIN_SAMPLES, STORED, NoiseModel, estimate_noise
from narxcal.channels import described
from narxcal.intervals import LEVEL
from narxcal.support.arrays import BoolArray, FloatArray, IntArray, last_true, spans
from narxcal.support.csv_text import TIME_FORMAT
from narxcal.support.errors import ConfigError, DataError
from narxcal.support.files import atomic_stream
from narxcal.support.interrupt import held_interrupt

# Rows per sample of the model, half of what minutes read as seconds give.
_CROWDED = 30
# At full speed rows can wait until the next measurement of a slow channel is known.
_LOOK_AHEAD_S = 5.0
_HOLD_S = 2.0  # a missing input keeps its last value so long
_WARMUP_S = 300.0  # of a log from which noise is estimated


@dataclass(frozen=True)
class ReplayOptions:
    """How to replay.

    `engine` picks one of several engines; else all are replayed. With `follow` a growing file is
    read until it has not grown for `idle_s`. `interval` is the share of samples that the intervals
    cover, that of the free run only where the bundle has one.

    Live, the noise is that of the bundle. At full speed the sensors' is estimated from the start of
    the log itself, and the model's is that of the bundle, which was estimated from whole flights.
    For a bundle without noise both are estimated from the log, which delays the output so long.
    """

    engine: str | None = None
    realtime: bool = False
    follow: bool = False
    idle_s: float = 10.0
    interval: float = LEVEL

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
class Filled:
    """Inputs (time, n_in), `age` samples old; `alive` (time,) where the model can run by them."""

    inputs: FloatArray
    age: IntArray
    alive: BoolArray

    @classmethod
    def nothing(cls, inputs: int) -> Self:
        """As before the first sample."""
        age = np.zeros((1, inputs), dtype=np.int64)
        return cls(np.full((1, inputs), np.nan), age, np.zeros(1, dtype=np.bool_))

    @property
    def held(self) -> BoolArray:
        return np.asarray((self.age > 0).any(axis=1))


@dataclass(frozen=True, eq=False)
class Predicted:
    """Free run of one engine, `(time,)` or `(time, n_out)`; NaN where there is none.

    `valid` is true where the inputs were measured and no fault masks the output, `half_width` that
    of the interval, NaN without one. `runs` are (start, stop, fresh) without a gap inside; with
    `fresh` the model starts anew.
    """

    time_s: FloatArray
    measured: FloatArray
    values: FloatArray
    half_width: FloatArray
    inside: BoolArray
    held: BoolArray
    gap: BoolArray
    valid: BoolArray
    runs: list[tuple[int, int, bool]]


@dataclass(frozen=True, eq=False)
class Fused:
    """Fused values (time, n_out), their innovations, and half-widths by the filter's variance."""

    values: FloatArray
    innovations: FloatArray
    half_width: FloatArray


def fill(given: FloatArray, before: Filled, longest: int) -> Filled:
    """Keep the last value of a missing input (time, n_in) for up to `longest` samples."""
    rows = np.vstack([before.inputs[-1], given])
    at = np.maximum(last_true(np.isfinite(rows)), 0)
    age = (np.arange(len(rows))[:, None] - at + np.where(at == 0, before.age[-1], 0))[1:]
    filled = np.take_along_axis(rows, at, axis=0)[1:]
    alive = np.asarray((np.isfinite(filled) & (age <= longest)).all(axis=1))
    return Filled(filled, age, alive)


def fuse(one: Predicted, fuser: FastFuser, fusable: BoolArray, z: float) -> Fused:
    """Merge a free run with the `fusable` (n_out,) outputs; intervals are of `z` deviations."""
    measured = np.where(fusable, one.measured, np.nan)
    values, innovations, half = (np.full(measured.shape, np.nan) for _ in range(3))
    for start, stop, fresh in one.runs:
        extend = fuser.run if fresh else fuser.extend
        found = extend(one.values[start:stop], measured[start:stop])
        values[start:stop], innovations[start:stop] = found.values, found.innovations
        half[start:stop] = np.where(fusable, z * np.sqrt(found.variances), np.nan)
    return Fused(values, innovations, half)


def noise_of(
    some: Sequence[Predicted], stored: NoiseModel | None, slow: BoolArray, dt_s: float
) -> tuple[NoiseModel, BoolArray]:
    """Estimate the noise from free runs; and which outputs (n_out,) have samples enough for that.

    With a `stored` one the sensors' noise is that of the log and the model's that of the bundle.
    The latter is per sample, and correlated over time: over the many samples between two
    measurements of a `slow` output it grows by more than independent steps would, so that there
    the log's is used.
    """
    records: list[list[FloatArray]] = []
    for one in some:
        pair = np.stack([one.measured, one.values])
        for start, stop, fresh in one.runs:
            records += [[]] if fresh else []
            records[-1].append(pair[:, start:stop])
    pairs = [np.concatenate(parts, axis=1) for parts in records]
    seen = sum((np.isfinite(z).sum(axis=0) for z, _ in pairs), np.zeros(len(slow)))
    fusable = np.asarray(seen >= MIN_SAMPLES)
    # Of an output without measurements the fuser repeats the prediction.
    found = {name: np.zeros(len(slow)) for name in STORED}
    found["measurement_variance"] += 1.0
    if fusable.any():
        own = estimate_noise(
            [z[:, fusable] for z, _ in pairs], [p[:, fusable] for _, p in pairs], dt_s
        )
        for name, values in found.items():
            values[fusable] = getattr(own, name)
        if stored is not None:
            for name in found.keys() - {"measurement_variance"}:
                found[name] = np.where(slow, found[name], getattr(stored, name))
    return NoiseModel(dt_s, **found), fusable


class EngineReplay:
    """One engine: run the pieces of its log through a calibration and a fuser of its own.

    A missing input keeps its last value for 2 s; after that there is no prediction until
    all inputs are back, and the model starts anew there, as it does after a gap of the log.
    `counts` are samples by what is counted and of which channel.
    """

    def __init__(self, model: ReplayModel, options: ReplayOptions, engine: str, file: str) -> None:
        self._own = model.calibration.for_engine(engine, or_mean=True)  # with its own register
        self._model, self._options, self._file = model, options, file
        self._findings = [one for one in model.findings if one.masks and one.engine == engine]
        self._filled = Filled.nothing(len(self._own.input_names))
        self._waiting: list[Predicted] = []
        stored = model.noise if options.live else None
        self._fuser = None if stored is None else FastFuser(stored, model.fuser)
        self._fusable = np.ones(len(self._own.output_names), dtype=np.bool_)
        self.counts: Counter[tuple[str, str]] = Counter()

    def summary(self) -> dict[str, Any]:
        """What `ReplaySummary` has by engine."""
        outputs, total = self._own.output_names, self.counts["all", ""]
        gated = self._fuser.gated_samples.tolist() if self._fuser else [0] * len(outputs)
        known = zip(outputs, self._fusable, strict=True)
        return {
            "held": self._counted("held"),
            "restarts": max(self.counts["starts", ""] - 1, 0),
            "blank": self._counted("blank"),
            "outside": self.counts["outside", ""],
            "gated": dict(zip(outputs, gated, strict=True)),
            "unfused": tuple(name for name, fusable in known if not fusable),
            "slow": {
                name: self._own.dt_s * total / (total - between)
                for name, between in self._counted("between").items()
            },
        }

    def _counted(self, what: str) -> dict[str, int]:
        return {name: n for (kind, name), n in self.counts.items() if kind == what and n}

    def _count(self, what: str, names: Sequence[str], flags: BoolArray) -> None:
        """Add up `flags` (time, n) of the first n of `names`."""
        for name, n in zip(names, flags.sum(axis=0).tolist(), strict=False):
            self.counts[what, name] += n

    def feed(self, pieces: Iterable[Piece], *, last: bool = False) -> list[tuple[Predicted, Fused]]:
        """Finished samples; none while the noise is still being estimated."""
        self._waiting += map(self._predict, pieces)
        if not self._waiting:
            return []
        if self._fuser is None:
            seconds = sum(len(each.held) for each in self._waiting) * self._own.dt_s
            if not last and seconds < _WARMUP_S:
                return []
            slow = np.array([self.counts["between", name] > 0 for name in self._own.output_names])
            noise, self._fusable = noise_of(self._waiting, self._model.noise, slow, self._own.dt_s)
            self._fuser = FastFuser(noise, self._model.fuser)
        z = NormalDist().inv_cdf(0.5 + 0.5 * self._options.interval)
        ready, self._waiting = self._waiting, []
        return [(each, fuse(each, self._fuser, self._fusable, z)) for each in ready]

    def _predict(self, piece: Piece) -> Predicted:
        own, names = self._own, (*self._own.input_names, *self._own.output_names)
        inputs = len(own.input_names)
        for name in own.input_names:
            if name not in piece.channels:
                raise DataError(
                    "the model needs this input, and the log neither has nor implies it",
                    file=self._file,
                    channel=name,
                    hint=f"The log has {', '.join(piece.channels)}",
                )
        never, missing = (
            np.zeros(len(piece.time_s), dtype=np.bool_),
            np.full(len(piece.time_s), np.nan),
        )
        faulty = np.column_stack([self._faulty(piece, name) for name in names])
        between = np.column_stack([piece.interpolated.get(name, never) for name in names])
        known = np.column_stack([piece.channels.get(name, missing) for name in names])
        known[faulty] = np.nan
        # Interpolated values are no information about an output.
        given, measured = known[:, :inputs], np.where(between, np.nan, known)[:, inputs:]
        before = Filled.nothing(inputs) if piece.starts else self._filled
        filled = self._filled = fill(given, before, round(_HOLD_S / own.dt_s))
        self._count("held", names, (filled.age > 0) & filled.alive[:, None])
        self._count("blank", names, ~np.isfinite(given) & ~filled.alive[:, None])
        self._count("between", names, between)
        self.counts["all", ""] += len(never)
        valid = ~faulty[:, inputs:] & ~filled.held[:, None]
        return self._free_run(piece.time_s, measured, filled, valid, goes_on=bool(before.alive[-1]))

    def _free_run(
        self,
        time_s: FloatArray,
        measured: FloatArray,
        filled: Filled,
        valid: BoolArray,
        *,
        goes_on: bool,
    ) -> Predicted:
        own, inputs, alive = self._own, filled.inputs, filled.alive
        values, half, gap = np.full(measured.shape, np.nan), np.full(measured.shape, np.nan), ~alive
        runs = [(start, stop, start > 0 or not goes_on) for start, stop in spans(alive)]
        for start, stop, fresh in runs:
            if fresh:
                values[start] = own.reset(inputs[start])
                gap[start] = self.counts["starts", ""] > 0
                self.counts["starts", ""] += 1
            if start + fresh < stop:
                values[start + fresh : stop] = own.extend(inputs[start + fresh : stop])
        steady = [own.input_names.index(name) for name in own.steady.input_names]
        inside = alive & own.steady.inside(inputs[:, steady])
        self.counts["outside", ""] += int((alive & ~inside).sum())
        if own.interval is not None and alive.any():
            half[alive] = own.half_width(inputs[alive], values[alive], self._options.interval)
        return Predicted(
            time_s, measured, values, half, inside, filled.held & alive, gap,
            np.isfinite(values) & valid, runs,
        )  # fmt: skip

    def _faulty(self, piece: Piece, name: str) -> BoolArray:
        """Where a fault masks a channel, or its values are physically impossible (time,)."""
        bad = np.zeros(len(piece.time_s), dtype=np.bool_)
        if name in piece.channels:
            known = self._model.logs.declared.get(name) or described(name)
            bad |= out_of_range(known, piece.channels[name])
        for one in self._findings:
            if name == one.channel:
                bad |= one.rows(piece.time_s)
        return bad


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
    options, clock = options or ReplayOptions(), clock or Clock()
    running = _Replay(model, Path(log), options, clock)
    with atomic_stream(out, live=options.live) as file:
        if not options.follow:
            return running.write(file)
        with held_interrupt() as interrupt:
            running.pace.stop = lambda: interrupt.requested
            return running.write(file)


class _Replay:
    def __init__(self, model: ReplayModel, log: Path, options: ReplayOptions, clock: Clock) -> None:
        self.options, self.model, self.clock = options, model, clock
        self.pace = Pace(
            lines=1 if options.realtime else 4096, live=True, follow=options.follow,
            idle_s=options.idle_s, clock=clock.now, sleep=clock.sleep,
        )  # fmt: skip
        self.file = open_log(log, model.logs)
        self.dt_s = model.calibration.dt_s
        ahead = 0.0 if options.live else _LOOK_AHEAD_S
        self.engines = {
            name: (self.file.stream(self.dt_s, ahead), EngineReplay(model, options, name, str(log)))
            for name in self._names(log)
        }
        self.rows = self.read = 0
        self.first_s: float | None = None
        self.began = clock.now()

    def _names(self, log: Path) -> tuple[str, ...]:
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

    def write(self, file: TextIO) -> ReplaySummary:
        file.write(",".join(self._header()) + "\n")
        names = tuple(self.engines)
        for block in self.file.blocks(names, self.pace):
            self.read += sum(len(rows["time_s"]) for rows in block.values())
            self._emit(file, block, last=False)
        self._emit(file, {name: {} for name in names}, last=True)
        if not any(stream.samples for stream, _ in self.engines.values()):
            raise DataError(
                "expected samples at two or more times", file=self.file.path, channel="time_s"
            )
        return self._summary()

    def _header(self) -> list[str]:
        outputs, interval = self.model.calibration.output_names, self.model.calibration.interval
        band = () if interval is None else ("free_run_low", "free_run_high")
        parts = ("free_run", *band, "fused", "fused_low", "fused_high", "innovation")
        per_channel = [f"{name}_{part}" for name in outputs for part in parts]
        engine = ["engine"] if len(self.engines) > 1 else []
        valid = [f"{name}_valid" for name in outputs]
        return ["time_s", *engine, *per_channel, "inside_envelope", "held", "gap", *valid]

    def _emit(self, file: TextIO, block: Mapping[str, Rows], *, last: bool) -> None:
        """Write what is certain with one more block, rows of several engines in order of time."""
        several = len(self.engines) > 1
        lines = [
            line
            for name, (stream, engine) in self.engines.items()
            for part in engine.feed(stream.push(block[name], last=last), last=last)
            for line in self._lines(*part, [name] if several else [])
        ]
        lines.sort(key=lambda line: line[0])
        self.rows += len(lines)
        for at, text in lines:
            if self.options.realtime:
                self._wait(at)
            file.write(text)
            if self.options.realtime:
                file.flush()
        if self.options.follow:
            file.flush()

    def _lines(
        self, one: Predicted, fused: Fused, engine: list[str]
    ) -> Iterator[tuple[float, str]]:
        free, middle, half = one.values, fused.values, fused.half_width
        interval = self.model.calibration.interval
        band = [] if interval is None else [free - one.half_width, free + one.half_width]
        parts = [free, *band, middle, middle - half, middle + half, fused.innovations]
        results = np.stack(parts, axis=2).reshape(len(one.time_s), -1)
        table = np.column_stack([one.time_s, results]).tolist()
        flags = np.column_stack([one.inside, one.held, one.gap, one.valid]).astype(int)
        form = ",".join([TIME_FORMAT, *engine, *["%.10g"] * results.shape[1]])
        tail = ",%d" * flags.shape[1] + "\n"
        for row, flag in zip(table, flags.tolist(), strict=True):
            yield row[0], (form % tuple(row)).replace("nan", "") + tail % tuple(flag)

    def _wait(self, at_s: float) -> None:
        """Sleep until the wall clock has advanced as far as the log."""
        if self.first_s is None:
            self.first_s, self.began = at_s, self.clock.now()
        ahead = (at_s - self.first_s) - (self.clock.now() - self.began)
        if ahead > 0.0:
            self.clock.sleep(ahead)

    def _summary(self) -> ReplaySummary:
        found = {name: engine.summary() for name, (_, engine) in self.engines.items()}
        parts = ("held", "restarts", "blank", "outside", "gated", "unfused", "slow")
        return ReplaySummary(
            rows=self.rows,
            engines=tuple(self.engines),
            log_s=self.rows * self.dt_s,
            wall_s=self.clock.now() - self.began,
            **{part: {name: one[part] for name, one in found.items()} for part in parts},
            dropped=sum(stream.dropped for stream, _ in self.engines.values()),
            truncated=self.file.truncated,
            findings=self.model.findings,
            read=self.read,
        )
