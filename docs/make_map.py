"""Writes docs/map.md: every module of every room, with the start of its own docstring.

Run `make map` after adding or renaming a module; the tests compare.
"""

from __future__ import annotations

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("narxcal", "data_prep", "training", "eval")
HEAD = """\
# Map of the modules

By room, from the roof down as imports go: of every module the start of its docstring. Each command
is a module of `narxcal/cli/`. Written by `make map`.
"""
_SHORTEST = 24  # characters: a shorter head, such as "Prepare logs: ...", needs what follows


def rooms() -> dict[str, list[Path]]:
    """Modules of each room: `room` is the folder, relative to the repository."""
    found: dict[str, list[Path]] = {}
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            if path.name not in ("__init__.py", "__main__.py"):
                room = path.parent.relative_to(ROOT).as_posix()
                found.setdefault(room, []).append(path)
    return dict(sorted(found.items(), key=lambda item: _floor(item[0])))


def page() -> str:
    """Text of the page."""
    parts = [HEAD]
    for room, modules in rooms().items():
        said = {path.stem: _purpose(path) for path in modules}
        rows = [f"- `{k}`: {_head(v)}" for k, v in said.items() if not v.startswith("`narxcal ")]
        parts.append("\n".join([f"## `{room}/`", "", *rows, ""]))
    return "\n".join(parts)


def _floor(room: str) -> tuple[int, str]:
    order = ("narxcal/cli", "eval", "training", "data_prep", "narxcal")
    return next(k for k, top in enumerate(order) if room.startswith(top)), room


def _head(purpose: str) -> str:
    """Give the text up to its first colon, semicolon or full stop that leaves enough of it."""
    for end in re.finditer(r"[:;.] ", purpose):
        if end.start() >= _SHORTEST:
            return purpose[: end.start()]
    return purpose


def _purpose(path: Path) -> str:
    text = ast.get_docstring(ast.parse(path.read_text("utf-8"))) or ""
    return text.split("\n\n", maxsplit=1)[0].replace("\n", " ").removesuffix(".").replace("|", "/")


if __name__ == "__main__":
    (ROOT / "docs" / "map.md").write_text(page(), encoding="utf-8")
