"""The one place that words a diagnosis: verdict, effects with their sizes, what to fly next."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from typing import Any, Final

from eval.judging.outcome import Outcome
from eval.report.style import decimals, number
from narxcal.channels import CHANNELS, symbol
from narxcal.effects.library import effect, name_of
from narxcal.effects.steady import SWITCHES, TAKEN
from narxcal.intervals import LEVEL

NAMED: Final = {
    "build": "differences of build",
    "offsets": "flight offsets",
    "noise": "noise",
    "unexplained": "not explained by the library",
}
VERDICTS: Final = {
    "none": "✓ NO EFFECT",
    "effects": "● FOUND",
    "ambiguous": "≈ AMBIGUOUS",
    "unknown": "? UNDETERMINED",
}
# What the shapes are that amplitudes belong to, by the first part of a parameter's name.
_SHAPES: Final = {
    "base": "at idle",
    "power": "from idle to full power",
    "per_10K": "per 10 K",
    "on": "while it is on",
    "idle": "with the lever at its stop",
    "share": "for each degree that metal trails",
    **{name: f"with {symbol(name)}" for name in SWITCHES},
}
_MEANINGS: Final = {
    TAKEN.name: "acceleration lost over the range of EGT",
    "own_s": "the lag that the simulated channel has already",
}
_MOST_NAMED = 3
Size = Mapping[str, Any]  # value, low, high and unit of one parameter
Row = Mapping[str, Any]


def in_words(name: str) -> str:
    """What it is, its name in brackets: `lag of the EGT sensor (sensor_lag:EGT_C)`.

    Raises `ConfigError` for an effect that is not in the library.
    """
    found = effect(name)
    words = found.meaning
    if found.channel is not None:
        words = words.replace("one sensor", f"the {symbol(found.channel)} sensor")
        words = words.replace("one channel", symbol(found.channel))
    return f"{words} ({name})"


def listed(words: list[str], last: str = "and") -> str:
    """`a`, `a and b`, `a, b and c`."""
    return f" {last} ".join(filter(None, (", ".join(words[:-1]), words[-1]))) if words else ""


def size_words(size: Size) -> str:
    """A size with unit and interval, to two digits of the interval: `1.80 s (1.62 to 1.98)`."""
    value, low, high = (_text(size, size[key]) for key in ("value", "low", "high"))
    unit = size.get("unit", "-").replace("degC", "°C").replace("deg", "°")
    return f"{value} {unit}".rstrip(" -") + f" ({low} to {high})"


def parameter_words(name: str) -> str:
    """A parameter, an amplitude in words: `EGT with NAI` for `NAI_EGT_C`; others as they are."""
    for shape, words in _SHAPES.items():
        channel = name.removeprefix(f"{shape}_")
        if channel != name and channel in CHANNELS:
            return f"{symbol(channel)} {words}"
    return _MEANINGS.get(name, name)


def surest_words(row: Mapping[str, Any]) -> str:
    """Every parameter of an effect with its interval: `tau_s 1.80 s (1.62 to 1.98); ...`.

    Of sizes that may as well be nothing, their interval holding 0, only their names, unless all
    are such. A size at the very value at which it does nothing is left out.
    """
    neutral = {one.name: one.neutral for one in effect(name_of(row)).fixed}
    found = {
        name: size
        for name, size in row["parameters"].items()
        if size["value"] is None or size["value"] != neutral.get(name)
    } or row["parameters"]
    nil = [name for name, size in found.items() if _holds_0(size["low"], size["high"])]
    nil = [] if len(nil) == len(found) else nil
    texts = [f"{parameter_words(n)} {size_words(found[n])}" for n in found if n not in nil]
    if nil:
        names = [*map(parameter_words, nil)]
        words = listed(names) if len(nil) <= _MOST_NAMED else f"{len(nil)} others"
        texts.append(f"{words} may as well be 0")
    return "; ".join(texts)


def _holds_0(low: float | None, high: float | None) -> bool:
    return low is not None and high is not None and low <= 0.0 <= high


def _text(size: Size, value: float | None) -> str:
    low, high = size["low"], size["high"]
    width = 0.0 if low is None or high is None else 0.5 * (high - low)
    if value is None or not (math.isfinite(value) and math.isfinite(width) and width > 0.0):
        return number(value)
    digits = decimals(width, 2)
    near = round(value, digits) + 0.0
    return f"{near:.{digits}f}" if near else "0"


def sentences(document: Row) -> list[str]:
    """The verdict: one sentence for each effect that is named, then what is left."""
    verdict, rows = document["verdict"], {name_of(row): row for row in document["effects"]}
    shares = {row["cause"]: row for row in document["budget"]}
    found = [_claim(name, rows[name], shares) for name in verdict["effects"] if name in rows]
    if not found:
        reason = verdict["reason"].rstrip(".")
        word = "Undetermined" if verdict["kind"] == "unknown" else "No effect is named"
        found = [f"{word}: {reason}."]
    if verdict["ambiguous_with"]:
        both = [name for name in (*verdict["effects"], *verdict["ambiguous_with"]) if name in rows]
        words = [f"{in_words(name)} ({percent(rows[name]['probability'])})" for name in both]
        manoeuvre = verdict["separating_manoeuvre"]
        found.append(f"One answer, which these flights do not divide: {listed(words, 'or')}.")
        found.append(f"What would: {manoeuvre}.")
    if (left := shares.get("unexplained")) is not None:
        share = percent(left["share"]) if left["share"] < 1.0 else "All"
        share = "No part" if share == percent(0.0) else share
        found.append(f"{share} of the gap is left over that no effect known to narxcal explains.")
    return found


def _claim(name: str, row: Row, shares: Mapping[str, Row]) -> str:
    text = f"{in_words(name)}, {percent(row['probability'])} probable, {surest_words(row)}"
    if name in shares:
        share, own = shares[name]["share"], shares[name]["channels"]
        most = max(own, key=lambda each: own[each])
        whole = sum(each["channels"].get(most, 0.0) for each in shares.values())
        part = own[most] / whole if whole > 0.0 else 0.0
        text += f": {percent(share)} of the gap, {percent(part)} of that of {symbol(most)}"
    return f"{text[:1].upper()}{text[1:]}."


def outcome(document: Row) -> Outcome:
    """The verdict box: what is named, how sure, and how far the gap shrinks."""
    first, *rest = sentences(document)
    shrink = document["shrink"]
    if document["verdict"]["effects"]:
        low, high = (percent(shrink["predicted"][key]) for key in ("low", "high"))
        text = f"Added to the simulator they take {percent(shrink['predicted']['value'])} "
        text += f"({low} to {high}) off the squared gap"
        if shrink["realised"] is not None:
            text += f"; on {shrink['on']} it is {percent(shrink['realised'])}"
        rest.append(f"{text}.")
        rest += _events(shrink)
    return Outcome(document["verdict"]["kind"] != "unknown" or None, first, tuple(rest))


def is_sure(document: Row, names: Collection[str]) -> bool:
    return all(row["probability"] >= LEVEL for row in document["effects"] if name_of(row) in names)


def _events(shrink: Row) -> Iterator[str]:
    for name, times in shrink["times"].items():
        if times["events"]:
            text = ", ".join(
                f"{each} {number(times[f'{each}_before_s'])} s before, "
                f"{number(times[f'{each}_after_s'])} s after"
                for each in ("Ti", "Tt")
            )
            yield f"Mean error of {symbol(name)} over {times['events']} events: {text}."


def next_flights(document: Row) -> list[tuple[str, str]]:
    """Manoeuvres that would tell apart what these flights do not, each with what for."""
    found: dict[str, list[str]] = {}
    verdict = document["verdict"]
    sets = [row["credible_set"] for row in document["budget"] if len(row["credible_set"]) > 1]
    doubted = [*verdict["ambiguous_with"], *(name for names in sets for name in names)]
    if doubted:
        doubted = [*verdict["effects"], *doubted]
    for name in dict.fromkeys(doubted):
        found.setdefault(effect(name).manoeuvre, []).append(in_words(name))
    return [(manoeuvre, f"separates {listed(words)}") for manoeuvre, words in found.items()]


def cause_words(name: str) -> str:
    return NAMED[name] if name in NAMED else in_words(name)


def percent(share: float) -> str:
    return f"{100.0 * share:z.0f} %"
