"""A steady-state model fitted from quasi-steady samples of flight logs, in corrected parameters.

In corrected parameters (Walsh and Fletcher 2004, Gas Turbine Performance, section 4.3) one
curve over the driving channel serves all altitudes and temperatures nearly; what is left is
blended linearly between the corners of the flight envelope:

    y_c(z, x) = sum over corners v of  weight_v(x) * (a_v + sum_j b_vj I_j(z)),   b_vj >= 0

with I_j the monotone I-splines of degree 2 (Ramsay 1988, Statistical Science 3(4)) over the
driver z, and x the blending channels scaled to [0, 1]. Non-negative b make every output
monotone in the driver everywhere inside the envelope. Each engine adds a small straight line
over z, its build scatter; so does each switch while it is on: a bleed, another idle.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BSpline, PPoly

from narxcal.atmosphere import AirState, air_state
from narxcal.steady.model import Arrays, Envelope, checked_inputs, register_steady, stored

Floats = NDArray[np.float64]
KELVIN = 273.15
_ARRAYS = ("low", "high", "seen", "knots", "curve", "engine_lines")
_NO_LINES: Floats = np.zeros((0, 0, 2))


@dataclass(frozen=True, kw_only=True)
class Layout:
    """Which channel plays which part.

    `corrected` refers speeds to sqrt(theta2), temperatures to theta2 and fuel flow to
    delta2 sqrt(theta2); it needs ALT_ft among the inputs (Mach and dT_C are taken as zero
    where they are missing). `blend` names the inputs between whose extremes the curves blend,
    `switches` those that add a line of their own while they are on.
    """

    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    driver: str
    blend: tuple[str, ...] = ()
    corrected: bool = True
    switches: tuple[str, ...] = ()

    def column(self, inputs: Floats, name: str) -> Floats:
        """One named column of `inputs` (..., n_in), zero where the model has none."""
        if name not in self.input_names:
            return np.zeros(inputs.shape[:-1])
        return inputs[..., self.input_names.index(name)]

    def drive(self, inputs: Floats, air: AirState | None = None) -> Floats:
        """The driver as the curves see it: log of corrected fuel flow, or the lever itself.

        `air` is that of `inputs`, for a caller who has it already.
        """
        driver = self.column(inputs, self.driver)
        if self.driver != "FF_kgph":
            return driver
        if self.corrected:
            air = air or self.air(inputs)
            driver = driver / (air.delta2 * np.sqrt(air.theta2))
        return np.log(np.maximum(driver, 1.0))

    def referred(self, inputs: Floats, outputs: Floats) -> Floats:
        """Outputs (..., n_out) to corrected parameters."""
        scale, offset = self._reference(inputs, None)
        return (outputs + offset) / scale

    def actual(self, inputs: Floats, referred: Floats, air: AirState | None = None) -> Floats:
        """Corrected parameters back to outputs (..., n_out); `air` as in `drive`."""
        scale, offset = self._reference(inputs, air)
        return referred * scale - offset

    def air(self, inputs: Floats) -> AirState:
        """The air at `inputs` (..., n_in)."""
        names = ("ALT_ft", "Mach", "dT_C")
        return air_state(*(self.column(inputs, name) for name in names))

    def _reference(self, inputs: Floats, air: AirState | None) -> tuple[Floats, Floats]:
        shape = (*inputs.shape[:-1], len(self.output_names))
        scale, offset = np.ones(shape), np.zeros(shape)
        if self.corrected:
            air = air or self.air(inputs)
            for k, name in enumerate(self.output_names):
                if name.endswith("_pct"):
                    scale[..., k] = np.sqrt(air.theta2)
                elif name.endswith("_C"):
                    scale[..., k], offset[..., k] = air.theta2, KELVIN
                elif name == "FF_kgph":
                    scale[..., k] = air.delta2 * np.sqrt(air.theta2)
                elif name == "FN_kN":
                    scale[..., k] = air.delta2
        return scale, offset


@register_steady
@dataclass(frozen=True, kw_only=True, eq=False)
class FittedSteadyState:
    """Monotone spline curves in corrected parameters (see the module).

    `curve` (n_out, corners, 1 + splines) holds a_v and b_vj; `engine_lines` (engines, n_out, 2)
    value at mid-range and slope per full range of the driver, and so does `switch_lines`
    (switches, n_out, 2). `engine` picks the scatter in force; an unknown engine gets none. The
    envelope is the box it is vouched for, `seen` (2,) their range of the driver as the curves see
    it; the knots reach beyond it.
    """

    kind: ClassVar[str] = "fitted"

    layout: Layout
    envelope: Envelope
    seen: Floats
    knots: Floats
    curve: Floats
    engines: tuple[str, ...] = ()
    engine_lines: Floats
    switch_lines: Floats = field(default_factory=_NO_LINES.copy)
    engine: str = ""

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the input columns."""
        return self.layout.input_names

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names of the output columns."""
        return self.layout.output_names

    def for_engine(self, engine: str) -> FittedSteadyState:
        """The same curves with the build scatter of `engine` (none if it was not fitted)."""
        return replace(self, engine=engine)

    def inside(self, inputs: ArrayLike) -> NDArray[np.bool_]:
        """Whether samples (..., n_in) lie within what the fit has seen, driver included."""
        given = checked_inputs(inputs, self.input_names)
        drive = self.layout.drive(given)
        seen = (drive >= self.seen[0]) & (drive <= self.seen[1])
        inside: NDArray[np.bool_] = self.envelope.inside(given) & seen
        return inside

    def outputs(self, inputs: ArrayLike) -> Floats:
        """Settled outputs (..., n_out) at `inputs` (..., n_in); held beyond the knots."""
        given = checked_inputs(inputs, self.input_names)
        air = self.layout.air(given) if self.layout.corrected else None
        z = np.clip(self.layout.drive(given, air), self.knots[0], self.knots[-1])
        weights = corner_weights(self.layout, self.envelope, given)
        referred = np.einsum("...v,...j,ovj->...o", weights, self._basis(z), self.curve)
        if self.engine in self.engines:
            line = self.engine_lines[self.engines.index(self.engine)]
            referred = referred + line[:, 0] + line[:, 1] * self._middle(z)[..., None]
        for name, line in zip(self.layout.switches, self.switch_lines, strict=True):
            on = self.layout.column(given, name)[..., None]
            referred = referred + on * (line[:, 0] + line[:, 1] * self._middle(z)[..., None])
        return self.layout.actual(given, referred, air)

    def _basis(self, z: Floats) -> Floats:
        return np.concatenate([np.ones((*z.shape, 1)), self._splines(z)], axis=-1)

    @cached_property
    def _splines(self) -> PPoly:
        return i_splines(self.knots)

    def _middle(self, z: Floats) -> Floats:
        return middle(z, self.knots)

    def to_arrays(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Split into JSON-able structure and named arrays, for the bundle."""
        layout = {
            "input_names": list(self.layout.input_names),
            "output_names": list(self.layout.output_names),
            "driver": self.layout.driver,
            "blend": list(self.layout.blend),
            "corrected": self.layout.corrected,
            "switches": list(self.layout.switches),
        }
        arrays = {
            "low": self.envelope.low,
            "high": self.envelope.high,
            "seen": self.seen,
            "knots": self.knots,
            "curve": self.curve,
            "engine_lines": self.engine_lines,
            "switch_lines": self.switch_lines,
        }
        return {"layout": layout, "engines": list(self.engines), "engine": self.engine}, arrays

    @classmethod
    def from_arrays(cls, meta: Mapping[str, Any], arrays: Arrays) -> Self:
        """Rebuild from `to_arrays`; raises `ModelError` where a part is missing."""
        kept = {name: stored(arrays, name, "steady-state model") for name in _ARRAYS}
        layout = stored(meta, "layout", "steady-state model")
        return cls(
            layout=Layout(
                input_names=tuple(layout["input_names"]),
                output_names=tuple(layout["output_names"]),
                driver=layout["driver"],
                blend=tuple(layout["blend"]),
                corrected=layout["corrected"],
                switches=tuple(layout.get("switches", ())),
            ),
            envelope=Envelope(kept["low"], kept["high"]),
            seen=kept["seen"],
            knots=kept["knots"],
            curve=kept["curve"],
            engines=tuple(meta.get("engines", ())),
            engine_lines=kept["engine_lines"],
            switch_lines=np.asarray(arrays.get("switch_lines", _NO_LINES)),
            engine=str(meta.get("engine", "")),
        )


def i_splines(knots: Floats) -> PPoly:
    """All monotone I-splines of degree 2 over even `knots`: (..., splines).

    The knots go on evenly beyond their ends, so that equal coefficients make a straight line.
    """
    degree = 2
    step = knots[1] - knots[0]
    more = step * np.arange(1, degree + 1)
    padded = np.concatenate([knots[0] - more[::-1], knots, knots[-1] + more])
    count = len(padded) - degree - 1
    # I_j is the sum of the B-splines from j on.
    tails = np.tril(np.ones((count, count)))[:, 1:]
    spline = BSpline(padded, tails, degree)
    # Taylor coefficients of each piece, highest power first, as PPoly wants them.
    taylor = [spline.derivative(2)(knots[:-1]) / 2.0, spline.derivative(1)(knots[:-1])]
    return PPoly(np.stack([*taylor, spline(knots[:-1])]), knots)


def corner_weights(layout: Layout, envelope: Envelope, inputs: Floats) -> Floats:
    """Multilinear weights (..., corners) of the blending channels, which sum to one."""
    parts = []
    for name in layout.blend:
        k = layout.input_names.index(name)
        width = max(envelope.high[k] - envelope.low[k], 1e-12)
        parts.append(np.clip((inputs[..., k] - envelope.low[k]) / width, 0.0, 1.0))
    columns = []
    for corner in product((0, 1), repeat=len(parts)):
        weight = np.ones(inputs.shape[:-1])
        for x, high in zip(parts, corner, strict=True):
            weight = weight * (x if high else 1.0 - x)
        columns.append(weight)
    return np.stack(columns, axis=-1)


def middle(z: Floats, knots: Floats) -> Floats:
    """Driver scaled to [-0.5, 0.5] over the range of the knots."""
    scaled: Floats = (z - knots[0]) / (knots[-1] - knots[0]) - 0.5
    return scaled
