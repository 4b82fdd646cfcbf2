"""The flight card: which lever moves to fly next, within the limits of an aircraft and its time.

Moves at one altitude cost their minutes. Altitudes are flown in one direction: for every range of
them a design is made with the climb off the budget (`eval.design`), and the best is kept. For a run
the criterion is the information of the moves about its parameters (`eval.information`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import numpy as np

from eval.design import Candidates, Criterion, d_optimal, design, i_optimal
from eval.evaluate import run_config
from eval.information import Experiment, of_training
from narxcal.calibration.bundle import Bundle
from narxcal.calibration.calibration import Calibration
from narxcal.channels import described
from narxcal.flight_test.moves import CARD_SCHEMA, Limits, Move, course, moves
from narxcal.intervals import LEVEL
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError
from narxcal.support.progress import Progress, silent

_LITTLE: Final = 0.1  # of the held-out mean squared error
CriterionName = Literal["D", "I"]


class Step(NamedTuple):
    """A move as it is flown: lowest and highest (n_out,) expected, what leaving it out would cost.

    `inside` says whether all of it lies in the envelope of the model's logs, `share` the loss of
    the criterion without it as a share of the losses of all steps.
    """

    move: Move
    low: FloatArray
    high: FloatArray
    inside: bool
    share: float


@dataclass(frozen=True, eq=False)
class Card:
    """Moves in the order of flight; `minutes` include settling and climbs.

    `expected` are rows of what the flight gives: name, before, after, and unit. `facts` go into the
    document as they are.
    """

    purpose: str
    limits: Limits
    lever: str
    outputs: tuple[str, ...]
    steps: tuple[Step, ...]
    minutes: float
    expected: tuple[tuple[str, float, float, str], ...]
    headline: str
    cautions: tuple[str, ...]
    facts: Mapping[str, Any]

    def document(self) -> dict[str, Any]:
        """JSON-able."""
        return {
            "schema": CARD_SCHEMA,
            "purpose": self.purpose,
            "headline": self.headline,
            "cautions": list(self.cautions),
            "minutes": self.minutes,
            "lever": self.lever,
            "limits": self.limits.model_dump(mode="json", by_alias=True),
            "steps": [self._row(one) for one in self.steps],
            "expected": [
                {"of": name, "before": before, "after": after, "unit": unit}
                for name, before, after, unit in self.expected
            ],
            **self.facts,
        }

    def _row(self, one: Step) -> dict[str, Any]:
        ranges = zip(self.outputs, one.low.tolist(), one.high.tolist(), strict=True)
        return {
            **one.move.model_dump(mode="json", by_alias=True),
            "expected": {name: [low, high] for name, low, high in ranges},
            "inside_envelope": one.inside,
            "share": one.share,
        }


class Wanted(NamedTuple):
    """What is asked for: within `limits`, at most `minutes`; the criterion is that of a run."""

    limits: Limits
    minutes: float
    criterion: CriterionName = "D"


def calibration_card(
    bundle: Bundle, wanted: Wanted, data: Path | None = None, progress: Progress = silent
) -> Card:
    """The moves with most information about a run's parameters.

    `data` is where its training logs are now.

    Raises `ConfigError` for limits that do not fit the run or admit no move, `ModelError` for a
    run without dynamic parameters, `DataError` where its training logs are not at hand.
    """
    own, lever, limits = bundle.calibration, run_config(bundle)[0].driver, wanted.limits
    check_channels(limits, own.input_names, own.output_names, lever)
    experiment = Experiment(bundle, limits, lever)
    flights = Flown(limits, lever, own.input_names, own.dt_s)
    every, ranges = _permitted(experiment, flights)
    before = np.eye(len(experiment.unit)) + of_training(experiment, data, progress)
    alone = [experiment.information_of(flights.alone(one)) for one in every]
    outer = np.sum([one.outer for one in alone], axis=0) / sum(one.samples for one in alone)
    information = np.stack([one.information for one in alone])
    values = {"D": d_optimal(before), "I": i_optimal(before, outer)}
    value = values[wanted.criterion]
    chosen = planned(wanted, every, information, value)
    path = flights.course([every[k] for k in chosen.numbers])
    flight = experiment.information_of(path)
    after = before + flight.information
    shrunk = _Shrunk(before, after, outer, experiment.unit)
    return Card(
        "calibration",
        limits,
        lever,
        own.output_names,
        steps_of(chosen, every, ranges, information, value),
        chosen.minutes,
        shrunk.rows(experiment.names),
        shrunk.words,
        (*shrunk.cautions, *passed(limits, _peaks(own, path), own.output_names)),
        {
            "run_sha256": bundle.sha256,
            "criterion": wanted.criterion,
            "information_nats": shrunk.nats,
            "predictive_variance": {"before": shrunk.predictive[0], "after": shrunk.predictive[1]},
        },
    )


class _Shrunk(NamedTuple):
    """Information before and after, mean outer product of slopes, all (P, P); units (P,)."""

    before: FloatArray
    after: FloatArray
    outer: FloatArray
    unit: FloatArray

    @property
    def nats(self) -> float:
        """Expected fall of the parameters' entropy."""
        return float(np.linalg.slogdet(self.after)[1] - np.linalg.slogdet(self.before)[1]) / 2.0

    @property
    def deviations(self) -> tuple[FloatArray, FloatArray]:
        """Standard deviations (P,) of the parameters before and after."""
        before, after = (np.sqrt(np.diag(np.linalg.inv(one))) for one in (self.before, self.after))
        return self.unit * before, self.unit * after

    @property
    def predictive(self) -> tuple[float, float]:
        """Mean predictive variance in shares of the held-out mean squared error."""
        before, after = (
            float(np.sum(self.outer * np.linalg.inv(one))) for one in (self.before, self.after)
        )
        return before, after

    @property
    def words(self) -> str:
        """What the flight gives, in one line."""
        before, after = self.deviations
        narrower = 1.0 - float(np.median(after / before))
        surer = 1.0 - (self.predictive[1] / self.predictive[0]) ** 0.5
        return (
            f"intervals of parameters become {100.0 * narrower:.0f} % narrower in the median, "
            f"those of predictions {100.0 * surer:.0f} %"
        )

    @property
    def cautions(self) -> tuple[str, ...]:
        """Say so where most of the error is not that of the parameters."""
        share = self.predictive[0]
        if share > _LITTLE:
            return ()
        text = (
            f"uncertain parameters make {100.0 * share:.1g} % of the mean squared error on "
            "held-out recordings; what the model's form leaves, no flight takes away"
        )
        return (text,)

    def rows(self, names: Sequence[str]) -> tuple[tuple[str, float, float, str], ...]:
        """Each parameter with its standard deviations, the most shrunk first."""
        before, after = self.deviations
        order = np.argsort(after / before)
        return tuple((names[k], float(before[k]), float(after[k]), "1 s.d.") for k in order)


@dataclass(frozen=True)
class Flown:
    """How moves become inputs (time, n_in) called `names`, every `dt_s`."""

    limits: Limits
    lever: str
    names: tuple[str, ...]
    dt_s: float

    def alone(self, move: Move) -> FloatArray:
        """Inputs over a move that begins in equilibrium."""
        return self.course([move.model_copy(update={"settle_s": 0.0})])

    def course(self, some: Sequence[Move]) -> FloatArray:
        """Inputs over moves one after another, with what lies between them."""
        path = course(self.limits, some, self.dt_s)
        values: dict[str, Any] = {
            "dT_C": self.limits.dT_C,
            **self.limits.inputs,
            **path,
            self.lever: path["lever"],
        }
        found = np.zeros((len(path["lever"]), len(self.names)))
        for k, name in enumerate(self.names):
            found[:, k] = values.get(name, 0.0)
        return found


class Ranges(NamedTuple):
    """Lowest and highest (n_out,) of each output over a move; `inside` the trained envelope."""

    low: FloatArray
    high: FloatArray
    inside: bool


def _permitted(experiment: Experiment, flights: Flown) -> tuple[list[Move], list[Ranges]]:
    """Moves whose outputs keep the limits, with the interval that the run gives them."""
    own, every, ranges, peaks = experiment.bundle.calibration, moves(flights.limits), [], []
    for one in every:
        inputs = flights.alone(one)
        y, inside = own.simulate(inputs), bool(own.steady.inside(inputs).all())
        ranges.append(Ranges(y.min(axis=0), y.max(axis=0), inside))
        peaks.append(_peaks(own, inputs))
    kept = admitted(flights.limits, np.array(peaks), own.output_names)
    return [every[k] for k in kept], [ranges[k] for k in kept]


def _peaks(own: Calibration, inputs: FloatArray) -> FloatArray:
    """Highest of each output (n_out,) over inputs, with the interval that the run gives it."""
    y = own.simulate(inputs)
    half = np.zeros_like(y) if own.interval is None else own.half_width(inputs, y, LEVEL)
    return np.asarray(np.max(y + half, axis=0))


def passed(limits: Limits, peaks: FloatArray, outputs: Sequence[str]) -> list[str]:
    """Warnings of limits that may be passed between steps."""
    return [
        f"{name} may reach {high:.4g} between steps, the limit is {limits.highest[name]:.4g}: "
        "set the lever slowly"
        for name, high in zip(outputs, peaks.tolist(), strict=True)
        if high > limits.highest.get(name, np.inf)
    ]


def check_channels(
    limits: Limits, inputs: Sequence[str], outputs: Sequence[str], lever: str
) -> None:
    """Raise `ConfigError` unless limits name outputs, and every input has a value."""
    if lever not in inputs:
        raise ConfigError(
            f"the lever '{lever}' is no input of the model", hint=f"Inputs: {', '.join(inputs)}"
        )
    given = {lever, "ALT_ft", "Mach", "dT_C"}
    further = [name for name in inputs if name not in given]
    for table, names, known in (
        ("highest", limits.highest, outputs),
        ("inputs", limits.inputs, further),
    ):
        for name in names:
            if name not in known:
                raise ConfigError(
                    f"[{table}] names '{name}', which is none of its channels",
                    hint=f"They are {', '.join(known) or 'none'}",
                )
    for name in further:
        if name not in limits.inputs and described(name).role != "switch":
            raise ConfigError(
                f"the limits give no value of the input '{name}'",
                hint=f"Add {name} = VALUE to [inputs]",
            )


def admitted(limits: Limits, peaks: FloatArray, outputs: Sequence[str]) -> list[int]:
    """Numbers of the moves whose `peaks` (n, n_out) keep [highest]; `ConfigError` for none."""
    most = np.array([limits.highest.get(name, np.inf) for name in outputs])
    kept: list[int] = np.flatnonzero((peaks <= most).all(axis=1)).tolist()
    if not kept:
        least = zip(outputs, peaks.min(axis=0).tolist(), strict=True)
        words = [f"{name} {low:.4g} of {limits.highest[name]:.4g}" for name, low in least
                 if name in limits.highest]  # fmt: skip
        raise ConfigError(
            f"limits that admit no move: the gentlest of {len(peaks)} may reach {', '.join(words)}",
            hint="Raise [highest], or lower the upper end of lever",
        )
    return kept


class Chosen(NamedTuple):
    """Numbers of the chosen candidates in the order of flight, and minutes in all."""

    numbers: list[int]
    minutes: float


def planned(
    wanted: Wanted, every: Sequence[Move], information: FloatArray, value: Criterion
) -> Chosen:
    """Choose moves by their `information` (n, P, P).

    Raises `ConfigError` where there is no time for a single move.
    """
    limits, heights = wanted.limits, sorted({one.altitude_ft for one in every})
    best: list[int] = []
    score = -np.inf
    for low, high in combinations_with_replacement(heights, 2):
        some = [k for k, one in enumerate(every) if low <= one.altitude_ft <= high]
        cost = np.array([every[k].minutes for k in some])
        candidates = Candidates(information[some], cost)
        picked = design(candidates, wanted.minutes - limits.climb_min(low, high), value)
        found = float(value(candidates.total(picked)))
        if picked and found > score:
            best, score = [some[k] for k in picked], found
    if not best:
        shortest = min(one.minutes for one in every)
        raise ConfigError(
            f"limits that admit no move: the shortest takes {shortest:.1f} minutes, "
            f"found {wanted.minutes:g}",
            hint="Give more minutes, or shorten settle_s and hold_s",
        )
    best.sort(key=lambda k: _place(every[k]))
    climb = limits.climb_min(every[best[0]].altitude_ft, every[best[-1]].altitude_ft)
    return Chosen(best, climb + sum(every[k].minutes for k in best))


def _place(move: Move) -> tuple[float, float, float]:
    """Order of flight: by altitude, then so that the lever is set by short ways."""
    return move.altitude_ft, move.corners[0][1], move.corners[-1][1]


def steps_of(
    chosen: Chosen, every: Sequence[Move], ranges: Sequence[Ranges], information: FloatArray,
    value: Criterion,
) -> tuple[Step, ...]:  # fmt: skip
    """The chosen moves as steps."""
    total = information[chosen.numbers].sum(axis=0)
    lost = value(total) - value(total - information[chosen.numbers])
    shares = np.maximum(lost, 0.0) / max(float(np.maximum(lost, 0.0).sum()), 1e-300)
    return tuple(
        Step(every[k], *ranges[k], share)
        for k, share in zip(chosen.numbers, shares.tolist(), strict=True)
    )
