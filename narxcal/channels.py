"""The canonical channels: the one table of names, units, roles and physical ranges."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from narxcal.support.errors import ConfigError, did_you_mean

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


# Names in use elsewhere, for the hint at ours.
_SYNONYMS = {
    "EGT_C": ("ITT", "TGT", "TOT", "MGT", "T45", "T5", "TIT"),
    "FF_kgph": ("WF", "FMF", "FUELFLOW", "FF"),
    "TRA_deg": ("PLA", "TLA", "THROTTLE", "LEVER", "POWERLEVER"),
    "N1_pct": ("NL", "NF", "FAN", "N1"),
    "N2_pct": ("NH", "NG", "NGG", "CORE", "N2"),
    "ALT_ft": ("HP", "ALTITUDE", "PALT", "ALT"),
    "CAS_kt": ("IAS", "KIAS", "KCAS", "VCAS", "CAS"),
    "dT_C": ("DISA", "DELTAISA", "ISADEV", "DTISA"),
    "SAT_C": ("OAT", "SAT", "TAMB"),
    "Mach": ("MN", "MACHNO"),
    "WOW": ("AIRGROUND", "GROUND", "SQUAT"),
    "time_s": ("TIME", "TIMESTAMP", "UTC"),
}


def channel(name: str) -> Channel:
    """Look a canonical channel up; raises `ConfigError` naming the nearest known one."""
    if name in CHANNELS:
        return CHANNELS[name]
    written = (name, name.partition("_")[0])  # a unit may follow: ITT_C
    plain = {"".join(filter(str.isalnum, text)).upper() for text in written}
    meant = next((own for own, others in _SYNONYMS.items() if plain & {*others}), name)
    hint = did_you_mean(meant, CHANNELS, "Known channels:")
    raise ConfigError(f"unknown channel '{name[:80]}'", hint=hint)


def spools_of(names: Iterable[str]) -> tuple[str, ...]:
    """Those of `names` that are spool speeds, by which equilibrium is detected."""
    return tuple(name for name in names if name in SPOOLS)


def symbol(name: str) -> str:
    """`N1_pct` -> `N1`: what an engineer calls the channel; any other name as it is."""
    return name.rsplit("_", 1)[0] if name in CHANNELS else name
