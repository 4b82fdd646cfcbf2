"""Run the calibration and the baselines over one log, on the same rows."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from data_prep.equilibrium import quasi_steady
from data_prep.log import Log
from data_prep.prepare import hold_inputs
from data_prep.reading import SAME_INTERVAL
from eval.judging.trim import Trim, TrimConfig, TrimSamples, estimate_trim
from narxcal.calibration.bundle import Bundle
from narxcal.calibration.calibration import Calibration
from narxcal.channels import spools_of
from narxcal.intervals import LEVEL
from narxcal.steady.model import Envelope
from narxcal.support.arrays import BoolArray, FloatArray, bridge_gaps, spans
from narxcal.support.errors import DataError
from training.config import RunConfig
from training.dynamics.baselines import Baselines

MODEL, ONE_STEP, NETWORK = "model", "one_step", "network"
STEADY_STATE, FIRST_ORDER, ARX = "steady_state", "first_order", "arx"
BASELINES = (STEADY_STATE, FIRST_ORDER, ARX)
_MANY_OUTSIDE = 0.1  # share of a log's samples outside the envelope from which on it is reported


@dataclass(frozen=True, eq=False)
class FreeRun:
    """One log, its measured outputs and those of each model over the same inputs.

    | field | shape | meaning |
    |---|---|---|
    | `measured` | (time, channel) | measured outputs, NaN where masked |
    | `outputs` | name -> (time, channel) | `model` in free run, `one_step`, `network`, baselines |
    | `inputs_known` | (time,) | inputs were recorded, not carried over a gap |
    | `quasi_steady` | (time,) | the log is in equilibrium |
    | `in_envelope` | (time,) | inputs lie in the steady-state model's envelope |
    | `level` | (time,) | power level of `eval.judging.trim` |
    | `half_width` | (time, channel) | of the interval of `model`; None without one |
    | `scored_from` | | first row that is scored; earlier ones were used for the trim |
    | `trims` | name -> `Trim` | offsets that were added to an output |
    | `simulate_s` | | time that the free run took |
    """

    log: Log
    channels: tuple[str, ...]
    measured: FloatArray
    outputs: Mapping[str, FloatArray]
    inputs_known: BoolArray
    quasi_steady: BoolArray
    in_envelope: BoolArray
    level: FloatArray
    scored_from: int = 0
    trims: Mapping[str, Trim] = field(default_factory=dict)
    simulate_s: float = 0.0
    half_width: FloatArray | None = None

    @property
    def model(self) -> FloatArray:
        return self.outputs[MODEL]

    @property
    def steady(self) -> FloatArray:
        return self.outputs[STEADY_STATE]

    @property
    def trim(self) -> Trim | None:
        """Offsets that were added to the free run; None without trim."""
        return self.trims.get(MODEL)

    @property
    def scored(self) -> BoolArray:
        """Rows (time,) that count: inputs known, and not used for the trim."""
        rows = self.inputs_known.copy()
        rows[: self.scored_from] = False
        return rows


def run_log(
    bundle: Bundle,
    config: RunConfig,
    log: Log,
    recorded: Log | None = None,
    *,
    one_step: bool = True,
) -> FreeRun:
    """Run everything over one prepared log; masked inputs are filled and their rows not scored.

    `recorded` is the log before its faults were masked, where there are some: an input of which
    nothing is left runs as recorded, and after a masked input or a gap in the recording the free
    run starts anew from the measured outputs. Without `one_step` that prediction is left out.
    Raises `DataError` for a log without the model's channels or on another sampling grid.
    """
    own = bundle.calibration.for_engine(log.source.engine, or_mean=True)
    _check_interval(own, log)
    known = _complete(log, own.input_names)
    before = recorded or log
    lost = [name for name in own.input_names if not log.recorded([name])]
    filled = log.with_channels({name: before[name] for name in lost})
    inputs = hold_inputs(filled, own.input_names).matrix(own.input_names)
    faulty = _complete(before, own.input_names) & ~known
    faulty |= ~np.any([np.isfinite(values) for values in before.channels.values()], axis=0)
    measured = log.matrix(own.output_names)
    steady = np.asarray(own.settled(inputs), dtype=np.float64)
    began = time.perf_counter()
    model = _restarted(own, inputs, measured, faulty)
    took_s = time.perf_counter() - began
    outputs = {MODEL: model, STEADY_STATE: steady}
    outputs[NETWORK] = outputs[MODEL]
    if own.members.members:
        outputs[NETWORK] = _restarted(own.own_alone(), inputs, measured, faulty)
    if one_step:
        outputs[ONE_STEP] = _one_step(own, inputs, measured, outputs[MODEL])
    level = np.zeros(len(log))
    if bundle.record.baselines is not None:
        fitted = Baselines.from_json(bundle.record.baselines)
        outputs[FIRST_ORDER] = fitted.simulate("first_order", steady, measured[0], own.dt_s)
        outputs[ARX] = fitted.simulate("arx", steady, measured[0], own.dt_s)
        level = (steady[:, 0] - fitted.low[0]) / max(fitted.high[0] - fitted.low[0], 1e-9)
    spools = spools_of(own.output_names)
    return FreeRun(
        log=log,
        channels=own.output_names,
        measured=measured,
        outputs=outputs,
        inputs_known=known,
        quasi_steady=quasi_steady(log, config.events.driver, spools, config.quasi_steady),
        in_envelope=np.asarray(own.steady.inside(inputs)),
        level=level,
        simulate_s=took_s,
        half_width=None if own.interval is None else own.half_width(inputs, model, LEVEL),
    )


def _complete(log: Log, names: Sequence[str]) -> BoolArray:
    return np.asarray(np.all([np.isfinite(log[name]) for name in names], axis=0))


def _restarted(
    own: Calibration, inputs: FloatArray, measured: FloatArray, faulty: BoolArray
) -> FloatArray:
    """Free run (time, n_out) that starts anew after faulty inputs, and after gaps."""
    ends = [stop for _, stop in spans(faulty) if stop < len(faulty)]
    parts = [slice(*pair) for pair in pairwise((0, *ends, len(faulty)))]
    return np.concatenate([own.simulate(inputs[part], measured[part.start]) for part in parts])


def _one_step(
    own: Calibration, inputs: FloatArray, measured: FloatArray, free: FloatArray
) -> FloatArray:
    """One-step prediction (time, n_out); NaN for an output without a single measured sample.

    Such an output feeds back its free run, so that the others still have a one-step figure.
    """
    there = np.isfinite(measured).any(axis=0)
    if there.all():
        return own.predict(inputs, measured)
    return np.where(there, own.predict(inputs, np.where(there, measured, free)), np.nan)


def trimmed(run: FreeRun, until: int, config: TrimConfig) -> FreeRun:
    """Trim the free run and every baseline, each by its own error over the first rows.

    The one-step prediction starts from measured values and needs none.
    """
    outputs, trims = dict(run.outputs), {}
    nowhere = np.zeros(len(run.log))
    altitude_ft = np.nan_to_num(bridge_gaps(run.log.channels.get("ALT_ft", nowhere)))
    for name in (MODEL, NETWORK, *BASELINES):
        if name not in outputs:
            continue
        usable = run.quasi_steady & run.inputs_known
        error = run.measured - outputs[name]
        seen = TrimSamples(error, run.level, altitude_ft, usable, run.log.dt_s)
        trims[name] = estimate_trim(seen, until, run.channels, config)
        outputs[name] = outputs[name] + trims[name].at(run.level, altitude_ft)
    return replace(run, outputs=outputs, scored_from=until, trims=trims)


def _check_interval(calibration: Calibration, log: Log) -> None:
    if abs(log.dt_s - calibration.dt_s) > SAME_INTERVAL * calibration.dt_s:
        raise DataError(
            f"the model samples every {calibration.dt_s:g} s, this log every {log.dt_s:g} s",
            file=log.name,
            hint="Resample the log to the model's interval: raster_hz in [logs]",
        )


def outside_envelope(bundle: Bundle, run: FreeRun) -> str:
    """Warn of a log with more than 10 % of its samples outside the steady-state model's envelope.

    Names the inputs and their ranges where the envelope is a box; empty for a log that is inside.
    """
    outside, known = run.inputs_known & ~run.in_envelope, run.inputs_known
    if outside.sum() <= _MANY_OUTSIDE * known.sum():
        return ""
    steady = bundle.calibration.for_engine(run.log.source.engine, or_mean=True).steady
    box, ranges = getattr(steady, "envelope", None), []
    if isinstance(box, Envelope):
        for name, low, high in zip(steady.input_names, box.low, box.high, strict=True):
            values = run.log[name][known]
            if np.mean((values < low) | (values > high)) > _MANY_OUTSIDE:
                ranges.append(
                    f"{name} is {values.min():.5g} to {values.max():.5g}, "
                    f"the envelope {low:.5g} to {high:.5g}"
                )
    where = f" ({'; '.join(ranges)})" if ranges else ""
    return (
        f"{run.log.name}: {100.0 * outside.sum() / known.sum():.0f} % of the samples are outside "
        f"the envelope of the steady-state model{where}"
    )
