"""Figures of whole logs, of cross-validation and noise, and of reproduced studies."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from data_prep.events import Event
from data_prep.log import Log
from eval.judging.residuals import ResidualTests, independence, whiteness
from eval.report import plot, style
from eval.report.style import Picture, picture
from eval.report.tables import Measure, WindowTrial, measures
from eval.report.view import LogView
from narxcal.channels import CHANNELS, symbol
from narxcal.support.arrays import FloatArray

if TYPE_CHECKING:
    from eval.judging.compare import Comparison
    from eval.judging.crossval import CrossValidation, FoldResult
    from eval.judging.significance import Recording
    from eval.reproduce.noise import NoiseSweep


def overlay(view: LogView) -> Picture:
    """Draw the whole log: driver, then per output flight over model and the deviation below it."""
    names = ", ".join(symbol(name) for name in view.outputs)
    shown = "as measured" if view.evaluation is None else "measured and model, with deviation"
    alt = f"{names} over the whole log {view.name}: {shown}"
    return picture(overlay_figure(view), alt, _overlay_caption(view))


def overlay_figure(view: LogView, on: Figure | None = None) -> Figure:
    """The same as a matplotlib figure, which may be given."""
    outputs, compared = view.curves(), view.evaluation is not None
    ratios = [0.6] + [part for _ in outputs for part in ((1.6, 0.6) if compared else (1.4,))]
    figure, rows = style.stack(10.0, ratios, on)
    step = 2 if compared else 1
    plot.events(view, ax=rows[0])
    for position, curves in enumerate(outputs):
        plot.compare(view, channel=curves.name, ax=rows[1 + step * position])
        if curves.model is not None:
            deviation = curves.model - curves.measured
            _deviation(rows[2 + step * position], view.log.time_s, curves.name, deviation)
    style.legend(rows[1], columns=5)
    for axes in rows:
        style.over_time(axes)
        axes.set_xlabel("")
        if view.scored_from_s is not None:
            axes.axvline(view.scored_from_s, color=style.MEASURED, lw=0.9, ls=":")
    style.clock(rows[-1], view.log.time_s)
    return figure


def _overlay_caption(view: LogView) -> str:
    if view.evaluation is None:
        return "Thin lines in the driver strip: pushes (orange) and pulls (blue). Grey: masked."
    text = (
        "Measured: the thin line on top of the free run in blue, shaded its interval; below each, "
        "model minus measured. "
        "Grey: masked by cleaning, not scored."
    )
    trim = (
        " Left of the black vertical line trim offsets are estimated; only what follows is scored."
    )
    return text if view.scored_from_s is None else text + trim


def _deviation(axes: Axes, time: FloatArray, name: str, deviation: FloatArray) -> None:
    axes.axhline(0.0, color="#8c959f", lw=0.6)
    style.shade_missing(axes, time, deviation)
    style.curve(axes, time, deviation, style.MODEL, lw=0.7)
    axes.set_ylabel(f"Δ{style.with_unit(name)}")
    style.ticks(axes)


def residual_tests(view: LogView) -> list[Picture]:
    return [_residual_test(view.name, part) for part in view.residuals]


def _residual_test(log: str, part: ResidualTests) -> Picture:
    entries = len(part.cross) + 1  # one line of the legend per input, and the band
    figure, left, right = style.pair(10.0, 2.5, legend_rows=-(-entries // plot.LEGEND_COLUMNS))
    for axes, cross in ((left, False), (right, True)):
        plot.resid(part, cross=cross, ax=axes)
        style.legend(axes, columns=plot.LEGEND_COLUMNS)
    name = symbol(part.channel)
    alt = f"Correlation of the {name} residual of {log} with itself and with each input"
    return picture(figure, alt, _judgement(part))


_CHANCE = "no input correlates more than chance allows (1 % over all lags)"


def _judgement(part: ResidualTests) -> str:
    name = symbol(part.channel)
    white = whiteness(part.auto)
    texts = []
    if white.outside_95 is not None:
        texts.append(
            f"{100 * white.outside_95:.0f} % of the lags lie outside the band of white noise "
            "(5 % expected)"
        )
    found = {key: independence(cross) for key, cross in part.cross.items()}
    left = [symbol(key) for key, test in found.items() if test.ok is False]
    if found:
        texts.append(f"an effect of {', '.join(left)} is left" if left else _CHANCE)
    return f"{name}: {'; '.join(texts)}." if texts else f"{name}: too few samples to judge."


def windows(trial: WindowTrial) -> Picture:
    """Show what each moving-average window does to the signal and to its spectrum."""
    columns = 3
    rows = -(-(len(trial.gain) + 1) // columns)
    figure, left, right = style.pair(10.0, 2.9, legend_rows=rows)
    left.plot(
        trial.excerpt_time_s, trial.excerpt[0], color="#8c959f", lw=0.8, zorder=1,
        label="not smoothed",
    )  # fmt: skip
    for colour, (window, gain) in zip(style.CYCLE * 4, trial.gain.items(), strict=False):
        chosen = window == trial.chosen
        look: Any = {
            "color": colour, "lw": 2.0 if chosen else 1.1,
            "label": f"{window} samples{' (chosen)' if chosen else ''}",
        }  # fmt: skip
        left.plot(trial.excerpt_time_s, trial.excerpt[window], **look)
        right.plot(trial.frequency_hz, 20.0 * np.log10(np.maximum(np.abs(gain), 1e-3)), **look)
    left.set_ylabel(style.with_unit(trial.excerpt_channel))
    style.clock(left, trial.excerpt_time_s)
    right.axhline(-3.0, color="#57606a", lw=0.7, ls=":")
    right.annotate(
        "-3 dB", (1.0, -3.0), xycoords=("axes fraction", "data"), ha="right", va="bottom", size=7
    )
    right.set(xlabel="frequency [Hz]", ylabel="gain [dB]", ylim=(-45.0, 3.0))
    for axes in (left, right):
        axes.margins(x=0.0)
        style.dress(axes)
        style.legend(axes, columns=columns)
    names = ", ".join(map(str, trial.gain))
    alt = f"Moving average windows {names} on {trial.log}: signal and gain"
    return picture(figure, alt, f"The chosen window is {trial.chosen} samples.")


def spread(found: CrossValidation) -> Picture | None:
    """Draw one panel per measure: a box over the folds and every fold as a dot, per scheme."""
    shown = measures(found)
    if not found.folds:
        return None
    columns = min(4, len(shown))
    rows = -(-len(shown) // columns)
    figure = style.figure(10.0, 2.3 * rows)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, measure in zip(grid, shown, strict=False):
        _strip(axes, found.schemes, measure)
    for axes in grid[len(shown) :]:
        axes.set_visible(False)
    labels = ", ".join(measure.label for measure in shown)
    caption = (
        "Every dot is one fold, the box spans the quartiles and the line in it is the median; "
        "a dotted line is the limit."
    )
    return picture(figure, f"Spread over the folds of {labels}", caption)


def _strip(axes: Axes, schemes: Mapping[str, Sequence[FoldResult]], measure: Measure) -> None:
    found = {
        name: [value for fold in folds if (value := fold.figures.get(measure.key)) is not None]
        for name, folds in schemes.items()
    }
    kept = {name: values for name, values in found.items() if values}
    if kept:
        axes.boxplot(
            list(kept.values()), widths=0.5, showfliers=False, patch_artist=True,
            boxprops={"facecolor": "#dbe9f4", "edgecolor": style.MODEL, "linewidth": 0.8},
            medianprops={"color": style.MODEL, "linewidth": 1.5},
            whiskerprops={"color": style.MODEL, "linewidth": 0.8},
            capprops={"color": style.MODEL, "linewidth": 0.8},
        )  # fmt: skip
    for position, values in enumerate(kept.values(), start=1):
        # Evenly spread instead of random jitter: the same folds give the same drawing.
        aside = np.linspace(-0.16, 0.16, len(values)) if len(values) > 1 else np.zeros(1)
        axes.plot(position + aside, values, "o", ms=3.2, color=style.MEASURED, alpha=0.75, mew=0,
                  clip_on=False)  # fmt: skip
    if measure.limit is not None:
        axes.axhline(measure.limit, color=style.BAD, lw=1.0, ls=":")
    axes.set_ylim(bottom=0.0)
    short = ["\n".join(textwrap.wrap(name, 16)[:2]) for name in kept]
    axes.set_xticks(range(1, len(kept) + 1), short)
    axes.set_ylabel(measure.title)
    style.dress(axes, size=7.5, grid="y")


def noise(sweep: NoiseSweep) -> Picture:
    """Plot RMSE against signal-to-noise ratio, and the filter's consistency."""
    table, name = sweep.table, symbol(sweep.channel)
    figure = style.figure(10.0, 2.9)
    left, right = figure.subplots(1, 2)
    for colour, marker, (label, values) in zip(
        style.CYCLE, "osD^vP", sweep.curves.items(), strict=False
    ):
        left.plot(table["snr_db"], values, color=colour, marker=marker, ms=4, lw=1.3, label=label)
    left.set(ylabel=f"RMSE of {style.with_unit(sweep.channel)}", yscale="log")
    band = float(table["nis_low"].mean()), float(table["nis_high"].mean())
    right.plot(
        table["snr_db"], table["mean_nis"], color=style.MODEL, marker="o", ms=4, label="mean NIS"
    )
    right.axhspan(*band, color=style.MASK, alpha=0.6, lw=0, label="95 % band")
    right.set(ylabel="normalised innovation squared [-]")
    for axes in (left, right):
        axes.set(xlabel="signal-to-noise ratio [dB]")
        style.dress(axes)
        style.legend(axes, columns=3)
    alt = f"RMSE of {name} in {sweep.log} against signal-to-noise ratio"
    caption = f"{sweep.log}: Gaussian noise added to {name}; errors against the clean signal."
    return picture(figure, alt, caption)


_LEAD_S = 2.0


def segment(log: Log, event: Event, channels: Sequence[str], title: str) -> Picture:
    """Draw one event with nothing but what was measured: figures 6 and 7 of the paper."""
    rows = slice(max(0, event.start - round(_LEAD_S / log.dt_s)), event.stop)
    figure, axes = style.stack(6.4, [0.7] + [1.1] * (len(channels) - 1))
    time = log.time_s[rows] - event.start_s
    for part, name in zip(axes, channels, strict=True):
        colour = style.DRIVER if part is axes[0] else style.MEASURED
        style.curve(part, time, log[name][rows], colour, lw=1.2)
        part.axvline(0.0, color="#57606a", lw=0.7, ls=":")
        style.over_time(part, name)
    axes[-1].set_xlabel("time after the lever moved [s]")
    place = f"{log.moment(event.start_s)} of {log.name}"
    return picture(figure, f"{title} at {place}", f"{title}, at {place}.")


def recorded_figure(log: Log, on: Figure | None = None) -> Figure:
    """Draw every channel of a log over time, one below the other; grey is where none was read."""
    names = log.recorded((*CHANNELS, *log.declared))
    figure, axes = style.stack(9.0, [0.8] * len(names), on)
    for part, name in zip(axes, names, strict=True):
        style.shade_missing(part, log.time_s, log[name])
        style.curve(part, log.time_s, log[name], style.MEASURED, lw=0.8)
        style.over_time(part, name)
    style.clock(axes[-1], log.time_s, f" of {log.name}")
    return figure


def free_runs(
    time_s: FloatArray, channel: str, measured: FloatArray, runs: Mapping[str, FloatArray]
) -> Picture:
    """Overlay free runs of several models over one log, `(time,)` each."""
    figure, (upper, lower) = style.stack(10.0, [1.9, 0.9])
    for colour, (name, values) in zip(style.CYCLE, runs.items(), strict=False):
        style.curve(upper, time_s, values, colour, lw=1.4, alpha=0.85)
        style.curve(lower, time_s, values - measured, colour, lw=0.8, label=name)
    style.curve(upper, time_s, measured, style.MEASURED, lw=0.8)
    upper.set_ylabel(style.with_unit(channel))
    lower.set_ylabel(f"Δ{style.with_unit(channel)}")
    style.clock(lower, time_s)
    for axes in (upper, lower):
        style.over_time(axes)
    style.legend(lower, columns=5)
    names = ", ".join(runs)
    alt = f"{symbol(channel)} measured and in free run: {names}"
    return picture(
        figure, alt, "Measured: the line without a colour; below, each model minus measured."
    )


def most_eventful(found: Comparison) -> Recording:
    return max(found.recordings, key=lambda each: len(each.events))


def compared(found: Comparison) -> Picture:
    """Free runs of all models, a row per channel: the log with most events, and its largest move.

    The move is that with the largest change of the first channel within 20 s of an event's start.
    """
    one = most_eventful(found)
    rows, names = len(one.channels), [row.run for row in found.rows]
    figure = style.figure(10.0, 0.5 + 1.9 * rows)
    grid = figure.subplots(rows, 2, squeeze=False, width_ratios=(1.0, 1.2))
    near = _largest_move(one)
    for k, name in enumerate(one.channels):
        for axes, part in zip(grid[k], (slice(None), near), strict=True):
            time_s, alone = one.time_s[part], one.measured[part, k]
            for number, model in enumerate(names):
                colour = style.CYCLE[number % len(style.CYCLE)]
                dashes = ("-", "--", ":")[number // len(style.CYCLE) % 3]
                values = one.outputs[model][part, k]
                if np.isfinite(values).any():
                    style.curve(axes, time_s, values, colour, lw=1.1, ls=dashes, label=model)
            style.curve(axes, time_s, alone, style.MEASURED, lw=0.9, label="measured")
            style.over_time(axes, name)
            if k == rows - 1:
                style.clock(axes, one.time_s)
    style.legend(grid[0][0], columns=4, size=7.0)
    alt = f"{', '.join(map(symbol, one.channels))} of {one.name}, measured and in free run"
    caption = f"{one.name}: the whole log, and its largest move. Black: measured."
    return picture(figure, alt, caption)


def _largest_move(one: Recording) -> slice:
    dt_s = float(np.median(np.diff(one.time_s)))
    reach, first = round(20.0 / dt_s), np.nan_to_num(one.measured[:, 0])
    starts = [event.start for event in one.events] or [0]
    size = [abs(float(first[min(at + reach, len(first) - 1)] - first[at])) for at in starts]
    at = starts[int(np.argmax(size))]
    return slice(max(at - round(5.0 / dt_s), 0), at + reach)


def fused(
    time_s: FloatArray, channel: str, curves: Mapping[str, FloatArray], caption: str
) -> Picture:
    """Show some seconds of a noisy channel, `(time,)` per name, the truth last: figure 13."""
    figure = style.figure(10.0, 2.8)
    axes = figure.subplots()
    colours = ("#b6bdc4", style.CYCLE[0], style.CYCLE[1], style.CYCLE[2])
    *others, truth = curves.items()
    for colour, (name, values) in zip(colours, others, strict=False):
        axes.plot(time_s, values, color=colour, lw=1.0, label=name)
    axes.plot(time_s, truth[1], color=style.MEASURED, lw=1.0, ls="--", label=truth[0])
    style.clock(axes, time_s)
    style.over_time(axes, channel)
    style.legend(axes, columns=5)
    return picture(figure, f"{symbol(channel)} with noise, fused and true", caption)
