"""An exported FMU run by FMPy, to compare it with `simulate`."""

from __future__ import annotations

import shutil
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np

from narxcal.calibration.calibration import Calibration
from narxcal.export.proof import Case, held, row_of
from narxcal.support.arrays import FloatArray

STEPS_S = (0.1, 0.02, 0.25)  # communication steps of the proof, next to the model's own
_TIMED = 20_000  # steps over which the time of one is measured
_MOST_RESTORED = 600  # samples of the run whose state is stored and set


class FmuRun:
    """One instance of a dynamic FMU that narxcal wrote."""

    def __init__(self, file: Path, inputs: Sequence[str], outputs: Sequence[str]) -> None:
        import fmpy  # noqa: PLC0415  (an extra that most installations lack)

        self.described = fmpy.read_model_description(str(file))
        self._folder = fmpy.extract(str(file))
        self.slave: Any = fmpy.instantiate_fmu(self._folder, self.described, "CoSimulation")
        self.three = self.described.fmiVersion == "3.0"
        known = {one.name: one.valueReference for one in self.described.modelVariables}
        self.references = known
        self.inputs = [known[name] for name in inputs]
        self.outputs = [known[name] for name in outputs]
        real = ("Float64", "Int32") if self.three else ("Real", "Integer")
        self._set, self._get = (getattr(self.slave, f"{verb}{real[0]}") for verb in ("set", "get"))
        self._set_integer = getattr(self.slave, f"set{real[1]}")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.slave.freeInstance()
        shutil.rmtree(self._folder, ignore_errors=True)

    def start(
        self, inputs: FloatArray | None, engine: int = 0, *, interpolate: bool = False
    ) -> None:
        """Initialise at inputs (n_in,), or without any."""
        self.slave.reset()
        if not self.three:
            self.slave.setupExperiment(startTime=0.0)
        self.slave.enterInitializationMode()
        if engine:
            self._set_integer([self.references["engine"]], [engine])
        if "interpolate" in self.references:
            self.slave.setBoolean([self.references["interpolate"]], [interpolate])
        if inputs is not None:
            self._set(self.inputs, inputs.tolist())
        self.slave.exitInitializationMode()

    def values(self) -> list[float]:
        """Outputs now."""
        return list(self._get(self.outputs))

    def run(self, inputs: FloatArray, step_s: float, first: int = 0) -> FloatArray:
        """Outputs (n, n_out) after steps at whose ends the inputs are those (n, n_in).

        The first step begins at communication point `first`.
        """
        rows = np.empty((len(inputs), len(self.outputs)))
        for k, row in enumerate(inputs.tolist()):
            self._set(self.inputs, row)
            self.slave.doStep((first + k) * step_s, step_s)
            rows[k] = self.values()
        return rows

    def step_us(self, inputs: FloatArray, step_s: float) -> float:
        """CPU time of `doStep` alone in microseconds, called from Python, after a start."""
        self._set(self.inputs, inputs.tolist())
        begin = time.process_time()
        for k in range(_TIMED):
            self.slave.doStep(k * step_s, step_s)
        return 1e6 * (time.process_time() - begin) / _TIMED


def compare(
    model: Calibration, file: Path, cases: Sequence[Case], engines: Sequence[str]
) -> tuple[list[dict[str, Any]], float]:
    """Compare an FMU with `simulate` over cases, at several communication steps.

    At a step that is not the model's, inputs are interpolated in time, and outputs compared where
    both have a sample. States are stored and set in mid-flight. Returns the rows of the proof and
    the CPU time of a step at the model's own interval in microseconds.
    """
    rows = []
    with FmuRun(file, model.input_names, model.output_names) as fmu:
        for case in cases:
            own, number = model.for_engine(case.engine, or_mean=True), _number(engines, case.engine)
            for step_s in dict.fromkeys([model.dt_s, *STEPS_S]):
                same = step_s == model.dt_s
                points = case.inputs if same else _between(held(case.inputs), model.dt_s, step_s)
                fmu.start(points[0], number, interpolate=not same)
                found = np.vstack([fmu.values(), fmu.run(points[1:], step_s)])
                given = held(points) if same else _between(points, step_s, model.dt_s)
                expected = own.simulate(given)
                at, samples = _common(len(points), len(expected), step_s / model.dt_s)
                off = np.abs(found[at] - expected[samples])
                rows.append(row_of(model, case, f"step of {step_s:g} s", off))
            off = _restored(fmu, held(case.inputs[:_MOST_RESTORED]), own, number)
            rows.append(row_of(model, case, "state stored and set", off))
        first = held(cases[0].inputs)
        fmu.start(first[0])
        return rows, fmu.step_us(first[-1], model.dt_s)


def _number(engines: Sequence[str], engine: str) -> int:
    return [*engines].index(engine) if engine in engines else 0


def _between(inputs: FloatArray, step_s: float, other_s: float) -> FloatArray:
    """Inputs every `other_s`, on the lines between those every `step_s`."""
    times = np.arange(len(inputs)) * step_s
    at = np.arange(0.0, times[-1] + 1e-9, other_s)
    return np.column_stack([np.interp(at, times, column) for column in inputs.T])


def _common(points: int, samples: int, ratio: float) -> tuple[list[int], list[int]]:
    """Communication points and samples that are at the same time; `ratio` of step to dt."""
    at = np.arange(points) * ratio
    same = np.flatnonzero((np.abs(at - np.round(at)) < 1e-6) & (np.round(at) < samples))
    return same.tolist(), np.round(at[same]).astype(int).tolist()


def _restored(fmu: FmuRun, inputs: FloatArray, own: Calibration, number: int) -> FloatArray:
    """Differences of a run whose state is stored, serialised and set after another flight."""
    half, expected, end = len(inputs) // 2, own.simulate(inputs), "State" if fmu.three else "state"
    get, put, free, serialise = (
        getattr(fmu.slave, f"{verb}FMU{end}") for verb in ("get", "set", "free", "serialize")
    )
    restore = getattr(fmu.slave, "deserializeFMUState" if fmu.three else "deSerializeFMUstate")
    fmu.start(inputs[0], number)
    fmu.run(inputs[1:half], own.dt_s)
    stored = get()
    data = serialise(stored)
    free(stored)
    fmu.run(inputs[half:], own.dt_s, half - 1)
    restored = restore(data)
    put(restored)
    free(restored)
    return np.abs(fmu.run(inputs[half:], own.dt_s, half - 1) - expected[half:])
