"""Where the fit of the lags starts, which of their parameters are free, and how far they may go.

The starting values are round figures read off regressions of measured accelerations on speeds and
air (virtual flights of seed 100); a fit from zero ends in poorer places.

Where the fit of lags behind a control starts, and which of their numbers it changes.

The starting values are those of a fit to virtual flights of seed 100; regressors that are not named
here stay out.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from narxcal.lumped.lag import (
    CASING_PARAMETERS,
    FUEL_PARAMETERS,
    LAG_PARAMETERS,
    LIMIT_PARAMETERS,
    PARAMETERS,
    UNLIMITED,
    LagModel,
    speeds_of,
)
from narxcal.lumped.lag_governed import FITTED, governed_shapes
from narxcal.lumped.lag_governed_steps import LINES, OTHER_LINES, REGRESSORS, SHARES
from narxcal.support.arrays import BoolArray, FloatArray

_OF_CORE = ("core", *FUEL_PARAMETERS)
_SLOPES, _HOT = ("core", "core_speed", "rate"), ("up_hot", "down_hot", "hot")
_HOT_UNIT = 5.0  # the logarithm of sqrt(theta2) spans a tenth or two
# A temperature has one time constant, that of its probe; with limits it goes with the flow.
_PROBE = ("log_tau", "lead_s", "core", "slow_share", "log_slow_tau")
_PROBE_IN_FLOW = (
    "log_tau", "air", "speed", "hot", "core", "slow_share", "log_slow_tau",
    *FUEL_PARAMETERS, *CASING_PARAMETERS,
)  # fmt: skip
_ALL = {"log_tau": -0.3, "log_slow_tau": 1.5, "log_up": UNLIMITED, "log_down": UNLIMITED}
_SPEED = {"lead_s": 0.3}
# Half the corrected range in a second; a given power speeds a rotor up the less, the thinner the
# air.
_LIMITED = {"log_up": 0.0, "log_down": 0.0, "up_air": -1.0, "down_air": -1.0}
# Heat goes between gas and metal as flow^0.8 (FACTS A4). Corrected flow grows to about three times
# that of idle, flow^0.8 over w from -1 to 1 by exp(2 * 0.4); flow itself goes by the air. What heat
# does falls with power, for speeds answer to shares of the fuel, which is seven times that of idle.
_HEAT = {"heat": 1.0, "heat_speed": -0.5, "heat_rate": 0.4, "heat_air": 0.8}
_LIMITED_CORE = {
    "log_up": -0.1, "up_hot": -1.0, "up_speed": -0.5, "up_speed_speed": -0.5,
    "up_other": 0.7, "up_speed_other": 0.5,
}  # fmt: skip
# Over the output's range by the core's: a fan follows the core, and a temperature does; the fuel
# that speeds the core up adds what they will be a moment later, longer in thin air.
_FAN_SLOPES = {"core": 0.75, "core_speed": 0.05, "rate": -0.12}
_FAN = {"rate_air": 1.0}
_HOT_SLOPES = {"core": 0.75, "core_speed": 0.35, "rate": -0.35}
# Blades soak heat for 7 s, casings for more than a minute.
_HOT_PARTS = {
    "rate_air": 1.2, "rate_speed": 0.5,
    "log_slow_tau": 2.0, "casing_share": 0.02, "log_casing_tau": 4.3,
}  # fmt: skip


def fans_of(model: LagModel) -> list[int]:
    """Columns of the speeds beside the core's."""
    speeds = np.flatnonzero(speeds_of(model.output_names))
    return [int(column) for column in speeds if column != model.core]


class LagForm(NamedTuple):
    """What lags are to be: fitted to `relative` errors, `limited` by a control, moved by `heat`."""

    relative: bool = False
    limited: bool = False
    heat: bool = False


def start_values(model: LagModel, form: LagForm) -> FloatArray:
    """Parameters (n_out, 38) that a fit of `model` starts from; those of heat are not fitted."""
    parameters = np.zeros((len(model.output_names), len(PARAMETERS)))
    speeds = np.flatnonzero(speeds_of(model.output_names))
    _set(parameters, range(len(parameters)), _ALL)
    _set(parameters, speeds, _SPEED)
    _set(parameters, speeds, _HEAT if form.heat else {})
    if not form.limited:
        return parameters
    _set(parameters, speeds, _LIMITED)
    fans = fans_of(model)
    _set(parameters, [model.core] if fans else [], _LIMITED_CORE)
    _set(parameters, fans, _FAN)
    hot = [k for k in range(len(parameters)) if k not in speeds]
    _set(parameters, hot, _HOT_PARTS)
    for columns, slopes in ((fans, _FAN_SLOPES), (hot, _HOT_SLOPES)):
        for k in columns:
            ratio = float(model.half[k] / model.half[model.core])
            _set(parameters, [k], {name: share * ratio for name, share in slopes.items()})
    return parameters


def free_parameters(model: LagModel, column: int, *, limited: bool) -> BoolArray:
    """Which parameters (38,) of an output are fitted; the others keep their starting values."""
    names: set[str] = set(_PROBE_IN_FLOW if limited else _PROBE)
    if speeds_of(model.output_names)[column]:
        names = set(LAG_PARAMETERS)
        if limited:
            names |= {*LIMIT_PARAMETERS, *FUEL_PARAMETERS, "hot"}
    if column == model.core:
        names -= set(_OF_CORE)
    if column != model.core or not fans_of(model):
        names = {name for name in names if not name.endswith("_other")}
    return np.array([name in names for name in PARAMETERS])


def prior_units(model: LagModel, column: int, *, limited: bool) -> FloatArray:
    """What counts as one unit of each parameter (38,) for the prior."""
    unit = np.ones(len(PARAMETERS))
    if limited:
        unit[_at(_SLOPES)] = model.half[column] / model.half[model.core]
        unit[_at(_HOT)] = _HOT_UNIT
    return unit


def _set(parameters: FloatArray, columns: Iterable[int], values: dict[str, float]) -> None:
    for name, value in values.items():
        parameters[list(columns), PARAMETERS.index(name)] = value


def _at(names: tuple[str, ...]) -> list[int]:
    return [PARAMETERS.index(name) for name in names]


_START_LINES = {
    "core_s": {"one": -1.13, "thin": 0.53, "Mach": 0.24, "v": -0.03, "u": -0.33, "vv": 0.4},
    "gain": {"one": 0.51, "thin": 0.04, "v": -0.67, "u": 0.45, "uu": 0.27},
    "reset_s": {"one": 0.26, "thin": 0.75, "Mach": -0.37, "v": -0.58, "u": 0.2},
    "lead_s": {"one": -0.7, "thin": 0.61, "u": 0.37},
    "up": {"one": 0.39, "thin": -1.17, "hot": -1.14, "Mach": 0.15, "v": -0.66, "u": 0.93,
           "vv": -0.41, "vu": 0.41, "uu": -0.32},
    "down": {"one": 0.29, "thin": -0.82, "hot": 0.12, "Mach": -0.17, "v": 1.48, "u": -0.21,
             "vv": -0.55, "vu": 1.46, "uu": -0.97},
    "fan_s": {"one": 0.24, "thin": 0.92, "hot": -0.17, "Mach": -0.61, "v": -0.23, "vv": -0.26,
              "vu": 0.75, "uu": -0.41},
    "push": {"one": -1.88, "thin": 1.17, "hot": 0.14, "Mach": -1.17, "v": -0.13, "vv": 1.11},
}  # fmt: skip
_START_OTHER = {
    "probe_s": {"one": 0.1, "thin": 0.65, "hot": -0.58, "Mach": 0.1, "v": 0.22, "u": -0.33,
                "vv": 0.31},
    "push": {"one": -0.49, "thin": 0.94, "hot": -0.73, "Mach": 0.25, "v": 0.67, "u": -0.88,
             "vv": 0.58},
}  # fmt: skip
_START_SLOPES = ((0.96, 0.0, -0.55, 0.17, 0.07, 0.0), (0.79, 0.0, 0.5, 0.37, -0.3, 0.04))
_START_HEAT = (
    (0.0, 2.85, -0.5, 0.8, 0.05, 2.5),  # of the core
    (0.0, 2.85, -0.5, 0.8, 0.0, 2.5),  # of the fan, which the control holds
    (0.0, 2.85, -0.5, 0.8, -0.07, 2.6),  # of others
)
_FITTED_HEAT = [0, 4, 5]  # the times that metal takes to heat up are not
_START_VALVE_S, _START_CLEARANCE, _START_SHARE = 0.3, 0.2, -0.2


def governed_start(count: int) -> dict[str, FloatArray]:
    """Lines, slopes, heat and extra of `count` outputs that a fit starts from."""
    others = count - 2
    lines = [_row(_START_LINES[name]) for name in LINES]
    lines += [_row(_START_OTHER[name]) for _ in range(others) for name in OTHER_LINES]
    core, fan, other = _START_HEAT
    return {
        "lines": np.array(lines),
        "slopes": np.array([_START_SLOPES[0], *[_START_SLOPES[1]] * others]),
        "heat": np.array([core, fan, *[other] * others]),
        "extra": np.array([_START_VALVE_S, _START_CLEARANCE, *[_START_SHARE] * others]),
    }


def _row(named: dict[str, float]) -> list[float]:
    return [named.get(name, 0.0) for name in REGRESSORS]


def free_numbers(count: int, other: int | None) -> dict[str, BoolArray]:
    """Which numbers are fitted: those of core and fan, or those of one `other` output."""
    free = {name: np.zeros(governed_shapes(count)[name], dtype=bool) for name in FITTED}
    if other is None:
        named = [[name in _START_LINES[line] for name in REGRESSORS] for line in LINES]
        free["lines"][: len(LINES)] = named
        free["slopes"][0] = free["heat"][0, _FITTED_HEAT] = free["extra"][:SHARES] = True
        return free
    first = len(LINES) + len(OTHER_LINES) * (other - 2)
    for k, line in enumerate(OTHER_LINES):
        free["lines"][first + k] = [name in _START_OTHER[line] for name in REGRESSORS]
    free["slopes"][other - 1] = free["heat"][other, _FITTED_HEAT] = True
    free["extra"][SHARES + other - 2] = True
    return free
