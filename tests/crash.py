"""Kill a writer at any of its file events, in this process, as SIGKILL or a power cut would.

Python's audit hook reports every opening for writing, renaming, making and removing below a folder;
`fsync` is reported besides. From the event `kill_at` on, each raises `Killed`, which no command
catches, so that nothing that the writer still tries (clean-up included) changes the disk.
"""

import os
import sys
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC
_CHANGING = {
    "os.rename", "os.mkdir", "os.remove", "os.rmdir", "os.symlink", "os.link", "os.truncate",
}  # fmt: skip


class Killed(BaseException):
    """The writer is dead."""


class Disk:
    """Counts the file events below `folder`; `kill_at` (None: never) counts from 0."""

    def __init__(self, folder, kill_at=None):
        self.folder, self.kill_at, self.events = str(folder), kill_at, []
        self._before, self._flushed = set(self._states()), set()

    def event(self, name, path):
        # A relative path is of a removal within an open folder (`shutil.rmtree`).
        if isinstance(path, int):
            return
        there = os.fsdecode(path)
        if there.startswith("/") and not there.startswith(self.folder):
            return
        self.events.append((name, there))
        if self.kill_at is not None and len(self.events) > self.kill_at:
            raise Killed

    def flushed(self, descriptor):
        self._flushed.add(_state(os.fstat(descriptor)))

    def lose_power(self):
        """Cut every file that was written and not flushed since, to half of its length."""
        for state, path in self._states().items():
            if state not in self._before and state not in self._flushed:
                os.truncate(path, path.stat().st_size // 2)

    def _states(self):
        paths = (path for path in Path(self.folder).rglob("*") if path.is_file())
        return {_state(path.stat()): path for path in paths}


def _state(found):
    return found.st_ino, found.st_mtime_ns, found.st_size


_watching = []


def _hook(event, arguments):
    if not _watching:
        return
    if event in _CHANGING or (event == "open" and arguments[2] & _WRITING):
        _watching[0].event(event, arguments[0])


sys.addaudithook(_hook)


@contextmanager
def watched(disk):
    """Report the events of the block to `disk`."""

    def flush(descriptor):
        disk.event("fsync", disk.folder)
        disk.flushed(descriptor)  # the disk itself need not wait for it

    with mock.patch("os.fsync", flush):
        _watching.append(disk)
        try:
            yield disk
        finally:
            _watching.clear()


def killed_everywhere(folder, write, *, power=False):
    """Run `write` killed at event 0, then at 1, and so on, until it ends by itself.

    Yields the number of the event after each kill (with `power`, after a power cut), and at last
    None. What is checked or put right in between is up to the caller.
    """
    kill_at = 0
    while True:
        disk = Disk(folder, kill_at)
        try:
            with watched(disk):
                write()
        except Killed:
            if power:
                disk.lose_power()
            yield kill_at
            kill_at += 1
        else:
            yield None
            return
