"""The answers to a blind test scored with its key: measures, their tables, one small HTML page."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.stats import binomtest

from eval.diagnosis.applied import read_document
from eval.diagnosis.blind.files import ANOTHER, open_key
from eval.diagnosis.blind.outcome import Outcome
from eval.diagnosis.blind.run import ANSWERS, read_answer
from eval.diagnosis.blind.run import SCHEMA as ANSWERS_SCHEMA
from eval.report import page
from eval.report import tables as tables_of_pages
from eval.report.page import RunHeader
from eval.report.style import NOTHING
from narxcal.support.errors import ConfigError, DataError

SCHEMA: Final = "narxcal.blind_score/2"
_BINS: Final = 5
Cases = Sequence[Outcome]


class CaseSet(NamedTuple):
    """A folder of cases that `blind make` wrote, and the folder of answers to them."""

    folder: Path
    answers: Path


class Rate(NamedTuple):
    """A share `hits / of` with its 95 % interval by Wilson; NaN of nothing."""

    hits: int
    of: int
    value: float
    low: float
    high: float


class Measure(NamedTuple):
    """One line of the table: its group, what it is, and its value.

    `value` is a share with its interval, or a number in `unit`.
    """

    group: str
    name: str
    value: Rate | float
    unit: str = ""

    def row(self) -> dict[str, Any]:
        found = self.value._asdict() if isinstance(self.value, Rate) else {"value": self.value}
        return {"group": self.group, "name": self.name, "unit": self.unit, **found}


def score_answers(sets: Sequence[CaseSet], secrets: Sequence[str]) -> dict[str, Any]:
    """Open the keys of all sets and score the answers together; returns the document.

    Each key opens by whichever of the `secrets` fits. Of several sets the cases are named
    `folder/case`. Raises `DataError` for a case without an answer, `ConfigError` for a folder that
    is given twice, and as `open_key`.
    """
    plans, outcomes = {}, []
    for name, each in zip(_names(sets), sets, strict=True):
        read_document(each.answers / ANSWERS, ANSWERS_SCHEMA, DataError, ANOTHER)
        key = open_key(each.folder, *secrets)
        plans[name] = dict(key["plan"])
        outcomes += _outcomes(key, each.answers, f"{name}/" if len(sets) > 1 else "")
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


def _outcomes(key: Mapping[str, Any], answers: Path, lead: str) -> list[Outcome]:
    outcomes = []
    for name, truth in key["cases"].items():
        answer = read_answer(answers, name)
        if answer is None:
            raise DataError(
                "the case has no answer yet",
                file=answers / name,
                hint="Go on with `narxcal blind run`, then score",
            )
        outcomes.append(Outcome(lead + name, truth, answer))
    return outcomes


def scored(outcomes: Cases, plans: Mapping[str, Any]) -> dict[str, Any]:
    """Put all that is measured over outcomes into a document of schema narxcal.blind_score/2.

    `plans` are those that the cases were made by, by the name of their folder.
    """
    return {
        "schema": SCHEMA,
        "plans": dict(plans),
        "cases": {kind: len(every) for kind, every in _by(outcomes, lambda o: o.kind).items()},
        "table": [each.row() for each in table(outcomes)],
        **{
            name: {g: [each.row() for each in table(o)] for g, o in _by(outcomes, of).items()}
            for name, of in (
                ("by_family", lambda o: o.family),
                ("by_folder", lambda o: o.name.rpartition("/")[0]),
            )
        },
        "confusion": confusion(outcomes),
        "outcomes": [_outcome(each) for each in outcomes],
    }


def table(outcomes: Cases) -> list[Measure]:
    """Every measure; those on effects over cases in which an effect has to be named."""
    above = [o for o in outcomes if o.nameable and not o.altered]
    singles = [o for o in above if o.kind == "single"]
    pairs = [o for o in above if o.kind == "pair"]
    nulls = [o for o in outcomes if o.kind == "null" and not o.altered]
    strange = [o for o in outcomes if o.kind == "outside"]
    claims = [o for o in outcomes if o.claims and not o.altered]
    channels = [o.channel_right for o in above if o.channel_right is not None]
    seconds = [o.seconds for o in outcomes if o.seconds is not None]
    sure = ([o.sureness for o in claims], [o.said in o.true_effects for o in claims])
    return [
        Measure("detection", "nulls claimed", rate(o.claims for o in nulls)),
        Measure("detection", "firm claims out of library", rate(o.firm for o in strange)),
        Measure("attribution", "top-1, ranked first", rate(o.found for o in above)),
        Measure("attribution", "top-1, as answered", rate(o.said in o.true_effects for o in above)),
        Measure("attribution", "exact verdict of singles", rate(o.exact for o in singles)),
        Measure("attribution", "claims right", rate(sure[1])),
        Measure(
            "attribution",
            "true effects in the named set",
            rate({*o.true_effects} <= {*o.named_set} for o in above if o.claims),
        ),
        Measure("attribution", "size of the set, mean", mean(len(o.named_set) for o in claims)),
        Measure("attribution", "calibration error (ECE)", calibration_error(*sure)),
        Measure("pairs", "exact pair", rate(o.exact for o in pairs)),
        Measure("pairs", "both found", rate({*o.true_effects} <= {*o.claimed} for o in pairs)),
        Measure("where", "channel of most energy", rate(channels)),
        *_of_budgets(outcomes),
        *_of_altered([o for o in outcomes if o.altered]),
        Measure("cost", "cases without an answer", rate(o.failed for o in outcomes)),
        Measure("cost", "median time per case", _median(seconds), "s"),
        Measure("cost", "longest time", max(seconds, default=math.nan), "s"),
    ]


def _of_budgets(outcomes: Cases) -> list[Measure]:
    effects = [abs(e) for o in outcomes for n, e in o.share_errors.items() if n in o.true_effects]
    every = [abs(e) for o in outcomes for e in o.share_errors.values()]
    shrunk = [o.shrinkage for o in outcomes]
    sizes = [each for o in outcomes for each in o.magnitudes]
    return [
        Measure("budget", "error of shares of true effects, mean", 100.0 * mean(effects), "points"),
        Measure("budget", "error of all shares, mean", 100.0 * mean(every), "points"),
        Measure(
            "budget",
            "predicted less realised shrinkage, mean",
            mean(abs(each[0] - each[1]) for each in shrunk if each is not None),
        ),
        Measure("budget", "true size within its interval", rate(s.inside for s in sizes)),
        Measure(
            "budget",
            "relative error of the size, median",
            _median([abs(s.value / s.true - 1.0) for s in sizes]),
        ),
    ]


def _of_altered(altered: Cases) -> list[Measure]:
    """Recorded flights: named with its size, and what else is named."""
    put_in = [o for o in altered if o.in_library]
    rows = [
        (o.truth["times_nameable"], name, o.claimed, [m for m in o.magnitudes if m.effect == name])
        for o in put_in
        for name in o.true_effects
    ]
    found = []
    for times in sorted({row[0] for row in rows}, reverse=True):
        own = [row for row in rows if row[0] == times]
        sized = [all(m.inside for m in row[3]) and row[1] in row[2] for row in own]
        found += [
            Measure("altered", f"named, {times:g} x nameable", rate(r[1] in r[2] for r in own)),
            Measure("altered", f"named with its size, {times:g} x nameable", rate(sized)),
        ]
    return [
        *found,
        Measure("altered", "other claims per altered flight", mean(o.others for o in put_in)),
        Measure("altered", "unaltered claimed", rate(o.claims for o in altered if o not in put_in)),
    ]


def confusion(outcomes: Cases) -> dict[str, dict[str, int]]:
    """True label -> label of the answer -> count; pairs count by the effect that was named."""
    return {
        true: {said: len(each) for said, each in _by(rows, lambda o: o.said).items()}
        for true, rows in sorted(_by(outcomes, lambda o: o.true_label).items())
    }


def rate(hits: Iterable[bool]) -> Rate:
    """Share of hits with its interval (E. B. Wilson, J. Am. Stat. Assoc. 22, 1927, 209)."""
    every = [bool(hit) for hit in hits]
    n, k = len(every), sum(every)
    if n == 0:
        return Rate(0, 0, math.nan, math.nan, math.nan)
    low, high = binomtest(k, n).proportion_ci(0.95, method="wilson")
    return Rate(k, n, k / n, float(low), float(high))


def calibration_error(probabilities: Any, hits: Any) -> float:
    """Expected calibration error: |share of hits - mean probability| over five bins of equal mass.

    Bins of equal mass have less bias than bins of equal width where probabilities crowd near 1
    (K. Nguyen, B. O'Connor, EMNLP 2015). NaN of nothing.
    """
    p, hit = np.asarray(probabilities, np.float64), np.asarray(hits, np.float64)
    if len(p) == 0:
        return math.nan
    off = np.array_split((hit - p)[np.argsort(p, kind="stable")], _BINS)
    return float(sum(abs(each.sum()) for each in off if len(each)) / len(p))


def mean(values: Iterable[float]) -> float:
    every = list(values)
    return float(np.mean(every)) if every else math.nan


def _median(values: Sequence[float]) -> float:
    return float(np.median(values)) if values else math.nan


def _by(items: Iterable[Any], group: Callable[[Any], Any]) -> dict[Any, list[Any]]:
    found: dict[Any, list[Any]] = {}
    for item in items:
        found.setdefault(group(item), []).append(item)
    return found


def _outcome(outcome: Outcome) -> dict[str, Any]:
    strange = outcome.truth["outside"]
    said = outcome.shrinkage or (None, None)
    share = outcome.gap_share
    return {
        "case": outcome.name,
        "kind": outcome.kind,
        "style": outcome.truth["style"],
        "engine": outcome.truth["engine"],
        "gap_share": share if math.isfinite(share) else None,
        "true": list(outcome.true_effects) or ([strange["id"]] if strange else []),
        "verdict": outcome.verdict,
        "claimed": list(outcome.claimed),
        "ambiguous_with": list(outcome.named_set[len(outcome.claimed) :]),
        "ranked": list(outcome.ranked[:3]),
        "reason": outcome.answer.get("reason") or outcome.answer["verdict"].get("reason", ""),
        "predicted": said[0],
        "realised": said[1],
        "shares": outcome.share_errors,
        "sizes": [{**size._asdict(), "inside": size.inside} for size in outcome.magnitudes],
        "seconds": outcome.seconds,
    }


Table = tuple[str, Sequence[str], Sequence[Sequence[str]]]
_COLUMNS: Final = 4  # of shares in a row after their names, in 80 columns of a terminal
_WIDE: Final = 10  # of them on the page


def tables(document: Mapping[str, Any], columns: int = _COLUMNS) -> list[Table]:
    """Tables of the score: by folder, or by family where there is but one.

    At most `columns` folders stand side by side, by default as many as a terminal shows.
    """
    split = _split(document, "folder", columns) or _split(document, "family", columns)
    return [_main(document), *split, _confused(document)]


def render(document: Mapping[str, Any]) -> str:
    """The score as an HTML page that needs nothing else."""
    families = _split(document, "family", _WIDE) if len(document["by_folder"]) > 1 else []
    every = (*tables(document, _WIDE), *families, _sizes(document), _case_by_case(document))
    counts = ", ".join(f"{count} {kind}" for kind, count in document["cases"].items())
    return page.render(
        "score.html.j2",
        header=RunHeader(title="Blind test of the gap diagnosis", created="", versions={}),
        words=f"{counts} cases. Intervals are 95 %, Wilson's.",
        parts=[{"caption": each[0], "table": _cells(each)} for each in every if each[2]],
    )


def shown(row: Mapping[str, Any]) -> str:
    """A share with its interval, or a number."""
    value = row.get("value")
    if value is None or not math.isfinite(value):
        return "-"
    if "low" not in row:
        return f"{value:.3g}"
    return f"{value:.2f} [{row['low']:.2f}, {row['high']:.2f}]"


def _main(document: Mapping[str, Any]) -> Table:
    rows = [
        [_named(row), shown(row), _counted(row) if "of" in row else ""] for row in document["table"]
    ]
    return "Blind test", ("", "all [95 %]", "n"), rows


def _split(document: Mapping[str, Any], fact: str, columns: int) -> list[Table]:
    by = document[f"by_{fact}"]
    if len(by) < 2:
        return []
    names = list(by)
    found: list[Table] = []
    for start in range(0, len(names), columns):
        some = names[start : start + columns]
        rows = {row["name"]: _named(row) for name in names for row in by[name]}
        cells = {n: {row["name"]: _counted(row) for row in by[n]} for n in some}
        lines = [[text, *(cells[n].get(row, "-") for n in some)] for row, text in rows.items()]
        found.append((f"By {fact}", ("", *some), lines))
    return found


def _confused(document: Mapping[str, Any]) -> Table:
    """What was said of each truth; only what is wrong is spelled out."""
    rows = []
    for true, said in document["confusion"].items():
        wrong = sorted(((n, k) for n, k in said.items() if n != true), key=lambda e: (-e[1], e[0]))
        words = ", ".join(f"{name} {count}" for name, count in wrong)
        rows.append([true, str(sum(said.values())), str(said.get(true, 0)), words or "-"])
    return "What was said of what", ("truth", "cases", "right", "said instead"), rows


def _case_by_case(document: Mapping[str, Any]) -> Table:
    rows = [
        [
            row["case"],
            row["kind"],
            "-" if row["gap_share"] is None else f"{100 * row['gap_share']:.0f} %",
            " + ".join(row["true"]) or "-",
            row["verdict"],
            " + ".join(row["claimed"]) or "-",
            ", ".join(row["ambiguous_with"]) or "-",
            f"{_plain(row['predicted'])} / {_plain(row['realised'])}",
        ]
        for row in document["outcomes"]
    ]
    head = ("case", "kind", "g", "truth", "verdict", "claimed", "or", "shrinkage")
    return "Case by case", head, rows


def _sizes(document: Mapping[str, Any]) -> Table:
    rows = [
        [
            row["case"],
            size["effect"],
            size["name"],
            f"{size['true']:.3g}",
            f"{size['value']:.3g} [{size['low']:.3g}, {size['high']:.3g}]",
            "yes" if size["inside"] else "no",
        ]
        for row in document["outcomes"]
        for size in row["sizes"]
    ]
    return "Sizes", ("case", "effect", "parameter", "true", "found [90 %]", "true one inside"), rows


def _named(row: Mapping[str, Any]) -> str:
    unit = row.get("unit", "")
    return f"{row['name']} [{unit}]" if unit else row["name"]


def _counted(row: Mapping[str, Any]) -> str:
    if "of" not in row:
        return _plain(row["value"])
    return f"{row['hits']} of {row['of']}" if row["of"] else "-"


def _plain(value: float | None) -> str:
    return "-" if value is None or not math.isfinite(value) else f"{value:.2f}"


def _cells(table: Table) -> tables_of_pages.Table:
    """A table as pages have it: numbers flush right, the first column a head."""
    _, head, rows = table
    flush = [all(t[:1] in "+-0123456789" for t in column) for column in zip(*rows, strict=True)]
    cells = tuple(
        (
            tables_of_pages.Cell(row[0], "head"),
            *(
                tables_of_pages.Cell(NOTHING if text == "-" else text, number=right)
                for text, right in zip(row[1:], flush[1:], strict=True)
            ),
        )
        for row in rows
    )
    return tables_of_pages.Table("", (head[0] or "measure", *head[1:]), cells)
