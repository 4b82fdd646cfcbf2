"""The three errors a user can cause, children of `NarxcalError`; hints at misspelt names."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from os import PathLike

_LONGEST = 80  # characters of a name


class NarxcalError(Exception):
    """Something the user can act on: what was expected, what was found, where, what to do.

    The message reads `FILE, channel C, row R: PROBLEM. HINT`, each part only where it is known.
    """

    def __init__(
        self,
        problem: str,
        *,
        file: str | PathLike[str] | None = None,
        channel: str | None = None,
        row: int | None = None,
        hint: str | None = None,
    ) -> None:
        self.problem = problem
        self.file = None if file is None else str(file)
        self.channel = channel
        self.row = row
        self.hint = hint
        super().__init__(self._message())

    def _message(self) -> str:
        known = (("{}", self.file), ("channel {}", self.channel), ("row {}", self.row))
        place = ", ".join(form.format(each) for form, each in known if each is not None)
        head = f"{place}: " if place else ""
        tail = f". {self.hint}" if self.hint else ""
        return f"{head}{self.problem}{tail}"


class DataError(NarxcalError):
    """A log, table or recording is not what it has to be."""


class ConfigError(NarxcalError):
    """A configuration or a command-line argument is not what it has to be."""


class ModelError(NarxcalError):
    """A model or a bundle cannot be used as requested."""


def did_you_mean(name: str, known: Iterable[str], otherwise: str, cutoff: float = 0.4) -> str:
    """Hint at the nearest of the `known` names.

    Where none is similar by `cutoff` (`difflib`, 0 to 1), list them after the words `otherwise`.
    """
    names = list(known)
    # Comparing takes the product of both lengths, and nobody misspells a name into a long text.
    near = difflib.get_close_matches(name[:_LONGEST], names, n=1, cutoff=cutoff)
    return f"Did you mean '{near[0]}'?" if near else f"{otherwise} {', '.join(names)}"


def printable(text: str) -> str:
    """Spell control characters out, so that no name of a file commands a terminal."""
    return "".join(
        each
        if each == "\n" or each.isprintable() or each == " "
        else each.encode("unicode_escape").decode("ascii")
        for each in text
    )
