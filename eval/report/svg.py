"""Matplotlib figure -> small inline SVG, the same bytes for the same figure, from any thread."""

from __future__ import annotations

import hashlib
import io
import re
import threading
from dataclasses import dataclass
from typing import Any
from xml.sax.saxutils import escape, quoteattr

import matplotlib as mpl
import numpy as np
from markupsafe import Markup
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from numpy.typing import NDArray

from data_prep.log import FloatArray

AnyFloats = NDArray[np.floating[Any]]

MAX_POINTS = 1500

# rc parameters are global to the process, so only one thread may render at a time.
_RENDERING = threading.Lock()

_NO_METADATA = {"Date": None, "Creator": None, "Format": None, "Type": None}


@dataclass(frozen=True)
class Picture:
    """An inline SVG with what a reader who cannot see it is told, and its caption."""

    svg: Markup
    alt: str
    caption: str = ""


def picture(figure: Figure, alt: str, caption: str = "") -> Picture:
    """Render `figure`; text stays text (searchable) and takes the page's own font."""
    buffer = io.StringIO()
    with _RENDERING, mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "narxcal"}):
        FigureCanvasSVG(figure).print_svg(buffer, metadata=_NO_METADATA)  # type: ignore[no-untyped-call]
    return Picture(Markup(_shrink(buffer.getvalue(), alt)), alt, caption)  # noqa: S704 - our own SVG


def envelope(
    time: AnyFloats, values: FloatArray, points: int = MAX_POINTS
) -> tuple[AnyFloats, FloatArray]:
    """Thin a curve to at most `points` samples that keep every bin's minimum and maximum.

    Arrays are `(time,)`. A bin of which all samples are missing gives one NaN, so a gap stays a
    gap; an extreme value is never lost, as it would be by taking every n-th sample.
    """
    if len(values) <= points:
        return time, values
    size = -(-len(values) // (points // 2))
    bins = -(-len(values) // size)
    padded = np.full(bins * size, np.nan)
    padded[: len(values)] = values
    block = padded.reshape(bins, size)
    first = np.arange(bins) * size
    low = first + np.where(np.isnan(block), np.inf, block).argmin(axis=1)
    high = first + np.where(np.isnan(block), -np.inf, block).argmax(axis=1)
    keep = np.unique(np.concatenate([low, high]))
    return time[keep], values[keep]


def spans(time: FloatArray, flagged: np.ndarray) -> list[tuple[float, float]]:
    """(start, end) times of the runs of True in `flagged` `(time,)`."""
    if not len(time):
        return []
    edges = np.flatnonzero(np.diff(np.r_[False, flagged, False].astype(np.int8)))
    ends = np.minimum(edges[1::2], len(time) - 1)
    return list(zip(time[edges[::2]].tolist(), time[ends].tolist(), strict=True))


def _shrink(svg: str, alt: str) -> str:
    body = svg[svg.index("<svg") :]
    # The canvas style would leak out of an inline SVG to the page; the page's CSS carries it.
    body = re.sub(r"\s*<defs>\s*<style.*?</style>\s*</defs>", "", body, flags=re.DOTALL)
    body = re.sub(r"\s*<metadata>.*?</metadata>", "", body, flags=re.DOTALL)
    body = re.sub(r"font-family: [^;\"]*;? ?", "", body)
    body = re.sub(r" transform=\"rotate\(-?0 [^\"]*\"", "", body)
    body = re.sub(r"\b(?:d|x|y|transform)=\"[^\"]*\"", _hundredths, body)
    body = re.sub(r"\s*\n\s*", "\n", re.sub(r" \n(?=[LMCQzZ\"])", "", body))
    body = _private_ids(body, alt)
    box = re.search(r'width="([\d.]+)pt" height="[\d.]+pt" (viewBox="[^"]+")', body)
    width, view = (float(box[1]), box[2]) if box else (720.0, "")
    # Small drawings keep their size; wide ones take the width of the page. None gets so small that
    # its letters cannot be read: the page scrolls it instead.
    natural = f"{width * 4 / 3:.0f}px"
    limit = "" if width > 700.0 else f";max-width:{natural}"
    head = (
        f'<svg class="plot" role="img" aria-label={quoteattr(alt)} {view} '
        f'style="--natural:{natural}{limit}" xmlns="http://www.w3.org/2000/svg" '
        f'xmlns:xlink="http://www.w3.org/1999/xlink">\n<title>{escape(alt)}</title>'
    )
    return head + body[body.index(">") + 1 :]


def _hundredths(attribute: re.Match[str]) -> str:
    """Cut coordinates to 0.01 pt, far below what a printer resolves."""
    return re.sub(r"(\d+\.\d\d)\d+", r"\1", attribute[0])


def _private_ids(body: str, alt: str) -> str:
    """Drop the ids nobody refers to and make the others unique to this drawing of this name."""
    used = set(re.findall(r"(?:href=\"#|url\(#)([^\")]+)", body))
    key = hashlib.sha256((alt + body).encode()).hexdigest()[:8]
    body = re.sub(
        r" id=\"([^\"]*)\"",
        lambda match: f' id="{key}{match[1]}"' if match[1] in used else "",
        body,
    )
    return re.sub(r"(href=\"#|url\(#)", rf"\g<1>{key}", body)
