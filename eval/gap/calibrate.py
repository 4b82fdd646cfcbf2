"""Writes the weights of the budget's conditional logit, from blind cases with an open key.

    python -m eval.gap.calibrate weigh FEATURES CASE...
    python -m eval.gap.calibrate fit FEATURES [OUT]

`weigh` reads, emulates and fits each case (ten seconds) and leaves its features and its truth in a
folder; `fit` finds the weights (a second). The file that it writes says when, on how many cases of
which engines they were fitted, and what such weights reach on engines of a family left out.
"""

from __future__ import annotations

import argparse
import datetime as dt
import json
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.optimize import minimize
from scipy.special import log_softmax, logsumexp

from eval.gap.budget import batched, phases_of, record_of
from eval.gap.pairs import read_pairs
from narxcal.support.arrays import FloatArray
from training.budget.control import suited
from training.budget.diagnosis import Engines, diagnose
from training.budget.odds import FEATURES, OF_CASE, Odds, prior
from training.gap.emulator import fit_emulators

RIDGE: Final = 0.1
_SMALL: Final = 0.05  # share of the gap below which nobody has to name an effect
_OUTSIDE: Final = 0.5  # weight of a case that the library does not hold
FAMILIES: Final = {
    "lumped_n1": "lumped",
    "lumped_n2": "lumped",
    "lumped_fuel": "lumped",
    "maker": "maker",
    "business_jet": "virtual",
    "single_aisle": "virtual",
}


@dataclass(frozen=True, eq=False)
class Case:
    """Features of one case, which answers are right, and how much it counts."""

    name: str
    family: str
    kind: str
    effects: tuple[str, ...]
    features: FloatArray
    case: FloatArray
    right: FloatArray
    weight: float
    true: tuple[str, ...]
    share: float


def read_case(file: Path) -> Case:
    """One case from what its diagnosis stored and its truth."""
    found = json.loads(file.read_text(encoding="utf-8"))
    truth, facts = found["truth"], found["facts"]
    names = tuple(facts["features"])
    true = tuple(e["id"] + (f":{e['channel']}" if e["channel"] else "") for e in truth["effects"])
    share = float(truth["gap_share"])
    right = np.array([name in true for name in names] + [False, False], dtype=bool)
    if truth["kind"] == "null":
        right[-2] = True
    elif truth["kind"] == "outside":
        right[-1] = True
        right[-2] = share < _SMALL
    elif share < _SMALL or not right.any():
        right[-2:] = True
    weight = _OUTSIDE if truth["kind"] == "outside" else 1.0
    return Case(
        file.stem,
        FAMILIES.get(truth["engine"], truth["engine"]),
        truth["kind"],
        names,
        np.array([facts["features"][name] for name in names]),
        np.array(facts["case_features"]),
        right,
        weight,
        true,
        share,
    )


def fit(cases: Sequence[Case]) -> Odds:
    """Weights that make right answers likeliest, with a ridge on all."""
    n, m = len(FEATURES), len(OF_CASE)
    designs = [_design(one, n, m) for one in cases]
    priors = [np.array([*map(prior, one.effects), 0.0, 0.0]) for one in cases]

    def loss(w: FloatArray) -> tuple[float, FloatArray]:
        total, slope = RIDGE * float(w @ w), 2.0 * RIDGE * w
        for one, design, before in zip(cases, designs, priors, strict=True):
            scores = log_softmax(design @ w + before)
            right = logsumexp(scores[one.right])
            total -= one.weight * float(right)
            better = np.where(one.right, np.exp(scores - right), 0.0)
            slope += one.weight * (np.exp(scores) - better) @ design
        return total, slope

    found = minimize(loss, np.zeros(n + 2 * m), jac=True, method="L-BFGS-B")
    w = tuple(float(v) for v in found.x)
    return Odds(w[:n], w[n : n + m], w[n + m :])


def _design(one: Case, n: int, m: int) -> FloatArray:
    """Features of every answer (effects + 2, n + 2 m): of effects, of the case for two more."""
    count = len(one.effects)
    found = np.zeros((count + 2, n + 2 * m))
    found[:count, :n] = one.features
    found[count, n : n + m] = found[count + 1, n + m :] = one.case
    return found


def judged(one: Case, odds: Odds) -> dict[str, Any]:
    """What the weights say of a case, how probable it is, and whether it is right."""
    chances = odds.probabilities(one.effects, one.features, one.case)
    first = int(np.argmax(chances[:-2]))
    says = int(np.argmax(chances))
    return {
        "name": one.name,
        "family": one.family,
        "kind": one.kind,
        "true": one.true,
        "share": one.share,
        "first": one.effects[first],
        "probability": float(chances[first]),
        "none": float(chances[-2]),
        "unknown": float(chances[-1]),
        "named": says < len(one.effects),
        "right": one.effects[first] in one.true,
    }


def figures(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Top-1 of effects above 5 % of the gap, nulls named, claims right, and the calibration."""
    large = [r for r in rows if r["kind"] in ("single", "pair") and r["share"] >= _SMALL]
    nulls = [r for r in rows if r["kind"] == "null"]
    claims = [r for r in rows if r["named"]]
    return {
        "cases": len(rows),
        "top1": _mean([r["right"] for r in large]),
        "answered": _mean([r["right"] and r["named"] for r in large]),
        "nulls_named": _mean([r["named"] for r in nulls]),
        "outside_named": _mean([r["named"] for r in rows if r["kind"] == "outside"]),
        "claims_right": _mean([r["right"] for r in claims]),
        "ece": _ece(claims),
    }


def _mean(values: Sequence[bool]) -> list[float]:
    return [float(np.mean(values)) if values else float("nan"), len(values)]


def _ece(claims: Sequence[dict[str, Any]], bins: int = 5) -> float:
    """Calibration error in bins of equal mass."""
    if not claims:
        return float("nan")
    order = sorted(claims, key=lambda r: r["probability"])
    parts = np.array_split(np.arange(len(order)), min(bins, len(order)))
    off = [
        len(p) * abs(np.mean([order[k]["probability"] - order[k]["right"] for k in p]))
        for p in parts
    ]
    return float(sum(off) / len(order))


def left_out(cases: Sequence[Case]) -> list[dict[str, Any]]:
    """Every family judged by weights that were fitted on the others."""
    rows: list[dict[str, Any]] = []
    for family in dict.fromkeys(one.family for one in cases):
        odds = fit([one for one in cases if one.family != family])
        rows += [judged(one, odds) for one in cases if one.family == family]
    return rows


def weigh_case(case: Path) -> dict[str, Any]:
    """Features and layers of one case, with its truth."""
    data = batched(read_pairs(case / "real", case / "sim"))
    record = record_of(data)
    emulator = suited(fit_emulators(data.flights), record)
    found = diagnose(record, Engines(emulator), phases_of(data))
    truth = json.loads((case / "truth.json").read_text(encoding="utf-8"))
    return {"truth": truth, "verdict": found.verdict_row(), "facts": dict(found.facts)}


def written(cases: Sequence[Case], out: Path) -> dict[str, Any]:
    """Fit the weights, write them, and give the figures with each family left out."""
    rows, odds = left_out(cases), fit(cases)
    text = {
        "date": dt.datetime.now(tz=dt.UTC).date().isoformat(),
        "cases": len(cases),
        "families": {f: sum(one.family == f for one in cases) for f in FAMILIES.values()},
        "family_left_out": figures(rows),
        "features": list(FEATURES),
        "of_case": list(OF_CASE),
        "effect": list(odds.effect),
        "none": list(odds.none),
        "unknown": list(odds.unknown),
    }
    out.write_text(json.dumps(text, indent=1) + "\n", encoding="utf-8")
    return text


def main(arguments: Sequence[str] | None = None) -> None:
    """Weigh cases, or fit the weights and report."""
    parser = argparse.ArgumentParser(description="The weights of the budget's probabilities")
    parser.add_argument("do", choices=("weigh", "fit"))
    parser.add_argument("features", type=Path)
    parser.add_argument("more", type=Path, nargs="*")
    given = parser.parse_args(arguments)
    if given.do == "weigh":
        given.features.mkdir(parents=True, exist_ok=True)
        for case in given.more:
            found = json.dumps(weigh_case(case), default=float)
            name = f"{case.parent.name}_{case.name}.json"
            (given.features / name).write_text(found, encoding="utf-8")
        return
    cases = [read_case(file) for file in sorted(given.features.glob("*.json"))]
    out = given.more[0] if given.more else Path(os.devnull)
    sys.stdout.write(json.dumps(written(cases, out)["family_left_out"], indent=1) + "\n")


if __name__ == "__main__":
    main()
