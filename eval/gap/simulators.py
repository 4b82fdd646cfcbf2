"""Simulators by what the user names: a run folder, an FMU, a function, a virtual engine.

Each becomes a function from a log, whose inputs are complete, to its outputs `(time,)` by channel.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from data_prep.log import Log
from eval.gap.own_function import open_function
from narxcal.calibration.bundle import DOCUMENT, load_bundle
from narxcal.calibration.calibration import Calibration
from narxcal.channels import CHANNELS
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError, ModelError
from training.pipeline import calibration_for

ENGINES = ("business_jet", "single_aisle")
_OUTPUTS = tuple(name for name, row in CHANNELS.items() if row.role == "output")
_ONE_RASTER = 1e-3
DRIVERS = ("TRA_deg", "FF_kgph")
Simulate = Callable[[Log], Mapping[str, FloatArray]]


class Simulator(NamedTuple):
    """What was named: its kind in a word, and either a folder of its logs or a function."""

    kind: str
    how: Path | Simulate


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
    return Simulator("bundle", simulate_by(load_bundle(folder, trust=trust).calibration))


def _virtual_engine(name: str) -> Simulate:
    """The engine as built; inputs that noise carries out of its envelope are moved back in."""
    home = importlib.import_module("narxcal.turbofan.engine")
    engine = home.VirtualEngine(name)

    def simulate(log: Log) -> Mapping[str, FloatArray]:
        u = np.clip(log.matrix(engine.input_names), home.LOW, home.HIGH)
        told = dict(zip(engine.input_names, u.T, strict=True))
        found: Mapping[str, FloatArray] = engine.simulate(told, log.dt_s)
        return found

    return simulate


def simulate_by(calibration: Calibration) -> Simulate:
    """A calibration on its own raster; inputs and outputs are carried over on straight lines."""

    def simulate(log: Log) -> Mapping[str, FloatArray]:
        own = calibration_for(calibration, log)
        u = log.matrix(own.input_names)
        if abs(log.dt_s / calibration.dt_s - 1.0) <= _ONE_RASTER:
            return dict(zip(own.output_names, own.simulate(u).T, strict=True))
        here = np.arange(len(log)) * log.dt_s
        there = np.arange(0.0, here[-1] + 0.5 * calibration.dt_s, calibration.dt_s)
        told = np.column_stack([np.interp(there, here, column) for column in u.T])
        outputs = own.simulate(told).T
        return {
            name: np.interp(here, there, values)
            for name, values in zip(own.output_names, outputs, strict=True)
        }

    return simulate


def _fmu(path: Path) -> Simulate:
    """Co-simulation of an FMU whose variables bear the names of channels."""
    fmpy = _fmpy(path)
    description = _described(fmpy, path)
    names = {
        kind: [v.name for v in description.modelVariables if v.causality == kind]
        for kind in ("input", "output")
    }
    outputs = [name for name in names["output"] if name in _OUTPUTS]
    if not outputs:
        raise ModelError(
            f"no output of the FMU is one of {', '.join(_OUTPUTS)}",
            file=path,
            hint=f"Its outputs are {', '.join(names['output']) or 'none'}: name them so",
        )
    if not any(name in DRIVERS for name in names["input"]):
        raise ModelError(
            f"no input of the FMU is one of {', '.join(DRIVERS)}",
            file=path,
            hint=f"Its inputs are {', '.join(names['input']) or 'none'}: name the lever so",
        )

    def simulate(log: Log) -> Mapping[str, FloatArray]:
        told = [name for name in names["input"] if name in CHANNELS]
        kinds = [("time", np.float64), *((name, np.float64) for name in told)]
        rows = np.zeros(len(log), dtype=kinds)
        rows["time"] = np.arange(len(log)) * log.dt_s
        for name in told:
            rows[name] = log[name]
        found = _co_simulated(fmpy, path, rows, outputs)
        time_s, wanted = np.asarray(found["time"]), np.asarray(rows["time"])
        return {name: np.interp(wanted, time_s, found[name]) for name in outputs}

    return simulate


def _described(fmpy: Any, path: Path) -> Any:
    # FMPy raises whatever the parser of its day does about a file that it dislikes.
    try:
        return fmpy.read_model_description(str(path))
    except Exception as error:
        raise ModelError(
            f"the file is no FMU that can be read: {error}", file=path, hint="Export it again"
        ) from error


def _co_simulated(fmpy: Any, path: Path, rows: Any, outputs: Sequence[str]) -> Any:
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


def _fmpy(path: Path) -> Any:
    try:
        return importlib.import_module("fmpy")
    except ImportError:
        raise ModelError(
            "FMUs need the package FMPy", file=path, hint="pip install narxcal[fmu]"
        ) from None
