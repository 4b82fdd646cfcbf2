"""Ctrl-C and SIGTERM, deferred until the work can stop.

Python handles a signal at the next line of Python that it comes to. Where compiled code (numba)
returns an array or a named tuple to Python, that line is in the middle of it: numba unpickles the
class of the result by a Python function and does not check for errors. An exception raised there
becomes a `SystemError`; with a named tuple the process ends by a segmentation fault. Handlers that
raise are therefore deferred until the result is returned. Compiled functions that Python calls
return no named tuples, for where the handler is somebody else's.

Work that keeps what it has when it is stopped polls an `Interrupt` between its steps instead.
SIGTERM (and Ctrl-Break on Windows) does what Ctrl-C does; `terminated` says which one it was.
"""

from __future__ import annotations

import _thread
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import current_thread, main_thread
from types import FrameType

Handler = Callable[[int, FrameType | None], object]


def put_off(handler: Handler) -> Handler:
    """Make a signal handler wait for as long as compiled code is returning its result."""

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


_SIGNALS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGBREAK") if hasattr(signal, name)
)


class _Stop:
    """What Ctrl-C and SIGTERM do: they raise `KeyboardInterrupt`; `number` keeps which one came."""

    def __init__(self) -> None:
        self.number: int | None = None

    def __call__(self, number: int, frame: FrameType | None) -> None:
        self.number = number
        signal.default_int_handler(number, frame)


_stop = _Stop()
_raise_keyboard_interrupt = put_off(_stop)


def terminated() -> bool:
    """Whether SIGTERM came in the block of `safe_interrupt`, handled or still deferred."""
    return _stop.number not in (None, signal.SIGINT)


@contextmanager
def safe_interrupt() -> Iterator[None]:
    """Let Ctrl-C and SIGTERM raise `KeyboardInterrupt` while the block runs, and nothing else.

    Outside the main thread, and for a signal that is ignored or another's, nothing is changed.
    """
    _stop.number = None
    with _handled_by(_raise_keyboard_interrupt):
        yield


class Interrupt:
    """Whether a stop was requested; the second request interrupts at once, as it always does."""

    def __init__(self) -> None:
        self.requested = False

    def stop_here(self) -> None:
        """Raise the `KeyboardInterrupt` that was deferred."""
        if self.requested:
            raise KeyboardInterrupt

    def _request(self, number: int, frame: FrameType | None) -> None:
        _stop.number = number
        if self.requested:
            _raise_keyboard_interrupt(number, frame)
        self.requested = True


@contextmanager
def held_interrupt() -> Iterator[Interrupt]:
    """Defer Ctrl-C and SIGTERM while the block runs; the work polls the `Interrupt`.

    Outside the main thread, and for a signal that is ignored or another's, nothing is deferred:
    Python delivers no signal there, or somebody else has a use for it.
    """
    interrupt = Interrupt()
    with _handled_by(interrupt._request):  # noqa: SLF001 -- one noun, one module
        yield interrupt


@contextmanager
def _handled_by(handler: Handler) -> Iterator[None]:
    before = {number: signal.getsignal(number) for number in _SIGNALS if _is_ours(number)}
    for number in before:
        signal.signal(number, handler)
    try:
        yield
    finally:
        for number, former in before.items():
            signal.signal(number, former)


def _is_ours(number: int) -> bool:
    """Whether the signal is handled as Python or `safe_interrupt` does, and arrives here."""
    default = signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL
    known = (default, _raise_keyboard_interrupt)
    return signal.getsignal(number) in known and current_thread() is main_thread()


def is_interrupt(error: BaseException | None) -> bool:
    """Whether `error` is an interruption, or was caused by one.

    In the block of `safe_interrupt` all that is raised after the signal was caused by it: C code
    may drop what was raised in Python that it calls. Pandas then reports an unreadable file.
    """
    if _stop.number is not None and error is not None:
        return True
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__cause__ or error.__context__
    return False
