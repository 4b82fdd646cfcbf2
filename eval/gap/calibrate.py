"""Writes the weights of the conditional logit: `python -m eval.gap.calibrate FEATURES [OUT]`.

FEATURES is a folder of `*.json` with the features and the truth of blind cases, as
`--features` of this command leaves them beside the cases: reading, emulating and fitting a case takes
ten seconds, the weights of all less than one. The file that it writes says when, on which seeds and
on how many cases of which engines they were fitted, and what the same fit reaches on engines of a
family that it has not seen.
"""

from __future__ import annotations

import argparse
import datetime
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.optimize import minimize
from scipy.special import log_softmax, logsumexp

from narxcal.support.arrays import FloatArray
from training.budget.odds import FEATURES, OF_CASE, Odds, prior

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
    """What the weights say of a case: the likeliest answer, its probability, whether it is right."""
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


def main(arguments: Sequence[str] | None = None) -> None:
    """Fit, report, write."""
    parser = argparse.ArgumentParser(description="Fit the weights of the budget's probabilities")
    parser.add_argument("features", type=Path)
    parser.add_argument("out", type=Path, nargs="?")
    given = parser.parse_args(arguments)
    cases = [read_case(file) for file in sorted(given.features.glob("*.json"))]
    rows = left_out(cases)
    print(json.dumps(figures(rows), indent=1))
    for row in rows:
        if not row["right"] and row["kind"] in ("single", "pair") and row["share"] >= _SMALL:
            print(row["name"], row["true"], round(row["share"], 2), "->", row["first"], round(row["probability"], 2))
    if given.out is None:
        return
    odds = fit(cases)
    families = {f: sum(one.family == f for one in cases) for f in FAMILIES.values()}
    text = {
        "date": datetime.datetime.now(tz=datetime.UTC).date().isoformat(),
        "cases": len(cases),
        "families": families,
        "family_left_out": figures(rows),
        "features": list(FEATURES),
        "of_case": list(OF_CASE),
        "effect": list(odds.effect),
        "none": list(odds.none),
        "unknown": list(odds.unknown),
    }
    given.out.write_text(json.dumps(text, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
