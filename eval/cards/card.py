"""The flight card: which lever moves to fly next, within the limits of an aircraft and its time.

Moves at one altitude cost their minutes. Altitudes are flown in one direction: for every range of
them a design is made with the climb off the budget (`eval.cards.design`), and the best is kept. For
a run the criterion is the information of the moves about its parameters (`eval.cards.information`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import numpy as np

from eval.cards.design import Candidates, Criterion, d_optimal, design, i_optimal
from eval.cards.information import Experiment, of_training
from eval.run_logs import run_config
from narxcal.calibration.bundle import Bundle
from narxcal.calibration.calibration import Calibration
from narxcal.channels import is_switch
from narxcal.flight_test.moves import CARD_SCHEMA, Limits, Move, course, moves
from narxcal.intervals import LEVEL
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError
from narxcal.support.progress import Progress, silent

_LITTLE: Final = 0.1  # of the held-out mean squared error
CriterionName = Literal["D", "I"]


class Step(NamedTuple):
    """A move with what is expected of it: lowest and highest (n_out,) of the outputs.

    `peak` is the highest with its uncertainty, `inside` whether all of it lies in the envelope of
    the model's logs, `share` the loss of the criterion without it as a share of the losses of all
    steps of a card.
    """

    move: Move
    low: FloatArray
    high: FloatArray
    peak: FloatArray
    inside: bool
    share: float = 0.0


@dataclass(frozen=True, eq=False)
class Card:
    """Moves in the order of flight.

    `expected` are rows of what the flight gives: name, before, after, and unit. `facts` go into the
    document as they are.
    """

    purpose: str
    limits: Limits
    lever: str
    outputs: tuple[str, ...]
    steps: tuple[Step, ...]
    expected: tuple[tuple[str, float, float, str], ...]
    headline: str
    cautions: tuple[str, ...]
    facts: Mapping[str, Any]

    @property
    def minutes(self) -> float:
        """Flight time, settling and climbs included."""
        some = [one.move for one in self.steps]
        climb = self.limits.climb_min(some[0].altitude_ft, some[-1].altitude_ft)
        return climb + sum(one.minutes for one in some)

    def document(self) -> dict[str, Any]:
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
    every = [_expected(own, one, flights.alone(one)) for one in moves(limits)]
    every = [every[k] for k in admitted(limits, every, own.output_names)]
    before = np.eye(len(experiment.unit)) + of_training(experiment, data, progress)
    alone = [experiment.information_of(flights.alone(one.move)) for one in every]
    outer = np.sum([one.outer for one in alone], axis=0) / sum(one.samples for one in alone)
    information = np.stack([one.information for one in alone])
    values = {"D": d_optimal(before), "I": i_optimal(before, outer)}
    steps = planned(wanted, every, information, values[wanted.criterion])
    path = flights.course([one.move for one in steps])
    after = before + experiment.information_of(path).information
    gains = _gains(experiment, (before, after), outer)
    return Card(
        "calibration",
        limits,
        lever,
        own.output_names,
        steps,
        gains.expected,
        gains.headline,
        (*gains.cautions, *passed(limits, _peaks(own, path), own.output_names)),
        {"run_sha256": bundle.sha256, "criterion": wanted.criterion, **gains.facts},
    )


class _Gains(NamedTuple):
    """What a flight gives, as a card states it."""

    expected: tuple[tuple[str, float, float, str], ...]
    headline: str
    cautions: tuple[str, ...]
    facts: Mapping[str, Any]


def _gains(
    experiment: Experiment, informations: tuple[FloatArray, FloatArray], outer: FloatArray
) -> _Gains:
    """Of information (P, P) before and after, and the mean outer product of slopes (P, P)."""
    inverses = [np.linalg.inv(one) for one in informations]
    deviations = np.array([experiment.unit * np.sqrt(np.diag(one)) for one in inverses])
    ratio = deviations[1] / deviations[0]
    # In shares of the held-out mean squared error.
    predictive = [float(np.sum(outer * one)) for one in inverses]
    narrower = 100.0 * (1.0 - float(np.median(ratio)))
    surer = 100.0 * (1.0 - (predictive[1] / predictive[0]) ** 0.5)
    caution = (
        f"uncertain parameters make {100.0 * predictive[0]:.1g} % of the mean squared error on "
        "held-out recordings; what the model's form leaves, no flight takes away"
    )
    nats = 0.5 * float(np.diff([np.linalg.slogdet(one)[1] for one in informations])[0])
    names, (before, after) = experiment.names, deviations.tolist()
    return _Gains(
        tuple((names[k], before[k], after[k], "1 s.d.") for k in np.argsort(ratio).tolist()),
        f"intervals of parameters become {narrower:.0f} % narrower in the median, those of "
        f"predictions {surer:.0f} %",
        (caution,) if predictive[0] <= _LITTLE else (),
        {
            "information_nats": nats,
            "predictive_variance": {"before": predictive[0], "after": predictive[1]},
        },
    )


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


def _expected(own: Calibration, move: Move, inputs: FloatArray) -> Step:
    y, inside = own.simulate(inputs), bool(own.steady.inside(inputs).all())
    return Step(move, y.min(axis=0), y.max(axis=0), _peaks(own, inputs), inside)


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
        ("[highest]", limits.highest, outputs),
        ("[inputs]", limits.inputs, further),
        ("switches", limits.switches, [*filter(is_switch, further)]),
    ):
        for name in names:
            if name not in known:
                raise ConfigError(
                    f"{table} names '{name}', which is none of its channels",
                    hint=f"They are {', '.join(known) or 'none'}",
                )
    for name in further:
        if name not in limits.inputs and not is_switch(name):
            raise ConfigError(
                f"the limits give no value of the input '{name}'",
                hint=f"Add {name} = VALUE to [inputs]",
            )


def admitted(limits: Limits, every: Sequence[Step], outputs: Sequence[str]) -> list[int]:
    """Numbers of the moves whose peaks keep [highest]; `ConfigError` for none."""
    peaks = np.array([one.peak for one in every])
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


def planned(
    wanted: Wanted, every: Sequence[Step], information: FloatArray, value: Criterion
) -> tuple[Step, ...]:
    """Choose moves by their `information` (n, P, P), in the order of flight with their shares.

    Raises `ConfigError` where there is no time for a single move, or none gives anything.
    """
    limits, height = wanted.limits, np.array([one.move.altitude_ft for one in every])
    cost = np.array([one.move.minutes for one in every])
    best: list[int] = []
    score = -np.inf
    for low, high in combinations_with_replacement(np.unique(height).tolist(), 2):
        some = np.flatnonzero((height >= low) & (height <= high))
        candidates = Candidates(information[some], cost[some])
        picked = design(candidates, wanted.minutes - limits.climb_min(low, high), value)
        found = float(value(candidates.total(picked)))
        if picked and found > score:
            best, score = some[picked].tolist(), found
    if not best and cost.min() <= wanted.minutes:
        raise ConfigError(
            f"none of {len(every)} moves within the limits adds any information",
            hint="Widen lever or altitude_ft, or name under switches what the pilot may set",
        )
    if not best:
        raise ConfigError(
            f"limits that admit no move: the shortest takes {cost.min():.1f} minutes, "
            f"found {wanted.minutes:g}",
            hint="Give more minutes, or shorten settle_s and hold_s",
        )
    total = information[best].sum(axis=0)
    lost = np.maximum(value(total) - value(total - information[best]), 0.0)
    shares = (lost / max(float(lost.sum()), 1e-300)).tolist()
    steps = [every[k]._replace(share=share) for k, share in zip(best, shares, strict=True)]
    return tuple(sorted(steps, key=_place))


def _place(one: Step) -> tuple[float, str, float, float]:
    """Order of flight: by altitude and switch, then so that the lever is set by short ways."""
    corners = one.move.corners
    return one.move.altitude_ft, one.move.switch, corners[0][1], corners[-1][1]
