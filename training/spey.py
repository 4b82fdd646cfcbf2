"""The Spey paper's procedure: identify part by part, repeat over records, combine, predict.

Steps (DeHoff et al., section IV): throttle; pressures from measured speeds; engine from measured
fuel flow, record by record (Table 3); engine and control from the command, all records at once.
Each step starts from the one before. Measured inputs carry noise, which output error does not
model: the first three steps are biased by it (docs/reproduce.md), the last is not, since its
input is the command.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from narxcal.output_error.engine import (
    DuctPressures,
    EngineAndControl,
    EngineFromFuel,
    ThrottleLinkage,
)
from narxcal.output_error.paper import FlightRecord
from narxcal.record import Record
from training.likelihood_statistics import Combined, combine, propagate
from training.output_error import Model, Plan, fit
from training.output_error_result import OutputErrorFit


@dataclass(frozen=True, eq=False)
class Identification:
    """All steps of one engine; `engine` is one fit per record."""

    throttle: OutputErrorFit
    pressures: OutputErrorFit
    engine: tuple[OutputErrorFit, ...]
    control: OutputErrorFit


def identify(
    records: Sequence[FlightRecord], sigma: Mapping[str, float] | None = None
) -> Identification:
    """Run the four steps on records of one engine; `sigma` is the known noise, None estimates it.

    Raises as `fit` does.
    """
    dt_s = records[0].dt_s
    linkage, ducts = ThrottleLinkage(), DuctPressures(dt_s)
    throttle = fit(linkage, [one.of(linkage) for one in records], Plan(sigma=sigma))
    pressures = fit(ducts, [one.of(ducts) for one in records], Plan(sigma=sigma))
    found = {**pressures.parameters(), **throttle.parameters()}
    fuel = EngineFromFuel(dt_s)
    plan = Plan(start=within_bounds(fuel, found), sigma=sigma)
    engine = tuple(fit(fuel, one.of(fuel), plan) for one in records)
    found |= {name: one.combined.value for name, one in repeatability(engine).items()}
    whole = EngineAndControl(dt_s)
    plan = Plan(start=within_bounds(whole, found), sigma=sigma)
    control = fit(whole, [one.of(whole) for one in records], plan)
    return Identification(throttle, pressures, engine, control)


def within_bounds(model: Model, values: Mapping[str, float]) -> dict[str, float]:
    """Values of the model's free parameters, moved inside its bounds: start values of a fit."""
    return {
        one.name: float(np.clip(values[one.name], one.low, one.high))
        for one in model.parameters
        if one.free and one.name in values
    }


@dataclass(frozen=True, eq=False)
class Repeated:
    """One parameter over several records: a row of Table 3, and its combination for Table 4."""

    estimates: tuple[float, ...]
    sd: tuple[float, ...]
    combined: Combined


def repeatability(fits: Sequence[OutputErrorFit]) -> dict[str, Repeated]:
    """Estimates of single records by parameter, and their means weighted by dispersion."""
    found = [one.estimates() for one in fits]
    rows = {}
    for name in found[0]:
        values, sd = zip(*(each[name] for each in found), strict=True)
        rows[name] = Repeated(values, sd, combine(values, sd))
    return rows


def prediction_error(model: Model, values: Mapping[str, float], record: Record) -> dict[str, float]:
    """RMS error of each output over a record, simulated with `OutputErrorFit.parameters()`."""
    error = record.y - np.asarray(model.simulate(values, record.u))
    rms = np.sqrt(np.nanmean(error**2, axis=0))
    return dict(zip(model.output_names, rms.tolist(), strict=True))


def tau_engine(values: Mapping[str, complex]) -> complex:
    """Time constant of engine and governor with C_FB = C_FH, tau_H / (K_AF C_FB), in s.

    Put the governor's law into the row of N_H: tau_H N_H' = C_FH K_AF (N_c - N_H), as the positive
    feedback cancels the engine's own restoring force.
    """
    return values["tau_H"] / (values["K_AF"] * values["C_FH"])


def tau_engine_of(control: OutputErrorFit) -> tuple[float, float]:
    """tau_engine and its standard deviation, s, with the correlations of the fit."""
    places = [control.names.index(name) for name in ("tau_H", "K_AF", "C_FH")]
    covariance = control.covariance if control.white else control.covariance_coloured
    values = {control.names[k]: float(control.values[k]) for k in places}
    return propagate(tau_engine, values, covariance[np.ix_(places, places)])
