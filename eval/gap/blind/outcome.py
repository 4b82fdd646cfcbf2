"""One case with its answer: what was true, what was said, and what follows from both."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from eval.gap.blind.oracle import bin_name, channel_of_most, core
from narxcal.effects.library import LIBRARY

FLOOR: Final = 0.05  # share of the gap below which nobody has to find an effect
NONE, UNKNOWN, FAILED = "none", "unknown", "failed"


class Outcome(NamedTuple):
    """`truth` is the row of the key, `answer` a document of narxcal.gap/1, or why there is none."""

    name: str
    truth: Mapping[str, Any]
    answer: Mapping[str, Any]

    @property
    def kind(self) -> str:
        """What the case is: single, pair, null, outside."""
        return str(self.truth["kind"])

    @property
    def gap_share(self) -> float:
        """Share of the squared gap that the true content makes."""
        return float(self.truth["gap_share"])

    @property
    def in_library(self) -> bool:
        """Whether it holds effects that can be named."""
        return self.kind in ("single", "pair")

    @property
    def true_effects(self) -> tuple[str, ...]:
        """Names of the effects that it holds."""
        return tuple(_name(row) for row in self.truth["effects"])

    @property
    def failed(self) -> bool:
        """Whether there is no answer: refused, an error, or too late."""
        return "verdict" not in self.answer

    @property
    def verdict(self) -> str:
        """Kind of the verdict: none, effects, ambiguous, unknown; or failed."""
        return FAILED if self.failed else str(self.answer["verdict"]["kind"])

    @property
    def claims(self) -> bool:
        """Whether effects are named."""
        return self.verdict in ("effects", "ambiguous")

    @property
    def claimed(self) -> tuple[str, ...]:
        """Effects that are named; nothing where the verdict names none."""
        return tuple(self.answer["verdict"]["effects"]) if self.claims else ()

    @property
    def named_set(self) -> tuple[str, ...]:
        """Effects that are named, with those that they cannot be told from."""
        if not self.claims:
            return ()
        return (*self.claimed, *self.answer["verdict"]["ambiguous_with"])

    @property
    def ranked(self) -> tuple[str, ...]:
        """All effects in the order of the answer, whatever the verdict."""
        return tuple(_name(row) for row in self.answer.get("effects", ()))

    @property
    def probabilities(self) -> dict[str, float]:
        """Probability of each effect."""
        return {_name(row): float(row["probability"]) for row in self.answer.get("effects", ())}

    @property
    def said(self) -> str:
        """The answer as one label: the effect named first, none, unknown or failed."""
        return self.claimed[0] if self.claimed else self.verdict

    @property
    def true_label(self) -> str:
        """What the label should be; of two effects the one that was named, or else the first."""
        if not self.in_library:
            return NONE if self.kind == "null" else UNKNOWN
        return self.said if self.said in self.true_effects else self.true_effects[0]

    def first(self, count: int) -> bool:
        """Whether a true effect is among the first `count` of the ranking."""
        return any(name in self.true_effects for name in self.ranked[:count])

    @property
    def family_first(self) -> bool:
        """Whether the effect ranked first is of a true one's family."""
        families = {LIBRARY[name.partition(":")[0]].family for name in self.true_effects}
        return any(LIBRARY[n.partition(":")[0]].family in families for n in self.ranked[:1])

    @property
    def overlap_of(self) -> tuple[set[str], set[str]]:
        """Bins that hold 70 % of the energy: said, and true."""
        return core(self._said_shares()), core(self.truth["where"])

    @property
    def channel_right(self) -> bool:
        """Whether most energy is said to be in the channel that truly has most."""
        return channel_of_most(self._said_shares()) == channel_of_most(self.truth["where"])

    @property
    def shrinkage(self) -> tuple[Mapping[str, float], float] | None:
        """Predicted shrinkage with its interval, and the realised one; None without a claim."""
        shrink = self.answer.get("shrink", {})
        if not self.claims or shrink.get("realised") is None:
            return None
        return shrink["predicted"], float(shrink["realised"])

    @property
    def seconds(self) -> float | None:
        """What the answer took."""
        found = self.answer.get("seconds")
        return None if found is None else float(found)

    def _said_shares(self) -> dict[str, float]:
        return {
            bin_name(row["channel"], row["direction"], row["phase"]): float(row["share"])
            for row in self.answer.get("where", ())
            if row["share"] > 0.0
        }


def _name(row: Mapping[str, Any]) -> str:
    return row["id"] if row.get("channel") is None else f"{row['id']}:{row['channel']}"
