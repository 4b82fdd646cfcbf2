"""Units a recorder may use, and how each becomes the unit of its canonical channel."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

from narxcal.atmosphere import pressure_altitude
from narxcal.channels import ENDINGS, described
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError


@dataclass(frozen=True)
class Unit:
    """`value in base unit = value * scale + offset`; the base is the canonical channel's unit.

    Of the dimension `PRESSURE_ALTITUDE` the base is kPa, and the altitude follows from it.
    """

    dimension: str
    scale: float
    offset: float = 0.0


PRESSURE_ALTITUDE = "pressure altitude"
_POUND_KG = 0.45359237  # exact, international avoirdupois pound
_FOOT_M = 0.3048  # exact
_MILE_M = 1852.0  # exact, international nautical mile
_STATUTE_M = 1609.344  # exact, statute mile
_LBF_KN = 0.0044482216152605  # exact, pound of force
_LBF_FT_NM = 1000.0 * _LBF_KN * _FOOT_M
_HP_KW = 0.55 * _LBF_FT_NM  # 550 ft lbf/s
_PSI_KPA = 1e6 * _LBF_KN / 25.4**2  # pound of force on a square inch

_UNITS: dict[str, Unit] = {
    "s": Unit("time", 1.0),
    "ms": Unit("time", 1e-3),
    "us": Unit("time", 1e-6),
    "ns": Unit("time", 1e-9),
    "min": Unit("time", 60.0),
    "h": Unit("time", 3600.0),
    "d": Unit("time", 86400.0),
    "deg": Unit("angle", 1.0),
    "rad": Unit("angle", 57.29577951308232),
    "ft": Unit("length", 1.0),
    "m": Unit("length", 1.0 / _FOOT_M),
    "km": Unit("length", 1000.0 / _FOOT_M),
    "FL": Unit("length", 100.0),
    "%": Unit("ratio", 1.0),
    "-": Unit("number", 1.0),
    "0/1": Unit("switch", 1.0),
    "degC": Unit("temperature", 1.0),
    "K": Unit("temperature", 1.0, -273.15),
    "degF": Unit("temperature", 5.0 / 9.0, -160.0 / 9.0),
    "degR": Unit("temperature", 5.0 / 9.0, -273.15),
    "kg/h": Unit("mass flow", 1.0),
    "kg/s": Unit("mass flow", 3600.0),
    "kg/min": Unit("mass flow", 60.0),
    "g/s": Unit("mass flow", 3.6),
    "lb/h": Unit("mass flow", _POUND_KG),
    "lb/s": Unit("mass flow", 3600.0 * _POUND_KG),
    "lb/min": Unit("mass flow", 60.0 * _POUND_KG),
    "kN": Unit("force", 1.0),
    "N": Unit("force", 1e-3),
    "lbf": Unit("force", _LBF_KN),
    "klbf": Unit("force", 1000.0 * _LBF_KN),
    "kt": Unit("speed", 1.0),
    "m/s": Unit("speed", 3600.0 / _MILE_M),
    "km/h": Unit("speed", 1000.0 / _MILE_M),
    "mph": Unit("speed", _STATUTE_M / _MILE_M),
    "ft/s": Unit("speed", 3600.0 * _FOOT_M / _MILE_M),
    # Of channels that a configuration declares.
    "rpm": Unit("rotational speed", 1.0),
    "kW": Unit("power", 1.0),
    "W": Unit("power", 1e-3),
    "hp": Unit("power", _HP_KW),
    "PS": Unit("power", 0.73549875),  # exact, 75 kgf m/s
    "Nm": Unit("torque", 1.0),
    "kNm": Unit("torque", 1e3),
    "lbf.ft": Unit("torque", _LBF_FT_NM),
    "lbf.in": Unit("torque", _LBF_FT_NM / 12.0),
    "kPa": Unit("pressure", 1.0),
    "Pa": Unit("pressure", 1e-3),
    "hPa": Unit("pressure", 0.1),
    "bar": Unit("pressure", 100.0),
    "psi": Unit("pressure", _PSI_KPA),
    "inHg": Unit("pressure", 3.386389),  # at 0 degC
    "A": Unit("current", 1.0),
    "V": Unit("voltage", 1.0),
}
# By the canonical unit: in which others recorders give a quantity, and in which few do. Of those
# `_TWICE` a conversion is made of what is in the canonical unit already.
_OTHERS: Mapping[str, tuple[str, ...]] = {
    "%": ("-",),
    "degC": ("K", "degF", "degR"),
    "kg/h": ("lb/h", "kg/s", "lb/s"),
    "ft": ("m",),
    "kt": ("km/h", "m/s", "mph"),
    "kN": ("lbf", "N"),
}
_RARE: Mapping[str, tuple[str, ...]] = {
    "-": ("%",),
    "kg/h": ("kg/min", "g/s", "lb/min"),
    "ft": ("km", "FL"),
}
_TWICE = ("K", "degF", "-", "lb/h", "m", "m/s")
_IN_WORDS = {"K": "kelvin", "-": "a fraction", "%": "percent", "FL": "flight level"}
_SIGNS = ("A", "V")  # a letter alone in a file is a sensor's or an engine's
_ALIASES = {
    "sec": "s",
    "°": "deg",
    "°C": "degC",
    "C": "degC",
    "°F": "degF",
    "F": "degF",
    "R": "degR",
    "celsius": "degC",
    "kelvin": "K",
    "fahrenheit": "degF",
    "metre": "m",
    "meter": "m",
    "feet": "ft",
    "kts": "kt",
    "knots": "kt",
    "kgph": "kg/h",
    "pph": "lb/h",
    "lb/hr": "lb/h",
    "kg/hr": "kg/h",
    "pps": "lb/s",
    "pct": "%",
    "percent": "%",
    "%rpm": "%",
    "1": "-",
    "mach": "-",
    "": "-",
    "bool": "0/1",
    "shp": "hp",
    "N.m": "Nm",
    "ft.lb": "lbf.ft",
    "lb.ft": "lbf.ft",
    "ft-lb": "lbf.ft",
    "lb-ft": "lbf.ft",
    "in.lb": "lbf.in",
    "mbar": "hPa",
    "psia": "psi",
    **dict.fromkeys(("1/min", "r/min", "min-1", "u/min", "upm", "tr/min"), "rpm"),
}
# How units are spelled out, part by part: "Lbs. per Hour" is lb/h.
_WORDS = {
    word: unit
    for unit, words in {
        "s": "sec secs second seconds sek sekunden secondes segundos",
        "ms": "msec msecs millisecond milliseconds",
        "us": "usec microsecond microseconds",
        "min": "mins minute minutes",
        "h": "hr hrs hour hours std stunde stunden heure heures hora horas",
        "d": "day days",
        "deg": "degs degree degrees grad degré degrés grado grados",
        "rad": "rads radian radians",
        "ft": "foot feet fuss fuß pied pieds pie pies",
        "m": "meter meters metre metres",
        "km": "kilometer kilometers kilometre kilometres",
        "lb": "lbs lbm pound pounds",
        "kg": "kgs kilogram kilograms",
        "g": "gram grams",
        "gal": "gals gallon gallons usgal",
        "l": "liter liters litre litres",
        "kt": "kts knot knots knoten noeud noeuds nœud nœuds nudo nudos",
        "mph": "mi/h mile/h miles/h",
        "%": "pct percent",
        "degc": "degreec degreesc degcelsius degreescelsius gradc gradcelsius",
        "degf": "degreef degreesf degfahrenheit degreesfahrenheit",
        "k": "degk kelvins",
        "degr": "rankine degrankine",
        "lbf": "lbsf poundf poundsforce",
        "lbfft": "ftlb ftlbs ftlbf lbft lbsft footpounds poundfeet",
        "lbfin": "inlb inlbs inlbf lbin lbsin inchpounds poundinches",
        "rpm": "r/min rev/min revs/min",
        "hp": "horsepower bhp",
    }.items()
    for word in words.split()
}
# Volumes of fuel need its density; the others are units of columns that are no channels.
_GALLON_L = 3.785411784  # exact, US gallon
_VOLUME_FLOWS = {  # in l/h
    "gal/h": _GALLON_L,
    "gph": _GALLON_L,
    "gal/min": 60.0 * _GALLON_L,
    "gpm": 60.0 * _GALLON_L,
    "l/h": 1.0,
    "lph": 1.0,
    "l/min": 60.0,
    "lpm": 60.0,
    "ml/min": 0.06,
    "m3/h": 1000.0,
}
_MEASURES = (
    *("psig", "V", "mV", "A", "mA", "Hz"),
    *("g", "lb", "kg", "gal", "l", "nm", "mi", "ft/min", "fpm", "deg/s", "m/s2", *_VOLUME_FLOWS),
)
# What else a row of units may hold.
_OTHER = (
    *("utc", "hh:mm:ss", "hh:mm:ss.sss", "text", "bool", "n/a", "none", "count", "counts"),
    *("bit", "bits"),
)
_BRACKETS = re.compile(r"\s*[\[({<]?\s*(.*?)\s*[\])}>]?\s*")


def _texts() -> dict[str, str]:
    """Plain text -> unit, for all texts that name one unit alone, whatever their case."""
    found: dict[str, set[str]] = {}
    for text, unit in [*((unit, unit) for unit in _UNITS), *_ALIASES.items()]:
        if text and text not in _SIGNS:
            found.setdefault(_plain(text), set()).add(unit)
    return {text: next(iter(units)) for text, units in found.items() if len(units) == 1}


def find_unit(name: str, canonical: str) -> Unit:
    """Look up unit `name` as it applies to channel `canonical`.

    Raises `ConfigError` for an unknown unit (naming the nearest) and for one of another
    dimension (naming those that fit).
    """
    target = described(canonical)
    known = _lookup(name, canonical)
    if target.name == "dT_C" and known.dimension == "temperature":
        return Unit("difference", known.scale)  # a difference has no zero point
    if target.name == "ALT_ft" and known.dimension == "pressure":
        return Unit(PRESSURE_ALTITUDE, known.scale)  # of a barometer, as in a test cell
    if target.unit == "%" and known.dimension == "number":
        return Unit("ratio", 100.0)
    if target.unit == "-" and known.dimension == "ratio":
        return Unit("number", 0.01)
    wanted = _UNITS[target.unit].dimension
    if known.dimension == wanted or (wanted, known.dimension) == ("switch", "number"):
        return known
    hint = f"Units that fit: {', '.join(_fitting(canonical))}"
    if known.dimension == _UNITS["rpm"].dimension and target.unit == "%":
        hint = "Leave it out and set scale to 100 / (rpm at 100 %)"
    raise ConfigError(
        f"unit '{name}' is a {known.dimension}, this channel is a {wanted}",
        channel=canonical,
        hint=hint,
    )


def usual_units(channel: str) -> tuple[str, ...]:
    """Units in which recorders give a channel, its own first; differences are of their own."""
    own = described(channel).unit
    return (own, *(() if channel == "dT_C" else _OTHERS.get(own, ())))


def conversions(channel: str) -> dict[str, Unit]:
    """Units that values of a channel may be in instead of its own, by their words.

    Among them are those that undo a conversion which was made of values in its own unit.
    """
    own, *others = usual_units(channel)
    found = {}
    for name in (*others, *(() if channel == "dT_C" else _RARE.get(own, ()))):
        unit, words = find_unit(name, channel), _IN_WORDS.get(name, name)
        found[words] = unit
        if name in _TWICE:
            inverse = Unit(unit.dimension, 1.0 / unit.scale, -unit.offset / unit.scale)
            found[f"{_IN_WORDS.get(own, own)}, taken for {words}"] = inverse
    return found


def named_unit(cell: str) -> str:
    """The unit that a cell such as `[deg C]` or `KG/H` of a row of units names; empty if none."""
    return _BY_TEXT.get(_plain(cell), "")


def is_pressure(cell: str) -> bool:
    """Whether a cell of a row of units names a pressure."""
    unit = named_unit(cell)
    return bool(unit) and _UNITS[unit].dimension == "pressure"


def base_unit(name: str) -> str:
    """The unit of a channel in which a unit of a recorder ends up; empty if there is none."""
    dimension = _UNITS[name].dimension if name in _UNITS else ""
    return next((each for each in ENDINGS.values() if _UNITS[each].dimension == dimension), "")


def is_volume_flow(cell: str) -> bool:
    """Whether a cell names a flow of volume, which no mass flow follows from without a density."""
    return _plain(cell) in _FLOWS


def litres_per_hour(cell: str) -> float:
    """Litres per hour in one unit of a flow of volume (`is_volume_flow`)."""
    return _FLOWS[_plain(cell)]


def is_no_unit(cell: str) -> bool:
    """Whether a cell of a row of units is as good as blank: `()`, `[-]`."""
    return _plain(cell) in ("", "-")


def is_unit_text(cell: str) -> bool:
    """Whether a cell names any unit, be it one of a channel or not."""
    plain = _plain(cell)
    return plain in _BY_TEXT or plain in _FOREIGN


@lru_cache(maxsize=10_000)
def _plain(cell: str) -> str:
    """Text of a unit without brackets, blanks, dots, plurals and capitals: `Lbs./Hr` is `lb/h`."""
    found = _BRACKETS.fullmatch(cell)
    text = (found[1] if found else cell).casefold().replace("\N{GREEK SMALL LETTER MU}", "u")
    text = re.sub(r"\bper\b", "/", text.replace("\N{MICRO SIGN}", "u"))
    text = re.sub(r"\s+|\.(?!\d)|(?<=[a-z])-(?=[a-z])", "", text)
    text = "/".join(_WORDS.get(part, part) for part in text.split("/"))
    return _WORDS.get(text, text)


def _lookup(name: str, canonical: str) -> Unit:
    name = _ALIASES.get(name, name)
    name = "rpm" if named_unit(name) == "rpm" else name
    if name in _UNITS:
        return _UNITS[name]
    fitting = _fitting(canonical)
    everything = [*fitting, *(alias for alias, unit in _ALIASES.items() if unit in fitting)]
    near = [unit for unit in everything if unit.lower() == name.lower()]
    near = near or difflib.get_close_matches(name, everything, n=1, cutoff=0.5)
    hint = f"Did you mean '{near[0]}'?" if near else f"Units that fit: {', '.join(fitting)}"
    raise ConfigError(f"unknown unit '{name}'", channel=canonical, hint=hint)


def _fitting(canonical: str) -> list[str]:
    wanted = _UNITS[described(canonical).unit].dimension
    return [unit for unit, each in _UNITS.items() if each.dimension == wanted]


def to_canonical(values: FloatArray, unit: Unit) -> FloatArray:
    """Apply `unit`; values already in the canonical unit come back untouched, bit for bit."""
    if unit.dimension == PRESSURE_ALTITUDE:
        return pressure_altitude(values * unit.scale)
    if unit.scale == 1.0 and unit.offset == 0.0:
        return values
    return values * unit.scale + unit.offset


_BY_TEXT = _texts()
_FLOWS = {_plain(text): flow for text, flow in _VOLUME_FLOWS.items()}
_FOREIGN = {_plain(text) for text in (*_MEASURES, *_OTHER)}
