"""The page about the open flights: `citation_gap.md` and its figures."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from eval.gap.flights_steps import FlightStudy, level_interval
from eval.report import style
from narxcal.channels import symbol
from narxcal.support.files import atomic_write_bytes
from training.budget.result import Interval

NAME = "citation_gap"
GOALS = {"N1_pct": 0.6, "EGT_C": 10.0}
_HEAD = """# What the two Citation II flights hold that no channel records

This page is made by

    python -m eval.gap.flights_study --data ../shared/data/flights --out docs

There are two flights of one aircraft, a year apart, both engines of each. Each flight is simulated
by a calibration of the other one (`citation2.toml`), fuel flow being the input, as a free run over
the whole flight. The search for windows (`training.gap.windows`) sees what is left, recorded less
simulated, where fuel flow has not moved for 10 s. ITT stands in the column EGT.
"""

_TAIL = """## How to read it

- At given fuel flow, N1 and N2 fall and ITT rises, at once in both engines, for minutes, with the
  lever at rest: that is what air taken from the compressors does. Nothing in the logs says which
  valve it was; anti-ice is the likely one, for the windows lie in climb, cruise and descent.
- ITT follows in two parts: one within seconds, which the search weighs, and one over a minute or
  two while the metal warms, which the sizes over whole windows hold as well.
- A start or stop that falls on a lever move is known no better than its interval says.
- An engine's own constant offset (fuel meter, probe) is no effect of this kind; the last step shows
  what it is worth, fitted to the very log it is judged on.
- The last section asks whether a model identified on a flight gets better once the windows are
  taken out of it: compare its first row with that of the same flight further up.
- "Not confirmed" and "no windows" are answers: the page claims only what one engine tells of the
  other.
"""


def write_page(studies: Sequence[FlightStudy], out: Path) -> None:
    """Write the page and a figure per study into the folder `out`."""
    out.mkdir(parents=True, exist_ok=True)
    parts = [_HEAD]
    for number, found in enumerate(studies, 1):
        parts += [_section(found)]
        if found.confirmed:
            picture = f"{NAME}_{number}.png"
            atomic_write_bytes(out / picture, png(draw(found)))
            parts += [f"![Before and after]({picture})\n"]
    parts += [_TAIL]
    atomic_write_bytes(out / f"{NAME}.md", "\n".join(parts).encode())


def _section(found: FlightStudy) -> str:
    lines = [f"## {found.title}\n", _verdict(found), ""]
    if found.confirmed:
        lines += [*_windows(found), "", *_sizes(found), ""]
    lines += [*_alone(found), "", *_errors(found), ""]
    return "\n".join(lines)


def _verdict(found: FlightStudy) -> str:
    if not found.windows.found:
        return (
            f"No windows: the best ones gain {found.windows.gain:.0f}, and noise of this colour "
            f"reaches {found.windows.threshold:.0f}."
        )
    share = 100.0 * found.explained
    text = (
        f"**Windows: {len({w.start_s for w in found.windows.found})}**, the same in both engines; "
        f"twice the log likelihood rises by {found.windows.gain:.0f} (noise of the same colour "
        f"reaches {found.windows.threshold:.0f} once in a hundred). "
    )
    if found.confirmed:
        return text + (
            f"Confirmed: what one engine's log alone tells takes {share:.0f} % off the squared "
            "error of the other engine (mean of the channels)."
        )
    return text + (
        "**Not confirmed**: windows and sizes of one engine's log alone "
        + (f"take only {share:.0f} % off" if share >= 0.0 else f"add {-share:.0f} % to")
        + " the squared error of the other engine, so nothing is claimed."
    )


def _windows(found: FlightStudy) -> list[str]:
    heads = [
        f"{style.with_unit(name)} {engine}" for engine in _engines(found) for name in _names(found)
    ]
    rows = ["| window | start, s | stop, s | " + " | ".join(heads) + " |"]
    rows.append("|" + "---|" * (3 + len(heads)))
    starts = sorted({w.start_s for w in found.windows.found})
    for number, start in enumerate(starts, 1):
        same = sorted(
            (w for w in found.windows.found if w.start_s == start), key=lambda w: w.flight
        )
        cells = [_pm(interval) for window in same for interval in window.shift]
        when = (_span(start, same[0].start_span_s), _span(same[0].stop_s, same[0].stop_span_s))
        rows.append(f"| {number} | {when[0]} | {when[1]} | " + " | ".join(cells) + " |")
    return [
        "Shifts at the edges, within seconds of the switch, with 90 % intervals:\n",
        *rows,
    ]


def _sizes(found: FlightStudy) -> list[str]:
    rows = ["| | " + " | ".join(style.with_unit(name) for name in _names(found)) + " |"]
    rows.append("|" + "---|" * (1 + len(_names(found))))
    rows.append(
        "| at the edges, both engines | " + " | ".join(map(_pm, found.windows.shift)) + " |"
    )
    for e, engine in enumerate(_engines(found)):
        sizes = level_interval(found.judged, e, found.windows.on[e])
        cells = [f"{s.value:.3g} ({s.low:.3g} .. {s.high:.3g})" for s in sizes]
        rows.append(f"| over the whole windows, {engine} | " + " | ".join(cells) + " |")
    return ["Size of the effect, at once and once the metal has followed:\n", *rows]


def _alone(found: FlightStudy) -> list[str]:
    lines = ["Found in one engine's log alone, without the other's:\n"]
    for engine, windows in found.alone.items():
        times = ", ".join(f"{w.start_s:.0f}-{w.stop_s:.0f} s" for w in windows.found)
        size = ", ".join(
            f"{symbol(name)} {i.value:+.2g}"
            for name, i in zip(_names(found), windows.shift, strict=True)
        )
        lines.append(f"- {engine}: {times} ({size})" if times else f"- {engine}: nothing")
    return lines


def _errors(found: FlightStudy) -> list[str]:
    engines, names = _engines(found), _names(found)
    heads = [f"{style.with_unit(name)} {engine}" for engine in engines for name in names]
    rows = ["| RMSE of the free run | fitted to this log | " + " | ".join(heads) + " |"]
    rows.append("|" + "---|" * (2 + len(heads)))
    for step in found.steps:
        cells = [f"{value:.2f}" if value < 5.0 else f"{value:.1f}" for value in step.rmse.ravel()]
        rows.append(f"| {step.name} | {step.fitted} | " + " | ".join(cells) + " |")
    goals = ", ".join(f"{symbol(name)} {value:g}" for name, value in GOALS.items())
    return [f"Error over the whole flight (goal: {goals}):\n", *rows]


def _engines(found: FlightStudy) -> tuple[str, ...]:
    return found.judged.engines


def _names(found: FlightStudy) -> tuple[str, ...]:
    return found.judged.outputs


def _pm(interval: Interval) -> str:
    return f"{interval.value:+.2f} ± {0.5 * (interval.high - interval.low):.2f}"


def _span(value: float, span: tuple[float, float]) -> str:
    return f"{value:.0f} ({span[0]:.0f} .. {span[1]:.0f})"


def draw(found: FlightStudy) -> Figure:
    """Fuel flow, and what is left of each output before and after, with the windows shaded."""
    judged = found.judged
    time = np.arange(judged.real.shape[1], dtype=np.float64) * judged.dt_s
    figure, rows = style.stack(10.0, [0.8, *[1.5] * len(judged.outputs)])
    for fuel, colour in zip(judged.fuel, style.CYCLE, strict=False):
        style.curve(rows[0], time, fuel, colour, lw=0.8)
    rows[0].set_ylabel(style.with_unit("FF_kgph"))
    for c, name in enumerate(judged.outputs):
        axes = rows[c + 1]
        for e, engine in enumerate(judged.engines):
            before, after = found.steps[0].rest[e, :, c], found.steps[1].rest[e, :, c]
            style.curve(axes, time, before, "#8c959f", lw=0.7, label=f"{engine}, as is", points=900)
            style.curve(
                axes, time, after, style.CYCLE[e], lw=0.8, points=900,
                label=f"{engine}, with the windows of the other",
            )  # fmt: skip
        limit = 1.1 * float(np.nanquantile(np.abs(found.steps[0].rest[..., c]), 0.995))
        axes.set(ylim=(-limit, limit), ylabel=f"gap {style.with_unit(name)}")
    for axes in rows:
        style.dress(axes)
        axes.margins(x=0.0)
        for window in found.windows.found:
            axes.axvspan(window.start_s, window.stop_s, color=style.MASK, alpha=0.25, lw=0)
    style.legend(rows[1])
    rows[-1].set_xlabel("time [s]; shaded: windows found")
    return figure


def png(figure: Figure) -> bytes:
    """The figure as the bytes of a PNG, the same for the same figure."""
    buffer = io.BytesIO()
    FigureCanvasAgg(figure)
    figure.savefig(buffer, format="png", dpi=110, metadata={"Software": None})
    return buffer.getvalue()
