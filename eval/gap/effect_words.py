"""An effect in words: what it is, and how large with its interval, for people rather than code."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from eval.gap.page_cells import printed
from eval.report.tables import number
from narxcal.channels import symbol
from narxcal.effects.library import effect

_MOST_NAMED = 3
Size = Mapping[str, Any]  # value, low, high and unit of one parameter


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
    low, high = size["low"], size["high"]
    ends = [_text(size, each) for each in (low, high)]
    unit = printed(size.get("unit", "-"))
    return f"{_text(size, size['value'])} {unit}".rstrip() + f" ({ends[0]} to {ends[1]})"


def spread_words(size: Size) -> str:
    """A size with half of its interval, both to one digit of that: `-1.85 ± 0.03`."""
    half = 0.5 * (size["high"] - size["low"])
    digits = _decimals(half, 1)
    if digits is None:
        return f"{number(size['value'])} ± {number(half)}"
    return f"{_plain(size['value'], digits)} ± {half:.{digits}f}"


def is_nil(size: Size) -> bool:
    """Whether a size may as well be nothing: its interval holds 0."""
    low, high = size["low"], size["high"]
    return low is not None and high is not None and low <= 0.0 <= high


def sizes_words(row: Mapping[str, Any]) -> str:
    """Every parameter of an effect with its interval: `tau_s 1.80 s (1.62 to 1.98); ...`."""
    return "; ".join(f"{name} {size_words(size)}" for name, size in row["parameters"].items())


def surest_words(row: Mapping[str, Any]) -> str:
    """The same, but of sizes that may as well be nothing only their names."""
    found = row["parameters"]
    nil = [name for name, size in found.items() if is_nil(size)]
    if len(nil) == len(found):
        return sizes_words(row)
    told = [f"{name} {size_words(size)}" for name, size in found.items() if name not in nil]
    if nil:
        names = listed(nil) if len(nil) <= _MOST_NAMED else f"{len(nil)} others"
        told.append(f"{names} not distinct from 0")
    return "; ".join(told)


def _text(size: Size, value: float | None) -> str:
    low, high = size["low"], size["high"]
    digits = None if low is None or high is None else _decimals(0.5 * (high - low), 2)
    if digits is None or value is None or not math.isfinite(value):
        return number(value)
    return _plain(value, digits)


def _decimals(width: float, digits: int) -> int | None:
    """Decimals that show `digits` significant digits of a width; None of what has no width."""
    if not (math.isfinite(width) and width > 0.0):
        return None
    exponent = int(f"{width:.{digits - 1}e}".partition("e")[2])
    return min(max(digits - 1 - exponent, 0), 6)


def _plain(value: float, digits: int) -> str:
    near = round(value, digits) + 0.0
    return f"{near:.{digits}f}" if near else "0"
