"""Cases from real flights: an effect added exactly to what was recorded, all else as it was.

GAP section 2, tier P. Effects of sensors are put on a recorded output. A delay of the lever is
made by handing the lever earlier: to whoever answers, and to the simulator. Effects inside the
engine are what they change in a lumped engine (`injected`). Flights are cut into pieces; what the
real engine has besides stays in, so there are no nulls among these cases.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from data_prep.log import Log
from data_prep.prepare import hold_inputs
from eval.gap.blind.cases import BINS, BlindPlan, Content, draw_share
from eval.gap.blind.catalogue import CATALOGUE, Dose, Scale, Windows
from eval.gap.blind.files import FOLDERS, write_log
from eval.gap.blind.injected import EFFECTS, Injector, possible
from eval.gap.blind.make import Made
from eval.gap.blind.oracle import located
from eval.gap.blind.sizes import energy, gap_share, ranges, size_for
from eval.gap.blind.truth import hidden_windows
from eval.gap.pairs import DIAGNOSED, match_simulated, read_folder
from eval.gap.simulators import Simulate, open_simulator
from narxcal.channels import CHANNELS
from narxcal.flight_test.sensors import SensorConfig, Streams, record
from narxcal.support.arrays import FloatArray, bridge_gaps
from narxcal.support.errors import ConfigError, DataError
from training.config import RunConfig

Channels = dict[str, FloatArray]
DRIVERS: Final = ("TRA_deg", "FF_kgph")
_PERFECT = SensorConfig(preset="perfect", inputs="exact")
_MOVES: Final = 0.1  # of its range: a piece in which the lever moves less says nothing


class Real(NamedTuple):
    """Where the flights are, which simulator is given for them, how their columns are called."""

    flights: Path
    simulator: str
    config: RunConfig | None = None
    trust: bool = False  # of a run folder whose steady-state model runs code


class Piece(NamedTuple):
    """A stretch of one log, `rows` of it."""

    log: str
    rows: slice


class Flown(NamedTuple):
    """All logs with their inputs complete, `(time,)`, and what simulates them.

    They are flown in pieces of `piece_s`, in each of which a drift begins anew.
    """

    logs: Mapping[str, Log]
    simulate: Simulate
    driver: str
    outputs: tuple[str, ...]
    injectors: Mapping[str, Injector]
    windows: Mapping[str, Windows]
    piece_s: float

    def simulated(self, early_s: float = 0.0) -> dict[str, Channels]:
        """Inputs and simulated outputs of every log, the lever `early_s` earlier."""
        return {name: self._one(name, log, early_s) for name, log in self.logs.items()}

    def _one(self, name: str, log: Log, early_s: float) -> Channels:
        told = replace(log, channels={n: log[n] for n in _inputs(log, self.driver)})
        if early_s:
            later = np.arange(len(log)) + early_s / log.dt_s
            driver = np.interp(later, np.arange(len(log)), log[self.driver])
            told = replace(told, channels={**told.channels, self.driver: driver})
        found = match_simulated(name, told, self.simulate)
        return {
            "time_s": log.time_s,
            **told.channels,
            **{output: found[output] for output in self.outputs},
        }


def make_real_cases(folder: Path, plan: BlindPlan, real: Real) -> Iterator[Made]:
    """Make the cases of a plan from real flights, one after the other.

    Raises `DataError` for flights with too few pieces and for what cannot be read, `ConfigError`
    for a simulator that gives none of the recorded outputs.
    """
    flown = _flown(real, plan.duration_s)
    pieces = _pieces(flown, plan)
    random = np.random.default_rng(np.random.SeedSequence(plan.seed, spawn_key=(2,)))
    scales = [each for each in CATALOGUE if _possible(each, flown)]
    if not scales:
        raise ConfigError("no effect of the catalogue can be put on these outputs")
    before = flown.simulated()
    order = random.permutation(plan.cases).tolist()
    width = max(3, len(str(plan.cases)))
    for place, which in enumerate(order, start=1):
        scale = scales[which % len(scales)]
        size = (which // len(scales) + which) % len(BINS)
        share = draw_share(Content("single", (scale,), bin=size), random)
        chosen = [pieces[k] for k in random.permutation(len(pieces))]
        wanted = _Wanted(f"case_{place:0{width}d}", scale, _sign(scale, random), share)
        yield _made(folder, (flown, before), wanted, chosen[: plan.flights + plan.held_out], plan)


class _Wanted(NamedTuple):
    name: str
    scale: Scale
    sign: float
    share: float


def _made(
    folder: Path,
    flown_before: tuple[Flown, Mapping[str, Channels]],
    wanted: _Wanted,
    pieces: Sequence[Piece],
    plan: BlindPlan,
) -> Made:
    flown, before = flown_before
    dose = _sized(flown, before, wanted)
    early_s = dose.size if dose.scale.id == "throttle_delay" else 0.0
    told = flown.simulated(early_s) if early_s else before
    recorded = {name: _recorded(flown, name, told[name], dose) for name in flown.logs}
    with_it = {name: _added(flown, name, told[name], dose) for name in flown.logs}
    parts = [[_cut(each[p.log], p.rows) for p in pieces] for each in (told, recorded, with_it)]
    held = slice(plan.flights, None)
    logs = {}
    for number, (sim, rec, _) in enumerate(zip(*parts, strict=True)):
        names = FOLDERS[:2] if number < plan.flights else FOLDERS[2:]
        for name, channels in zip(names, (sim, rec), strict=True):
            log = f"{name}/flight_{number}.csv.gz"
            logs[log] = write_log(folder / wanted.name / log, channels)
    own = slice(0, plan.flights)
    row = {
        "kind": "single",
        "style": "real",
        "engine": "real",
        "effects": [dose.row()],
        "outside": None,
        "base": {"differs": True},
        "aimed_share": wanted.share,
        "pieces": [[p.log, p.rows.start, p.rows.stop] for p in pieces],
        "gap_share": gap_share(parts[1][held], parts[0][held], parts[2][held]),
        **located(
            list(zip(parts[2][own], parts[0][own], strict=True)), parts[0][own], parts[1][own]
        ),
    }
    return Made(wanted.name, row, logs)


def _sized(flown: Flown, before: Mapping[str, Channels], wanted: _Wanted) -> Dose:
    """Size of the effect that comes to its share on the longest log."""
    name = max(flown.logs, key=lambda each: len(flown.logs[each]))
    log, simulated = flown.logs[name], before[name]
    spans = ranges([simulated])
    recorded = {**simulated, **{output: log[output] for output in flown.outputs}}
    rest = energy(recorded, simulated, spans)

    def measured(size: float) -> float:
        dose = Dose(wanted.scale, wanted.sign * size)
        return energy(_added(flown, name, simulated, dose), simulated, spans)

    part = rest * wanted.share / (1.0 - wanted.share)
    size = size_for(measured, part, (wanted.scale.first, wanted.scale.most))
    return Dose(wanted.scale, wanted.sign * size)


def _added(flown: Flown, name: str, simulated: Channels, dose: Dose) -> Channels:
    """Simulated channels with the effect: on one sensor, inside, or on all outputs as a delay."""
    log, outputs = flown.logs[name], flown.outputs
    if dose.on_sensor:
        return _measured(flown, simulated, dose, log)
    if dose.scale.id in EFFECTS:
        return _injected(flown, name, simulated, dose)
    index = np.arange(len(log), dtype=np.float64)
    sooner = index - dose.size / log.dt_s
    late = {n: np.interp(sooner, index, v) for n, v in simulated.items() if n in outputs}
    return {**simulated, **late}


def _recorded(flown: Flown, name: str, told: Channels, dose: Dose) -> Channels:
    """What is handed over as recorded: inputs as told, outputs as they were or through a fault."""
    log = flown.logs[name]
    outputs = {**told, **{output: log[output] for output in flown.outputs}}
    if dose.scale.id in EFFECTS:
        return _injected(flown, name, outputs, dose)
    return _measured(flown, outputs, dose, log) if dose.on_sensor else outputs


def _injected(flown: Flown, name: str, channels: Channels, dose: Dose) -> Channels:
    """Channels of a log with what the effect changes inside an engine."""
    spans = {n: float(np.ptp(bridge_gaps(flown.logs[name][n]))) for n in flown.outputs}
    change = flown.injectors[name].change(dose, flown.windows[name], spans)
    return {**channels, **{n: channels[n] + each for n, each in change.items()}}


def _measured(flown: Flown, channels: Channels, dose: Dose, log: Log) -> Channels:
    """Channels with one of them through the fault; unknown samples stay unknown."""
    name = dose.scale.channel or ""
    fault, known = dose.fault("business_jet"), bridge_gaps(channels[name])
    size = round(flown.piece_s / log.dt_s) if dose.scale.id == "sensor_drift" else len(known)
    found = np.concatenate(
        [
            record({name: each}, log.dt_s, _PERFECT, Streams(0, 0, 0), [fault]).channels[name]
            for each in np.split(known, range(size, len(known), size))
        ]
    )
    return {**channels, name: np.where(np.isfinite(channels[name]), found, np.nan)}


def _flown(real: Real, piece_s: float) -> Flown:
    simulator = open_simulator(real.simulator, trust=real.trust)
    if isinstance(simulator.how, Path):
        raise ConfigError(
            "real flights need a simulator that can be run again, not a folder of its logs",
            hint="Name a run folder, an FMU or a function by --sim",
        )
    read = read_folder(real.flights, real.config)
    driver = next((name for name in DRIVERS if _in_all(name, read)), "")
    if not driver:
        raise DataError(
            f"a log has neither {' nor '.join(DRIVERS)}: nothing drives it", file=real.flights
        )
    logs = {name: hold_inputs(log, _inputs(log, driver)) for name, log in read.items()}
    given = simulator.how(next(iter(logs.values())))
    outputs = tuple(
        name for name in DIAGNOSED if name != driver and name in given and _in_all(name, logs)
    )
    if not outputs:
        raise ConfigError(
            "the simulator gives no output that all flights have",
            hint=f"It gives {', '.join(given)}",
        )
    injectors = {name: Injector(log.channels, driver, log.dt_s) for name, log in logs.items()}
    return Flown(logs, simulator.how, driver, outputs, injectors, _hidden(logs), piece_s)


def _hidden(logs: Mapping[str, Log]) -> dict[str, Windows]:
    """Windows of a hidden switch in every log."""
    random = np.random.default_rng(np.random.SeedSequence(0, spawn_key=(5,)))
    return {n: hidden_windows(random, float(np.ptp(log.time_s))) for n, log in logs.items()}


def _pieces(flown: Flown, plan: BlindPlan) -> list[Piece]:
    """Stretches of `duration_s` in which the driver moves."""
    found = []
    logs, driver = flown.logs, flown.driver
    span = max(float(np.ptp(log[driver])) for log in logs.values())
    for name, log in logs.items():
        size = round(flown.piece_s / log.dt_s)
        for number in range(len(log) // size):
            rows = slice(number * size, (number + 1) * size)
            if float(np.ptp(log[driver][rows])) >= _MOVES * span:
                found.append(Piece(name, rows))
    needed = plan.flights + plan.held_out
    if len(found) < needed:
        raise DataError(
            f"the flights give {len(found)} pieces of {plan.duration_s:g} s in which the "
            f"{driver} moves, and a case needs {needed}",
            hint="Take more flights, or less by --flights and --held-out",
        )
    return found


def _possible(scale: Scale, flown: Flown) -> bool:
    inside = possible(flown.driver, flown.outputs, scale.id)
    return inside or scale.id == "throttle_delay" or (scale.channel or "") in flown.outputs


def _sign(scale: Scale, random: np.random.Generator) -> float:
    sign = float(random.choice((-1.0, 1.0)))
    return sign if scale.signed else 1.0


def _in_all(name: str, logs: Mapping[str, Log]) -> bool:
    return all(name in log.channels for log in logs.values())


def _inputs(log: Log, driver: str) -> list[str]:
    roles = ("lever", "ambient", "switch")
    return [name for name in log.channels if name == driver or CHANNELS[name].role in roles]


def _cut(channels: Mapping[str, FloatArray], rows: slice) -> Channels:
    found = {name: values[rows] for name, values in channels.items()}
    return {**found, "time_s": found["time_s"] - found["time_s"][0]}
