"""Output files and folders: written whole or not at all, and never over what is not narxcal's.

A file or folder is written under a temporary name next to its target, flushed to the disk, and then
takes the target's name, so that a full disk or a killed process leaves the former content or the
new one. Temporaries are called `.NAME.TOKEN.part`; a folder that is replaced waits as
`.NAME.TOKEN.old` for the new one to stand. `recover` puts right what a killed process left; every
check of an output calls it first. Of commands that write one output one runs (`cli.app.locked`).

Commands check where they are to write before they begin: `check_file`, `Results.check`.
"""

from __future__ import annotations

import errno
import hashlib
import json
import math
import os
import platform
import re
import secrets
import shutil
import stat
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from os import PathLike
from pathlib import Path
from typing import IO, Any, TextIO

from narxcal.support.errors import ConfigError

STDOUT = Path("-")
_DISK_ERRORS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS}


# --- writing ---


def atomic_write_bytes(path: str | PathLike[str], data: bytes) -> None:
    """Write `data` to `path`, replacing what was there only once all of it is on the disk.

    `-` is the standard output; a device, a pipe or a socket is written to as it is.
    """
    target = Path(path)
    if in_place(target):
        with _reported(target), _opened_in_place(target) as stream:
            stream.buffer.write(data)
        return
    recover(target)
    part = _temporary(target, "part")
    with _becoming(target, part):
        target.parent.mkdir(parents=True, exist_ok=True)
        with part.open("xb") as stream:
            stream.write(data)
            _flush(stream)


def atomic_write_text(path: str | PathLike[str], text: str) -> None:
    """Write `text` as UTF-8 to `path` like `atomic_write_bytes`."""
    atomic_write_bytes(path, text.encode("utf-8"))


@contextmanager
def atomic_stream(path: str | PathLike[str], *, live: bool = False) -> Iterator[TextIO]:
    """Yield a UTF-8 text file that becomes `path` when the block ends well.

    On any error, Ctrl-C included, it is removed and `path` stays as it was. A `live` one is
    named `NAME.part` until then, so that others can read it while it grows. `-`, devices and pipes
    are written in place.
    """
    target = Path(path)
    if in_place(target):
        with _reported(target), _opened_in_place(target) as stream:
            yield stream
        return
    part = target.with_name(f"{target.name}.part") if live else _temporary(target, "part")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        stream = part.open("x", encoding="utf-8", newline="")
    except FileExistsError as error:
        if not live or not part.exists():
            raise cannot_write(target, error) from None
        hint = "Another command writes it, or one was killed: remove it, or choose another name"
        raise ConfigError("the file exists", file=part, hint=hint) from None
    except OSError as error:
        raise cannot_write(target, error) from None
    with _becoming(target, part), stream:
        yield stream
        _flush(stream)


@contextmanager
def atomic_folder(path: str | PathLike[str], replaced: Results | None = None) -> Iterator[Path]:
    """Yield an empty temporary folder that becomes `path` when the block ends well.

    On any error, Ctrl-C included, the temporary folder is removed and `path` stays as it
    was. An existing folder with content is refused, unless it is a `replaced` one that holds
    nothing else: that is deleted once the new one stands.
    """
    target = check_output_folder(path, replaced)
    part = _temporary(target, "part")
    try:
        part.mkdir(parents=True)
    except OSError as error:
        raise cannot_write(target, error) from None
    try:
        yield part
        _flush_folder(part)
        _replace_folder(part, target)
    except OSError as error:
        # What else fails inside the block (a log that cannot be read) is not about writing.
        if error.errno in _DISK_ERRORS:
            raise cannot_write(target, error) from None
        raise
    finally:
        shutil.rmtree(part, ignore_errors=True)


def recover(path: str | PathLike[str]) -> None:
    """Put right what killed processes left next to `path`.

    A former folder is put back where its successor never took the name; else leftovers are deleted.
    """
    target = Path(path)
    leftovers = re.compile(rf"\.{re.escape(target.name)}\.[0-9a-f]+\.(part|old)")
    with suppress(OSError):
        for entry in sorted(target.parent.iterdir()):
            named = leftovers.fullmatch(entry.name)
            if named is None:
                continue
            if named[1] == "old" and not os.path.lexists(target):
                entry.replace(target)
            elif entry.is_dir():
                shutil.rmtree(entry, ignore_errors=True)
            else:
                entry.unlink()


# --- checks before any work ---


def check_file(out: Path, *inputs: Path, overwrite: bool = False) -> None:
    """Refuse, before any work is done, a file that must not or cannot be written.

    `inputs` are files and folders that the command reads: nothing there is ever written over.
    `-`, devices and pipes are good as they are.
    """
    if in_place(out):
        return
    if out.is_dir():
        raise ConfigError(
            f"output file {out} is a folder", hint=f"Name a file, such as {out / 'out.csv'}"
        )
    recover(out)
    if out.is_symlink() and not out.exists():
        raise ConfigError(
            f"output file {out} is a link that leads nowhere", hint="Choose another name"
        )
    if out.exists():
        for each in inputs:
            _check_not_read(out, each)
        if not overwrite:
            raise ConfigError(
                f"output file {out} exists", hint="Add --overwrite, or choose another name"
            )
    check_writable(out)


def _check_not_read(out: Path, read: Path) -> None:
    if not read.exists():
        return
    if read.is_dir() and out.resolve().is_relative_to(read.resolve()):
        raise ConfigError(
            f"output file {out} is part of {read}, which is read", hint="Choose another name"
        )
    if out.samefile(read):
        raise ConfigError(f"output file {out} is the input itself", hint="Choose another name")


def check_output_folder(path: str | PathLike[str], replaced: Results | None = None) -> Path:
    """Refuse, before any work is done, a folder that must not or cannot be written to.

    Returns the folder itself where `path` is a link to one.

    Raises `ConfigError` as `check_writable`, for a file, for one that cannot be exchanged (the
    working directory, a mount), and for a folder with content, unless that is what `replaced` says
    and nothing else.
    """
    target = Path(os.path.realpath(path))
    recover(target)
    if Path(path).is_symlink() and not target.exists():
        raise ConfigError(
            f"output folder {path} is a link that leads nowhere", hint="Choose another name"
        )
    if target.exists():
        _check_folder(Path(path), target)
        if any(target.iterdir()):
            if replaced is None:
                raise ConfigError(
                    f"output folder {path} exists and is not empty",
                    hint="Choose another name, or allow it to be overwritten",
                )
            replaced.check_content(Path(path), target)
    check_writable(target)
    return target


def _check_folder(path: Path, target: Path) -> None:
    if not target.is_dir():
        raise ConfigError(f"output folder {path} is not a folder", hint="Choose another name")
    if Path.cwd().is_relative_to(target):
        what = "is the working directory, or holds it"
    elif target.is_mount():
        what = "is where a disk is mounted"
    else:
        return
    raise ConfigError(f"output folder {path} {what}", hint=f"Name one below it: {path / 'out'}")


def check_writable(path: str | PathLike[str]) -> None:
    """Refuse, before any work is done, a place whose disk takes nothing; leaves nothing there."""
    target = Path(path).absolute()
    ground = next(folder for folder in (*target.parents, target) if folder.exists())
    probe = _temporary(ground / target.name, "part")
    try:
        probe.mkdir()
        probe.rmdir()
    except OSError as error:
        raise cannot_write(Path(path), error) from None


@dataclass(frozen=True)
class Results:
    """A folder of results: what a command writes there, known by `document` and its `schema`.

    `document` is the JSON file that every such folder has, `others` further names at its top, and
    `pattern` a regular expression of names of which there may be any number.
    """

    schema: str
    document: str
    others: tuple[str, ...] = ()
    pattern: str = ""

    def check(self, folder: Path) -> None:
        """Refuse, before any work is done, a folder with content that this command never wrote."""
        check_output_folder(folder, self)

    def check_content(self, folder: Path, target: Path) -> None:
        """Refuse a folder that holds anything else than this; `folder` is its name to the user.

        `others` that end in `/*` are folders of files. Raises `ConfigError`.
        """
        folders = {name[:-2] for name in self.others if name.endswith("/*")}
        foreign = [
            str(entry.relative_to(target))
            for entry in sorted(target.iterdir())
            if entry.name not in {self.document, *self.others, *folders}
            and not re.fullmatch(self.pattern, entry.name)
        ]
        for name in folders:
            inner = target / name
            within = sorted(inner.iterdir()) if inner.is_dir() else []
            foreign += [f"{name}/{each.name}" for each in within if not each.is_file()]
        if not foreign and has_schema(target / self.document, self.schema):
            return
        found = foreign or sorted(entry.name for entry in target.iterdir())
        raise ConfigError(
            f"output folder {folder} holds other content ('{found[0]}') and is not overwritten",
            hint="Choose another name, or empty it yourself",
        )

    @contextmanager
    def writing(self, folder: Path) -> Iterator[Path]:
        with atomic_folder(folder, self) as part:
            yield part

    def write(self, folder: Path, document: Mapping[str, Any], *pages: str) -> None:
        """Write the document into a folder, and the pages, which come first in `others`."""
        (folder / self.document).write_text(to_json(document), encoding="utf-8")
        for name, page in zip(self.others, pages, strict=False):
            (folder / name).write_text(page, encoding="utf-8")

    def save(self, folder: Path, document: Mapping[str, Any], *pages: str) -> None:
        with self.writing(folder) as part:
            self.write(part, document, *pages)


# --- content ---


def to_json(document: Mapping[str, Any]) -> str:
    """Format as JSON with a final line feed; what is not a finite number becomes null."""
    return json.dumps(finite(document), indent=1, allow_nan=False) + "\n"


def finite(value: Any) -> Any:
    """Copy of what JSON can hold, with null for numbers that are not finite."""
    if isinstance(value, Mapping):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def has_schema(file: Path, schema: str) -> bool:
    """Whether a JSON file bears a schema that is `schema`, or begins so where that ends in '.'."""
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return False
    found = document.get("schema") if isinstance(document, dict) else None
    return found == schema or (schema[-1] in "/." and str(found).startswith(schema))


def is_file(path: Path) -> bool:
    """Whether there is such a file; a name that the system refuses, such as a long one, is none."""
    return os.path.isfile(path)  # noqa: PTH113 -- `Path.is_file` raises for such a name


def is_folder(path: Path) -> bool:
    """Whether there is such a folder, as `is_file`."""
    return os.path.isdir(path)  # noqa: PTH112 -- likewise


def sha256_of(path: str | PathLike[str]) -> str:
    """Hash of a file's content, in bounded memory."""
    with Path(path).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that decide what a model computes."""
    found = {"python": platform.python_version()}
    for package in ("narxcal", "numpy", "scipy", "torch", "safetensors"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:  # run from a checkout that is not installed
            found[package] = "unknown"
    return found


def cannot_write(target: Path, error: OSError) -> ConfigError:
    """Describe why the disk refused `target`, which is as it was."""
    full = "free some space or choose" if error.errno in _DISK_ERRORS else "choose"
    return ConfigError(
        f"cannot write: {error.strerror or error}",
        file=target,
        hint=f"Nothing was changed; {full} another place",
    )


# --- inner steps ---


def in_place(target: Path) -> bool:
    """Whether `target` is nothing that could be replaced: `-`, a device, a pipe, a socket."""
    if target == STDOUT:
        return True
    try:
        mode = target.stat().st_mode
    except OSError:
        return False
    return not (stat.S_ISREG(mode) or stat.S_ISDIR(mode))


@contextmanager
def _opened_in_place(target: Path) -> Iterator[Any]:
    if target == STDOUT:
        yield sys.stdout
        sys.stdout.flush()
        return
    with target.open("w", encoding="utf-8", newline="") as stream:
        yield stream


@contextmanager
def _reported(target: Path) -> Iterator[None]:
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        raise cannot_write(target, error) from None


@contextmanager
def _becoming(target: Path, part: Path) -> Iterator[None]:
    """Rename `part` to `target` when the block ends well; either way it is gone then."""
    try:
        yield
        part.replace(target)
    except OSError as error:
        raise cannot_write(target, error) from None
    finally:
        with suppress(OSError):
            part.unlink()


def _replace_folder(part: Path, target: Path) -> None:
    """Give `part` the name of `target`; what was there is deleted once the new folder stands."""
    if not target.exists() or not any(target.iterdir()):
        part.replace(target)
        return
    former = part.with_suffix(".old")
    target.replace(former)
    try:
        part.replace(target)
    except OSError:
        former.replace(target)
        raise
    shutil.rmtree(former, ignore_errors=True)


def _temporary(target: Path, suffix: str) -> Path:
    """Name that nobody else uses, in the folder of `target`; `recover` knows it."""
    return target.with_name(f".{target.name}.{secrets.token_hex(6)}.{suffix}")


def _flush(stream: IO[Any]) -> None:
    stream.flush()
    os.fsync(stream.fileno())


def _flush_folder(folder: Path) -> None:
    for file in folder.rglob("*"):
        if file.is_file():
            with file.open("rb") as stream:
                os.fsync(stream.fileno())
