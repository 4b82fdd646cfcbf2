"""Writes docs/map.md: every module of every room, with the first line of its own docstring.

Run `make map` after adding or renaming a module; the tests compare.
"""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("narxcal", "data_prep", "training", "eval")
HEAD = """\
# Map of the modules

One table per room, from the roof down as imports go; what a module is for is the first line of its
own docstring. Written by `make map`.
"""


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
        rows = [f"| `{path.stem}` | {_purpose(path)} |" for path in modules]
        parts.append("\n".join([f"## `{room}/`", "", "| module | |", "|---|---|", *rows, ""]))
    return "\n".join(parts)


def _floor(room: str) -> tuple[int, str]:
    order = ("narxcal/cli", "eval", "training", "data_prep", "narxcal")
    return next(k for k, top in enumerate(order) if room.startswith(top)), room


def _purpose(path: Path) -> str:
    text = ast.get_docstring(ast.parse(path.read_text("utf-8"))) or ""
    return text.split("\n\n", maxsplit=1)[0].replace("\n", " ").removesuffix(".").replace("|", "/")


if __name__ == "__main__":
    (ROOT / "docs" / "map.md").write_text(page(), encoding="utf-8")
