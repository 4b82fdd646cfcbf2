"""Replay: a flight streamed through the model and the fuser, as it would run beside the engine."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from data_prep.raster_stream import RasterStream
from data_prep.stamps import PRINTED
from eval.replay_engine import EngineReplay, Rows
from eval.replay_setup import ReplayModel, ReplayOptions
from eval.stream import CsvStream, Pace
from narxcal.atomic import atomic_stream
from narxcal.channels import CHANNELS
from narxcal.errors import ConfigError, DataError
from narxcal.interrupt import held_interrupt

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import TextIO


__all__ = ["Clock", "ReplayModel", "ReplayOptions", "ReplaySummary", "replay"]

# At full speed there is no hurry: blanks of slow channels are waited for.
_LOOK_AHEAD_S = 5.0


@dataclass(frozen=True)
class ReplaySummary:
    """What a replay did.

    `held` counts, per engine and input, samples at which its last value stood in; `restarts`
    the gaps after which the model began anew; `outside` samples outside the envelope; `gated`,
    per engine and output, measurements that the fuser refused; `unfused` outputs that were never
    measured well enough to fuse. `slow` is, per engine and channel, the time in s between
    two measurements of a channel slower than the raster: an input is on the straight line there,
    an output is not fused. `dropped` rows had no usable stamp; `truncated` says that
    the file broke off in mid-line, which was left out.
    """

    rows: int
    engines: tuple[str, ...]
    log_s: float
    wall_s: float
    held: dict[str, dict[str, int]]
    restarts: dict[str, int]
    outside: dict[str, int]
    gated: dict[str, dict[str, int]]
    unfused: dict[str, tuple[str, ...]]
    slow: dict[str, dict[str, float]]
    dropped: int
    truncated: bool

    @property
    def times_real_time(self) -> float:
        """Seconds of log per second of replay, all engines together."""
        return self.log_s / self.wall_s if self.wall_s > 0.0 else float("inf")

    @property
    def cautions(self) -> list[str]:
        """Sentences without a full stop on what the model was not told."""
        said = [_too_slow(name, slow) for name, slow in self.slow.items()]
        return [text for text in said if text]

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        own = asdict(self)
        return {**own, "times_real_time": self.times_real_time, "cautions": self.cautions}


def _too_slow(engine: str, slow: dict[str, float]) -> str:
    """What to say of slow channels; the air changes slowly, and nothing is lost there."""
    told = [
        f"{name} about every {every_s:.2g} s"
        for name, every_s in slow.items()
        if CHANNELS[name].role != "ambient"
    ]
    if not told:
        return ""
    whose = f"{engine}: " if engine else ""
    return (
        f"{whose}slower than the model's raster are recorded {', '.join(told)}: outputs are fused "
        "only where they were measured, inputs are on straight lines between"
    )


@dataclass(frozen=True)
class Clock:
    """Wall time and waiting; a test brings its own."""

    now: Callable[[], float] = time.monotonic
    sleep: Callable[[float], None] = time.sleep


def replay(
    model: ReplayModel,
    log: str | Path,
    out: str | Path,
    options: ReplayOptions | None = None,
    clock: Clock | None = None,
) -> ReplaySummary:
    """Stream the CSV `log` through model and fuser, and write the CSV `out`.

    Columns: `time_s`; `engine`, where several are replayed; per output channel
    `X_prediction` (free run), `X_fused` and `X_innovation` (measured minus expected, blank where
    not measured, as between two measurements of a channel slower than the raster);
    `inside_envelope` (1 inside that of the steady-state model); `held` (1 where a missing input's
    last value stood in); `gap` (1 where the model started anew, or, with blank predictions, where
    it could not run). Samples are those of `data_prep.read_logs` on the
    model's raster; the prediction at a sample uses the inputs up to and including it.

    `OUT` appears when all rows are there; live, they can be read in `OUT.part` as they come. Ctrl-C
    ends a `follow` well and any other replay with nothing left behind.

    Raises `DataError` for the log, `ConfigError` for options or an output that cannot be written.
    """
    return _Replay(model, Path(log), options or ReplayOptions(), clock or Clock()).write(Path(out))


class _Replay:
    def __init__(self, model: ReplayModel, log: Path, options: ReplayOptions, clock: Clock) -> None:
        self.options = options
        self.clock = clock
        pace = Pace(
            lines=1 if options.realtime else 4096,
            follow=options.follow,
            idle_s=options.idle_s,
            clock=clock.now,
            sleep=clock.sleep,
        )
        self.stream = CsvStream(log, model.logs, pace)
        names = self._engines(log)
        self.engines = {name: EngineReplay(model, options, name, str(log)) for name in names}
        ahead = 0.0 if options.live else _LOOK_AHEAD_S
        self.rasters = {
            name: RasterStream(
                model.logs,
                model.calibration.dt_s,
                ahead,
                str(log),
                self.stream.constants,
                hourly=self.stream.hourly,
            )
            for name in names
        }
        self.outputs = tuple(model.calibration.output_names)
        self.rows = 0
        self._first_s: float | None = None
        self._began = clock.now()

    def _engines(self, log: Path) -> tuple[str, ...]:
        known = self.stream.engines
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
            self.stream.pace.stop = lambda: interrupt.asked
            self._write_rows(file)

    def _write_rows(self, file: TextIO) -> None:
        for rows in self._samples():
            self._emit(file, rows)

    def _header(self) -> list[str]:
        parts = ("prediction", "fused", "innovation")
        per_channel = [f"{name}_{part}" for name in self.outputs for part in parts]
        engine = ["engine"] if len(self.engines) > 1 else []
        return ["time_s", *engine, *per_channel, "inside_envelope", "held", "gap"]

    def _samples(self) -> Iterator[dict[str, list[Rows]]]:
        """Finished rows per engine, as they become certain."""
        names = tuple(self.engines)
        for block in self.stream.blocks(names):
            yield {
                name: self.engines[name].feed(list(self.rasters[name].push(block[name])))
                for name in names
            }
        yield {
            name: self.engines[name].feed(list(self.rasters[name].push({}, last=True)), last=True)
            for name in names
        }
        if not any(raster.samples for raster in self.rasters.values()):
            raise DataError(
                "expected samples at two or more times", file=self.stream.path, channel="time_s"
            )

    def _emit(self, file: TextIO, rows: dict[str, list[Rows]]) -> None:
        """Write one block, rows of several engines in order of time."""
        lines: list[tuple[float, str]] = []
        for name, parts in rows.items():
            for part in parts:
                lines += _lines(part, name if len(self.engines) > 1 else None)
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

    def _wait(self, at_s: float) -> None:
        """Sleep until the wall clock has advanced as far as the log."""
        if self._first_s is None:
            self._first_s, self._began = at_s, self.clock.now()
        ahead = (at_s - self._first_s) - (self.clock.now() - self._began)
        if ahead > 0.0:
            self.clock.sleep(ahead)

    def _summary(self) -> ReplaySummary:
        engines = self.engines
        return ReplaySummary(
            rows=self.rows,
            engines=tuple(engines),
            log_s=self.rows * next(iter(self.rasters.values())).dt_s,
            wall_s=self.clock.now() - self._began,
            held={name: engine.held for name, engine in engines.items()},
            restarts={name: engine.restarts for name, engine in engines.items()},
            outside={name: engine.outside for name, engine in engines.items()},
            gated={name: engine.gated for name, engine in engines.items()},
            unfused={name: engine.unfused for name, engine in engines.items()},
            slow={name: engine.slow for name, engine in engines.items()},
            dropped=sum(raster.dropped for raster in self.rasters.values()),
            truncated=self.stream.truncated,
        )


def _lines(rows: Rows, engine: str | None) -> list[tuple[float, str]]:
    n_out = rows.prediction.shape[1]
    results = np.stack([rows.prediction, rows.fused, rows.innovation], axis=2)
    table = np.column_stack([rows.time_s, results.reshape(len(rows.time_s), 3 * n_out)]).tolist()
    flags = np.column_stack([rows.inside, rows.held, rows.gap]).astype(int).tolist()
    form = ",".join([PRINTED, *([engine] if engine else []), *["%.10g"] * (3 * n_out)])
    tail = ",%d,%d,%d\n"
    return [
        (row[0], (form % tuple(row)).replace("nan", "") + tail % tuple(flag))
        for row, flag in zip(table, flags, strict=True)
    ]
