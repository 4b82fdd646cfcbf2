"""Output error on flight logs: a steady-state model in front, first-order dynamics behind it.

Fuel flow (or whatever drives the steady-state model) is the input; N2, N1 and the gas temperature
are the outputs. The model is `EngineFromSteady`, so a fit simulates whole flights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from data_prep.log import Log
from narxcal.output_error.engine import STEADY_OUTPUTS, EngineFromSteady, steady_drive
from narxcal.record import Record
from narxcal.steady.model import SteadyStateModel
from narxcal.support.errors import DataError
from training.output_error import Plan, fit
from training.output_error_result import OutputErrorFit
from training.spey import Repeated, repeatability

OUTPUTS: Final = STEADY_OUTPUTS
# The meter's second derivative is offered apart: it takes a bandwidth that 10 Hz logs rarely have.
_METER: Final = ("tau_M",)
OFFSETS: Final = ("N_HO", "N_LO", "T_O")


def steady_record(log: Log, steady: SteadyStateModel, driver: str) -> Record:
    """Record of a log for `EngineFromSteady`; raises `DataError` as `steady_drive` does."""
    moved = log[driver]
    span = float(moved.min()), float(moved.max())
    try:
        drive = steady_drive(steady, log.matrix(steady.input_names), driver, span)
    except DataError as error:
        raise DataError(
            error.problem, file=log.name, channel=error.channel, hint=error.hint
        ) from None
    return Record(drive, log.measured(OUTPUTS), log.name)


def parts_of_equal_motion(record: Record, count: int = 3) -> list[Record]:
    """Cut a record where the sum of |dH| reaches equal shares: each part moves about as much.

    The cuts are where H moves least over 50 samples, within a twentieth of the record from there
    and as close as may be: parts have to start near equilibrium. Raises `DataError` for a record of
    fewer than 200 samples a part.
    """
    if len(record) < 200 * count:
        raise DataError(
            f"{len(record)} samples are too few for {count} parts",
            file=record.name,
            hint=f"At least {200 * count} are needed",
        )
    moved = np.cumsum(np.abs(np.diff(record.u[:, 0], prepend=record.u[0, 0])))
    reach = len(record) // 20
    cuts = [0]
    for share in np.arange(1, count) / count:
        near = int(np.searchsorted(moved, share * moved[-1], side="right"))
        places = np.arange(max(near - reach, cuts[-1] + 50), min(near + reach, len(record) - 50))
        span = moved[places] - moved[places - 50]
        calm = places[span <= span.min()]
        cuts.append(int(calm[np.argmin(np.abs(calm - near))]))
    cuts.append(len(record))
    return [
        Record(record.u[a:b], record.y[a:b], f"{record.name} part {k}")
        for k, (a, b) in enumerate(pairwise(cuts), 1)
    ]


@dataclass(frozen=True, eq=False)
class FlightFit:
    """One engine in one flight: the whole record, its parts, and with a meter of second order."""

    record: Record
    whole: OutputErrorFit
    parts: tuple[OutputErrorFit, ...]
    second_order: OutputErrorFit

    @property
    def repeated(self) -> dict[str, Repeated]:
        """Parameters over the parts: Table 3 for this flight."""
        return repeatability(self.parts)


def identify_flight(record: Record, dt_s: float, parts: int = 3) -> FlightFit:
    """Fit the whole record and each part, noise estimated; raises as `fit` does."""
    model = EngineFromSteady(dt_s)
    free = tuple(one.name for one in model.parameters if one.free or one.name in OFFSETS)
    lagged = Plan(free=(*free, *_METER), iterations=100)
    whole = fit(model, [record], lagged)
    start = whole.parameters()
    near = Plan(free=lagged.free, start=start, iterations=100)
    every = [fit(model, [part], near) for part in parts_of_equal_motion(record, parts)]
    wider = Plan(free=(*free, *_METER, "square_M"), start=start, iterations=100)
    return FlightFit(record, whole, tuple(every), fit(model, [record], wider))


def meter(found: FlightFit) -> str:
    """Say what the records determine of the fuel meter, whose output is the input here.

    The deviation of 1/omega^2 is scaled by the Birge ratio of the lag over the parts.
    """
    row = found.repeated["tau_M"]
    square, sd = found.second_order.estimates()["square_M"]
    sd *= max(1.0, row.combined.birge)
    k = found.whole.names.index("tau_M")
    others = np.abs(np.delete(found.whole.correlation[k], k))
    names = [name for name in found.whole.names if name != "tau_M"]
    text = (
        f"2 zeta/omega = {found.whole.values[k]:.2f} s ({min(row.estimates):.2f} to "
        f"{max(row.estimates):.2f} s in parts), from the zero that it adds to a first-order rotor; "
        f"correlation with {names[int(np.argmax(others))]} {others.max():.2f}"
    )
    if square > 1.96 * sd:
        return f"{text}; omega = {square**-0.5:.1f} rad/s"
    return (
        f"{text}; omega and zeta at constant zeta/omega are unidentifiable "
        f"(1/omega^2 = {square:.3f} s2, sd {sd:.3f} s2)"
    )


def common_parameters(fits: Sequence[OutputErrorFit]) -> list[str]:
    """Free parameters without offsets, in order."""
    return [name for name in fits[0].names if name not in OFFSETS]
