"""Where the fit of the lags starts, which of their parameters are free, and how far they may go.

The starting values are round figures read off regressions of measured accelerations on speeds and
air (virtual flights of seed 100); a fit from zero ends in poorer places.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from narxcal.lag import LagModel, speeds_of
from narxcal.lag_steps import (
    CASING_PARAMETERS,
    FUEL_PARAMETERS,
    LAG_PARAMETERS,
    LIMIT_PARAMETERS,
    PARAMETERS,
    UNLIMITED,
)

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
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
