"""By how much outputs are off at one fan speed: what a wrong build says whatever a control holds.

Thrust goes with the fan's speed. Where a control holds the core instead, a worn engine has a slower
fan, too, and the temperature at a given lever hides a part of how much hotter it is. So the shift
of an output is taken along the line on which the simulator settles,

    shift = ln y_real - ln y_sim - (f(n_real, z) - f(n_sim, z)),    ln y_sim = f(n_sim, z)

with n the logarithm of the fan's speed and z what was flown through (altitude, Mach, temperature);
only samples count at which nothing moves.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d

from narxcal.effects.running import Flights
from narxcal.support.arrays import FloatArray
from training.gap.quadratic import Misfit
from training.gap.scatter import levels

_CONDITIONS: Final = ("ALT_ft", "Mach", "dT_C")
_STILL, _REST_S = 0.003, 5.0  # of a channel's range per s; for so long before and after
_LEAST = 1e-3  # of the largest level: less has no logarithm worth taking
_FEW = 10  # samples per term of the line


def at_one_speed(flights: Flights, measure: Misfit) -> dict[str, FloatArray]:
    """Shift of each output but the first at one speed of the first, in % per flight (flights,).

    NaN for a flight in which an output is not known at rest, and for all where too little is.
    """
    outputs = flights.signals.outputs
    simulated = levels(flights.y, outputs)
    recorded = simulated + measure.gap
    own, real = (np.log(_above(values)) for values in (simulated, recorded))
    rest = _at_rest(flights)
    found = {}
    for c, name in enumerate(outputs[1:], start=1):
        use = rest & (measure.weights[..., [0, c]] > 0.0).all(axis=-1)
        along = _line(flights, own[..., 0], own[..., c], use)
        shift = real[..., c] - own[..., c] - (along(real[..., 0]) - along(own[..., 0]))
        found[name] = np.array([_median(100.0 * s[u]) for s, u in zip(shift, use, strict=True)])
    return found


def burns_more(shifts: Mapping[str, FloatArray], much: tuple[float, float]) -> bool:
    """Whether the fuel flow is up with the temperature, by so `much` of it and in %.

    A worn engine is hotter because it needs more fuel. A wrong probe leaves the fuel as it was, and
    scatter of builds moves it by a percent or two.
    """
    if not {"EGT_C", "FF_kgph"} <= set(shifts):
        return False
    hotter, more = (typical(shifts[name]) for name in ("EGT_C", "FF_kgph"))
    return more > max(much[0] * hotter, much[1])


def typical(shift: FloatArray) -> float:
    """The median of the flights that tell; NaN unless half of them do."""
    told = shift[np.isfinite(shift)]
    return float(np.median(told)) if 2 * len(told) >= len(shift) else np.nan


def _at_rest(flights: Flights) -> NDArray[np.bool_]:
    """Samples (flights, time) before and after which nothing moves for a while."""
    signals = flights.signals
    span = np.maximum(signals.high - signals.low, 1e-9)
    rate = np.abs(np.gradient(flights.y / span, signals.dt_s, axis=1)).max(axis=-1)
    still = (rate < _STILL) & (np.arange(rate.shape[1]) < flights.lengths[:, None])
    return np.asarray(minimum_filter1d(still, 1 + 2 * round(_REST_S / signals.dt_s), axis=1))


def _line(
    flights: Flights, speed: FloatArray, target: FloatArray, use: NDArray[np.bool_]
) -> Callable[[FloatArray], FloatArray]:
    """The line of a `target` (flights, time) over the logarithm of speed, fitted where in `use`."""
    signals = flights.signals
    conditions = [signals.u(name) for name in _CONDITIONS if name in signals.active]
    z = flights.u[..., conditions]
    z = (z - z.mean(axis=(0, 1))) / np.maximum(z.std(axis=(0, 1)), 1e-9)
    centre = float(speed[use].mean()) if use.any() else 0.0

    def terms(at: FloatArray) -> FloatArray:
        x = (at - centre)[..., None]
        return np.concatenate([np.ones_like(x), x, x**2, x**3, z, z**2, z * x], axis=-1)

    rows = terms(speed)[use]
    if len(rows) < _FEW * rows.shape[-1]:
        return lambda at: np.full_like(at, np.nan)
    weights = np.linalg.lstsq(rows, target[use], rcond=1e-8)[0]
    return lambda at: np.asarray(terms(at) @ weights)


def _above(values: FloatArray) -> FloatArray:
    return np.asarray(np.maximum(values, _LEAST * values.max(axis=(0, 1))))


def _median(values: FloatArray) -> float:
    return float(np.median(values)) if values.size else np.nan
