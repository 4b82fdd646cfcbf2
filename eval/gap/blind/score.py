"""Scores the answers to a blind test with its key: the table of GAP section 2, and by gap share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from eval.gap.blind.files import open_key, read_json
from eval.gap.blind.measures import Cases, detected, shrinkage_error, table
from eval.gap.blind.metrics import mean, overlap, rate
from eval.gap.blind.outcome import Outcome
from eval.gap.blind.run import ANSWERS, read_answer, read_reruns
from eval.gap.blind.run import SCHEMA as ANSWERS_SCHEMA
from narxcal.errors import DataError

SCHEMA: Final = "narxcal.blind_score/1"
EDGES: Final = (0.02, 0.05, 0.10, 0.25)
GROUPS: Final = ("below 2 %", "2-5 %", "5-10 %", "10-25 %", "above 25 %")


def score_answers(
    folder: Path, answers: Path, secret: str, also: Sequence[tuple[Path, Path]] = ()
) -> dict[str, Any]:
    """Open the key of the cases in `folder` and score the answers; returns the document.

    `also` are further folders of cases with their answers, whose keys the same secret opens.
    Raises `DataError` for a case without an answer, and as `open_key`.
    """
    outcomes, plan = _opened(folder, answers, secret)
    if not also:
        return scored(outcomes, plan)
    outcomes = [each._replace(name=f"{folder.name}/{each.name}") for each in outcomes]
    for other, theirs in also:
        more = _opened(other, theirs, secret)[0]
        outcomes += [each._replace(name=f"{other.name}/{each.name}") for each in more]
    return scored(outcomes, plan)


def _opened(folder: Path, answers: Path, secret: str) -> tuple[list[Outcome], dict[str, Any]]:
    """All cases of a folder with their answers, and the plan that they were made by."""
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
        outcomes.append(Outcome(name, truth, answer, read_reruns(answers, name)))
    return outcomes, dict(key["plan"])


def scored(outcomes: Cases, plan: Mapping[str, Any]) -> dict[str, Any]:
    """Put all that is measured over outcomes into a document of schema narxcal.blind_score/1."""
    return {
        "schema": SCHEMA,
        "plan": dict(plan),
        "cases": {kind: sum(o.kind == kind for o in outcomes) for kind in _kinds(outcomes)},
        "wrong_base": sum(bool(o.truth["base"]["differs"]) for o in outcomes),
        "table": [each.row() for each in table(outcomes)],
        "by_style": _by(outcomes, "style"),
        "by_engine": _by(outcomes, "engine"),
        "by_gap_share": by_gap_share(outcomes),
        "confusion": confusion(outcomes),
        "outcomes": [_outcome(each) for each in outcomes],
    }


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
                "detected": rate([detected(o) for o in group]).row(),
                "claimed": rate([o.claims for o in group]).row(),
                "top_1": rate([o.first(1) for o in group]).row(),
                "top_2": rate([o.first(2) for o in group]).row(),
                "family": rate([o.family_first for o in group]).row(),
                "as_answered": rate([o.said in o.true_effects for o in singles]).row(),
                "channel": rate([o.channel_right for o in group]).row(),
                "overlap": mean([overlap(*o.overlap_of) for o in group]),
                "shrinkage_error": shrinkage_error(group),
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


def _by(outcomes: Cases, fact: str) -> dict[str, list[dict[str, Any]]]:
    """The whole table over the cases of each style, or engine."""
    found = sorted({str(o.truth[fact]) for o in outcomes})
    return {
        each: [m.row() for m in table([o for o in outcomes if o.truth[fact] == each])]
        for each in found
    }


def _kinds(outcomes: Cases) -> list[str]:
    return sorted({o.kind for o in outcomes})


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
        "labels": list(outcome.labels),
    }
