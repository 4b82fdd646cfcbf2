"""Charts of a page that zoom: all curves of a log over one time axis, with one cursor for them.

A chart is one element that holds its samples. Two scripts, the same on every page and allowed by
their hashes alone, draw it in the place of its SVG, which stays for paper and where no script runs:
uPlot (MIT licence; `vendor/`, as in its npm package) and `live.js`.

Samples are whole multiples of a decimal step, 1e-6 to 1e-5 of the range of their curve, as deflated
differences. Of a log of more than `_MOST` numbers there are the least and the largest of bins, and
its events sample by sample; the script makes of these the coarser levels that it draws.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
import sys
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from data_prep.events import PUSH, Event
from eval.report import style
from eval.report.figures import most_eventful
from eval.report.view import Curves, LogView, stretch_s
from narxcal.intervals import LEVEL
from narxcal.support.arrays import FloatArray, spans
from narxcal.support.moments import dated, elapsed
from training.responses.rules import time_bands
from training.responses.transients import AssessedEvent, Assessment

if TYPE_CHECKING:
    from eval.judging.compare import Comparison

_MOST: Final = 400_000  # numbers of a whole log
_MOST_OF_EVENTS: Final = 2_000_000
_LEAST: Final = 1e-9  # range of a curve that is shown to six digits
_MISSING: Final = 0xFFFFFFFF
_DASHES: Final[tuple[tuple[int, ...], ...]] = ((), (6, 4), (2, 3))
_PIXELS: Final = 8000  # of a stretch of missing samples, over the whole chart
_DRIVER_PX, _OUTPUT_PX, _DEVIATION_PX = 70, 160, 84


class Line(NamedTuple):
    """A curve (time,), NaN where it is interrupted; width and dashes in pixels."""

    label: str
    values: FloatArray
    colour: str
    width: float = 1.0
    dash: tuple[int, ...] = ()


class Shade(NamedTuple):
    """A stretch of time behind the curves, or a line where it has no length."""

    start_s: float
    stop_s: float
    colour: str


class Mark(NamedTuple):
    """A stretch of time that the list of a chart leads to; `state` as of an event card."""

    start_s: float
    stop_s: float
    text: str
    state: str = ""


@dataclass(frozen=True, eq=False)
class Panel:
    """Curves over one axis of values; with `band` the first two are the ends of an interval."""

    label: str
    lines: Sequence[Line]
    height_px: int
    shades: Sequence[Shade] = ()
    band: bool = False


@dataclass(frozen=True, eq=False)
class Chart:
    """Panels over one uniform time axis (time,).

    With a `clock`, the axis is of seconds with that label; without, it is the time of a log.
    """

    time_s: FloatArray
    panels: Sequence[Panel]
    marks: Sequence[Mark] = ()
    clock: str = ""


def of_log(view: LogView) -> Markup:
    """Chart of a whole log: driver, outputs as measured and in free run, deviation, events."""
    log, at_s = view.log, view.scored_from_s
    scored = [] if at_s is None else [Shade(at_s, at_s, style.MEASURED)]
    begins = [_begin(each.event) for each in view.events]
    panels = [_driver(log[view.driver], view.driver, begins + scored)]
    for curves in view.curves():
        panels += _output(log.time_s, curves, scored)
    marks = [_mark(log.time_s, each.event, each.move, each.ok) for each in view.events]
    return html(Chart(log.time_s, panels, marks))


def of_event(view: LogView, one: AssessedEvent) -> Markup:
    """Chart of one event over the time after the lever moved, with its Ti/Tt windows."""
    rows, t0_s = view.rows(one.event), one.event.start_s
    time_s = view.log.time_s[rows] - t0_s
    panels = [_driver(view.log[view.driver][rows], view.driver, [Shade(0.0, 0.0, style.DRIVER)])]
    for curves in view.curves(rows):
        panels += _output(time_s, curves, _windows(one.of(curves.name), t0_s))
    return html(Chart(time_s, panels, clock="time after the lever moved [s]"))


def of_runs(found: Comparison) -> Markup:
    """Chart of the free runs of all models over one log, as measured on top."""
    one = most_eventful(found)
    panels, count = [], len(style.CYCLE)
    for k, name in enumerate(one.channels):
        runs = {row.run: one.outputs[row.run][:, k] for row in found.rows}
        lines = [
            Line(run, values, style.CYCLE[n % count], 1.2, _DASHES[n // count % len(_DASHES)])
            for n, (run, values) in enumerate(runs.items())
            if np.isfinite(values).any()
        ]
        lines.append(Line("measured", one.measured[:, k], style.MEASURED))
        panels.append(Panel(style.with_unit(name), lines, _OUTPUT_PX))
    marks = [
        _mark(one.time_s, event, f"{event.speed} {'push' if event.label == PUSH else 'pull'}", None)
        for event in one.events
    ]
    return html(Chart(one.time_s, panels, marks))


def _driver(values: FloatArray, name: str, shades: Sequence[Shade]) -> Panel:
    return Panel(
        style.with_unit(name), [Line("driver", values, style.DRIVER, 1.2)], _DRIVER_PX, shades
    )


def _begin(event: Event) -> Shade:
    colour = style.BAD if event.label == PUSH else style.MODEL
    return Shade(event.start_s, event.start_s, colour)


def _mark(time_s: FloatArray, event: Event, move: str, ok: bool | None) -> Mark:
    state = {True: "pass", False: "fail", None: ""}[ok]
    after = elapsed(event.start_s - float(time_s[0]))
    return Mark(*stretch_s(time_s, event), f"{move}, t+{after}", state)


def _output(time_s: FloatArray, curves: Curves, shades: Sequence[Shade] = ()) -> Iterator[Panel]:
    label, lines = style.with_unit(curves.name), []
    spans_s = style.missing_spans(time_s, curves.measured, _PIXELS)
    missing = [Shade(*span_s, style.MASK) for span_s in spans_s]
    interval = curves.model is not None and curves.half_width is not None
    if curves.model is not None and curves.half_width is not None:
        percent = f"{100.0 * LEVEL:.0f} %"
        ends = (curves.model - curves.half_width, curves.model + curves.half_width)
        lines += [
            Line(f"{percent} {end}", values, style.MODEL, 0.0)
            for end, values in zip(("from", "to"), ends, strict=True)
        ]
    if curves.steady is not None:
        lines.append(Line("steady state", curves.steady, style.STEADY, 1.0, _DASHES[1]))
    if curves.model is not None:
        lines.append(Line("model", curves.model, style.MODEL, 2.0))
    lines.append(Line("measured", curves.measured, style.MEASURED))
    yield Panel(label, lines, _OUTPUT_PX, [*missing, *shades], interval)
    if curves.model is not None:
        deviation = Line("model - measured", curves.model - curves.measured, style.MODEL)
        yield Panel(f"Δ{label}", [deviation], _DEVIATION_PX, [*missing, *shades])


def _windows(one: Assessment | None, t0_s: float) -> list[Shade]:
    """Where the model may reach 10 % and 90 %, and where flight and model do."""
    if one is None:
        return []
    bands = time_bands(one.flight, one.model, one.verdict)
    shades = [
        Shade(start_s - t0_s, stop_s - t0_s, colour)
        for (start_s, stop_s), colour in zip(bands, (style.TI, style.TT), strict=False)
    ]
    reached = [
        (at - t0_s, colour)
        for reading, colour in ((one.flight, style.MEASURED), (one.model, style.MODEL))
        for at in (reading.t10_s, reading.t90_s)
        if math.isfinite(at)
    ]
    return shades + [Shade(at, at, colour) for at, colour in reached]


def html(chart: Chart) -> Markup:
    if len(chart.time_s) < 2:
        return Markup()
    text = json.dumps(_document(chart), separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return Markup('<div class="live" data-chart="{}"></div>').format(text)


def _document(chart: Chart) -> dict[str, Any]:
    """What the script reads; each panel has its `lines` from one number to another."""
    time_s, rows = chart.time_s, len(chart.time_s)
    lines = [line for panel in chart.panels for line in panel.lines]
    steps = [_Step.of(line.values) for line in lines]
    ends = np.cumsum([len(panel.lines) for panel in chart.panels]).tolist()
    began_s = 0.0 if chart.clock else float(time_s[0])
    return {
        "start_s": float(time_s[0]) - began_s,
        "elapsed": not chart.clock,
        "began_s": began_s if dated(began_s) else None,
        "dt_s": float(time_s[-1] - time_s[0]) / (rows - 1),
        "rows": rows,
        "clock": chart.clock or style.clock_label(began_s),
        "lines": [
            {"label": line.label, "colour": line.colour, "width": line.width, "dash": line.dash,
             "digits": step.digits, "shown": step.shown, "base": step.base}
            for line, step in zip(lines, steps, strict=True)
        ],
        "panels": [
            {"label": panel.label, "height": panel.height_px,
             "shades": [_after(shade, began_s) for shade in panel.shades],
             "band": panel.band, "lines": [end - len(panel.lines), end]}
            for panel, end in zip(chart.panels, ends, strict=True)
        ],
        "marks": [_after(mark, began_s) for mark in chart.marks],
        "pieces": [
            {"first": first, "rows": last - first, "size": size,
             "data": _packed([line.values[first:last] for line in lines], steps, size)}
            for first, last, size in _pieces(chart, len(lines))
        ],
    }  # fmt: skip


def _after(stretch: Shade | Mark, began_s: float) -> Shade | Mark:
    return stretch._replace(start_s=stretch.start_s - began_s, stop_s=stretch.stop_s - began_s)


class _Step(NamedTuple):
    """A curve in whole numbers: value = (base + whole) / 10^digits."""

    digits: int
    base: int

    @property
    def shown(self) -> int:
        """Decimals for a reader: to 1e-4 to 1e-3 of the range."""
        return max(0, self.digits - 2)

    @classmethod
    def of(cls, values: FloatArray) -> _Step:
        known = values[np.isfinite(values)]
        low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)
        largest = max(abs(low), abs(high)) or 1.0
        # Whole numbers are exact in the script below 2^53, and 10^-digits has to exist.
        span = min(high - low, sys.float_info.max) or 1e-3 * largest
        digits = min(6 - math.ceil(math.log10(max(span, _LEAST))),
                     15 - math.ceil(math.log10(max(largest, 1.0))))  # fmt: skip
        return cls(digits, round(low * 10.0**digits))

    def words(self, values: FloatArray) -> NDArray[np.uint32]:
        """Differences (time,) of what is known as unsigned integers, the sign in the last bit."""
        known = np.isfinite(values)
        whole = np.rint(values[known] * 10.0**self.digits).astype(np.int64) - self.base
        steps = np.diff(whole, prepend=0)
        words = np.full(len(values), _MISSING, dtype=np.uint32)
        words[known] = (steps << 1) ^ (steps >> 63)
        return words


def _pieces(chart: Chart, lines: int) -> list[tuple[int, int, int]]:
    """(first, last, samples per bin): the whole chart and, where that is in bins, its marks."""
    rows = len(chart.time_s)
    size = _bin_size(rows * lines, _MOST)
    pieces = [(0, rows, size)]
    if size > 1:
        times = np.array([mark[:2] for mark in chart.marks]).reshape(-1, 2)
        marked = np.zeros(rows, dtype=np.bool_)
        for first, last in np.searchsorted(chart.time_s, times):
            marked[first : last + 1] = True
        fine = _bin_size(int(marked.sum()) * lines, _MOST_OF_EVENTS)
        pieces += [(first, last, fine) for first, last in spans(marked)]
    return pieces


def _bin_size(numbers: int, most: int) -> int:
    """Samples per bin, a power of two, so that at most so many numbers are left, two per bin."""
    return 1 if numbers <= most else 2 ** math.ceil(math.log2(2 * numbers / most))


def _packed(curves: Sequence[FloatArray], steps: Sequence[_Step], size: int) -> str:
    """Deflated words of all curves, byte by byte; of bins the least values, then the largest."""
    words = [
        step.words(part)
        for values, step in zip(curves, steps, strict=True)
        for part in _binned(values, size)
    ]
    planes = np.concatenate(words).astype("<u4").view(np.uint8).reshape(-1, 4).T
    return base64.b64encode(zlib.compress(planes.tobytes(), 6)).decode()


def _binned(values: FloatArray, size: int) -> tuple[FloatArray, ...]:
    if size == 1:
        return (values,)
    starts = np.arange(0, len(values), size)
    return np.fmin.reduceat(values, starts), np.fmax.reduceat(values, starts)


@cache
def scripts() -> tuple[Markup, ...]:
    return tuple(Markup(_shipped(name)) for name in ("vendor/uPlot.iife.min.js", "live.js"))  # noqa: S704 - shipped


@cache
def licence() -> Markup:
    """Copyright and licence of uPlot, which has to stand wherever it does."""
    return Markup(_shipped("vendor/LICENSE"))  # noqa: S704 - shipped


@cache
def looks() -> Markup:
    return Markup(_shipped("vendor/uPlot.min.css"))  # noqa: S704 - shipped


@cache
def allowed() -> Markup:
    """What a content security policy allows: scripts of these hashes."""
    found = (hashlib.sha256(text.encode()).digest() for text in scripts())
    return Markup(" ").join(
        Markup("'sha256-{}'").format(base64.b64encode(each).decode()) for each in found
    )


def _shipped(name: str) -> str:
    return files("eval.report").joinpath(name).read_text("utf-8")
