"""A log: one recording of one engine on a uniform sampling grid, with its audit."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from data_prep.identity import Identity
from narxcal.support.arrays import BoolArray, FloatArray
from narxcal.support.errors import DataError

LONG_SPAN_S = 1.0  # an audit lists spans of this length, and only counts shorter ones
Action = Literal["masked", "repaired", "filled", "dropped"]
Kind = Literal[
    "unit", "scale", "bias", "drift", "stuck", "dead", "noise", "late", "held", "swapped",
    "inconsistent",
]  # fmt: skip


@dataclass(frozen=True)
class AuditEntry:
    """`samples` of `channel` were masked, repaired, filled or dropped for `reason`.

    `spans_s` holds the (start, end) times where that was done for seconds or longer;
    scattered single samples are only counted. Channel `*` means whole rows.
    """

    channel: str
    action: Action
    reason: str
    samples: int
    spans_s: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class Audit:
    """Everything that was changed between the file and the log, in order."""

    entries: tuple[AuditEntry, ...] = ()

    def add(self, *entries: AuditEntry) -> Audit:
        """Append the entries that touched at least one sample."""
        return Audit(self.entries + tuple(entry for entry in entries if entry.samples))

    def masked(self) -> dict[str, dict[str, int]]:
        """Masked samples: channel -> reason -> count."""
        counts: dict[str, dict[str, int]] = {}
        for entry in self.entries:
            if entry.action == "masked":
                reasons = counts.setdefault(entry.channel, {})
                reasons[entry.reason] = reasons.get(entry.reason, 0) + entry.samples
        return counts


@dataclass(frozen=True)
class Fault:
    """A sensor fault of `channel` of a log, from `from_s` to `to_s` in the log's time.

    `channels` are all that take part, such as two swapped ones. `confidence` is one minus the
    probability of the finding on a sound log. The kinds are defined in docs/evaluate.md.
    """

    log: str
    channel: str
    channels: tuple[str, ...]
    kind: Kind
    from_s: float
    to_s: float
    confidence: float
    detail: str

    def row(self) -> dict[str, Any]:
        """One entry of `faults` in JSON."""
        return {**asdict(self), "channels": list(self.channels)}

    @property
    def engine(self) -> str:
        """The engine of its log; empty for a log without engines."""
        return re.sub(r"#\d+$", "", self.log).rpartition(":")[2] if ":" in self.log else ""

    @property
    def caution(self) -> str:
        """One line for a reader."""
        when = f"{self.from_s:.6g} to {self.to_s:.6g} s"
        return f"{self.log}: {' and '.join(self.channels)} {self.kind}, {when}: {self.detail}"


@dataclass(frozen=True)
class Source:
    """Where a log came from; `sha256` is of the file's bytes."""

    file: str = ""
    sha256: str = ""
    engine: str = ""


@dataclass(frozen=True, eq=False, repr=False)
class Log:
    """Canonical channels `(time,)` on a uniform sampling grid; a masked or missing sample is NaN.

    `name` is `FILE:engine` (`FILE:engine#2` for the second part of a log split at a gap).
    `noise` is the variance of the white noise that was on each channel before it was smoothed.
    `interpolated` (channel -> bool `(time,)`) is True where the sample lies between two
    measurements of a channel slower than the grid; faster channels are not in it.
    `faults` are those that its channels show by themselves and against physics
    (`data_prep.plausibility`), `updates` (channel -> s) how often a channel changes.
    """

    name: str
    time_s: FloatArray
    channels: Mapping[str, FloatArray]
    audit: Audit = field(default_factory=Audit)
    source: Source = field(default_factory=Source)
    noise: Mapping[str, float] = field(default_factory=dict)
    interpolated: Mapping[str, BoolArray] = field(default_factory=dict)
    faults: tuple[Fault, ...] = ()
    updates: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        # The rounding of a sum depends on the memory layout, and a copy in another process is
        # contiguous: so is every log, for the same bits in any number of processes.
        packed = {name: np.ascontiguousarray(values) for name, values in self.channels.items()}
        object.__setattr__(self, "channels", packed)

    def __len__(self) -> int:
        return len(self.time_s)

    def __repr__(self) -> str:
        every = f" every {self.dt_s:.6g} s" if len(self) > 1 else ""
        return f"<Log {self.name}: {len(self)} samples{every} of {', '.join(self.channels)}>"

    def __getitem__(self, channel: str) -> FloatArray:
        if channel not in self.channels:
            raise DataError(
                "the log has no such channel",
                file=self.name,
                channel=channel,
                hint=f"It has {', '.join(self.channels)}",
            )
        return self.channels[channel]

    @property
    def dt_s(self) -> float:
        """Sampling interval in seconds, from the whole span so that rounding does not show."""
        return float(self.time_s[-1] - self.time_s[0]) / (len(self.time_s) - 1)

    @cached_property
    def identity(self) -> Identity:
        """What the samples of the log are recognised by, under any name."""
        return Identity.of(self.time_s, self.channels)

    def recorded(self, names: Sequence[str]) -> tuple[str, ...]:
        """Return those of `names` of which the log has a sample."""
        there = (name for name in names if name in self.channels)
        return tuple(name for name in there if np.isfinite(self[name]).any())

    def matrix(self, names: Sequence[str]) -> FloatArray:
        """Stack the named channels into `(time, channel)`."""
        return np.column_stack([self[name] for name in names])

    def with_channels(self, channels: Mapping[str, FloatArray], *entries: AuditEntry) -> Log:
        """Replace or add channels and record what that changed."""
        return replace(self, channels={**self.channels, **channels}, audit=self.audit.add(*entries))

    def part(self, start: int, stop: int) -> Log:
        """Rows `start:stop` as a log of the same name and audit."""
        rows = slice(start, stop)
        return replace(
            self,
            time_s=self.time_s[rows],
            channels={name: values[rows] for name, values in self.channels.items()},
            interpolated={name: flags[rows] for name, flags in self.interpolated.items()},
        )

    def measured(self, names: Sequence[str]) -> FloatArray:
        """As `matrix`, with NaN where a channel is `interpolated` instead of measured."""
        never = np.zeros(len(self), dtype=np.bool_)
        between = np.column_stack([self.interpolated.get(name, never) for name in names])
        return np.where(between, np.nan, self.matrix(names))
