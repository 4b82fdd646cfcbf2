"""Where commands put their results, and what they refuse to overwrite."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from narxcal.atomic import atomic_folder, check_writable
from narxcal.errors import ConfigError


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
