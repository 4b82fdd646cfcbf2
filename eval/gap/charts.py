"""What was tried and how far the gap shrinks, drawn: dots with intervals, and bars."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eval.gap.summary import effect_name
from eval.report import style
from eval.report.style import Picture, picture
from narxcal.channels import symbol

_MOST_EFFECTS, _MOST_MODELS = 12, 15
_ROW, _LEFT, _WIDTH = 0.26, 2.5, 8.6  # inches
_QUIET = "#8c959f"
_SIDES = {"input": style.CYCLE[4], "process": style.CYCLE[0], "sensor": style.CYCLE[2]}
_THEIL = {"bias": style.CYCLE[1], "variance": style.CYCLE[4], "covariance": style.CYCLE[0]}


def effect_ranking(document: Mapping[str, Any]) -> Picture | None:
    """Probability and gain of the leading effects, each with its interval; None without any."""
    rows = document["effects"][:_MOST_EFFECTS]
    if not rows:
        return None
    claimed = set(document["verdict"]["effects"])
    names = [effect_name(row) for row in rows]
    figure, left, right = _side_by_side(names)
    for place, (name, row) in enumerate(zip(names, rows, strict=True)):
        color = style.MODEL if name in claimed else _QUIET
        left.barh(place, 100 * row["probability"], 0.62, color=color)
        left.text(100 * row["probability"] + 2, place, f"{100 * row['probability']:.0f} %",
                  va="center", size=7.5)  # fmt: skip
        _whisker(right, place, row["gain"], color, hollow=bool(row.get("with")))
    left.set(xlabel="probability [%]", xlim=(0, 115), xticks=(0, 50, 100))
    right.set(xlabel="gain: share of the gap taken away [%]")
    _share_axis(right)
    texts = [
        f"{name} {100 * row['probability']:.0f} %" for name, row in zip(names, rows, strict=True)
    ]
    more = len(document["effects"]) - len(rows)
    caption = "Blue: claimed. Gain on flights that had no part in the fit, with its least and most "
    caption += "over flights; hollow: together with another effect." + (
        f" {more} lesser effects are in the table." if more > 0 else ""
    )
    return picture(figure, f"Probability and gain of effects: {', '.join(texts[:5])}", caption)


def model_chart(document: Mapping[str, Any]) -> Picture | None:
    """Gain of the leading models, flight by flight; None without any."""
    rows = sorted(document["tried"], key=lambda row: -_finite(row["gain"]))[:_MOST_MODELS]
    if not rows:
        return None
    names = [" + ".join(row["effects"]) for row in rows]
    drawn, axes = _rows(names)
    for place, row in enumerate(rows):
        flights = [100 * _clipped(gain) for gain in row["flights"]]
        axes.plot(flights, [place] * len(flights), "o", ms=3, color=style.CYCLE[5], mew=0)
        axes.plot([100 * _clipped(row["gain"])], [place], "|", ms=10, mew=2.2, color=style.MODEL)
    axes.set_xlabel("gain: share of the gap taken away [%]")
    lost = any(_finite(gain) < -1.0 for row in rows for gain in (*row["flights"], row["gain"]))
    _share_axis(axes)
    return picture(
        drawn,
        f"Gain of {len(names)} models, best: {names[0]} {100 * _clipped(rows[0]['gain']):.0f} %",
        "Dots: single flights, each with the parameters that the others give; bar: all together."
        + (" Gains below -100 % are drawn there." if lost else ""),
    )


def prediction(document: Mapping[str, Any]) -> Picture | None:
    """Predicted shrinkage with its interval beside the realised one; None where none is."""
    shrink = document["shrink"]
    if not document["verdict"]["effects"]:
        return None
    realised = shrink.get("realised")
    names = ["predicted"] + (["realised"] if realised is not None else [])
    drawn, axes = _rows(names, width=5.2, left=0.9)
    _whisker(axes, 0, shrink["predicted"], style.MODEL)
    text = f"predicted {_percent(shrink['predicted']['value'])}"
    if realised is not None:
        axes.plot([100 * _clipped(realised)], [1], "D", ms=6, color=style.GOOD)
        text += f", realised {_percent(realised)}"
    axes.set_xlabel("share of the gap that is taken away [%]")
    _share_axis(axes)
    caption = "Line: the 90 % interval of the prediction, by flights that the others predict. "
    caption += (
        "Diamond: what came true on flights that took no part."
        if realised is not None
        else "No flights were held out; --heldout-real gives the test that counts."
    )
    return picture(drawn, f"Shrinkage of the gap: {text}", caption)


def channel_bars(document: Mapping[str, Any]) -> Picture | None:
    """RMSE of every channel before and after, and its floor, over that before.

    None without any gap, and where no effect is claimed, so that nothing changes it.
    """
    channels = {
        name: row
        for name, row in document["shrink"]["channels"].items()
        if _finite(row["before"]) > 0.0
    }
    if not channels or not document["verdict"]["effects"]:
        return None
    drawn = style.figure(max(3.0, 0.9 + 0.95 * len(channels)), 2.7)
    axes = drawn.subplots()
    for place, row in enumerate(channels.values()):
        for at, key in enumerate(("before", "after")):
            share = 100 * _finite(row[key]) / row["before"]
            color = (style.STEADY, style.GOOD)[at]
            axes.bar(
                place + 0.36 * at - 0.18, share, 0.34, color=color, label=None if place else key
            )
        floor = 100 * _finite(row["floor"]) / row["before"]
        axes.plot([place - 0.38, place + 0.38], [floor] * 2, color=style.MEASURED, lw=1.4,
                  label=None if place else "noise floor")  # fmt: skip
    axes.set_xticks(range(len(channels)), [symbol(name) for name in channels])
    axes.set_ylabel("RMSE of the gap [%], before = 100")
    style.dress(axes, grid="y")
    style.legend(axes)
    texts = [
        f"{symbol(name)} {100 * _finite(row['after']) / row['before']:.0f} %"
        for name, row in channels.items()
    ]
    return picture(drawn, f"RMSE left of that before: {', '.join(texts)}", "")


def sides(document: Mapping[str, Any]) -> Picture | None:
    """Input, process or sensor side as one bar; None where there is no gap."""
    found = {name: _finite(document["side"].get(name)) for name in _SIDES}
    if sum(found.values()) <= 0.0:
        return None
    return _stacked({"": found}, _SIDES, "Side of the engine")


def theil(document: Mapping[str, Any]) -> Picture | None:
    """Theil's split of every channel's gap; None without any."""
    found = {
        symbol(name): {key: _finite(row.get(key)) for key in _THEIL}
        for name, row in document["theil"].items()
    }
    if not any(sum(parts.values()) > 0.0 for parts in found.values()):
        return None
    return _stacked(found, _THEIL, "Theil's split of the squared gap")


def _stacked(
    rows: Mapping[str, Mapping[str, float]], colors: Mapping[str, str], what: str
) -> Picture:
    names = list(rows)
    drawn, axes = _rows(names, width=5.2, left=0.9, top=0.25)
    for place, parts in enumerate(rows.values()):
        start = 0.0
        for key, share in parts.items():
            axes.barh(place, 100 * share, 0.6, left=start, color=colors[key],
                      label=None if place else key)  # fmt: skip
            if share >= 0.08:
                axes.text(start + 50 * share, place, f"{100 * share:.0f}", ha="center",
                          va="center", size=7.5, color="white", weight="bold")  # fmt: skip
            start += 100 * share
    axes.set(xlim=(0, 100), xlabel="share [%]")
    style.legend(axes)
    texts = [
        f"{name}: ".removeprefix(": ")
        + ", ".join(f"{key} {100 * share:.0f} %" for key, share in parts.items())
        for name, parts in rows.items()
    ]
    return picture(drawn, f"{what}; {'; '.join(texts)}", "")


def _rows(
    names: Sequence[str], *, width: float = _WIDTH, left: float = 3.2, top: float = 0.06
) -> tuple[Figure, Axes]:
    """Axes with one row of fixed height per name."""
    height = top + _ROW * len(names) + 0.42
    drawn = Figure(figsize=(width, height), facecolor="white")
    place = (left / width, 0.42 / height)
    axes = drawn.add_axes((*place, (width - left - 0.15) / width, 1 - (0.42 + top) / height))
    _name_rows(axes, names)
    return drawn, axes


def _side_by_side(names: Sequence[str]) -> tuple[Figure, Axes, Axes]:
    height = 0.06 + _ROW * len(names) + 0.42
    drawn = Figure(figsize=(_WIDTH, height), facecolor="white")
    wide, tall = (_WIDTH - _LEFT - 0.4) / 2 / _WIDTH, 1 - 0.48 / height
    left = drawn.add_axes((_LEFT / _WIDTH, 0.42 / height, 0.8 * wide, tall))
    place = (_LEFT + 0.25) / _WIDTH + 0.8 * wide
    right = drawn.add_axes((place, 0.42 / height, 1.2 * wide, tall), sharey=left)
    _name_rows(left, names)
    style.dress(right)
    right.tick_params(labelleft=False)
    return drawn, left, right


def _name_rows(axes: Axes, names: Sequence[str]) -> None:
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.5, -0.5)
    style.dress(axes)


def _share_axis(axes: Axes) -> None:
    """At least 0 to 100 %; never further down than -100 %."""
    low, _ = axes.get_xlim()
    axes.set_xlim(min(-4.0, max(low, -104.0)), 104.0)
    axes.axvline(0.0, color=_QUIET, lw=0.7)


def _whisker(
    axes: Axes,
    place: float,
    found: Mapping[str, float | None],
    color: str,
    *,
    hollow: bool = False,
) -> None:
    low, high = (
        _clipped(found[key], otherwise) for key, otherwise in (("low", -1.0), ("high", 1.0))
    )
    axes.plot([100 * low, 100 * high], [place, place], color=color, lw=1.4)
    axes.plot([100 * _clipped(found["value"])], [place], "o", ms=5, color=color,
              mfc="white" if hollow else color)  # fmt: skip


def _clipped(value: float | None, otherwise: float = 0.0) -> float:
    if value is None or math.isnan(value):
        return otherwise
    return float(np.clip(value, -1.0, 1.0))


def _finite(value: float | None) -> float:
    return float(value) if value is not None and math.isfinite(value) else 0.0


def _percent(value: float | None) -> str:
    return "unknown" if value is None else f"{100 * value:.0f} %"
