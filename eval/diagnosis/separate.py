"""The flight card of an undecided diagnosis: moves that separate its hypotheses.

Hypotheses i and j predict records of the next flight that differ by D. Both are Gaussian with the
same covariance: noise and errors of the simulator V, differences of build, an offset of the flight,
and the sizes of both effects within their intervals, the columns N of one standard deviation each.
Their Kullback-Leibler divergence is half the squared distance

    d^2 = D' V^-1 D - b' (1 + N' V^-1 N)^-1 b,      b = N' V^-1 D

and the likelier one is the right one with probability Phi(d / 2) (Anderson, *An Introduction to
Multivariate Statistical Analysis*, section 6.4). Inner products by V^-1 of moves add up, so that
they are what `eval.cards.card` plans by; it maximises the mean divergence of pairs, weighted by
their probabilities. The chances that a card states are those of the whole flight, with what lies
between the moves. Errors of a simulator are slow, 25 of them in eight minutes are independent
(`training.diagnosis.metric`): the variance of a sample is as much larger as a sample is shorter.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.special import ndtr

from eval.cards.card import Card, Flown, Step, Wanted, admitted, check_channels, planned
from eval.diagnosis.applied import EMULATOR, gap_document, read_emulator, signals_from_json
from eval.diagnosis.flights import filled_up
from narxcal.effects.base import Effect, Signals
from narxcal.effects.library import effect, name_of
from narxcal.effects.running import Flights, respond
from narxcal.effects.steady import UNLOGGED, UNLOGGED_SWITCH
from narxcal.flight_test.moves import moves
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError
from training.diagnosis.emulator import GreyBoxEmulator
from training.diagnosis.metric import TOLERANCE
from training.diagnosis.nuisances import build_columns, offset_sizes, theta_of

_INDEPENDENT_S: Final = 480.0 / 25.0  # of the errors of a simulator
_LIKELY: Final = 0.1  # of the likeliest effect's probability
_MOST: Final = 4  # hypotheses
_INTERVAL: Final = 1.6449  # standard deviations of a 90 % interval


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """An effect with its parameters theta (p,) and their standard deviations, and how likely.

    Without an effect it says that none acts.
    """

    effect: Effect | None
    theta: FloatArray
    spread: FloatArray
    probability: float

    @property
    def name(self) -> str:
        return "no effect" if self.effect is None else self.effect.name


class Undecided(NamedTuple):
    """What a diagnosis left open: hypotheses, emulator, and variance (outputs,) of a sample."""

    hypotheses: list[Hypothesis]
    emulator: GreyBoxEmulator
    signals: Signals
    variance: FloatArray


def separation_card(file: Path, wanted: Wanted) -> Card:
    """The moves that separate what a `gap.json` leaves open.

    Raises `ConfigError` for a decided diagnosis, for limits that do not fit it or admit no move,
    `ModelError` for a damaged emulator.
    """
    open_ = read_undecided(file)
    signals, limits = open_.signals, wanted.limits
    names = tuple(name for name in signals.inputs if name != UNLOGGED)
    check_channels(limits, names, signals.outputs, signals.driver)
    flown = Flown(limits, signals.driver, signals.inputs, signals.dt_s)
    some = moves(limits)
    flights = simulated(open_, [flown.alone(one) for one in some])
    every = [
        Step(one, y[:n].min(axis=0), y[:n].max(axis=0), y[:n].max(axis=0), _inside(open_, u[:n]))
        for one, y, u, n in zip(some, flights.y, flights.u, flights.lengths, strict=True)
    ]
    kept = admitted(limits, every, signals.outputs)
    columns = Columns.of(open_, flights)
    grams = columns.grams(flights, open_.variance)[kept]
    steps = planned(wanted, [every[k] for k in kept], grams, columns.divergence)
    flight = simulated(open_, [flown.course([one.move for one in steps])])
    whole = Columns.of(open_, flight)
    rows = whole.chances(whole.grams(flight, open_.variance)[0])
    return Card(
        "diagnosis",
        limits,
        signals.driver,
        signals.outputs,
        steps,
        tuple((f"{a} or {b}", 0.5, chance, "chance to be right") for a, b, chance in rows),
        "; ".join(f"{a} and {b} are separated with a probability of {100.0 * chance:.0f} %"
                  for a, b, chance in rows),
        (),
        {"hypotheses": {one.name: one.probability for one in open_.hypotheses}},
    )  # fmt: skip


def read_undecided(file: Path) -> Undecided:
    """Read a `gap.json` with its emulator; raises `ConfigError` where nothing is left open."""
    document = gap_document(file)
    again = "Name the gap.json that narxcal diagnose wrote, unchanged"
    try:
        hypotheses = _hypotheses(document)
        signals = signals_from_json(document["quality"]["signals"])
        noise, rmse = document["quality"]["noise"], document["emulator"]["rmse"]
        own = np.array([float(rmse.get(name, 0.0)) for name in signals.outputs])
        white = np.array([float(noise[name]) for name in signals.outputs])
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        problem = f"a part is missing or damaged: {type(error).__name__}: {error}"
        raise ConfigError(problem, file=file, hint=again) from None
    if len(hypotheses) < 2:
        verdict = document["verdict"]
        named = " and ".join(verdict["effects"]) or "no effect"
        raise ConfigError(
            f"the diagnosis leaves nothing open that a flight could separate: it found {named}",
            file=file,
            hint="A card is for an ambiguous or undetermined diagnosis, or for a run",
        )
    slow = own**2 + (TOLERANCE * (signals.high - signals.low)) ** 2
    variance = white**2 + slow * max(_INDEPENDENT_S / signals.dt_s, 1.0)
    return Undecided(hypotheses, read_emulator(file.parent / EMULATOR), signals, variance)


def _hypotheses(document: Mapping[str, Any]) -> list[Hypothesis]:
    """The ambiguous effects, or of an undetermined diagnosis the likeliest, and that none acts.

    A load of unknown windows is no hypothesis: nobody knows whether it will be on.
    """
    verdict, effects = document["verdict"], document["effects"]
    rows = {name_of(row): row for row in effects if row["id"] != UNLOGGED_SWITCH.id}
    none = Hypothesis(None, np.zeros(0), np.zeros(0), float(verdict.get("none", 0.0)))
    names, also = [], []
    if verdict["kind"] == "ambiguous":
        names = [*verdict["effects"][:1], *verdict["ambiguous_with"]]
    elif verdict["kind"] == "unknown" and rows:
        names = sorted(rows, key=lambda name: -float(rows[name]["probability"]))
        least = _LIKELY * float(rows[names[0]]["probability"])
        names = [name for name in names if float(rows[name]["probability"]) >= least]
        also = [none]
    signals = signals_from_json(document["quality"]["signals"])
    found = [_hypothesis(name, rows[name], signals) for name in names if name in rows]
    return [*found[: _MOST - len(also)], *also]


def _hypothesis(name: str, row: Mapping[str, Any], signals: Signals) -> Hypothesis:
    kind, found = effect(name), row["parameters"]
    parameters = kind.parameters(signals)
    theta = theta_of(parameters, {key: float(one["value"]) for key, one in found.items()})
    spread = np.zeros(len(parameters))
    for k, one in enumerate(parameters):
        if one.name in found and not one.all_or_nothing:
            ends = float(found[one.name]["high"]) - float(found[one.name]["low"])
            spread[k] = max(ends, 0.0) / (2.0 * _INTERVAL)
    return Hypothesis(kind, theta, spread, float(row["probability"]))


def simulated(open_: Undecided, inputs: Sequence[FloatArray]) -> Flights:
    """Flights of the emulator from equilibrium over inputs (time, n_in) of each."""
    lengths = np.array([len(u) for u in inputs], dtype=np.int64)
    u = filled_up(inputs)
    begun = Flights(open_.signals, u, open_.emulator.settled.outputs(u), lengths)
    return replace(begun, y=open_.emulator.free_run(begun))


def _inside(open_: Undecided, u: FloatArray) -> bool:
    settled = open_.emulator.settled
    at = u[:, list(settled.conditions)]
    return bool(((at >= settled.low) & (at <= settled.high)).all())


@dataclass(frozen=True, eq=False)
class Columns:
    """Columns (k, moves, time, outputs): what hypotheses differ by, and how sure they are.

    The first `shared` are differences of build and the flight's offsets. Then each hypothesis has
    the responses to a standard deviation of its parameters, those in `own`; the last are the
    responses to the hypotheses, in their order.
    """

    values: FloatArray
    shared: int
    own: list[range]
    hypotheses: list[Hypothesis]

    @classmethod
    def of(cls, open_: Undecided, flights: Flights) -> Columns:
        """Run every effect over all moves."""
        outputs = len(open_.signals.outputs)
        offsets = np.zeros((outputs, *flights.y.shape))
        for k, size in enumerate(offset_sizes(flights).tolist()):
            offsets[k, ..., k] = size
        built = [each for _, each in build_columns(flights, open_.emulator)]
        parts: list[FloatArray] = [*built, *offsets]
        shared, edges = len(parts), [len(parts)]
        every = [_responses(one, flights, open_.emulator) for one in open_.hypotheses]
        for _, slopes in every:
            parts += [*slopes]
            edges.append(len(parts))
        own = [range(*pair) for pair in pairwise(edges)]
        values = np.stack([*parts, *(response for response, _ in every)])
        return cls(values, shared, own, open_.hypotheses)

    def grams(self, flights: Flights, variance: FloatArray) -> FloatArray:
        """Inner products (moves, k, k) by the inverse of `variance` (outputs,) of a sample."""
        found = []
        for m, length in enumerate(flights.lengths.tolist()):
            rows = (self.values[:, m, :length] / np.sqrt(variance)).reshape(len(self.values), -1)
            found.append(rows @ rows.T)
        return np.stack(found)

    @property
    def _pairs(self) -> list[tuple[int, int, float]]:
        """Pairs of hypotheses with their weights, which sum to one."""
        chances = [max(one.probability, 1e-9) for one in self.hypotheses]
        pairs = list(combinations(range(len(chances)), 2))
        whole = sum(chances[i] * chances[j] for i, j in pairs)
        return [(i, j, chances[i] * chances[j] / whole) for i, j in pairs]

    def squared_distance(self, gram: FloatArray, i: int, j: int) -> FloatArray:
        """Squared distance d^2 (...,) of hypotheses i and j by inner products (..., k, k)."""
        first = len(self.values) - len(self.hypotheses)
        n = np.array([*range(self.shared), *self.own[i], *self.own[j]])
        change = gram[..., first + i] - gram[..., first + j]
        whole = change[..., first + i] - change[..., first + j]
        b = change[..., n]
        inner = np.eye(len(n)) + gram[..., n[:, None], n[None]]
        return np.asarray(whole - np.sum(b * np.linalg.solve(inner, b[..., None])[..., 0], axis=-1))

    def divergence(self, gram: FloatArray) -> FloatArray:
        """Mean Kullback-Leibler divergence (...,) of pairs, in nats."""
        parts = [0.5 * w * self.squared_distance(gram, i, j) for i, j, w in self._pairs]
        return np.asarray(np.sum(parts, axis=0))

    def chances(self, gram: FloatArray) -> list[tuple[str, str, float]]:
        """Names of each pair, and the probability that the likelier one is the right one."""
        names = [one.name for one in self.hypotheses]
        return [
            (names[i], names[j], float(ndtr(0.5 * np.sqrt(max(float(d2), 0.0)))))
            for i, j, _ in self._pairs
            for d2 in [self.squared_distance(gram, i, j)]
        ]


def _responses(
    one: Hypothesis, flights: Flights, emulator: GreyBoxEmulator
) -> tuple[FloatArray, FloatArray]:
    """What a hypothesis does (moves, time, outputs), and slopes of it (parameters, ...).

    A slope is half the difference of a standard deviation up and down of what is not certain.
    """
    if one.effect is None:
        return np.zeros_like(flights.y), np.zeros((0, *flights.y.shape))
    low, high = np.array([(p.low, p.high) for p in one.effect.parameters(flights.signals)]).T
    steps = np.diag(one.spread)[one.spread > 0.0]
    thetas = np.clip(np.vstack([one.theta, one.theta + steps, one.theta - steps]), low, high)
    found = respond([(one.effect, thetas)], flights, emulator) - flights.y
    up, down = np.split(found[1:], 2)
    return found[0], 0.5 * (up - down)
