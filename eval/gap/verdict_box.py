"""What the page says in words: the verdict, what speaks for it, and what flight to fly next."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from eval.gap.effect_words import in_words, listed, surest_words
from eval.gap.rivals import places_in
from eval.gap.summary import effect_name, sentence, to_tell
from narxcal.effects.library import effect

_WORDS = {
    "none": ("pass", "✓ NO GAP"),
    "effects": ("found", "● FOUND"),
    "ambiguous": ("found", "≈ NOT TOLD APART"),
    "unknown": ("none", "? I DON'T KNOW"),
}
_RIVALS, _FEW_EVENTS = 3, 10


@dataclass(frozen=True)
class VerdictBox:
    """`state` sets its look, `word` is the answer, `headline` the sentence, `lines` why."""

    state: str
    word: str
    headline: str
    lines: tuple[str, ...]


def verdict_box(document: Mapping[str, Any]) -> VerdictBox:
    """Verdict of a document of schema narxcal.gap/1."""
    kind = document["verdict"]["kind"]
    state, word = _WORDS[kind]
    lines = [*_claimed(document), *filter(None, (to_tell(document),)), *_measured(document)]
    if kind == "unknown":
        lines += _candidate(document)
    return VerdictBox(state, word, sentence(document), tuple(lines))


def _claimed(document: Mapping[str, Any]) -> list[str]:
    """Probability and sizes of what is claimed, one line each."""
    rows = {effect_name(row): row for row in document["effects"]}
    lines = []
    for name in document["verdict"]["effects"]:
        row = rows.get(name)
        if row is None:
            continue
        lines.append(f"{name}: probability {_percent(row['probability'])}; {surest_words(row)}.")
        bounds = [each.removeprefix(f"{name} ") for each in row.get("at_bound", ())]
        lines += [f"{name}: {each} is at the bound of its range." for each in bounds]
    return lines


def _measured(document: Mapping[str, Any]) -> list[str]:
    """How large the gap is, what is left of it, and how many models were tried."""
    quality, tried = document["quality"], document["tried"]
    lines = []
    share, left = _number(quality.get("gap_share")), _number(quality.get("left_share"))
    if share is not None and (share > 0.0 or tried):
        text = f"{_gap(share)} of the squared difference of recorded and simulated is gap"
        text += ", the rest is noise" if share < 0.995 else ""
        if document["verdict"]["effects"] and left is not None:
            text += f"; {_percent(max(left, 0.0))} of the gap stays unexplained"
            text += ", each flight's own small offsets taken out"
        lines.append(f"{text}.")
    if tried:
        lines.append(f"{len(tried)} models were tried.")
    return lines


def _gap(share: float) -> str:
    return "Nearly all" if share >= 0.995 else _percent(share)


def _candidate(document: Mapping[str, Any]) -> list[str]:
    if not document["effects"]:
        return []
    row = document["effects"][0]
    gain = _percent(_number(row["gain"]["value"]) or 0.0)
    name = in_words(effect_name(row))
    return [f"The best candidate, {name}, takes away {gain} of the gap and is not claimed."]


def tiles(document: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Figures to show large, each with what it is."""
    quality, shrink = document["quality"], document["shrink"]
    flights = quality.get("flights", ())
    minutes = (_number(quality.get("duration_s")) or 0.0) / 60.0
    found = [(str(len(flights)), f"flights, {minutes:.0f} minutes")] if flights else []
    found.append((_percent(_number(quality.get("gap_share"))), "of the squared difference is gap"))
    if document["verdict"]["effects"]:
        found.append(
            (_percent(_number(shrink["predicted"]["value"])), "of it taken away, predicted")
        )
        realised = _number(shrink.get("realised"))
        if realised is not None:
            found.append((_percent(realised), "realised on held-out flights"))
    found.append((str(len(document["tried"])), "models tried"))
    return found


def next_flights(document: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Manoeuvres worth flying next, each with what it would tell."""
    verdict, found = document["verdict"], []
    if verdict["separating_manoeuvre"] and verdict["effects"]:
        found.append((verdict["separating_manoeuvre"], _separates(document)))
    known = {text for text, _ in found}
    for name in _open_questions(document):
        manoeuvre = effect(name).manoeuvre
        if manoeuvre not in known:
            known.add(manoeuvre)
            found.append((manoeuvre, f"shows {name}, or rules it out"))
    if verdict["kind"] != "none":
        found += _missing(document["quality"])
    if verdict["effects"] and not document["quality"].get("held_out"):
        reason = "gives the shrinkage on flights that took no part (--heldout-real, --heldout-sim)"
        found.append(("two more flights of the same kind", reason))
    return found


def _separates(document: Mapping[str, Any]) -> str:
    """Which claimed effect the separating manoeuvre tells from which."""
    found = places_in(document) or {
        listed(document["verdict"]["effects"]): ["effects that look alike"]
    }
    return "; ".join(f"separates {place} from {listed(names)}" for place, names in found.items())


def _open_questions(document: Mapping[str, Any]) -> list[str]:
    """Rivals of the claimed effect, or the best candidates where nothing could be claimed."""
    verdict = document["verdict"]
    if verdict["kind"] == "ambiguous":
        return list(verdict["ambiguous_with"])[:_RIVALS]
    if verdict["kind"] == "unknown":
        return [effect_name(row) for row in document["effects"][:_RIVALS]]
    return []


def _missing(quality: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What the flights at hand have too little of."""
    found = []
    counts = {name: quality.get(name) for name in ("pushes", "pulls")}
    few = [f"{n} {name}" for name, n in counts.items() if n is not None and n < _FEW_EVENTS]
    if few:
        reason = f"there were only {' and '.join(few)}: every interval gets narrower"
        found.append(("idle to high power and back, ten times, settled in between", reason))
    return found


def _number(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


def _percent(share: float | None) -> str:
    if share is None:
        return "–"  # noqa: RUF001 - a dash for what does not exist
    if 0.0 < share < 0.0005:
        return "less than 0.1 %"
    return f"{100 * share:.1f} %" if 0.0 < share < 0.0995 else f"{100 * share:.0f} %"
