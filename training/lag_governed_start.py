"""Where the fit of lags behind a control starts, and which of their numbers it changes.

The starting values are those of a fit to virtual flights of seed 100; regressors that are not named
here stay out.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from narxcal.lag_governed import FITTED, governed_shapes
from narxcal.lag_governed_steps import LINES, OTHER_LINES, REGRESSORS, SHARES

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

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
