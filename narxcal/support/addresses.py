"""Folders by fsspec address: paths of this machine, `s3://`, `gs://`, `memory://` and others.

A file is written whole or not at all: here as `narxcal.support.files` does, in object stores by
one upload, which is atomic there, elsewhere under another name first.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from narxcal.support.errors import ConfigError, DataError, NarxcalError
from narxcal.support.files import atomic_write_bytes

_SCHEMES = ("abfs", "az", "gcs", "gs", "memory", "s3", "s3a", "sftp")
_ATOMIC = {"s3", "s3a", "gs", "gcs", "az", "abfs", "memory"}


def is_local(address: str) -> bool:
    """Whether it is a path of this machine, with or without `file://`."""
    return "://" not in address or address.startswith(("file://", "local://"))


@dataclass(frozen=True)
class Folder:
    """A folder at an address; names of files in it are relative, with `/`.

    What the address needs but lacks (a package, an account, the network) is a `ConfigError`.
    """

    address: str

    def __getstate__(self) -> dict[str, str]:
        """Send the address alone to other processes: what it opens may need what they lack."""
        return {"address": self.address}

    @cached_property
    def _place(self) -> tuple[Any, str]:
        from fsspec.core import url_to_fs  # noqa: PLC0415 -- comes with torch; help does not wait

        hint = "Name a folder, or an address such as s3://BUCKET/FOLDER"
        scheme = self.address.partition("://")[0]
        # Of others some connect before anything is asked of them, and some run what they name.
        if not is_local(self.address) and scheme not in _SCHEMES:
            problem = f"expected a path or an address of {', '.join(_SCHEMES)}, found {scheme}://"
            raise ConfigError(problem, file=self.address, hint=hint)
        try:
            files, root = url_to_fs(self.address)
        except Exception as error:  # noqa: BLE001 -- each store raises what it likes
            raise ConfigError(f"cannot be opened: {error}", file=self.address, hint=hint) from None
        return files, root.rstrip("/")

    @property
    def local(self) -> Path | None:
        """Its path, if it is one of this machine."""
        return Path(self._place[1]) if is_local(self.address) else None

    def below(self, name: str) -> Folder:
        return Folder(f"{self.address.rstrip('/')}/{name}")

    def sizes(self, patterns: Sequence[str]) -> dict[str, int]:
        """Name -> bytes of the files that match a pattern (`*`, `**`), in order of name."""
        files, root = self._place
        found: dict[str, int] = {}
        for pattern in patterns:
            with self._reported(pattern):
                matches = files.glob(f"{root}/{pattern}", detail=True)
            for path, facts in matches.items():
                if facts["type"] == "file":
                    found[path[len(root) + 1 :]] = int(facts["size"])
        return dict(sorted(found.items()))

    def has(self, name: str) -> bool:
        files, root = self._place
        with self._reported(name):
            return bool(files.isfile(f"{root}/{name}"))

    def read(self, name: str) -> bytes:
        """Content of a file; raises `DataError` where there is none."""
        files, root = self._place
        with self._reported(name):
            content: bytes = files.cat_file(f"{root}/{name}")
        return content

    def write(self, name: str, content: bytes) -> None:
        """Write a file whole or not at all; raises `ConfigError` if it cannot be written."""
        files, root = self._place
        if is_local(self.address):
            atomic_write_bytes(f"{root}/{name}", content)
            return
        target = f"{root}/{name}"
        try:
            files.makedirs(target.rpartition("/")[0], exist_ok=True)
            if self.address.partition("://")[0] in _ATOMIC:
                files.pipe_file(target, content)
            else:
                files.pipe_file(f"{target}.part", content)
                files.mv(f"{target}.part", target)
        except Exception as error:  # noqa: BLE001 -- each store raises what it likes
            raise ConfigError(f"cannot write: {error}", file=f"{self.address}/{name}") from None

    @contextmanager
    def on_disk(self, name: str) -> Iterator[Path]:
        """Path of a file or folder: itself, or a copy that is removed when the block ends."""
        files, root = self._place
        if is_local(self.address):
            yield Path(root) / name
            return
        with tempfile.TemporaryDirectory(prefix="narxcal-") as folder:
            path = Path(folder) / (name.rpartition("/")[2] or "copy")
            source = f"{root}/{name}".rstrip("/")
            with self._reported(name):
                files.get(source, str(path), recursive=files.isdir(source))
            yield path

    @contextmanager
    def _reported(self, name: str) -> Iterator[None]:
        try:
            yield
        except NarxcalError:
            raise
        except Exception as error:  # noqa: BLE001 -- each store raises what it likes
            place = f"{self.address.rstrip('/')}/{name}"
            why = getattr(error, "strerror", None) or error
            raise DataError(f"cannot be read: {why}", file=place) from None
