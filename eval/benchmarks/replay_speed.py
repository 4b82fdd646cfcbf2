"""Replay with the fuser against the clock, on a virtual flight at 32 Hz."""

from __future__ import annotations

import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from data_prep.log import Log
from eval.benchmarks.row import Row
from eval.replay import ReplayModel, replay
from eval.reproduce.flights import flown
from eval.virtual_flights import load_scenario, write_flights
from narxcal.bundle import Bundle
from narxcal.fuser import KalmanFuser, NoiseModel
from training.config import RunConfig, load_config
from training.pipeline import Split, calibrate, prepare_logs

FloatArray = NDArray[np.float64]
_GROUP = "replay"
_SOURCE = "issue: replay with fuser"


def rows(duration_s: float = 1440.0, steps: int = 5000) -> list[Row]:
    """Train briefly, since speed does not depend on the weights, then replay and step."""
    config, base = load_config("demo.toml")
    with TemporaryDirectory() as folder:
        flight = _fly(Path(folder), duration_s)
        log, bundle = _briefly_trained(config, base, flight)
        model = ReplayModel.of(bundle)
        replay(model, flight, Path(folder) / "warm.csv")
        began = time.process_time()
        summary = replay(model, flight, Path(folder) / "out.csv")
        busy = summary.log_s / (time.process_time() - began)
    remark = f"{summary.log_s:.0f} s of log at 32 Hz in {summary.wall_s:.2f} s; "
    remark += f"{busy:.0f} s of log per processor second"
    speed = summary.times_real_time
    return [
        Row(
            _GROUP,
            "CSV to CSV with fuser",
            speed,
            "x real time",
            300.0,
            "at least",
            _SOURCE,
            remark,
        ),
        _step_row(bundle, log, steps),
    ]


def _step_row(bundle: Bundle, log: Log, steps: int) -> Row:
    """How long the slowest of a hundred online steps takes."""
    wall_ms, busy_ms = (1e3 * took for took in step_seconds(bundle, log, steps))
    remark = f"DynamicCalibration.step and KalmanFuser.step, {len(wall_ms)} samples; "
    remark += f"median {np.median(wall_ms):.3f} ms; processor time p99 "
    remark += f"{np.percentile(busy_ms, 99):.3f} ms, which other programs cannot lengthen"
    what, slowest = "model step and fuser step, p99", float(np.percentile(wall_ms, 99))
    return Row(_GROUP, what, slowest, "ms", 1.0, "at most", _SOURCE, remark)


def _fly(folder: Path, duration_s: float) -> Path:
    """One flight of the demonstration's engine, of this length."""
    demo = load_scenario("demo")
    plan = demo.plan.model_copy(update={"duration_s": duration_s})
    truth = write_flights(folder, demo.model_copy(update={"plan": plan, "flights": 1}))
    return folder / str(truth["logs"][0]["file"])


def _briefly_trained(config: RunConfig, base: Path, flight: Path) -> tuple[Log, Bundle]:
    """A model of the demonstration's structure over a table of the virtual engine.

    The engine itself is solved anew at every row, which takes several times as long as all else:
    a replay over it would measure the maker's model.
    """
    config, _ = flown(config, base, flight.parent)
    brief = config.train.model_copy(update={"horizons_s": (5.0,), "iterations": (2,)})
    config = config.model_copy(update={"train": brief})
    log = prepare_logs(config, [flight], 1.0 / 32.0)[0]
    return log, calibrate(config, base, Split((log,), (), ()))


def step_seconds(bundle: Bundle, log: Log, steps: int) -> tuple[FloatArray, FloatArray]:
    """Wall and processor time of each online step, `(steps,)` or fewer in a shorter log."""
    calibration = bundle.calibration
    fuser = KalmanFuser(NoiseModel.from_dict(bundle.meta["fuser_noise"]))
    inputs = log.matrix(calibration.input_names)[: steps + 1]
    measured = log.matrix(calibration.output_names)[: steps + 1]
    fuser.reset(calibration.reset(inputs[0], measured[0]), measured[0])
    wall, busy = [], []
    for row, outputs in zip(inputs[1:], measured[1:], strict=True):
        began = time.perf_counter(), time.thread_time()
        fuser.step(calibration.step(row), outputs)
        busy.append(time.thread_time() - began[1])
        wall.append(time.perf_counter() - began[0])
    return np.array(wall), np.array(busy)
