"""A found effect drawn as an engineer draws it: hysteresis loop, lag step, soak curve, bars.

Curves come from the effect's own hooks wherever it has one to show, so that the drawing is the
effect that was found and no sketch of it. Shaded or thin: the ends of the parameter's interval.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict

from matplotlib.figure import Figure

from eval.gap.effect_words import surest_words
from eval.gap.lever_drawings import hysteresis, lever_bias, lever_in_time
from eval.gap.response_drawings import over_altitude, step_response, time_constants
from eval.gap.shift_drawings import sensor_error, shift_bars, soak, wear
from eval.gap.sketch import Sketch
from eval.report.style import Picture, picture
from narxcal.effects.base import Effect, Parameter, Signals
from training.budget.result import Interval


def drawing(acting: Effect, sizes: Mapping[str, Interval], signals: Signals) -> Picture:
    """Draw `acting` at `sizes` (parameter -> value with interval), for these signals.

    A parameter that is not given is neutral.
    """
    parameters = acting.parameters(signals)
    neutral = {p.name: Interval(p.neutral, p.neutral, p.neutral) for p in parameters}
    sketch = Sketch(acting, {**neutral, **sizes}, signals)
    drawn = _DRAWN.get(acting.id, shift_bars)(sketch)
    alt = f"{acting.name}: {acting.meaning}"
    return picture(drawn, alt, _caption(acting, parameters, sketch.sizes))


def _caption(acting: Effect, parameters: Sequence[Parameter], sizes: Mapping[str, Interval]) -> str:
    """What it is, its sizes with their intervals, and how those are drawn."""
    told = {p.name: {**asdict(sizes[p.name]), "unit": p.unit} for p in parameters}
    meaning = f"{acting.meaning[:1].upper()}{acting.meaning[1:]}"
    words = surest_words({"parameters": told})
    return f"{meaning}: {words}. Shaded, or a thin line in a bar: 90 % interval."


_DRAWN: dict[str, Callable[[Sketch], Figure]] = {
    "throttle_backlash": hysteresis,
    "throttle_delay": lever_in_time,
    "throttle_rate_limit": lever_in_time,
    "throttle_bias": lever_bias,
    "actuator_lag": step_response,
    "sensor_lag": step_response,
    "flowmeter_dynamics": step_response,
    "time_skew": step_response,
    "spool_lag": time_constants,
    "spool_coupling": time_constants,
    "accel_decel_asymmetry": time_constants,
    "accel_limit": over_altitude,
    "altitude_lag": over_altitude,
    "deterioration": wear,
    "heat_soak": soak,
    "sensor_bias": sensor_error,
    "sensor_drift": sensor_error,
}
