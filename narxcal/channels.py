"""The canonical channels: the one table of names, units, roles and physical ranges.

A configuration may declare further ones (`data_prep.config.DeclaredChannel`). Their names, as those
of the table, end in their unit: what takes a name alone knows the unit by it (`described`), and a
log the physical range, too (`data_prep.log.Log.channel`).
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.resources import files
from typing import Literal

from narxcal.support.errors import ConfigError, did_you_mean

# Slack on the physical limits, in parts of their distance: an air-data computer on the ground shows
# Mach -4e-6. Where none are known, what a recorder of single precision can hold is the limit.
_SLACK, _WIDEST = 0.005, 3.4e38

Role = Literal["time", "lever", "ambient", "switch", "output", "auxiliary"]


@dataclass(frozen=True)
class Channel:
    """One signal: its canonical name is also its CSV header.

    `low` and `high` bound what is physically possible for any turbofan; a sample outside is a
    recording fault, not an extreme manoeuvre.
    """

    name: str
    unit: str
    role: Role
    low: float
    high: float
    meaning: str

    @property
    def limits(self) -> tuple[float, float]:
        """The physical range with some slack; a value outside counts as not measured."""
        slack = _SLACK * (self.high - self.low)
        return max(self.low - slack, -_WIDEST), min(self.high + slack, _WIDEST)


_TABLE = (
    Channel("time_s", "s", "time", float("-inf"), float("inf"), "time, strictly increasing"),
    Channel("TRA_deg", "deg", "lever", -30.0, 120.0, "throttle resolver angle"),
    Channel("ALT_ft", "ft", "ambient", -2000.0, 60000.0, "pressure altitude"),
    Channel("Mach", "-", "ambient", 0.0, 1.2, "flight Mach number"),
    Channel("dT_C", "degC", "ambient", -60.0, 60.0, "static temperature minus ISA"),
    Channel("WOW", "0/1", "switch", 0.0, 1.0, "weight on wheels"),
    Channel("Approach", "0/1", "switch", 0.0, 1.0, "approach idle selected"),
    Channel("ECS", "0/1", "switch", 0.0, 1.0, "environmental control bleed"),
    Channel("NAI", "0/1", "switch", 0.0, 1.0, "nacelle anti-ice"),
    Channel("WAI", "0/1", "switch", 0.0, 1.0, "wing anti-ice"),
    Channel("N1_pct", "%", "output", 0.0, 130.0, "low-pressure spool speed"),
    Channel("N2_pct", "%", "output", 0.0, 130.0, "high-pressure spool speed"),
    Channel("EGT_C", "degC", "output", -60.0, 1300.0, "exhaust or inter-turbine temperature"),
    Channel("FF_kgph", "kg/h", "output", 0.0, 20000.0, "fuel mass flow"),
    Channel("FN_kN", "kN", "output", -50.0, 600.0, "net thrust"),
    Channel("FPR", "-", "output", 0.5, 5.0, "fan pressure ratio"),
    Channel("EPR", "-", "output", 0.5, 10.0, "engine pressure ratio"),
    # Read only to derive the channels above.
    Channel("SAT_C", "degC", "auxiliary", -100.0, 70.0, "static air temperature"),
    Channel("TAT_C", "degC", "auxiliary", -100.0, 120.0, "total air temperature"),
    Channel("CAS_kt", "kt", "auxiliary", 0.0, 600.0, "calibrated airspeed"),
    Channel("TAS_kt", "kt", "auxiliary", 0.0, 800.0, "true airspeed"),
)

CHANNELS: dict[str, Channel] = {channel.name: channel for channel in _TABLE}
SPOOLS = ("N1_pct", "N2_pct")

# How the name of a channel ends, in which unit, and what it measures; a ratio has no ending.
_MEASURES = (
    ("pct", "%", "percentage"),
    ("rpm", "rpm", "rotational speed"),
    ("kW", "kW", "power"),
    ("Nm", "Nm", "torque"),
    ("kN", "kN", "force"),
    ("kPa", "kPa", "pressure"),
    ("C", "degC", "temperature"),
    ("kgph", "kg/h", "mass flow"),
    ("deg", "deg", "angle"),
    ("A", "A", "current"),
    ("V", "V", "voltage"),
)
ENDINGS = {end: unit for end, unit, _ in _MEASURES}
_QUANTITIES = {"-": "ratio", **{unit: quantity for _, unit, quantity in _MEASURES}}

# Names in use elsewhere, as one word in capitals.
FIELD_NAMES: dict[str, tuple[str, ...]] = {
    name: tuple("".join(each.split()).upper() for each in text.split(","))
    for name, text in tomllib.loads(
        files(__package__).joinpath("field_names.toml").read_text("utf-8")
    ).items()
}


def channel(name: str) -> Channel:
    """Look a canonical channel up; raises `ConfigError` naming the nearest known one."""
    if name in CHANNELS:
        return CHANNELS[name]
    written = (name, name.partition("_")[0])  # a unit may follow: ITT_C
    plain = {"".join(filter(str.isalnum, text)).upper() for text in written}
    meant = next((own for own, others in FIELD_NAMES.items() if plain & {*others}), name)
    hint = did_you_mean(meant, CHANNELS, "Known channels:")
    raise ConfigError(f"unknown channel '{name[:80]}'", hint=hint)


def described(name: str) -> Channel:
    """Return a channel by its name alone: of the table, or else an output of any value.

    Its unit is that which ends the name, `-` where none does.
    """
    known = CHANNELS.get(name)
    if known:
        return known
    unit = ENDINGS.get(name.rpartition("_")[2], "-") if "_" in name else "-"
    return Channel(name, unit, "output", float("-inf"), float("inf"), _QUANTITIES[unit])


def is_switch(name: str) -> bool:
    return described(name).role == "switch"


def spools_of(names: Iterable[str]) -> tuple[str, ...]:
    """Those of `names` that are spool speeds, by which equilibrium is detected."""
    return tuple(name for name in names if name in SPOOLS)


def symbol(name: str) -> str:
    """`N1_pct` -> `N1`: what an engineer calls the channel; a name without a unit as it is."""
    stem, _, end = name.rpartition("_")
    return stem if stem and (name in CHANNELS or end in ENDINGS) else name
