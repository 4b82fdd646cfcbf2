"""The page of `watch`: alarms, ranking, map of tails over time, and curves of engines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from matplotlib.axes import Axes

from eval.fleets.watch import QUANTITIES, Alarm, Effects, Key, Watch, commands
from eval.report import style
from eval.report.page import RunHeader, render
from eval.report.style import Picture, number, picture
from eval.report.tables import Cell, Row, Table, plain, row
from narxcal.channels import symbol
from narxcal.intervals import LEVEL
from narxcal.support.arrays import FloatArray

MOST_DRAWN: Final = 8  # engines with curves
MOST_ROWS: Final = 60  # engines on the map
_CELLS = 60  # of time on the map
_POINTS = 200  # flights of a curve; of more, the extremes are drawn, without standard errors
_INTERVAL = 1.6449  # standard errors of the product's usual 90 %

Engine = tuple[str, str]


def watch_page(header: RunHeader, found: Watch, place: Mapping[str, str]) -> str:
    """Build the page; `place` says where `flights` and `run` are, as `watch.commands`."""
    ranked = ranking(found)
    return render(
        "watch.html.j2",
        header=header,
        outcome=found.outcome,
        alarms=alarm_table(found.alarms),
        commands=[(_title(one), "\n".join(commands(one, **place))) for one in found.alarms],
        ranking=ranking_table(found, ranked),
        map=_map(found, list(ranked)[:MOST_ROWS]) if ranked else None,
        curves=[_curves(found, one) for one in list(ranked)[:MOST_DRAWN]],
        undrawn=max(len(ranked) - MOST_DRAWN, 0),
    )


def ranking(found: Watch) -> dict[Engine, tuple[int, float, Key]]:
    """Engines with the most alarms first: those, the largest change of a level, and of what.

    A change of level is in standard deviations of a single flight about it.
    """
    ranked: dict[Engine, tuple[int, float, Key]] = {}
    for one in found.effects:
        engine = (one.key.tail, one.key.engine)
        size = float(np.max(_departure(found, one)))
        if engine not in ranked or size > ranked[engine][1]:
            ranked[engine] = (0, size, one.key)
    for alarm in found.alarms:
        for name in alarm.engines:
            count, size, key = ranked[alarm.tail, name]
            ranked[alarm.tail, name] = (count + 1, size, key)
    order = sorted(ranked, key=lambda one: (-ranked[one][0], -ranked[one][1], one))
    return {one: ranked[one] for one in order}


def _departure(found: Watch, one: Effects) -> FloatArray:
    """Distance (n,) of the level from that of the first flight."""
    variance = found.priors[one.key.channel, one.key.quantity].variance
    spread = np.sqrt(variance + np.mean(one.series.errors**2))
    away: FloatArray = np.abs(one.drift.level - one.drift.level[0]) / spread
    return away


def _title(alarm: Alarm) -> str:
    who = " and ".join(filter(None, alarm.engines))
    return (
        f"{alarm.tail} {who}".strip()
        + f": {alarm.kind}"
        + ("" if alarm.kind == "trend" else f" at {alarm.at}")
    )


def alarm_table(alarms: Sequence[Alarm]) -> Table:
    """A row per change, those of one alarm below a row that says what they may be."""
    head = ("engine", "of", "size", "standard error", "unit", "p over the fleet")
    rows: list[Row] = []
    for alarm in alarms:
        where = "" if alarm.first == alarm.last else f" ({alarm.first} to {alarm.last})"
        text = f"{_title(alarm)}{where}, {alarm.hours:.1f} h: {alarm.cause}"
        rows.append((Cell(text, "group"),))
        for key, one in alarm.changes:
            rate = 100.0 if one.kind == "trend" else 1.0
            unit = f"{key.unit} per 100 h" if one.kind == "trend" else key.unit
            p = plain(f"{one.adjusted:.1g}")
            rows.append(row(key.who, key.what, rate * one.size, rate * one.error, unit, p))
    return Table("", head, tuple(rows))


def ranking_table(found: Watch, ranked: Mapping[Engine, tuple[int, float, Key]]) -> Table:
    """Engines with the most alarms first."""
    head = ("tail and engine", "flights", "hours", "alarms", "largest change of level", "of")
    rows = tuple(
        row(
            key.who, len(found.flights[tail]), float(found.hours[tail][-1]),
            Cell(str(count), "bad" if count else "", number=True), size, key.what,
        )
        for (tail, _), (count, size, key) in ranked.items()
    )  # fmt: skip
    caption = "Change of level in standard deviations of one flight about it"
    return Table(caption, head, rows)


def _map(found: Watch, engines: Sequence[Engine]) -> Picture:
    """Engines against flight hours: the largest departure of any level from its first value."""
    end = max(float(found.hours[tail][-1]) for tail, _ in engines)
    edges = np.linspace(0.0, end, _CELLS + 1)
    middles = 0.5 * (edges[1:] + edges[:-1])
    values = np.full((len(engines), _CELLS), np.nan)
    row = {one: k for k, one in enumerate(engines)}
    for one in found.effects:
        k = row.get((one.key.tail, one.key.engine))
        if k is not None:
            flight = np.searchsorted(one.series.hours, middles).clip(max=len(one.flights) - 1)
            away = np.where(middles <= found.hours[one.key.tail][-1], 0.0, np.nan)
            values[k] = np.fmax(values[k], away + _departure(found, one)[flight])
    drawn = style.figure(10.0, 0.9 + 0.2 * len(engines))
    axes = drawn.subplots()
    image = axes.pcolormesh(
        edges, np.arange(len(engines) + 1), np.ma.masked_invalid(values), cmap="Blues", vmin=0.0,
        vmax=max(3.0, float(np.nanmax(values))),
    )  # fmt: skip
    for alarm in found.alarms:
        for name in alarm.engines:
            if (alarm.tail, name) in row:
                axes.plot(alarm.hours, row[alarm.tail, name] + 0.5, "v", color=style.BAD, ms=4.0)
    names = [f"{tail} {engine}".strip() for tail, engine in engines]
    axes.set_yticks(np.arange(len(engines)) + 0.5, names)
    axes.invert_yaxis()
    axes.set_xlabel("flight hours of the tail")
    style.dress(axes, grid="x")
    bar = drawn.colorbar(image, ax=axes)
    bar.ax.tick_params(labelsize=7)
    bar.set_label("change of level", size=8)
    caption = (
        "The largest change of the level of any quantity since the first flight, in standard "
        "deviations of one flight. Triangles: alarms, trends at their beginning."
    )
    return picture(drawn, "Map of engines against flight hours", caption)


def _curves(found: Watch, engine: Engine) -> tuple[str, Picture]:
    """All series of an engine: flights with their standard errors, level with its interval."""
    own = [one for one in found.effects if (one.key.tail, one.key.engine) == engine]
    channels = list(dict.fromkeys(one.key.channel for one in own))
    quantities = [name for name in QUANTITIES if any(one.key.quantity == name for one in own)]
    drawn = style.figure(10.0, 0.4 + 1.35 * len(channels))
    grid = drawn.subplots(len(channels), len(quantities), squeeze=False, sharex=True)
    for axes in grid.flat:
        axes.set_visible(False)
    for one in own:
        place = channels.index(one.key.channel), quantities.index(one.key.quantity)
        _curve(grid[place], one)
    for axes in grid[-1]:
        axes.set_xlabel("flight hours")
    name = " ".join(filter(None, engine))
    caption = (
        "Points: flights with their standard errors, of very many the extremes. Curve: level with "
        f"its {100 * LEVEL:.0f} % interval, red with a trend. Upright lines: steps and outliers."
    )
    listed = ", ".join(symbol(each) for each in channels)
    return name, picture(drawn, f"{listed} of {name} over flight hours", caption)


def _curve(axes: Axes, one: Effects) -> None:
    hours, drift = one.series.hours, one.drift
    axes.set_visible(True)
    at, values = style.envelope(hours, one.series.y, _POINTS)
    errors = one.series.errors if len(at) == len(hours) else None
    axes.errorbar(at, values, errors, fmt=".", ms=3.0, lw=0.6, color=style.DRIVER, alpha=0.7)
    trend = any(change.kind == "trend" for change in drift.changes)
    style.curve(axes, hours, drift.level, style.BAD if trend else style.MODEL, lw=1.4)
    half = _INTERVAL * drift.level_error
    axes.fill_between(
        hours, drift.level - half, drift.level + half, color=style.MODEL, alpha=0.18, lw=0
    )
    for change in drift.changes:
        if change.kind != "trend":
            axes.axvline(hours[change.at], color=style.BAD, lw=0.9)
    axes.set_ylabel(f"{one.key.what}{f' [{one.key.unit}]' if one.key.unit else ''}")
    style.dress(axes, size=6.5)


def console_rows(found: Watch) -> list[list[str]]:
    return [
        [
            _title(alarm), ", ".join(dict.fromkeys(key.what for key, _ in alarm.changes)),
            number(min(one.adjusted for _, one in alarm.changes), 1), alarm.cause,
        ]
        for alarm in found.alarms
    ]  # fmt: skip
