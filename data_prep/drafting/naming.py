"""Which channel a recorder's column may be, by its name: `lh_engine_fan_N1`, `EGT1C`, `ALT (ft)`.

A name is cut into words. Each has to be explained: by the names of a channel
(`narxcal.channels.FIELD_NAMES`), an engine, a unit, or as one of the few words that change nothing.
So a `radio altitude` or a `fuel used` is no channel, and no part of a name is passed over.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple
from unicodedata import normalize

from data_prep.config import ENGINE
from data_prep.sources.units import base_unit, find_unit, is_pressure, is_volume_flow, named_unit
from narxcal.channels import CHANNELS, ENDINGS, FIELD_NAMES, SPOOLS, described, symbol
from narxcal.support.errors import ConfigError

PER_MINUTE = "rpm"


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


# Names that say a channel together with their unit alone: the speed of an engine of one spool, and
# the pressure around it; and the word of that channel.
_SPEED = ("n", "speed")
_BAROMETER = _words(
    "air baro barometer barometric pbaro pamb p0 patm amb ambient pressure cell p test"
)
_WORD = re.compile(r"%|[A-Z]?[a-z]+\d*|[A-Z]+\d*[A-Z]*(?![a-z])|\d+[A-Za-z]*|[A-Za-z]\w*")
_IN_BRACKETS = re.compile(r"[\[({<]([^][(){}<>]*)[\])}>]\s*$")
_SIDES = ("l", "r", "lh", "rh", "left", "right", "le", "re", "lft", "rgt", "port", "stbd")
_ENGINE = re.compile(r"(?:eng|engine|e|no)([1-8])")
_NUMBERED = re.compile(r"([a-z]+\d?|n[12]|t\d+)([1-8])c?")
_LEAST_WORD = 3  # letters before an engine's number
_SIDED = re.compile(r"(l|r|lh|rh)(n[12]|egt|itt|ff|tla|pla|tra)")
_AIR_DATA = re.compile(r"d?adc?\d?|adr\d?|airdata|fmc\d?|fdr|dfdr|fadec\d?|eec\d?|ecu|acms")
_FILLERS = _words(
    "engine eng act actual ind meas measured value val raw lsp avg average mean std sensor probe "
    "tach spool rotor turbine parameter param of the no number drehzahl regime triebwerk moteur "
    "motor der de du"
)
_COMMANDS = _words(
    "setpoint set sp cmd command commanded dem demand demanded target ref request requested"
)
# What else stands in brackets at the end of a name.
_DESIGNATIONS = _words(
    "a b captain capt fo copilot pilot primary secondary main backup filtered smoothed corrected "
    "indicated total static baro gps radio inner outer upper lower front rear hp lp max utc gmt "
    "local"
)
_QUANTITIES = ("pct", "rpm", "kW", "Nm", "kPa")  # endings of quantities that engines differ in
_BY_NAME = {text.casefold(): name for name, texts in FIELD_NAMES.items() for text in texts}


class Reading(NamedTuple):
    """One way to read a column's name.

    `template` is the name with `{engine}` in the place of the text `engine`; `unit` stands in the
    name ("" where none does); `command` marks a demanded value, not a measured one; `doubt` counts
    the words that were passed over, fewer being better.
    """

    channel: str
    template: str
    engine: str = ""
    unit: str = ""
    command: bool = False
    doubt: int = 0


class _Word(NamedTuple):
    text: str
    start: int
    stop: int


def read_name(column: str, unit: str = "") -> Reading | None:
    """Return the best reading of a column's name; None for a column that is no channel.

    Brackets that end it may hold its unit, which `data_prep.sources.columns.unit_text` reads. With
    the `unit` that the file says, a name that any speed may have is read as the only spool's, and
    the pressure around a test cell as the altitude that it stands for. The struct or group that a
    column is in, as in `rec/time`, is no part of its name unless it names the engine.
    """
    if column in CHANNELS:  # also `dT_C`, of which a part is a step of time elsewhere
        return Reading(column, column, unit=column.partition("_")[2].casefold())
    brackets = _IN_BRACKETS.search(column)
    named = brackets is None or is_designation(brackets[1])
    own = column if brackets is None or named else column[: brackets.start()]
    plain = "".join(normalize("NFD", letter)[0] for letter in own.replace("ß", "s"))
    words = [_Word(found[0].casefold(), *found.span()) for found in _WORD.finditer(plain)]
    found = list(_readings(column, words))
    if not found and named_unit(unit) in (PER_MINUTE, "%"):
        turns = [word._replace(text=PER_MINUTE) if word.text in _SPEED else word for word in words]
        found = list(_readings(column, turns))
    if not found and is_pressure(unit) and _is_barometer([word.text for word in words]):
        found = [Reading("ALT_ft", column)]
    group, _, inner = column.partition("/")
    if not found and group.isidentifier() and (read := read_name(inner, unit)):
        return read._replace(template=f"{group}/{read.template}")
    return min(found, key=lambda each: each.doubt, default=None)


def _is_barometer(words: Sequence[str]) -> bool:
    """Whether words mean the pressure around the engine: `PBARO`, `cell pressure`, `P ambient`."""
    return {*words} <= _BAROMETER and not {*words} <= {"p", "pressure", "test", "air"}


def declarable(column: str, unit: str, marks: Collection[str]) -> tuple[str, str, str] | None:
    """Return name, template and unit with which a column that is no channel may be declared.

    `unit` is what the file says, else the column's name ends in it; `marks` are texts of engines.
    None without a unit of an engine's quantity, and for a name that the table of channels has.
    """
    brackets = _IN_BRACKETS.search(column)
    own = column[: brackets.start()] if brackets and unit else column
    first = own.rfind("/") + 1 if own.rpartition("/")[0].replace("/", "_").isidentifier() else 0
    words = [_Word(found[0], *found.span()) for found in _WORD.finditer(own, first)]
    if not unit:
        words, unit = _unit_at_the_end(words)
    known = "" if unit in ("nm", "NM") else named_unit(unit)  # nautical miles
    ending = next((end for end, each in ENDINGS.items() if each == base_unit(known)), "")
    template, left = _of_an_engine(column, words, marks)
    name = "".join(word[0].upper() + word[1:] for word in left)
    named = {symbol(each).casefold() for each in CHANNELS}
    if ending not in _QUANTITIES or not name.isidentifier() or name.casefold() in named:
        return None
    return f"{name}_{ending}", template, known


def _unit_at_the_end(words: list[_Word]) -> tuple[list[_Word], str]:
    """The words before the longest unit that ends a name, and the unit: `Load_kW`, `LoadkW`."""
    for first in range(1, len(words)):
        part, before = words[first:], words[first - 1]
        text = "".join(word.text for word in part)
        if not named_unit(text) or any(a.stop != b.start for a, b in pairwise(part)):
            continue
        prefix = before.text[-1]  # of the unit, in a word that it touches
        if before.stop < part[0].start or not named_unit(prefix + text):
            return words[:first], text
        shorter = _Word(before.text[:-1], before.start, before.stop - 1)
        return [*words[: first - 1], shorter], prefix + text
    return words, ""


def _of_an_engine(
    column: str, words: Sequence[_Word], marks: Collection[str]
) -> tuple[str, list[str]]:
    """Return the template of a column by the first of `marks` in it, and the other words."""
    texts = [word.text for word in words]
    for place, (text, start, stop) in enumerate(words):
        for left, at, width in _without_engine(text.casefold(), stop - start):
            first, last = start + at, start + at + width
            if column[first:last] in marks:
                kept = [*texts[:place], *left, *texts[place + 1 :]]
                return column[:first] + ENGINE + column[last:], kept
    return column, texts


def is_designation(text: str) -> bool:
    """Whether text in brackets belongs to a column's name: an engine, a number, `fan`, `avg`.

    `R` is the right engine, not a degree Rankine, `HP` the high-pressure spool, not a power.
    """
    words = [found[0].casefold() for found in _WORD.finditer(text)]
    unit = named_unit(text) or is_volume_flow(text) or PER_MINUTE in words
    if unit and text.casefold() not in (*_SIDES, "1", "hp"):
        return False
    known = _DESIGNATIONS | _FILLERS | _COMMANDS | _BY_NAME.keys() | {*_SIDES}
    return all(
        word in known or word.isdigit() or _ENGINE.fullmatch(word) or _AIR_DATA.fullmatch(word)
        for word in words
    )


def _readings(column: str, words: Sequence[_Word]) -> Iterator[Reading]:
    """Read the name as that of no engine, then each word as the engine's in turn."""
    if plain := _channel([word.text for word in words]):
        yield Reading(plain[0], column, "", *plain[1:])
        return
    for place, (text, start, stop) in enumerate(words):
        rest = [word.text for word in words]
        for left, at, width in _without_engine(text, stop - start):
            known = _channel([*rest[:place], *left, *rest[place + 1 :]])
            if known:
                name, unit, command, doubt = known
                mark = column[start + at : start + at + width]
                template = column[: start + at] + ENGINE + column[start + at + width :]
                yield Reading(name, template, mark, unit, command, doubt + len(left))


def _without_engine(text: str, length: int) -> Iterator[tuple[list[str], int, int]]:
    """Yield what is left of a word without the engine in it, and place and length of that."""
    if text in _SIDES or (len(text) == 1 and text in "12345678"):
        yield [], 0, length
    if found := _ENGINE.fullmatch(text):
        yield [], found.start(1), 1
    # N1 is no `N` of engine 1.
    found = _NUMBERED.fullmatch(text)
    if found and (found[1] in _BY_NAME or len(found[1]) >= _LEAST_WORD):
        yield [found[1]], found.start(2), 1
    if found := _SIDED.fullmatch(text):
        yield [found[2]], 0, len(found[1])


def _channel(words: Sequence[str]) -> tuple[str, str, bool, int] | None:
    """Channel, unit, whether commanded, and words passed over, of a name without its engine."""
    plain = [word for word in words if word not in _COMMANDS]
    command = len(plain) < len(words)
    # The longest unit first: `GMT_SEC` is a time in seconds, though `sec` alone names one, too.
    for unit_words in range(min(2, len(plain) - 1), -1, -1):
        kept = plain[: len(plain) - unit_words]
        unit = "/".join(plain[len(kept) :])  # `FF_lb_hr`
        found = _named(kept)
        engine = unit.isdigit() or unit in _SIDES  # `EGT R` is no degree Rankine
        if found and (not unit or (not engine and fits(unit, found[0]))):
            own = PER_MINUTE if PER_MINUTE in kept and not unit else unit
            return found[0], own, command, found[1] + 2 * command
    return None


def _named(words: Sequence[str]) -> tuple[str, int] | None:
    if not words:
        return None
    kept = [word for word in words if word not in _FILLERS and not _AIR_DATA.fullmatch(word)]
    for doubt, some in enumerate((words, kept)):
        if name := _BY_NAME.get("".join(some)):
            return name, doubt
    names = {_BY_NAME.get(word, "") for word in kept}
    if len(names) == 1 and (name := names.pop()):
        return name, 2  # `fan N1`
    joined = "".join(kept)
    checked = joined.endswith("c") and kept[-1] != "c"
    # Airbus marks checked parameters by a C at the end; of a speed it means commanded.
    name = _BY_NAME.get(joined[:-1], "") if checked else ""
    return (name, 3) if name and name not in SPOOLS else None


def fits(unit: str, name: str) -> bool:
    """Whether text names a unit in which channel `name` may be recorded."""
    if named_unit(unit) == PER_MINUTE and name in SPOOLS:
        return True
    if is_volume_flow(unit):
        return described(name).unit == "kg/h"
    try:
        find_unit(named_unit(unit), name)
    except ConfigError:
        return False
    return bool(named_unit(unit))
