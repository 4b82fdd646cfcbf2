"""Tables of the page of a diagnosis, from its document alone."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from eval.gap.effect_words import sizes_words, spread_words
from eval.gap.page_cells import count, percent, seconds, span, whole
from eval.gap.summary import effect_name, seconds_within, windows_named
from eval.report.style import unit, with_unit
from eval.report.tables import NOTHING, Cell, Mark, Table, figure
from narxcal.channels import symbol

_TOO_COARSE = 0.5  # of the gap: an emulator with more error than this says little about it


def bins(document: Mapping[str, Any]) -> Table:
    """Every bin of the gap's energy, largest first; the core is marked.

    With a claim also how what the effects do divides over the bins.
    """
    claims = any(row.get("explained") is not None for row in document["where"])
    rows = tuple(
        (
            Cell(symbol(row["channel"]), "head"),
            Cell(row["direction"]),
            Cell(row["phase"]),
            percent(row["share"], "best" if row.get("core") else ""),
            Cell(span(row), number=True),
            *((percent(row["explained"]),) if claims else ()),
            Cell(_regime(row["regime"])),
        )
        for row in document["where"]
    )
    named = ("channel", "direction", "phase", "share [%]", "90 % interval [%]")
    head = (*named, *(("of what the effects do [%]",) if claims else ()), "mostly at")
    return Table("Marked: the fewest bins that hold 70 % of the energy", head, rows)


def _regime(regime: Mapping[str, str]) -> str:
    return ", ".join(f"{key} {level}" for key, level in regime.items() if level != "all") or NOTHING


def regimes(document: Mapping[str, Any]) -> Table:
    """How the gap's energy divides over altitude, Mach, power and bleed."""
    rows = tuple(
        (Cell(name, "head"), Cell(level), percent(row["share"]), Cell(span(row), number=True))
        for name, levels in document["quality"].get("regimes", {}).items()
        for level, row in levels.items()
    )
    head = ("regime", "level", "share [%]", "90 % interval [%]")
    return Table("Each regime adds up to the whole", head, rows)


def bands(document: Mapping[str, Any]) -> Table:
    """At which frequencies each channel's gap lives."""
    rows = tuple(
        (
            Cell(symbol(name), "head"),
            Cell(f"{row['low_hz']:g} to {row['high_hz']:g}", number=True),
            percent(row["share"]),
            Cell(span(row), number=True),
            Cell(f"{row['coherence']:.2f}", number=True),
        )
        for name, found in document["quality"].get("bands", {}).items()
        for row in found
    )
    head = ("channel", "band [Hz]", "share [%]", "90 % interval [%]", "coherence with the driver")
    return Table("Each channel adds up to its own gap", head, rows)


def effects(document: Mapping[str, Any]) -> Table:
    """Ranked effects in full."""
    claimed = set(document["verdict"]["effects"])
    rows = tuple(_effect(row, claimed) for row in document["effects"])
    head = ("effect", "family", "side", "probability [%]", "gain [%]", "least to most [%]",
            "parameters with 90 % interval", "remark")  # fmt: skip
    return Table("Claimed effects first, then by probability", head, rows)


def _effect(row: Mapping[str, Any], claimed: set[str]) -> tuple[Cell, ...]:
    name = effect_name(row)
    remarks = ["claimed"] if name in claimed else []
    if row.get("with"):
        remarks.append(f"fitted with {', '.join(row['with'])}")
    bounds = [each.removeprefix(f"{name} ") for each in row.get("at_bound", ())]
    remarks += [f"{each} is at the bound of its range" for each in bounds]
    return (
        Cell(name, "head"),
        Cell(row["family"]),
        Cell(row.get("side", "")),
        percent(row["probability"], "best" if name in claimed else ""),
        percent(row["gain"]["value"]),
        Cell(span(row["gain"]), number=True),
        Cell(sizes_words(row)),
        Cell("; ".join(remarks)),
    )


def windows(document: Mapping[str, Any]) -> Table:
    """When an unlogged load was on, and what it shifted there."""
    found = windows_named(document)
    names = list(found[0]["shift"]) if found else []
    rows = tuple(
        (
            Cell(spell["log"], "head"),
            *(
                Cell(seconds_within(spell[f"{end}_s"], spell[f"{end}_span_s"]), number=True)
                for end in ("start", "end")
            ),
            *(Cell(spread_words(spell["shift"][name]), number=True) for name in names),
            Cell("held out" if spell["held_out"] else "diagnosed"),
        )
        for spell in found
    )
    head = ("log", "from [s]", "to [s]", *(f"Δ{with_unit(name)}" for name in names), "flight")
    return Table("Windows, and the shift in each, with 90 % intervals", head, rows)


def models(document: Mapping[str, Any]) -> Table:
    """Every model that was fitted, by its gain."""
    tried = sorted(document["tried"], key=lambda row: -_real(row["gain"]))
    rows = tuple(
        (
            Cell(" + ".join(row["effects"]), "head"),
            Cell(row["family"]),
            percent(row["gain"]),
            Cell(_reach(row["flights"]), number=True),
            percent(row["probability"]),
        )
        for row in tried
    )
    head = ("model", "family", "gain [%]", "over flights [%]", "probability [%]")
    return Table("Gain on flights that had no part in the fit", head, rows)


def _reach(values: Sequence[float | None]) -> str:
    known = [100 * value for value in values if value is not None]
    return f"{whole(min(known))} to {whole(max(known))}" if known else NOTHING


def shrinkage(document: Mapping[str, Any]) -> Table:
    """Per channel: RMSE before, after and floor, and what that is of the squared gap.

    Without a claim nothing is added, so that there is no after.
    """
    shrink, claims = document["shrink"], bool(document["verdict"]["effects"])
    rows = tuple(
        (
            Cell(with_unit(name), "head"),
            figure(row["before"]),
            *((figure(row["after"], _better(row["before"], row["after"])),) if claims else ()),
            figure(row["floor"]),
            *((percent(_taken(row)),) if claims else ()),
        )
        for name, row in shrink["channels"].items()
    )
    head = ("RMSE of", "before", "after", "noise floor", "off the squared gap [%]")
    shown = head if claims else ("channel", "RMSE of the gap", "noise floor")
    return Table(_on(document), shown, rows)


def _on(document: Mapping[str, Any]) -> str:
    on = document["shrink"].get("on", "the flights of the diagnosis")
    return f"On {on}; root mean square of recorded less simulated"


def _taken(row: Mapping[str, float | None]) -> float | None:
    before, after = _real(row["before"]), _real(row["after"])
    return 1.0 - (after / before) ** 2 if before > 0.0 else None


def times(document: Mapping[str, Any]) -> Table:
    """Errors of Ti and Tt before and after, per channel; without a claim there is no after."""
    found, claims = document["shrink"].get("times", {}), bool(document["verdict"]["effects"])
    rows = tuple(
        (
            Cell(symbol(name), "head"),
            count(row["events"]),
            *(cell for time in ("Ti", "Tt") for cell in _time(row, time, after=claims)),
        )
        for name, row in found.items()
    )
    head = [f"{time} {when} [s]" for time in ("Ti", "Tt") for when in ("before", "after")]
    shown = head if claims else ["Ti [s]", "Tt [s]"]
    return Table("Mean absolute errors of Ti and Tt", ("channel", "events", *shown), rows)


def _time(row: Mapping[str, Any], name: str, *, after: bool) -> list[Cell]:
    before, then = row[f"{name}_before_s"], row[f"{name}_after_s"]
    return [seconds(before), *([seconds(then, _better(before, then))] if after else [])]


def late(document: Mapping[str, Any]) -> Table:
    """Median errors of Ti and Tt of the simulator as it is, pushes and pulls apart."""
    rows = tuple(
        (
            Cell(symbol(name), "head"),
            Cell(direction),
            count(row["events"]),
            seconds(row["Ti_s"]),
            seconds(row["Tt_s"]),
        )
        for name, both in document["quality"].get("Ti_Tt", {}).items()
        for direction, row in both.items()
    )
    head = ("channel", "direction", "events", "Ti [s]", "Tt [s]")
    caption = "Median of recorded less simulated: positive where the engine is later"
    return Table(caption, head, rows)


def theil(document: Mapping[str, Any]) -> Table:
    """Theil's split of every channel."""
    rows = tuple(
        (
            Cell(symbol(name), "head"),
            *(percent(row[key]) for key in ("bias", "variance", "covariance")),
            figure(row["inequality"]),
        )
        for name, row in document["theil"].items()
    )
    head = ("channel", "bias [%]", "variance [%]", "covariance [%]", "inequality U")
    return Table("Theil's split of the squared gap", head, rows)


def emulator(document: Mapping[str, Any]) -> Table:
    """The emulator's own error beside the gap that it has to explain."""
    before, there = document["shrink"]["channels"], document["emulator"].get("rmse_heldout", {})
    rows = tuple(
        (
            Cell(with_unit(name), "head"),
            figure(rmse, _coarse(rmse, before.get(name, {}).get("before"))),
            *((figure(there[name]),) if there else ()),
            figure(before.get(name, {}).get("before")),
            figure(document["quality"].get("noise", {}).get(name)),
        )
        for name, rmse in document["emulator"]["rmse"].items()
    )
    on_held = ("on held-out flights",) if there else ()
    head = ("channel", "emulator's own RMSE", *on_held, "RMSE of the gap", "noise")
    return Table("Free run of the emulator over whole simulated flights", head, rows)


def _coarse(rmse: float | None, gap: float | None) -> Mark:
    if rmse is None or gap is None:
        return "none"
    return "bad" if rmse > _TOO_COARSE * gap else "good"


def changed(document: Mapping[str, Any]) -> Table:
    """What was changed in the logs, or is missing in them, in samples."""
    rows = tuple(
        (Cell(flight, "head"), Cell(reason), count(samples))
        for flight, reasons in document["quality"].get("changed", {}).items()
        for reason, samples in reasons.items()
    )
    return Table("Samples that are unknown, masked or cut", ("flight", "what", "samples"), rows)


def compared(document: Mapping[str, Any]) -> Table:
    """Outputs that are compared but not diagnosed."""
    rows = tuple(
        (Cell(symbol(name), "head"), figure(rmse), Cell(unit(name)))
        for name, rmse in document["quality"].get("compared", {}).items()
    )
    head = ("channel", "RMSE of recorded less simulated", "unit")
    return Table("Recorded on both sides, compared, not diagnosed", head, rows)


def _better(before: float | None, after: float | None) -> Mark:
    return "best" if _real(after, math.inf) < 0.98 * _real(before) else ""


def _real(value: float | None, otherwise: float = 0.0) -> float:
    return otherwise if value is None or not math.isfinite(value) else float(value)
