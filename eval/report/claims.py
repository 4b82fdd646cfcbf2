"""What a reproduced study puts on its page: the paper's claims beside ours, tables, figures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from eval.report.content import LogPage
from eval.report.svg import Picture
from eval.report.tables import NOTHING, Cell, Table, number


@dataclass(frozen=True, kw_only=True)
class Claim:
    """One claim and what we found; `origin` says who makes it: the paper, or our own goal.

    `value` in `unit` is held against `bound`: `below` says on which side it has to be. `met` is
    None where there was nothing to measure. `remark` is for the reader, above all where ours is
    the worse figure.
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
        """JSON-able values; None where nothing was measured."""
        return {
            "what": self.what,
            "origin": self.origin,
            "claimed": self.claimed,
            "ours": self.value if math.isfinite(self.value) else None,
            "unit": self.unit,
            "bound": self.bound,
            "met": self.met,
            "remark": self.remark,
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class Study:
    """One study of a paper: `source` is where the paper has it, `text` how ours was done.

    `results` is what `reproduce.json` holds of it, beside the claims; `sheets` are logs of
    which every event is drawn.
    """

    key: str
    title: str
    source: str
    text: str
    claims: Sequence[Claim] = ()
    tables: Sequence[Table] = ()
    pictures: Sequence[Picture] = ()
    sheets: Sequence[LogPage] = ()
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
    """Turn what a table leaves out into what a claim leaves open."""
    return math.nan if value is None else float(value)


def claim_table(claims: Sequence[Claim], caption: str = "") -> Table:
    """Each claim with our figure beside it and, where ours falls short, a mark."""
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
