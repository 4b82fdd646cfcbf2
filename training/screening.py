"""Screen logs by the bank of `training.redundancy`: what is masked, and what is only reported.

**Masked** is a stretch of one channel with a beginning or an end inside the log. With the wander w
of a sound log as a first-order process (`training.redundancy`), a step of height h from block a to
block b raises the log likelihood of r by G / 2,

    G = (s' z)^2 / (s' s),   z = whitened r,   s = whitened step: 1 at a, 1 - phi inside, -phi at b

It is at fault if G and h are beyond what sound logs show (`LEAST_GAIN`, `threshold`), and if r is
within the scatter of sound logs outside of it. A second engine of the file shares clock, air and
manoeuvre: what r of both shows is no fault of one (`training.redundancy.agreement` of r and of the
difference). Levers are commands, which an engine may not follow: nothing is
concluded from them.

**Reported** is what the whole log disagrees in: its level u is compared with the scatter of levels
s, which is known from few logs: Student's t. One stated rate of false alarms, `RATE_PER_H`, gives
all thresholds.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.stats import t as student

from data_prep.log import AuditEntry, Finding, Kind, Log
from data_prep.plausibility import conversions, finding, sound_air
from narxcal.channels import CHANNELS, symbol
from narxcal.support.arrays import BoolArray, FloatArray, spans
from training.levels import PRIOR_LOGS
from training.redundancy import (
    AIR,
    BLOCK_S,
    MOST_FOLDS,
    STRETCHES,
    Bank,
    Blocks,
    Pool,
    Residuals,
    Signals,
    Wander,
    agreement,
    delays_of,
    is_measured,
    log_ratio,
    moving_mean,
    noise_of,
    own_wander,
    residuals,
)

RATE_PER_H = 0.01  # false alarms of each kind per hour of flight
LEAST_GAIN = 300.0
_LEAST_STRETCH_S = 20.0
_AGREES = 3.0  # scatters within which the rest of a log agrees
_MOST_STRETCHES = 6
_BRIDGED_S, _FAR_BLOCKS = 60.0, 3  # so many blocks are no outliers
_REASON = "fault: "
_TELLING = 3  # measured channels from which on it can be said which of them is wrong
_LEAST_TESTABLE = 0.1  # share of a log that has to be comparable for a finding about all of it


def threshold(bank: Bank, hours: float, channels: int) -> float:
    """Scatters beyond which a level of any of `channels` is seen once in 1 / `RATE_PER_H`.

    The scatter itself is known from the bank's logs and the prior ones (Bonferroni over channels).
    """
    share = min(RATE_PER_H * max(hours, 0.1), 0.05) / max(channels, 1)
    return float(student.isf(0.5 * share, _dof(bank)))


def _dof(bank: Bank) -> float:
    """Degrees of freedom of the scatter between logs."""
    return PRIOR_LOGS + max(bank.logs - 1, 1)


def screened(bank: Bank | None, logs: Sequence[Log]) -> list[Log]:
    """Return prepared logs with what the bank shows added to their findings."""
    if bank is None:
        return list(logs)
    found = []
    for log, clock in zip(logs, _stretched(bank, logs), strict=True):
        mates = [one for one in logs if _of_one_flight(log, one)]
        # With another clock every channel looks late, and lags are wrong.
        more = clock or _examine(bank, log, mates[0] if mates else None)
        found.append(replace(log, findings=(*log.findings, *more)))
    return found


def masked(log: Log) -> Log:
    """Return the log with the stretches that its findings mask as NaN, and that counted."""
    changed: dict[str, FloatArray] = {}
    entries = []
    for each in log.findings:
        if not each.masks or each.channel not in log.channels:
            continue
        values = changed.get(each.channel, log.channels[each.channel]).copy()
        inside = each.rows(log.time_s) & np.isfinite(values)
        if inside.any():
            values[inside] = np.nan
            changed[each.channel] = values
            count = int(inside.sum())
            entries.append(AuditEntry(each.channel, "masked", f"{_REASON}{each.kind}", count))
    return log.with_channels(changed, *entries) if changed else log


def by_each_other(logs: Sequence[Log], channels: Sequence[str]) -> list[Log]:
    """Return prepared training logs with the findings that the other recordings show.

    `channels` are those of the model. A recording is a file, of many a group is left out at a time;
    a single one is compared with itself, of which a stretch is not most. What the first pass masks
    is not learned from in the second.
    """
    found, groups = list(logs), _groups(_files(logs))
    for _ in range(2):
        known = [masked(log) for log in found]
        after, pool = list(found), Pool.of(known)
        for own in groups:
            bank = pool.bank(channels, own if len(groups) > 1 else ())
            for k, log in zip(own, screened(bank, [logs[k] for k in own]), strict=True):
                after[k] = log
        done = [_spans(a) == _spans(b) for a, b in zip(after, found, strict=True)]
        found = after
        if all(done):
            break
    return found


def _groups(files: Sequence[list[int]]) -> list[list[int]]:
    """Files that are left out together, at most `MOST_FOLDS` groups of them."""
    count = min(MOST_FOLDS, len(files))
    return [[k for own in files[first::count] for k in own] for first in range(count)]


def _spans(log: Log) -> set[tuple[str, float | None]]:
    return {(each.channel, each.start_s) for each in log.findings if each.masks}


def _of_one_flight(a: Log, b: Log) -> bool:
    """Whether two logs are those of two engines at the same times."""
    apart = a.source.engine != b.source.engine and a.source.file == b.source.file
    return apart and len(a) == len(b) and bool(a.time_s[0] == b.time_s[0])


@dataclass(frozen=True, eq=False)
class _Subject:
    """The log under examination; `signals` without what is masked so far."""

    bank: Bank
    log: Log
    signals: Signals
    channels: tuple[str, ...]
    mate: Residuals | None
    findings: tuple[Finding, ...] = ()

    @property
    def hours(self) -> float:
        """Length of the log."""
        return len(self.log) * self.log.dt_s / 3600.0

    @property
    def threshold(self) -> float:
        """Of levels, in scatters."""
        return threshold(self.bank, self.hours, len(self.channels))

    def residuals(self) -> Residuals:
        """R without what the other engine of the flight shows, too."""
        found = residuals(self.bank, self.signals, self.channels)
        if self.mate is None:
            return found
        common = {
            name: agreement([each, each - self.mate.agreed[name]])
            if name in self.mate.agreed
            else each
            for name, each in found.agreed.items()
        }
        return replace(found, agreed=common)

    def with_finding(self, found: Finding) -> _Subject:
        """Add a finding; its stretch is compared with nothing any more."""
        values = self.signals.values[found.channel]
        blank = np.where(found.rows(self.signals.time_s), np.nan, values)
        signals = self.signals.having({found.channel: blank}) if found.local else self.signals
        return replace(self, signals=signals, findings=(*self.findings, found))


def _subject(bank: Bank, log: Log, mate: Log | None) -> _Subject | None:
    lost = {each.channel for each in log.findings if each.kind == "unit" and not each.local}
    channels = tuple(name for name in bank.channels if log.recorded([name]) and name not in lost)
    clean = masked(log)
    signals = Signals.of(clean)
    if len(channels) < 2 or len(signals.time_s) * signals.step_s < 2.0 * _LEAST_STRETCH_S:
        return None
    other = None
    if mate is not None:
        shared = tuple(name for name in channels if mate.recorded([name]))
        other = residuals(bank, Signals.of(masked(mate)), shared) if len(shared) > 1 else None
    return _Subject(bank, clean, _without_air(log, signals), channels, other)


def _without_air(log: Log, signals: Signals) -> Signals:
    """Blank air data of a wrong unit or that contradict each other: nothing is corrected by it."""
    wrong = {name for each in log.findings if not each.local for name in each.channels} & {*AIR}
    blank = {name: np.full(len(signals.time_s), np.nan) for name in wrong if name in signals.values}
    return signals.having(blank)


def _examine(bank: Bank, log: Log, mate: Log | None) -> tuple[Finding, ...]:
    """What the bank shows of one prepared log."""
    subject = _subject(bank, log, mate)
    if subject is None:
        return ()
    other = _restored(subject)
    if other:
        return other
    for name in _sensed(subject):
        subject = _motionless(subject, name)
    for _ in range(_MOST_STRETCHES):
        before = len(subject.findings)
        subject = _stretch(subject)
        if len(subject.findings) == before:
            break
    found = [*subject.findings, *_seldom(subject), *_noisy(subject), *_late(subject)]
    if not any(each.kind in {"held", "late", "stuck"} for each in found):
        found += _level(subject)
    used = {*bank.used, *AIR, "time_s"}
    return tuple(each for each in found if used & {*each.channels})


def _sensed(subject: _Subject) -> list[str]:
    """Channels that a sensor measures; a lever is commanded."""
    return [name for name in subject.channels if is_measured(name)]


# ---------------------------------------------------------------- stretches


@dataclass(frozen=True)
class Step:
    """A step of height h in blocks `start:stop`; it raises the log likelihood by `gain` / 2."""

    gain: float
    start: int
    stop: int
    height: float


def strongest_step(blocks: Blocks, wander: Wander) -> Step:
    """The step that raises the likelihood of r most; a log is compared with its own wander, too."""
    count, least = len(blocks.r), round(_LEAST_STRETCH_S / BLOCK_S)
    if count < 2 * least:
        return Step(0.0, 0, 0, 0.0)
    z, phi, variance = _whitened(blocks, wander)
    weight = 1.0 / variance
    score = np.concatenate([[0.0], np.cumsum((1.0 - phi) * z * weight)])
    norm = np.concatenate([[0.0], np.cumsum((1.0 - phi) ** 2 * weight)])
    begin = z * weight - score[1:], weight - norm[1:]
    end = (
        np.append(score[:-1] - phi * z * weight, score[-1]),
        np.append(norm[:-1] + phi**2 * weight, norm[-1]),
    )
    product, square = (a[:, None] + b[None, :] for a, b in zip(begin, end, strict=True))
    length = np.arange(count + 1)[None, :] - np.arange(count)[:, None]
    allowed = (length >= least) & (length <= count - least)
    gain = np.where(allowed, product**2 / np.where(allowed, square, 1.0), 0.0)
    start, stop = np.unravel_index(int(np.argmax(gain)), gain.shape)
    if not gain[start, stop] > 0.0:
        return Step(0.0, 0, 0, 0.0)
    height = float(product[start, stop] / square[start, stop])
    return Step(float(gain[start, stop]), int(start), int(stop), height)


def _whitened(blocks: Blocks, wander: Wander) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Innovations of r, the share phi that stays since the block before, and their variance."""
    r = blocks.r - np.median(blocks.r)
    apart = np.clip(np.round(np.diff(blocks.time_s) / BLOCK_S), 1.0, 1e4)
    phi = np.concatenate([[0.0], wander.stays**apart])
    z = r - phi * np.concatenate([[0.0], r[:-1]])
    own = own_wander(z[1:], blocks.moved[1:], wander.stays)
    larger = Wander(wander.stays, max(wander.rest, own.rest), max(wander.motion, own.motion))
    stationary = max(1.0 - wander.stays**2, 1e-9)
    return z, phi, larger.variance(blocks.moved) * (1.0 - phi**2) / stationary


def _stretch(subject: _Subject) -> _Subject:
    """Add the strongest stretch of one channel, if it is at fault."""
    found = subject.residuals()
    best: tuple[float, str, Blocks, list[tuple[int, int]]] | None = None
    for name in _sensed(subject):
        if len(found.errors[name]) < 2:
            continue  # of two channels neither can be said to be wrong
        blocks = Blocks.of(found, name)
        step = strongest_step(blocks, Wander(*subject.bank.wander[name]))
        parts = _at_fault(subject, name, blocks, step)
        if parts and (best is None or step.gain > best[0]):
            best = step.gain, name, blocks, parts
    if best is None:
        return subject
    _, name, blocks, parts = best
    for start, stop in parts:
        subject = subject.with_finding(_described(subject, found, name, (blocks, start, stop)))
    return subject


def _at_fault(subject: _Subject, name: str, blocks: Blocks, step: Step) -> list[tuple[int, int]]:
    """Blocks at fault: the step, or all but it where that agrees; empty where nothing is."""
    if step.gain < LEAST_GAIN:
        return []
    scatter = subject.bank.level[name]
    inside = np.zeros(len(blocks.r), dtype=np.bool_)
    inside[step.start : step.stop] = True
    levels = [float(np.median(blocks.r[rows])) / scatter for rows in (inside, ~inside)]
    if abs(levels[0] - levels[1]) < subject.threshold:
        return []
    wrong = inside if abs(levels[0]) > abs(levels[1]) else ~inside
    right = levels[1] if abs(levels[0]) > abs(levels[1]) else levels[0]
    if abs(right) > _AGREES:
        return []
    # A fault once proven, what does not agree as the rest has to is no more believed.
    far = np.abs(blocks.r / scatter - right) > _AGREES
    return _joined([_extended(far, span) for span in spans(wrong)])


def _extended(far: BoolArray, span: tuple[int, int]) -> tuple[int, int]:
    """The span with what is far from the rest of the log next to it.

    Gaps of up to `_BRIDGED_S` are bridged: a sensor that fails before and after them is not
    believed within.
    """
    start, stop = span
    reach = round(_BRIDGED_S / BLOCK_S)
    while True:
        first = max(start - reach, 0)
        before, after = np.flatnonzero(far[first:start]), np.flatnonzero(far[stop : stop + reach])
        if len(before) < _FAR_BLOCKS and len(after) < _FAR_BLOCKS:
            return start, stop
        start = first + int(before[0]) if len(before) >= _FAR_BLOCKS else start
        stop = stop + int(after[-1]) + 1 if len(after) >= _FAR_BLOCKS else stop


def _joined(parts: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """The spans, those that touch as one."""
    found: list[tuple[int, int]] = []
    for start, stop in sorted(parts):
        if found and start <= found[-1][1]:
            found[-1] = found[-1][0], max(stop, found[-1][1])
        else:
            found.append((start, stop))
    return found


def _described(
    subject: _Subject, found: Residuals, name: str, where: tuple[Blocks, int, int]
) -> Finding:
    """The stretch as a finding: its times, and what explains its error best.

    It reaches to the next blocks that agree: what cannot be compared in between is not believed.
    """
    blocks, start, stop = where
    time_s, half = blocks.time_s, 0.5 * BLOCK_S
    log_ends = float(subject.log.time_s[0]), float(subject.log.time_s[-1])
    first = log_ends[0] if start == 0 else float(time_s[start - 1]) + half
    last = log_ends[1] if stop == len(time_s) else float(time_s[stop]) - half
    inside = (found.signals.time_s >= first) & (found.signals.time_s <= last)
    kind, size, unit = _kind(found, name, inside)
    text = f"{size:+.3g} {unit} against what {_listed(subject.channels, name)} say"
    level = float(np.median(np.abs(blocks.r[start:stop]))) / subject.bank.level[name]
    probability = _probability(subject, level)
    return finding(
        subject.log, name, kind, text, span_s=(first, last), size=(size, unit),
        probability=max(probability, 1.0 - RATE_PER_H * max(subject.hours, 0.1)),
    )  # fmt: skip


def _probability(subject: _Subject, level: float) -> float:
    """One minus the probability of a level of any channel on a sound log."""
    tail = float(student.sf(abs(level), _dof(subject.bank)))
    alarms = len(subject.channels) * 2.0 * tail
    return float(np.clip(1.0 - alarms, 0.0, 0.9999))


def _kind(found: Residuals, name: str, inside: BoolArray) -> tuple[Kind, float, str]:
    """How a channel is wrong in some rows, by the shape that leaves least: kind, size, unit.

    A scale and a drift by 95 %: what is constant is taken for constant.
    """
    error, expected = _error(found, name)
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


def _error(found: Residuals, name: str) -> tuple[FloatArray, FloatArray]:
    """Agreed error and expected value (time,) of a channel in its unit."""
    expected = found.corrected.raw(name, found.expected[name])
    error = found.agreed[name] * found.scale(name) * found.corrected.scale[name]
    return error, expected


def _listed(channels: Sequence[str], but: str) -> str:
    return " and ".join(symbol(name) for name in channels if name != but)


# ---------------------------------------------------------------- motionless

_STILL = 0.2  # of the motion that the other channels show
_STILL_S, _LEAST_STILL_S = 60.0, 30.0


def _motionless(subject: _Subject, name: str) -> _Subject:
    """A channel that shows noise, or nothing, while the others agree that it moves.

    A channel that is set in steps, as benches and simulators set it, may stay.
    """
    if len(_sensed(subject)) < _TELLING or _in_steps(subject.log[name]):
        return subject
    found = residuals(subject.bank, subject.signals, subject.channels)
    size = round(_STILL_S / found.signals.step_s)
    y = subject.signals.values[name]
    own, implied = _moving_spread(y, size), _implied(found, name, size)
    scatter = _AGREES * subject.bank.level[name] * abs(subject.bank.centre[name])
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
            ends = float(subject.log.time_s[0]), float(subject.log.time_s[-1])
            span_s = max(float(time_s[start]) - half, ends[0]), float(time_s[stop - 1]) + half
            span_s = span_s[0], min(span_s[1], ends[1])
            level = float(np.nanmedian(y[start:stop]))
            text = f"stays at {level:.4g} while {_listed(subject.channels, name)} move"
            size_ = (level, CHANNELS[name].unit)
            whole = stop - start > _MOSTLY * len(y)
            place = None if whole else span_s
            subject = subject.with_finding(
                finding(subject.log, name, "stuck", text, span_s=place, size=size_)
            )
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


def _seldom(subject: _Subject) -> Iterator[Finding]:
    """Channels that change much more seldom than in the training logs."""
    for name in _sensed(subject):
        every_s = subject.log.updates.get(name, 0.0)
        usual_s = subject.bank.updates.get(name, 0.0)
        if every_s > max(_LEAST_UPDATE_S, _SELDOM * usual_s, _SELDOM * subject.log.dt_s):
            text = f"changes every {every_s:.2g} s only, every {usual_s:.2g} s in the training logs"
            yield finding(subject.log, name, "held", text, size=(every_s, "s"))


_NOISY = 6.0


def _noisy(subject: _Subject) -> Iterator[Finding]:
    """Channels with much more noise than in any training log, and more than their scatter."""
    for name in _sensed(subject):
        own, usual = noise_of(subject.log, name), subject.bank.noise.get(name, 0.0)
        matters = 0.5 * subject.bank.level[name] * abs(subject.bank.centre[name])
        if own > max(_NOISY * usual, matters):
            unit = CHANNELS[name].unit
            text = f"noise of {own:.2g} {unit}, {usual:.2g} in the training logs"
            yield finding(subject.log, name, "noise", text, size=(own, unit))


_LEAST_DELAY_S = 0.4


def _late(subject: _Subject) -> Iterator[Finding]:
    """The channel that is later against all others than in the training logs."""
    bank, found = subject.bank, delays_of(subject.log, subject.channels)
    excess: dict[str, tuple[float, float]] = {}
    for i in subject.channels:
        known = [
            (found[i, j] - bank.delays[i][j][0], bank.delays[i][j][1])
            for j in subject.channels
            if (i, j) in found and j in bank.delays.get(i, {})
        ]
        if len(known) >= 2:
            errors = np.array([[error] for error, _ in known])
            spread = float(np.median([each for _, each in known]))
            excess[i] = float(agreement(list(errors))[0]), spread
    limit = subject.threshold
    late = {
        name: delay
        for name, (delay, spread) in excess.items()
        if abs(delay) > max(_LEAST_DELAY_S, limit * spread)
    }
    if late:
        name = max(late, key=lambda each: abs(late[each]))
        word = "late" if late[name] > 0.0 else "early"
        text = f"{abs(late[name]):.2g} s {word} against {_listed(subject.channels, name)}"
        yield finding(subject.log, name, "late", text, size=(late[name], "s"))


def _stretched(bank: Bank, logs: Sequence[Log]) -> list[tuple[Finding, ...]]:
    """Stretched time stamps of each log: of all engines of a file or of none.

    r(k) is the ratio of the dynamic residual, were the stamps stretched by k, to that as they are
    (`training.redundancy.log_ratio`). Of a sound log it is that of the training logs, of one that
    is stretched by k it is 1 / r(1/k) of these.
    """
    found: list[tuple[Finding, ...]] = [() for _ in logs]
    for own in _files(logs):
        subjects = [one for k in own if (one := _subject(bank, logs[k], None)) is not None]
        if not subjects or min(len(_sensed(one)) for one in subjects) < _TELLING:
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
                text = f"all responses are {stretch:g} times as {word} as in the training logs"
                for k in own:
                    found[k] = (finding(logs[k], "time_s", "stretched", text, size=(stretch, "")),)
                break
    return found


def _files(logs: Sequence[Log]) -> list[list[int]]:
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


_RESTORED = 0.35  # of the misfit that undoing a hypothesis leaves at most


def _restored(subject: _Subject) -> tuple[Finding, ...]:
    """Another unit or an exchange that brings a log beyond the scatter back into it.

    Where nothing can be compared nothing is beyond it: a flight in air where no training log has
    been is not one in another unit.
    """
    before, t = _misfit(subject, subject.signals)
    known = [abs(value) for value in t.values() if np.isfinite(value)]
    if not known or max(known) < subject.threshold:
        return ()
    best: tuple[float, _Other] | None = None
    for each in _others(subject):
        after, levels = _misfit(subject, subject.signals.having(each.values))
        sound = all(abs(value) < _AGREES for value in levels.values())
        if sound and after < _RESTORED * before and (best is None or after < best[0]):
            best = after, each
    if best is None:
        return ()
    one = best[1]
    size = one.size, ""
    return (finding(subject.log, one.channel, one.kind, one.text, size=size, partner=one.partner),)


def _misfit(subject: _Subject, signals: Signals) -> tuple[float, dict[str, float]]:
    """Mean square of the levels u / s, bounded, and these; NaN where little can be compared."""
    found = residuals(subject.bank, signals, subject.channels)
    levels = {}
    for name in _sensed(subject):
        comparable = float(np.mean(np.isfinite(found.agreed[name])))
        level = found.level(name) / subject.bank.level[name]
        levels[name] = level if comparable > _LEAST_TESTABLE else float("nan")
    squares = [min(each**2, 400.0) if np.isfinite(each) else 400.0 for each in levels.values()]
    return float(np.mean(squares)) if squares else 0.0, levels


def _others(subject: _Subject) -> Iterator[_Other]:
    values = subject.signals.values
    for a, b in combinations(_sensed(subject), 2):
        if CHANNELS[a].unit == CHANNELS[b].unit:
            text = f"{symbol(a)} and {symbol(b)} fit the training logs when exchanged"
            yield _Other("exchanged", a, text, {a: values[b], b: values[a]}, b)
    sound = sound_air(subject.log)
    air = [name for name in ("ALT_ft", "Mach") if name in values and name not in sound]
    for name in (*_sensed(subject), *air):
        for word, scale, offset in conversions(name) if subject.log.recorded([name]) else ():
            text = f"looks like {word}: median {np.nanmedian(subject.log[name]):.4g}"
            other = {name: scale * values[name] + offset}
            yield _Other("unit", name, text, other, size=1.0 / scale)


def _level(subject: _Subject) -> list[Finding]:
    """The channel whose level is furthest beyond the scatter."""
    if len(_sensed(subject)) < _TELLING:
        return []
    t = {name: x for name, x in _misfit(subject, subject.signals)[1].items() if np.isfinite(x)}
    worst = max(t, key=lambda each: abs(t[each]), default="")
    if not worst or abs(t[worst]) < subject.threshold:
        return []
    probability = _probability(subject, t[worst])
    found = residuals(subject.bank, subject.signals, subject.channels)
    everywhere = np.ones(len(found.signals.time_s), dtype=np.bool_)
    kind, size, unit = _kind(found, worst, everywhere)
    text = f"{size:+.3g} {unit} against what {_listed(subject.channels, worst)} say"
    return [finding(subject.log, worst, kind, text, size=(size, unit), probability=probability)]
