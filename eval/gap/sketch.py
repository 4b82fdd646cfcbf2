"""What all drawings of an effect share: the effect with its sizes, panels, bands and bars."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eval.report import style
from narxcal.effects.base import Effect, Signals
from narxcal.support.arrays import FloatArray
from training.budget.result import Interval

WIDTH, HEIGHT = 4.6, 2.7  # in inches


class Sketch(NamedTuple):
    """An effect with its sizes, and the signals it acts on."""

    effect: Effect
    sizes: Mapping[str, Interval]
    signals: Signals

    @property
    def first(self) -> Interval:
        """Size of the effect's first parameter."""
        return self.sizes[self.effect.parameters(self.signals)[0].name]


def number(value: float) -> str:
    """Three digits, short where the last ones are 0."""
    return f"{value:.3g}"


def panel(x: str, y: str) -> tuple[Figure, Axes]:
    """An empty figure of one panel, its axes labelled."""
    drawn = style.figure(WIDTH, HEIGHT)
    axes = drawn.subplots()
    axes.set(xlabel=x, ylabel=y)
    return drawn, axes


def finish(axes: Axes, *, legend: bool = True) -> None:
    """Dress the axes as all of a page are, with a legend above."""
    style.dress(axes)
    if legend:
        style.legend(axes, columns=3)


def band(axes: Axes, x: FloatArray, low: FloatArray, high: FloatArray) -> None:
    """Shade between what the ends of an interval give."""
    axes.fill_between(x, low, high, color=style.MODEL, alpha=0.2, lw=0)


def bar(axes: Axes, place: float, size: Interval, color: str, width: float = 0.6) -> None:
    """A bar with its interval as a line."""
    axes.bar(place, size.value, width, color=color)
    axes.plot([place, place], [size.low, size.high], color=style.MEASURED, lw=1.2)
