"""How far the gap is expected to shrink on other flights, before what was recorded there is seen.

On the flights at hand the effects take `before - left` of the squared gap, each flight by what the
others give. Further flights may be like these, or have more of what the effects do, and then more
of the gap that they explain: what they change there follows from the inputs, and what they leave
comes at some rate per sample, so that

    share = moved / (moved + rest),   moved = change' * sum(before - left) / sum(change)

and `rest` is the rate of what is left, times the samples. Which of the two holds, or how much of
either, follows from flights that are predicted by the others, as does the interval: in the
logarithm of what is left, which no effect makes less than nothing and other misfit can make any
amount of.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd
from scipy.stats import t

from data_prep.events import PUSH, Event
from narxcal.effects.base import Signals
from narxcal.effects.library import effect, name_of
from narxcal.effects.running import Emulator, Flights, Setting, respond
from narxcal.effects.steady import UNLOGGED_SWITCH
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError
from training.diagnosis.budget import Interval
from training.diagnosis.fit import Frame
from training.diagnosis.metric import Record
from training.responses.response import Transient, TransientConfig, measure_transient

Values = Mapping[str, Mapping[str, float]]  # effect -> parameter -> value


@dataclass(frozen=True)
class ChannelShrink:
    """RMSE of one channel's gap: before, after the effects are added, and the noise floor."""

    before: float
    after: float
    floor: float


@dataclass(frozen=True)
class TimeShrink:
    """Mean absolute errors of Ti and Tt in seconds over `events`, before and after."""

    events: int
    Ti_before_s: float
    Ti_after_s: float
    Tt_before_s: float
    Tt_after_s: float


@dataclass(frozen=True, eq=False)
class HeldOut:
    """What the found effects do on flights that took no part in finding them.

    `share` of the squared gap above the noise that they take away, as predicted; `channels` the
    RMSE before and after; `after` (flights, time, outputs) the simulator with them.
    `emulator_rmse` per channel is of the emulator's free run there, where the effects rest on it.
    """

    data: Record
    share: float
    channels: Mapping[str, ChannelShrink]
    after: FloatArray
    emulator_rmse: Mapping[str, float] = field(default_factory=dict)


def claimed_in(document: Mapping[str, Any]) -> Values:
    """Claimed effects of a document of any schema of narxcal.gap; raises `ConfigError`."""
    rows = {
        name_of(row): {key: float(found["value"]) for key, found in row["parameters"].items()}
        for row in document.get("effects", ())
    }
    wanted = document.get("verdict", {}).get("effects", ())
    lost = [name for name in wanted if name not in rows]
    if lost:
        raise ConfigError(f"the verdict names '{lost[0]}', which is not among the effects")
    return {name: rows[name] for name in wanted}


def settings(values: Values, signals: Signals) -> list[Setting]:
    """Effects with their parameters as one run, for signals that hold what they act on.

    A parameter that is not given is neutral. Raises `ConfigError` for an unknown parameter, and
    for an effect that cannot act on these signals.
    """
    return [(effect(name), _theta(name, given, signals)) for name, given in values.items()]


def _theta(name: str, given: Mapping[str, float], signals: Signals) -> FloatArray:
    found = effect(name)
    if not found.applies(signals):
        raise ConfigError(
            f"effect '{name}' cannot act on these logs",
            hint=f"They have {', '.join((*signals.inputs, *signals.outputs))}; what it acts on "
            "is missing or never changes",
        )
    known = {parameter.name: parameter.neutral for parameter in found.parameters(signals)}
    lost = [key for key in given if key not in known]
    if lost:
        raise ConfigError(
            f"effect '{name}' has no parameter '{lost[0]}'", hint=f"It has {', '.join(known)}"
        )
    return np.array([[given.get(key, neutral) for key, neutral in known.items()]])


def shift_of(values: Values, signals: Signals) -> FloatArray:
    sizes = values[UNLOGGED_SWITCH.id]
    return np.array([sizes.get(f"on_{name}", 0.0) for name in signals.outputs])


def with_effects(values: Values, flights: Flights, emulator: Emulator | None) -> FloatArray:
    """Outputs (flights, time, outputs) of the simulator with effects of these values."""
    if not values:
        return flights.y
    return np.asarray(respond(settings(values, flights.signals), flights, emulator)[0])


def held_out(values: Values, data: Record, emulator: Emulator | None) -> HeldOut:
    after = with_effects(values, data.flights, emulator)
    share = float(pooled_share(*squares(data, after)))
    return HeldOut(data, share, channel_shrink(data, after), after)


def squares(data: Record, after: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Sums of squares of the gap above the noise per flight, before and `after`: (flights,) each.

    Plain differences of recorded and simulated outputs, each channel over
    `noise^2 + (0.001 range)^2`, so that anybody can form them from the logs.
    """
    floor = np.isfinite(data.difference) * data.noise**2
    before, left = (
        np.nansum((each**2 - floor) / data.variance, axis=(1, 2))
        for each in (data.difference, data.real - after)
    )
    return before, left


def pooled_share(before: FloatArray, left: FloatArray) -> float:
    """Share of the squared gap that is taken away over all flights; 0 where there is no gap.

    No more than all: what is left may by chance be less than the noise.
    """
    whole = float(before.sum())
    return min(1.0, 1.0 - float(left.sum()) / whole) if whole > 0.0 else 0.0


def channel_shrink(data: Record, after: FloatArray) -> dict[str, ChannelShrink]:
    """Root mean squares of recorded less simulated, before and after, and the noise."""
    before = np.sqrt(np.nanmean(data.difference**2, axis=(0, 1)))
    left = np.sqrt(np.nanmean((data.real - after) ** 2, axis=(0, 1)))
    return {
        name: ChannelShrink(float(before[k]), float(left[k]), float(data.noise[k]))
        for k, name in enumerate(data.flights.signals.outputs)
    }


def time_shrink(
    before: Mapping[str, pd.DataFrame], after: Mapping[str, pd.DataFrame]
) -> dict[str, TimeShrink]:
    """Compare `time_errors` before and after, on the events that both have."""
    return {name: _both(before[name], after[name]) for name in before}


def _both(before: pd.DataFrame, after: pd.DataFrame) -> TimeShrink:
    shared = before.merge(after, on=["flight", "start"], suffixes=("", "_after"))
    names = ("Ti_s", "Ti_s_after", "Tt_s", "Tt_s_after")
    return TimeShrink(len(shared), *(float(shared[name].abs().mean()) for name in names))


_AT_ONCE = 2  # flights that are predicted by the others
_LEVEL = 0.95  # of Student's distribution: a 90 % interval
_FINE = 0.1  # of the gap: a share that is added to what is left, so that little is as good as none
_NONE = 1e-9


class Sums(NamedTuple):
    """Sums of squares over the noise's per flight, (flights,) each.

    `before` and `left` are of the gap above the noise without and with effects, `change` of what
    they do to the outputs, `samples` how many are known.
    """

    before: FloatArray
    left: FloatArray
    change: FloatArray
    samples: FloatArray

    def of(self, rows: Sequence[int]) -> Sums:
        return Sums(*(each[list(rows)] for each in self))


class Other(NamedTuple):
    """What is known of flights unseen, (flights,) each: see `Sums`."""

    change: FloatArray
    samples: FloatArray


def seen(data: Record, after: FloatArray, by_others: FloatArray | None) -> Sums:
    """Sum up flight by flight what `after` (flights, time, outputs) changes and leaves.

    With `by_others` added it is what the parameters do that the other flights give: what each
    flight would have left if it had taken no part.
    """
    unfitted = after if by_others is None else after + by_others
    return Sums(*squares(data, unfitted), *unseen(data, after))


def unseen(data: Record, after: FloatArray) -> Other:
    """What `after` changes, and where anything was recorded, whatever that is."""
    known = np.isfinite(data.real)
    change = (after - data.flights.y) ** 2 / data.variance
    samples = known.sum(axis=(1, 2)).astype(np.float64)
    return Other(np.sum(change, axis=(1, 2), where=known), samples)


def expected(found: Sums, other: Other | None = None) -> Interval:
    """Share of the squared gap that effects will take off flights unseen, with a 90 % interval.

    Flights that nothing is known of are like those they were `found` in. One flight says nothing of
    the scatter between them.
    """
    count = len(found.before)
    alike = _if_alike(found)
    if count < 2:
        return Interval(alike, -1.0, 1.0)
    tried, out = _by_others(found)
    true = _log_left(tried[:, 2])
    part = 0.0 if other is None else _part(*(tried[:, :2] - tried[:, 2:]).T)
    ways = np.array([alike, alike if other is None else _by_change(found, other)])
    many = _AT_ONCE if other is None else len(other.change)
    # Errors vary as the mean of the flights predicted, and as that of those that predict them; and
    # as the two ways do from their mixture.
    scatter = (1.0 / many + 1.0 / count) / (1.0 / out + 1.0 / (count - out))
    squared = [np.mean((_log_left(tried[:, way]) - true) ** 2) for way in (0, 1)]
    apart = float(np.ptp(_log_left(ways)))
    spread = scatter * ((1.0 - part) * squared[0] + part * squared[1])
    spread += part * (1.0 - part) * apart**2
    value = float((1.0 - part) * ways[0] + part * ways[1])
    return _within(value, float(t.ppf(_LEVEL, count - 1) * np.sqrt(spread)))


def _by_others(found: Sums) -> tuple[FloatArray, int]:
    """Shares (sets, 3) of sets of flights by the others in both ways, and true; size of a set."""
    count = len(found.before)
    out = min(_AT_ONCE, count - 1)
    rows = []
    for chosen in combinations(range(count), out):
        rest = found.of([f for f in range(count) if f not in chosen])
        one = found.of(chosen)
        there = Other(one.change, one.samples)
        rows.append((_if_alike(rest), _by_change(rest, there), _if_alike(one)))
    return np.array(rows), out


def _if_alike(found: Sums) -> float:
    """Share that is taken off these flights, and off any in which all is as in them."""
    return max(-1.0, pooled_share(found.before, found.left))


def _by_change(found: Sums, other: Other) -> float:
    """Share that is taken off flights in which the effects do what they do there."""
    taken = float((found.before - found.left).sum()) / max(float(found.change.sum()), _NONE)
    moved = taken * float(other.change.sum())
    rate = float(found.left.sum()) / max(float(found.samples.sum()), 1.0)
    whole = moved + max(rate * float(other.samples.sum()), 0.0)
    return float(np.clip(moved / max(whole, _NONE), -1.0, 1.0))


def _part(alike: FloatArray, by_change: FloatArray) -> float:
    apart = by_change - alike
    return float(np.clip(-(alike @ apart) / max(float(apart @ apart), _NONE), 0.0, 1.0))


def _log_left(share: FloatArray) -> FloatArray:
    return np.asarray(np.log(1.0 - share + _FINE))


def _within(share: float, reach: float) -> Interval:
    """The share with the ends at which so much more or less is left."""
    left = 1.0 - share + _FINE
    low, high = (1.0 + _FINE - left * float(np.exp(way * reach)) for way in (1.0, -1.0))
    return Interval(share, max(-1.0, low), min(1.0, high))


def taken_off(frame: Frame, change: FloatArray) -> Interval:
    """Share of the squared gap that a `change` (flights, time, outputs) takes off its units.

    It is what effects do in each unit by what the other units give. Of its energy m in a unit it
    takes a m + e off, with e of a variance that goes with m: whether a is above zero depends
    neither on how much a flight lets effects do, nor on how large the rest of the gap is. With a
    90 % interval by Student's distribution.
    """
    inner, _, toward = frame.inner(change[None])
    moved, count = np.maximum(inner[:, 0, 0], _NONE), len(inner)
    taken = 2.0 * toward[:, 0] - moved
    a = float(taken.sum() / moved.sum())
    spread = np.sqrt(np.sum((taken - a * moved) ** 2 / moved) / max(count - 1, 1) / moved.sum())
    reach = float(t.ppf(_LEVEL, max(count - 1, 1)) * spread)
    scale = float(moved.sum()) / frame.whole
    return Interval(a * scale, (a - reach) * scale, (a + reach) * scale)


_LEAST = 0.08  # of the channel's range: the smallest response that is read
_BEFORE_S, _AFTER_S = 1.0, 8.0


_EVENT: Final = {"flight": int, "start": int, "direction": str, "Ti_s": float, "Tt_s": float}


def time_errors(
    data: Record, model: FloatArray, events: Sequence[Sequence[Event]]
) -> dict[str, pd.DataFrame]:
    """What `model` (flights, time, outputs) has too little of Ti and Tt, in seconds, by output.

    A row is an event that could be read both on `data.real` and on the model: its number of the
    flight, first sample and direction, and flight less model. Events that end before the speeds
    settle, responses below 8 % of the channel's range, and those that either side does not settle
    on are left out. A response is followed for up to 8 s after its event, as far as the lever
    rests: the flight may be slower than the model.
    """
    dt_s, lengths = data.flights.signals.dt_s, data.flights.lengths
    longer = [
        (f, replace(event, stop=min(event.stop + round(_AFTER_S / dt_s), until)))
        for f, flight in enumerate(events)
        for event, until in zip(
            flight, [*(later.start for later in flight), int(lengths[f])][1:], strict=True
        )
    ]
    return {
        name: pd.DataFrame(
            filter(None, (_read(data, model, (f, k), event) for f, event in longer)),
            columns=list(_EVENT),
        ).astype(_EVENT)
        for k, name in enumerate(data.flights.signals.outputs)
    }


def _read(
    data: Record, model: FloatArray, place: tuple[int, int], event: Event
) -> tuple[int, int, str, float, float] | None:
    f, k = place
    if event.interrupted or not event.settled:
        return None
    dt_s = data.flights.signals.dt_s
    rows = slice(max(0, event.start - round(_BEFORE_S / dt_s)), event.stop)
    time_s = np.arange(rows.start, rows.stop, dtype=np.float64) * dt_s
    config = TransientConfig(least_response=_LEAST * float(data.span[k]), drift_share=0.1)
    flight = measure_transient(time_s, data.real[f, rows, k], event.start * dt_s, config)
    own = config.model_copy(update={"least_response": 0.0, "drift_share": 0.2})
    sim = measure_transient(time_s, model[f, rows, k], event.start * dt_s, own)
    if not _comparable(flight, sim):
        return None
    direction = "push" if event.label == PUSH else "pull"
    return f, event.start, direction, flight.Ti_s - sim.Ti_s, flight.Tt_s - sim.Tt_s


def _comparable(flight: Transient, model: Transient) -> bool:
    if flight.reason is not None or model.reason is not None:
        return False
    return flight.response * model.response > 0.0
