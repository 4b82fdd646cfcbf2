"""Drawings of pages and notebooks (`narxcal.plot`): each on one `Axes`, which it returns.

Data come first, then the model, as in MATLAB's `compare(data, sys)`.

| argument | is |
|---|---|
| `data` | a result of `narxcal.prepare`, `train` or `evaluate` (of several logs the first; `result["flight_3.csv"]` is another), a prepared `Log`, or a record `(u, y)` |
| `model` | a run, bundle, `Calibration` or `Narx`, or the free run of any other, (time, outputs); of the result of an evaluation it is its own |
| `channel` | an output; the first one by default. Outputs of arrays are y1, y2, ..., inputs u1, u2, ... |
| `ax` | where to draw; without it a new figure of pyplot, with a legend |

Raises `DataError` for data that are none of these, and for a channel that they lack.
"""  # noqa: E501 - a table

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from matplotlib.axes import Axes

from eval.judging.residuals import Correlation, ResidualTests, residual_tests
from eval.report import style
from eval.report.event_figures import draw_curves, draw_output
from eval.report.style import envelope
from eval.report.view import Data, Model, Traces, model_of, traces, view_of_data
from narxcal.channels import symbol
from narxcal.support.arrays import BoolArray, FloatArray, bridge_gaps
from narxcal.support.errors import DataError

if TYPE_CHECKING:
    from eval.diagnosis.diagnose import Answer

_LAGS: Final = 160  # drawn per correlation; a reader sees no more
LEGEND_COLUMNS: Final = 5  # in the width of one of two axes
_SEGMENTS: Final = 8  # of Hann windows that overlap by half, at least
_SEGMENT_S: Final = 100.0  # at most: ten times the slowest time constant of a spool
_SETTLED: Final = 5  # times what is drawn
# Variance of a mean of spectra whose Hann windows overlap by half, in that of independent ones:
# 1 + 2 (1/6)^2 (Welch, IEEE Trans. AU-15, 1967).
_OVERLAP: Final = 1.0 + 2.0 / 36.0


def compare(
    data: Data, model: Model | None = None, channel: str | None = None, *, ax: Axes | None = None
) -> Axes:
    """Draw an output as measured and in free run, with its fit in percent.

    fit = 100 (1 - ||y - y_model|| / ||y - mean(y)||) over the samples that are scored, as MATLAB's
    `compare` defines it. Shaded: the interval of the model, and in grey what is masked.
    """
    from eval.judging.scores import fit_percent  # noqa: PLC0415 - the page of `prepare` needs no model

    found = traces(data, model)
    curves, axes = found.output(channel), _axes(ax)
    draw_curves(axes, found.time_s, curves)
    if curves.model is not None:
        pair = curves.measured[:, None], curves.model[:, None]
        (fit,) = fit_percent(*pair, found.scored)
        text = f"fit {fit:.1f} %" if np.isfinite(fit) else "no fit: nothing varies"
        axes.text(
            0.995, 0.97, text, transform=axes.transAxes, ha="right", va="top", fontsize=7,
            color="#57606a",
        )  # fmt: skip
    axes.set_ylabel(style.with_unit(curves.name))
    style.clock(axes, found.time_s)
    return _finished(axes, ax)


def resid(
    data: Data | ResidualTests,
    model: Model | None = None,
    channel: str | None = None,
    *,
    cross: bool = False,
    ax: Axes | None = None,
) -> Axes:
    """Draw the residual's correlation with itself or, with `cross`, with every input.

    Shaded: the 95 % band, which a white residual leaves in 5 % of the lags. The band of `cross`
    allows for a coloured residual, which that of a free run is (`eval.judging.residuals`). A
    positive lag is an effect of the input that the model misses, a negative one feedback to the
    input.
    """
    part = data if isinstance(data, ResidualTests) else _residuals(traces(data, model), channel)
    axes, name = _axes(ax), symbol(part.channel)
    if not cross:
        _band(axes, part.auto, part.dt_s)
        _stems(axes, part.auto, part.dt_s)
        axes.set(xlabel="lag [s]", ylabel="autocorrelation [-]", ylim=(-1.05, 1.05))
    for (colour, dashes), (source, one) in zip(_INPUTS, part.cross.items(), strict=False):
        if not cross:
            break
        _band(axes, one, part.dt_s, None if axes.lines else "95 % band")
        lags, values = envelope(one.lags * part.dt_s, one.values, 2 * _LAGS)
        axes.plot(lags, values, color=colour, ls=dashes, lw=1.2, label=symbol(source))
    if cross:
        first = "lag [s] (positive: the input comes first)"
        axes.set(xlabel=first, ylabel="cross-correlation [-]")
    if ax is None:
        axes.set_title(f"residual of {name}", fontsize=8.0, loc="right")
    return _finished(axes, ax, LEGEND_COLUMNS)


def _residuals(found: Traces, channel: str | None) -> ResidualTests:
    error = found.error(channel)
    rows = slice(int(np.argmax(found.scored)), None)
    inputs = {name: values[rows] for name, values in found.inputs.items()}
    return residual_tests(found.output(channel).name, error[rows], inputs, found.dt_s)


# More inputs than colours: the dashes differ.
_INPUTS: Final = [(colour, dashes) for dashes in ("-", "--", ":", "-.") for colour in style.CYCLE]


def _stems(axes: Axes, part: Correlation, dt_s: float) -> None:
    """Bars from zero as one broken line: a tenth of the bytes of a collection of lines."""
    lags, bars = envelope(part.lags * dt_s, part.values, _LAGS)
    heights = np.column_stack([np.zeros_like(bars), bars, np.full_like(bars, np.nan)]).ravel()
    axes.plot(np.repeat(lags, 3), heights, color=style.MODEL, lw=1.0)


def _band(axes: Axes, part: Correlation, dt_s: float, label: str | None = "95 % band") -> None:
    lags, half = envelope(part.lags * dt_s, part.band_95, _LAGS)
    axes.fill_between(lags, -half, half, color=style.MASK, alpha=0.6, lw=0, label=label)


def steps(  # noqa: PLR0913 - the model, its conditions, and what is drawn
    model: Model,
    data: Data | None = None,
    channel: str | None = None,
    *,
    driver: str | None = None,
    levels: int = 4,
    seconds: float = 15.0,
    ax: Axes | None = None,
) -> Axes:
    """Draw how a model answers steps of the driver: up as a line, down dashed.

    The driver steps between `levels + 1` values that divide its range in `data`; all other inputs
    stay at their medians there. Before each step the inputs are held for five times as long as is
    drawn. A linear model answers all steps of one size alike. The result of `train` or `evaluate`
    brings its data.
    """
    if data is None and not hasattr(model, "views"):
        raise DataError(
            "a step needs data for its size and the other inputs", hint="steps(model, data)"
        )
    source: Any = model if data is None else data
    found, simulate = model_of(model, source)
    name, output, axes = found.input(driver), found.output(channel).name, _axes(ax)
    column, k = [*found.inputs].index(name), [*found.outputs].index(output)
    rows = max(1, round(seconds / found.dt_s))
    start = _SETTLED * rows
    held = np.tile([np.nanmedian(values) for values in found.inputs.values()], (start + rows, 1))
    low, high = np.nanmin(found.inputs[name]), np.nanmax(found.inputs[name])
    nodes = np.linspace(low, high, levels + 1)
    time_s = found.dt_s * np.arange(-1, rows)
    for place, ends in enumerate(pairwise(nodes)):
        colour = style.CYCLE[place % len(style.CYCLE)]
        for (before, after), dashes in ((ends, "-"), (ends[::-1], "--")):
            u = held.copy()
            u[:start, column], u[start:, column] = before, after
            y = simulate(u)[start - 1 :, k]
            label = f"{ends[0]:.3g} to {ends[1]:.3g}" if dashes == "-" else None
            axes.plot(time_s, y - y[0], color=colour, ls=dashes, lw=1.3, label=label)
    axes.axhline(0.0, color="#8c959f", lw=0.6)
    axes.set_xlabel(f"time after the step of {style.with_unit(name)} [s]")
    axes.set_ylabel(f"Δ{style.with_unit(output)}")
    return _finished(axes, ax)


def frequency(
    data: Data,
    model: Model | None = None,
    channel: str | None = None,
    *,
    driver: str | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the gain from driver to output over frequency: as measured, and of the model.

    The empirical transfer function is `H(f) = S_uy(f) / S_uu(f)` by Welch's spectra; that of the
    model is computed from its free run over the same inputs in the same way, so that both share
    what averaging over amplitudes and leakage do. Shaded: 95 % of `|H|` as measured, from the
    coherence c (Bendat and Piersol, Random Data, section 9.2): `|H| (1 +- 1.96 s)`,
    `s^2 = (1 - c) / (2 n c)`, n independent segments. Frequencies at which c could be that of
    unrelated signals (1 - 0.05^(1 / (n - 1))) are left out. Raises `DataError` for a record of
    less than eight segments of four samples, and where no frequency is left.
    """
    found = traces(data, model)
    curves, name, axes = found.output(channel), found.input(driver), _axes(ax)
    rows = slice(int(np.argmax(found.scored)), None)
    lever, measured = found.inputs[name][rows], curves.measured[rows]
    hz, gain, coherence, count = _transfer(lever, measured, found.dt_s)
    shown = coherence > 1.0 - 0.05 ** (1.0 / (count - 1.0))
    if not shown.any():
        raise DataError(
            f"{curves.name} does not follow {name} at any frequency",
            file=found.name,
            hint="Take a record in which the driver moves more",
        )
    half = 1.96 * np.sqrt((1.0 - coherence) / (2.0 * count * coherence))
    low, high = (_where(shown, gain * np.maximum(1.0 + way * half, 1e-3)) for way in (-1.0, 1.0))
    axes.fill_between(hz, low, high, color=style.MASK, alpha=0.6, lw=0, label="95 % interval")
    axes.plot(hz, _where(shown, gain), color=style.MEASURED, lw=1.0, label="measured")
    if curves.model is not None:
        own = _transfer(lever, _where(np.isfinite(measured), curves.model[rows]), found.dt_s)[1]
        axes.plot(hz, _where(shown, own), color=style.MODEL, lw=2.0, alpha=0.8, label="model")
    axes.set(xscale="log", yscale="log", xlabel="frequency [Hz]")
    axes.set_ylabel(f"gain {style.with_unit(name)} to {style.with_unit(curves.name)}")
    return _finished(axes, ax)


def _where(shown: BoolArray, values: FloatArray) -> FloatArray:
    return np.where(shown, values, np.nan)


def _transfer(
    u: FloatArray, y: FloatArray, dt_s: float
) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Frequencies in Hz without 0, |H| and coherence there, and independent segments."""
    from scipy.signal import csd  # noqa: PLC0415 - takes a second, and pages draw no spectrum

    size = min(round(_SEGMENT_S / dt_s), 2 * len(u) // (_SEGMENTS + 1))
    if size < 4:
        raise DataError(
            f"expected at least {2 * (_SEGMENTS + 1)} samples for a spectrum, found {len(u)}"
        )
    step, (u, y) = size // 2, map(bridge_gaps, (u, y))
    (hz, both), *alone = (
        csd(a, b, 1.0 / dt_s, nperseg=size, noverlap=size - step)
        for a, b in ((u, y), (u, u), (y, y))
    )
    (own, other), tiny = (part.real for _, part in alone), np.finfo(float).tiny
    coherence = np.abs(both) ** 2 / np.maximum(own * other, tiny)
    gain = np.abs(both) / np.maximum(own, tiny)
    return hz[1:], gain[1:], coherence[1:], ((len(u) - size) // step + 1) / _OVERLAP


def events(
    data: Data, event: int | None = None, channel: str | None = None, *, ax: Axes | None = None
) -> Axes:
    """Draw the driver with its pushes (orange) and pulls (blue); with `event`, that one's output.

    `event` counts from 0. An event is drawn as on a qualification page: flight and model over the
    time after the lever moved, 10 % and 90 % of the response, the windows for Ti and Tt. Raises
    `DataError` for an event that there is not, and for data without events.
    """
    view, axes = view_of_data(data), _axes(ax)
    if event is None:
        style.curve(axes, view.log.time_s, view.log[view.driver], style.DRIVER, lw=0.9)
        for one in (each.event for each in view.events):
            colour = style.BAD if one.label == 0 else style.MODEL
            axes.axvline(one.start_s, color=colour, lw=0.5, alpha=0.6)
        axes.set_ylabel(style.with_unit(view.driver))
        style.clock(axes, view.log.time_s)
        return _finished(axes, ax)
    if not 0 <= event < len(view.events):
        raise DataError(
            f"there is no event {event}, the log has {len(view.events)} (0 is the first)",
            file=view.name,
        )
    chosen = view.events[event]
    rows = view.rows(chosen.event)
    name = channel or view.outputs[0]
    curves = next((one for one in view.curves(rows) if one.name == name), None)
    if curves is None:
        raise DataError(
            "there is no such output", file=view.name, channel=name,
            hint=f"Outputs are {', '.join(view.outputs)}",
        )  # fmt: skip
    draw_output(axes, view.log.time_s[rows] - chosen.event.start_s, curves, chosen)
    axes.set_xlabel("time after the lever moved [s]")
    return _finished(axes, ax)


def gap(found: Answer, *, ax: Axes | None = None) -> Axes:
    """Draw the budget of `narxcal.diagnose`: causes as shares of the gap, by channel and phase."""
    from eval.diagnosis.pictures import draw_budget  # noqa: PLC0415 - loads the whole diagnosis

    axes = _axes(ax, height=5.0)
    draw_budget(axes, found.evidence.budget.rows())
    return axes


def _axes(ax: Axes | None, width: float = 8.0, height: float = 3.2) -> Axes:
    if ax is not None:
        return ax
    from matplotlib import pyplot as plt  # noqa: PLC0415 - pages open no window

    made: Any = plt.subplots(figsize=(width, height), layout="constrained")[1]
    axes: Axes = made
    return axes


def _finished(axes: Axes, given: Axes | None, columns: int = 5) -> Axes:
    """Dress the axes; those that a caller gave are often one of many and get no legend."""
    style.over_time(axes)
    if given is None:
        style.legend(axes, columns=columns)
    return axes
