"""Cleaning: repair single gross errors, mask a channel while its sensor is at fault."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from pydantic import Field

from data_prep.faults import (
    SPOOLS,
    FaultsConfig,
    Reason,
    beyond_usual,
    bursts,
    excursions,
    frozen,
    is_sensed,
    out_of_range,
    role,
)
from data_prep.log import Action, AuditEntry, Log
from data_prep.outliers import Method, gross_errors
from narxcal.support.arrays import BoolArray, FloatArray, bridge_gaps, sample_and_hold, spans
from narxcal.support.settings import Section

# Spikes that count towards a burst stand off by twice what makes a single gross error.
_BURST_FACTOR = 2.0
# Slack when a span is compared with a limit that it just reaches.
_ROUNDING = 1e-9
# Shorter spans are only counted.
_SPAN_S = 1.0


class CleanConfig(Section):
    """TOML table `[clean]`.

    method, sigmas: the test for single gross errors, "3-sigma" or "grubbs" (which knows no
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
    """Clean every channel for itself; only the affected channel is changed.

    Faults that last become NaN, single gross errors are interpolated, and each sample of
    both is counted in the audit.
    """
    config = config or CleanConfig()
    if not config.enabled or len(log) < 3:
        return log
    changed: dict[str, FloatArray] = {}
    entries: list[AuditEntry] = []
    # Spools first: whether a cut of fuel was real is read off the cleaned ones.
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
    """One channel on its way through the tests; `values` is what is left of it."""

    log: Log
    name: str
    config: CleanConfig
    values: FloatArray = field(init=False)
    entries: list[AuditEntry] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        self.values = self.log[self.name].copy()

    def run(self) -> None:
        """Run the tests, the surest first; later ones no longer see what earlier ones took."""
        self._drop(out_of_range(self.name, self.values), "out of range")
        if role(self.name) == "switch":
            return
        for start, stop in spans(frozen(self._current(), self.name, self.config.faults)):
            self._plateau(start, stop, "frozen")
        self._bursts()
        for start, stop in excursions(self._current(), self.name, self.config.faults):
            # Single spikes are told apart better below: two of opposite sign look like one jump.
            if (stop - start) * self.log.dt_s > self.config.repair_s + _ROUNDING:
                self._plateau(start, stop, "spiking")
        self._drop(self._gross(self.config.sigmas), "spiking", repair_only=True)
        # Half a second off the median is no manoeuvre of an output; ambient channels may blip.
        if role(self.name) == "output":
            self._drop(self._gross(_BURST_FACTOR * self.config.sigmas), "spiking")

    def _current(self) -> Log:
        return self.log.with_channels({self.name: self.values})

    def _window(self) -> int:
        half = min(round(0.5 * self.config.median_s / self.log.dt_s), len(self.log))
        return 2 * max(1, half) + 1

    def _gross(self, sigmas: float) -> BoolArray:
        return gross_errors(self.values, self._window(), sigmas, self.config.method)

    def _bursts(self) -> None:
        if not is_sensed(self.name):
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
        short = np.zeros(len(mask), dtype=np.bool_)
        long = np.zeros(len(mask), dtype=np.bool_)
        for start, stop in spans(mask):
            span_s = (stop - start) * self.log.dt_s
            if span_s <= self.config.repair_s + _ROUNDING:
                short[start:stop] = True
            elif not repair_only:
                long[start:stop] = True
        self.values[short | long] = np.nan
        self._note(long, "masked", reason)
        self.values[short] = self._bridge()[short]
        self._note(short, "repaired", reason)

    def _bridge(self) -> FloatArray:
        # A switch has no values in between: it keeps the last one, at the start takes the next.
        fill = sample_and_hold if role(self.name) == "switch" else bridge_gaps
        return fill(self.values)

    def _note(self, mask: BoolArray, action: Action, reason: Reason) -> None:
        if not mask.any():
            return
        time_s, half = self.log.time_s, 0.5 * self.log.dt_s
        long = tuple(
            (float(time_s[start]) - half, float(time_s[stop - 1]) + half)
            for start, stop in spans(mask)
            if (stop - start) * self.log.dt_s >= _SPAN_S
        )
        count = int(mask.sum())
        self.entries.append(AuditEntry(self.name, action, reason, count, long))
