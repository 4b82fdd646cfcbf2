"""Simulators by what the user names, and the same run again under changed inputs."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from data_prep.log import Log
from narxcal.calibration.bundle import DOCUMENT, Bundle, load_bundle
from narxcal.calibration.calibration import Calibration
from narxcal.channels import CHANNELS
from narxcal.effects.base import Pace
from narxcal.effects.running import Emulator, Flights, Shift
from narxcal.steady.fmu import import_fmpy, read_description
from narxcal.steady.function import import_function, search_path
from narxcal.support.arrays import FloatArray, block_means, bridge_gaps, on_lines
from narxcal.support.errors import ConfigError, ModelError, NarxcalError
from training.pipeline import calibration_for

_TAKES = "It takes ({channel: (time,)}, dt_s) and returns {channel: (time,)}"
ENGINES = ("business_jet", "single_aisle")
_OUTPUTS = tuple(name for name, row in CHANNELS.items() if row.role == "output")
_ONE_RASTER = 1e-3
DRIVERS = ("TRA_deg", "FF_kgph")
Simulate = Callable[[Log], Mapping[str, FloatArray]]


def open_function(reference: str) -> Simulate:
    """Import `module:function`, installed or in the current folder, as a simulator of logs.

    Raises `ConfigError` where there is none; the simulator raises `ModelError` where the function
    fails or returns anything but channels of the log's length.
    """
    with redirect_stdout(sys.stderr):
        function, file = import_function(reference, subject="simulator")

    def simulate(log: Log) -> Mapping[str, FloatArray]:
        given = {each: v.copy() for each, v in log.channels.items() if each in CHANNELS}
        try:
            with redirect_stdout(sys.stderr), search_path(file.parent):
                found = dict(function(given, log.dt_s))
                arrays = {each: np.array(v, dtype=np.float64) for each, v in found.items()}
        except NarxcalError:
            raise
        except (Exception, SystemExit) as error:
            raise ModelError(
                f"simulator '{reference}' failed: {type(error).__name__}: {error}",
                file=log.name,
                hint=_TAKES,
            ) from error
        for each, values in arrays.items():
            if values.shape != (len(log),):
                raise ModelError(
                    f"simulator '{reference}' returned {values.shape}, expected ({len(log)},)",
                    file=log.name,
                    channel=each,
                )
        return arrays

    return simulate


class Simulator(NamedTuple):
    """What was named: its kind in a word, and either a folder of its logs or a function.

    A run folder has its `bundle`.
    """

    kind: str
    how: Path | Simulate
    bundle: Bundle | None = None

    @property
    def again(self) -> Simulate | None:
        return None if isinstance(self.how, Path) else self.how


def open_simulator(source: str, *, trust: bool = False) -> Simulator:
    """Open a folder of logs, a run folder, an FMU, `module:function`, or a virtual engine's name.

    A function takes `(inputs: {channel: (time,)}, dt_s)` and returns `{channel: (time,)}`. `trust`
    is that of `load_bundle`, for a run folder. Raises
    `ConfigError` for what is none of these, else as the simulator's own reader.
    """
    path = Path(source or "nothing")
    if source in ENGINES:
        return Simulator("virtual engine", _virtual_engine(source))
    if path.is_dir():
        is_bundle = (path / DOCUMENT).is_file()
        return _of_run(path, trust) if is_bundle else Simulator("logs", path)
    if path.suffix == ".fmu" and path.is_file():
        return Simulator("FMU", _fmu(path))
    if all(source.partition(":")) and not path.exists():
        return Simulator("function", open_function(source))
    raise ConfigError(
        f"simulator '{source}' is no folder of logs, run folder, FMU, module:function or "
        "virtual engine",
        hint=f"Virtual engines are {' and '.join(ENGINES)}",
    )


def _of_run(folder: Path, trust: bool) -> Simulator:
    bundle = load_bundle(folder, trust=trust)
    declared = [name for name in bundle.calibration.input_names if name not in CHANNELS]
    if declared:
        raise ModelError(
            "an input of the run is a declared channel, and a diagnosis simulates from built-in "
            "ones alone",
            file=folder,
            channel=declared[0],
            hint="Train a run without it in [steady_state] inputs",
        )
    return Simulator("bundle", simulate_by(bundle.calibration), bundle)


def _virtual_engine(name: str) -> Simulate:
    """The engine as built; inputs that noise carries out of its envelope are moved back in."""
    home = importlib.import_module("narxcal.turbofan.engine")
    engine = home.VirtualEngine(name)

    def simulate(log: Log) -> Mapping[str, FloatArray]:
        u = np.clip(log.matrix(engine.input_names), home.LOW, home.HIGH)
        given = dict(zip(engine.input_names, u.T, strict=True))
        found: Mapping[str, FloatArray] = engine.simulate(given, log.dt_s)
        return found

    return simulate


def simulate_by(calibration: Calibration) -> Simulate:
    """A calibration on its own raster; inputs and outputs are carried over on straight lines."""

    def simulate(log: Log) -> Mapping[str, FloatArray]:
        own = calibration_for(calibration, log)
        u = log.matrix(own.input_names)
        if abs(log.dt_s / calibration.dt_s - 1.0) <= _ONE_RASTER:
            y = own.simulate(u)
        else:
            here = np.arange(len(log)) * log.dt_s
            there = np.arange(0.0, here[-1] + 0.5 * calibration.dt_s, calibration.dt_s)
            y = on_lines(here, there, own.simulate(on_lines(there, here, u)))
        return dict(zip(own.output_names, y.T, strict=True))

    return simulate


def _fmu(path: Path) -> Simulate:
    description = read_description(path)
    names = {
        kind: [v.name for v in description.modelVariables if v.causality == kind]
        for kind in ("input", "output")
    }
    outputs = [name for name in names["output"] if name in _OUTPUTS]
    for kind, wanted, which in (("output", _OUTPUTS, "them"), ("input", DRIVERS, "the lever")):
        if not set(wanted) & set(names[kind]):
            raise ModelError(
                f"no {kind} of the FMU is one of {', '.join(wanted)}",
                file=path,
                hint=f"Its {kind}s are {', '.join(names[kind]) or 'none'}: name {which} so",
            )

    def simulate(log: Log) -> Mapping[str, FloatArray]:
        given = [name for name in names["input"] if name in CHANNELS]
        rows = np.zeros(len(log), dtype=[(name, np.float64) for name in ("time", *given)])
        rows["time"] = np.arange(len(log)) * log.dt_s
        for name in given:
            rows[name] = log[name]
        found = _co_simulated(path, rows, outputs)
        time_s, wanted = np.asarray(found["time"]), np.asarray(rows["time"])
        return {name: np.interp(wanted, time_s, found[name]) for name in outputs}

    return simulate


def _co_simulated(path: Path, rows: Any, outputs: Sequence[str]) -> Any:
    fmpy = import_fmpy(path)
    interval = float(rows["time"][1])
    try:
        return fmpy.simulate_fmu(
            str(path),
            stop_time=float(rows["time"][-1]),
            output_interval=interval,
            step_size=interval,
            input=rows,
            output=outputs,
            terminate=False,
        )
    except (fmpy.fmi1.FMICallException, OSError, RuntimeError, ValueError) as error:
        raise ModelError(
            f"the FMU failed: {error}", file=path, hint="Run it in co-simulation by itself first"
        ) from error


@dataclass(frozen=True, eq=False)
class Rerun:
    """`simulate` takes logs of `block` samples per sample of the flights."""

    emulator: Emulator
    simulate: Simulate
    block: int
    _as_flown: list[tuple[Flights, FloatArray]] = field(default_factory=list)

    def run(
        self,
        flights: Flights,
        given: FloatArray,
        pace: Pace | None = None,
        shift: Shift | None = None,
    ) -> FloatArray:
        """Outputs (rows, time, outputs) for `given` (blocks, time, inputs).

        With a pace, and a shift of where it settles, it is the emulator's run, anchored to what the
        simulator says of these inputs. Samples of which it says nothing are bridged, as in its
        logs. Raises `ModelError` where the simulator leaves out one of the outputs.
        """
        if pace is None:
            return self._flown(flights) if given is flights.u else self._run_on(flights, given)
        found = self.emulator.run(flights, given, pace, shift)
        if given is flights.u:
            return found
        blocks, rows = len(given), np.arange(len(found))
        here, there = rows % blocks, rows % len(flights.u)
        anchored = self.run(flights, given)[here] - self._flown(flights)[there]
        guessed = self.emulator.run(flights, given)[here]
        return np.asarray(found + anchored - guessed + self.emulator.run(flights, flights.u)[there])

    def _flown(self, flights: Flights) -> FloatArray:
        """What it says of the inputs as they were flown: computed once."""
        for known, found in self._as_flown:
            if known is flights:
                return found
        found = self._run_on(flights, flights.u)
        self._as_flown[:] = [(flights, found)]
        return found

    def _run_on(self, flights: Flights, given: FloatArray) -> FloatArray:
        return np.stack([self._one(flights, u) for u in given])

    def _one(self, flights: Flights, u: FloatArray) -> FloatArray:
        signals, count = flights.signals, len(u)
        dt_s = signals.dt_s / self.block
        rows = np.arange(count * self.block, dtype=np.float64)
        middles = (np.arange(count) + 0.5) * self.block - 0.5
        given = zip(signals.inputs, on_lines(rows, middles, u).T, strict=True)
        channels = {name: values for name, values in given if name in CHANNELS}
        found = self.simulate(Log("flight run again", rows * dt_s, channels))
        for name in signals.outputs:
            if name not in found or not np.isfinite(found[name]).any():
                raise ModelError("the simulator no longer gives it", channel=name)
        y = np.column_stack([bridge_gaps(found[name]) for name in signals.outputs])
        return block_means(y, self.block)
