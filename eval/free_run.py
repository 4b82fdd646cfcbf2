"""Runs the calibration and the baselines over one log, side by side on the same rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from data_prep.equilibrium import quasi_steady
from data_prep.log import Log
from data_prep.prepare import hold_inputs
from eval.trim import Trim, TrimConfig, TrimSamples, estimate_trim
from narxcal.calibration.bundle import Bundle
from narxcal.calibration.calibration import DynamicCalibration
from narxcal.support.arrays import BoolArray, FloatArray
from narxcal.support.errors import DataError
from training.baselines import Baselines
from training.config import RunConfig

MODEL, ONE_STEP = "model", "one_step"
STEADY_STATE, FIRST_ORDER, ARX = "steady_state", "first_order", "arx"
BASELINES = (STEADY_STATE, FIRST_ORDER, ARX)
SPEEDS = ("N1_pct", "N2_pct")


@dataclass(frozen=True, eq=False)
class Runs:
    """One log, what was measured and what each model makes of its inputs, (time, channel) each.

    `outputs` maps `model` (free run), `one_step` and the baselines to their outputs. Rows (time,):
    `known` where the inputs were recorded and not held, `still` where the log is quasi-steady,
    `inside` where the inputs lie in the steady-state model's envelope. `level` is the power
    level of `eval.trim`. `trims` holds what was added to an output, and only rows from
    `scored_from` on count.
    """

    log: Log
    channels: tuple[str, ...]
    measured: FloatArray
    outputs: Mapping[str, FloatArray]
    known: BoolArray
    still: BoolArray
    inside: BoolArray
    level: FloatArray
    scored_from: int = 0
    trims: Mapping[str, Trim] | None = None

    @property
    def scored(self) -> BoolArray:
        """Rows (time,) that count: inputs known, and not used up by the trim."""
        rows = self.known.copy()
        rows[: self.scored_from] = False
        return rows


def run_log(bundle: Bundle, config: RunConfig, log: Log) -> Runs:
    """Run everything over one prepared log; masked inputs are held and their rows not scored.

    Raises `DataError` for a log without the model's channels or on another raster.
    """
    own = bundle.calibration.for_engine(log.source.engine)
    _check_raster(own, log)
    known = np.asarray(np.isfinite(log.matrix(own.input_names)).all(axis=1))
    inputs = hold_inputs(log, own.input_names).matrix(own.input_names)
    measured = log.matrix(own.output_names)
    steady = np.asarray(own.steady.outputs(inputs), dtype=np.float64)
    outputs = {
        MODEL: own.simulate(inputs, measured[0]),
        STEADY_STATE: steady,
    }
    outputs[ONE_STEP] = _one_step(own, inputs, measured, outputs[MODEL])
    level = np.zeros(len(log))
    if "baselines" in bundle.meta:
        fitted = Baselines.from_json(bundle.meta["baselines"])
        outputs[FIRST_ORDER] = fitted.lag.simulate(steady, measured[0], own.dt_s)
        outputs[ARX] = fitted.arx.simulate(steady, measured[0])
        level = (steady[:, 0] - fitted.low[0]) / max(fitted.high[0] - fitted.low[0], 1e-9)
    speeds = tuple(name for name in own.output_names if name in SPEEDS)
    still = quasi_steady(log, config.events.driver, speeds, config.quasi_steady)
    inside = np.asarray(own.steady.inside(inputs))
    return Runs(log, own.output_names, measured, outputs, known, still, inside, level)


def _one_step(
    own: DynamicCalibration, inputs: FloatArray, measured: FloatArray, free: FloatArray
) -> FloatArray:
    """Prediction (time, n_out) from measured outputs; what has no sample stays that of `free`.

    Otherwise a flight without a probe would have no one-step figure of its spools either.
    """
    there = np.isfinite(measured).any(axis=0)
    return np.where(there, own.predict(inputs, np.where(there, measured, free)), np.nan)


def trimmed(runs: Runs, until: int, config: TrimConfig) -> Runs:
    """Trim the free run and every baseline, each by its own error over the first rows.

    The one-step prediction starts from measured values and needs none.
    """
    outputs, trims = dict(runs.outputs), {}
    for name in (MODEL, *BASELINES):
        if name not in outputs:
            continue
        seen = TrimSamples(
            runs.measured - outputs[name], runs.level, runs.still & runs.known, runs.log.dt_s
        )
        trims[name] = estimate_trim(seen, until, runs.channels, config)
        outputs[name] = outputs[name] + trims[name].at(runs.level)
    return Runs(
        runs.log,
        runs.channels,
        runs.measured,
        outputs,
        runs.known,
        runs.still,
        runs.inside,
        runs.level,
        until,
        trims,
    )


def _check_raster(calibration: DynamicCalibration, log: Log) -> None:
    if abs(log.dt_s - calibration.dt_s) > 1e-3 * calibration.dt_s:
        raise DataError(
            f"the model runs on a raster of {calibration.dt_s:g} s, found {log.dt_s:g} s",
            file=log.name,
            hint="Read the log on the model's raster: raster_hz in [logs]",
        )
