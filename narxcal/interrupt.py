"""Ctrl-C, held back until the work stands at a place where it can stop.

A signal that arrives inside a compiled loop surfaces as a `SystemError`, in the middle of a
step. Work that keeps what it has when it is stopped asks between its steps instead.
"""

from __future__ import annotations

import signal
from contextlib import contextmanager
from threading import current_thread, main_thread
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import FrameType


class Interrupt:
    """Whether Ctrl-C was pressed; the second press interrupts at once, as it always does."""

    def __init__(self) -> None:
        self.asked = False
        self._before: object = None

    def stop_here(self) -> None:
        """Raise the `KeyboardInterrupt` that was held back."""
        if self.asked:
            raise KeyboardInterrupt

    def _press(self, number: int, frame: FrameType | None) -> None:
        if self.asked and callable(self._before):
            self._before(number, frame)
        self.asked = True

    @contextmanager
    def _held(self) -> Iterator[None]:
        self._before = signal.signal(signal.SIGINT, self._press)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, self._before)


@contextmanager
def held_interrupt() -> Iterator[Interrupt]:
    """Hold Ctrl-C back while the block runs; it asks the `Interrupt` where it can stop.

    Outside the main thread, and where SIGINT is ignored or another's, nothing is held: Python
    delivers no signal there, or somebody else has a use for it.
    """
    interrupt = Interrupt()
    ours = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if not ours or current_thread() is not main_thread():
        yield interrupt
        return
    with interrupt._held():  # noqa: SLF001 -- one noun, one module
        yield interrupt


def is_interrupt(error: BaseException | None) -> bool:
    """Whether `error` is a Ctrl-C, or came of one that fell into a compiled loop."""
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__cause__ or error.__context__
    return False
