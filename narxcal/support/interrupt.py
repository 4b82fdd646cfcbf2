"""Ctrl-C, held back until the work stands at a place where it can stop.

Python handles a signal at the next line of Python that it comes to. Where compiled code (numba)
hands an array or a named tuple to Python, that line is in the midst of it: numba unpickles the
class of the result by a Python function, and does not look whether that went well. An exception
raised there becomes a `SystemError`; with a named tuple it ends the process by a segmentation
fault. Handlers that raise are therefore put off until the result is handed over. Compiled functions
that Python calls return no named tuples, for where the handler is somebody else's.

Work that keeps what it has when it is stopped asks between its steps instead.
"""

from __future__ import annotations

import _thread
import signal
import sys
from contextlib import contextmanager
from threading import current_thread, main_thread
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import FrameType

    Handler = Callable[[int, FrameType | None], object]


def put_off(handler: Handler) -> Handler:
    """Make a signal handler wait for as long as compiled code is handing over its result."""

    def wait(number: int, frame: FrameType | None) -> None:
        if _handing_over(frame):
            # Sent again by a thread: by the time that runs, Python has moved on, or it is put off
            # once more.
            _thread.start_new_thread(_thread.interrupt_main, (signal.Signals(number),))
        else:
            handler(number, frame)

    return wait


def _handing_over(frame: FrameType | None) -> bool:
    """Whether Python stands in what numba calls while it builds a result."""
    unpickle = getattr(sys.modules.get("numba.core.serialize"), "_numba_unpickle", None)
    code = getattr(unpickle, "__code__", None)
    while frame is not None and frame.f_code is not code:
        frame = frame.f_back
    return frame is not None


class _CtrlC:
    """What Ctrl-C does: it raises `KeyboardInterrupt`, and is remembered."""

    def __init__(self) -> None:
        self.pressed = False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        self.pressed = True
        signal.default_int_handler(number, frame)


_ctrl_c = _CtrlC()
_raise_keyboard_interrupt = put_off(_ctrl_c)


@contextmanager
def safe_interrupt() -> Iterator[None]:
    """Let Ctrl-C raise `KeyboardInterrupt` while the block runs, and nothing else, anywhere.

    Outside the main thread, and where SIGINT is ignored or another's, nothing is changed.
    """
    if not _is_ours():
        yield
        return
    _ctrl_c.pressed = False
    before = signal.signal(signal.SIGINT, _raise_keyboard_interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


class Interrupt:
    """Whether Ctrl-C was pressed; the second press interrupts at once, as it always does."""

    def __init__(self) -> None:
        self.asked = False

    def stop_here(self) -> None:
        """Raise the `KeyboardInterrupt` that was held back."""
        if self.asked:
            raise KeyboardInterrupt

    def _press(self, number: int, frame: FrameType | None) -> None:
        if self.asked:
            _raise_keyboard_interrupt(number, frame)
        self.asked = True

    @contextmanager
    def _held(self) -> Iterator[None]:
        before = signal.signal(signal.SIGINT, self._press)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)


@contextmanager
def held_interrupt() -> Iterator[Interrupt]:
    """Hold Ctrl-C back while the block runs; it asks the `Interrupt` where it can stop.

    Outside the main thread, and where SIGINT is ignored or another's, nothing is held: Python
    delivers no signal there, or somebody else has a use for it.
    """
    interrupt = Interrupt()
    if not _is_ours():
        yield interrupt
        return
    with interrupt._held():  # noqa: SLF001 -- one noun, one module
        yield interrupt


def _is_ours() -> bool:
    """Whether SIGINT is what Python or `safe_interrupt` made it, and this is where it arrives."""
    known = (signal.default_int_handler, _raise_keyboard_interrupt)
    return signal.getsignal(signal.SIGINT) in known and current_thread() is main_thread()


def is_interrupt(error: BaseException | None) -> bool:
    """Whether `error` is a Ctrl-C, or came of one.

    In the block of `safe_interrupt` all that is raised after the press came of it: C code may drop
    what was raised in Python that it calls. Pandas then says that its file cannot be read.
    """
    if _ctrl_c.pressed and error is not None:
        return True
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__cause__ or error.__context__
    return False
