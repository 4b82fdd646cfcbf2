"""Writes files and folders whole or not at all.

Everything is written under a temporary name in the target's own folder and renamed once it
is complete and on the disk, so that a full disk or a killed run never leaves half a file
under a name that is taken for good. A run killed outright can leave a temporary
(`.NAME.*.part`, or `NAME.part` of a live one) behind; nothing ever reads one.

Versions of Python and of the packages that decide what a model computes.

Where commands put their results, and what they refuse to overwrite.
"""

from __future__ import annotations

import errno
import json
import math
import os
import secrets
import shutil
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from narxcal.support.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from os import PathLike
    from typing import IO, Any, TextIO
import platform
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version

_DISK_ERRORS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS}


def atomic_write_bytes(path: str | PathLike[str], data: bytes) -> None:
    """Write `data` to `path`, replacing what was there only once all of it is on the disk.

    Raises `ConfigError` if it cannot be written; the former file is then untouched.
    """
    target = Path(path)
    part = _beside(target, "part")
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
    named `NAME.part` until then, so that others can read it while it grows.

    Raises `ConfigError` if it cannot be written, and for a `NAME.part` that is there already.
    """
    target = Path(path)
    part = target.with_name(f"{target.name}.part") if live else _beside(target, "part")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        stream = part.open("x", encoding="utf-8", newline="")
    except FileExistsError as error:
        if not live or not part.exists():
            raise cannot_write(target, error) from None
        hint = "Another run writes it, or one was killed: remove it, or choose another name"
        raise ConfigError("the file exists", file=part, hint=hint) from None
    except OSError as error:
        raise cannot_write(target, error) from None
    with _becoming(target, part), stream:
        yield stream
        _flush(stream)


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


def _flush(stream: IO[Any]) -> None:
    stream.flush()
    os.fsync(stream.fileno())


@contextmanager
def atomic_folder(path: str | PathLike[str], replace: bool = False) -> Iterator[Path]:
    """Yield an empty temporary folder that becomes `path` when the block ends well.

    On any error, Ctrl-C included, the temporary folder is removed and `path` stays as it
    was. An existing folder with content is refused; with `replace`, one that narxcal wrote
    is moved aside, and deleted only after the new one stands.

    Raises `ConfigError` as `check_output_folder`, and if the disk refuses the content.
    """
    target = Path(path)
    check_output_folder(target, replace)
    part = _beside(target, "part")
    try:
        part.mkdir(parents=True)
    except OSError as error:
        raise cannot_write(target, error) from None
    try:
        yield part
        _sync(part)
        _swap_in(part, target)
    except OSError as error:
        # What else fails inside the block (a log that cannot be read) is not about writing.
        if error.errno in _DISK_ERRORS:
            raise cannot_write(target, error) from None
        raise
    finally:
        shutil.rmtree(part, ignore_errors=True)


def check_output_folder(path: str | PathLike[str], replace: bool = False) -> None:
    """Refuse, before any work is done, a folder that must not or cannot be written to.

    Raises `ConfigError` as `check_writable`, for a file, for a folder with content, and, under
    `replace`, for a folder in which narxcal wrote nothing.
    """
    target = Path(path)
    check_writable(target)
    if not target.exists() and not target.is_symlink():
        return
    if not target.is_dir():
        raise ConfigError(f"output folder {target} is not a folder", hint="Choose another name")
    if not any(target.iterdir()):
        return
    if not replace:
        raise ConfigError(
            f"output folder {target} exists and is not empty",
            hint="Choose another name, or allow it to be overwritten",
        )
    if not _is_ours(target):
        raise ConfigError(
            f"output folder {target} holds other content and is not overwritten",
            hint="Choose another name, or empty it yourself",
        )


def check_writable(path: str | PathLike[str]) -> None:
    """Refuse, before any work is done, a place whose disk takes nothing; leaves nothing there.

    Raises `ConfigError` as the writing itself would.
    """
    target = Path(path).absolute()
    ground = next(folder for folder in target.parents if folder.exists())
    probe = _beside(ground / target.name, "part")
    try:
        probe.mkdir()
        probe.rmdir()
    except OSError as error:
        raise cannot_write(Path(path), error) from None


def _is_ours(folder: Path) -> bool:
    """Whether a JSON file in `folder` bears one of narxcal's schemas."""
    for file in folder.glob("*.json"):
        try:
            document = json.loads(file.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            continue
        if isinstance(document, dict) and str(document.get("schema")).startswith("narxcal."):
            return True
    return False


def _swap_in(part: Path, target: Path) -> None:
    """Rename `part` to `target`; content there is moved aside first and deleted last."""
    if not target.exists() or not any(target.iterdir()):
        part.replace(target)
        return
    aside = _beside(target, "old")
    target.replace(aside)
    try:
        part.replace(target)
    except OSError:
        aside.replace(target)
        raise
    shutil.rmtree(aside, ignore_errors=True)


def _sync(folder: Path) -> None:
    for file in folder.rglob("*"):
        if file.is_file():
            with file.open("rb") as stream:
                os.fsync(stream.fileno())


def _beside(target: Path, suffix: str) -> Path:
    """Make up a name that nobody else uses, in the folder of `target`."""
    return target.with_name(f".{target.name}.{secrets.token_hex(6)}.{suffix}")


def cannot_write(target: Path, error: OSError) -> ConfigError:
    """What to tell whose disk refused `target`, which is as it was."""
    full = "free some space or choose" if error.errno in _DISK_ERRORS else "choose"
    return ConfigError(
        f"cannot write: {error.strerror or error}",
        file=target,
        hint=f"Nothing was changed; {full} another place",
    )


_PACKAGES = ("narxcal", "numpy", "scipy", "torch", "safetensors")


def finite(value: Any) -> Any:
    """Copy a document with None for every float that is not finite; JSON has no NaN."""
    if isinstance(value, Mapping):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def to_json(document: Mapping[str, Any]) -> str:
    """Format as JSON with a final line feed; what is not a finite number becomes null."""
    return json.dumps(finite(document), indent=1, allow_nan=False) + "\n"


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that decide what a model computes."""
    found = {"python": platform.python_version()}
    for package in _PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:  # run from a checkout that is not installed
            found[package] = "unknown"
    return found


def check_file(out: Path, *inputs: Path) -> None:
    """Refuse, before any work is done, to write a file in the place of a folder or of an input.

    Raises `ConfigError`.
    """
    if out.is_dir():
        raise ConfigError(
            f"output file {out} is a folder", hint=f"Name a file, such as {out / 'out.csv'}"
        )
    if any(out.exists() and each.exists() and out.samefile(each) for each in inputs):
        raise ConfigError(f"output file {out} is the input itself", hint="Choose another name")
    check_writable(out)


@dataclass(frozen=True)
class Results:
    """A folder of results: what a command puts there, told by `document` and its `schema`.

    `document` is the JSON file every such folder has, `others` further names at its top.
    """

    schema: str
    document: str
    others: tuple[str, ...]

    def check(self, folder: Path) -> None:
        """Refuse, before any work is done, a folder with content that this command never wrote.

        Raises `ConfigError`, also for one that cannot be written.
        """
        check_writable(folder)
        if not folder.exists():
            return
        if not folder.is_dir():
            raise ConfigError(f"output folder {folder} is not a folder", hint="Choose another name")
        found = sorted(entry.name for entry in folder.iterdir())
        foreign = [name for name in found if name not in (self.document, *self.others)]
        if foreign or (found and not self._ours(folder)):
            raise ConfigError(
                f"output folder {folder} holds other content ('{(foreign or found)[0]}') "
                "and is not overwritten",
                hint="Choose another name, or empty it yourself",
            )

    @contextmanager
    def writing(self, folder: Path) -> Iterator[Path]:
        """Yield a temporary folder that takes the place of `folder` when the block ends well."""
        self.check(folder)
        with atomic_folder(folder, replace=True) as part:
            yield part

    def _ours(self, folder: Path) -> bool:
        try:
            document = json.loads((folder / self.document).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return False
        return isinstance(document, dict) and document.get("schema") == self.schema
