"""All pairs as one batch of arrays: means over blocks, events, units, held-out flights alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from data_prep.events import PULL, PUSH, Event, EventsConfig, find_events
from data_prep.log import Log
from eval.diagnosis.pairs import RATES, Pair
from eval.judging.outcome import plural
from narxcal.channels import spools_of
from narxcal.effects.base import Signals
from narxcal.effects.running import Flights, with_load
from narxcal.effects.steady import SWITCHES, UNLOGGED
from narxcal.support.arrays import FloatArray, IntArray, block_means, noise_level
from narxcal.support.errors import DataError
from training.diagnosis.budget import Phases
from training.diagnosis.metric import Record
from training.responses.response import HIGH, LOW

Regimes = dict[str, tuple[tuple[str, ...], IntArray]]
DIRECTIONS = ("push", "pull", "steady")
PHASES = ("initiation", "transit", "settling", "steady")
# What the lever does and how far the response is, in the order of the numbers of `moves_of`.
MOVES = (
    ("steady", "steady"),
    *((direction, phase) for direction in DIRECTIONS[:2] for phase in PHASES[:3]),
)
LEVELS = ("low", "mid", "high")
# Where a level begins: 10000 and 25000 ft, Mach 0.3 and 0.6, thirds of the speed range.
EDGES = {"altitude": (10e3, 25e3), "Mach": (0.3, 0.6), "power": (1 / 3, 2 / 3)}
_SMALL = 0.01  # of the range: a change whose 10 % and 90 % cannot be read
RATE_HZ = 4.0
KEEP_HZ = 5.0  # slower logs are taken as they are
_STILL = 1e-6  # of a channel's size: what changes by less does not change
_SILENT = 1e-5  # of a channel's range: logs that agree to the digit have no less noise
_TRIMMED = 90.0  # percentile of the second differences that counts where their median is none


def batch(pairs: Sequence[Pair], rate_hz: float = RATE_HZ, keep_hz: float = KEEP_HZ) -> Record:
    """Put all pairs on one raster of about `rate_hz`, by means over whole blocks of samples.

    Logs of up to `keep_hz` keep their own. Means do not shift recorded against simulated, and white
    noise falls with the root of the block. A block is known where at least half of it is.
    """
    size = block_size(pairs[0].dt_s, rate_hz, keep_hz)
    inputs, outputs = tuple(pairs[0].inputs), tuple(pairs[0].sim)
    u = [_blocks(pair.inputs, inputs, size) for pair in pairs]
    y = [_blocks(pair.sim, outputs, size) for pair in pairs]
    real = [_blocks(pair.real, outputs, size) for pair in pairs]
    none = np.zeros(len(outputs))
    signals = Signals(inputs, outputs, pairs[0].dt_s * size, pairs[0].driver, none, none)
    signals = _in_ranges(signals, np.concatenate(u), np.concatenate(y))
    flights = Flights(signals, filled_up(u), filled_up(y), np.array([len(each) for each in u]))
    inside = np.arange(flights.u.shape[1]) < flights.lengths[:, None]
    measured = np.where(inside[..., None], filled_up(real), np.nan)
    gaps = [r - s for r, s in zip(real, y, strict=True)]
    noise = np.median([[_fast_part(one) for one in gap.T] for gap in gaps], axis=0)
    noise = np.maximum(noise, _SILENT * (signals.high - signals.low))
    fast = _fast_energy(pairs, outputs, gaps)
    names = tuple(pair.name for pair in pairs)
    return Record(flights, measured, noise, _units(flights), _groups(flights), fast, names)


def block_size(dt_s: float, rate_hz: float = RATE_HZ, keep_hz: float = KEEP_HZ) -> int:
    return 1 if 1.0 / dt_s <= keep_hz else max(1, round(1.0 / (dt_s * rate_hz)))


def _blocks(channels: Mapping[str, FloatArray], names: Sequence[str], size: int) -> FloatArray:
    return block_means(np.column_stack([channels[name] for name in names]), size)


def filled_up(parts: Sequence[FloatArray]) -> FloatArray:
    """Flights (time, n) as one array (flights, time, n), shorter ones with their last row on."""
    longest = max(map(len, parts))
    return np.stack([np.pad(one, ((0, longest - len(one)), (0, 0)), "edge") for one in parts])


def _in_ranges(signals: Signals, u: FloatArray, y: FloatArray) -> Signals:
    """The signals with the ranges of inputs and outputs, (samples, ...)."""
    size = np.maximum(np.abs(u).max(axis=0), 1e-9)
    lever = u[:, signals.u(signals.driver)]
    return replace(
        signals,
        low=y.min(axis=0),
        high=y.max(axis=0),
        lever=(float(lever.min()), float(lever.max())),
        active=tuple(np.array(signals.inputs)[np.ptp(u, axis=0) > _STILL * size].tolist()),
    )


def _fast_energy(
    pairs: Sequence[Pair], outputs: Sequence[str], means: Sequence[FloatArray]
) -> FloatArray:
    whole = np.concatenate([[p.real[n] - p.sim[n] for n in outputs] for p in pairs], axis=1)
    slow = np.concatenate(means)
    lost = np.nanmean(whole**2, axis=1) - np.nanmean(slow**2, axis=0)
    return np.asarray(np.maximum(lost, 0.0))


def _fast_part(gap: FloatArray) -> float:
    """Noise of one gap: robust, and not fooled by a coarse resolution.

    Readings that mostly repeat give a median of none; the smaller nine tenths of the second
    differences then tell.
    """
    found, bends = noise_level(gap), np.abs(np.diff(gap, 2))
    if found > 0.0 or not np.isfinite(bends).any():
        return found
    small = bends[bends <= np.nanpercentile(bends, _TRIMMED)]
    return float(np.sqrt(np.mean(small**2) / 6.0))


FEWEST = 3  # pushes, and pulls, over all flights: fewer say nothing about their spread
_FUEL_FRACTION = 0.05  # a fuel flow wanders more than a lever does


def events_of(data: Record) -> tuple[tuple[Event, ...], ...]:
    """Pushes and pulls of each flight, settled when the simulated speeds are."""
    signals = data.flights.signals
    speeds = spools_of(signals.outputs)
    config = EventsConfig(
        driver=signals.driver,
        response=speeds or signals.outputs[:1],
        condition="",
        min_fraction=0.02 if signals.governed else _FUEL_FRACTION,
    )
    return tuple(tuple(find_events(_log(data, f), config)) for f in range(len(data.names)))


def _log(data: Record, f: int) -> Log:
    flights, n = data.flights, int(data.flights.lengths[f])
    signals = flights.signals
    channels = {signals.driver: flights.u[f, :n, signals.u(signals.driver)]}
    channels |= {name: flights.y[f, :n, signals.y(name)] for name in signals.outputs}
    return Log(data.names[f], np.arange(n, dtype=np.float64) * signals.dt_s, channels)


def check_excitation(data: Record, events: Sequence[Sequence[Event]]) -> None:
    """Raise `DataError`, saying what is missing, for fewer than three pushes or three pulls."""
    labels = [event.label for flight in events for event in flight]
    found = {("push", "pushes"): labels.count(PUSH), ("pull", "pulls"): labels.count(PULL)}
    if min(found.values()) >= FEWEST:
        return
    missing = " and ".join(
        f"{FEWEST - count} more {many}" for (_, many), count in found.items() if count < FEWEST
    )
    counted = " and ".join(f"{n} {one if n == 1 else many}" for (one, many), n in found.items())
    raise DataError(
        f"too little excitation: {counted} of {data.flights.signals.driver} in "
        f"{plural(len(data.names), 'flight')}, {FEWEST} of each are needed",
        hint=f"Fly at least {missing}, idle to high power and back",
    )


_BLOCK_S, _MOST = 300.0, 6  # of a flight, where fewer than three stand for themselves


def moves_of(data: Record, events: Sequence[Sequence[Event]]) -> IntArray:
    """Row of `MOVES` (flights, time) that each sample is in; -1 beyond a flight's end."""
    flights = data.flights
    move = np.full(flights.u.shape[:2], -1)
    for f, found in enumerate(events):
        n = int(flights.lengths[f])
        move[f, :n] = 0
        for event in found:
            move[f, event.start + 1 : event.stop] = _phases(flights.y[f, :, 0], event, data.span[0])
    return move


def _phases(y: FloatArray, event: Event, span: float) -> IntArray:
    """Rows of `MOVES` from the sample after the event's start to its end."""
    first = 1 + 3 * event.label
    part = y[event.start : event.stop]
    change = part[-1] - part[0]
    phases = np.full(len(part) - 1, first + 2)
    if abs(change) < _SMALL * span:
        return phases
    share = (part[1:] - part[0]) / change
    t10 = int(np.argmax(share >= LOW))
    t90 = t10 + int(np.argmax(share[t10:] >= HIGH))
    phases[:t10] = first
    phases[t10 : t90 + 1] = first + 1
    return phases


def regimes_of(data: Record) -> Regimes:
    """Altitude, Mach, power and bleed, as far as the inputs tell.

    Each has the names of its levels, and which one each sample is in, (flights, time).
    """
    flights, signals = data.flights, data.flights.signals
    values = {"power": signals.power(flights.y)}
    for name, channel in (("altitude", "ALT_ft"), ("Mach", "Mach")):
        if channel in signals.inputs:
            values[name] = flights.u[..., signals.u(channel)]
    found: Regimes = {
        name: (LEVELS, np.digitize(each, EDGES[name]).astype(np.int64))
        for name, each in values.items()
    }
    switches = [name for name in SWITCHES if name in signals.active]
    if switches:
        found["bleed"] = _combined(switches, [flights.u[..., signals.u(s)] for s in switches])
    return found


def _combined(
    names: Sequence[str], states: Sequence[FloatArray]
) -> tuple[tuple[str, ...], IntArray]:
    """Which switches are on: one level for each combination there is."""
    number = sum(((state > 0.5).astype(int) << k for k, state in enumerate(states)), start=0)
    present, index = np.unique(np.asarray(number), return_inverse=True)
    labels = tuple(
        "+".join(name for k, name in enumerate(names) if code >> k & 1) or "off" for code in present
    )
    return labels, np.asarray(index).reshape(states[0].shape)


def _units(flights: Flights) -> IntArray:
    """Unit (flights, time) of every sample: flights, or blocks of them where there are few."""
    count, steps = flights.u.shape[:2]
    unit = np.full((count, steps), -1)
    start = 0
    for f, length in enumerate(flights.lengths.tolist()):
        parts = 1
        if count < 3:
            parts = int(np.clip(length * flights.signals.dt_s / _BLOCK_S, 2, _MOST))
        unit[f, :length] = start + np.arange(length) * parts // length
        start += parts
    return unit


def _groups(flights: Flights) -> tuple[int, ...]:
    signals = flights.signals
    if "ALT_ft" not in signals.active:
        return tuple(range(len(flights.u)))
    flown = flights.u[..., signals.u("ALT_ft")]
    return tuple(
        next(g for g in range(f + 1) if np.array_equal(flown[g], flown[f]))
        for f in range(len(flown))
    )


def phases_of(data: Record) -> Phases:
    names = tuple("steady" if d == "steady" else f"{d}_{p}" for d, p in MOVES)
    return Phases(names, moves_of(data, events_of(data)))


_HINT = "Record and simulate them with the channels and at the rate of the others"


def in_terms_of(data: Record, other: Record) -> Record:
    """`other` with the signals of `data`.

    An input that `other` lacks and that never changes in `data` has its value there. Raises
    `DataError` for one that does change, for an output that is missing, and for another rate.
    """
    if UNLOGGED in data.flights.signals.inputs:
        off = np.zeros(other.flights.u.shape[:2])
        other = replace(other, flights=with_load(other.flights, off, always=True))
    mine, theirs = data.flights.signals, other.flights.signals
    if abs(theirs.dt_s / mine.dt_s - 1.0) > RATES:
        raise DataError(
            f"the held-out flights are processed at {1 / theirs.dt_s:.4g} Hz, those of the "
            f"diagnosis at {1 / mine.dt_s:.4g} Hz",
            file=other.names[0],
            hint=_HINT,
        )
    for name in mine.outputs:
        if name not in theirs.outputs:
            raise _lacking(other, name)
    columns = [theirs.outputs.index(name) for name in mine.outputs]
    u = np.stack([_input(data, other, name) for name in mine.inputs], axis=-1)
    flights = replace(other.flights, signals=mine, u=u, y=other.flights.y[..., columns])
    return replace(
        other, flights=flights, real=other.real[..., columns], noise=other.noise[columns]
    )


def together(first: Flights, others: Flights) -> Flights:
    """Flights (flights, time, ...) of the same inputs and outputs as one batch, in their ranges.

    What was recorded is no part of it: what a simulator says of a flight is known before anybody
    has flown it.
    """
    u, y = filled_up([*first.u, *others.u]), filled_up([*first.y, *others.y])
    signals = _in_ranges(first.signals, *(each.reshape(-1, each.shape[2]) for each in (u, y)))
    return Flights(signals, u, y, np.concatenate([first.lengths, others.lengths]))


def _input(data: Record, other: Record, name: str) -> FloatArray:
    """The input (flights, time) of the other flights, or what it is throughout the diagnosed."""
    mine, theirs = data.flights, other.flights
    if name in theirs.signals.inputs:
        return theirs.u[..., theirs.signals.u(name)]
    if name in mine.signals.active:
        raise _lacking(other, name)
    return np.full(theirs.u.shape[:2], np.median(mine.u[..., mine.signals.u(name)]))


def _lacking(other: Record, name: str) -> DataError:
    return DataError("the held-out flights lack it", file=other.names[0], channel=name, hint=_HINT)
