"""Whose place the rivals of a claim would take: of two effects that are claimed, mostly one's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from eval.gap.claimed import is_offset

Models = Sequence[Sequence[str]]  # names of the effects of each model, best first


def places(claimed: Sequence[str], rivals: Sequence[str], models: Models) -> dict[str, list[str]]:
    """Rivals by the claimed effects that they would take the place of, several joined by `and`.

    A rival takes the place of the one that its model of as many effects leaves out. Offsets and
    what moves are judged apart: where there is no such model, it takes that of its own kind.
    """
    found: dict[str, list[str]] = {}
    for rival in rivals:
        found.setdefault(" and ".join(_place(claimed, rival, models)), []).append(rival)
    return found


def places_in(document: Mapping[str, Any]) -> dict[str, list[str]]:
    """The same from a document of schema narxcal.gap/1."""
    verdict = document["verdict"]
    models = [row["effects"] for row in document.get("tried", ())]
    return places(verdict["effects"], verdict["ambiguous_with"], models)


def contested(claimed: Sequence[str], rivals: Sequence[str], models: Models) -> list[str]:
    """The claimed effects that rivals would take the place of, in the order of the claim."""
    lost = {name for rival in rivals for name in _place(claimed, rival, models)}
    return [name for name in claimed if name in lost]


def _place(claimed: Sequence[str], rival: str, models: Models) -> list[str]:
    for model in models:
        if rival in model and len(model) == len(claimed):
            out = [name for name in claimed if name not in model]
            if len(out) == 1:
                return out
    own = [name for name in claimed if is_offset(name) == is_offset(rival)]
    return own or list(claimed)
