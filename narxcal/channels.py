"""The canonical channels: the one table of names, units, roles and physical ranges.

A configuration may declare further ones (`data_prep.config.DeclaredChannel`). Their names, as those
of the table, end in their unit: what takes a name alone knows the unit by it (`described`), and a
log the physical range, too (`data_prep.log.Log.channel`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
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

# Names in use elsewhere: abbreviations of ARINC 429, AGARD and recorders, and words in full; after
# the English ones German ("oe" or "o" for an umlaut, "s" for a sharp one), French and Spanish,
# without accents.
FIELD_NAMES: dict[str, tuple[str, ...]] = {
    name: tuple("".join(each.split()).upper() for each in text.split(","))
    for name, text in {
        "time_s": "time, t, timestamp, utc, gmt, elapsed, elapsed time, relative time, clock, "
        "frame time, sec, seconds, recorder time, utc time, gmt time, sample time, time stamp, "
        "elapsed flight time, local time, lcl time, relative seconds, "
        "zeit, uhrzeit, zeitstempel, messzeit, temps, heure, horodatage, tiempo, hora, real time",
        "TRA_deg": "tra, tla, pla, throttle, lever, power lever, thrust lever, throttle lever, "
        "throttle resolver angle, throttle angle, throttle lever angle, thrust lever angle, "
        "power lever angle, throttle position, power lever position, thrust lever position, "
        "throttle pos, power lever pos, thrust lever pos, lever position, lever pos, "
        "leistungshebel, schubhebel, gashebel, leistungshebelstellung, schubhebelstellung, "
        "manette, manette des gaz, manette puissance, palanca, palanca gases, palanca potencia",
        "ALT_ft": "alt, altitude, hp, palt, pressure altitude, altitude press, altitude pressure, "
        "altp, press alt, baro alt, baro altitude, alt std, altitude std, std altitude, "
        "pressure alt, alt b, alt ind, indicated altitude, "
        "hoehe, hohe, druckhoehe, druckhohe, flughoehe, flughohe, altitude pression, altitud, "
        "altitud presion",
        "Mach": "mach, mn, mach no, mach number, mach nr, machzahl, nombre mach, numero mach",
        "dT_C": "disa, delta isa, isa dev, isa deviation, dtisa",
        "WOW": "wow, weight on wheels, air ground, gnd air, squat, squat switch, on ground, "
        "on gnd, ground, ac on gnd, ac on ground, ground air",
        "Approach": "approach idle, high idle, flight idle",
        "ECS": "ecs, pack, bleed, bleed air, ecs bleed, air conditioning",
        "NAI": "nai, eai, cai, nacelle anti ice, engine anti ice, cowl anti ice, "
        "inlet anti ice, aie",
        "WAI": "wai, wing anti ice, wing deice",
        "N1_pct": "n1, nl, nf, fan, fan speed, n1 speed, lp speed, lp spool speed, lp rotor speed, "
        "low pressure spool speed, xnl, rpm, shaft speed, rotor speed, spool speed, n1 rpm, "
        "drehzahl, niederdruckdrehzahl, fandrehzahl, regime, regime moteur, vitesse rotation, "
        "revoluciones, regimen",
        "N2_pct": "n2, nh, ng, ngg, core, core speed, n2 speed, hp speed, hp spool speed, "
        "hp rotor speed, high pressure spool speed, gas generator speed, xnh, n2 rpm, "
        "hochdruckdrehzahl, gasgeneratordrehzahl",
        "EGT_C": "egt, itt, tgt, tot, mgt, t45, t49, t5, tit, jpt, exhaust gas temp, "
        "exhaust gas temperature, inter turbine temperature, interturbine temp, turbine gas temp, "
        "turbine gas temperature, turbine outlet temperature, turbine exit, turbine exit temp, "
        "jet pipe temperature, exhaust temp, exhaust temperature, turbine inlet temperature, "
        "abgastemperatur, abgastemp, turbinentemperatur, temperature echappement, temperature "
        "gaz echappement, temperature tuyere, temperatura escape, temperatura gases escape, "
        "temperatura gases",
        "FF_kgph": "ff, wf, fmf, wfe, fflow, fuel flow, fuel mass flow, fuel flow rate, fuel rate, "
        "kraftstofffluss, kraftstoffdurchfluss, kraftstoffdurchsatz, kraftstoffmassenstrom, "
        "kraftstoffstrom, brennstoffdurchsatz, brennstoffstrom, debit carburant, debit "
        "combustible, flujo combustible, caudal combustible",
        "FN_kN": "fn, thrust, net thrust",
        "FPR": "fpr, fan pressure ratio",
        "EPR": "epr, engine pressure ratio",
        "SAT_C": "sat, oat, tamb, static air temp, static air temperature, outside air temp, "
        "outside air temperature, ambient temp, ambient temperature, air temp, t cell, t ambient, "
        "cell temp, cell temperature, test cell temp, test cell temperature, "
        "aussentemperatur, ausentemperatur, lufttemperatur, umgebungstemperatur, "
        "statische temperatur, temperature statique, temperatura estatica, "
        "temperature exterieure, temperature ambiante, temperatura exterior, temperatura ambiente",
        "TAT_C": "tat, rat, total air temp, total air temperature, ram air temperature, "
        "gesamttemperatur, temperature totale, temperatura total",
        "CAS_kt": "cas, ias, kias, kcas, vcas, vias, airspeed, air speed, calibrated airspeed, "
        "computed airspeed, indicated airspeed, airspeed comp, airspeed computed, "
        "fluggeschwindigkeit, geschwindigkeit, vitesse, vitesse indiquee, vitesse air, "
        "velocidad, velocidad indicada",
        "TAS_kt": "tas, ktas, vtas, true airspeed, true air speed, "
        "wahre fluggeschwindigkeit, vitesse vraie, velocidad verdadera",
    }.items()
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
