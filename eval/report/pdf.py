"""Pages of a PDF: text, tables and axes on A4, in millimetres from the top left corner.

Fonts are embedded as TrueType and text stays text, so that it can be searched. The same pages give
the same bytes: no date, no path, no random name is written.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Any, Literal, NamedTuple

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont, get_font
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.textpath import text_to_path
from matplotlib.transforms import Affine2D

from eval.report.style import RENDERING

WIDTH, HEIGHT = 210.0, 297.0  # A4
LEFT, RIGHT, TOP, BOTTOM = 20.0, 195.0, 24.0, 279.0  # what a page may fill
BODY, SMALL = 7.5, 6.5  # points
INK, QUIET, RULE = "#16191d", "#57606a", "#8c959f"
_MM, _POINT_MM = 1.0 / 25.4, 25.4 / 72.0
_LEADING = 1.32
_FAMILY = "DejaVu Sans"  # comes with the plotting library: the same letters on every machine
_RC: Any = {
    "pdf.fonttype": 42, "pdf.compression": 9, "font.family": [_FAMILY], "axes.unicode_minus": True,
    "path.simplify": True, "path.simplify_threshold": 0.111, "text.usetex": False,
}  # fmt: skip
Align = Literal["left", "center", "right"]


class Column(NamedTuple):
    """One column of a table: its title, width in mm and alignment."""

    title: str
    width: float
    align: Align = "left"


class Page:
    """One page that is filled from the top; `y` is where the next block begins, in mm."""

    def __init__(self, header: tuple[str, str], footer: str) -> None:
        self.figure = Figure(figsize=(WIDTH * _MM, HEIGHT * _MM), facecolor="white")
        down = Affine2D().scale(1.0 / WIDTH, -1.0 / HEIGHT).translate(0.0, 1.0)
        self._mm = down + self.figure.transFigure
        self.y = TOP
        left, right = header
        self.text((LEFT, 15.5), left, size=SMALL, color=QUIET)
        self.text((RIGHT, 15.5), right, size=SMALL, align="right", color=QUIET)
        self.rule(19.0)
        self.rule(282.5)
        self.text((LEFT, 284.0), footer, size=SMALL - 0.5, color=QUIET)

    @property
    def room(self) -> float:
        """Height in mm that is still free."""
        return BOTTOM - self.y

    def text(
        self,
        at: tuple[float, float],
        text: str,
        size: float = BODY,
        align: Align = "left",
        **look: Any,
    ) -> None:
        """Write one line whose top is at (x, y) in mm; `look` are color and weight."""
        x, y = at
        self.figure.text(
            x, y + 0.8 * size * _POINT_MM, printable(text), transform=self._mm, size=size,
            ha=align, va="baseline", family=_FAMILY, parse_math=False, **({"color": INK} | look),
        )  # fmt: skip

    def rule(self, y: float, ends: tuple[float, float] = (LEFT, RIGHT)) -> None:
        """Draw a horizontal line at `y` between two ends in mm."""
        self.figure.add_artist(Line2D(ends, [y, y], color=RULE, lw=0.5, transform=self._mm))

    def box(self, at: tuple[float, float], size: tuple[float, float], colour: str) -> None:
        """Draw a frame of (width, height) mm whose top left corner is at (x, y)."""
        frame = Rectangle(at, *size, transform=self._mm, fill=False, ec=colour, lw=0.9)
        self.figure.add_artist(frame)

    def heading(self, text: str, *, size: float = 10.0) -> None:
        self.y += 2.0
        self.text((LEFT, self.y), text, size=size, weight="bold")
        self.y += size * _POINT_MM * _LEADING + 1.2

    def paragraph(
        self,
        text: str,
        *,
        size: float = BODY,
        ends: tuple[float, float] = (LEFT, RIGHT),
        colour: str = INK,
    ) -> None:
        """Write wrapped text between two ends in mm and move on."""
        for line in wrapped(text, ends[1] - ends[0], size):
            self.text((ends[0], self.y), line, size=size, color=colour)
            self.y += line_mm(size)

    def pairs(
        self, pairs: Iterable[tuple[str, str]], label: float = 32.0, size: float = BODY
    ) -> None:
        """Write labels, `label` mm wide, and their wrapped values."""
        for name, value in pairs:
            self.text((LEFT, self.y), name, size=size, color=QUIET)
            self.paragraph(value or " ", size=size, ends=(LEFT + label, RIGHT))
            self.y += 0.5

    def lines_to_fill(self, names: Iterable[str], label: float = 45.0, size: float = BODY) -> None:
        """Write names with lines on which something is written by hand."""
        for name in names:
            self.text((LEFT, self.y), name, size=size, color=QUIET)
            self.rule(self.y + line_mm(size), (LEFT + label, RIGHT))
            self.y += 9.0

    def table(
        self,
        columns: Sequence[Column],
        rows: Sequence[Sequence[str]],
        size: float = BODY - 0.5,
        bold: Sequence[int] = (),
    ) -> int:
        """Write as many rows as fit and return their number; `bold` columns stand out."""
        places, x = [], LEFT
        for column in columns:
            places.append({"left": x, "center": x + column.width / 2}.get(
                column.align, x + column.width - 1.5))  # fmt: skip
            x += column.width
        for place, column in zip(places, columns, strict=True):
            self.text((place, self.y), column.title, size=size, align=column.align, color=QUIET)
        self.y += line_mm(size) + 0.4
        self.rule(self.y)
        self.y += 0.9
        for done, row in enumerate(rows):
            cells = [wrapped(cell, column.width - 2.5, size)
                     for cell, column in zip(row, columns, strict=True)]  # fmt: skip
            height = max(map(len, cells)) * line_mm(size) + 0.5
            if height > self.room:
                return done
            for k, lines in enumerate(cells):
                for number, line in enumerate(lines):
                    self.text(
                        (places[k], self.y + number * line_mm(size)), line, size=size,
                        align=columns[k].align, weight="bold" if k in bold else "normal",
                    )  # fmt: skip
            self.y += height
        return len(rows)

    def axes(self, top: float, height: float, left: float, shared: Axes | None = None) -> Axes:
        """Add axes from `left` to the right margin, mm."""
        place = (left / WIDTH, 1.0 - (top + height) / HEIGHT, (RIGHT - left) / WIDTH,
                 height / HEIGHT)  # fmt: skip
        return self.figure.add_axes(place, sharex=shared)


def to_pdf(pages: Iterable[Page], total: int, title: str) -> bytes:
    """Return the bytes of a PDF; pages are drawn, numbered and dropped one by one."""
    buffer = io.BytesIO()
    metadata = {"Title": printable(title), "CreationDate": None, "Creator": "narxcal"}
    with RENDERING, mpl.rc_context(_RC), PdfPages(buffer, metadata=metadata) as file:
        for number, page in enumerate(pages, start=1):
            place = f"Page {number} of {total}"
            page.text((RIGHT, 284.0), place, size=SMALL, align="right", color=QUIET)
            file.savefig(page.figure)
    return buffer.getvalue()


def line_mm(size: float) -> float:
    return size * _POINT_MM * _LEADING


def wrapped(text: str, width: float, size: float) -> list[str]:
    """Divide text into lines of at most `width` mm, within a word where it is too long."""
    lines, line = [], ""
    for word in printable(text).split(" "):
        longer = f"{line} {word}" if line else word
        if width_mm(longer, size) <= width:
            line = longer
            continue
        if line:
            lines.append(line)
        line = word
        while width_mm(line, size) > width and len(line) > 1:
            cut = next(k for k in range(len(line) - 1, 0, -1)
                       if k == 1 or width_mm(line[:k], size) <= width)  # fmt: skip
            lines.append(line[:cut])
            line = line[cut:]
    return [*lines, line]


@lru_cache(maxsize=20_000)
def width_mm(text: str, size: float) -> float:
    if not text:
        return 0.0
    prop = FontProperties(family=_FAMILY, size=size)
    return (
        float(text_to_path.get_text_width_height_descent(text, prop, ismath=False)[0]) * _POINT_MM
    )


def printable(text: str) -> str:
    """Text on one line, a character that the font lacks written as `U+8D85`."""
    known = _known_letters()
    return "".join(
        one if ord(one) in known else " " if one.isspace() else f"U+{ord(one):04X}" for one in text
    )


@lru_cache(maxsize=1)
def _known_letters() -> frozenset[int]:
    letters = get_font(findfont(FontProperties(family=_FAMILY))).get_charmap()
    return frozenset(code for code in letters if chr(code).isprintable())
