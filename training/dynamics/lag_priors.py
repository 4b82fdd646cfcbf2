"""Start value, unit and freedom of every parameter of the lumped engine, as tables.

| cell | meaning |
|---|---|
| `0.3` | fitted from 0.3 on |
| `0.3/5` | likewise; 5 counts as one unit for the prior (otherwise 1) |
| `*0.3` | start and unit are multiplied by the output's half range over the core's |
| `=0.3` | fixed at 0.3 |
| `.` | fixed at 0 |

The start values are rounded from regressions of measured accelerations on speeds and air, and from
fits, of virtual flights of seed 100; a fit from zero ends in poorer minima.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from narxcal.lumped.engine import LumpedEngine, shapes_of
from narxcal.lumped.governed import HEAT, LINES, OTHER_LINES, REGRESSORS, SLOPES
from narxcal.lumped.limited import LIMITED
from narxcal.support.arrays import BoolArray, FloatArray, IntArray


class Form(NamedTuple):
    """Form of a lumped engine: a control governs N1, or limits acceleration and deceleration."""

    governed: bool = False
    limited: bool = False


class Priors(NamedTuple):
    """Per parameter (P,): start value, unit, whether it is fitted, and with which column."""

    start: FloatArray
    unit: FloatArray
    fitted: BoolArray
    column: IntArray


# Without limits. `core` is the core spool, `fan` any other speed, `other` a temperature or flow,
# which has one time constant, that of its probe.
_PLAIN: Final = """
                   core   fan    other
log_tau            -0.3   -0.3   -0.3
air                0      0      .
speed              0      0      .
target             0      0      .
speed_speed        0      0      .
speed_target       0      0      .
target_target      0      0      .
lead_s             0.3    0.3    0
core               .      0      0
slow_share         0      0      0
log_slow_tau       1.5    1.5    1.5
log_up             =20    =20    =20
log_down           =20    =20    =20
"""
# With limits of half the corrected range in a second, less in thin air; `alone` is the core of an
# engine without a fan. The logarithm of sqrt(theta2) spans a tenth or two, hence units of 5. Fan
# and temperatures follow the core, and fuel that accelerates the core adds what they will be soon.
# Blades soak heat for 7 s, casings for more than a minute.
_LIMITS: Final = """
                   alone  core   fan    other
log_tau            -0.3   -0.3   -0.3   -0.3
air                0      0      0      0
speed              0      0      0      0
target             0      0      0      .
speed_speed        0      0      0      .
speed_target       0      0      0      .
target_target      0      0      0      .
lead_s             0.3    0.3    0.3    .
core               .      .      *0.75  *0.75
slow_share         0      0      0      0
log_slow_tau       1.5    1.5    1.5    2.0
log_up             0      -0.1   0      =20
up_air             -1     -1     -1     .
up_speed           0      -0.5   0      .
up_speed_speed     0      -0.5   0      .
up_other           .      0.7    .      .
up_speed_other     .      0.5    .      .
up_other_other     .      0      .      .
up_hot             0/5    -1/5   0/5    .
log_down           0      0      0      =20
down_air           -1     -1     -1     .
down_speed         0      0      0      .
down_speed_speed   0      0      0      .
down_other         .      0      .      .
down_speed_other   .      0      .      .
down_other_other   .      0      .      .
down_hot           0/5    0/5    0/5    .
core_speed         .      .      *0.05  *0.35
rate               .      .      *-0.12 *-0.35
rate_air           .      .      1.0    1.2
rate_speed         .      .      0      0.5
casing_share       .      .      .      0.02
log_casing_tau     .      .      .      4.3
hot                0/5    0/5    0/5    0/5
"""
# Of speeds, which heat drives; the share of it is fitted, from none on. Heat transfer goes as
# flow^0.8: corrected flow triples from idle to full power, over w from -1 to 1, which is
# exp(2 * 0.4); flow also depends on the air.
# The effect of heat falls with power, since speeds respond to shares of the fuel.
_HEAT: Final = {"heat": 1.0, "heat_speed": -0.5, "heat_rate": 0.4, "heat_air": 0.8}

_BY_CORE: Final = ("core", "core_speed", "rate", "rate_air", "rate_speed")  # not of the core itself

_GOVERNED: Final = """
         one    thin   hot    Mach   v      u      vv     vu     uu
core_s   -1.19  0.57   .      0.3    0.31   -0.42  0.43   .      .
gain     0.52   -0.07  .      .      -0.62  0.54   .      .      0.28
reset_s  -0.1   0.77   .      -0.26  -0.57  0.32   .      .      .
lead_s   -1.5   0.78   .      .      .      0.7    .      .      .
up       0.25   -1.09  -0.92  0.33   -0.79  0.78   -0.31  0.24   -0.24
down     0.35   -0.49  0.01   -0.85  1.29   0.02   -0.37  1.56   -1.09
fan_s    0.26   0.87   -0.32  -0.64  -0.27  .      -0.37  0.94   -0.56
push     -1.63  1.59   0.18   -1.73  -0.13  .      0.67   .      .
"""
_GOVERNED_OTHER: Final = """
         one    thin   hot    Mach   v      u      vv     vu     uu
probe_s  0.1    0.65   -0.58  0.1    0.22   -0.33  0.31   .      .
push     -0.49  0.94   -0.73  0.25   0.67   -0.88  0.58   .      .
"""
_SLOPES: Final = """
         const  thin   Mach   tilt   tilt_Mach  bend
fan      0.96   0.0    -0.55  0.17   0.07       0.0
other    0.79   0.0    0.5    0.37   -0.3       0.04
"""
# The times that metal takes to heat up are not fitted; the governed fan has no heat.
_GOVERNED_HEAT: Final = """
         soak_share  log_soak_tau  soak_speed  soak_air  open_share  log_begun_tau
core     0.0         =2.85         =-0.5       =0.8      0.05        2.5
fan      .           =2.85         =-0.5       =0.8      .           =2.5
other    0.0         =2.85         =-0.5       =0.8      -0.07       2.6
"""
_VALVE_S, _CLEARANCE, _SHARE = "0.3", "0.2", "-0.2"


def start_engine(
    output_names: tuple[str, ...], form: Form, scales: Mapping[str, FloatArray]
) -> tuple[LumpedEngine, Priors]:
    """Build the engine that a fit starts from; `scales` are its centre, half and limit.

    Raises `ModelError` for a governed engine without the speeds of a fan and a core.
    """
    shapes = shapes_of(len(output_names), governed=form.governed)
    blank = {name: np.zeros(shape) for name, shape in shapes.items()}
    engine = LumpedEngine.of(output_names, blank, scales)
    table = _priors(engine, form)
    return replace(engine, theta=table.start), table


def _priors(engine: LumpedEngine, form: Form) -> Priors:
    rows = _governed(engine) if engine.governed else _limited(engine, form)
    cells = [(cell, column) for column, row in rows for cell in row]
    column = np.array([column for _, column in cells], dtype=np.int64)
    parsed = [_parsed(cell) for cell, _ in cells]
    ratio = engine.half[column] / engine.half[engine.core]
    factor = np.where([cell.startswith("*") for cell, _ in cells], ratio, 1.0)
    start, unit = (factor * np.array(values) for values in zip(*parsed, strict=True))
    fitted = np.array([cell[0] not in ".=" for cell, _ in cells])
    return Priors(start, unit, fitted, column)


def _limited(engine: LumpedEngine, form: Form) -> list[tuple[int, list[str]]]:
    """Column and cells of each row of `parameters`."""
    table = _read(_LIMITS if form.limited else _PLAIN)
    fanless, rows = np.sum(engine.speeds) < 2, []
    for column, speed in enumerate(engine.speeds):
        role = "other"
        if speed:
            role = "core" if column == engine.core else "fan"
        if form.limited and fanless and role == "core":
            role = "alone"
        cells = {name: row[role] for name, row in table.items()}
        if column == engine.core:  # of an engine without a speed, too
            cells |= dict.fromkeys(_BY_CORE, ".")
        if speed:
            cells |= {name: f"={value}" for name, value in _HEAT.items()}
        rows.append((column, [cells.get(name, ".") for name in LIMITED]))
    return rows


def _governed(engine: LumpedEngine) -> list[tuple[int, list[str]]]:
    """Column and cells of each row of lines, slopes, heat and extra; core and fan fit together."""
    core, others = engine.core, [int(column) for column in engine.order[2:]]
    lines, other_lines = _read(_GOVERNED), _read(_GOVERNED_OTHER)
    slopes, heat = _read(_SLOPES), _read(_GOVERNED_HEAT)
    rows = [(core, [lines[name][term] for term in REGRESSORS]) for name in LINES]
    for column in others:
        rows += [(column, [other_lines[name][t] for t in REGRESSORS]) for name in OTHER_LINES]
    for table, names, roles in ((slopes, SLOPES, ["fan"]), (heat, HEAT, ["core", "fan"])):
        rows += [(core, [table[role][name] for name in names]) for role in roles]
        rows += [(column, [table["other"][name] for name in names]) for column in others]
    return [*rows, (core, [_VALVE_S, _CLEARANCE]), *((column, [_SHARE]) for column in others)]


def _read(table: str) -> dict[str, dict[str, str]]:
    """Cells of a table by row and column."""
    head, *rows = table.strip().splitlines()
    columns = head.split()
    return {
        name: dict(zip(columns, cells, strict=True))
        for name, *cells in (row.split() for row in rows)
    }


def _parsed(cell: str) -> tuple[float, float]:
    """Start and unit."""
    start, _, unit = cell.strip("=*").partition("/")
    return 0.0 if start == "." else float(start), float(unit or 1.0)
