"""The log that is compared with the bank: its residuals, its limits, and findings about it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from data_prep.log import Finding, Kind, Log
from narxcal.channels import CHANNELS, symbol
from narxcal.support.arrays import BoolArray, FloatArray
from training.screening.redundancy import (
    AIR,
    Bank,
    Residuals,
    Signals,
    blocks_of,
    is_measured,
    mate_of,
    recording_of,
    residuals,
)
from training.screening.scatter import LEAST_STRETCH_S, strongest_step

RATE_PER_H = 0.01  # false alarms of each kind per hour of flight
TELLING = 3  # measured channels from which on it can be said which of them is wrong
_LEAST_TESTABLE = 0.1  # share of a log that has to be comparable for a finding about all of it


@dataclass(frozen=True, eq=False)
class Subject:
    """The log under examination; `signals` without what is masked so far.

    `mate` is the other engine of the flight; `whole`: the log is the longest part of its recording,
    and stands for it as a whole.
    """

    bank: Bank
    log: Log
    signals: Signals
    channels: tuple[str, ...]
    mate: Residuals | None
    whole: bool
    findings: tuple[Finding, ...] = ()

    @classmethod
    def of(cls, bank: Bank, log: Log, logs: Sequence[Log]) -> Subject | None:
        """The log among `logs`; None of one that is too short, or has fewer than two channels."""
        lost = {each.channel for each in log.findings if each.kind == "unit" and not each.local}
        channels = tuple(
            name for name in bank.channels if log.recorded([name]) and name not in lost
        )
        clean = log.without_faults()
        signals = Signals.of(clean)
        if len(channels) < 2 or len(signals.time_s) * signals.step_s < 2.0 * LEAST_STRETCH_S:
            return None
        mate, other = mate_of(log, logs), None
        shared = tuple(name for name in channels if mate and mate.recorded([name]))
        if mate and len(shared) > 1:
            other = residuals(bank, Signals.of(mate.without_faults()), shared)
        parts = (len(one) for one in logs if recording_of(one) == recording_of(log))
        whole = len(log) >= max(parts, default=0)
        return cls(bank, clean, _without_air(log, signals), channels, other, whole)

    @property
    def sensed(self) -> list[str]:
        """Channels that a sensor measures; a lever is commanded."""
        return [name for name in self.channels if is_measured(name)]

    @property
    def alarms(self) -> float:
        """Probability of a false alarm of one kind on a sound log of this length."""
        return RATE_PER_H * max(len(self.log) * self.log.dt_s / 3600.0, 0.1)

    @property
    def share(self) -> float:
        """Likewise, of one channel (Bonferroni)."""
        return min(self.alarms, 0.05) / len(self.channels)

    @cached_property
    def limit(self) -> dict[str, float]:
        """Sizes beyond which levels are findings."""
        return {name: self.bank.scatter[name].limit(self.share) for name in self.sensed}

    @cached_property
    def step_limits(self) -> dict[str, dict[int, float]]:
        """Heights of each octave beyond which steps within the log are findings."""
        return self.bank.step_limits(self.share)

    @cached_property
    def shown(self) -> Residuals:
        return residuals(self.bank, self.signals, self.channels)

    @cached_property
    def levels(self) -> dict[str, float]:
        """Levels of the channels of which enough can be compared."""
        known = (
            n for n in self.sensed if np.isfinite(self.shown.agreed[n]).mean() > _LEAST_TESTABLE
        )
        return {name: self.shown.level(name) for name in known}

    @property
    def sound(self) -> bool:
        """Whether no level and no stretch is beyond the limit of sound logs."""
        steps = {
            n: strongest_step(blocks_of(self.shown, n), self.step_limits[n]) for n in self.levels
        }
        return all(
            abs(level) <= self.limit[name] and steps[name].excess < 1.0
            for name, level in self.levels.items()
        )

    def having(self, values: Mapping[str, FloatArray]) -> Subject:
        return replace(self, signals=self.signals.having(values))

    def after(self, findings: Sequence[Finding]) -> Subject:
        """Add findings; their stretches are compared with nothing any more."""
        values = dict(self.signals.values)
        for each in findings:
            if each.local:
                inside = each.rows(self.signals.time_s)
                values[each.channel] = np.where(inside, np.nan, values[each.channel])
        return replace(self.having(values), findings=(*self.findings, *findings))

    def misfit(
        self, found: Residuals, name: str, level: float, span_s: tuple[float, float] | None = None
    ) -> Finding:
        """A finding of the shape that explains the error of a channel best, here or in a stretch.

        Its probability is one minus that of such a level of any channel on a sound log.
        """
        time_s = found.signals.time_s
        low, high = span_s or (-np.inf, np.inf)
        kind, size, unit = _shape(found, name, (time_s >= low) & (time_s <= high))
        text = f"{size:+.3g} {unit} against what {self.others(name)} say"
        chance = len(self.channels) * self.bank.scatter[name].tail(level)
        probability = float(np.clip(1.0 - chance, 0.0, 0.9999))
        if span_s:
            probability = max(probability, 1.0 - self.alarms)
        return self.log.finding(
            kind, name, text, span_s, size=size, unit=unit, probability=probability
        )

    def others(self, name: str) -> str:
        """The channels that one is compared with, in words."""
        return " and ".join(symbol(each) for each in self.channels if each != name)


def _without_air(log: Log, signals: Signals) -> Signals:
    """Blank air data of a wrong unit or that contradict each other: nothing is corrected by it."""
    wrong = {name for each in log.findings if not each.local for name in each.channels} & {*AIR}
    blank = {name: np.full(len(signals.time_s), np.nan) for name in wrong if name in signals.values}
    return signals.having(blank)


def _shape(found: Residuals, name: str, inside: BoolArray) -> tuple[Kind, float, str]:
    """How a channel is wrong in some rows, by the shape that leaves least: kind, size, unit.

    A drift has to leave 10 % less: what is constant is taken for constant.
    """
    unit = CHANNELS[name].unit
    expected = found.corrected.raw(name, found.expected[name])
    error = found.agreed[name] * found.scale(name) * found.corrected.scale[name]
    rows = inside & np.isfinite(error) & np.isfinite(expected)
    y, base = error[rows], expected[rows]
    if len(y) < 3:
        return "bias", 0.0, unit
    shapes: dict[Kind, tuple[FloatArray, float]] = {
        "bias": (np.ones(len(y)), 1.0),
        "scale": (base, 1.0),
        "drift": (np.linspace(0.0, 1.0, len(y)), 0.9),
    }
    sizes = {kind: float(x @ y) / max(float(x @ x), 1e-300) for kind, (x, _) in shapes.items()}
    left = {k: float(np.sum(np.abs(y - sizes[k] * x))) / price for k, (x, price) in shapes.items()}
    best = min(left, key=lambda kind: left[kind])
    return (best, 100.0 * sizes[best], "%") if best == "scale" else (best, sizes[best], unit)
