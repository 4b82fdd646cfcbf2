"""How logs are divided into those to fit to and those held out, and how scores are compared.

A model is chosen for flights that it has not seen. With three recordings or more each is held out
whole, in a few folds. One or two recordings are cut into stretches, and a fold holds out those of

    the highest third in altitude, the lowest third in power, the last third in time

and each of two recordings. A choice between models is by the mean over the held-out pieces of the
logarithm of their errors, so that a model which does well in the middle and fails at an edge loses.

**Cross-validation** divides many times, by two schemes. *Leave one flight out* holds back a whole
file at a time, with all its engines: they flew through the same air and were read by one recorder.
*Random by event* (calibration paper, section 3.2: ten random 7:3 divisions) holds back whole
events: each log is cut into segments of one event each, and a segment is never divided:
neighbouring samples are nearly equal, and one must not train the model that the other judges.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Final, NamedTuple, TypeVar

import numpy as np
from pydantic import Field
from scipy.special import ndtr, stdtrit

from data_prep.events import Event, EventsConfig, find_events
from data_prep.log import Log
from narxcal.support.arrays import BoolArray, FloatArray, known_mean
from narxcal.support.errors import DataError
from narxcal.support.settings import Section

T = TypeVar("T")
_LEAST = 1e-18  # of a mean square: outputs without any error compare, too
_THIRD: Final = 1.0 / 3.0
_RANGE_FT: Final = 1000.0  # of altitude: over it pressure changes by 3 %, outputs by that or less
_STRETCH_S: Final = 60.0  # a move with its settling
_STRETCHES: Final = (6, 24)  # of a log: thirds of it need so many; more divide moves


class Fold(NamedTuple):
    """Indices of the items to fit to and of those to judge on."""

    fitted: list[int]
    judged: list[int]

    def of(self, items: Sequence[T]) -> tuple[list[T], list[T]]:
        """Items to fit to, and items to judge on."""
        return [items[k] for k in self.fitted], [items[k] for k in self.judged]


def held_out_folds(recordings: Sequence[str], most: int) -> list[Fold]:
    """Leave each recording out once, in at most `most` folds.

    `recordings` names the recording of each item; those of one recording stay together.
    """
    names = list(dict.fromkeys(recordings))
    fold = {name: number % most for number, name in enumerate(names)}
    of = [fold[name] for name in recordings]
    return [
        Fold(
            [k for k, one in enumerate(of) if one != number],
            [k for k, one in enumerate(of) if one == number],
        )
        for number in sorted(set(of))
    ]


def regions(
    time: FloatArray, power: FloatArray, altitude_ft: FloatArray | None
) -> dict[str, BoolArray]:
    """Which of the items (count,) each region holds; `time` is the share of the recording.

    Empty where items are alike in everything.
    """
    found = {}
    if altitude_ft is not None and np.ptp(altitude_ft) > _RANGE_FT:
        found["highest altitude"] = altitude_ft > np.quantile(altitude_ft, 1.0 - _THIRD)
    found["lowest power"] = power < np.quantile(power, _THIRD)
    found["last third"] = time > 1.0 - _THIRD
    return {name: held for name, held in found.items() if held.any() and not held.all()}


@dataclass(frozen=True, eq=False)
class LogFold:
    """Logs and parts of logs to fit to and to judge on; `name` says what is held out.

    `whole` tells recordings from regions.
    """

    name: str
    fitted: tuple[Log, ...]
    judged: tuple[Log, ...]
    whole: bool

    def piece(self, log: Log) -> str:
        """What a judged log counts for: its recording, or the region."""
        return log.source.file if self.whole else self.name


def log_folds(
    logs: Sequence[Log], power: Callable[[Log], FloatArray], most: int = 3
) -> list[LogFold]:
    """Folds of logs: of recordings in at most `most` folds, of one or two of them also of regions.

    `power` gives the power of a log (time,) in any unit.
    """
    files = [log.source.file for log in logs]
    many = len(set(files))
    found = [] if many > 2 else list(_of_regions(logs, power))
    if many > 1:
        for fold in held_out_folds(files, most):
            fitted, judged = fold.of(logs)
            name = ", ".join(dict.fromkeys(log.source.file for log in judged))
            found.append(LogFold(name, tuple(fitted), tuple(judged), whole=True))
    return found


def thirds(logs: Sequence[Log], most: int = 3) -> tuple[list[Log], list[Fold]]:
    """Logs and folds of whole recordings; of a single one, its thirds in time."""
    files = [log.source.file for log in logs]
    if len(set(files)) > 1:
        return list(logs), held_out_folds(files, most)
    parts, numbers = [], []
    for log in logs:
        edges = np.linspace(0, len(log), most + 1).astype(int).tolist()
        for number, (a, b) in enumerate(pairwise(edges)):
            parts.append(_named_part(log, a, b))
            numbers.append(str(number))
    return parts, held_out_folds(numbers, most)


def _named_part(log: Log, start: int, stop: int) -> Log:
    return replace(log.part(start, stop), name=f"{log.name}[{start}:{stop}]")


def _of_regions(logs: Sequence[Log], power: Callable[[Log], FloatArray]) -> Iterator[LogFold]:
    cuts = [_edges(log) for log in logs]
    time = np.concatenate([(at[:-1] + at[1:]) / (2.0 * at[-1]) for at in cuts])
    level = np.concatenate([_means(power(log), at) for log, at in zip(logs, cuts, strict=True)])
    altitude = None
    if all(log.recorded(["ALT_ft"]) for log in logs):
        parts = [_means(log["ALT_ft"], at) for log, at in zip(logs, cuts, strict=True)]
        altitude = np.concatenate(parts)
    numbers = np.cumsum([0, *(len(at) - 1 for at in cuts)])
    for name, held in regions(time, level, altitude).items():
        fitted: list[Log] = []
        judged: list[Log] = []
        for log, at, (first, last) in zip(logs, cuts, pairwise(numbers), strict=True):
            for start, stop, out in _runs(held[first:last]):
                part = _named_part(log, int(at[start]), int(at[stop]))
                (judged if out else fitted).append(part)
        if fitted and judged:
            yield LogFold(name, tuple(fitted), tuple(judged), whole=False)


def _edges(log: Log) -> FloatArray:
    """Rows at which a log is cut into stretches of one length."""
    count = int(np.clip(len(log) * log.dt_s / _STRETCH_S, *_STRETCHES))
    return np.unique(np.linspace(0, len(log), count + 1).astype(int))


def _means(values: FloatArray, edges: FloatArray) -> FloatArray:
    """Mean of the known values in each stretch; the mean of all where none is known."""
    parts = [values[a:b][np.isfinite(values[a:b])] for a, b in pairwise(edges.astype(int).tolist())]
    usual = float(np.nanmean(values)) if np.isfinite(values).any() else 0.0
    return np.array([float(part.mean()) if len(part) else usual for part in parts])


def _runs(held: BoolArray) -> list[tuple[int, int, bool]]:
    """(start, stop, value) of the runs of equal values."""
    edges = [0, *(np.flatnonzero(np.diff(held.astype(int))) + 1).tolist(), len(held)]
    return [(a, b, bool(held[a])) for a, b in pairwise(edges)]


def geometric_rms(errors: Sequence[FloatArray]) -> float:
    """Geometric mean over the outputs of the RMS of `errors`, (time, outputs) each.

    Infinite where an output has no error that is a number.
    """
    square = np.concatenate([error**2 for error in errors]) if errors else np.empty((0, 1))
    mean = known_mean(square)
    if np.isnan(mean).any():
        return np.inf
    return float(np.exp(0.5 * np.mean(np.log(np.maximum(mean, _LEAST)))))


def surely_below(ratios: FloatArray, margin: float = 0.0) -> BoolArray:
    """Whether means (...,) of logarithms of ratios (pieces, ...) lie clearly below `-margin`.

    Student's one-sided t test on the pieces at 16 %, the risk of one standard error of many: the
    standard error of few is uncertain itself, and widened for it. Of one piece alone a `margin`
    above zero decides; without one it says nothing.
    """
    count, mean = len(ratios), ratios.mean(axis=0)
    if count < 2:
        return np.asarray((mean < -margin) & (margin > 0.0))
    error = ratios.std(axis=0, ddof=1) / np.sqrt(count) * stdtrit(count - 1, ndtr(1.0))
    return np.asarray(mean < -np.maximum(error, margin))


def clearly_less(differences: Sequence[FloatArray]) -> bool:
    """Whether the mean of paired `differences`, one array a piece, is clearly below zero.

    By more than its standard error, as in `surely_below`; never by one piece alone.
    """
    mean, error, pieces = clustered(differences)
    return pieces > 1 and mean < -float(stdtrit(pieces - 1, ndtr(1.0)) * error)


def clustered(values: Sequence[FloatArray]) -> tuple[float, float, int]:
    """Mean of all known `values`, one array a piece, its standard error, the number of pieces.

    The pieces are the units, for transients of one flight have errors in common (cluster-robust
    variance: Liang and Zeger 1986, Biometrika 73(1)). NaN and infinite without any.
    """
    known = [each[np.isfinite(each)] for each in values]
    known = [each for each in known if len(each)]
    pieces, total = len(known), sum(len(each) for each in known)
    if not pieces:
        return np.nan, np.inf, 0
    mean = sum(float(each.sum()) for each in known) / total
    if pieces < 2:
        return mean, np.inf, 1
    square = sum(float(np.sum(each - mean)) ** 2 for each in known)
    return mean, float(np.sqrt(pieces / (pieces - 1) * square)) / total, pieces


# ---- cross-validation


class CrossvalConfig(Section):
    """Table [evaluate.crossval]: which divisions are made.

    Of the random ones, number i is drawn with `seed + i`. A segment begins `lead_s` before the
    lever moves, so that the level the engine starts from belongs to its event.
    """

    leave_one_flight_out: bool = True
    random_splits: int = Field(default=10, ge=0)
    train_share: float = Field(default=0.7, gt=0.0, lt=1.0)
    seed: int = Field(default=0, ge=0)
    lead_s: float = Field(default=3.0, gt=0.0)


@dataclass(frozen=True, eq=False)
class Segment:
    """Rows `start:stop` of one log and the events in them, given in rows of the whole log.

    Events are found on the whole log, since what counts as a movement depends on its range.
    """

    whole: Log
    start: int
    stop: int
    events: tuple[Event, ...]

    @property
    def log(self) -> Log:
        """The rows as a log of their own, named `NAME[start:stop]` unless they are all."""
        if (self.start, self.stop) == (0, len(self.whole)):
            return self.whole
        return _named_part(self.whole, self.start, self.stop)

    @property
    def own_events(self) -> tuple[Event, ...]:
        """The events in rows of `log`, none reaching beyond its end."""
        name, first, last = self.log.name, self.start, self.stop
        return tuple(
            replace(
                event,
                log=name,
                start=event.start - first,
                stop=min(event.stop, last) - first,
            )
            for event in self.events
        )


@dataclass(frozen=True, eq=False)
class Plan:
    """One division. `seed` is None where nothing was drawn."""

    scheme: str
    name: str
    train: tuple[Segment, ...]
    test: tuple[Segment, ...]
    seed: int | None = None


LEAVE_ONE_OUT, RANDOM = "leave one flight out", "random splits by event"


def leave_one_flight_out(
    logs: Sequence[Log], events: EventsConfig, outputs: Sequence[str] = ()
) -> list[Plan]:
    """One plan per file; `DataError` where there is only one flight.

    `outputs` settle where a log records none of the responses of `events`.
    """
    flights = list(dict.fromkeys(log.source.file for log in logs))
    if len(flights) < 2:
        raise DataError(
            f"leaving one flight out takes two flights or more, found {len(flights)}",
            file=flights[0] if flights else None,
            hint="Add flights to [logs] files, or set leave_one_flight_out = false",
        )
    whole = {}
    for log in logs:
        found = tuple(find_events(log, events.for_log(log, outputs)))
        whole[log.name] = Segment(log, 0, len(log), found)
    return [
        Plan(
            LEAVE_ONE_OUT,
            f"without {Path(flight).name}",
            tuple(whole[log.name] for log in logs if log.source.file != flight),
            tuple(whole[log.name] for log in logs if log.source.file == flight),
        )
        for flight in flights
    ]


def random_splits(
    logs: Sequence[Log], events: EventsConfig, config: CrossvalConfig, outputs: Sequence[str] = ()
) -> list[Plan]:
    """Draw `config.random_splits` divisions of all segments; `DataError` with too few events.

    `outputs` as in `leave_one_flight_out`.

    Training segments that follow each other are joined, which spares the network starts from
    an unknown history; test segments stay one event each.
    """
    responses = {log.name: events.for_log(log, outputs) for log in logs}
    segments = [
        part for log in logs for part in cut_segments(log, responses[log.name], config.lead_s)
    ]
    return divide(segments, config)


def divide(segments: Sequence[Segment], config: CrossvalConfig) -> list[Plan]:
    """Draw `config.random_splits` divisions of these segments; as `random_splits` otherwise."""
    trained = round(config.train_share * len(segments))
    if not 0 < trained < len(segments):
        raise DataError(
            f"expected at least two events to divide, found {len(segments)}",
            hint="Check [events], or set random_splits = 0",
        )
    plans = []
    for number in range(config.random_splits):
        seed = config.seed + number
        drawn = np.random.default_rng(seed).permutation(len(segments))
        chosen = np.zeros(len(segments), dtype=np.bool_)
        chosen[drawn[:trained]] = True
        plans.append(
            Plan(
                RANDOM,
                f"split {number + 1}",
                tuple(_joined(segments, chosen)),
                tuple(part for part, use in zip(segments, chosen, strict=True) if not use),
                seed,
            )
        )
    return plans


def cut_segments(log: Log, events: EventsConfig, lead_s: float) -> list[Segment]:
    """Cut a log into one segment per event, which together hold every row of it once.

    The first segment begins with the log. No segments where there are no events.
    """
    found = find_events(log, events)
    if not found:
        return []
    lead = max(1, round(lead_s / log.dt_s))
    # Where one movement follows another at once, the lead would reach into the one before.
    edges = [max(b.start - lead, min(a.stop, b.start)) for a, b in pairwise(found)]
    starts, stops = [0, *edges], [*edges, len(log)]
    return [
        Segment(log, start, stop, (event,))
        for event, start, stop in zip(found, starts, stops, strict=True)
    ]


def _joined(segments: Sequence[Segment], chosen: BoolArray) -> list[Segment]:
    """The chosen segments, those that follow each other in one log as one."""
    joined: list[Segment] = []
    for part in (each for each, use in zip(segments, chosen, strict=True) if use):
        last = joined[-1] if joined else None
        if last is not None and last.whole is part.whole and last.stop == part.start:
            joined[-1] = Segment(part.whole, last.start, part.stop, (*last.events, *part.events))
        else:
            joined.append(part)
    return joined
