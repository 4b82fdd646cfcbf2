"""Divides logs into training and test sets many times, and calibrates once per division.

Two schemes. *Leave one flight out* holds back a whole file at a time, with all its engines: they
flew through the same air and were read by one recorder. *Random by event* (calibration paper,
section 3.2: ten random 7:3 divisions) holds back whole events: each log is cut into segments of
one event each, and a segment is never divided, so that no sample tells of its neighbour in the
other set.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from data_prep.events import Event, EventsConfig, find_events
from data_prep.log import Log
from narxcal.calibration.bundle import Bundle
from narxcal.support.errors import DataError
from narxcal.support.parallel import in_processes
from narxcal.support.settings import Section
from training.config import RunConfig
from training.methods import TrainOptions
from training.pipeline import calibrate
from training.records import Split

T = TypeVar("T")


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
        part = self.whole.part(self.start, self.stop)
        return replace(part, name=f"{self.whole.name}[{self.start}:{self.stop}]")

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


def _joined(segments: Sequence[Segment], chosen: NDArray[np.bool_]) -> list[Segment]:
    """The chosen segments, those that follow each other in one log as one."""
    joined: list[Segment] = []
    for part in (each for each, use in zip(segments, chosen, strict=True) if use):
        last = joined[-1] if joined else None
        if last is not None and last.whole is part.whole and last.stop == part.start:
            joined[-1] = Segment(part.whole, last.start, part.stop, (*last.events, *part.events))
        else:
            joined.append(part)
    return joined


def run_plans(
    plans: Sequence[Plan],
    config: RunConfig,
    base: Path,
    judge: Callable[[Bundle, Plan], T],
    jobs: int = -1,
) -> Iterator[T]:
    """Calibrate once per plan and yield what `judge` makes of it, in the order of the plans.

    Logs are prepared and screened, masked inputs still NaN. Plans run in parallel processes of one
    thread each (all cores by default); the numbers do not depend on `jobs`.
    `judge` has to be a function of a module, and what it returns must be small.
    """
    single = config.having(train={"threads": 1})
    task = partial(_run_plan, config=single, base=base, judge=judge)
    return in_processes(task, plans, jobs)


def _run_plan(plan: Plan, config: RunConfig, base: Path, judge: Callable[[Bundle, Plan], T]) -> T:
    train, test = (tuple(part.log for part in parts) for parts in (plan.train, plan.test))
    options = TrainOptions(screened=True)
    return judge(calibrate(config, base, Split(train, (), test), options), plan)
