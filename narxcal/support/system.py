"""What an operating system has to do: lock an output, free memory.

Written for Linux, macOS and Windows. Locks end with the process that holds them, however it ends,
and are meant for local file systems.
"""

from __future__ import annotations

import ctypes
import os
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from narxcal.support.errors import ConfigError


def release_memory() -> None:
    """Give freed memory back to the system, where its C library (glibc) would keep it.

    It holds arrays of one size as scraps between those that stay: half a gigabyte after reading a
    flight of fifty hours.
    """
    if sys.platform != "win32" and hasattr(libc := ctypes.CDLL(None), "malloc_trim"):
        libc.malloc_trim(0)


@contextmanager
def locked(target: Path) -> Iterator[None]:
    """Keep other processes that lock it from writing to `target` while the block runs.

    The lock is a file next to the target, `.NAME.lock`, that names process and machine; where its
    folder does not exist, next to the first one above that does not either.

    Raises `ConfigError` if another process has it, and `OSError` if it cannot be written.
    """
    folder = Path(os.path.realpath(target))
    while not folder.parent.exists():
        folder = folder.parent
    file = folder.with_name(f".{folder.name}.lock")
    descriptor = _acquired(file, target)
    try:
        os.truncate(file, 0)
        os.write(descriptor, f"{os.getpid()} on {socket.gethostname()}\n".encode())
        yield
    finally:
        # Removed first, so that nobody can lock a file that is about to go.
        try:
            with suppress(OSError):
                file.unlink()
        finally:
            os.close(descriptor)
        with suppress(OSError):  # Windows removes no open file
            file.unlink(missing_ok=True)


def _acquired(file: Path, target: Path) -> int:
    while True:
        descriptor = os.open(file, os.O_RDWR | os.O_CREAT, 0o644)
        if not _lock(descriptor):
            owner = os.read(descriptor, 200).decode(errors="replace").strip()
            os.close(descriptor)
            raise ConfigError(
                f"{target} is being written by another command (process {owner or 'unknown'})",
                hint="Wait for it to end, or choose another name",
            )
        # Between opening and locking, the former owner may have removed this very file.
        with suppress(OSError):
            if os.path.samestat(os.fstat(descriptor), file.stat()):
                return descriptor
        os.close(descriptor)


def _lock(descriptor: int) -> bool:
    """Lock an open file until it is closed; whether nobody else has it."""
    try:
        if sys.platform == "win32":
            import msvcrt  # noqa: PLC0415 -- of Windows alone

            os.lseek(descriptor, 1 << 30, os.SEEK_SET)  # beyond what is read
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
            os.lseek(descriptor, 0, os.SEEK_SET)
        else:
            import fcntl  # noqa: PLC0415 -- of POSIX alone

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True
