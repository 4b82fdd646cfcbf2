"""Values of options that argparse has to read: what each allows, and what it says of another."""

from __future__ import annotations

import math
from argparse import ArgumentTypeError


def fraction(text: str) -> float:
    """A number from 0 to below 1, as `--trim` takes it."""
    value = _number(text)
    if not 0.0 <= value < 1.0:
        raise ArgumentTypeError(f"expected a fraction from 0 to below 1, found {text}")
    return value


def seconds(text: str) -> float:
    """A time of more than 0 s, as `--timeout` takes it; `inf` is no limit."""
    value = _number(text)
    if not value > 0.0:
        raise ArgumentTypeError(f"expected more than 0 s, found {text}")
    return value


def count(text: str) -> int:
    """A whole number of 1 or more, as `--jobs` takes it."""
    return _whole(text, 1)


def seed(text: str) -> int:
    """A whole number of 0 or more, from which random numbers are drawn."""
    return _whole(text, 0)


def _whole(text: str, least: int) -> int:
    try:
        value = int(text)
    except ValueError:
        value = least - 1
    if value < least:
        raise ArgumentTypeError(f"expected a whole number of {least} or more, found {text}")
    return value


def _number(text: str) -> float:
    """NaN, which no option allows, where the text is no number."""
    try:
        return float(text)
    except ValueError:
        return math.nan
