"""Clean a log: repair single gross errors, mask a channel while its sensor is at fault.

Signals and masks are `(time,)`, NaN where nothing was measured.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.ndimage import median_filter
from scipy.special import stdtrit

from data_prep.cleaning.faults import (
    FaultsConfig,
    Reason,
    beyond_usual,
    bursts,
    excursions,
    frozen,
    is_sensed,
    out_of_range,
    resolution,
)
from data_prep.equilibrium import peak_to_peak
from data_prep.log import LONG_SPAN_S, Action, AuditEntry, Log
from narxcal.channels import SPOOLS
from narxcal.support.arrays import (
    BoolArray,
    FloatArray,
    bridge_gaps,
    long_runs,
    robust_range,
    sample_and_hold,
    spans,
)
from narxcal.support.settings import Section

Method = Literal["3-sigma", "grubbs"]

# The spread is taken over this many median windows, of so many samples at least: of 110 samples the
# median absolute deviation is within 11 % (1.17 / sqrt(count)).
_SPREAD_WINDOWS = 10
_LEAST_BLOCK = 11
# Less than this part of the channel's range is no gross error, however quiet the channel is:
# without it the last digit of a noise-free simulation would be one.
_LEAST_PART = 0.002
# Significance of the Grubbs test, per block.
_ALPHA = 0.05
# Spikes that count towards a burst deviate by twice what makes a single gross error.
_BURST_FACTOR = 2.0
# Slack when a span is compared with a limit that it just reaches.
_ROUNDING = 1e-9


class CleanConfig(Section):
    """TOML table `[clean]`.

    method, sigmas: the test for single gross errors, "3-sigma" or "grubbs" (which has no
        `sigmas`), on the residual to a running median over `median_s`.
    repair_s: a run of errors up to this long is repaired by interpolation, a longer one is
        masked. enabled: false leaves the log as it is.
    """

    enabled: bool = True
    method: Method = "3-sigma"
    sigmas: float = Field(default=3.0, gt=0)
    median_s: float = Field(default=1.0, gt=0)
    repair_s: float = Field(default=0.2, gt=0)
    faults: FaultsConfig = FaultsConfig()


def clean(log: Log, config: CleanConfig | None = None) -> Log:
    """Clean each channel by itself.

    Lasting faults become NaN, single gross errors are interpolated, and each sample of both is
    counted in the audit.
    """
    config = config or CleanConfig()
    if not config.enabled or len(log) < 3:
        return log
    changed: dict[str, FloatArray] = {}
    entries: list[AuditEntry] = []
    # Spools first: the cleaned ones show whether a cut of fuel was real.
    order = sorted(log.channels, key=lambda name: name not in SPOOLS)
    for name in order:
        work = _Work(log.with_channels(changed), name, config)
        work.run()
        if work.entries:
            changed[name] = work.values
            entries += work.entries
    return log.with_channels(changed, *entries)


@dataclass
class _Work:
    """One channel under test; `values` is what is left of it."""

    log: Log
    name: str
    config: CleanConfig
    values: FloatArray = field(init=False)
    entries: list[AuditEntry] = field(init=False, default_factory=list)
    _deviations: Deviations | None = field(init=False, default=None)  # of the present values

    def __post_init__(self) -> None:
        self.values = self.log[self.name].copy()

    def run(self) -> None:
        """Run the tests, the surest first; later ones do not see what earlier ones removed."""
        self._drop(out_of_range(self.log.channel(self.name), self.values), "out of range")
        if self._role == "switch":
            return
        for start, stop in spans(frozen(self._current(), self.name, self.config.faults)):
            self._plateau(start, stop, "frozen")
        self._bursts()
        for start, stop in excursions(self._current(), self.name, self.config.faults):
            # Single spikes are tested below: here two of opposite sign look like one plateau.
            if (stop - start) * self.log.dt_s > self.config.repair_s + _ROUNDING:
                self._plateau(start, stop, "spiking")
        self._drop(self._gross(self.config.sigmas), "spiking", repair_only=True)
        # Half a second off the median is no manoeuvre of an output; ambient channels may blip.
        if self._role == "output":
            self._drop(self._gross(_BURST_FACTOR * self.config.sigmas), "spiking")

    def _current(self) -> Log:
        return self.log.with_channels({self.name: self.values})

    def _window(self) -> int:
        half = min(round(0.5 * self.config.median_s / self.log.dt_s), len(self.log))
        return 2 * max(1, half) + 1

    def _gross(self, sigmas: float) -> BoolArray:
        if self._deviations is None:
            self._deviations = deviations(self.values, self._window())
        return self._deviations.gross(sigmas, self.config.method)

    def _bursts(self) -> None:
        if not is_sensed(self.log.channel(self.name)):
            return
        spikes = self._gross(_BURST_FACTOR * self.config.sigmas)
        mask = bursts(self._current(), self.name, spikes, self.config.faults)
        self._drop(mask & np.isfinite(self.values), "spiking")

    def _plateau(self, start: int, stop: int, reason: Reason) -> None:
        mask = np.zeros(len(self.values), dtype=np.bool_)
        mask[start:stop] = True
        mask &= np.isfinite(self.values)
        if mask.any() and beyond_usual(self.values, mask):
            reason = "out of range"
        self._drop(mask, reason)

    def _drop(self, mask: BoolArray, reason: Reason, *, repair_only: bool = False) -> None:
        """Repair the short runs of `mask`, mask the longer ones unless `repair_only`."""
        if not mask.any():
            return
        self._deviations = None
        long = long_runs(mask, int((self.config.repair_s + _ROUNDING) / self.log.dt_s))
        short = mask & ~long
        long &= not repair_only
        self.values[short | long] = np.nan
        self._note(long, "masked", reason)
        self.values[short] = self._bridge()[short]
        self._note(short, "repaired", reason)

    def _bridge(self) -> FloatArray:
        # A switch has no values in between: it keeps the last one.
        fill = sample_and_hold if self._role == "switch" else bridge_gaps
        return fill(self.values)

    @property
    def _role(self) -> str:
        return self.log.channel(self.name).role

    def _note(self, mask: BoolArray, action: Action, reason: Reason) -> None:
        if not mask.any():
            return
        time_s, half = self.log.time_s, 0.5 * self.log.dt_s
        long = tuple(
            (float(time_s[start]) - half, float(time_s[stop - 1]) + half)
            for start, stop in spans(mask)
            if (stop - start) * self.log.dt_s >= LONG_SPAN_S
        )
        count = int(mask.sum())
        self.entries.append(AuditEntry(self.name, action, reason, count, long))


def running_median(values: FloatArray, window: int) -> FloatArray:
    """Median over a centred odd window; where a signal is monotone, that is the signal."""
    return np.asarray(median_filter(values, size=window, mode="nearest"))


@dataclass(frozen=True)
class Deviations:
    """How far samples `(time,)` lie from the running median of `window`, for tests of any limit.

    `known` are those that were measured, gaps between them are bridged. `bend` are absolute second
    differences, `swing` is what the median itself moves within its window, `least` the smallest
    deviation that counts, `step` the resolution of the channel. Of a constant channel nothing is
    known.
    """

    window: int
    known: BoolArray
    residual: FloatArray
    bend: FloatArray
    swing: FloatArray
    least: float
    step: float

    @cached_property
    def spread(self) -> FloatArray:
        """Standard deviation of the noise around each sample.

        That of the residual, or of second differences: in a window of 3 samples every third one is
        the median itself, and more of them on a slope.
        """
        block = max(self.window, _LEAST_BLOCK)
        residual = _slow_median(np.abs(self.residual), block)
        bend = _slow_median(self.bend, block) / float(np.sqrt(6.0))
        # The median of a quantised residual is short of its spread by up to half a step, and may
        # be zero where the noise is not.
        spread: FloatArray = 1.4826 * np.maximum(residual, bend) + 0.5 * self.step
        return np.maximum(spread, self.step)

    def gross(self, sigmas: float, method: Method) -> BoolArray:
        """Flag gross errors.

        Local: a sample has to leave the median by `sigmas` standard deviations of the noise
        around it, on top of what the median itself moves within its window. A slam is monotone,
        so its residual is zero; a peak is no sharper than the median around it.
        """
        away = np.abs(self.residual)
        if method == "grubbs":
            known = np.where(self.known, self.residual, np.nan)
            flagged = _grubbs(known, self.window * _SPREAD_WINDOWS)
            return flagged & (away > self.least + self.swing)
        return self.known & (away > np.maximum(sigmas * self.spread, self.least) + self.swing)


def deviations(values: FloatArray, window: int) -> Deviations:
    """Take the running median of `window` samples off `values` `(time,)`."""
    low, high = robust_range(values)
    if not high > low:
        none = np.zeros(len(values))
        return Deviations(window, none > 0.0, none, none, none, 0.0, 0.0)
    filled = bridge_gaps(values)
    median = running_median(filled, window)
    return Deviations(
        window=window,
        known=np.isfinite(values),
        residual=filled - median,
        bend=np.abs(np.diff(filled, 2, prepend=filled[:1], append=filled[-1:])),
        swing=peak_to_peak(median, window),
        least=_LEAST_PART * (high - low),
        step=resolution(values),
    )


def _slow_median(values: FloatArray, block: int) -> FloatArray:
    """Median over ten blocks, evaluated once per block and interpolated in between."""
    blocks = _blocks(values, block)
    # Only the last one is padded, and a median that passes over NaN takes three times as long.
    coarse = np.append(np.median(blocks[:-1], axis=1), np.nanmedian(blocks[-1]))
    slow = median_filter(coarse, size=_SPREAD_WINDOWS + 1, mode="nearest")
    centres = (np.arange(len(coarse)) + 0.5) * block
    return np.interp(np.arange(len(values)), centres, slow)


def _blocks(values: FloatArray, size: int) -> FloatArray:
    """Cut `(time,)` into `(block, size)`; the last block is filled up with NaN."""
    padded = np.full(-(-len(values) // size) * size, np.nan)
    padded[: len(values)] = values
    return padded.reshape(-1, size)


def _grubbs(residual: FloatArray, block: int) -> BoolArray:
    """Two-sided Grubbs test in blocks, repeated until no block loses a sample.

    Grubbs (1969), Technometrics 11: G = max|x - mean| / s against
    (N - 1)/sqrt(N) * sqrt(t^2 / (N - 2 + t^2)) with t the alpha/(2N) quantile of Student's t.
    """
    table = _blocks(residual, block)
    rows = np.arange(len(table))
    while True:
        known = np.isfinite(table)
        count = known.sum(axis=1)
        mean = np.where(known, table, 0.0).sum(axis=1) / np.maximum(count, 1)
        away = np.where(known, np.abs(table - mean[:, None]), 0.0)
        spread = np.sqrt((away**2).sum(axis=1) / np.maximum(count - 1, 1))
        worst = away.argmax(axis=1)
        bad = away[rows, worst] > _critical(count) * spread
        if not bad.any():
            break
        table[rows[bad], worst[bad]] = np.nan
    kept = np.isfinite(table.ravel()[: len(residual)])
    return np.asarray(np.isfinite(residual) & ~kept)


def _critical(count: NDArray[np.intp]) -> FloatArray:
    """Tabulate the critical G per block size; a block below three samples rejects nothing."""
    number = np.maximum(count, 3).astype(np.float64)
    quantile = stdtrit(number - 2.0, 1.0 - _ALPHA / (2.0 * number))
    limit = (number - 1) / np.sqrt(number) * np.sqrt(quantile**2 / (number - 2 + quantile**2))
    return np.where(count < 3, np.inf, limit)
