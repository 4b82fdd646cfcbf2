"""A reproduced study: the paper's claims with our figures, tables and pictures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from eval.outcome import Outcome
from eval.report.page import RunHeader, render
from eval.report.style import Picture
from eval.report.tables import NOTHING, Cell, Table, number
from eval.report.view import LogView
from narxcal.support.files import finite


@dataclass(frozen=True, kw_only=True)
class Claim:
    """One claim and what we found; `origin` is who makes it: the paper, or our own goal.

    `value` in `unit` has to be below `bound`, or not below it where `below` is False. `met` is None
    where there was nothing to measure. `remark` explains above all where ours is the worse figure.
    """

    what: str
    claimed: str
    value: float
    bound: float
    unit: str = ""
    below: bool = True
    origin: str = "paper"
    remark: str = ""

    @property
    def met(self) -> bool | None:
        """Whether the value is on the good side of the bound."""
        if not math.isfinite(self.value):
            return None
        return self.value < self.bound if self.below else self.value >= self.bound

    @property
    def ours(self) -> str:
        """The value in words."""
        whole = math.isfinite(self.value) and float(self.value).is_integer()
        text = f"{self.value:.0f}" if whole else number(self.value)
        return f"{text} {self.unit}" if self.unit and text != NOTHING else text

    def row(self) -> dict[str, Any]:
        """One entry of `claims`; None where nothing was measured."""
        row: dict[str, Any] = finite(
            {
                "what": self.what,
                "origin": self.origin,
                "claimed": self.claimed,
                "ours": self.value,
                "unit": self.unit,
                "bound": self.bound,
                "met": self.met,
                "remark": self.remark,
            }
        )
        return row


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
        """One entry of `studies`."""
        return {
            "study": self.key,
            "title": self.title,
            "source": self.source,
            "claims": [claim.row() for claim in self.claims],
            **self.results,
        }


def or_nan(value: float | None) -> float:
    """None, a figure that does not exist, as NaN."""
    return math.nan if value is None else float(value)


def claim_table(claims: Sequence[Claim], caption: str = "") -> Table:
    """Each claim with our figure and, where ours falls short, a mark."""
    remarks = any(claim.remark for claim in claims)
    head = ("claim", "made by", "claimed", "ours", "outcome", *(("remark",) if remarks else ()))
    rows = tuple(
        (
            Cell(claim.what, "head"),
            Cell(claim.origin),
            Cell(claim.claimed),
            Cell(claim.ours, number=True),
            _outcome(claim),
            *((Cell(claim.remark),) if remarks else ()),
        )
        for claim in claims
    )
    return Table(caption, head, rows)


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
    reached = sum(claim.met is True for claim in judged)
    missed = [
        f"{claim.what}: {claim.ours}, not {claim.claimed}." for claim in judged if not claim.met
    ]
    headline = f"{reached} of {len(judged)} claims are reached"
    passed = not missed if judged else None
    return Outcome(passed, headline, (*counts(judged), *missed))


def counts(judged: Sequence[Claim]) -> list[str]:
    """Say how many claims of the paper, and how many goals of our own, are reached."""
    lines = []
    for origin in dict.fromkeys(claim.origin for claim in judged):
        own = [claim.met is True for claim in judged if claim.origin == origin]
        whose = "the paper's claims" if origin == "paper" else "our own goals"
        lines.append(f"{sum(own)} of {len(own)} of {whose} are reached.")
    return lines
