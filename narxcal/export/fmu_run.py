"""An exported FMU run by FMPy, to compare it with `simulate`."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np

from narxcal.calibration.calibration import Calibration
from narxcal.export import proof
from narxcal.export.program import Program
from narxcal.export.proof import Case, Trial, held, row_of
from narxcal.steady.fmu import open_unit
from narxcal.support.arrays import FloatArray, on_lines

STEPS_S = (0.1, 0.02, 0.25)  # communication steps of the proof, next to the model's own
_TIMED = 20_000  # steps over which the time of one is measured
_MOST_RESTORED = 600  # samples of the run whose state is stored and set


class FmuRun:
    """One instance of a dynamic FMU that narxcal wrote."""

    def __init__(self, file: Path, inputs: Sequence[str], outputs: Sequence[str]) -> None:
        self.unit = open_unit(file)
        self.slave, self.fmi3 = self.unit.slave, self.unit.fmi3
        self.references = {one.name: one.valueReference for one in self.unit.variables}
        self.inputs, self.outputs = (
            [self.references[name] for name in names] for names in (inputs, outputs)
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.unit.close()

    def start(
        self, inputs: FloatArray | None, engine: int = 0, *, interpolate: bool = False
    ) -> None:
        """Initialise at inputs (n_in,), or without any."""
        self.unit.begin()
        if engine:
            self.set_engine(engine)
        if "interpolate" in self.references:
            self.slave.setBoolean([self.references["interpolate"]], [interpolate])
        if inputs is not None:
            self.unit.put(self.inputs, inputs.tolist())
        self.slave.exitInitializationMode()

    def set_engine(self, engine: int) -> None:
        put = self.slave.setInt32 if self.fmi3 else self.slave.setInteger
        put([self.references["engine"]], [engine])

    def values(self) -> list[float]:
        return list(self.unit.get(self.outputs))

    def run(self, inputs: FloatArray, step_s: float, first: int = 0) -> FloatArray:
        """Outputs (n, n_out) after steps at whose ends the inputs are those (n, n_in).

        The first step begins at communication point `first`.
        """
        rows = np.empty((len(inputs), len(self.outputs)))
        for k, row in enumerate(inputs.tolist()):
            self.unit.put(self.inputs, row)
            self.slave.doStep((first + k) * step_s, step_s)
            rows[k] = self.values()
        return rows

    def step_us(self, inputs: FloatArray, step_s: float) -> float:
        """CPU time of `doStep` alone in microseconds, called from Python, after a start."""
        self.unit.put(self.inputs, inputs.tolist())
        begin = time.process_time()
        for k in range(_TIMED):
            self.slave.doStep(k * step_s, step_s)
        return 1e6 * (time.process_time() - begin) / _TIMED


def compare(
    program: Program, file: Path, cases: Sequence[Case]
) -> tuple[list[dict[str, Any]], float]:
    """Compare the FMU of a program with `simulate` over cases, at several communication steps.

    At a step that is not the model's, inputs are interpolated in time, and outputs compared where
    both have a sample. States are stored and set in mid-flight. Returns the rows of the proof and
    the CPU time of a step at the model's own interval in microseconds.
    """
    model = program.model
    with FmuRun(file, model.input_names, model.output_names) as fmu:

        def run(trials: Sequence[Trial]) -> Iterator[FloatArray]:
            for case, _ in trials:
                fmu.start(case.inputs[0], program.number_of(case.engine))
                yield np.vstack([fmu.values(), fmu.run(case.inputs[1:], model.dt_s)])

        rows = proof.compare(model, run, cases, starts=False)
        for case in cases:
            own = model.for_engine(case.engine, or_mean=True)
            number = program.number_of(case.engine)
            for step_s in STEPS_S:
                off = _at_steps(fmu, held(case.inputs), own, number, step_s)
                rows.append(row_of(model, case, f"step of {step_s:g} s", off))
            off = _restored(fmu, held(case.inputs[:_MOST_RESTORED]), own, number)
            rows.append(row_of(model, case, "state stored and set", off))
        first = held(cases[0].inputs)
        fmu.start(first[0])
        return rows, fmu.step_us(first[-1], model.dt_s)


def _at_steps(
    fmu: FmuRun, inputs: FloatArray, own: Calibration, number: int, step_s: float
) -> FloatArray:
    """Differences of a run at communication steps, inputs (time, n_in) running straight."""
    points = _between(inputs, own.dt_s, step_s)
    fmu.start(points[0], number, interpolate=True)
    found = np.vstack([fmu.values(), fmu.run(points[1:], step_s)])
    expected = own.simulate(_between(points, step_s, own.dt_s))
    at, samples = _common(len(points), len(expected), step_s / own.dt_s)
    return np.abs(found[at] - expected[samples])


def _between(inputs: FloatArray, step_s: float, other_s: float) -> FloatArray:
    """Inputs every `other_s`, on the lines between those every `step_s`."""
    times = np.arange(len(inputs)) * step_s
    at = np.arange(0.0, times[-1] + 1e-9, other_s)
    return on_lines(at, times, inputs)


def _common(points: int, samples: int, ratio: float) -> tuple[list[int], list[int]]:
    """Communication points and samples that are at the same time; `ratio` of step to dt."""
    at = np.arange(points) * ratio
    same = np.flatnonzero((np.abs(at - np.round(at)) < 1e-6) & (np.round(at) < samples))
    return same.tolist(), np.round(at[same]).astype(int).tolist()


def _restored(fmu: FmuRun, inputs: FloatArray, own: Calibration, number: int) -> FloatArray:
    """Differences of a run whose state is stored, serialised and set after another flight."""
    half, expected, end = len(inputs) // 2, own.simulate(inputs), "State" if fmu.fmi3 else "state"
    get, put, free, serialise = (
        getattr(fmu.slave, f"{verb}FMU{end}") for verb in ("get", "set", "free", "serialize")
    )
    restore = getattr(fmu.slave, "deserializeFMUState" if fmu.fmi3 else "deSerializeFMUstate")
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
