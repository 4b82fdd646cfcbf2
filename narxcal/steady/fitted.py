"""A steady-state model fitted to quasi-steady samples of flight logs, in corrected parameters.

In corrected parameters (Walsh and Fletcher 2004, Gas Turbine Performance, section 4.3) one curve
over the driving channel nearly serves all altitudes and temperatures; the rest is blended linearly
between the corners v of the flight envelope:

    y_c(z, x) = sum_v  weight_v(x) * (a_v + sum_j b_vj I_j(z)),   b_vj >= 0

Real exponents of theta and delta differ from those of similarity (Volponi 1999, J. Eng. Gas
Turbines Power 121(4)): with `exponents`, each named ratio r of the air adds

    (c + d z) * (ln r - middle),   ln r held within the range of the fit

| symbol | meaning | unit |
|---|---|---|
| z | driver: lever [deg], or log of (corrected) fuel flow | |
| x | blending channels, scaled to [0, 1] in the envelope | - |
| I_j | monotone I-splines of degree 2 (Ramsay 1988, Statistical Science 3(4)) | - |
| a, b | `curve`: offset and spline coefficients, in corrected output units | |
| c, d | `air_lines`: value at mid-range and slope per full range of z, likewise | |

Non-negative b make every output monotone in the driver everywhere inside the envelope. Each engine
adds a curve of the same splines, its build scatter, and each switch (a bleed, another idle) that is
on a straight line over z.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from itertools import product
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BSpline, PPoly

from narxcal.atmosphere import AIR_CHANNELS, AirState, air_at, corrected_scale
from narxcal.steady.model import (
    ALTERED,
    Arrays,
    Envelope,
    checked_inputs,
    register_steady,
    stored,
    stored_names,
)
from narxcal.support.arrays import BoolArray, FloatArray
from narxcal.support.errors import ModelError

_WHAT = "steady-state model"
_ARRAYS = ("low", "high", "seen", "knots", "curve", "engine_curves")
_LATER = ("switch_lines", "air_lines", "air_seen")  # older folders lack some of them
_NO_LINES: FloatArray = np.zeros((0, 0, 2))
_NO_RANGE: FloatArray = np.zeros((0, 2))
RATIOS = ("theta", "delta")


@dataclass(frozen=True, kw_only=True)
class Layout:
    """The role of each channel.

    `corrected` refers speeds to sqrt(theta2), temperatures to theta2 and fuel flow to
    delta2 sqrt(theta2); it needs ALT_ft among the inputs (Mach and dT_C are taken as zero
    where they are missing). `blend` names the inputs between whose extremes the curves blend,
    `switches` those that add a line of their own while they are on, `exponents` which of `RATIOS`
    correct the corrected outputs further.
    """

    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    driver: str
    blend: tuple[str, ...] = ()
    corrected: bool = True
    switches: tuple[str, ...] = ()
    exponents: tuple[str, ...] = ()

    @property
    def assumed(self) -> tuple[str, ...]:
        """Channels of the air that corrected parameters take as zero, as the model has none."""
        known = self.input_names
        return tuple(each for each in AIR_CHANNELS if self.corrected and each not in known)

    def column(self, inputs: FloatArray, name: str) -> FloatArray:
        """One named column of `inputs` (..., n_in), zero where the model has none."""
        if name not in self.input_names:
            return np.zeros(inputs.shape[:-1])
        return inputs[..., self.input_names.index(name)]

    def drive(self, inputs: FloatArray, air: AirState | None = None) -> FloatArray:
        """The driver z: log of corrected fuel flow, or the lever itself.

        `air` is that of `inputs`, where the caller has it already.
        """
        driver = self.column(inputs, self.driver)
        if self.driver != "FF_kgph":
            return driver
        if self.corrected:
            driver = driver / corrected_scale("FF_kgph", air or air_at(inputs, self.input_names))[0]
        return np.log(np.maximum(driver, 1.0))

    def ratios(self, inputs: FloatArray, air: AirState | None = None) -> FloatArray:
        """Logarithms of the ratios that `exponents` name, (..., exponents); `air` as in `drive`."""
        if not self.exponents:
            return np.zeros((*inputs.shape[:-1], 0))
        air = air or air_at(inputs, self.input_names)
        known = {"theta": air.theta2, "delta": air.delta2}
        return np.log(np.stack([known[name] for name in self.exponents], axis=-1))

    def to_corrected(self, inputs: FloatArray, outputs: FloatArray) -> FloatArray:
        """Convert outputs (..., n_out) to corrected parameters."""
        scale, offset = self._scale(inputs, None)
        return (outputs + offset) / scale

    def from_corrected(
        self, inputs: FloatArray, corrected: FloatArray, air: AirState | None = None
    ) -> FloatArray:
        """Convert corrected parameters to outputs (..., n_out); `air` as in `drive`."""
        scale, offset = self._scale(inputs, air)
        return corrected * scale - offset

    def corners(self, inputs: FloatArray, envelope: Envelope) -> FloatArray:
        """Weight of each corner of the envelope in the blending channels: (..., corners)."""
        columns = [self.input_names.index(name) for name in self.blend]
        width = np.maximum(envelope.high - envelope.low, 1e-12)
        with np.errstate(over="ignore"):  # weights are clipped to the corners
            return corner_weights(((inputs - envelope.low) / width)[..., columns])

    def _scale(self, inputs: FloatArray, air: AirState | None) -> tuple[FloatArray, FloatArray]:
        scale = np.ones((*inputs.shape[:-1], len(self.output_names)))
        offset = np.zeros(len(self.output_names))
        if self.corrected:
            air = air or air_at(inputs, self.input_names)
            for k, name in enumerate(self.output_names):
                scale[..., k], offset[k] = corrected_scale(name, air)
        return scale, offset


@register_steady
@dataclass(frozen=True, kw_only=True, eq=False)
class FittedSteadyState:
    """Monotone spline curves in corrected parameters (see the module).

    `curve` (n_out, corners, 1 + splines) contains a_v and b_vj; `engine_curves` (engines, n_out,
    1 + splines) what each engine adds to them; `switch_lines` (switches, n_out, 2) value at
    mid-range and slope per full range of the driver, and so does `air_lines` (exponents, n_out, 2),
    the latter per unit of ln ratio, whose range in the fit is `air_seen` (exponents, 2). `engine`
    selects the build scatter; an unknown engine gets none.
    `envelope` and `seen` (2,), the range of z, bound the samples of the fit; the knots reach
    beyond them.
    """

    kind: ClassVar[str] = "fitted"

    layout: Layout
    envelope: Envelope
    seen: FloatArray
    knots: FloatArray
    curve: FloatArray
    engines: tuple[str, ...] = ()
    engine_curves: FloatArray
    switch_lines: FloatArray = field(default_factory=_NO_LINES.copy)
    air_lines: FloatArray = field(default_factory=_NO_LINES.copy)
    air_seen: FloatArray = field(default_factory=_NO_RANGE.copy)
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

    def inside(self, inputs: ArrayLike) -> BoolArray:
        """Whether samples (..., n_in) lie within the range of the fit, driver included."""
        given = checked_inputs(inputs, self.input_names)
        drive = self.layout.drive(given)
        seen = (drive >= self.seen[0]) & (drive <= self.seen[1])
        return np.asarray(self.envelope.inside(given) & seen)

    def outputs(self, inputs: ArrayLike) -> FloatArray:
        """Steady-state outputs (..., n_out) at `inputs` (..., n_in); constant beyond the knots."""
        given = checked_inputs(inputs, self.input_names)
        air = air_at(given, self.input_names) if self.layout.corrected else None
        z = np.clip(self.layout.drive(given, air), self.knots[0], self.knots[-1])
        basis = np.concatenate([np.ones((*z.shape, 1)), self._splines(z)], axis=-1)
        weights = self.layout.corners(given, self.envelope)
        corrected = np.einsum("...v,...j,ovj->...o", weights, basis, self._own_curve)
        scaled = scaled_driver(z, self.knots)[..., None]
        for name, line in zip(self.layout.switches, self.switch_lines, strict=True):
            on = self.layout.column(given, name)[..., None]
            corrected = corrected + on * (line[:, 0] + line[:, 1] * scaled)
        shares = centred_ratios(self.layout.ratios(given, air), self.air_seen)
        for share, line in zip(np.moveaxis(shares, -1, 0), self.air_lines, strict=True):
            corrected = corrected + share[..., None] * (line[:, 0] + line[:, 1] * scaled)
        return self.layout.from_corrected(given, corrected, air)

    def curve_of(self, engine: str) -> FloatArray:
        """Curves (n_out, corners, 1 + splines) of an engine; those of the mean if it is unknown."""
        if engine not in self.engines:
            return self.curve
        return self.curve + self.engine_curves[self.engines.index(engine), :, None]

    @cached_property
    def _own_curve(self) -> FloatArray:
        return self.curve_of(self.engine)

    @cached_property
    def _splines(self) -> PPoly:
        return i_splines(self.knots)

    def to_arrays(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Split into JSON-able structure and named arrays, for the bundle."""
        arrays = {
            "low": self.envelope.low,
            "high": self.envelope.high,
            **{name: getattr(self, name) for name in (*_ARRAYS[2:], *_LATER)},
        }
        layout = {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in asdict(self.layout).items()
        }
        return {"layout": layout, "engines": list(self.engines), "engine": self.engine}, arrays

    @classmethod
    def from_arrays(cls, meta: Mapping[str, Any], arrays: Arrays) -> Self:
        """Rebuild from `to_arrays`; raises `ModelError` where a part is missing or misshapen."""
        kept = {name: stored(arrays, name, _WHAT) for name in _ARRAYS}
        layout = stored(meta, "layout", _WHAT)
        inputs, outputs = stored_names(layout, _WHAT)
        model = cls(
            layout=Layout(
                input_names=inputs,
                output_names=outputs,
                driver=layout["driver"],
                blend=tuple(layout["blend"]),
                corrected=layout["corrected"],
                switches=tuple(layout.get("switches", ())),
                exponents=tuple(layout.get("exponents", ())),
            ),
            envelope=Envelope(kept.pop("low"), kept.pop("high")),
            engines=tuple(meta.get("engines", ())),
            **{name: np.asarray(arrays[name]) for name in _LATER if name in arrays},
            engine=str(meta.get("engine", "")),
            **kept,
        )
        model.check()
        return model

    def check(self) -> None:
        """Raise `ModelError` for names and arrays that do not fit each other."""
        layout = self.layout
        inputs, outputs = len(layout.input_names), len(layout.output_names)
        lacking = {layout.driver, *layout.blend, *layout.switches} - {*layout.input_names}
        if lacking:
            raise ModelError(f"'{min(lacking)}' is no input of the stored {_WHAT}", hint=ALTERED)
        if not {*layout.exponents} <= {*RATIOS}:
            raise ModelError(f"the stored {_WHAT} has an unknown ratio of the air", hint=ALTERED)
        if self.knots.ndim != 1 or len(self.knots) < 2 or not (np.diff(self.knots) > 0.0).all():
            raise ModelError(f"the knots of the stored {_WHAT} do not increase", hint=ALTERED)
        shapes = {
            "low": (self.envelope.low, (inputs,)),
            "high": (self.envelope.high, (inputs,)),
            "seen": (self.seen, (2,)),
            "curve": (self.curve, (outputs, 2 ** len(layout.blend), len(self.knots) + 1)),
            "engine_curves": (
                self.engine_curves,
                (len(self.engines), outputs, self.curve.shape[-1]),
            ),
            "switch_lines": (self.switch_lines, (len(layout.switches), outputs, 2)),
            "air_lines": (self.air_lines, (len(layout.exponents), outputs, 2)),
            "air_seen": (self.air_seen, (len(layout.exponents), 2)),
        }
        for name, (array, shape) in shapes.items():
            if array.shape != shape and (array.size or shape[0]):
                raise ModelError(
                    f"array '{name}' of the stored {_WHAT} has to be of shape {shape}, "
                    f"found {array.shape}",
                    hint=ALTERED,
                )


def i_splines(knots: FloatArray) -> PPoly:
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


def corner_weights(x: FloatArray) -> FloatArray:
    """Multilinear weights of the corners c in {0, 1}^n of the unit cube; they sum to one.

        w_c(x) = prod_i  x_i  if c_i = 1  else  1 - x_i

    `x` (..., n) are the blending channels scaled to [0, 1]; returns (..., 2^n).
    """
    corners = np.array(list(product((False, True), repeat=x.shape[-1])), dtype=bool)
    x = np.clip(x, 0.0, 1.0)[..., None, :]
    return np.asarray(np.where(corners, x, 1.0 - x).prod(axis=-1))


def centred_ratios(ratios: FloatArray, seen: FloatArray) -> FloatArray:
    """Logarithms of ratios (..., n) within the ranges `seen` (n, 2), from the middle of each."""
    low, high = seen.T
    return np.asarray(np.clip(ratios, low, high) - 0.5 * (low + high))


def scaled_driver(z: FloatArray, knots: FloatArray) -> FloatArray:
    """Driver scaled to [-0.5, 0.5] over the range of the knots."""
    return np.asarray((z - knots[0]) / (knots[-1] - knots[0]) - 0.5)
