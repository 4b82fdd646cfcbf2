"""A diagnosis in words and small tables, from its document alone."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from eval.gap.effect_words import in_words, listed, spread_words, surest_words
from eval.gap.rivals import places_in
from eval.report.tables import number

_NONE, _REAL = "no gap beyond noise and build scatter", "the gap is real, but "
EMULATOR = "emulator"  # folder beside gap.json
_MOST_EFFECTS, _MOST_BINS = 5, 6
Table = tuple[str, Sequence[str], Sequence[Sequence[str]]]


def sentence(document: Mapping[str, Any]) -> str:
    """The verdict in one sentence: what it is, and how far the gap shrinks."""
    verdict = document["verdict"]
    kind, claimed = verdict["kind"], verdict["effects"]
    if kind == "none":
        return f"{_NONE[0].upper()}{_NONE[1:]}." + _because(verdict)
    if kind == "unknown":
        why = verdict["reason"].rstrip(".").removeprefix(_REAL)
        words = f"{_REAL[0].upper()}{_REAL[1:]}no effect of the library accounts for it"
        return _spaced(f"{words}: {why}." if why else f"{words}.")
    words = f"What differs: {listed([in_words(name) for name in claimed])}"
    added = "it" if len(claimed) == 1 else "them"
    if kind == "ambiguous":
        words += _just_as_well(document)
        added = "the first" if len(claimed) == 1 else f"the first {len(claimed)}"
    taken = f"adding {added} to the simulator takes away {_taken(document['shrink'])}"
    return f"{words}; {taken}."


def _just_as_well(document: Mapping[str, Any]) -> str:
    """The rivals, and of two claimed effects whose place they would take."""
    claimed, told = document["verdict"]["effects"], ""
    for place, rivals in places_in(document).items():
        names = listed([in_words(name) for name in rivals], "or")
        if len(claimed) == 1:
            told += f", or just as well {names}"
        else:
            told += f"; in the place of {place} just as well {names}"
    return told


def _taken(shrink: Mapping[str, Any]) -> str:
    """How far the gap shrinks: predicted with its interval, and what came true."""
    value, low, high = (100.0 * shrink["predicted"][key] for key in ("value", "low", "high"))
    words = f"{value:.0f} % of the gap (90 % interval {low:.0f} to {high:.0f} %"
    if shrink.get("realised") is not None:
        words += f"; {100 * shrink['realised']:.0f} % on held-out flights"
    return words + ")"


def to_tell(document: Mapping[str, Any]) -> str:
    """What to fly where effects cannot be told apart; empty where they can."""
    verdict = document["verdict"]
    if verdict["kind"] != "ambiguous" or not verdict["separating_manoeuvre"]:
        return ""
    return f"To tell them apart, fly: {verdict['separating_manoeuvre']}."


def no_load(document: Mapping[str, Any]) -> str:
    """Why windows of the gap are no unlogged load, where nothing else is found; else empty."""
    reason = document["quality"].get("unlogged_load", "")
    told = document["verdict"]["kind"] == "unknown" and reason not in ("", "found")
    return f"No unlogged load: {reason}." if told else ""


def effect_name(row: Mapping[str, Any]) -> str:
    """`id`, or `id:channel`."""
    return row["id"] if row.get("channel") is None else f"{row['id']}:{row['channel']}"


def effect_table(document: Mapping[str, Any]) -> Table:
    """Ranked effects: probability, gain on flights that had no part in the fit, parameters."""
    claimed = document["verdict"]["effects"]
    shown = document["effects"] if document["verdict"]["kind"] != "none" else []
    rows = [
        [
            effect_name(row) + (" *" if effect_name(row) in claimed else ""),
            f"{100 * row['probability']:.0f} %",
            f"{100 * row['gain']['value']:.0f} %",
            surest_words(row),
        ]
        for row in shown[:_MOST_EFFECTS]
    ]
    return "Effects (* claimed)", ("effect", "probability", "gain", "parameters"), rows


def windows_named(document: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Windows of an unlogged load that is claimed, cannot be ruled out, or is the best guess."""
    verdict = document["verdict"]
    wanted = {*verdict["effects"], *verdict["ambiguous_with"]}
    if verdict["kind"] == "unknown":
        wanted = {effect_name(row) for row in document["effects"][:1]}
    rows = [row for row in document["effects"] if effect_name(row) in wanted]
    return [spell for row in rows for spell in row.get("windows", ())]


def window_table(document: Mapping[str, Any]) -> Table:
    """When an unlogged load was on, and what it shifted there."""
    found = windows_named(document)
    names = list(found[0]["shift"]) if found else []
    rows = [
        [
            spell["log"] + (" *" if spell["held_out"] else ""),
            *(
                _narrow(seconds_within(spell[f"{end}_s"], spell[f"{end}_span_s"]))
                for end in ("start", "end")
            ),
            *(_narrow(spread_words(spell["shift"][name])) for name in names),
        ]
        for spell in found
    ]
    told = " (* held out)" if any(spell["held_out"] for spell in found) else ""
    return f"When the load was on{told}", ("log", "from [s]", "to [s]", *names), rows


def _narrow(text: str) -> str:
    """Without blanks about its sign: a log, two times and four channels fit into 80 columns."""
    return text.replace(" ± ", "±")


def seconds_within(value: float, span: Sequence[float]) -> str:
    """A time with the half of its interval, as `97.2 ± 0.1`."""
    return f"{value:.1f} ± {max(0.5 * (span[1] - span[0]), 0.05):.1f}"


def where_table(document: Mapping[str, Any]) -> Table:
    """Largest bins of the gap's energy."""
    rows = [
        [
            f"{row['channel']} {row['direction']}"
            + (f" {row['phase']}" if row["phase"] != row["direction"] else ""),
            _percent({**row, "value": row["share"]}),
            " ".join(f"{key} {level}" for key, level in row["regime"].items() if level != "all"),
        ]
        for row in document["where"][:_MOST_BINS]
        if row["share"] > 0.0
    ]
    return "Where the gap is", ("bin", "share [90 %]", "mostly at"), rows


def shrink_table(document: Mapping[str, Any]) -> Table:
    """Root mean squares of the gap before and after, and errors of Ti and Tt.

    Without a claim nothing is added to the simulator, so that there is no after.
    """
    shrink, claims = document["shrink"], bool(document["verdict"]["effects"])
    times = shrink.get("times", {})
    keys = ("before", "after", "floor") if claims else ("before", "floor")
    rows = [
        [
            name,
            *(number(found[key]) for key in keys),
            *(_times(times.get(name, {}), each, claims=claims) for each in ("Ti", "Tt")),
        ]
        for name, found in shrink["channels"].items()
    ]
    if claims:
        head = ("RMSE of", *keys, "Ti error [s]", "Tt error [s]")
        return f"How far it shrinks, on {shrink['on']}", head, rows
    head = ("channel", "RMSE", "floor", "Ti error [s]", "Tt error [s]")
    return f"How large the gap is, on {shrink['on']}", head, rows


def _times(found: Mapping[str, Any], name: str, *, claims: bool) -> str:
    before = number(found.get(f"{name}_before_s"))
    return f"{before} -> {number(found.get(f'{name}_after_s'))}" if claims else before


def _percent(found: Mapping[str, float]) -> str:
    value, low, high = (100.0 * found[key] for key in ("value", "low", "high"))
    return f"{value:.0f} % [{low:.0f}, {high:.0f}]"


def _because(verdict: Mapping[str, Any]) -> str:
    reason = verdict["reason"].rstrip(".")
    if not reason or reason == _NONE:
        return ""
    return _spaced(f" {reason[0].upper()}{reason[1:]}.")


def _spaced(text: str) -> str:
    """Percentages with a space before their sign."""
    return re.sub(r"(?<=\d)%", " %", text)
