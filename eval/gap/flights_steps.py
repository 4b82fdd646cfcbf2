"""How far the error over a whole flight falls as effects are added, sized on the other engine."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from narxcal.effects.memory import Lag
from narxcal.effects.steady import FOLLOW_S
from narxcal.support.arrays import FloatArray
from training.budget.result import Interval
from training.gap.path_windows import Windows

METAL_S = (15.0, 60.0, 180.0)  # time constants tried for heat soak (FACTS A4: 30 to 300 s)
CONFIRMED = 0.1  # share of the squared error
_DRAWS, _BLOCK_S = 400, 120.0


@dataclass(frozen=True, eq=False)
class Judged:
    """Both engines of one flight, (engines, time, outputs); `fuel` flow is (engines, time)."""

    engines: tuple[str, ...]
    outputs: tuple[str, ...]
    dt_s: float
    real: FloatArray
    sim: FloatArray
    fuel: FloatArray

    @property
    def gap(self) -> FloatArray:
        """Recorded less simulated."""
        return self.real - self.sim


@dataclass(frozen=True, eq=False)
class Step:
    """RMSE (engines, outputs) with what `name` says added; `rest` (engines, time, outputs) is left.

    `fitted` says what of the judged engine's own log went into it: nothing, the windows, or sizes.
    """

    name: str
    rmse: FloatArray
    rest: FloatArray
    fitted: str


@dataclass(frozen=True, eq=False)
class FlightStudy:
    """One flight judged by a model of another: windows, and how far the error falls.

    `alone` are the windows found in one engine's log without the other's.
    """

    title: str
    judged: Judged
    windows: Windows
    alone: Mapping[str, Windows]
    steps: tuple[Step, ...]

    @property
    def explained(self) -> float:
        """Share of the squared error that the other engine's windows take away, mean of all."""
        return float(np.mean(1.0 - (self.steps[1].rmse / self.steps[0].rmse) ** 2))

    @property
    def confirmed(self) -> bool:
        """Whether there are windows, and one engine's tell the other's."""
        return bool(self.windows.found) and self.explained >= CONFIRMED


def steps(judged: Judged, both: Windows, alone: Mapping[str, Windows]) -> tuple[Step, ...]:
    """As is; with what the other engine tells, in three steps; with own sizes, and an own offset.

    Without windows in the other engine's log alone, its error stays as it is.
    """
    gap = judged.gap
    crossed, shared, soaked = gap.copy(), gap.copy(), gap.copy()
    for e in range(2):
        other = judged.engines[1 - e]
        shape = followed(alone[other].on[0], judged.dt_s)
        crossed[e] -= shape[:, None] * level(gap[1 - e], [shape])[0]
        shape = followed(both.on[1 - e], judged.dt_s)
        shared[e] -= shape[:, None] * level(gap[1 - e], [shape])[0]
        metal = _metal(judged, 1 - e, shape)
        sizes = level(gap[1 - e], [shape, heat_lag(judged.sim[1 - e], judged, metal)])
        soaked[e] -= shape[:, None] * sizes[0]
        soaked[e] -= heat_lag(judged.sim[e], judged, metal)[:, None] * sizes[1]
    own, whole = gap.copy(), gap.copy()
    for e in range(2):
        shape = followed(both.on[e], judged.dt_s)
        own[e] -= shape[:, None] * level(gap[e], [shape])[0]
        soak = heat_lag(judged.sim[e], judged, _metal(judged, e, shape))
        found = level(gap[e], [shape, soak])
        whole[e] -= np.stack([shape, soak, np.ones_like(shape)], axis=1) @ found
    return (
        _step("as is", gap, "no"),
        _step("windows and sizes of the other engine alone", crossed, "no"),
        _step("windows of both, sizes of the other engine", shared, "windows"),
        _step("and heat soak of the other engine", soaked, "windows"),
        _step("windows of both, own sizes", own, "yes"),
        _step("and own heat soak and one offset per channel", whole, "yes"),
    )


def _step(name: str, rest: FloatArray, fitted: str) -> Step:
    return Step(name, np.sqrt(np.nanmean(rest**2, axis=1)), rest, fitted)


def followed(on: FloatArray, dt_s: float) -> FloatArray:
    """How the engine takes up a load that is `on` (time,)."""
    return np.asarray(Lag(np.array([FOLLOW_S]), dt_s)(on[None])[0])


def heat_lag(sim: FloatArray, judged: Judged, tau_s: float) -> FloatArray:
    """Temperature that the metal lacks (time,), in K: the simulated one less its own lag."""
    hot = sim[:, judged.outputs.index("EGT_C")]
    return np.asarray(hot - Lag(np.array([tau_s]), judged.dt_s)(hot[None])[0])


def _metal(judged: Judged, e: int, shape: FloatArray) -> float:
    """Time constant of the metal at which engine `e` is told best."""
    left = []
    for tau_s in METAL_S:
        shapes = [shape, heat_lag(judged.sim[e], judged, tau_s)]
        amounts = level(judged.gap[e], shapes)
        rest = judged.gap[e] - np.stack([*shapes, np.ones_like(shape)], axis=1) @ amounts
        left.append(float(np.nanmean(rest[:, judged.outputs.index("EGT_C")] ** 2)))
    return METAL_S[int(np.argmin(left))]


def level(gap: FloatArray, shapes: list[FloatArray]) -> FloatArray:
    """Least squares sizes (shapes + 1, outputs) of shapes (time,) and, last, an offset."""
    design = np.stack([*shapes, np.ones(len(gap))], axis=1)
    known = np.isfinite(gap).all(axis=1)
    if not design[known, 0].any():
        design[:, 0] = 0.0
    return np.asarray(np.linalg.lstsq(design[known], gap[known], rcond=None)[0])


def level_interval(judged: Judged, e: int, on: FloatArray) -> tuple[Interval, ...]:
    """Mean size of the windows on engine `e`, with its 90 % interval, by blocks of two minutes.

    It is the whole change of level, later heating included; the search for windows weighs edges.
    """
    gap, shape = judged.gap[e], followed(on, judged.dt_s)
    size = round(_BLOCK_S / judged.dt_s)
    count = len(gap) // size
    random = np.random.default_rng(0)
    blocks = np.arange(count * size).reshape(count, size)
    drawn = []
    for _ in range(_DRAWS):
        rows = blocks[random.integers(count, size=count)].ravel()[:: max(1, size // 100)]
        drawn.append(level(gap[rows], [shape[rows]])[0])
    value = level(gap, [shape])[0]
    low, high = np.quantile(np.array(drawn), [0.05, 0.95], axis=0)
    return tuple(
        Interval(float(v), float(a), float(b)) for v, a, b in zip(value, low, high, strict=True)
    )
