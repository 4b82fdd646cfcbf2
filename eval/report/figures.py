"""Figures about one whole log: free-run overlay, residual correlation, Pearson heat map."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from data_prep.log import FloatArray
from eval.report import style
from eval.report.content import ChannelTrace, LogPage, ResidualTests
from eval.report.svg import Picture, envelope, picture
from eval.residuals import Correlation, independence, whiteness

_LAGS = 160  # drawn per correlation; a reader sees no more


def overlay(page: LogPage) -> Picture:
    """Draw the whole log: driver, then per output flight over model and the deviation below it."""
    outputs, compared = page.channels, any(part.model is not None for part in page.channels)
    ratios = [0.6] + [part for _ in outputs for part in ((1.6, 0.6) if compared else (1.4,))]
    figure, rows = style.stack(10.0, ratios)
    step = 2 if compared else 1
    _driver(rows[0], page)
    for position, trace in enumerate(outputs):
        _output(rows[1 + step * position], page.time_s, trace)
        if compared:
            _deviation(rows[2 + step * position], page.time_s, trace)
    style.legend(rows[1], columns=5)
    for axes in rows:
        style.dress(axes)
        axes.margins(x=0.0)
        _mark_trim(axes, page.scored_from_s)
    rows[-1].set_xlabel("time [s]")
    names = ", ".join(style.symbol(trace.name) for trace in outputs)
    shown = "measured and model, with deviation" if compared else "as measured"
    alt = f"{names} over the whole log {page.name}: {shown}"
    return picture(figure, alt, _overlay_caption(page))


def _overlay_caption(page: LogPage) -> str:
    if all(trace.model is None for trace in page.channels):
        return "Thin lines in the driver strip: pushes (orange) and pulls (blue). Grey: masked."
    text = (
        "Measured: the thin line on top of the free run in blue; below each, model minus measured. "
        "Grey: masked by cleaning, not scored."
    )
    trim = " Left of the dotted line trim offsets are estimated; only what follows is scored."
    return text if page.scored_from_s is None else text + trim


def _driver(axes: Axes, page: LogPage) -> None:
    style.curve(axes, page.time_s, page.driver, style.DRIVER, lw=0.9)
    axes.set_ylabel(style.with_unit(page.driver_name))
    for trace in page.events:
        colour = style.BAD if trace.event.label == 0 else style.MODEL
        axes.axvline(trace.event.start_s, color=colour, lw=0.5, alpha=0.6)


def _output(axes: Axes, time: FloatArray, trace: ChannelTrace) -> None:
    style.shade_missing(axes, time, trace.measured)
    if trace.steady is not None:
        style.curve(axes, time, trace.steady, style.STEADY, lw=0.8, ls="--", label="steady state")
    if trace.model is not None:
        style.curve(
            axes, time, trace.model, style.MODEL, lw=2.0, alpha=0.75, label="model, free run"
        )
    style.curve(axes, time, trace.measured, style.MEASURED, lw=0.7, label="measured")
    axes.set_ylabel(style.with_unit(trace.name))


def _deviation(axes: Axes, time: FloatArray, trace: ChannelTrace) -> None:
    axes.axhline(0.0, color="#8c959f", lw=0.6)
    style.shade_missing(axes, time, trace.measured)
    if trace.model is not None:
        style.curve(axes, time, trace.model - trace.measured, style.MODEL, lw=0.7)
    axes.set_ylabel(f"Δ{style.with_unit(trace.name)}")


def _mark_trim(axes: Axes, scored_from_s: float | None) -> None:
    if scored_from_s is not None:
        axes.axvline(scored_from_s, color="#24292f", lw=0.9, ls=":")


def residual_tests(page: LogPage) -> list[Picture]:
    """Residual autocorrelation and input cross-correlations of every channel with 95 % bands."""
    return [_residual_test(page.name, part) for part in page.residuals]


def _residual_test(log: str, part: ResidualTests) -> Picture:
    figure, left, right = style.pair(10.0, 2.5)
    _band(left, part.auto, part.dt_s)
    _stems(left, part.auto, part.dt_s)
    left.set(xlabel="lag [s]", ylabel="autocorrelation [-]", ylim=(-1.05, 1.05))
    for colour, (name, cross) in zip(style.CYCLE * 4, part.cross.items(), strict=False):
        _band(right, cross, part.dt_s, None if right.lines else "95 % band")
        label = style.symbol(name)
        lags, values = envelope(cross.lags * part.dt_s, cross.values, 2 * _LAGS)
        right.plot(lags, values, color=colour, lw=1.2, label=label)
    right.set(xlabel="lag [s] (positive: the input comes first)", ylabel="cross-correlation [-]")
    for axes in (left, right):
        style.dress(axes)
        axes.margins(x=0.0)
        style.legend(axes, columns=6)
    name = style.symbol(part.channel)
    alt = f"Correlation of the {name} residual of {log} with itself and with each input"
    return picture(figure, alt, _judgement(part))


def _stems(axes: Axes, part: Correlation, dt_s: float) -> None:
    """Bars from zero as one broken line: a tenth of the bytes of a collection of lines."""
    lags, bars = envelope(part.lags * dt_s, part.values, _LAGS)
    heights = np.column_stack([np.zeros_like(bars), bars, np.full_like(bars, np.nan)]).ravel()
    axes.plot(np.repeat(lags, 3), heights, color=style.MODEL, lw=1.0)


def _band(axes: Axes, part: Correlation, dt_s: float, label: str | None = "95 % band") -> None:
    lags, half = envelope(part.lags * dt_s, part.band_95, _LAGS)
    axes.fill_between(lags, -half, half, color=style.MASK, alpha=0.6, lw=0, label=label)


_CHANCE = "no input correlates more than chance allows (1 % over all lags)"


def _judgement(part: ResidualTests) -> str:
    """Say in words what the bands show, as far as it can be judged."""
    name = style.symbol(part.channel)
    white = whiteness(part.auto)
    texts = []
    if white.outside_95 is not None:
        texts.append(
            f"{100 * white.outside_95:.0f} % of the lags lie outside the band of white noise "
            "(5 % expected)"
        )
    found = {key: independence(cross) for key, cross in part.cross.items()}
    left = [style.symbol(key) for key, test in found.items() if test.ok is False]
    if found:
        texts.append(f"an effect of {', '.join(left)} is left" if left else _CHANCE)
    return f"{name}: {'; '.join(texts)}." if texts else f"{name}: too few samples to judge."


def heat_map(table: pd.DataFrame, log: str, strong: float = 0.8) -> Picture:
    """Draw Pearson coefficients (inputs x outputs), strong ones framed."""
    inputs, outputs = list(map(str, table.index)), list(map(str, table.columns))
    values = table.to_numpy(dtype=float)
    figure = style.figure(1.6 + 0.75 * len(outputs), 0.7 + 0.34 * len(inputs))
    axes = figure.subplots()
    image = axes.pcolormesh(
        np.ma.masked_invalid(values), cmap="PuOr_r", vmin=-1, vmax=1, edgecolors="white", lw=1.5
    )
    for (row, column), value in np.ndenumerate(values):
        _coefficient(axes, row, column, float(value), strong)
    axes.set_xticks(np.arange(len(outputs)) + 0.5, [style.symbol(name) for name in outputs])
    axes.set_yticks(np.arange(len(inputs)) + 0.5, [style.symbol(name) for name in inputs])
    axes.invert_yaxis()
    axes.tick_params(
        length=0, labelsize=8, top=True, labeltop=True, bottom=False, labelbottom=False
    )
    for side in axes.spines.values():
        side.set_visible(False)
    bar = figure.colorbar(image, ax=axes, shrink=0.9, ticks=[-1, -0.5, 0, 0.5, 1])
    bar.ax.tick_params(labelsize=7)
    bar.outline.set_visible(False)
    bar.set_label("\N{GREEK SMALL LETTER RHO}", size=9, rotation=0, labelpad=8)
    return picture(figure, f"Pearson coefficients of inputs and outputs in {log}", "")


def _coefficient(axes: Axes, row: int, column: int, value: float, strong: float) -> None:
    if not np.isfinite(value):
        axes.text(column + 0.5, row + 0.5, "n/a", ha="center", va="center", size=8, color="#8c959f")
        return
    axes.text(
        column + 0.5, row + 0.5, f"{value:+.2f}", ha="center", va="center", size=8,
        color="white" if abs(value) > 0.65 else "#24292f",
        weight="bold" if abs(value) >= strong else "normal",
    )  # fmt: skip
