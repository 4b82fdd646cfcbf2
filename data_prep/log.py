"""A log: one recording of one engine on a uniform sampling grid, with its audit."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
import pandas as pd

from data_prep.cleaning.identity import Identity
from narxcal.channels import Channel, described
from narxcal.support.arrays import BoolArray, FloatArray
from narxcal.support.errors import DataError
from narxcal.support.moments import moment

CODE_WORD = "code word"  # begins the reason of such a sample in an audit
LONG_SPAN_S = 1.0  # an audit lists spans of this length, and only counts shorter ones
Action = Literal["masked", "repaired", "filled", "dropped"]
Kind = Literal[
    "unit", "scale", "bias", "drift", "stuck", "noise", "late", "held", "exchanged", "stretched",
    "inconsistent",
]  # fmt: skip
MASK = 0.95  # least probability of what is masked
SURE = 0.999  # of a finding that physics contradicts
# What would prove a finding about a whole log.
_REMEDIES: Mapping[Kind, str] = {
    "unit": "Check the recorder's unit and set it under [logs.columns]",
    "scale": "Compare with another sensor, or with a ground run of a trimmed engine",
    "bias": "Compare with another sensor, or with a ground run of a trimmed engine",
    "late": "Check the recorder's time stamps of this channel",
    "held": "Check at which rate the recorder samples this channel",
    "noise": "Check the sensor's wiring and the recorder's filter",
    "exchanged": "Check which column is which",
    "stretched": "Check the unit of the time stamps, and the rate of the recorder",
    "inconsistent": "Check both channels' columns and units",
}


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
class Finding:
    """What a log shows to be wrong with one channel.

    With times (`start_s`, `end_s`) it is a stretch that begins or ends inside the log, while the
    rest of the log agrees with the other channels: it is masked. Without, the whole log disagrees
    with the training logs, as another day, another engine, a wrong model or a wrong unit would
    make it: it is reported with what would prove it, and nothing is masked.

    `size` is in `unit`: of a unit the factor, of a delay seconds; NaN where the kind has none.
    `probability` is one minus that of such a finding on a sound log. `partner` is the other
    channel of an exchange or contradiction, `time_s` stands for the clock. `log` is its log's name,
    `origin_s` when that began; all times are seconds on its own clock.
    """

    kind: Kind
    channel: str
    start_s: float | None = None
    end_s: float | None = None
    size: float = float("nan")
    unit: str = ""
    probability: float = SURE
    evidence: str = ""
    partner: str = ""
    log: str = ""
    origin_s: float = 0.0

    @property
    def remedy(self) -> str:
        """What would prove it; empty for a stretch of the log."""
        return "" if self.local else _REMEDIES.get(self.kind, "")

    @property
    def channels(self) -> tuple[str, ...]:
        return (self.channel, self.partner) if self.partner else (self.channel,)

    @property
    def local(self) -> bool:
        """Whether it is a stretch of the log, not all of it."""
        return self.start_s is not None

    @property
    def masks(self) -> bool:
        return self.local and self.probability >= MASK

    @property
    def engine(self) -> str:
        """The engine of its log; empty for a log without engines."""
        return re.sub(r"#\d+$", "", self.log).rpartition(":")[2] if ":" in self.log else ""

    def rows(self, time_s: FloatArray) -> BoolArray:
        """Samples (time,) that it is about: all without times."""
        if self.start_s is None or self.end_s is None:
            return np.ones(len(time_s), dtype=np.bool_)
        return (time_s >= self.start_s) & (time_s <= self.end_s)

    def row(self) -> dict[str, Any]:
        size = None if np.isnan(self.size) else self.size
        return {**asdict(self), "size": size, "remedy": self.remedy}

    @classmethod
    def from_row(cls, row: Mapping[str, Any]) -> Finding:
        known = {name: value for name, value in row.items() if name != "remedy"}
        return cls(**{**known, "size": np.nan if row["size"] is None else row["size"]})

    @property
    def caution(self) -> str:
        """One line for a reader."""
        names = " and ".join(self.channels)
        text = f"{self.log}: {names} {self.kind}, {self.when or 'the whole log'}: {self.evidence}"
        return f"{text}. {self.remedy}" if self.remedy else text

    @property
    def when(self) -> str:
        """From when to when, for people; empty for the whole log."""
        if self.start_s is None:
            return ""
        return moment(self.start_s, self.origin_s, self.end_s)


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
    `declared` are channels of the configuration, beyond the table of `narxcal.channels`.
    `findings` are those of `data_prep.cleaning.plausibility` and `training.screening.screen`,
    `updates` (channel -> s) how often a channel changes, `rounding` the steps of its values.
    """

    name: str
    time_s: FloatArray
    channels: Mapping[str, FloatArray]
    audit: Audit = field(default_factory=Audit)
    source: Source = field(default_factory=Source)
    noise: Mapping[str, float] = field(default_factory=dict)
    interpolated: Mapping[str, BoolArray] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    updates: Mapping[str, float] = field(default_factory=dict)
    rounding: Mapping[str, float] = field(default_factory=dict)
    declared: Mapping[str, Channel] = field(default_factory=dict)

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

    def to_frame(self) -> pd.DataFrame:
        """Return the channels as columns, in their canonical units, over the index `time_s` [s]."""
        return pd.DataFrame(dict(self.channels), index=pd.Index(self.time_s, name="time_s"))

    @property
    def dt_s(self) -> float:
        """Sampling interval in seconds, from the whole span so that rounding does not show."""
        return float(self.time_s[-1] - self.time_s[0]) / (len(self.time_s) - 1)

    def moment(self, time_s: float, until_s: float | None = None, *, decimals: int = 1) -> str:
        """A time of the log, or a stretch of time, for people."""
        return moment(time_s, float(self.time_s[0]), until_s, decimals=decimals)

    @cached_property
    def identity(self) -> Identity:
        """What the samples of the log are recognised by, under any name."""
        return Identity.of(self.time_s, self.channels)

    def channel(self, name: str) -> Channel:
        """Unit, role, physical range and meaning of a channel."""
        return self.declared.get(name) or described(name)

    def finding(
        self,
        kind: Kind,
        channel: str,
        evidence: str,
        span_s: tuple[float, float] | None = None,
        **more: Any,
    ) -> Finding:
        """Say what is wrong with a channel in a stretch of the log, or in all of it."""
        start_s, end_s = span_s or (None, None)
        began_s = float(self.time_s[0]) if span_s else 0.0
        return Finding(
            kind, channel, start_s, end_s,
            evidence=evidence, log=self.name, origin_s=began_s, **more,
        )  # fmt: skip

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

    def without_faults(self) -> Log:
        """The log with the stretches that its findings mask as NaN, each counted in the audit."""
        changed: dict[str, FloatArray] = {}
        entries = []
        for each in self.findings:
            if not each.masks or each.channel not in self.channels:
                continue
            values = changed.get(each.channel, self.channels[each.channel]).copy()
            inside = each.rows(self.time_s) & np.isfinite(values)
            if inside.any():
                values[inside] = np.nan
                changed[each.channel] = values
                count = int(inside.sum())
                entries.append(AuditEntry(each.channel, "masked", f"fault: {each.kind}", count))
        return self.with_channels(changed, *entries) if changed else self
