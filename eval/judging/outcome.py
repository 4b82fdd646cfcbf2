"""Pass or fail of a command that judges: one line of words, and the exit code."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Outcome:
    """A verdict with its reasons; `passed` is None where there was nothing to judge.

    Without evidence there is no pass: `exit_code` is 0 for a pass alone.
    """

    passed: bool | None
    headline: str
    lines: tuple[str, ...] = ()

    @property
    def exit_code(self) -> int:
        return 0 if self.passed else 1


def plural(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
