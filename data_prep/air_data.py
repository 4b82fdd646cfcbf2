"""Find the units of air data by the one Mach number that they all have to give.

Airspeed with altitude, true airspeed with temperature, and the rise of temperature in a probe each
give the Mach number; altitude gives the usual temperature of the air.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np

from data_prep.units import find_unit, to_canonical
from narxcal.atmosphere import KELVIN, SOUND_KT, T0_K, isa, mach_of_cas
from narxcal.support.arrays import FloatArray

_ROWS = 400
_FEWEST = 10
_FLYING = 0.3  # Mach number above which an airspeed is exact
_SAME_MACH = 0.04  # relative; a wrong unit changes the Mach number by a tenth or more
_MOST_FROM_ISA_C = 40.0


def units_that_agree(
    air: Mapping[str, FloatArray], possible: Mapping[str, Sequence[str]]
) -> dict[str, str]:
    """Return the units in which alone air data `(rows,)` agree, by channel.

    `possible` are the units of each channel but Mach, which has none. A channel with several units
    that agree with some units of the others is left out.
    """
    most = max(map(len, air.values()), default=1)
    rows = np.linspace(0, most - 1, _ROWS)
    raw = {name: filled(values, rows) for name, values in air.items()}
    agreeing = []
    for units in product(*possible.values()):
        chosen = dict(zip(possible, units, strict=True))
        canonical = {
            name: to_canonical(values, find_unit(chosen.get(name, "-"), name))
            for name, values in raw.items()
        }
        if _agree(canonical):
            agreeing.append(units)
    found = {name: {units[k] for units in agreeing} for k, name in enumerate(possible)}
    return {name: each.pop() for name, each in found.items() if len(each) == 1}


def _agree(air: Mapping[str, FloatArray]) -> bool:
    """Whether air data `(rows,)` give one Mach number, in each way that there is, and usual air."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        machs = _machs(air)
        flying = machs[0] > _FLYING if machs else np.zeros(0, dtype=np.bool_)
        if len(machs) < 2 or flying.sum() < _FEWEST:
            return False
        apart = [float(np.median(np.abs(each / machs[0] - 1.0)[flying])) for each in machs[1:]]
    if not max(apart) < _SAME_MACH:  # NaN is none
        return False
    if not {"SAT_C", "ALT_ft"} <= air.keys():
        return True
    away = air["SAT_C"] + KELVIN - isa(air["ALT_ft"])[0]
    return bool(np.median(np.abs(away[flying])) < _MOST_FROM_ISA_C)


def _machs(air: Mapping[str, FloatArray]) -> list[FloatArray]:
    machs = [air["Mach"]] if "Mach" in air else []
    if {"CAS_kt", "ALT_ft"} <= air.keys():
        machs.append(mach_of_cas(air["CAS_kt"], air["ALT_ft"]))
    if {"SAT_C", "TAT_C"} <= air.keys():
        rise = (air["TAT_C"] + KELVIN) / (air["SAT_C"] + KELVIN) - 1.0
        machs.append(np.sqrt(5.0 * np.maximum(rise, 0.0)))
    if "TAS_kt" in air and {"SAT_C", "TAT_C"} & air.keys():
        total = "SAT_C" not in air
        kelvin = air["TAT_C" if total else "SAT_C"] + KELVIN
        mach = air["TAS_kt"] / (SOUND_KT * np.sqrt(kelvin / T0_K))
        machs.append(mach / np.sqrt(1.0 - 0.2 * mach**2) if total else mach)
    return machs


def filled(values: FloatArray, rows: FloatArray) -> FloatArray:
    """Interpolate a column at fractional `rows`, over its blanks."""
    known = np.flatnonzero(np.isfinite(values))
    return np.interp(rows, known, values[known]) if len(known) else np.full(len(rows), np.nan)
