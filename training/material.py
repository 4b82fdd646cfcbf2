"""What the lags and the network learn from, made of prepared logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from data_prep.log import Log
from data_prep.quasi_steady import quasi_steady
from narxcal.calibration import narx_features, steady_for_engine
from narxcal.lag import LagModel, speeds_of
from narxcal.lag_governed import AnyLags
from narxcal.narx_config import NarxConfig
from narxcal.records import Record
from narxcal.steady_state import SteadyStateModel
from training.config import RunConfig
from training.emphasis import largest, motion_weight
from training.lag_fit import LagSamples, fit_lags
from training.lag_governed_fit import fit_governed
from training.lag_start import LagForm
from training.local_trim import locally_trimmed
from training.rest import rest_records
from training.trainer import Material

_ROUNDS = 3  # of lags and static error, each found with the other known; more change little


def material(
    config: RunConfig,
    steady: SteadyStateModel,
    lag: AnyLags | None,
    sets: tuple[Sequence[Log], Sequence[Log]],
) -> Material:
    """Records of the logs to fit to and of those to stop by, and rest records if wanted."""
    records, validation = (
        [deviation_record(log, steady, config, lag) for log in logs] for logs in sets
    )
    if config.train.emphasis == "motion":
        records = _emphasised(records, sets[0][0].dt_s, lagged=lag is not None)
    plain = Material(records, validation, sets[0][0].dt_s)
    return replace(plain, rest=_rest(config, plain, structure_of(config).moving))


def deviation_record(
    log: Log, steady: SteadyStateModel, config: RunConfig, lag: AnyLags | None = None
) -> Record:
    """What the network learns from: features and deviations of one log (papers/narx, 2.1).

    With lags in front of it, they are what the lags leave.
    """
    heat = lag if config.narx.lag_heat and isinstance(lag, LagModel) else None
    one = lag_samples(log, steady, config, heat)
    deviation, lagged = one.ss - one.measured, None
    if lag is not None:
        drive = lag.drive(one.inputs, steady.input_names, one.ss)
        lagged = lag.deviations(drive, deviation[0], log.dt_s)
        deviation = deviation - lagged
    columns = [steady.input_names.index(name) for name in config.narx.schedule]
    return Record(narx_features(one.ss, one.inputs[:, columns], lagged), deviation, log.name)


def _emphasised(records: Sequence[Record], dt_s: float, *, lagged: bool) -> list[Record]:
    """The records with their samples weighted by motion; features are those of `narx_features`."""
    parts = []
    for record in records:
        count = record.y.shape[1]
        before = record.u[:, count : 2 * count] if lagged else np.zeros_like(record.y)
        ss = record.u[:, (1 + lagged) * count :][:, :count]
        parts.append((ss, ss - before - record.y))
    scale = largest([ss for ss, _ in parts])
    return [
        replace(record, weight=motion_weight(*part, scale, dt_s))
        for record, part in zip(records, parts, strict=True)
    ]


def lag_samples(
    log: Log, steady: SteadyStateModel, config: RunConfig, lag: LagModel | None = None
) -> LagSamples:
    """What lags are fitted to; what the spools of `lag` still have before them is no static error.

    Nobody says so of a temperature: its slow part takes longer than the stretches that it is fitted
    to, and what a switched load does to it would be taken for such a part.
    """
    inputs = log.matrix(steady.input_names)
    ss = steady_for_engine(steady, log.source.engine).outputs(inputs)
    measured = log.matrix(steady.output_names)
    if config.train.local_trim:
        still = quasi_steady(log, config.events.driver, speeds(config), config.train.still)
        settling = np.zeros_like(ss)
        if lag is not None:
            drive = lag.drive(inputs, steady.input_names, ss)
            before = lag.deviations(drive, settling[0], log.dt_s)
            settling = np.where(speeds_of(lag.output_names), before, 0.0)
        ss = locally_trimmed(ss, measured + settling, still)
    return LagSamples(inputs, ss, measured)


def lags(config: RunConfig, steady: SteadyStateModel, logs: Sequence[Log]) -> AnyLags | None:
    """Fit the lags in front of the network to training logs; None where none are wanted.

    Nothing in [narx] may be "auto" any more (see training.lag_choice).
    """
    if not config.narx.lag:
        return None
    lag: AnyLags | None = None
    for _ in range(_ROUNDS if config.narx.lag_heat and not config.narx.lag_governed else 1):
        heat = lag if isinstance(lag, LagModel) else None
        samples = [lag_samples(log, steady, config, heat) for log in logs]
        lag = fitted_lags(config, samples, steady, logs[0].dt_s)
    return lag


def fitted_lags(
    config: RunConfig, samples: Sequence[LagSamples], steady: SteadyStateModel, dt_s: float
) -> AnyLags:
    """Lags of the form that [narx] says, fitted once; errors as of `fit_lags`, `fit_governed`."""
    names, section = (steady.input_names, tuple(steady.output_names)), config.narx
    if section.lag_governed:
        return fit_governed(samples, names, dt_s, config.train.threads)
    limited = section.lag_limits is True
    form = LagForm(section.lag_errors == "relative", limited, section.lag_heat)
    return fit_lags(samples, names, dt_s, form)


def structure_of(config: RunConfig) -> NarxConfig:
    """What the configuration makes of the network's structure."""
    section = config.narx
    vanishing = len(section.outputs) * (2 if section.lag else 1)
    return NarxConfig(
        lags=section.lags,
        taps=section.taps,
        hidden=section.hidden,
        margin=section.margin,
        moving=vanishing if section.anchored else 0,
        linear_feedback=section.linear_feedback,
    )


def _rest(config: RunConfig, material: Material, moving: int) -> list[Record]:
    """Rest records for an anchored network; one that is not anchored need not come to rest."""
    steps = round(config.train.rest_s / material.dt_s)
    if not moving or steps < 2:
        return []
    seed, far = config.train.seed, config.train.rest_far
    return rest_records(material.records, moving, steps, seed, far=far)


def speeds(config: RunConfig) -> tuple[str, ...]:
    """Those outputs that are spool speeds: they say whether the engine stands still."""
    return tuple(name for name in config.narx.outputs if name in ("N1_pct", "N2_pct"))
