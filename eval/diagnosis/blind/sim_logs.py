"""Cases from another maker's simulator, of which there are only logs: what can be put onto them.

Only what needs no second run of that simulator is used. Exact are effects of sensors and a delay
of the lever (it commutes with an engine that does not change with time). Nearly exact are steady
effects, if the control holds its first output: how many degrees or percent belong to one is that of
a typical two-spool turbofan, and nothing has the form that the diagnosis fits. On top come a build,
a structural misfit, and the noise of the instrumentation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from data_prep.log import Log
from eval.diagnosis.blind.cases import (
    CATALOGUE,
    BlindPlan,
    Case,
    Offer,
    Scale,
    draw_cases,
    drawn,
)
from eval.diagnosis.blind.make import Made, made_from
from eval.diagnosis.blind.outside import MIMICS, MISFIT, applied
from eval.diagnosis.blind.truth import (
    NOTHING,
    OUTPUTS,
    STRETCH_S,
    Channels,
    Content,
    Flight,
    Specimen,
    outputs_of,
)
from eval.diagnosis.pairs import read_folder
from narxcal.flight_test.scenario import drawn_windows
from narxcal.flight_test.signals import first_order, within
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import DataError

_SPOOL_S, _GAS_S = 1.6, 0.8  # after a bleed opens, N2 and exhaust temperature take so long
_SWITCHES: Final = ("NAI", "WAI", "ECS")


def switches_of(channels: Channels) -> tuple[str, ...]:
    return tuple(n for n in _SWITCHES if n in channels and np.ptp(channels[n]) > 0.0)


def _bled(flight: Flight, power: FloatArray, share: FloatArray) -> Channels:
    """A share of the core's air is taken away: hotter, and N2 up a little to keep N1."""
    slow = first_order(share, _SPOOL_S, flight.dt_s)
    fast = first_order(share, _GAS_S, flight.dt_s)
    return {
        "EGT_C": 1100.0 * fast * (0.65 + 0.35 * power**1.5),
        "N2_pct": 16.0 * slow * (1.0 - 0.5 * power),
        "FF_kgph": flight.inputs.get("FF_kgph", np.zeros(1)) * 1.6 * fast,
    }


def _bleed(flight: Flight, power: FloatArray, size: float) -> Channels:
    on = sum(flight.inputs[name] for name in switches_of(flight.inputs))
    return _bled(flight, power, size * np.minimum(np.asarray(on, np.float64) + 0.0 * power, 1.0))


def _hidden(flight: Flight, power: FloatArray, size: float) -> Channels:
    on = within(np.arange(len(power), dtype=np.float64) * flight.dt_s, flight.windows)
    return _bled(flight, power, size * on.astype(np.float64))


def _worn(flight: Flight, power: FloatArray, size: float) -> Channels:
    """Efficiency lost in compressor and turbine: hotter with power, N2 a little down."""
    fuel = flight.inputs.get("FF_kgph", np.zeros(1))
    return {
        "EGT_C": size * (4.0 + 5.0 * power**1.3),
        "N2_pct": -size * (0.05 + 0.12 * power),
        "FF_kgph": fuel * 0.011 * size,
    }


def _day(flight: Flight, power: FloatArray, size: float) -> Channels:
    """The control's N1 is off by `size` percent per degC of the day, and all else goes along."""
    more = size * flight.inputs["dT_C"]
    return {
        "N1_pct": more,
        "N2_pct": more * (0.55 - 0.2 * power),
        "EGT_C": more * (3.0 + 4.0 * power),
    }


def _soaked(flight: Flight, power: FloatArray, size: float) -> Channels:
    """Metal that is colder than the gas cools it; it heats up the faster the higher the power."""
    egt = flight.inputs["EGT_C"]
    keep = np.exp(-flight.dt_s / (45.0 + 110.0 * (1.0 - power)))
    metal = np.empty_like(egt)
    state = float(egt[0])
    for k, (gas, share) in enumerate(zip(egt.tolist(), keep.tolist(), strict=True)):
        metal[k] = state
        state = gas + (state - gas) * share
    cold = 0.035 * size * (egt - metal)
    return {"EGT_C": -cold, "N2_pct": -0.004 * cold}


# What each adds to the outputs of a flight, by its power from 0 to 1 and a size.
SHIFTS: Final[dict[str, Callable[[Flight, FloatArray, float], Channels]]] = {
    "bleed_extraction": _bleed,
    "unlogged_switch": _hidden,
    "deterioration": _worn,
    "temperature_effect": _day,
    "heat_soak": _soaked,
}


ENGINE: Final = "maker"
_FOLDERS: Final = ("sim", "sim_heldout")
# Standard deviation of a build, in parts of the range: offset, slope and bend over power each.
_BUILD: Final = {"N1_pct": 0.001, "N2_pct": 0.003, "EGT_C": 0.006, "FF_kgph": 0.006}


def make_log_cases(folder: Path, plan: BlindPlan, logs: Path) -> Iterator[Made]:
    """Make the cases of a plan from the simulator's logs, one after the other.

    `logs` holds them, or folders `sim` and `sim_heldout` at any depth. Flights are used whole.
    Raises `DataError` for too few of them, and as `read_folder`.
    """
    flights = _read(logs)
    needed = plan.flights + plan.held_out
    if len(flights) < needed:
        raise DataError(
            f"there are {len(flights)} simulated flights, and a case needs {needed}",
            file=logs,
            hint="Add logs, or take fewer by --flights and --held-out",
        )
    for case in draw_cases(plan, offer_of(flights)):
        yield made_from(folder, plan, LogSpecimen(case, plan, flights))


class LogSpecimen(Specimen):
    """A case whose simulator is known by its logs alone, which are behind its own sensors."""

    def __init__(self, case: Case, plan: BlindPlan, logs: Sequence[Log]) -> None:
        super().__init__(case, plan, dict.fromkeys(OUTPUTS, 0.0))
        random = self._drawn(0)
        order = random.permutation(len(logs))[: plan.flights + plan.held_out].tolist()
        self.logs = [_channels(logs[k]) for k in order]
        scatter = 0.0 if plan.build == "same" else 1.0
        self._bends = {
            name: scatter * scale * random.standard_normal(3) for name, scale in _BUILD.items()
        }

    def flight(self, number: int) -> Flight:
        channels = self.logs[number]
        windows = drawn_windows(self._drawn(2, number), float(channels["time_s"][-1]), STRETCH_S)
        return Flight(number, channels, windows)

    def simulated(
        self, flight: Flight, content: Content = NOTHING, *, built: bool = False
    ) -> Channels:
        seen = self._built(flight, content) if built else self._with(flight, content)
        return seen if content == NOTHING else self._shown(seen, flight, content, self._perfect)

    def _real(self, flight: Flight, content: Content) -> Channels:
        real = self._built(flight, content)
        for what, size in MISFIT if self.case.base.misfit else ():
            real = applied(what, "output", real, size)
        return real

    def _built(self, flight: Flight, content: Content) -> Channels:
        real = self._with(flight, content)
        p = self._power(flight) - 0.5
        for name in outputs_of(real):
            a, b, c = self._bends[name]
            span = float(np.ptp(flight.inputs[name]))
            real[name] = real[name] + span * (a + 2.0 * b * p + 4.0 * c * p**2)
        return real

    def _with(self, flight: Flight, content: Content) -> Channels:
        found = dict(flight.inputs)
        for dose in content.doses:
            if dose.scale.id in SHIFTS:
                shifts = SHIFTS[dose.scale.id](flight, self._power(flight), dose.size)
                found |= {n: found[n] + each for n, each in shifts.items() if n in found}
        for dose in content.doses:
            if dose.scale.id == "throttle_delay":
                found |= _late(found, dose.size / flight.dt_s)
        if self.case.strange is not None and content.strange:
            found = applied(self.case.strange, "output", found, content.strange)
        return found

    def _power(self, flight: Flight) -> FloatArray:
        """N1 from 0 to 1 over all flights of the case."""
        least = min(float(each["N1_pct"].min()) for each in self.logs)
        most = max(float(each["N1_pct"].max()) for each in self.logs)
        return (flight.inputs["N1_pct"] - least) / (most - least)

    def _seed(self, _flight: Flight) -> int:
        return int(self._drawn(1).integers(2**31))

    def _drawn(self, purpose: int, number: int = 0) -> np.random.Generator:
        return drawn(self.plan, 4, self.case.number, purpose, number)


def offer_of(flights: Sequence[Log]) -> Offer:
    """What can be put onto these logs."""
    first = _channels(flights[0])
    days = [float(log["dT_C"].mean()) for log in flights if "dT_C" in log.channels]
    missing = set()
    if not all(switches_of(_channels(log)) for log in flights):
        missing.add("bleed_extraction")
    if not days or np.ptp(days) < 1.0:
        missing.add("temperature_effect")

    def possible(scale: Scale) -> bool:
        if scale.channel is not None:
            return scale.channel in outputs_of(first)
        return scale.id == "throttle_delay" or (scale.id in SHIFTS and scale.id not in missing)

    return Offer(
        tuple(scale for scale in CATALOGUE if possible(scale)),
        tuple(each for each in MIMICS if each.on == "output"),
        ENGINE,
    )


def _read(folder: Path) -> list[Log]:
    parts = [each for each in folder.rglob("*") if each.is_dir() and each.name in _FOLDERS]
    parts = sorted(parts) or [folder]
    return [log for part in parts for log in read_folder(part).values()]


def _channels(log: Log) -> Channels:
    return {"time_s": log.time_s - log.time_s[0], **log.channels}


def _late(channels: Channels, steps: float) -> Channels:
    index = np.arange(len(channels["time_s"]), dtype=np.float64)
    return {n: np.interp(index - steps, index, channels[n]) for n in outputs_of(channels)}
