"""The Spey paper's tables on flight logs of two engines: repeatability, prediction, left and right.

Each engine of each flight is identified by itself; the other flight of the same engine is then
simulated with what was found, steady-state model included.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from data_prep.log import Log
from eval.report.tables import Cell, Table, figure
from eval.reproduce.study import Claim, Study, Watch, table_of
from narxcal.output_error.engine import EngineFromSteady
from narxcal.record import Record
from narxcal.steady.model import SteadyStateModel
from training.config import RunConfig
from training.likelihood_statistics import Combined, Difference, compare
from training.output_error_flights import (
    OUTPUTS,
    FlightFit,
    common_parameters,
    identify_flight,
    meter,
    steady_record,
)
from training.spey import prediction_error
from training.steady_choice import steady_state


def flights_study(
    logs: Sequence[Log], config: RunConfig, base: Path, watch: Watch | None = None
) -> Study:
    """Tables 3 and 4 and predictions for `logs`, prepared as `training.pipeline.prepare_logs` does.

    Raises `DataError` for logs that lack a channel or move too little.
    """
    driver = config.steady_state.driver or config.events.driver
    steady: dict[str, SteadyStateModel] = {}
    found: dict[str, FlightFit] = {}
    for number, log in enumerate(logs):
        if watch:
            watch("Identifying flights", number, len(logs))
        steady[log.name], _ = steady_state(config, base, [log])
        record = steady_record(log, steady[log.name], driver)
        found[log.name] = identify_flight(record, log.dt_s)
    predicted = [
        _prediction(log, (other, found[other.name], steady[other.name]), driver)
        for log in logs
        for other in logs
        if other.source.engine == log.source.engine and other.source.file != log.source.file
    ]
    pairs = [
        (a, b, compare(_means(found[a.name]), _means(found[b.name])))
        for k, a in enumerate(logs)
        for b in logs[k + 1 :]
        if (a.source.file == b.source.file) != (a.source.engine == b.source.engine)
    ]
    return Study(
        key="spey-flights",
        title="Output error on flight logs",
        source=f"{len(logs)} logs; {driver} in, {', '.join(OUTPUTS)} out",
        text="A steady-state model of each log gives the settled values; equation 1 with time "
        "constants that fall with N2 gives the dynamics. Noise estimated; deviations corrected for "
        "coloured residuals. Errors are RMS of the free run over whole logs.",
        claims=_claims(found, predicted),
        tables=[
            *(_repeat_table(name, one) for name, one in found.items()),
            _final_table(found),
            *(_difference_table(a.name, b.name, rows) for a, b, rows in pairs),
            _prediction_table(found, predicted),
        ],
        results={
            "meter": {name: meter(one) for name, one in found.items()},
            "fits": {name: one.whole.document() for name, one in found.items()},
            "predicted": [asdict(one) for one in predicted],
        },
    )


@dataclass(frozen=True)
class CrossPrediction:
    """RMS errors (N2, N1, T) over a log by what another flight of the same engine gave.

    `steady` is the steady-state model alone, `rms` with the dynamics.
    """

    log: str
    origin: str
    steady: tuple[float, ...]
    rms: tuple[float, ...]


def _prediction(
    log: Log, origin: tuple[Log, FlightFit, SteadyStateModel], driver: str
) -> CrossPrediction:
    other, found, steady = origin
    record = steady_record(log, steady, driver)
    values = found.whole.parameters()
    rms = prediction_error(EngineFromSteady(log.dt_s), values, record)
    return CrossPrediction(log.name, other.name, _steady_rms(record), tuple(rms.values()))


def _steady_rms(record: Record) -> tuple[float, ...]:
    alone = np.sqrt(np.nanmean((record.y - record.u[:, : len(OUTPUTS)]) ** 2, axis=0))
    return tuple(alone.tolist())


def _means(found: FlightFit) -> dict[str, tuple[float, float]]:
    """Weighted means of the parts; their deviations cover the scatter between parts."""
    means = {name: row.combined for name, row in found.repeated.items()}
    names = common_parameters([found.whole])
    return {name: (means[name].value, means[name].sd_scaled) for name in names}


def _claims(found: Mapping[str, FlightFit], predicted: Sequence[CrossPrediction]) -> list[Claim]:
    birge = [one.combined.birge for fit in found.values() for one in fit.repeated.values()]
    rates = [_means(fit)["rate_H"] for fit in found.values()]
    better = [b < a for one in predicted for a, b in zip(one.steady, one.rms, strict=True)]
    linear = min(abs(value / sd) for value, sd in rates)
    return [
        Claim("S1 linear near full power: |z| of the change of tau_H with N2, smallest", "linear",
              linear, "< 1.96", "from idle to full power time constants change severalfold"),
        Claim("S10 largest Birge ratio between parts of a flight", "repeatable", max(birge),
              "< 1.73", "with deviations already corrected for coloured residuals"),
        Claim("S12 outputs of other flights predicted better than by the steady state alone",
              "predicted well", 100.0 * float(np.mean(better)) if better else math.nan,
              ">= 100 %"),
    ]  # fmt: skip


def _repeat_table(name: str, found: FlightFit) -> Table:
    count = len(found.parts)
    head = ("parameter", *(f"part {k + 1}" for k in range(count)), "mean", "Birge ratio", "whole")
    whole, rows = found.whole.estimates(), []
    for parameter in common_parameters([found.whole]):
        one = found.repeated[parameter]
        rows.append((
            parameter,
            *(_value(v, sd) for v, sd in zip(one.estimates, one.sd, strict=True)),
            _value(one.combined.value, one.combined.sd_scaled),
            birge_cell(one.combined),
            _value(*whole[parameter]),
        ))  # fmt: skip
    return table_of(f"{name}: parts of equal motion", head, rows)


def birge_cell(one: Combined) -> Cell:
    """Birge ratio, marked above 1.73: the 5 % limit for three records."""
    return figure(one.birge, "bad" if one.birge > 1.73 else "")


def _final_table(found: Mapping[str, FlightFit]) -> Table:
    fits = [one.whole for one in found.values()]
    rows = [
        (name, *(_value(*fit.estimates()[name]) for fit in fits))
        for name in common_parameters(fits)
    ]
    meters = ("fuel meter", *(meter(one) for one in found.values()))
    return table_of("Whole flights", ("parameter", *found), (*rows, meters))


def _value(value: float, sd: float) -> Cell:
    return Cell(f"{value:.3g} ± {sd:.2g}", number=True)


def _difference_table(a: str, b: str, rows: Sequence[Difference]) -> Table:
    head = ("parameter", a, b, "difference [%]", "z", "significant")
    cells = [
        (one.name, one.left, one.right, one.percent, one.z, "yes" if one.significant else "no")
        for one in rows
    ]
    caption = f"{a} against {b}: weighted means of the parts, 5 % over all parameters together"
    return table_of(caption, head, cells)


def _prediction_table(
    found: Mapping[str, FlightFit], predicted: Sequence[CrossPrediction]
) -> Table:
    head = ("log", "identified from", *(f"{name}, steady alone" for name in OUTPUTS), *OUTPUTS)
    own = [
        CrossPrediction(name, name, _steady_rms(one.record), tuple(one.whole.sigma.values()))
        for name, one in found.items()
    ]
    rows = [
        (one.log, "itself" if one.origin == one.log else one.origin, *one.steady, *one.rms)
        for one in (*own, *predicted)
    ]
    return table_of("RMS error of the free run over whole logs", head, rows)
