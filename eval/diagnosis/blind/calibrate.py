"""Writes the weights of the budget's conditional logits, from blind cases.

    python -m eval.diagnosis.blind.calibrate weigh FEATURES SECRET CASES...
    python -m eval.diagnosis.blind.calibrate fit FEATURES [OUT]

`weigh` reads, emulates and fits every case of folders that `narxcal blind make` wrote (ten seconds
each), opens their keys, and leaves features and truth in a folder; `fit` finds the weights (a few
seconds). The file that it writes says when, on how many cases of which engines they were fitted,
and what such weights reach on engines of a family left out.
"""

from __future__ import annotations

import argparse
import datetime as dt
import json
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import minimize
from scipy.special import log_softmax, logsumexp
from sklearn.linear_model import LogisticRegression

from eval.diagnosis.blind.files import open_key
from eval.diagnosis.blind.outcome import FLOOR, NONE, Outcome
from eval.diagnosis.blind.score import Rate, table
from eval.diagnosis.flights import batch
from eval.diagnosis.pairs import read_pairs
from narxcal.support.arrays import BoolArray, FloatArray
from training.diagnosis.emulator import choose_control, fit_emulators
from training.diagnosis.fit import Single
from training.diagnosis.layers import (
    FEATURES,
    OF_CASE,
    Odds,
    compound_fits,
    features,
    log_odds,
    prior,
)
from training.diagnosis.remainder import left_of_build
from training.diagnosis.verdict import Engines, weigh

RIDGE: Final = 0.1
_OUTSIDE: Final = 0.5  # weight of a case that the library does not hold


@dataclass(frozen=True, eq=False)
class Choice:
    """One choice that a logit makes: `effects` or `others` more answers, which of them are `right`.

    `features` (effects, ...) are those of the effects, `case` that of the case, for every other
    answer.
    """

    effects: tuple[str, ...]
    features: FloatArray
    case: FloatArray
    others: int
    right: BoolArray
    weight: float = 1.0

    def design(self) -> FloatArray:
        """Features of every answer, (effects + others, ...): of effects, then once per other."""
        return np.asarray(block_diag(self.features, *[self.case] * self.others))


@dataclass(frozen=True, eq=False)
class Case:
    """One case: the choice of its first effect, and of a second effect, by what comes first."""

    outcome: Outcome
    first: Choice
    further: Mapping[str, Choice]


def read_case(file: Path) -> Case:
    found = json.loads(file.read_text(encoding="utf-8"))
    outcome = Outcome(file.stem, found["truth"], {})
    first = Choice(*_arrays(found), 2, _right(outcome, found["names"]), _weight(outcome))
    further = {
        row["leader"]: Choice(*_arrays(row), 1, _second(outcome, row), _weight(outcome))
        for row in found["further"]
    }
    return Case(outcome, first, further)


def _arrays(row: Mapping[str, Any]) -> tuple[tuple[str, ...], FloatArray, FloatArray]:
    return tuple(row["names"]), np.array(row["effects"]), np.array(row["case"])


def _weight(outcome: Outcome) -> float:
    return _OUTSIDE if outcome.kind == "outside" else 1.0


def _right(outcome: Outcome, names: Sequence[str]) -> BoolArray:
    """Which answers are right: a true effect; the others where there is none, or hardly any."""
    right = np.array([name in outcome.true_effects for name in names] + [False, False])
    small = outcome.gap_share < FLOOR
    if outcome.kind == "null":
        right[-2] = True
    elif outcome.kind == "outside":
        right[-2:] = [small, True]
    elif small or not right.any():
        right[-2:] = True
    return right


def _second(outcome: Outcome, row: Mapping[str, Any]) -> BoolArray:
    """Which second effects are right: the other true effect where it is not small."""
    leader, names = row["leader"], row["names"]
    others = [name for name in outcome.true_effects if name != leader]
    right = np.array([name in others for name in names] + [False])
    shares = [outcome.truth["budget"][name]["share"] for name in others]
    right[-1] = not right.any() or max(shares) < FLOOR
    return right


def fitted(choices: Sequence[Choice], around: FloatArray | None = None) -> FloatArray:
    """Weights that make right answers likeliest, with a ridge, `around` values of the first."""
    designs = [one.design() for one in choices]
    before = [np.array([*map(prior, one.effects), *[0.0] * one.others]) for one in choices]
    middle = np.zeros(designs[0].shape[1])
    if around is not None:
        middle[: len(around)] = around

    def loss(w: FloatArray) -> tuple[float, FloatArray]:
        total, slope = RIDGE * float((w - middle) @ (w - middle)), 2.0 * RIDGE * (w - middle)
        for one, design, known in zip(choices, designs, before, strict=True):
            scores = log_softmax(design @ w + known)
            right = logsumexp(scores[one.right])
            total -= one.weight * float(right)
            better = np.where(one.right, np.exp(scores - right), 0.0)
            slope += one.weight * (np.exp(scores) - better) @ design
        return total, slope

    return np.asarray(minimize(loss, middle, jac=True, method="L-BFGS-B").x)


def fit(cases: Sequence[Case]) -> Odds:
    """The weights of both logits, and how sure the likeliest effect is.

    That is judged on engines of each family by weights that were fitted on the others.
    """
    leading = []
    for own, others in _each_family(cases):
        odds = logits(others)
        leading += [(_likeliest(one.first, odds), one.outcome.true_effects) for one in own]
    odds = logits(cases)
    right = np.array([name in true for (name, *_), true in leading])
    if len({*right.tolist()}) < 2:
        return odds
    known = [[log_odds(chance)] for (_, chance, _), _ in leading]
    curve = LogisticRegression(C=10.0).fit(known, right)
    return replace(odds, acts=(float(curve.intercept_[0]), float(curve.coef_[0, 0])))


def logits(cases: Sequence[Case]) -> Odds:
    """The weights of both logits; those of further effects shrink towards those of the first.

    A further effect is fitted where the first one acts: other cases carry no information on it.
    """
    n, m = len(FEATURES), len(OF_CASE)
    w = fitted([one.first for one in cases])
    true = [
        choice
        for one in cases
        for leader, choice in one.further.items()
        if leader in one.outcome.true_effects
    ]
    more = fitted(true, w[:n]) if true else np.concatenate([w[:n], np.zeros(m)])
    parts = (w[:n], w[n : n + m], w[n + m :], more[:n], more[n:])
    return Odds(*(tuple(part.tolist()) for part in parts))


def _each_family(cases: Sequence[Case]) -> Iterator[tuple[list[Case], list[Case]]]:
    for family in dict.fromkeys(one.outcome.family for one in cases):
        own = [one for one in cases if one.outcome.family == family]
        if len(own) < len(cases):
            yield own, [one for one in cases if one.outcome.family != family]


def _likeliest(choice: Choice, odds: Odds) -> tuple[str, float, float]:
    """The likeliest effect, its probability, and that of none and unknown together."""
    chances = np.exp(odds.first(choice.effects, choice.features, choice.case))
    best = int(np.argmax(chances[:-2]))
    return choice.effects[best], float(chances[best]), float(chances[-2:].sum())


def judged(one: Case, odds: Odds) -> Outcome:
    """The case with what the weights say of it in the place of an answer."""
    leader, chance, others = _likeliest(one.first, odds)
    said = [leader] if chance > others else []
    more = one.further.get(leader)
    if said and more is not None:
        beside_it = odds.more(more.effects, more.features, more.case)
        best = int(np.argmax(beside_it))
        said += [more.effects[best]] if best < len(more.effects) else []
    verdict = {"kind": "effects" if said else NONE, "effects": said, "ambiguous_with": []}
    effects = [{"id": leader, "probability": odds.sure(chance)}]
    return one.outcome._replace(answer={"verdict": verdict, "effects": effects})


_FIGURES: Final = {
    "top1": "top-1, ranked first",
    "answered": "top-1, as answered",
    "exact_singles": "exact verdict of singles",
    "exact_pairs": "exact pair",
    "nulls_named": "nulls claimed",
    "outside_named": "firm claims out of library",
    "claims_right": "claims right",
    "ece": "calibration error (ECE)",
}


def figures(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Measures of the blind test: of a share its value, and over how many cases it is."""
    found = {each.name: each.value for each in table(outcomes)}
    values = {key: found[name] for key, name in _FIGURES.items()}
    shown = {k: [v.value, v.of] if isinstance(v, Rate) else v for k, v in values.items()}
    return {"cases": len(outcomes), **shown}


def left_out(cases: Sequence[Case]) -> list[Outcome]:
    """Every family judged by weights that were fitted on the others."""
    rows: list[Outcome] = []
    for own, others in _each_family(cases):
        odds = fit(others)
        rows += [judged(one, odds) for one in own]
    return rows


def weigh_case(case: Path, truth: Mapping[str, Any]) -> dict[str, Any]:
    """Features of one case, and of second effects, with its leader and with each true one first."""
    record = batch(read_pairs(case / "real", case / "sim"))
    emulator = choose_control(fit_emulators(record.flights), record)
    evidence = weigh(record, Engines(emulator))
    singles = {one.name: one for one in evidence.singles}
    leader = list(singles)[int(np.argmax(evidence.effects @ evidence.setting.odds.effect))]
    true = [name for name in Outcome(case.name, truth, {}).true_effects if name in singles]
    further = []
    for name in dict.fromkeys([leader, *true]):
        frame, tried = compound_fits(evidence.setting, [singles[name]])
        further.append({"leader": name, **_row(tried, *features(frame, tried))})
    own = _row(evidence.singles, evidence.effects, evidence.case)
    left = float(left_of_build(evidence.frame)[1].max())
    return {"truth": truth, **own, "further": further, "left": left}


def _row(singles: Sequence[Single], effects: FloatArray, case: FloatArray) -> dict[str, Any]:
    names = [one.name for one in singles]
    return {"names": names, "effects": effects.tolist(), "case": case.tolist()}


def written(cases: Sequence[Case], out: Path) -> dict[str, Any]:
    """Fit the weights, write them, and give the figures with each family left out."""
    rows, odds = left_out(cases), fit(cases)
    families = [one.outcome.family for one in cases]
    text = {
        "date": dt.datetime.now(tz=dt.UTC).date().isoformat(),
        "cases": len(cases),
        "families": {f: families.count(f) for f in sorted({*families})},
        "family_left_out": figures(rows),
        "features": list(FEATURES),
        "of_case": list(OF_CASE),
        **asdict(odds),
    }
    out.write_text(json.dumps(text, indent=1) + "\n", encoding="utf-8")
    return text


def main(arguments: Sequence[str] | None = None) -> None:
    """Weigh cases, or fit the weights and report."""
    parser = argparse.ArgumentParser(description="The weights of the budget's probabilities")
    parser.add_argument("do", choices=("weigh", "fit"))
    parser.add_argument("features", type=Path)
    parser.add_argument("more", nargs="*")
    given = parser.parse_args(arguments)
    if given.do == "weigh":
        secret, *folders = given.more
        given.features.mkdir(parents=True, exist_ok=True)
        for folder in map(Path, folders):
            for name, truth in open_key(folder, secret)["cases"].items():
                found = json.dumps(weigh_case(folder / name, truth), default=float)
                (given.features / f"{folder.name}_{name}.json").write_text(found, encoding="utf-8")
        return
    cases = [read_case(file) for file in sorted(given.features.glob("*.json"))]
    out = Path(given.more[0] if given.more else os.devnull)
    sys.stdout.write(json.dumps(written(cases, out)["family_left_out"], indent=1) + "\n")


if __name__ == "__main__":
    main()
