"""The page of a reproduced paper: every claim in one table, then study by study."""

from __future__ import annotations

from collections.abc import Sequence

from eval.report.claims import Claim, Study, claim_table
from eval.report.content import RunHeader
from eval.report.page import Outcome, render


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
