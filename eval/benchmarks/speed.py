"""Speed as ratios and against the clock, measured on this machine in this run.

Kernels: the network is that of the public comparison: one input, one output, 30 tanh units, here
with two lags, on one thread. Where tsfast is installed (extra `bench`), its generated C++ kernel
runs the same network in turn with ours. Replay: CSV to CSV with the fuser on a virtual flight at
32 Hz.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch

from data_prep.log import Log
from eval.benchmarks import Row
from eval.replay import ReplayModel, replay
from eval.reproduce.data import flown
from narxcal.calibration.bundle import Bundle
from narxcal.calibration.fuser import KalmanFuser
from narxcal.calibration.noise import NoiseModel
from narxcal.flight_test.fly import load_scenario, write_flights
from narxcal.narx.config import NarxConfig
from narxcal.narx.network import NarxModel
from narxcal.record import Record
from narxcal.support.arrays import FloatArray
from training.config import RunConfig, load_config
from training.dynamics.free_run import FreeRunProblem, cut_windows
from training.dynamics.network import net_of, new_model
from training.dynamics.optimisers import adam
from training.pipeline import calibrate, prepare_logs
from training.records import Split

_KERNEL_GROUP, _PEER = "speed", "tsfast 0.5, C++ kernel in float32"
_NETWORK = NarxConfig(lags=2, taps=(0, 1), hidden=30)


def rows() -> list[Row]:
    """Kernels, replay against the clock, preparation by processor time."""
    return [*kernel_rows(), *replay_rows(), *preparation_rows()]


def record_of(samples: int) -> Record:
    """A stable non-linear system driven by filtered noise, the same every time."""
    random = np.random.default_rng(0)
    u, y = random.standard_normal(samples), np.zeros(samples)
    for k in range(2, samples):
        y[k] = 1.2 * y[k - 1] - 0.4 * y[k - 2] + 0.2 * np.tanh(u[k - 1])
    return Record(u, y)


def kernel_rows(samples: int = 20000) -> list[Row]:
    """Free run and training steps."""
    record = record_of(samples)
    model = new_model([record], _NETWORK, seed=0)
    theta = net_of(model).get_theta()
    problem = FreeRunProblem(net_of(model), cut_windows(model, [record], 100))
    parts: tuple[tuple[str, Callable[[], object]], ...] = (
        ("free run, kernel", lambda: model.simulate(record.u, record.y[:1])),
        ("gradient (Adam), kernel", lambda: problem.gradient(theta)),
        ("J'J and gradient (LM), kernel", lambda: problem.normal_equations(theta)),
    )
    note = "2 lags, 30 tanh units, one thread; derivatives over windows of 100 samples"
    with _one_thread():
        took = [(what, 1e6 * _seconds(work) / samples) for what, work in parts]
        rows = [Row(_KERNEL_GROUP, what, us, "us/sample", note=note) for what, us in took]
        return rows + (_against_tsfast(model, record) if find_spec("tsfast") else [])


def _against_tsfast(model: NarxModel, record: Record) -> list[Row]:
    """Free run and Adam step by the C++ kernel of tsfast, each in turn with ours."""
    narx = import_module("tsfast.models.architectures.narx")
    theirs = narx.NarxMLP(1, 1, na=2, nb=2, hidden_size=30, num_layers=1, washout=2, backend="c")
    both = np.concatenate([record.u, record.y], axis=1, dtype=np.float32)
    whole, windows = torch.from_numpy(both)[None], torch.from_numpy(both).reshape(-1, 100, 2)
    optimiser = torch.optim.Adam(theirs.parameters())

    def run() -> None:
        with torch.no_grad():
            theirs(whole)

    def step() -> None:
        optimiser.zero_grad()
        ((theirs(windows) - windows[..., 1:]) ** 2).mean().backward()
        optimiser.step()

    problem = FreeRunProblem(net_of(model), cut_windows(model, [record], 100))
    descent = adam(problem, net_of(model).get_theta(), rate=1e-3)
    pairs = (
        ("free run", lambda: model.simulate(record.u, record.y[:1]), run, 0.5),
        ("gradient with Adam step", lambda: next(descent), step, 0.7),
    )
    rows = []
    for what, own, other, most in pairs:
        ours, tsfast = _in_turn(own, other)
        note = f"{1e6 * ours / len(record):.3f} against {1e6 * tsfast / len(record):.3f} us/sample"
        ratio = ours / tsfast
        rows.append(
            Row(_KERNEL_GROUP, f"{what}, over tsfast", ratio, "x", most, "at most", _PEER, note)
        )
    return rows


def _in_turn(one: Callable[[], object], other: Callable[[], object]) -> tuple[float, float]:
    """Least seconds of each, run alternately, so that what else the machine does hits both."""
    took = [(_seconds(one, 1), _seconds(other, 1)) for _ in range(12)][2:]
    return min(a for a, _ in took), min(b for _, b in took)


def _seconds(work: Callable[[], object], repeats: int = 5) -> float:
    """Least of several runs, after one that compiles."""
    if repeats > 1:
        work()
    took = []
    for _ in range(repeats):
        began = time.perf_counter()
        work()
        took.append(time.perf_counter() - began)
    return min(took)


@contextmanager
def _one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


_GROUP = "replay"
_SOURCE = "our goal"


def replay_rows(duration_s: float = 1440.0, steps: int = 5000) -> list[Row]:
    """Train briefly, since speed does not depend on the weights, then replay and step."""
    config, base = load_config("demo.toml")
    with TemporaryDirectory() as folder:
        flight = _fly(Path(folder), duration_s=duration_s)
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


def preparation_rows(duration_s: float = 6000.0) -> list[Row]:
    """`narxcal prepare` of one flight at 10 Hz, without its start, by processor time."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        flight = _fly(folder, duration_s=duration_s, rate_hz=10.0, style="line")
        config = folder / "run.toml"
        config.write_text(_PREPARED.format(folder.as_posix(), flight.name), encoding="utf-8")
        once = _prepare_s(config)
        for copy in range(4):
            shutil.copy(flight, folder / f"{copy}_{flight.name}")
        five = _prepare_s(config)
    hours = 4.0 * duration_s / 3600.0
    note = f"13 channels at 10 Hz, {hours:.1f} hours, extrapolated; the start of 2 s is left out"
    busy_s = 1000.0 * (five - once) / hours
    what = "processor time of 1000 log-hours"
    return [Row("prepare", what, busy_s, "s", 600.0, "at most", _SOURCE, note)]


_PREPARED = """schema = "narxcal.config/1"
name = "Benchmark"
[logs]
folder = "{}"
files = ["*{}"]
[split]
train = ["*"]
"""


def _prepare_s(config: Path) -> float:
    """Processor time of the command in one process."""
    command = [sys.executable, "-m", "narxcal", "prepare", str(config), "--jobs", "1", "--quiet"]
    before = os.times()
    subprocess.run([*command, "--out", str(config.with_name("out"))], check=True)  # noqa: S603 - ours
    after = os.times()
    return sum(after[2:4]) - sum(before[2:4])  # of children, user and system


def _fly(folder: Path, **plan_of_flight: object) -> Path:
    """One flight of the demonstration's engine, with these values of its plan."""
    demo = load_scenario("demo")
    plan = demo.plan.model_copy(update=plan_of_flight)
    truth = write_flights(folder, demo.model_copy(update={"plan": plan, "flights": 1}))
    return folder / str(truth["logs"][0]["file"])


def _briefly_trained(config: RunConfig, base: Path, flight: Path) -> tuple[Log, Bundle]:
    """A model of the demonstration's structure over a table of the virtual engine.

    The engine itself is solved anew at every row, which takes several times as long as all else:
    a replay over it would measure the maker's model.
    """
    config = flown(config, base, flight.parent)
    config = config.having(train={"horizons_s": (5.0,), "iterations": (2,)})
    log = prepare_logs(config, [flight], 1.0 / 32.0)[0]
    return log, calibrate(config, base, Split((log,), (), ()))


def step_seconds(bundle: Bundle, log: Log, steps: int) -> tuple[FloatArray, FloatArray]:
    """Wall and processor time of each online step, `(steps,)` or fewer in a shorter log."""
    calibration = bundle.calibration
    fuser = KalmanFuser(NoiseModel.from_dict(bundle.record.fuser_noise or {}))
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
