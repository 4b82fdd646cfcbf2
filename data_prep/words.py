"""Words that recorders and worksheets write in the place of numbers."""

from __future__ import annotations

import re

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
SWITCH = {**dict.fromkeys(_ON, 1.0), **dict.fromkeys(_OFF, 0.0)}
_SIGNS = re.compile(r"[-*?.#_~\N{EN DASH}\N{EM DASH}]+")  # `---`, `****`


def plain(text: str) -> str:
    """Return the text without case and surrounding blanks."""
    return text.strip().casefold()


def is_no_value(text: str) -> bool:
    """Whether a cell stands for a value that there is none of: `NCD`, `---`, `#N/A`."""
    short = plain(text)
    return short in NO_VALUE or _SIGNS.fullmatch(short) is not None
