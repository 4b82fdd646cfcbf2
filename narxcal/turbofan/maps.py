r"""Component maps in a compact parametric form.

**Compressor.** The *backbone* joins the points of best efficiency of all speed lines; with
relative corrected speed `n` (1 at the design point) it is

    w_b = n^a,    p_b - 1 = (p_d - 1) n^b,    eta_b = eta_d (1 - c (n - n_best)^2)

A speed line is a quarter of an ellipse; its parameter is the angle `alpha` from choke (0,
vertical) over the backbone (pi/4) to surge (pi/2, horizontal):

    w     = w_b (1 + s_w (cos alpha - cos pi/4)),     s_w = s_1 + s_0 (1 - n)
    p - 1 = (p_b - 1) (1 + s_p (sin alpha - sin pi/4))
    eta   = eta_b / (1 + d (alpha - pi/4)^2)

so that lines are steep at high speed and flat at low speed, as in measured maps (Saravanamuttoo,
Rogers & Cohen, *Gas Turbine Theory*, chapter 5). Beyond choke and surge the lines are extended
linearly, so that flow falls and pressure rises with `alpha` everywhere, as Newton's method needs.

**Turbine.** Swallowing capacity after Stodola's ellipse, `w = sqrt(1 - PR^-m) / (at design)`;
efficiency falls with the square of the departure of the velocity ratio `U / c_0` from its best.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from narxcal.support.compiled import compiled

BACKBONE = 0.25 * math.pi
SURGE = 0.5 * math.pi
_STRAIGHT_BELOW, _STRAIGHT_ABOVE = 0.2, 1.35
_LEAST_EFFICIENCY = 0.15
_LEAST_RATIO = 0.3  # a windmilling fan expands the air, to a limit


class CompressorMap(NamedTuple):
    """Constants of one compressor; `flow_kgps` is corrected, at design speed on the backbone."""

    flow_kgps: float = 0.0  # sized at the design point, as are the two next to it
    pressure_ratio: float = 0.0
    efficiency: float = 0.0
    flow_exponent: float = 1.0
    pressure_exponent: float = 2.0
    best_speed: float = 0.9
    speed_loss: float = 0.5  # c
    width: float = 0.10  # s_1: half the relative width of the speed line at design speed
    widening: float = 0.45  # s_0
    height: float = 0.45  # s_p
    angle_loss: float = 0.20  # d


class TurbineMap(NamedTuple):
    """Constants of one turbine at its design point; `capacity` is `W sqrt(T) / P`, SI."""

    capacity: float = 0.0  # sized at the design point, as are the three next to it
    pressure_ratio: float = 0.0
    efficiency: float = 0.0
    work_speed: float = 0.0  # N / sqrt(isentropic drop), the velocity ratio at design
    choking: float = 3.0  # m
    speed_loss: float = 0.35


@compiled
def cosine(alpha: float) -> float:
    """Cosine, extended linearly where its slope would vanish."""
    if alpha < _STRAIGHT_BELOW:
        return math.cos(_STRAIGHT_BELOW) - math.sin(_STRAIGHT_BELOW) * (alpha - _STRAIGHT_BELOW)
    return math.cos(alpha) if alpha < SURGE else SURGE - alpha


@compiled
def sine(alpha: float) -> float:
    """Sine, extended linearly where its slope would vanish."""
    if alpha > _STRAIGHT_ABOVE:
        return math.sin(_STRAIGHT_ABOVE) + math.cos(_STRAIGHT_ABOVE) * (alpha - _STRAIGHT_ABOVE)
    return math.sin(alpha) if alpha > 0.0 else alpha


@compiled
def compressor(chart: CompressorMap, speed: float, alpha: float) -> tuple[float, float, float]:
    """Corrected flow in kg/s, pressure ratio and efficiency at relative corrected `speed`."""
    speed = max(speed, 0.02)
    flow_b = chart.flow_kgps * speed**chart.flow_exponent
    rise_b = (chart.pressure_ratio - 1.0) * speed**chart.pressure_exponent
    best = chart.best_speed
    loss = chart.speed_loss * ((speed - best) ** 2 - (1.0 - best) ** 2)
    width = max(chart.width + chart.widening * (1.0 - speed), 0.03)
    flow = flow_b * (1.0 + width * (cosine(alpha) - math.cos(BACKBONE)))
    rise = rise_b * (1.0 + chart.height * (sine(alpha) - math.sin(BACKBONE)))
    efficiency = max(chart.efficiency * (1.0 - loss), _LEAST_EFFICIENCY)
    efficiency /= 1.0 + chart.angle_loss * (alpha - BACKBONE) ** 2
    return flow, max(1.0 + rise, _LEAST_RATIO), efficiency


@compiled
def stodola(pressure_ratio: float, choking: float) -> float:
    """`sqrt(1 - PR^-m)`, extended linearly below a pressure ratio of 1.01."""
    knee = 1.01
    if pressure_ratio >= knee:
        return math.sqrt(1.0 - pressure_ratio**-choking)
    at_knee = math.sqrt(1.0 - knee**-choking)
    slope: float = 0.5 * choking * knee ** (-choking - 1.0) / at_knee
    return at_knee + slope * (pressure_ratio - knee)


@compiled
def turbine_capacity(chart: TurbineMap, pressure_ratio: float) -> float:
    """Swallowing capacity `W sqrt(T) / P`, SI."""
    at_design = stodola(chart.pressure_ratio, chart.choking)
    return chart.capacity * stodola(pressure_ratio, chart.choking) / at_design


@compiled
def turbine_efficiency(chart: TurbineMap, speed: float, isentropic_drop: float) -> float:
    """Isentropic efficiency at `speed` (relative to design) and an enthalpy drop in J/kg."""
    departure = speed / (chart.work_speed * math.sqrt(max(isentropic_drop, 1e3))) - 1.0
    # A parabola in the velocity ratio, flattened far from it so that it never turns negative.
    return chart.efficiency / (1.0 + chart.speed_loss * departure * departure)
