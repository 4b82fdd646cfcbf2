"""Figures 10 to 21 of the Citation X paper, drawn from virtual flights."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import NullFormatter

from eval.report import style
from eval.report.style import Picture, picture
from eval.reproduce.citation_dynamic import DynamicRow, DynamicStudy, Scaled
from eval.reproduce.mesh import OUTPUTS, T_S, Kind
from narxcal.channels import symbol
from narxcal.support.arrays import FloatArray
from narxcal.transfer.response import rise_times

_NUMBERS: dict[Kind, tuple[int, int]] = {"step": (16, 17), "impulse": (18, 19), "ramp": (20, 21)}
_SHOWN_S = {"impulse": 4.0, "ramp": 60.0}  # an impulse is over soon
_MOST_PCT = 1e4  # a diverged model is drawn up to here


def dynamic_pictures(rows: Sequence[DynamicRow], studies: Sequence[DynamicStudy]) -> list[Picture]:
    """All figures of which the flights were flown."""
    shown = studies[-1].shown
    found = []
    if "step" in shown:
        found += [_step(shown["step"]), _rise(shown["step"]), _entries(studies[-1])]
    for number, kind in ((13, "impulse"), (14, "ramp")):
        if kind in shown:
            found.append(_disturbed(number, kind, shown[kind]))
    for kind, (success, error) in _NUMBERS.items():
        own = [row for row in rows if row.kind == kind and np.isfinite(row.success_pct)]
        if own:
            found += [
                _bars(success, kind, own, "success_pct"),
                _bars(error, kind, own, "mean_pct"),
            ]
    return found


def _time(values: FloatArray) -> FloatArray:
    return T_S * np.arange(len(values), dtype=np.float64)


def _ratios(flight: Scaled) -> dict[str, FloatArray]:
    """Output over its static value from the onset on, by output."""
    at = flight.flight.onset
    return {name: flight.flight.columns[name][at:] / flight.static[name] for name in OUTPUTS}


def _lines(axes: Axes, curves: dict[str, FloatArray], label: str) -> None:
    for colour, (name, values) in zip(style.CYCLE, curves.items(), strict=False):
        style.curve(axes, _time(values), values, colour, lw=1.2, label=symbol(name))
    axes.set(xlabel="time from the onset [s]", ylabel=label)
    style.dress(axes)
    style.legend(axes, columns=5)


def _where(flight: Scaled) -> str:
    one = flight.flight
    return f"{one.altitude_ft:.0f} ft, amplitude {one.amplitude_deg:.0f}°"


def _step(flight: Scaled) -> Picture:
    drawn, left, right = style.pair(10.0, 2.9)
    _lines(left, _ratios(flight), "output / static value [-]")
    _lines(right, dict(zip(OUTPUTS, flight.y.T, strict=True)), "scaled ratio [-]")
    caption = f"Figures 10 and 11: ratios to the static model after a step, {_where(flight)}."
    return picture(drawn, "Ratios after a step, and scaled to 0 to 1", caption)


def _rise(flight: Scaled) -> Picture:
    y = flight.y[:, OUTPUTS.index("FN_kN")]
    drawn = style.figure(6.4, 2.6)
    axes = drawn.subplots()
    style.curve(axes, _time(y), y, style.MODEL, lw=1.4)
    for level, at in zip((0.1, 0.9), rise_times(_time(y), y), strict=True):
        axes.plot([0.0, at, at], [level, level, 0.0], color=style.BAD, lw=0.9, ls=":")
        axes.annotate(f"t{100 * level:.0f} = {at:.2f} s", (at, level), size=8, va="top")
    axes.set(xlabel="time from the onset [s]", ylabel="scaled thrust ratio [-]")
    style.dress(axes)
    caption = f"Figure 12: t10 and t90 of thrust, {_where(flight)}."
    return picture(drawn, "Times of 10 % and 90 % of the thrust response", caption)


def _disturbed(number: int, kind: Kind, flight: Scaled) -> Picture:
    at, drawn = flight.flight.onset, style.pair(10.0, 2.9)
    figure, left, right = drawn
    shown = slice(round(_SHOWN_S[kind] / T_S))
    plain = {name: flight.flight.columns[name][at:][shown] for name in OUTPUTS}
    _lines(left, {n: v / np.abs(v[0]) for n, v in plain.items()}, "output / first value [-]")
    _lines(right, {n: v[shown] for n, v in _ratios(flight).items()}, "output / static value [-]")
    caption = (
        f"Figure {number}: response to a {kind}, {_where(flight)}; right over the static model."
    )
    return picture(figure, f"Outputs after a {kind}, and their ratio to the static model", caption)


def _entries(study: DynamicStudy) -> Picture:
    """A_11 of the canonical form is the negative first coefficient of its polynomial."""
    figure, left, right = style.pair(10.0, 2.7)
    wanted = (("5/O O/5 (C = I)", "+".join(OUTPUTS), 1.0), ("1/O O/4 (canonical)", "FN_kN", -1.0))
    for axes, (model, group, sign) in zip((left, right), wanted, strict=True):
        values = sign * study.tables[model, group][..., 0]
        for k, colour in zip(range(values.shape[1]), style.CYCLE, strict=False):
            axes.plot(values[:, k], color=colour, marker="o", ms=3, label=f"amplitude {k + 1}")
        axes.set(xlabel="altitude of the mesh, by number", ylabel=f"A11, {model}")
        style.dress(axes)
        style.legend(axes, columns=4)
    caption = "Figure 15: first entry of A over altitude and amplitude, in two forms."
    return picture(figure, "First entry of the state matrix over altitude and amplitude", caption)


def _bars(number: int, kind: Kind, rows: Sequence[DynamicRow], what: str) -> Picture:
    """One panel per output, one bar per model."""
    models = list(dict.fromkeys(row.model for row in rows))
    figure = style.figure(10.0, 0.9 + 0.19 * len(models))
    panels = figure.subplots(1, len(OUTPUTS), sharey=True)
    for axes, output in zip(panels, OUTPUTS, strict=True):
        own = {row.model: getattr(row, what) for row in rows if row.output == output}
        values = [min(own.get(model, np.nan), _MOST_PCT) for model in models]
        axes.barh(range(len(models)), values, color=style.MODEL, height=0.7)
        axes.set_xlabel(symbol(output))
        if what == "mean_pct":
            axes.set_xscale("log")
            axes.xaxis.set_minor_formatter(NullFormatter())
        style.dress(axes, size=7.0, grid="x")
    panels[0].set_yticks(range(len(models)), models)
    panels[0].invert_yaxis()
    words = "validation success" if what == "success_pct" else "mean relative error"
    caption = f"Figure {number}: {words} of responses to a {kind}, in %."
    return picture(figure, f"{words} by model and output, {kind}", caption)
