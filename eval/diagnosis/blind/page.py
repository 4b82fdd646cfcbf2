"""The score of a blind test in tables: for the terminal, and as one small HTML page."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any, Final

from eval.report import page
from eval.report import tables as tables_of_pages
from eval.report.page import RunHeader
from eval.report.style import NOTHING

Table = tuple[str, Sequence[str], Sequence[Sequence[str]]]
_COLUMNS: Final = 4  # of shares side by side, beside their names, in 80 columns of a terminal
_WIDE: Final = 10  # of them on the page
_NUMBER: Final = re.compile(r"[-+]?[\d.]+( ?%| s)?( ?[\[/] ?[-\d., ]+\]?)?( of \d+)?|-|")


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
        return f"{value:.3g} {row.get('unit', '')}".rstrip()
    return f"{value:.2f} [{row['low']:.2f}, {row['high']:.2f}]"


def _main(document: Mapping[str, Any]) -> Table:
    rows = [
        [_named(row), shown({**row, "unit": ""}), _counted(row) if "of" in row else ""]
        for row in document["table"]
    ]
    return "Blind test", ("", "all [95 %]", "n"), rows


def _split(document: Mapping[str, Any], fact: str, columns: int) -> list[Table]:
    """Every measure by folder or family where there are several."""
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
    """What was found of sizes of effects that were rightly named, and what was put in."""
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
    """A share as a count, a number as it is."""
    if "of" not in row:
        return _plain(row["value"])
    return f"{row['hits']} of {row['of']}" if row["of"] else "-"


def _plain(value: float | None) -> str:
    return "-" if value is None or not math.isfinite(value) else f"{value:.2f}"


def _cells(table: Table) -> tables_of_pages.Table:
    """A table as pages have it: numbers flush right, the first column a head."""
    _, head, rows = table
    flush = [all(map(_is_number, column)) for column in zip(*rows, strict=True)]
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


def _is_number(text: str) -> bool:
    return not text or _NUMBER.fullmatch(text) is not None
