"""Fits the steady-state curves of `narxcal.steady.fitted` to quasi-steady samples.

A penalised least-squares problem with signs (Eilers and Marx 1996, P-splines; Huber 1964 for
the robust weights): unrecorded bleed or a wrong sensor for some minutes must not bend the
curve of the rest of the flight. Samples in motion are fitted behind a first-order lag, whose time
constant is found with the curve (output error).

**Exponents.** Similarity is the prior mean of the exponents of theta and delta. With the relative
spread e of what engines differ from it (`SPREADS`), the level Y of a corrected output, the RMS s of
the residual and n samples that are independent as far as its autocorrelation says, the mean of the
squared errors is penalised by

    (s / (e Y))^2 / n (c^2 + d^2)

so that half a flight keeps similarity, and several flights move it.

**Engines.** Each deviates from the mean of all by sum_k (c_k - mean c_k) P_k(x), with Legendre
polynomials up to `_DEGREE` over the range of the driver, normalised to a mean square of one: what
all have in common is the curve's. c_k is normal with the
standard deviation t_k S_o, S_o being the scatter between engines of a type in output o
(`training.screening.levels`), and is penalised like the exponents. t_k is learned over engines and
outputs:

    t_k^2 = (p 4^-k + sum (c_k - mean c_k)^2 / S_o^2) / (p + n),   n = (engines - 1) outputs

with the prior of p logs that each degree has half the scatter of the one below. A single engine
has none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray
from scipy.optimize import lsq_linear, minimize_scalar
from scipy.signal import lfilter

from narxcal.channels import CHANNELS
from narxcal.steady.fitted import (
    RATIOS,
    FittedSteadyState,
    Layout,
    centred_ratios,
    i_splines,
    scaled_driver,
)
from narxcal.steady.model import Envelope
from narxcal.support.arrays import FloatArray, IntArray
from narxcal.support.errors import ConfigError, DataError
from training.config import SteadyFitConfig
from training.dynamics.baselines import LONGEST_S, SHORTEST_S
from training.screening.levels import PRIOR_LOGS, prior_share

_NOT_MONOTONE = 0.8  # of the residual that a monotone curve leaves
_USUAL = SteadyFitConfig()
_ROWS = 20000  # more quasi-steady samples than this tell nothing new
# Standard deviation of the exponents of theta and delta from those of similarity, by the unit of
# the output, as of the recorders that fly: `python -m eval.benchmarks.priors` of 2f9145a left one
# out in turn. Without a prior its estimates are several times as large, and differ as much in sign.
# Those of similarity lie between 0 and 1: where a channel's are not known, the logs have to say.
SPREADS: Final = {"%": (0.06, 0.03), "degC": (0.12, 0.065)}
_UNKNOWN: Final = (1.0, 1.0)
_NEAR: Final = 0.15  # of the driver's range: curves may still bend so far beyond the samples
_DEGREE: Final = (
    2  # constant, line, parabola: higher ones differ as much between flights as engines
)
_UNRELATED: Final = 0.05  # autocorrelation below which samples count as independent


@dataclass(frozen=True, eq=False)
class SteadySamples:
    """Samples of one log: inputs (n, n_in), outputs (n, n_out), their engine and log.

    They are quasi-steady or, with the interval `moving_s` between them, a whole log in motion.
    """

    inputs: FloatArray
    outputs: FloatArray
    engine: str = ""
    log: str = ""
    moving_s: float | None = None


@dataclass(frozen=True)
class SteadyQuality:
    """What a fit rests on: samples, residual RMS per output, share of driver range settled."""

    samples: int
    rms: dict[str, float]
    coverage: float = 1.0


def fit_steady_state(
    samples: Sequence[SteadySamples],
    layout: Layout,
    config: SteadyFitConfig = _USUAL,
) -> tuple[FittedSteadyState, SteadyQuality]:
    """Fit all outputs; raises `DataError` where there is too little to fit to.

    Corrected parameters without ALT_ft raise `ConfigError`.
    """
    design, data = linear_problem(samples, layout, config)
    strengths = _strengths(design, data)
    parts = zip(layout.output_names, data.matrices, data.corrected.T, strengths, strict=True)
    curves = np.stack(
        [
            _curve(replace(design, strengths=own), matrix, column, name)
            for name, matrix, column, own in parts
        ]
    )
    fitted = [matrix @ each for matrix, each in zip(data.matrices, curves, strict=True)]
    error = (np.stack(fitted, axis=1) - data.corrected) * data.layout_unit(layout)
    rms = dict(
        zip(layout.output_names, np.sqrt(np.nanmean(error**2, axis=0)).tolist(), strict=True)
    )
    return design.model(curves), SteadyQuality(len(data.inputs), rms)


@dataclass(frozen=True, eq=False)
class LinearData:
    """Samples of all logs, one row each; `matrices` of outputs are what coefficients multiply."""

    inputs: FloatArray
    outputs: FloatArray
    corrected: FloatArray
    matrices: tuple[FloatArray, ...]
    logs: NDArray[np.str_]

    def layout_unit(self, layout: Layout) -> FloatArray:
        """Change of the outputs (rows, n_out) where the corrected parameters change by one."""
        return layout.from_corrected(self.inputs, self.corrected + 1.0) - self.outputs


def linear_problem(
    samples: Sequence[SteadySamples], layout: Layout, config: SteadyFitConfig = _USUAL
) -> tuple[_Design, LinearData]:
    """Return the linear problem that `fit_steady_state` solves; errors are the same."""
    inputs = np.concatenate([part.inputs for part in samples])
    outputs = np.concatenate([part.outputs for part in samples])
    names = np.concatenate([[part.engine] * len(part.inputs) for part in samples])
    logs = np.concatenate([[part.log] * len(part.inputs) for part in samples])
    _require(inputs, outputs, layout)
    rows = slice(None, None, max(len(inputs) // _ROWS, 1))
    inputs, outputs, names, logs = inputs[rows], outputs[rows], names[rows], logs[rows]
    drive = layout.drive(inputs)
    knots = _spread_knots(drive, config)
    engines = _distinguished(samples)
    envelope = _envelope(inputs, layout)
    seen = np.array([drive.min(), drive.max()])
    ratios = layout.ratios(inputs)
    air_seen = np.stack([ratios.min(axis=0), ratios.max(axis=0)], axis=1)
    design = _Design(layout, envelope, seen, knots, engines, config, air_seen)
    corrected = layout.to_corrected(inputs, outputs)
    matrix = design.matrix(inputs, names)
    matrices = (matrix,) * len(layout.output_names)
    if samples[0].moving_s is not None:
        dt_s = samples[0].moving_s * (rows.step or 1)
        firsts = np.flatnonzero(np.concatenate([[True], logs[1:] != logs[:-1]]))
        matrices = tuple(_lagged(design, matrix, y, firsts, dt_s) for y in corrected.T)
    return design, LinearData(inputs, outputs, corrected, matrices, logs)


def _lagged(
    design: _Design, matrix: FloatArray, target: FloatArray, firsts: IntArray, dt_s: float
) -> FloatArray:
    """The matrix behind the first-order lag that leaves the least error; logs begin settled.

    The lag of a curve is the curve of lagged columns, so that every time constant asks for one
    linear fit.
    """

    def behind(log_tau: float) -> FloatArray:
        stays = np.exp(-dt_s / np.exp(log_tau))
        parts = np.split(matrix, firsts[1:])
        return np.concatenate(
            [lfilter([1.0 - stays], [1.0, -stays], x, axis=0, zi=stays * x[:1])[0] for x in parts]
        )

    def left(log_tau: float) -> float:
        lagged = behind(log_tau)
        found = design.solve(lagged, target, monotone=True)
        return float(np.nansum((lagged @ found - target) ** 2))

    ends = float(np.log(SHORTEST_S)), float(np.log(LONGEST_S))
    return behind(
        float(minimize_scalar(left, bounds=ends, method="bounded", options={"xatol": 0.05}).x)
    )


def _require(inputs: FloatArray, outputs: FloatArray, layout: Layout) -> None:
    if layout.corrected and "ALT_ft" not in layout.input_names:
        raise ConfigError(
            "corrected parameters need ALT_ft among [steady_state] inputs",
            hint="Add it, or set corrected = false",
        )
    if layout.exponents and not layout.corrected:
        raise ConfigError(
            "[steady_state] exponents are those of corrected parameters",
            hint="Set corrected = true, or exponents = []",
        )
    if len(inputs) < 50:
        raise DataError(
            f"expected at least 50 samples to fit curves to, found {len(inputs)}",
            channel=layout.driver,
            hint="Add logs, or set [steady_state] kind to table, callable or fmu",
        )
    drive = layout.drive(inputs)
    if float(np.ptp(drive)) <= 1e-6 * max(1.0, float(np.abs(drive).max())):
        raise DataError(
            f"the driving channel stands at {layout.column(inputs, layout.driver)[0]:g} in all "
            "samples, so no curve can be fitted",
            channel=layout.driver,
            hint="Add logs at other power settings",
        )
    for name, column in zip(layout.output_names, outputs.T, strict=True):
        if not np.isfinite(column).any():
            raise DataError(
                "the output is masked in all samples, so no curve can be fitted",
                channel=name,
                hint="Take it out of [narx] outputs, or add logs that hold it",
            )


def _envelope(inputs: FloatArray, layout: Layout) -> Envelope:
    """The box of the samples, a width wider for what the correction alone takes care of.

    Corrected parameters carry a curve over to other air; Reynolds number and humidity say that
    not to any other (Walsh and Fletcher 2004, section 4.3). The driver has a range of its own.
    """
    box = Envelope.of(inputs)
    if not layout.corrected:
        return box
    carried = [name not in layout.blend for name in layout.input_names]
    width = np.where(carried, box.high - box.low, 0.0)
    return Envelope(box.low - width, box.high + width)


def _spread_knots(drive: FloatArray, config: SteadyFitConfig) -> FloatArray:
    """Even knots over the range and a little beyond, where the penalty draws straight lines."""
    low, high = float(drive.min()), float(drive.max())
    beyond = min(_NEAR, config.reach) * (high - low)
    return np.linspace(low - beyond, high + beyond, config.knots)


def _distinguished(samples: Sequence[SteadySamples]) -> tuple[str, ...]:
    engines = sorted({part.engine for part in samples if len(part.inputs)})
    return tuple(engines) if len(engines) > 1 else ()


def _curve(design: _Design, matrix: FloatArray, target: FloatArray, output: str) -> FloatArray:
    """Coefficients of one output: monotone, unless it may turn and the samples clearly say so."""
    monotone = design.solve(matrix, target, monotone=True)
    if not _may_turn(output):
        return monotone
    free = design.solve(matrix, target, monotone=False)
    left = [float(np.nansum((matrix @ each - target) ** 2)) for each in (free, monotone)]
    return free if left[0] < _NOT_MONOTONE**2 * left[1] else monotone


def _may_turn(output: str) -> bool:
    """Whether the output may fall with the driver: temperatures do at low power."""
    return output.endswith("_C") or output not in CHANNELS


def _strengths(design: _Design, data: LinearData) -> FloatArray:
    """Penalties (n_out, lines) on what engines, switches and exponents add; see the module."""
    usual = np.full((len(data.corrected.T), design.lines), design.config.scatter)
    if not design.engines and not design.layout.exponents:
        return usual
    names = design.layout.output_names
    pairs = list(zip(data.matrices, data.corrected.T, strict=True))
    first = np.stack([design.solve(matrix, y, monotone=True) for matrix, y in pairs])
    errors = np.stack([y - x @ each for (x, y), each in zip(pairs, first, strict=True)], axis=1)
    known = [each[np.isfinite(each)] for each in errors.T]
    variance = np.array([np.mean(each**2) / _independent(each) for each in known])
    level = np.maximum(np.nanmedian(np.abs(data.corrected), axis=0), 1e-9)
    if design.engines:
        count = len(design.engines) * (1 + _DEGREE)
        scatter = level * [prior_share(name) for name in names]
        own = first[:, -design.lines :][:, :count].reshape(len(names), -1, 1 + _DEGREE)
        own = own - own.mean(axis=1, keepdims=True)
        shares = np.sum((own / scatter[:, None, None]) ** 2, axis=(0, 1))
        prior = PRIOR_LOGS * 4.0 ** -np.arange(1 + _DEGREE)
        free = (len(design.engines) - 1) * len(names)  # their mean is the curve's
        t = np.sqrt((prior + shares) / (PRIOR_LOGS + free))
        each = variance[:, None] / (scatter[:, None] * t) ** 2
        usual[:, :count] = np.tile(each, len(design.engines))
    for k, ratio in enumerate(design.layout.exponents):
        spread = np.array([_spread(name)[RATIOS.index(ratio)] for name in names])
        at = design.lines - 2 * (len(design.layout.exponents) - k)
        usual[:, at : at + 2] = (variance / (spread * level) ** 2)[:, None]
    return usual


def _spread(output: str) -> tuple[float, float]:
    return SPREADS["degC" if output.endswith("_C") else "%"] if output in CHANNELS else _UNKNOWN


def _independent(residual: FloatArray) -> float:
    """Number of independent samples of a series (n,) by its autocorrelation."""
    n = len(residual)
    power = np.abs(np.fft.rfft(residual, 2 * n)) ** 2
    correlation = np.fft.irfft(power)[:n]
    if correlation[0] <= 0.0:
        return float(n)
    correlation /= correlation[0]
    until = int(np.argmax(correlation < _UNRELATED)) or n
    return n / float(1.0 + 2.0 * correlation[1:until].sum())


@dataclass(frozen=True)
class _Design:
    layout: Layout
    envelope: Envelope
    seen: FloatArray
    knots: FloatArray
    engines: tuple[str, ...]
    config: SteadyFitConfig
    air_seen: FloatArray
    strengths: FloatArray | None = None

    @property
    def corners(self) -> int:
        return int(2 ** len(self.layout.blend))

    @property
    def splines(self) -> int:
        return len(self.knots)

    @property
    def lines(self) -> int:
        """Number of columns behind those of the curves."""
        others = len(self.layout.switches) + len(self.layout.exponents)
        return len(self.engines) * (1 + _DEGREE) + 2 * others

    @cached_property
    def shapes(self) -> FloatArray:
        """Coefficients (1 + splines, 1 + degree) of what engines add, of 1 and the splines."""
        z = np.linspace(self.seen[0], self.seen[1], 20 * len(self.knots))
        degrees = np.arange(1 + _DEGREE)
        wanted = legvander(np.linspace(-1.0, 1.0, len(z)), _DEGREE) * np.sqrt(2 * degrees + 1)
        return np.asarray(np.linalg.lstsq(self.basis(z), wanted, rcond=None)[0])

    def basis(self, drive: FloatArray) -> FloatArray:
        """1 and the splines (n, 1 + splines)."""
        return np.concatenate([np.ones((len(drive), 1)), i_splines(self.knots)(drive)], axis=1)

    def matrix(self, inputs: FloatArray, names: NDArray[np.str_]) -> FloatArray:
        """Columns: by corner 1 and the splines; by engine shapes; by switch, ratio 1 and slope."""
        drive = self.layout.drive(inputs)
        basis = self.basis(drive)
        weights = self.layout.corners(inputs, self.envelope)
        curve = (weights[:, :, None] * basis[:, None, :]).reshape(len(drive), -1)
        line = np.stack([np.ones_like(drive), scaled_driver(drive, self.knots)], axis=1)
        own = basis @ self.shapes
        mean = 1.0 / max(len(self.engines), 1)
        lines = [own * ((names == engine) - mean)[:, None] for engine in self.engines]
        lines += [line * self.layout.column(inputs, name)[:, None] for name in self.layout.switches]
        shares = centred_ratios(self.layout.ratios(inputs), self.air_seen)
        lines += [line * share[:, None] for share in shares.T]
        return np.concatenate([curve, *lines], axis=1)

    def solve(self, matrix: FloatArray, target: FloatArray, *, monotone: bool) -> FloatArray:
        """Huber-weighted penalised least squares, with b >= 0 if `monotone`, for one output."""
        known = np.isfinite(target)
        matrix, target = matrix[known], target[known]
        lower = np.full(matrix.shape[1], -np.inf)
        width = 1 + self.splines
        for corner in range(self.corners if monotone else 0):
            lower[corner * width + 1 : (corner + 1) * width] = 0.0
        penalty = self.penalty(matrix.shape[1])
        weight = np.full(len(target), 1.0 / len(target))
        for _ in range(15 if self.config.huber else 1):
            root = np.sqrt(weight)[:, None]
            rows = np.concatenate(
                [
                    np.column_stack([matrix * root, target * root[:, 0]]),
                    np.column_stack([penalty, np.zeros(len(penalty))]),
                ]
            )
            small = np.asarray(np.linalg.qr(rows, mode="r"))
            solution = lsq_linear(small[:, :-1], small[:, -1], (lower, np.inf)).x
            residual = np.abs(target - matrix @ solution)
            if self.config.huber:
                edge = self.config.huber * max(1.4826 * float(np.median(residual)), 1e-9)
                weight = np.minimum(1.0, edge / np.maximum(residual, 1e-12)) / len(target)
        return np.asarray(solution)

    def penalty(self, size: int) -> FloatArray:
        """Rows that vanish for straight, equal curves without lines of engines and air."""
        width = 1 + self.splines
        rows = []
        for corner in range(self.corners):
            first = corner * width + 1
            rows += [
                _row(size, {j: -1.0, j + 1: 1.0}, self.config.bend)
                for j in range(first, first + self.splines - 1)
            ]
            for bit in range(len(self.layout.blend)):
                other = corner ^ (1 << bit)
                if other > corner:
                    for j in range(width):
                        pair = {corner * width + j: -1.0, other * width + j: 1.0}
                        rows.append(_row(size, pair, self.config.spread))
        usual = np.full(self.lines, self.config.scatter)
        strengths = usual if self.strengths is None else self.strengths
        pairs = zip(range(self.corners * width, size), strengths.tolist(), strict=True)
        rows += [_row(size, {j: 1.0}, strength) for j, strength in pairs]
        return np.array(rows)

    def model(self, coefficients: FloatArray) -> FittedSteadyState:
        """Coefficients (n_out, columns) to a model whose curve is the mean engine's."""
        at = self.corners * (1 + self.splines)
        engines = at + len(self.engines) * (1 + _DEGREE)
        count = len(coefficients)
        curve = coefficients[:, :at].reshape(count, self.corners, -1)
        own = coefficients[:, at:engines].reshape(count, -1, 1 + _DEGREE)
        if self.engines:
            own = own - own.mean(axis=1, keepdims=True)
        own = own @ self.shapes.T
        knots, curve = self._straight_on(curve)
        more = (len(knots) - len(self.knots)) // 2
        lines = coefficients[:, engines:].reshape(count, -1, 2).transpose(1, 0, 2)
        lines = lines * [1.0, (len(knots) - 1) / (self.splines - 1)]  # slopes are over all knots
        own = np.pad(own, ((0, 0), (0, 0), (0, 2 * more)))
        own[..., 1:] = np.roll(own[..., 1:], more, axis=-1)  # an engine's own curve ends level
        return FittedSteadyState(
            layout=self.layout,
            envelope=self.envelope,
            seen=self.seen,
            knots=knots,
            curve=curve,
            engines=self.engines,
            engine_curves=own.transpose(1, 0, 2),
            switch_lines=lines[: len(self.layout.switches)],
            air_lines=lines[len(self.layout.switches) :],
            air_seen=self.air_seen,
        )

    def _straight_on(self, curve: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Knots as far as `reach`, and curves that go on to them as straight lines.

        Between the knots of the fit they are the same. Those of outputs that may turn stand:
        nothing says which way they go on.
        """
        step, span = self.knots[1] - self.knots[0], self.seen[1] - self.seen[0]
        lacking = self.config.reach * span - (self.knots[-1] - self.seen[1])
        more = max(int(np.ceil(lacking / step - 1e-9)), 0)
        out = step * np.arange(1, more + 1)
        knots = np.concatenate([self.knots[0] - out[::-1], self.knots, self.knots[-1] + out])
        stands = np.array([_may_turn(name) for name in self.layout.output_names])
        ends = np.where(stands[:, None, None], 0.0, curve[..., [1, -1]])
        below, above = (np.repeat(ends[..., k, None], more, axis=-1) for k in (0, 1))
        first = curve[..., :1] - below.sum(axis=-1, keepdims=True)
        return knots, np.concatenate([first, below, curve[..., 1:], above], axis=-1)


def _row(size: int, entries: dict[int, float], strength: float) -> FloatArray:
    row = np.zeros(size)
    for column, value in entries.items():
        row[column] = value * np.sqrt(strength)
    return row
