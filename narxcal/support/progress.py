"""How long work shows how far it is: the one type of such a callback."""

from __future__ import annotations

from typing import Protocol


class Progress(Protocol):
    """Called with the steps done, the number of steps (0: unknown), and what is at work."""

    def __call__(self, done: int, total: int, what: str = "", /) -> None: ...


def silent(_done: int, _total: int, _what: str = "", /) -> None:
    """Show nothing."""
