"""What recorders and worksheets write in the place of a measurement: words, labels, code words.

A code word is a number. One with all bits set marks a sample as invalid, and some recorders use a
word for something else at a fixed period. Either is found from the data alone. A value is a code
word if

* nearly every run of it is entered and left by a jump, there and back, that is larger than nearly
  all steps between the other samples, as no quantity moves;
* its runs are no longer than that of one measurement: a lever or a fuel flow that is stepped to its
  stop and back is none; and
* it is all ones, `(2**bits - 1)` times the resolution of the channel, or comes at a fixed period.
"""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from narxcal.support.arrays import BoolArray, FloatArray, runs

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
_FEWEST_RUNS = 3  # each is a jump that one step in a hundred exceeds, twice: 1e-12 by chance
_FEWEST_PERIODS = 8
_MOST_OF = 0.9  # of the runs; a measurement may equal the word
_LARGE = 0.99  # quantile of the steps between samples
_FEWEST_STEPS = 20  # that move at all, to know how a channel moves
_FEWEST_LEVELS = 16  # to know its resolution
_BITS = range(8, 17)
_MAX_DECIMALS = 6
_MOST_LEARNED = 200_000  # rows


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
        known = (label for label, each in self._numbers.items() if each == number)
        return next(known, f"{number:.10g}")


def plain(text: str) -> str:
    return text.strip().casefold()


def is_no_value(text: str) -> bool:
    """Whether a cell stands for a value that there is none of: `NCD`, `---`, `#N/A`."""
    short = plain(text)
    return short in NO_VALUE or _SIGNS.fullmatch(short) is not None


class CodeWords:
    """Code words of a channel that is read block by block.

    They are looked for in the first rows, and again whenever there are twice as many, so that those
    of a file that is still written are found as soon as they can be; earlier rows stay as they are.
    """

    def __init__(self) -> None:
        self._rows: list[FloatArray] = []
        self._count = 0
        self._look_at = 1
        self._known: tuple[CodeWord, ...] = ()
        self._before = np.nan

    def masks(self, values: FloatArray) -> list[tuple[CodeWord, BoolArray]]:
        """Return the code words in the next rows `(rows,)` and where each is."""
        self._learn(values)
        # A run of code words at the beginning is entered from the row before.
        rows = np.concatenate([[self._before], values])
        found = []
        for word in self._known:
            masked = word.rows(rows)
            rows = np.where(masked, np.nan, rows)
            found.append((word, masked[1:]))
        sound = rows[np.isfinite(rows)]
        self._before = sound[-1] if len(sound) else np.nan
        return found

    def _learn(self, values: FloatArray) -> None:
        if self._look_at > _MOST_LEARNED:
            return
        self._rows.append(values)
        self._count += len(values)
        if self._count >= self._look_at:
            self._rows = [np.concatenate(self._rows)]
            self._known = code_words(self._rows[0])
            self._look_at = 2 * self._count
        if self._look_at > _MOST_LEARNED:
            self._rows.clear()


class CodeWord(NamedTuple):
    """One code word of a channel: runs of `value` beyond jumps of `jump` are none of its samples.

    `why` says what it was recognised by.
    """

    value: float
    jump: float
    why: str

    def rows(self, values: FloatArray) -> BoolArray:
        """Which of `values` `(rows,)`, with NaN where blank, are this word."""
        found = np.zeros(len(values), dtype=np.bool_)
        own = np.flatnonzero(np.isfinite(values))
        starts, stops, jumps = _runs_of(self.value, values[own])
        for start, stop, jump in zip(starts, stops, jumps, strict=True):
            found[own[start:stop]] = jump > self.jump
        return found


def code_words(values: FloatArray) -> tuple[CodeWord, ...]:
    """Find the code words of a channel `(rows,)`, with NaN where blank."""
    found: list[CodeWord] = []
    for _ in range(_FEWEST_RUNS):
        own = np.flatnonzero(np.isfinite(values))
        # Steps between numbers that no recorder writes overflow, and then there is no word.
        with np.errstate(over="ignore", invalid="ignore"):
            word = _next(values[own], own)
        if word is None:
            break
        found.append(word)
        values = np.where(word.rows(values), np.nan, values)
    return tuple(found)


def _next(values: FloatArray, rows: NDArray[np.intp]) -> CodeWord | None:
    levels, counts = np.unique(values, return_counts=True)
    if len(levels) <= _FEWEST_LEVELS:
        return None
    often = counts >= _FEWEST_RUNS
    steps = np.diff(values)
    peaks = values[1:-1][np.sign(steps[1:]) * np.sign(steps[:-1]) < 0.0]
    peaks = peaks[np.abs(peaks - np.median(values)) > 0.0]
    common, times = np.unique(peaks, return_counts=True)
    candidates = [levels[-1]] * bool(often[-1]) + [levels[0]] * bool(often[0])
    candidates += [*common[times == times.max(initial=0)][:1]]
    found = (_word(float(value), values, rows) for value in candidates)
    return next((word for word in found if word), None)


def _word(value: float, values: FloatArray, rows: NDArray[np.intp]) -> CodeWord | None:
    others = values[values != value]
    changes = np.flatnonzero(np.diff(others) != 0.0)
    starts, stops, jumps = _runs_of(value, values)
    if len(changes) < _FEWEST_STEPS or len(starts) < _FEWEST_RUNS:
        return None
    large = float(np.quantile(np.abs(np.diff(others)[changes]), _LARGE))
    # A recorder may hold each measurement for some rows, give or take one.
    held = int(np.diff(changes).min()) + 1
    if np.mean(jumps > large) < _MOST_OF or np.median(stops - starts) > held:
        return None
    apart = np.diff(rows[starts])
    bits = _bits(value, others)
    period = int(np.median(apart))
    if bits:
        return CodeWord(value, large, f"all ones of {bits} bits")
    if len(apart) >= _FEWEST_PERIODS and period > 2 and np.mean(apart % period == 0) >= _MOST_OF:
        return CodeWord(value, large, f"every {period} rows")
    return None


def _runs_of(value: float, values: FloatArray) -> tuple[NDArray[np.intp], ...]:
    """First and end of each run of `value`, and the smaller of its jumps, 0 if not there and back.

    A run at an end of the data has one jump.
    """
    starts, stops = runs(values == value)
    before = value - values[np.maximum(starts - 1, 0)]
    after = value - values[np.minimum(stops, len(values) - 1)]
    before = np.where(starts == 0, after, before)
    after = np.where(stops == len(values), before, after)
    jumps = np.where(before * after > 0.0, np.minimum(np.abs(before), np.abs(after)), 0.0)
    return starts, stops, jumps


def _bits(value: float, others: FloatArray) -> int:
    """Bits of the word if `value` is all ones of the channel's resolution, else 0."""
    levels = np.unique(others)
    printed = _printed_step(np.append(levels, value))
    if value <= 0.0 or len(levels) < _FEWEST_LEVELS:
        return 0
    for bits in _BITS:
        resolution = value / (2**bits - 1)
        if printed > 0.5 * resolution:
            return 0
        away = np.abs(levels / resolution - np.round(levels / resolution)) * resolution
        if (away <= printed * (0.5 + 0.5 * levels / value) + 1e-9 * value).all():
            return bits
    return 0


def _printed_step(values: FloatArray) -> float:
    """Step of the last decimal that values were printed with; 0 where they were not rounded."""
    for decimals in range(_MAX_DECIMALS + 1):
        if np.allclose(values, np.round(values, decimals), rtol=1e-12, atol=1e-12):
            return float(10.0**-decimals) if decimals else 0.0
    return 0.0
