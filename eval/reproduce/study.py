"""A reproduced study: the paper's claims with our figures, tables and pictures."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from typing import Any

from eval.judging.outcome import Outcome
from eval.report.page import RunHeader, render
from eval.report.style import NOTHING, Picture, number
from eval.report.tables import Cell, Table, row
from eval.report.view import LogView
from narxcal.support.files import finite


@dataclass(frozen=True)
class Claim:
    """One claim and what we found; `origin` is who makes it: the paper, or our own goal.

    `limit` is what has to hold of `value`: `<`, `<=` or `>=`, the bound, a unit, as in `< 1.4 %`;
    left out where `claimed` says it in this form. `remark` explains above all where ours is the
    worse figure.
    """

    what: str
    claimed: str
    value: float
    limit: str = ""
    remark: str = ""
    origin: str = "paper"

    @property
    def bound(self) -> float:
        """What the value has to be below, or for `>=` not below; a bound of `<=` may be reached."""
        sign, bound, *_ = (self.limit or self.claimed).split()
        return math.nextafter(float(bound), math.inf) if sign == "<=" else float(bound)

    @property
    def unit(self) -> str:
        """Unit of value and bound, behind them in the limit."""
        return "".join((self.limit or self.claimed).split()[2:])

    @property
    def met(self) -> bool | None:
        """Whether the limit holds; None where there was nothing to measure."""
        if not math.isfinite(self.value):
            return None
        above = (self.limit or self.claimed).startswith(">=")
        return bool(self.value >= self.bound if above else self.value < self.bound)

    @property
    def ours(self) -> str:
        whole = math.isfinite(self.value) and float(self.value).is_integer()
        text = f"{self.value:.0f}" if whole else number(self.value)
        return f"{text} {self.unit}" if self.unit and text != NOTHING else text

    def row(self) -> dict[str, Any]:
        """One entry of `claims`; None where nothing was measured."""
        names = ("what", "origin", "claimed", "unit", "bound", "met", "remark")
        row: dict[str, Any] = finite(
            {n: getattr(self, n) for n in names} | {"ours": float(self.value)}
        )
        return row


CLAIMS = tomllib.loads(files(__package__).joinpath("claims.toml").read_text("utf-8"))


def claim(paper: str, key: str, value: float, **fills: object) -> Claim:
    """Row of `claims.toml` with our value; `fills` stand for the braces of its texts."""
    what, claimed, *rest = (text.format(**fills) for text in CLAIMS[paper][key])
    return Claim(what, claimed, float(value), *rest)


@dataclass(frozen=True, kw_only=True, eq=False)
class Study:
    """One study of a paper: `source` is where the paper has it, `text` how ours was done.

    `results` is what `reproduce.json` holds of it in addition to the claims; `sheets` are logs of
    which every event is drawn.
    """

    key: str
    title: str
    source: str
    text: str
    claims: Sequence[Claim] = ()
    tables: Sequence[Table] = ()
    pictures: Sequence[Picture] = ()
    sheets: Sequence[LogView] = ()
    results: Mapping[str, Any] = field(default_factory=dict)

    def row(self) -> dict[str, Any]:
        return {
            "study": self.key,
            "title": self.title,
            "source": self.source,
            "claims": [claim.row() for claim in self.claims],
            **self.results,
        }


def missed(studies: Sequence[Study]) -> list[str]:
    """Claims that do not hold here, with our figure."""
    return [
        f"{claim.what}: {claim.ours}, not {claim.claimed}."
        for study in studies
        for claim in study.claims
        if claim.met is False
    ]


def or_nan(value: float | None) -> float:
    """None, a figure that does not exist, as NaN."""
    return math.nan if value is None else float(value)


def table_of(caption: str, head: Sequence[str], rows: Iterable[Sequence[Any]]) -> Table:
    """Rows of texts, counts, figures or cells as they are; the first value of a row is its head."""
    return Table(caption, tuple(head), tuple(row(str(first), *rest) for first, *rest in rows))


def claim_table(claims: Sequence[Claim]) -> Table:
    """Each claim with our figure beside it and, where ours falls short, a mark."""
    head = ["claim", "made by", "claimed", "ours", "outcome"]
    head += ["remark"] if any(claim.remark for claim in claims) else []
    rows = [
        (claim.what, claim.origin, claim.claimed, Cell(claim.ours, number=True), _outcome(claim),
         claim.remark)[: len(head)]
        for claim in claims
    ]  # fmt: skip
    return table_of("", head, rows)


def _outcome(claim: Claim) -> Cell:
    if claim.met is None:
        return Cell("not measured", "none")
    return Cell("✓ reached", "good") if claim.met else Cell("✗ not reached", "bad")


def reproduction_page(header: RunHeader, studies: Sequence[Study]) -> str:
    """Build the page; it passes where no claim was missed."""
    return render(
        "reproduce.html.j2",
        header=header,
        outcome=outcome_of(studies),
        studies=studies,
        claim_table=claim_table,
    )


def outcome_of(studies: Sequence[Study]) -> Outcome:
    """Count the claims reached, and name those that are not."""
    judged = [claim for study in studies for claim in study.claims if claim.met is not None]
    lines = missed(studies)
    headline = f"{len(judged) - len(lines)} of {len(judged)} claims are reached"
    return Outcome(not lines if judged else None, headline, (*counts(judged), *lines))


def counts(judged: Sequence[Claim]) -> list[str]:
    """Say how many claims of the paper, and how many goals of our own, are reached."""
    lines = []
    for origin in dict.fromkeys(claim.origin for claim in judged):
        own = [claim.met is True for claim in judged if claim.origin == origin]
        whose = "the paper's claims" if origin == "paper" else "our own goals"
        lines.append(f"{sum(own)} of {len(own)} of {whose} are reached.")
    return lines
