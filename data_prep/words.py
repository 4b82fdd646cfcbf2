"""Words that recorders and worksheets write in the place of numbers."""

from __future__ import annotations

import re

import numpy as np

# By `plain`, without case and the blanks around them.
# fmt: off
NO_VALUE = frozenset((
    "na", "n/a", "#n/a", "#na", "null", "none", "nil", "nan", "invalid", "inv", "fail", "failed",
    "fault", "ncd", "no_data", "nodata", "missing", "error", "err", "#div/0!", "#value!", "#ref!",
    "#num!", "#name?", "#null!", "<na>", "overflow", "ovf", "void", "blank",
))
_ON = ("on", "true", "yes", "y", "ground", "gnd", "on ground", "active", "selected", "engaged")
_OFF = ("off", "false", "no", "n", "air", "in air", "flight", "airborne", "inactive",
        "not selected", "disengaged")
# fmt: on
_SWITCH = {**dict.fromkeys(_ON, 1.0), **dict.fromkeys(_OFF, 0.0)}
_SIGNS = re.compile(r"[-*?.#_~\N{EN DASH}\N{EM DASH}]+")  # `---`, `****`


def switch(word: str) -> float:
    """Return 1 for words like ON and 0 for their opposites; NaN for any other."""
    return _SWITCH.get(plain(word), np.nan)


class Labels:
    """Numbers for the labels of a column, be they words or numbers, and back."""

    def __init__(self) -> None:
        self._numbers: dict[str, float] = {}

    def number(self, label: str) -> float:
        """Return the number that `label` is, or else a negative one that stands for it."""
        label = label.strip()
        if label not in self._numbers:
            try:
                self._numbers[label] = float(label)
            except ValueError:
                self._numbers[label] = -1e6 - len(self._numbers)
        return self._numbers[label]

    def label(self, number: float) -> str:
        """Return the label of a number."""
        known = (label for label, each in self._numbers.items() if each == number)
        return next(known, f"{number:.10g}")


def plain(text: str) -> str:
    """Return the text without case and surrounding blanks."""
    return text.strip().casefold()


def is_no_value(text: str) -> bool:
    """Whether a cell stands for a value that there is none of: `NCD`, `---`, `#N/A`."""
    short = plain(text)
    return short in NO_VALUE or _SIGNS.fullmatch(short) is not None
