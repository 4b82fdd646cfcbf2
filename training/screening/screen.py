"""Screen logs by the bank of `redundancy`: what is masked, and what is only reported.

**Masked** is a stretch of one channel with a beginning or an end inside the log. It is at fault if
its height is beyond the limit of sound logs (`training.screening.scatter`), while the rest of the
log is within the scatter of levels between logs. What two channels show at the same time is a state
of the engine and no fault, and so is what both engines of a file show, which share clock, air and
manoeuvre (`training.screening.redundancy.agreement` of r of one and of the difference). Levers are
commands, which an engine may not follow: nothing is concluded from them.

**Reported** is what the whole log disagrees in: its levels u and its delays are compared with their
scatter between logs (`training.screening.scatter.Scatter`). Another unit or an exchange is named
where it makes the log sound, and is more likely than an error of one channel. The longest part of a
recording stands for it. One stated rate of false alarms, `RATE_PER_H`, gives all thresholds.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from data_prep.log import Finding, Kind, Log
from data_prep.sources.units import conversions, to_canonical
from narxcal.channels import CHANNELS, symbol
from narxcal.support.arrays import BoolArray, FloatArray, spans
from training.screening.redundancy import (
    AIR,
    STRETCHES,
    Bank,
    Residuals,
    Signals,
    blocks_of,
    delays_of,
    is_measured,
    log_ratio,
    mate_of,
    minutes_of,
    moving_mean,
    noise_of,
    recording_of,
    residuals,
)
from training.screening.scatter import BLOCK_S, LEAST_STRETCH_S, Blocks, Step, strongest_step

RATE_PER_H = 0.01  # false alarms of each kind per hour of flight
_MOST_STRETCHES = 6
_BRIDGED_S, _FAR_BLOCKS = 60.0, 3  # so many blocks are no outliers
_TELLING = 3  # measured channels from which on it can be said which of them is wrong
_LEAST_TESTABLE = 0.1  # share of a log that has to be comparable for a finding about all of it


def screened(bank: Bank | None, logs: Sequence[Log]) -> list[Log]:
    """Return prepared logs with what the bank shows added to their findings."""
    if bank is None:
        return list(logs)
    subjects = [_subject(bank, log, logs) for log in logs]
    found = [() if one is None else _wrong_unit_or_swap(one) for one in subjects]
    if not any(found):  # exchanged channels have other lags
        found = _stretched(bank, logs)
    found = [
        more or (() if one is None else _examine(one))
        for more, one in zip(found, subjects, strict=True)
    ]
    return [
        replace(log, findings=(*log.findings, *more)) for log, more in zip(logs, found, strict=True)
    ]


@dataclass(frozen=True, eq=False)
class _Subject:
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

    @property
    def sensed(self) -> list[str]:
        """Channels that a sensor measures; a lever is commanded."""
        return [name for name in self.channels if is_measured(name)]

    @property
    def hours(self) -> float:
        """Length of the log."""
        return len(self.log) * self.log.dt_s / 3600.0

    @property
    def share(self) -> float:
        """Probability of a false alarm of one channel of one sound log of this length."""
        return min(RATE_PER_H * max(self.hours, 0.1), 0.05) / len(self.channels)

    @cached_property
    def limit(self) -> dict[str, float]:
        """Sizes beyond which levels are findings (Bonferroni over channels)."""
        return {name: self.bank.scatter[name].limit(self.share) for name in self.sensed}

    @cached_property
    def step_limits(self) -> dict[str, dict[int, float]]:
        """Heights of each octave beyond which steps within the log are findings."""
        return self.bank.step_limits(self.share)

    @cached_property
    def apart_limits(self) -> dict[str, dict[int, float]]:
        """Likewise, of steps that the other engine of the flight does not show."""
        return self.bank.step_limits(self.share, apart=self.mate is not None)

    def residuals(self) -> Residuals:
        """R without what the other engine of the flight shows, too."""
        return residuals(self.bank, self.signals, self.channels).apart_from(self.mate)

    def with_finding(self, found: Finding) -> _Subject:
        """Add a finding; its stretch is compared with nothing any more."""
        values = self.signals.values[found.channel]
        blank = np.where(found.rows(self.signals.time_s), np.nan, values)
        signals = self.signals.having({found.channel: blank}) if found.local else self.signals
        return replace(self, signals=signals, findings=(*self.findings, found))


def _subject(bank: Bank, log: Log, logs: Sequence[Log]) -> _Subject | None:
    """The log among `logs`; None of a log that is too short, or has fewer than two channels."""
    lost = {each.channel for each in log.findings if each.kind == "unit" and not each.local}
    channels = tuple(name for name in bank.channels if log.recorded([name]) and name not in lost)
    clean = log.without_faults()
    signals = Signals.of(clean)
    if len(channels) < 2 or len(signals.time_s) * signals.step_s < 2.0 * LEAST_STRETCH_S:
        return None
    mate, other = mate_of(log, logs), None
    if mate is not None:
        shared = tuple(name for name in channels if mate.recorded([name]))
        other = (
            residuals(bank, Signals.of(mate.without_faults()), shared) if len(shared) > 1 else None
        )
    parts = (len(one) for one in logs if recording_of(one) == recording_of(log))
    whole = len(log) >= max(parts, default=0)
    return _Subject(bank, clean, _without_air(log, signals), channels, other, whole)


def _without_air(log: Log, signals: Signals) -> Signals:
    """Blank air data of a wrong unit or that contradict each other: nothing is corrected by it."""
    wrong = {name for each in log.findings if not each.local for name in each.channels} & {*AIR}
    blank = {name: np.full(len(signals.time_s), np.nan) for name in wrong if name in signals.values}
    return signals.having(blank)


def _examine(subject: _Subject) -> tuple[Finding, ...]:
    """What the bank shows of one prepared log with its own clock, units and order of channels."""
    found = [*_slow_updates(subject), *_noisy(subject), *_late(subject)] if subject.whole else []
    # Of a channel with other dynamics all the log no stretch is at fault.
    whole = {each.channel for each in found if not each.local}
    suspects = [name for name in subject.sensed if name not in whole]
    for name in suspects:
        subject = _motionless(subject, name)
    for _ in range(_MOST_STRETCHES):
        before = len(subject.findings)
        subject = _stretch(subject, suspects)
        if len(subject.findings) == before:
            break
    stretches = {each.channel for each in subject.findings}
    found = [each for each in found if not (each.local and each.channel in stretches)]
    found = [*_alone(subject.findings), *found]
    if subject.whole and not any(each.kind in {"held", "late", "stuck"} for each in found):
        found += _level(subject)
    used = {*subject.bank.used, *AIR, "time_s"}
    return tuple(each for each in found if used & {*each.channels})


def _alone(findings: Sequence[Finding]) -> list[Finding]:
    """Those without another channel's at the same time: what two show is a state of the engine."""

    def overlap(a: Finding, b: Finding) -> bool:
        if not (a.local and b.local) or a.channel == b.channel:
            return False
        start_s = max(a.start_s or 0.0, b.start_s or 0.0)
        end_s = min(a.end_s or 0.0, b.end_s or 0.0)
        shorter = min((each.end_s or 0.0) - (each.start_s or 0.0) for each in (a, b))
        return end_s - start_s > 0.5 * shorter

    return [one for one in findings if not any(overlap(one, each) for each in findings)]


# ---------------------------------------------------------------- stretches


def _stretch(subject: _Subject, channels: Sequence[str]) -> _Subject:
    """Add the strongest stretch of one of `channels`, if it is at fault."""
    found = subject.residuals()
    best: tuple[float, str, Blocks, list[tuple[int, int]]] | None = None
    for name in channels:
        if len(found.errors[name]) < 2:
            continue  # of two channels neither can be said to be wrong
        blocks = blocks_of(found, name)
        step = strongest_step(blocks, subject.apart_limits[name])
        parts = _at_fault(subject, name, blocks, step)
        if parts and (best is None or step.excess > best[0]):
            best = step.excess, name, blocks, parts
    if best is None:
        return subject
    _, name, blocks, parts = best
    for start, stop in parts:
        subject = subject.with_finding(_described(subject, found, name, (blocks, start, stop)))
    return subject


def _at_fault(subject: _Subject, name: str, blocks: Blocks, step: Step) -> list[tuple[int, int]]:
    """Blocks at fault: the step, or all but it where that agrees; empty where nothing is."""
    if step.excess < 1.0:
        return []
    limit = subject.limit[name]
    inside = np.zeros(len(blocks.r), dtype=np.bool_)
    inside[step.start : step.stop] = True
    levels = [float(np.median(blocks.r[rows])) for rows in (inside, ~inside)]
    wrong = inside if abs(levels[0]) > abs(levels[1]) else ~inside
    right = levels[1] if abs(levels[0]) > abs(levels[1]) else levels[0]
    if abs(right) > limit:
        return []
    # A fault once proven, what is nearer to it than to the rest, or as far from that as no stretch
    # of a sound log is, is no longer used.
    wrong_level = levels[0] if abs(levels[0]) > abs(levels[1]) else levels[1]
    least = min(subject.apart_limits[name].values())
    far = (blocks.r - right) * np.sign(wrong_level) > min(0.5 * abs(wrong_level - right), least)
    for start, stop in spans(wrong):
        first, last = _extended(far, start, stop)
        wrong[first:last] = True
    return spans(wrong)


def _extended(far: BoolArray, start: int, stop: int) -> tuple[int, int]:
    """The span `start:stop` with what is far from the rest of the log next to it.

    Gaps of up to `_BRIDGED_S` are bridged: a sensor that fails before and after them is not
    believed within.
    """
    reach = round(_BRIDGED_S / BLOCK_S)
    while True:
        first = max(start - reach, 0)
        before, after = np.flatnonzero(far[first:start]), np.flatnonzero(far[stop : stop + reach])
        if len(before) < _FAR_BLOCKS and len(after) < _FAR_BLOCKS:
            return start, stop
        start = first + int(before[0]) if len(before) >= _FAR_BLOCKS else start
        stop = stop + int(after[-1]) + 1 if len(after) >= _FAR_BLOCKS else stop


def _described(
    subject: _Subject, found: Residuals, name: str, where: tuple[Blocks, int, int]
) -> Finding:
    """The stretch as a finding: its times, and what explains its error best.

    It reaches to the middles of the next blocks: less than half of a block whose median agrees can
    be wrong, and what cannot be compared in between is not believed.
    """
    blocks, start, stop = where
    time_s = blocks.time_s
    log_ends = float(subject.log.time_s[0]), float(subject.log.time_s[-1])
    first = log_ends[0] if start == 0 else float(time_s[start - 1])
    last = log_ends[1] if stop == len(time_s) else float(time_s[stop])
    inside = (found.signals.time_s >= first) & (found.signals.time_s <= last)
    kind, size, unit = _kind(found, name, inside)
    text = f"{size:+.3g} {unit} against what {_listed(subject.channels, name)} say"
    level = float(np.median(np.abs(blocks.r[start:stop])))
    probability = _probability(subject, name, level)
    probability = max(probability, 1.0 - RATE_PER_H * max(subject.hours, 0.1))
    return Finding(
        kind, name, first, last, size, unit, probability, text,
        log=subject.log.name, origin_s=log_ends[0],
    )  # fmt: skip


def _probability(subject: _Subject, name: str, level: float) -> float:
    """One minus the probability of such a level of any channel on a sound log."""
    alarms = len(subject.channels) * subject.bank.scatter[name].tail(level)
    return float(np.clip(1.0 - alarms, 0.0, 0.9999))


def _kind(found: Residuals, name: str, inside: BoolArray) -> tuple[Kind, float, str]:
    """How a channel is wrong in some rows, by the shape that leaves least: kind, size, unit.

    A scale and a drift by 95 %: what is constant is taken for constant.
    """
    expected = found.corrected.raw(name, found.expected[name])
    error = found.agreed[name] * found.scale(name) * found.corrected.scale[name]
    rows = inside & np.isfinite(error) & np.isfinite(expected)
    y, base = error[rows], expected[rows]
    if len(y) < 3:
        return "bias", 0.0, CHANNELS[name].unit
    ramp = np.linspace(0.0, 1.0, len(y))
    shapes: dict[Kind, tuple[FloatArray, float]] = {
        "bias": (np.ones(len(y)), 1.0),
        "scale": (base, 1.0),
        "drift": (ramp, 0.9),
    }
    left, sizes = {}, {}
    for kind, (shape, price) in shapes.items():
        square = float(shape @ shape)
        sizes[kind] = float(shape @ y) / square if square > 0.0 else 0.0
        left[kind] = float(np.sum(np.abs(y - sizes[kind] * shape))) / price
    best = min(left, key=lambda each: left[each])
    if best == "scale":
        return best, 100.0 * sizes[best], "%"
    return best, sizes[best], CHANNELS[name].unit


def _listed(channels: Sequence[str], but: str) -> str:
    return " and ".join(symbol(name) for name in channels if name != but)


# ---------------------------------------------------------------- motionless

_STILL = 0.2  # of the motion that the other channels show
_STILL_S, _LEAST_STILL_S = 60.0, 30.0


def _motionless(subject: _Subject, name: str) -> _Subject:
    """A channel that shows noise, or nothing, while the others agree that it moves.

    A channel that is set in steps, as benches and simulators set it, may stay.
    """
    if len(subject.sensed) < _TELLING or _in_steps(subject.log[name]):
        return subject
    found = residuals(subject.bank, subject.signals, subject.channels)
    size = round(_STILL_S / found.signals.step_s)
    y = subject.signals.values[name]
    own, implied = _moving_spread(y, size), _implied(found, name, size)
    # Half of the steps that sound logs show: a motion to both sides has that standard deviation.
    limits = subject.step_limits[name]
    scatter = 0.5 * limits.get(1, limits.get(0, np.inf)) * abs(subject.bank.centre[name])
    least = np.maximum(scatter * found.corrected.scale[name], 3.0 * _resolution(y))
    if subject.mate is not None and name in subject.mate.channels:
        # The other engine moves, too, while this one's channel stays.
        other = _moving_spread(subject.mate.signals.values[name], size)
        implied = np.minimum(implied, other)
    quiet = (own < _STILL * implied) & (implied > least)
    for start, stop in _followed(y, own, quiet, size // 2):
        seconds = (stop - start) * found.signals.step_s
        if seconds >= _LEAST_STILL_S:
            time_s, half = found.signals.time_s, 0.5 * found.signals.step_s
            first = max(float(time_s[start]) - half, float(subject.log.time_s[0]))
            last = min(float(time_s[stop - 1]) + half, float(subject.log.time_s[-1]))
            level = float(np.nanmedian(y[start:stop]))
            text = f"stays at {level:.4g} while {_listed(subject.channels, name)} move"
            one = Finding(
                "stuck", name, first, last, level, CHANNELS[name].unit,
                evidence=text, log=subject.log.name, origin_s=float(subject.log.time_s[0]),
            )  # fmt: skip
            if stop - start > _MOSTLY * len(y):
                one = replace(one, start_s=None, end_s=None)
            subject = subject.with_finding(one)
    return subject


_MOSTLY = 0.98


def _in_steps(values: FloatArray) -> bool:
    """Whether most samples repeat the one before, also outside of the longest such stretch."""
    still = np.diff(values[np.isfinite(values)]) == 0.0
    longest = max((stop - start for start, stop in spans(still)), default=0)
    return bool(2 * (int(still.sum()) - longest) > len(still) - longest)


def _resolution(values: FloatArray) -> float:
    """Step of a quantised channel: the smallest of its usual changes."""
    steps = np.abs(np.diff(values))
    steps = steps[np.isfinite(steps) & (steps > 0.0)]
    return float(np.percentile(steps, 10)) if len(steps) else 0.0


def _followed(y: FloatArray, own: FloatArray, quiet: BoolArray, half: int) -> list[tuple[int, int]]:
    """Stretches around quiet windows, for as long as the channel keeps its level."""
    still = np.zeros(len(y), dtype=np.bool_)
    for start, stop in spans(quiet):
        first, last = max(start - half, 0), min(stop + half, len(y))
        level, width = np.nanmedian(y[first:last]), 4.0 * float(np.nanmax(own[start:stop]))
        same = np.abs(moving_mean(y, 5) - level) <= max(width, 1e-9)
        first, last = start, stop
        while first > 0 and same[first - 1]:
            first -= 1
        while last < len(y) and same[last]:
            last += 1
        still[first:last] = True
    return spans(still)


def _implied(found: Residuals, name: str, size: int) -> FloatArray:
    """Standard deviation in a window (time,) that half of the other channels ask for, or more."""
    scale = found.scale(name)
    parts = [
        _moving_spread(found.corrected.raw(name, found.corrected.x[name] - each * scale), size)
        for each in found.errors[name].values()
    ]
    ordered = np.sort(np.nan_to_num(np.stack(parts)), axis=0)
    return np.asarray(ordered[(len(parts) - 1) // 2])


def _moving_spread(values: FloatArray, size: int) -> FloatArray:
    """Standard deviation in a centred window."""
    centred = values - (np.nanmean(values) if np.isfinite(values).any() else 0.0)
    square = moving_mean(centred**2, size) - moving_mean(centred, size) ** 2
    return np.sqrt(np.maximum(square, 0.0))


# ---------------------------------------------------------------- the whole log

_SELDOM, _LEAST_UPDATE_S = 3.0, 0.5
_TENTH = 0.1 * 0.05  # of the largest value: Ti is read at a tenth of responses of 5 % and more


def _whole(log: Log, kind: Kind, name: str, text: str, size: tuple[float, str]) -> Finding:
    """A finding about all of a log; `size` with its unit."""
    return Finding(kind, name, size=size[0], unit=size[1], evidence=text, log=log.name)


def _slow_updates(subject: _Subject) -> Iterator[Finding]:
    """Channels that change much more seldom than in the training logs."""
    for name in subject.sensed:
        every_s = subject.log.updates.get(name, 0.0)
        usual_s = subject.bank.updates.get(name, 0.0)
        if every_s > max(_LEAST_UPDATE_S, _SELDOM * usual_s, _SELDOM * subject.log.dt_s):
            text = f"changes every {every_s:.2g} s only, every {usual_s:.2g} s in the training logs"
            yield _whole(subject.log, "held", name, text, (every_s, "s"))


def _coarse(subject: _Subject, name: str) -> Finding | None:
    """Coarser steps than those of the training logs, by which no Ti can be read."""
    step, usual = (each.rounding.get(name, 0.0) for each in (subject.log, subject.bank))
    tenth = _TENTH * float(np.nanmax(np.abs(subject.log[name]), initial=0.0))
    if not step > max(tenth, _SELDOM * usual):
        return None
    unit = CHANNELS[name].unit
    text = f"moves in steps of {step:.3g} {unit}, of {usual:.3g} in the training logs; Ti of a "
    text += f"small response is read at {tenth:.2g}"
    return _whole(subject.log, "noise", name, text, (step, unit))


def _noisy(subject: _Subject) -> Iterator[Finding]:
    """Coarse channels; minutes of others with more noise than sound logs, and their scatter."""
    limits, time_s = subject.bank.noise_limits(subject.share), subject.log.time_s
    for name in subject.sensed:
        if coarse := _coarse(subject, name):
            yield coarse
            continue
        matters = 0.5 * subject.bank.usual[name] * abs(subject.bank.centre[name])
        own, limit = noise_of(subject.log, name), max(limits.get(name, np.inf), matters)
        for start, stop in spans(own > limit):
            size, unit = float(np.median(own[start:stop])), CHANNELS[name].unit
            text = f"noise of {size:.2g} {unit}, sound logs have less than {limit:.2g}"
            found = _whole(subject.log, "noise", name, text, (size, unit))
            if stop - start < len(own):
                rows = minutes_of(subject.log)[[start, stop]] - [0, 1]
                start_s, end_s = map(float, time_s[rows])
                found = replace(found, start_s=start_s, end_s=end_s, origin_s=float(time_s[0]))
            yield found


_LEAST_DELAY_S = 0.4


def _late(subject: _Subject) -> Iterator[Finding]:
    """The channel that is later against all others than in the training logs."""
    bank, found = subject.bank, delays_of(subject.log, subject.channels)
    late = {}
    for name in subject.channels:
        delay_s = bank.lateness(found, name)
        limit = bank.late_scatter[name].limit(subject.share)
        if abs(delay_s) > max(_LEAST_DELAY_S, limit):
            late[name] = delay_s
    if late:
        name = max(late, key=lambda each: abs(late[each]))
        word = "late" if late[name] > 0.0 else "early"
        text = f"{abs(late[name]):.2g} s {word} against {_listed(subject.channels, name)}"
        yield _whole(subject.log, "late", name, text, (late[name], "s"))


def _stretched(bank: Bank, logs: Sequence[Log]) -> list[tuple[Finding, ...]]:
    """Stretched time stamps of each log: of all engines of a file or of none.

    r(k) is the ratio of the dynamic residual, were the stamps stretched by k, to that as they are
    (`training.screening.redundancy.log_ratio`). Of a sound log it is that of the training logs, of
    one that is stretched by k it is 1 / r(1/k) of these.
    """
    found: list[tuple[Finding, ...]] = [() for _ in logs]
    for own in files_of(logs):
        subjects = [one for k in own if (one := _subject(bank, logs[k], ())) is not None]
        if not subjects or min(len(one.sensed) for one in subjects) < _TELLING:
            continue
        hours = max(one.hours for one in subjects)
        shown = [residuals(bank, one.signals, one.channels) for one in subjects]
        for stretch in STRETCHES:
            ratios = [log_ratio(each, stretch) for each in shown]
            known = [each for each in ratios if np.isfinite(each)]
            if not known:
                continue
            ratio = float(np.mean(known))
            usual, scatter = bank.stretch[str(stretch)]
            other = -bank.stretch[str(1.0 / stretch)][0]
            odds = ((ratio - usual) ** 2 - (ratio - other) ** 2) / (2.0 * scatter**2)
            if ratio < 0.0 and odds > -np.log(RATE_PER_H * max(hours, 0.1)):
                word = "long" if stretch > 1.0 else "short"
                times = max(stretch, 1.0 / stretch)
                text = f"all responses are {times:g} times as {word} as in the training logs"
                for k in own:
                    found[k] = (_whole(logs[k], "stretched", "time_s", text, (stretch, "")),)
                break
    return found


def files_of(logs: Sequence[Log]) -> list[list[int]]:
    """Numbers of the logs of each file."""
    names = [log.source.file or log.name for log in logs]
    return [[k for k, each in enumerate(names) if each == name] for name in dict.fromkeys(names)]


@dataclass(frozen=True)
class _Other:
    """What a log may be instead: some channels with other values."""

    kind: Kind
    channel: str
    text: str
    values: Mapping[str, FloatArray]
    partner: str = ""
    size: float = float("nan")


_FAULT = 0.2  # standard deviation of the share by which faults scale or shift a channel


def _wrong_unit_or_swap(subject: _Subject) -> tuple[Finding, ...]:
    """Another unit or an exchange that makes a log sound, and more so than an error of one channel.

    Where channels cannot be compared they may be beyond what training logs show. Air data are not
    accused: engines share them, and what physics allows no statistic of one engine refutes.
    """
    if not subject.whole:
        return ()
    before = _fit(subject, subject.signals)
    comparable = len(before.levels) == len(subject.sensed)
    if before.sound and comparable:
        return ()
    best: tuple[float, _Other | None] = _scaled(subject, before), None
    for each in _others(subject):
        after = _fit(subject, subject.signals.having(each.values))
        least = len(before.levels) if comparable else len(subject.sensed)
        gain = _log_likelihood(subject, after.levels)
        if after.sound and len(after.levels) >= least and gain > best[0]:
            best = gain, each
    one = best[1]
    if one is None:
        return ()
    found = _whole(subject.log, one.kind, one.channel, one.text, (one.size, ""))
    return (replace(found, partner=one.partner),)


def _scaled(subject: _Subject, fit: _Fit) -> float:
    """Log likelihood of the levels, were one channel at fault by any size; of a part of them none.

    Nothing is left to say so where not all are comparable.
    """
    if len(fit.levels) < len(subject.sensed):
        return -np.inf
    found = []
    for name, level in fit.levels.items():
        others = {each: x for each, x in fit.levels.items() if each != name}
        own = -0.5 * (level / _FAULT) ** 2 - float(np.log(_FAULT * np.sqrt(2.0 * np.pi)))
        found.append(_log_likelihood(subject, others) + own)
    return max(found)


@dataclass(frozen=True)
class _Fit:
    """How channels agree: levels of those of which enough can be compared, and whether all do."""

    levels: Mapping[str, float]
    sound: bool


def _fit(subject: _Subject, signals: Signals) -> _Fit:
    """No level and no stretch of a sound log is beyond its limit."""
    found, levels, sound = residuals(subject.bank, signals, subject.channels), {}, True
    for name in subject.sensed:
        if np.mean(np.isfinite(found.agreed[name])) > _LEAST_TESTABLE:
            levels[name] = found.level(name)
            step = strongest_step(blocks_of(found, name), subject.step_limits[name])
            sound &= abs(levels[name]) <= subject.limit[name] and step.excess < 1.0
    return _Fit(levels, sound)


def _log_likelihood(subject: _Subject, levels: Mapping[str, float]) -> float:
    return sum(subject.bank.scatter[name].log_density(level) for name, level in levels.items())


def _others(subject: _Subject) -> Iterator[_Other]:
    values = subject.signals.values
    for a, b in combinations(subject.sensed, 2):
        if CHANNELS[a].unit == CHANNELS[b].unit:
            text = f"{symbol(a)} and {symbol(b)} fit the training logs when exchanged"
            yield _Other("exchanged", a, text, {a: values[b], b: values[a]}, b)
    for name in subject.sensed:
        for words, unit in conversions(name).items() if subject.log.recorded([name]) else ():
            text = f"looks like {words}: median {np.nanmedian(subject.log[name]):.4g}"
            other = {name: to_canonical(values[name], unit)}
            yield _Other("unit", name, text, other, size=1.0 / unit.scale)


def _level(subject: _Subject) -> list[Finding]:
    """The channel whose level is furthest beyond the scatter."""
    if len(subject.sensed) < _TELLING:
        return []
    levels = _fit(subject, subject.signals).levels
    beyond = [name for name, level in levels.items() if abs(level) > subject.limit[name]]
    if not beyond:
        return []
    worst = min(beyond, key=lambda each: subject.bank.scatter[each].tail(levels[each]))
    probability = _probability(subject, worst, levels[worst])
    shown = residuals(subject.bank, subject.signals, subject.channels)
    everywhere = np.ones(len(shown.signals.time_s), dtype=np.bool_)
    kind, size, unit = _kind(shown, worst, everywhere)
    text = f"{size:+.3g} {unit} against what {_listed(subject.channels, worst)} say"
    found = _whole(subject.log, kind, worst, text, (size, unit))
    return [replace(found, probability=probability)]
