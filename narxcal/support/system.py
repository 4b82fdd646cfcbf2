"""What an operating system has to do: exchange two names in one step, lock a folder, free memory.

Written for Linux, macOS and Windows. Locks end with the process that holds them, however it ends,
and are meant for local file systems.
"""

from __future__ import annotations

import ctypes
import errno
import os
import socket
import sys
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from narxcal.support.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Iterator

# <linux/fs.h>: RENAME_EXCHANGE; <sys/stdio.h> of macOS: RENAME_SWAP; both are 2.
_EXCHANGE = 2
# <fcntl.h> of Linux: "relative to the working directory".
_AT_FDCWD = -100
_NOT_OFFERED = {errno.ENOSYS, errno.EINVAL, errno.ENOTSUP, errno.EPERM}
# <winnt.h>, <winerror.h>
_QUERY_LIMITED_INFORMATION, _ACCESS_DENIED = 0x1000, 5


def exchange(first: Path, second: Path) -> bool:
    """Exchange two existing files or folders of one file system in one step.

    Returns False, with nothing changed, where system or file system offers no such step.

    Raises `OSError` as a renaming does.
    """
    if sys.platform == "win32":
        return False
    libc = ctypes.CDLL(None, use_errno=True)
    names = os.fsencode(first), os.fsencode(second)
    if hasattr(libc, "renameat2"):
        failed = libc.renameat2(_AT_FDCWD, names[0], _AT_FDCWD, names[1], _EXCHANGE)
    elif hasattr(libc, "renamex_np"):
        failed = libc.renamex_np(*names, _EXCHANGE)
    else:
        return False
    if not failed:
        return True
    number = ctypes.get_errno()
    if number in _NOT_OFFERED:
        return False
    raise OSError(number, os.strerror(number), str(first))


def release_memory() -> None:
    """Give freed memory back to the system, where its C library (glibc) would keep it.

    It holds arrays of one size as scraps between those that stay: half a gigabyte after reading a
    flight of fifty hours.
    """
    if sys.platform != "win32" and hasattr(libc := ctypes.CDLL(None), "malloc_trim"):
        libc.malloc_trim(0)


def is_running(pid: int) -> bool:
    """Whether a process of this machine has the number `pid`."""
    if sys.platform == "win32":
        # os.kill would end the process here.
        kernel = ctypes.WinDLL("kernel32", use_last_error=True)
        process = kernel.OpenProcess(_QUERY_LIMITED_INFORMATION, 0, pid)
        if not process:
            return bool(ctypes.get_last_error() == _ACCESS_DENIED)
        kernel.CloseHandle(process)
        return True
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


@contextmanager
def marked_alive(descriptor: int) -> Iterator[None]:
    """Lock an open file or folder while the block runs, so that `is_abandoned` denies it."""
    _lock(descriptor)
    yield


@contextmanager
def folder_alive(folder: Path) -> Iterator[None]:
    """As `marked_alive`, of a folder; where the system opens no folder, its process is the mark."""
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except OSError:
        yield
        return
    try:
        _lock(descriptor)
        yield
    finally:
        os.close(descriptor)


def is_abandoned(path: Path, pid: int) -> bool:
    """Whether nobody writes a temporary file or folder that process `pid` began.

    The number alone does not say: in another container that shares the disk it is that of another
    process, or of none. Who writes holds a lock on it, which ends with the process.
    """
    if is_running(pid):
        return False
    try:
        descriptor = os.open(path, os.O_RDONLY)
    except OSError:
        return True
    try:
        return _lock(descriptor)
    finally:
        os.close(descriptor)


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
