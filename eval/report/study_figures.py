"""Figures about many runs: smoothing windows, cross-validation spread, denoising sweep."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from data_prep.log import FloatArray
from eval.report import style
from eval.report.content import Measure, NoiseSweep, Scheme, WindowTrial
from eval.report.svg import Picture, picture


def windows(trial: WindowTrial) -> Picture:
    """Show what each moving-average window does to the signal and to its spectrum."""
    figure = style.figure(10.0, 2.9)
    left, right = figure.subplots(1, 2)
    _excerpt(left, trial)
    for colour, (window, gain) in zip(style.CYCLE * 4, trial.gain.items(), strict=False):
        decibels = 20.0 * np.log10(np.maximum(np.abs(gain), 1e-3))
        right.plot(
            trial.frequency_hz,
            decibels,
            color=colour,
            lw=_weight(window, trial),
            label=_window(window, trial),
        )
    right.axhline(-3.0, color="#57606a", lw=0.7, ls=":")
    right.annotate(
        "-3 dB", (1.0, -3.0), xycoords=("axes fraction", "data"), ha="right", va="bottom", size=7
    )
    right.set(xlabel="frequency [Hz]", ylabel="gain [dB]", ylim=(-45.0, 3.0))
    right.margins(x=0.0)
    for axes in (left, right):
        style.dress(axes)
        style.legend(axes, columns=4)
    chosen = f"The chosen window is {trial.chosen} samples."
    alt = (
        f"Moving average windows {', '.join(map(str, trial.gain))} on {trial.log}: signal and gain"
    )
    return picture(figure, alt, chosen)


def _excerpt(axes: Axes, trial: WindowTrial) -> None:
    if trial.excerpt_time_s is None:
        return
    colours = dict(zip(trial.gain, style.CYCLE * 4, strict=False))
    for window, values in trial.excerpt.items():
        if window == 0:
            axes.plot(
                trial.excerpt_time_s,
                values,
                color="#8c959f",
                lw=0.8,
                label="not smoothed",
                zorder=1,
            )
        else:
            axes.plot(
                trial.excerpt_time_s, values, color=colours.get(window, style.MODEL),
                lw=_weight(window, trial), label=_window(window, trial),
            )  # fmt: skip
    axes.set(xlabel="time [s]", ylabel=style.with_unit(trial.excerpt_channel))
    axes.margins(x=0.0)


def _window(window: int, trial: WindowTrial) -> str:
    return f"{window} samples" + (" (chosen)" if window == trial.chosen else "")


def _weight(window: int, trial: WindowTrial) -> float:
    return 2.0 if window == trial.chosen else 1.1


def spread(schemes: Sequence[Scheme], measures: Sequence[Measure]) -> Picture:
    """Draw one panel per measure: a box over the folds and every fold as a dot, per scheme."""
    columns = min(4, len(measures))
    rows = -(-len(measures) // columns)
    figure = style.figure(10.0, 2.3 * rows)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, measure in zip(grid, measures, strict=False):
        _strip(axes, schemes, measure)
    for axes in grid[len(measures) :]:
        axes.set_visible(False)
    labels = ", ".join(measure.label for measure in measures)
    caption = (
        "Every dot is one fold, the box spans the quartiles and the line in it is the median; "
        "a dotted line is the limit."
    )
    return picture(figure, f"Spread over the folds of {labels}", caption)


def _strip(axes: Axes, schemes: Sequence[Scheme], measure: Measure) -> None:
    kept = [(scheme, _values(scheme, measure)) for scheme in schemes]
    kept = [(scheme, values) for scheme, values in kept if len(values)]
    if kept:
        axes.boxplot(
            [values for _, values in kept], widths=0.5, showfliers=False, patch_artist=True,
            boxprops={"facecolor": "#dbe9f4", "edgecolor": style.MODEL, "linewidth": 0.8},
            medianprops={"color": style.MODEL, "linewidth": 1.5},
            whiskerprops={"color": style.MODEL, "linewidth": 0.8},
            capprops={"color": style.MODEL, "linewidth": 0.8},
        )  # fmt: skip
    for position, (_, values) in enumerate(kept, start=1):
        # A fixed fan instead of random jitter: the same folds give the same drawing.
        aside = np.linspace(-0.16, 0.16, len(values)) if len(values) > 1 else np.zeros(1)
        axes.plot(position + aside, values, "o", ms=3.2, color=style.MEASURED, alpha=0.75, mew=0,
                  clip_on=False)  # fmt: skip
    if measure.limit is not None:
        axes.axhline(measure.limit, color=style.BAD, lw=1.0, ls=":")
    axes.set_ylim(bottom=0.0)
    axes.set_xticks(range(1, len(kept) + 1), [_short(scheme.name) for scheme, _ in kept])
    axes.set_ylabel(f"{measure.label} [{measure.unit}]" if measure.unit else measure.label)
    style.dress(axes, size=7.5, grid="y")


def _values(scheme: Scheme, measure: Measure) -> FloatArray:
    values = [float(fold.results.get(measure.key, np.nan)) for fold in scheme.folds]
    return np.array([value for value in values if np.isfinite(value)])


def _short(name: str) -> str:
    return "\n".join(textwrap.wrap(name, 16)[:2])


def noise(sweep: NoiseSweep) -> Picture:
    """Plot RMSE against signal-to-noise ratio, and the filter's consistency beside it."""
    consistent = sweep.nis is not None
    figure = style.figure(10.0 if consistent else 6.0, 2.9)
    panels = figure.subplots(1, 2 if consistent else 1, squeeze=False).ravel()
    for colour, marker, (name, values) in zip(
        style.CYCLE, "osD^vP", sweep.curves.items(), strict=False
    ):
        panels[0].plot(sweep.snr_db, values, color=colour, marker=marker, ms=4, lw=1.3, label=name)
    panels[0].set(
        xlabel="signal-to-noise ratio [dB]",
        ylabel=f"RMSE of {style.with_unit(sweep.channel)}",
        yscale="log",
    )
    if sweep.nis is not None:
        panels[1].plot(
            sweep.snr_db, sweep.nis, color=style.MODEL, marker="o", ms=4, label="mean NIS"
        )
        if sweep.nis_band is not None:
            panels[1].axhspan(*sweep.nis_band, color=style.MASK, alpha=0.6, lw=0, label="95 % band")
        panels[1].set(
            xlabel="signal-to-noise ratio [dB]", ylabel="normalised innovation squared [-]"
        )
    for axes in panels:
        style.dress(axes)
        style.legend(axes, columns=3)
    name = style.symbol(sweep.channel)
    alt = f"RMSE of {name} in {sweep.log} against signal-to-noise ratio"
    caption = f"{sweep.log}: Gaussian noise added to {name}; errors against the clean signal."
    return picture(figure, alt, caption)
