"""The page of a diagnosis: one self-contained HTML text, from its document and its evidence."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from eval.gap import charts, heat_maps, page_tables
from eval.gap.drawings import drawing
from eval.gap.evidence import Evidence
from eval.gap.overlays import event_picture, flight_picture, views
from eval.gap.summary import effect_name
from eval.gap.verdict_box import next_flights, tiles, verdict_box
from eval.report.page import RunHeader, render
from eval.report.style import Picture
from narxcal.effects.library import effect
from training.budget.result import Interval

_MOST_DRAWN = 4


class Drawn(NamedTuple):
    """An effect drawn as an engineer draws it, and what it stands for."""

    name: str
    standing: str
    picture: Picture


def gap_page(document: Mapping[str, Any], evidence: Evidence, created: str = "") -> str:
    """Build the page of `diagnose`; `created` is the time it bears."""
    own, held = views(evidence)
    return render(
        "gap.html.j2",
        header=header(document, created),
        document=document,
        box=verdict_box(document),
        tiles=tiles(document),
        next_flights=next_flights(document),
        drawn=drawn_effects(document, evidence),
        own=(event_picture(own), flight_picture(own)),
        held=None if held is None else (event_picture(held), flight_picture(held)),
        charts=charts,
        heat_maps=heat_maps,
        page_tables=page_tables,
    )


def header(document: Mapping[str, Any], created: str) -> RunHeader:
    """What the page says about where it comes from."""
    quality = document["quality"]
    facts = {
        "Flights": ", ".join(quality.get("flights", ())),
        "Held out": ", ".join(quality.get("held_out", ())),
        "Parts that stand for flights": ", ".join(quality.get("parts", ())),
        "Rate": _rate(quality),
        "Driver": quality.get("driver", ""),
        "Computed in": f"{quality['wall_s']:.0f} s" if "wall_s" in quality else "",
    }
    return RunHeader(
        title="Diagnosis of the gap between simulator and engine",
        created=created,
        model=_compared(quality),
        versions=quality.get("versions", {}),
        facts={name: text for name, text in facts.items() if text},
    )


def _compared(quality: Mapping[str, Any]) -> str:
    kind, count = quality.get("simulator", "logs"), len(quality.get("flights", ()))
    flights = "one flight" if count == 1 else f"{count} flights"
    return f"{_SIMULATORS.get(kind, kind)}, compared with {flights}"


_SIMULATORS = {
    "logs": "simulated logs",
    "bundle": "a calibration of narxcal",
    "virtual engine": "the virtual engine",
    "function": "a function of Python",
}


def _rate(quality: Mapping[str, Any]) -> str:
    if "rate_hz" not in quality:
        return ""
    return f"{quality['rate_hz']:.4g} Hz, worked at {quality.get('worked_at_hz', 0.0):.4g} Hz"


def drawn_effects(document: Mapping[str, Any], evidence: Evidence) -> list[Drawn]:
    """The claimed effects and their rivals; where nothing is claimed, the best candidate.

    Nothing is drawn where there is no gap.
    """
    verdict, signals = document["verdict"], evidence.data.flights.signals
    standings = dict.fromkeys(verdict["effects"], "claimed")
    standings |= dict.fromkeys(verdict["ambiguous_with"], "cannot be told from it")
    rows = {effect_name(row): row for row in document["effects"]}
    if verdict["kind"] == "unknown" and rows:
        standings = {next(iter(rows)): "best candidate, not claimed"}
    found = []
    for name, standing in standings.items():
        if name in rows and effect(name).applies(signals):
            sizes = {
                key: Interval(each["value"], each["low"], each["high"])
                for key, each in rows[name]["parameters"].items()
            }
            found.append(Drawn(name, standing, drawing(effect(name), sizes, signals)))
    return found[:_MOST_DRAWN]
