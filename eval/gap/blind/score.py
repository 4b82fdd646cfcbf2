"""Scores the answers to a blind test with its key: the table of GAP section 2, and by gap share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from eval.gap.blind.files import open_key, read_json
from eval.gap.blind.measures import Cases, detected, shrinkage_error, table
from eval.gap.blind.metrics import mean, overlap, rate
from eval.gap.blind.outcome import Outcome
from eval.gap.blind.run import ANSWERS, read_answer, read_reruns
from eval.gap.blind.run import SCHEMA as ANSWERS_SCHEMA
from narxcal.support.errors import ConfigError, DataError

SCHEMA: Final = "narxcal.blind_score/1"
EDGES: Final = (0.02, 0.05, 0.10, 0.25)
GROUPS: Final = ("below 2 %", "2-5 %", "5-10 %", "10-25 %", "above 25 %")


class CaseSet(NamedTuple):
    """A folder of cases that `blind make` wrote, and the folder of the answers to them."""

    folder: Path
    answers: Path


def score_answers(sets: Sequence[CaseSet], secrets: Sequence[str]) -> dict[str, Any]:
    """Open the keys of all sets and score the answers together; returns the document.

    Each key opens by whichever of the `secrets` fits. Of several sets the cases are named
    `folder/case`. Raises `DataError` for a case without an answer, `ConfigError` for a folder
    that is given twice, and as `open_key`.
    """
    names = _names(sets)
    plans, outcomes = {}, []
    for name, each in zip(names, sets, strict=True):
        found, plans[name] = _opened(each, secrets)
        lead = f"{name}/" if len(sets) > 1 else ""
        outcomes += [outcome._replace(name=lead + outcome.name) for outcome in found]
    return scored(outcomes, plans)


def _names(sets: Sequence[CaseSet]) -> list[str]:
    """Names of the folders, or their paths where two have the same name."""
    paths = [each.folder.resolve() for each in sets]
    for number, path in enumerate(paths):
        if path in paths[:number]:
            raise ConfigError(
                "these cases are given twice", file=sets[number].folder, hint="Give each once"
            )
    short = [path.name for path in paths]
    return short if len({*short}) == len(sets) else [str(each.folder) for each in sets]


def _opened(cases: CaseSet, secrets: Sequence[str]) -> tuple[list[Outcome], dict[str, Any]]:
    """All cases of a folder with their answers, and the plan that they were made by."""
    folder, answers = cases
    read_json(answers / ANSWERS, ANSWERS_SCHEMA)
    key = open_key(folder, *secrets)
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


def scored(outcomes: Cases, plans: Mapping[str, Any]) -> dict[str, Any]:
    """Put all that is measured over outcomes into a document of schema narxcal.blind_score/1.

    `plans` are those that the cases were made by, by the name of their folder.
    """
    groups = {
        "by_style": [str(o.truth["style"]) for o in outcomes],
        "by_engine": [str(o.truth["engine"]) for o in outcomes],
        "by_folder": [o.name.rpartition("/")[0] for o in outcomes],
    }
    return {
        "schema": SCHEMA,
        "plans": dict(plans),
        "cases": {kind: sum(o.kind == kind for o in outcomes) for kind in _kinds(outcomes)},
        "wrong_base": sum(bool(o.truth["base"]["differs"]) for o in outcomes),
        "table": [each.row() for each in table(outcomes)],
        **{name: _by(outcomes, group) for name, group in groups.items()},
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


def _by(outcomes: Cases, groups: Sequence[str]) -> dict[str, list[dict[str, Any]]]:
    """The whole table over the cases of each group, in the order in which they come up."""
    found: dict[str, list[Outcome]] = {}
    for outcome, group in zip(outcomes, groups, strict=True):
        found.setdefault(group, []).append(outcome)
    return {name: [each.row() for each in table(cases)] for name, cases in found.items()}


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
        "sizes": [each.row() for each in outcome.magnitudes],
        "seconds": outcome.seconds,
        "labels": list(outcome.labels),
    }
