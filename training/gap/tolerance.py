"""What one build may have and another not: limits and idles of a control within its tolerance.

What a limit leaves to accelerate with is the difference of two large torques. On an engine whose
schedule of fuel is a sixth above what it needs, components and schedule that are a percent or two
off shift the limit by a sixth, and more where both are (22 % in a build of another maker's that has
no other fault); idles are trimmed to about a percent. Found in a build that differs otherwise too,
so much of them is no news; in one that is the simulator's own it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from narxcal.effects.base import Effect
from narxcal.effects.dynamic import FASTEST_PCTPS, AccelDecelAsymmetry, AccelLimit
from narxcal.effects.steady import IdleSchedule
from training.gap.fitting import Fit, Problem
from training.gap.scatter import build_scatter

_LIMIT: Final = 0.25  # of the simulator's acceleration or deceleration
_IDLE_PCT: Final = 1.0  # of a speed at idle
_OWN_BUILD: Final = 0.001  # scatter below which both are one build, sensors and all


def of_the_build(tried: Fit, beside: Sequence[Effect], problem: Problem) -> str:
    """The one effect of `tried` that is not among those `beside` it, if a build may have it.

    In words; empty if none may. Nothing is where the recorded engine is of the simulator's own
    build, and two effects that were found together are no limit's doing.
    """
    new = [effect for effect in tried.effects if effect not in beside]
    if len(new) != 1 or build_scatter(problem.flights, problem.misfit) < _OWN_BUILD:
        return ""
    end = int(np.cumsum(tried.sizes)[tried.effects.index(new[0])])
    own = range(end - tried.sizes[tried.effects.index(new[0])], end)
    values = {tried.parameters[k].name: float(tried.theta[k]) for k in own}
    words = _within(new[0], values, by_control=tried.by_control)
    return f"but {words} may be the build's own" if words else ""


def _within(effect: Effect, values: dict[str, float], *, by_control: bool) -> str:
    """The effect in words if it is within what a build may have; empty if it is more, or other."""
    if isinstance(effect, AccelLimit):
        absolute = values.get("most_pctps", FASTEST_PCTPS) < FASTEST_PCTPS
        return "" if absolute else _limit("acceleration", values["share"])
    if isinstance(effect, AccelDecelAsymmetry) and by_control:
        return _limit("deceleration", values["ratio"])
    if isinstance(effect, IdleSchedule):
        speeds = [size for name, size in values.items() if name.endswith("_pct")]
        core = speeds[-1] if speeds else np.inf
        return f"an approach idle {abs(core):.1f} % off" if abs(core) < _IDLE_PCT else ""
    return ""


def _limit(what: str, share: float) -> str:
    off = abs(share - 1.0)
    return f"a limit of {what} {100.0 * off:.0f} % off" if off < _LIMIT else ""
