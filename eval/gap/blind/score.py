"""Scores the answers to a blind test with its key: the table of GAP section 2, and by gap share."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from eval.gap.blind.files import open_key, read_json
from eval.gap.blind.metrics import (
    Rate,
    brier,
    calibration_error,
    kappa,
    macro_f1,
    mean,
    median,
    overlap,
    rate,
)
from eval.gap.blind.outcome import FLOOR, NONE, Outcome
from eval.gap.blind.run import ANSWERS, read_answer
from eval.gap.blind.run import SCHEMA as ANSWERS_SCHEMA
from narxcal.errors import DataError

SCHEMA: Final = "narxcal.blind_score/1"
EDGES: Final = (0.02, 0.05, 0.10, 0.25)
GROUPS: Final = ("below 2 %", "2-5 %", "5-10 %", "10-25 %", "above 25 %")
Cases = Sequence[Outcome]


class Measure(NamedTuple):
    """One line of the table: its group, what it is, over which cases, and its value.

    `value` is a share with its interval, or a number in `unit`.
    """

    group: str
    name: str
    value: Rate | float
    unit: str = ""

    def row(self) -> dict[str, Any]:
        """Give it as plain values."""
        found = self.value.row() if isinstance(self.value, Rate) else {"value": self.value}
        return {"group": self.group, "name": self.name, "unit": self.unit, **found}


def score_answers(folder: Path, answers: Path, secret: str) -> dict[str, Any]:
    """Open the key of the cases in `folder` and score the answers; returns the document.

    Raises `DataError` for a case without an answer, and as `open_key`.
    """
    read_json(answers / ANSWERS, ANSWERS_SCHEMA)
    key = open_key(folder, secret)
    outcomes = []
    for name, truth in key["cases"].items():
        answer = read_answer(answers, name)
        if answer is None:
            raise DataError(
                "the case has no answer yet",
                file=answers / name,
                hint="Go on with `narxcal blind run`, then score",
            )
        outcomes.append(Outcome(name, truth, answer))
    return scored(outcomes, key["plan"])


def scored(outcomes: Cases, plan: Mapping[str, Any]) -> dict[str, Any]:
    """Put all that is measured over outcomes into a document of schema narxcal.blind_score/1."""
    return {
        "schema": SCHEMA,
        "plan": dict(plan),
        "cases": {kind: sum(o.kind == kind for o in outcomes) for kind in _kinds(outcomes)},
        "wrong_base": sum(bool(o.truth["base"]["differs"]) for o in outcomes),
        "table": [each.row() for each in table(outcomes)],
        "by_style": {
            s: _rows(o for o in outcomes if o.truth["style"] == s) for s in _styles(outcomes)
        },
        "by_gap_share": by_gap_share(outcomes),
        "confusion": confusion(outcomes),
        "outcomes": [_outcome(each) for each in outcomes],
    }


def table(outcomes: Cases) -> list[Measure]:
    """Every measure; those on effects over cases of the library with at least 5 % of the gap."""
    above = [o for o in outcomes if o.in_library and o.gap_share >= FLOOR]
    return [
        *_detection(outcomes, above),
        *_attribution(outcomes, above),
        *_abstention(outcomes),
        *_localisation(above),
        *_shrinkage(outcomes),
        *_pairs(outcomes),
        *_cost(outcomes),
    ]


def by_gap_share(outcomes: Cases) -> list[dict[str, Any]]:
    """The main shares over cases of the library, by the share of the gap that the effect makes."""
    inside = [o for o in outcomes if o.in_library]
    place = np.digitize([o.gap_share for o in inside], EDGES).tolist()
    found = []
    for number, name in enumerate(GROUPS):
        group = [o for o, at in zip(inside, place, strict=True) if at == number]
        singles = [o for o in group if o.kind == "single"]
        found.append(
            {
                "gap_share": name,
                "cases": len(group),
                "detected": rate([_detected(o) for o in group]).row(),
                "claimed": rate([o.claims for o in group]).row(),
                "top_1": rate([o.first(1) for o in group]).row(),
                "top_2": rate([o.first(2) for o in group]).row(),
                "family": rate([o.family_first for o in group]).row(),
                "as_answered": rate([o.said in o.true_effects for o in singles]).row(),
                "channel": rate([o.channel_right for o in group]).row(),
                "overlap": mean([overlap(*o.overlap_of) for o in group]),
                "shrinkage_error": _shrinkage_error(group),
            }
        )
    return found


def confusion(outcomes: Cases) -> dict[str, dict[str, int]]:
    """True label -> label of the answer -> count; pairs count by the effect that was named."""
    found: dict[str, dict[str, int]] = {}
    for outcome in sorted(outcomes, key=lambda o: o.true_label):
        row = found.setdefault(outcome.true_label, {})
        row[outcome.said] = row.get(outcome.said, 0) + 1
    return found


def _detection(outcomes: Cases, above: Cases) -> list[Measure]:
    nulls = [o for o in outcomes if o.kind == "null"]
    strange = [o for o in outcomes if o.kind == "outside"]
    mimics = [o for o in strange if o.truth["outside"]["like"]]
    return [
        Measure("detection", "false claims on nulls", rate([o.claims for o in nulls])),
        Measure("detection", "firm false claims on nulls", rate([_firm(o) for o in nulls])),
        Measure("detection", "gap seen, g >= 5 %", rate([_detected(o) for o in above])),
        Measure("detection", "effect claimed, g >= 5 %", rate([o.claims for o in above])),
        Measure("abstention", "firm claims out of library", rate([_firm(o) for o in strange])),
        Measure("abstention", "firm claims on mimics", rate([_firm(o) for o in mimics])),
    ]


def _attribution(outcomes: Cases, above: Cases) -> list[Measure]:
    claims = [o for o in outcomes if o.claims]
    true = [_highest_true(o) for o in above]
    sets = [o for o in above if o.claims]
    firsts = [o.probabilities.get(o.ranked[0], 0.0) if o.ranked else 0.0 for o in claims]
    labels = [o.true_label for o in outcomes], [o.said for o in outcomes]
    answered = [o for o in outcomes if not o.failed]
    named = [o.said in o.true_effects for o in above]
    return [
        Measure("attribution", "top-1, ranked first", rate([o.first(1) for o in above])),
        Measure("attribution", "top-1, as answered", rate(named)),
        Measure("attribution", "top-2", rate([o.first(2) for o in above])),
        Measure("attribution", "family of the first", rate([o.family_first for o in above])),
        Measure("attribution", "right where it claims", rate([_named_true(o) for o in claims])),
        Measure("attribution", "macro-F1, with none and unknown", macro_f1(*labels)),
        Measure("attribution", "Cohen's kappa", kappa(*labels)),
        Measure("attribution", "mean probability of the true effect", mean(true)),
        Measure(
            "attribution",
            "Brier score",
            brier([o.probabilities for o in answered], [o.true_effects for o in answered]),
        ),
        Measure(
            "attribution",
            "calibration error (ECE) of claims",
            calibration_error(firsts, [o.first(1) for o in claims]),
        ),
        Measure("set", "true effect in the named set", rate([_covered(o) for o in sets])),
        Measure("set", "mean size", mean([float(len(o.named_set)) for o in sets])),
    ]


def _abstention(outcomes: Cases) -> list[Measure]:
    abstained = [o for o in outcomes if o.verdict in ("none", "unknown")]
    good = [not o.in_library or o.gap_share < FLOOR for o in abstained]
    strange = [o for o in outcomes if o.kind == "outside" and o.gap_share >= FLOOR]
    return [
        Measure("abstention", "precision of none and unknown", rate(good)),
        Measure(
            "abstention",
            "unknown out of library, g >= 5 %",
            rate([o.verdict == "unknown" for o in strange]),
        ),
    ]


def _localisation(above: Cases) -> list[Measure]:
    found = [o for o in above if not o.failed]
    return [
        Measure("where", "channel of most energy", rate([o.channel_right for o in found])),
        Measure(
            "where", "overlap (IoU) of 70 % bins", mean([overlap(*o.overlap_of) for o in found])
        ),
    ]


def _shrinkage(outcomes: Cases) -> list[Measure]:
    both = [o.shrinkage for o in outcomes]
    found = [each for each in both if each is not None]
    errors = [float(p["value"]) - r for p, r in found]
    inside = [float(p["low"]) <= r <= float(p["high"]) for p, r in found]
    return [
        Measure("shrinkage", "mean absolute error", mean([abs(e) for e in errors])),
        Measure("shrinkage", "bias (predicted - realised)", mean(errors)),
        Measure("shrinkage", "realised within the interval", rate(inside)),
    ]


def _pairs(outcomes: Cases) -> list[Measure]:
    pairs = [o for o in outcomes if o.kind == "pair" and o.gap_share >= FLOOR]
    singles = [o for o in outcomes if o.kind == "single" and o.claims]
    return [
        Measure("pairs", "exact pair", rate([{*o.claimed} == {*o.true_effects} for o in pairs])),
        Measure(
            "pairs",
            "at least one of two",
            rate([bool({*o.claimed} & {*o.true_effects}) for o in pairs]),
        ),
        Measure(
            "pairs", "second effect claimed on one", rate([len(o.claimed) > 1 for o in singles])
        ),
    ]


def _cost(outcomes: Cases) -> list[Measure]:
    seconds = [o.seconds for o in outcomes if o.seconds is not None]
    return [
        Measure("cost", "cases without an answer", rate([o.failed for o in outcomes])),
        Measure("cost", "median time per case", median(seconds), "s"),
        Measure("cost", "longest time", max(seconds, default=float("nan")), "s"),
    ]


def _rows(outcomes: Iterable[Outcome]) -> list[dict[str, Any]]:
    return [each.row() for each in table(list(outcomes))]


def _firm(outcome: Outcome) -> bool:
    return outcome.verdict == "effects"


def _detected(outcome: Outcome) -> bool:
    return not outcome.failed and outcome.verdict != NONE


def _covered(outcome: Outcome) -> bool:
    return {*outcome.true_effects} <= {*outcome.named_set}


def _named_true(outcome: Outcome) -> bool:
    """Whether the effect that is named first is a true one."""
    return outcome.claimed[0] in outcome.true_effects


def _highest_true(outcome: Outcome) -> float:
    return max(outcome.probabilities.get(name, 0.0) for name in outcome.true_effects)


def _shrinkage_error(group: Cases) -> float:
    both = [o.shrinkage for o in group]
    return mean([abs(float(f[0]["value"]) - f[1]) for f in both if f is not None])


def _kinds(outcomes: Cases) -> list[str]:
    return sorted({o.kind for o in outcomes})


def _styles(outcomes: Cases) -> list[str]:
    return sorted({str(o.truth["style"]) for o in outcomes})


def _outcome(outcome: Outcome) -> dict[str, Any]:
    """One case in a line: what was true, and what was said."""
    strange = outcome.truth["outside"]
    said = outcome.shrinkage
    return {
        "case": outcome.name,
        "kind": outcome.kind,
        "style": outcome.truth["style"],
        "engine": outcome.truth["engine"],
        "wrong_base": outcome.truth["base"]["differs"],
        "gap_share": outcome.gap_share,
        "true": list(outcome.true_effects) or ([strange["id"]] if strange else []),
        "verdict": outcome.verdict,
        "claimed": list(outcome.claimed),
        "ambiguous_with": list(outcome.named_set[len(outcome.claimed) :]),
        "ranked": list(outcome.ranked[:3]),
        "reason": outcome.answer.get("reason") or outcome.answer["verdict"]["reason"],
        "predicted": None if said is None else float(said[0]["value"]),
        "realised": None if said is None else said[1],
        "seconds": outcome.seconds,
    }
