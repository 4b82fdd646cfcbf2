"""A diagnosis in words and small tables, from its document alone."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

_NONE = "no gap beyond noise and build scatter"
EMULATOR = "emulator"  # folder beside gap.json
_MOST_EFFECTS, _MOST_BINS = 5, 6
Table = tuple[str, Sequence[str], Sequence[Sequence[str]]]


def sentence(document: Mapping[str, Any]) -> str:
    """The verdict in one sentence."""
    verdict, shrink = document["verdict"], document["shrink"]
    kind, predicted = verdict["kind"], shrink["predicted"]
    if kind == "none":
        return f"{_NONE[0].upper()}{_NONE[1:]}." + _because(verdict)
    if kind == "unknown":
        why = verdict["reason"].rstrip(".")
        words = "The gap is real, but no effect of the library accounts for it"
        return f"{words}: {why}." if why else f"{words}."
    names = " and ".join(named(document, name) for name in verdict["effects"])
    words = f"{names}: takes away {_percent(predicted)} of the gap"
    if shrink.get("realised") is not None:
        words += f" (realised on held-out flights: {100 * shrink['realised']:.0f} %)"
    if kind == "ambiguous":
        words += f"; cannot be told from {', '.join(verdict['ambiguous_with'])}"
        words += f". To tell: {verdict['separating_manoeuvre']}"
    return words + "."


def named(document: Mapping[str, Any], name: str) -> str:
    """An effect with its parameters, as 'sensor_lag:EGT_C (tau_s 1.8 [1.6, 2.0] s)'."""
    for row in document["effects"]:
        if effect_name(row) == name:
            return f"{name} ({parameters(row)})" if row["parameters"] else name
    return name


def effect_name(row: Mapping[str, Any]) -> str:
    """`id`, or `id:channel`."""
    return row["id"] if row.get("channel") is None else f"{row['id']}:{row['channel']}"


def parameters(row: Mapping[str, Any], most: int = 3) -> str:
    """Parameters of an effect with their intervals and units; of many those that are surest."""
    found = row["parameters"]
    surest = sorted(found, key=lambda key: -_sureness(found[key]))[:most]
    words = [
        f"{key} {number(each['value'])} [{number(each['low'])}, {number(each['high'])}]"
        f" {each.get('unit', '')}".rstrip(" -")
        for key, each in found.items()
        if key in surest
    ]
    if len(found) > most:
        words.append(f"and {len(found) - most} more")
    return ", ".join(words)


def _sureness(found: Mapping[str, float | None]) -> float:
    """Size of a parameter in widths of its interval."""
    value, low, high = (found.get(key) or 0.0 for key in ("value", "low", "high"))
    return abs(value) / max(high - low, 1e-3 * abs(value), 1e-12)


def number(value: float | None) -> str:
    """Three digits, or a dash where there is none."""
    if value is None or not math.isfinite(value):
        return "-"
    return f"{value:.3g}"


def effect_table(document: Mapping[str, Any]) -> Table:
    """Ranked effects: probability, gain on flights that had no part in the fit, parameters."""
    claimed = document["verdict"]["effects"]
    shown = document["effects"] if document["verdict"]["kind"] != "none" else []
    rows = [
        [
            effect_name(row) + (" *" if effect_name(row) in claimed else ""),
            f"{100 * row['probability']:.0f} %",
            f"{100 * row['gain']['value']:.0f} %",
            parameters(row),
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
            spell["log"] + (" (held out)" if spell["held_out"] else ""),
            seconds_within(spell["start_s"], spell["start_span_s"]),
            seconds_within(spell["end_s"], spell["end_span_s"]),
            *(f"{spell['shift'][name]['value']:.2g}" for name in names),
        ]
        for spell in found
    ]
    return "When the load was on", ("log", "from [s]", "to [s]", *names), rows


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
    """Root mean squares of the gap before and after, and errors of Ti and Tt."""
    shrink = document["shrink"]
    times = shrink.get("times", {})
    rows = [
        [
            name,
            *(number(found[key]) for key in ("before", "after", "floor")),
            _arrow(times.get(name, {}), "Ti"),
            _arrow(times.get(name, {}), "Tt"),
        ]
        for name, found in shrink["channels"].items()
    ]
    head = ("RMSE of", "before", "after", "floor", "Ti error [s]", "Tt error [s]")
    return f"How far it shrinks, on {shrink['on']}", head, rows


def _arrow(found: Mapping[str, Any], name: str) -> str:
    before, after = found.get(f"{name}_before_s"), found.get(f"{name}_after_s")
    return f"{number(before)} -> {number(after)}"


def _percent(found: Mapping[str, float]) -> str:
    value, low, high = (100.0 * found[key] for key in ("value", "low", "high"))
    return f"{value:.0f} % [{low:.0f}, {high:.0f}]"


def _because(verdict: Mapping[str, Any]) -> str:
    reason = verdict["reason"].rstrip(".")
    if not reason or reason == _NONE:
        return ""
    return f" {reason[0].upper()}{reason[1:]}."
