"""What two builds and two flights of one engine differ in, as Gaussian columns beside any effect.

| column | one standard deviation of its prior |
|---|---|
| steady maps, {1, p - 1/2, (p - 1/2)^2 - 1/12} of power p | {s, s, 2 s} of the level |
| offset of a flight and channel | 0.3 s of the level |
| hidden thermal start, exp(-t / 30 s), exp(-t / 120 s) | 1 % of the temperature's level |
| small dynamics: tolerances of linkages, valves, probes | as in `_small` |

s is the scatter of new engines: N1 0.4 %, N2 0.15 %, EGT 1 % in kelvin, fuel flow 2 % (assumed).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from narxcal.effects.base import Parameter
from narxcal.effects.library import effect as effect_called
from narxcal.effects.running import Emulator, Flights, response
from narxcal.support.arrays import FloatArray
from training.diagnosis.metric import Record

BUILD, OFFSET, START, SMALL = "build", "offset", "start", "small"
_LEVEL_PCT: Final = {"N1_pct": 0.4, "N2_pct": 0.15, "EGT_C": 1.0, "FF_kgph": 2.0}
_OTHER_PCT: Final = 1.0
_OF_FLIGHT: Final = 0.3
_STARTS_S: Final = (30.0, 120.0)
_START_PCT: Final = 1.0
_LIMIT, _SMALL_LIMIT = 3.0, 2.0
_FREEZING_K: Final = 273.15
_LEVER_DEG: Final = 85.0
_PROBE: Final = 0.03  # of its own lag
_PROBE_S: Final = 1.0  # lag of the hot probe
_SOAK: Final = 0.015  # of a channel's range, where the metal trails by the whole range of the gas


@dataclass(frozen=True, eq=False)
class Nuisances:
    """Columns (k, flights, time, outputs), each of one standard deviation of its prior.

    `kind` says what each is, `effect` the name of the effect that it is a small size of, or "".
    `limit` (k,) is how many standard deviations it may be off.
    """

    columns: FloatArray
    kind: tuple[str, ...]
    effect: tuple[str, ...]
    limit: FloatArray

    @property
    def of_build(self) -> bool:
        """Whether engines may differ by anything: the simulator is not this very one."""
        return any(limit > 0.0 for kind, limit in zip(self.kind, self.limit, strict=True)
                   if kind in (BUILD, SMALL))  # fmt: skip


def nuisances(record: Record, emulator: Emulator | None = None, build: float = 1.0) -> Nuisances:
    """Assumed nuisances of flights of which nothing was learned.

    `build` scales what engines differ by: 1 for two of one type, 0 where the simulator is this
    very engine. What flights of one engine differ by stays.
    """
    level = levels(record.flights)
    steady = steady_maps(record.flights, _shares(record.flights) * level)
    offsets = _offsets(record.flights)
    starts = _starts(record, level)
    small = _small(record.flights, emulator)
    kinds = (BUILD,) * len(steady) + (OFFSET,) * len(offsets) + (START,) * len(starts)
    names = ("",) * len(kinds) + tuple(name for name, _ in small)
    columns = np.concatenate([steady, offsets, starts, *(each[None] for _, each in small)])
    limit = np.full(len(columns), _LIMIT)
    limit[len(kinds) :] = _SMALL_LIMIT
    of_build = np.isin([*kinds, *[SMALL] * len(small)], (BUILD, SMALL))
    columns[of_build] *= build
    limit[of_build & (build == 0.0)] = 0.0
    return Nuisances(columns, kinds + (SMALL,) * len(small), names, limit)


def build_columns(flights: Flights, emulator: Emulator | None) -> list[tuple[str, FloatArray]]:
    """What engines of one type differ by, of one standard deviation each.

    Steady maps have no name, small dynamics that of the effect which they are a small size of.
    """
    steady = steady_maps(flights, _shares(flights) * levels(flights))
    return [*(("", each) for each in steady), *_small(flights, emulator)]


def offset_sizes(flights: Flights) -> FloatArray:
    """Standard deviation (outputs,) of the offset of a flight."""
    return np.asarray(_OF_FLIGHT * _shares(flights) * levels(flights))


def levels(flights: Flights) -> FloatArray:
    """RMS level of each output (outputs,), temperatures in kelvin."""
    inside = np.arange(flights.y.shape[1]) < flights.lengths[:, None]
    zero = [_FREEZING_K if name.endswith("_C") else 0.0 for name in flights.signals.outputs]
    return np.asarray(np.sqrt(np.mean((flights.y[inside] + zero) ** 2, axis=0)))


def most_of_build(flights: Flights) -> FloatArray:
    """The largest steady difference (outputs,) that builds of one type may have."""
    return np.asarray(_LIMIT * _shares(flights) * levels(flights))


def _shares(flights: Flights) -> FloatArray:
    """Standard deviation (outputs,) of what new engines differ by, as shares of the levels."""
    percent = [_LEVEL_PCT.get(name, _OTHER_PCT) for name in flights.signals.outputs]
    return np.array(percent) / 100.0


def steady_maps(flights: Flights, sizes: FloatArray) -> FloatArray:
    """Maps of power (3 per output, flights, time, outputs), for outputs of `sizes` (outputs,)."""
    p = flights.signals.power(flights.y)
    shapes = np.stack([np.ones_like(p), p - 0.5, 2.0 * ((p - 0.5) ** 2 - 1.0 / 12.0)])
    found = np.zeros((3 * len(sizes), *flights.y.shape))
    for c, size in enumerate(sizes):
        found[3 * c : 3 * c + 3, ..., c] = size * shapes
    return found


def _offsets(flights: Flights) -> FloatArray:
    sizes = offset_sizes(flights)
    found = np.zeros((len(flights.y) * len(sizes), *flights.y.shape))
    for k in range(len(found)):
        f, c = divmod(k, len(sizes))
        found[k, f, :, c] = sizes[c]
    return found


def _starts(record: Record, level: FloatArray) -> FloatArray:
    flights, hot = record.flights, record.flights.signals.hot
    time_s = np.arange(flights.y.shape[1]) * flights.signals.dt_s
    found = np.zeros((len(flights.y) * len(_STARTS_S), *flights.y.shape))
    for k in range(len(found)):
        f, j = divmod(k, len(_STARTS_S))
        found[k, f, :, hot] = 0.01 * _START_PCT * level[hot] * np.exp(-time_s / _STARTS_S[j])
    return found


def _small(flights: Flights, emulator: Emulator | None) -> list[tuple[str, FloatArray]]:
    """Responses to effects of one standard deviation of what builds and linkages differ by."""
    signals = flights.signals
    lever = signals.lever[1] - signals.lever[0]
    sizes: dict[str, dict[str, float]] = {
        "throttle_backlash": {"width_deg": 0.15 * lever / _LEVER_DEG},
        "throttle_bias": {"bias_deg": 0.15 * lever / _LEVER_DEG},
        "throttle_delay": {"delay_s": 0.015},
        "actuator_lag": {"tau_s": 0.015},
        "sensor_lag:EGT_C": {"tau_s": _PROBE * _PROBE_S, "own_s": 0.0},
        "spool_lag": {"factor": 1.01},
        "spool_coupling": {"factor": 1.01},
        "accel_decel_asymmetry": {"ratio": 1.01},
        "accel_limit": {"share": 0.96},
    }
    found: list[tuple[str, FloatArray]] = []
    if emulator is None:
        return found
    for name, given in sizes.items():
        effect = effect_called(name)
        if effect.applies(signals) and (signals.governed or not name.startswith("throttle")):
            theta = theta_of(effect.parameters(signals), given)
            found.append((name, response(effect, theta, flights, emulator)))
    soak, span = effect_called("heat_soak"), signals.high - signals.low
    for p in soak.parameters(signals):
        if p.linear:
            width = span[signals.y(p.name.removeprefix("share_"))] / span[signals.hot]
            given = {"tau_s": 40.0, "rise_s": 1.0, p.name: _SOAK * float(width)}
            theta = theta_of(soak.parameters(signals), given)
            found.append(("heat_soak", response(soak, theta, flights, emulator)))
    return [(name, each) for name, each in found if np.isfinite(each).all() and each.any()]


def theta_of(parameters: tuple[Parameter, ...], given: dict[str, float]) -> FloatArray:
    """Parameters as an array, neutral where they are not given."""
    return np.array([given.get(p.name, p.neutral) for p in parameters])
