"""Screen a log by the bank of `training.redundancy`: name its faults.

Hypotheses about the whole log come first (rows, noise, stretched time, another unit, exchanged
channels, delays), each accepted where undoing it brings all |S_i| below 1. Then channels are
isolated one by one; the shape that fits what is left of each says bias, scale, drift or dead.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.stats import t as student

from data_prep.log import Fault, Kind, Log
from data_prep.plausibility import conversions, fault, sound_air
from narxcal.atmosphere import mach_of_cas
from narxcal.channels import CHANNELS, symbol
from narxcal.support.arrays import BoolArray, FloatArray, bridge_gaps, spans
from training.redundancy import (
    AIR,
    LIMITS,
    PRIOR_LOGS,
    STRETCHES,
    WINDOWS_S,
    Bank,
    Corrected,
    Residuals,
    Signals,
    Values,
    delays_of,
    inside_air,
    log_ratio,
    moving_mean,
    noise_of,
    residuals,
)


@dataclass(frozen=True, eq=False)
class _Subject:
    """The log under examination, as it is after the faults found so far are undone."""

    log: Log
    signals: Signals
    channels: tuple[str, ...]
    faults: tuple[Fault, ...] = ()
    stretch: float = 1.0
    restored: tuple[str, ...] = ()

    def found(self, fault_: Fault, without: str = "", values: Values | None = None) -> _Subject:
        """Add a fault, and go on without its channel or with the values before it."""
        return replace(
            self,
            signals=self.signals.having(values or {}),
            channels=tuple(name for name in self.channels if name != without),
            faults=(*self.faults, fault_),
        )


def screened(bank: Bank | None, logs: Sequence[Log]) -> list[Log]:
    """Return prepared logs with the faults that the bank shows added to their own."""
    if bank is None:
        return list(logs)
    found = [replace(log, faults=examine(bank, log)) for log in logs]
    for i, k in combinations(range(len(found)), 2):
        if _of_one_flight(found[i], found[k]):
            found[i], found[k] = _exchanged(bank, found[i], found[k])
    return found


def contradiction(bank: Bank, log: Log) -> float:
    """RMS of the residuals of a prepared log, each over its sigma; 0 where none can be tested."""
    channels = tuple(name for name in bank.channels if log.recorded([name]))
    signals = Signals.of(log)
    if len(channels) < 2 or len(signals.time_s) < WINDOWS_S[0]:
        return 0.0
    return _spread(residuals(bank, signals, channels))


def _of_one_flight(a: Log, b: Log) -> bool:
    """Whether two logs are those of two engines at the same times."""
    apart = a.source.engine != b.source.engine and a.source.file == b.source.file
    return apart and len(a) == len(b) and bool(a.time_s[0] == b.time_s[0])


# Kinds of fault that an exchange may explain.
_LEVELS = frozenset({"scale", "bias", "drift", "dead", "inconsistent"})
_EXCHANGED = 0.85  # of the residual, at most, that an exchange leaves in both logs together


def _exchanged(bank: Bank, a: Log, b: Log) -> tuple[Log, Log]:
    """Name a channel of wrong level that fits when both engines' readings are exchanged."""
    names = {each.channel for log in (a, b) for each in log.faults if each.kind in _LEVELS}
    for name in sorted(names & {*bank.channels}):
        channels = tuple(one for one in bank.channels if a.recorded([one]) and b.recorded([one]))
        if name not in channels:
            continue
        pair = Signals.of(a), Signals.of(b)
        restored = (
            pair[0].having({name: pair[1].values[name]}),
            pair[1].having({name: pair[0].values[name]}),
        )
        before, after = (
            [residuals(bank, one, channels) for one in signals] for signals in (pair, restored)
        )
        left = sum(_spread(one) ** 2 for one in after) / sum(_spread(one) ** 2 for one in before)
        if left < _EXCHANGED**2 and all(_mostly_sound(one) for one in after):
            return _with_exchange(a, b, name), _with_exchange(b, a, name)
    return a, b


def _with_exchange(log: Log, other: Log, name: str) -> Log:
    """The log with its faults of level replaced by the exchange that explains them."""
    kept = tuple(each for each in log.faults if each.kind not in _LEVELS)
    text = f"fits the training logs when exchanged with that of {other.source.engine}"
    return replace(log, faults=(*kept, fault(log, (name,), ("swapped", text))))


def examine(bank: Bank, log: Log) -> tuple[Fault, ...]:
    """The faults of one prepared log: its own, and those that the bank shows."""
    lost = {each.channel for each in log.faults if each.kind in {"unit", "held"}}
    channels = tuple(name for name in bank.channels if log.recorded([name]) and name not in lost)
    subject = _Subject(log, Signals.of(log), channels, log.faults)
    if len(channels) < 2 or len(subject.signals.time_s) < WINDOWS_S[0]:
        return log.faults
    for step in _STEPS:
        if len(subject.channels) > 1:
            subject = step(bank, subject)
    used = {*bank.used, *AIR, "CAS_kt", "time_s"}
    return tuple(each for each in subject.faults if each in log.faults or used & {*each.channels})


_SELDOM = 1.6


def _coarse(bank: Bank, subject: _Subject) -> _Subject:
    """Channels, or whole rows, that change much more seldom than in the training logs."""
    log = subject.log
    seldom = [log.updates.get(name, 0.0) / bank.updates.get(name, 1.0) for name in subject.channels]
    if min(seldom) > _SELDOM and max(seldom) < _SELDOM * min(seldom):
        text = f"rows come {np.median(seldom):.2g} times as seldom as in the training logs"
        doubtful = fault(log, ("time_s",), ("inconsistent", text), confidence=0.9)
        return subject.found(doubtful)
    for name in subject.channels:
        every_s, usual_s = subject.log.updates.get(name, 0.0), bank.updates.get(name, 0.0)
        if every_s > max(0.5, 3.0 * usual_s, 3.0 * subject.log.dt_s):
            text = f"changes every {every_s:.2g} s only, every {usual_s:.2g} s in the training logs"
            subject = subject.found(fault(subject.log, (name,), ("held", text)), without=name)
    return subject


_LEAST_DELAY_S = 0.4


def _late(bank: Bank, subject: _Subject) -> _Subject:
    """A channel that is later against all others than in the training logs."""
    log = subject.log
    found = delays_of(log, subject.channels, subject.stretch)
    excess, spread = {}, {}
    for i in subject.channels:
        known = [
            (found[i, j] - bank.delays[i][j][0], bank.delays[i][j][1])
            for j in subject.channels
            if (i, j) in found and j in bank.delays.get(i, {})
        ]
        if len(known) >= 2:
            excess[i] = _agreed([error for error, _ in known])
            spread[i] = float(np.median([each for _, each in known]))
    late = {
        name: delay
        for name, delay in excess.items()
        if abs(delay) > max(_LEAST_DELAY_S, 4.0 * spread[name])
    }
    if not late:
        return subject
    name = max(late, key=lambda each: abs(late[each]))
    delay = late[name]
    word = "late" if delay > 0.0 else "early"
    shift = delay / subject.signals.step_s
    values = subject.signals.values[name]
    rows = np.arange(len(values)) + shift
    shifted = np.interp(rows, np.arange(len(values)), bridge_gaps(values))
    text = f"{abs(delay):.2g} s {word} against {_listed(subject.channels, name)}"
    return subject.found(fault(subject.log, (name,), ("late", text)), values={name: shifted})


def _agreed(errors: Sequence[float]) -> float:
    """Median of three or more; of two, the smaller where both have one sign."""
    if len(errors) != 2:
        return float(np.median(errors))
    return min(errors, key=abs) if errors[0] * errors[1] > 0.0 else 0.0


def _listed(channels: Sequence[str], but: str) -> str:
    return " and ".join(symbol(name) for name in channels if name != but)


# Of a log in air of the training logs: dynamics of other air may be slower.
_KNOWN_AIR = 0.15


def _stretched(bank: Bank, subject: _Subject) -> _Subject:
    """Time stamps by which all dynamics are too slow or too fast.

    `r(k)` is the ratio of the dynamic residual, were the stamps stretched by k, to that as they
    are. A sound log has the r(k) of the training logs; one that is stretched by k has 1 / r(1/k).
    The log belongs to the nearer of both.
    """
    inside = inside_air(bank, Corrected.of(subject.signals, subject.channels))
    if inside.mean() < _KNOWN_AIR:
        return subject
    beyond = {}
    for stretch in STRETCHES:
        usual, inverse = bank.stretch[str(stretch)], bank.stretch[str(1.0 / stretch)]
        found = log_ratio(bank, subject.signals, subject.channels, stretch)
        beyond[stretch] = 0.5 * (usual - inverse) - found
    best = max(beyond, key=lambda each: beyond[each])
    if not beyond[best] > 0.0:
        return subject
    word = "long" if best > 1.0 else "short"
    text = f"time stamps look stretched by {best:g}: all responses are so many times as {word}"
    found_ = subject.found(fault(subject.log, ("time_s",), ("scale", text)))
    signals = replace(subject.signals, step_s=subject.signals.step_s / best)
    return replace(found_, signals=signals, stretch=best)


def _whole(bank: Bank, subject: _Subject) -> _Subject:
    """Another unit or two exchanged channels, which restore the whole log when undone."""
    before = residuals(bank, subject.signals, subject.channels)
    if before.sound:
        return subject
    best: tuple[float, Fault, dict[str, FloatArray]] | None = None
    for kind, channels, text, values in _hypotheses(subject):
        after = residuals(bank, subject.signals.having(values), subject.channels)
        if after.extrapolation > _MORE_EXTRAPOLATED * before.extrapolation:
            continue  # wider tolerances explain everything
        if after.misfit > _RESTORED * before.misfit or not _mostly_sound(after):
            continue
        if best is None or after.misfit < best[0]:
            best = (after.misfit, fault(subject.log, channels, (kind, text)), values)
    if best is None:
        return subject
    if best[1].kind == "swapped":
        a, b = best[1].channels
        log = subject.log.with_channels({a: subject.log[b], b: subject.log[a]})
        subject = replace(subject, log=log)
    return subject.found(best[1], values=best[2])


def _airspeed(bank: Bank, subject: _Subject) -> _Subject:
    """Which of Mach and CAS is wrong, where they contradict each other: what the engine says."""
    values = subject.signals.values
    open_ = [each for each in subject.faults if {"Mach", "CAS_kt", "ALT_ft"} >= {*each.channels}]
    open_ = [each for each in open_ if each.kind == "inconsistent" and len(each.channels) > 1]
    if not open_ or not {"Mach", "CAS_kt", "ALT_ft"} <= values.keys():
        return subject
    implied = {"Mach": mach_of_cas(np.abs(values["CAS_kt"]), values["ALT_ft"])}
    restored = replace(subject, signals=subject.signals.having(implied))
    recorded, other = (
        _spread(residuals(bank, each.signals, each.channels)) for each in (subject, restored)
    )
    if _DECIDED[0] * other > recorded and _DECIDED[1] * recorded > other:
        return subject
    name = "Mach" if other < recorded else "CAS_kt"
    flies = implied["Mach"] > _AIRBORNE
    ratio = (values["Mach"] / np.maximum(implied["Mach"], 1e-9))[flies]
    constant = len(ratio) and np.std(ratio) < _CONSTANT * np.mean(ratio)
    wrong = replace(
        open_[0], channel=name, channels=(name,), kind="scale" if constant else "inconsistent"
    )
    faults = tuple(wrong if each is open_[0] else each for each in subject.faults)
    if name == "Mach":
        return replace(restored, faults=faults, restored=("Mach",))
    return replace(subject, faults=faults)


# Ratios of the engine's residuals from which on Mach, or CAS, is at fault.
_DECIDED, _AIRBORNE, _CONSTANT = (1.1, 1.25), 0.2, 0.1


def _without_air(_bank: Bank, subject: _Subject) -> _Subject:
    """Samples in which air data are at fault say nothing of the engine; what is restored does."""
    blanked: dict[str, FloatArray] = {}
    for each in subject.faults:
        for name in {*AIR} & {*each.channels} - {*subject.restored}:
            if name in subject.signals.values:
                time_s = subject.signals.time_s
                inside = (time_s >= each.from_s) & (time_s <= each.to_s)
                before = blanked.get(name, subject.signals.values[name])
                blanked[name] = np.where(inside, np.nan, before)
    lost = np.any([~np.isfinite(each) for each in blanked.values()], axis=0)
    channels = () if np.mean(lost) > 1.0 - _LEAST_TESTABLE else subject.channels
    return replace(subject, signals=subject.signals.having(blanked), channels=channels)


_LEAST_TESTABLE = 0.1  # share of a log's samples below which the bank says nothing of it


def _spread(found: Residuals) -> float:
    """RMS of the residuals, each over its sigma."""
    parts = np.stack([found.consensus[name] / found.bank.sigma[name] for name in found.channels])
    known = parts[np.isfinite(parts)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else 0.0


_RESTORED = 0.35
_MORE_EXTRAPOLATED = 1.02
_MOSTLY = 0.15


def _mostly_sound(found: Residuals) -> bool:
    known = sum(float(np.isfinite(each).mean()) for each in found.smooth.values())
    return known > 0.3 * len(found.channels) and all(
        found.share(name) < _MOSTLY for name in found.channels
    )


_AIR_SCALES = tuple(2.0 ** (k / 4.0) for k in range(-4, 5) if k)


def _hypotheses(
    subject: _Subject,
) -> Iterator[tuple[Kind, tuple[str, ...], str, dict[str, FloatArray]]]:
    values = subject.signals.values
    for a, b in combinations(subject.channels, 2):
        if CHANNELS[a].unit == CHANNELS[b].unit:
            text = f"{symbol(a)} and {symbol(b)} fit the training logs when exchanged"
            yield "swapped", (a, b), text, {a: values[b], b: values[a]}
    sound = sound_air(subject.log)
    air = [name for name in ("ALT_ft", "Mach") if name in values and name not in sound]
    for name in (*subject.channels, *air):
        for word, scale, offset in conversions(name):
            level = f"median {np.nanmedian(values[name]):.4g}"
            yield (
                "unit",
                (name,),
                f"looks like {word}: {level}",
                {name: scale * values[name] + offset},
            )
    for name in air:
        for factor in _AIR_SCALES:
            text = f"looks scaled by {factor:.2g}"
            yield "scale", (name,), text, {name: values[name] / factor}


def _isolated(bank: Bank, subject: _Subject) -> _Subject:
    """The channel without which the others agree, and how it is wrong."""
    if len(subject.channels) < 2:
        return subject
    found = residuals(bank, subject.signals, subject.channels)
    flagged = {name: each for name, each in found.flagged.items() if _lasting(each, found)}
    if not flagged:
        return subject
    name = max(flagged, key=lambda each: _energy(found, each))
    if len(subject.channels) > 3:
        rest = {
            each: residuals(
                bank, subject.signals, [other for other in subject.channels if other != each]
            ).misfit
            for each in flagged
        }
        name = min(rest, key=lambda each: rest[each])
    if len(subject.channels) == 2:
        text = "contradict each other by more than in any training log"
        return subject.found(
            _spanned(
                subject.log, subject.channels, ("inconsistent", text), found, _span(found, name)
            ),
            without=name,
        )
    kind, text, rows = _kind(found, name)
    return subject.found(_spanned(subject.log, (name,), (kind, text), found, rows), without=name)


def _energy(found: Residuals, name: str) -> float:
    return float(np.nansum(np.minimum(np.abs(found.smooth[name]), 4.0) ** 2))


def _lasting(flags: BoolArray, found: Residuals) -> bool:
    """Whether flags last for at least half a window."""
    least = 0.5 * WINDOWS_S[0] / found.signals.step_s
    return any(stop - start >= least for start, stop in spans(flags))


_WHOLE = 0.6


def _span(found: Residuals, name: str) -> tuple[int, int]:
    """First and last sample of the fault: the whole log if most testable samples are flagged."""
    flags = found.flagged[name]
    rows = np.flatnonzero(flags)
    if found.share(name) > _WHOLE and rows[0] < 0.25 * len(flags):
        return 0, len(flags) - 1
    return int(rows[0]), int(rows[-1])


def _spanned(
    log: Log,
    channels: tuple[str, ...],
    words: tuple[Kind, str],
    found: Residuals,
    rows: tuple[int, int],
) -> Fault:
    """The fault in these rows, with the confidence of its largest S."""
    first, last = rows
    half = 0.5 * found.signals.step_s
    time_s = found.signals.time_s
    largest = LIMITS[1] * float(np.nanmax(np.abs(found.smooth[channels[0]])))
    span_s = (float(time_s[first]) - half, float(time_s[last]) + half)
    return fault(log, channels, words, span_s, _confidence(found, largest))


def _confidence(found: Residuals, largest: float) -> float:
    """Confidence of a deviation by `largest` sigma.

    Sigma is known from few logs: the deviation has Student's distribution. A sound log may show it
    in any of the m channels: m times the probability of one (Bonferroni).
    """
    dof = PRIOR_LOGS + max(found.bank.logs - 1, 1)
    alarms = len(found.channels) * 2.0 * float(student.sf(largest, dof))
    return min(max(1.0 - alarms, 0.0), 0.9999)


def _kind(found: Residuals, name: str) -> tuple[Kind, str, tuple[int, int]]:
    """How a channel is wrong, by what explains its difference from the expected one best; where."""
    first, last = _span(found, name)
    rows = np.arange(len(found.signals.time_s), dtype=np.float64)
    y, expected = found.signals.values[name], found.corrected.raw(name, found.expected[name])
    usable = np.isfinite(y) & np.isfinite(expected) & np.isfinite(found.smooth[name])
    against, unit = _listed(found.channels, name), CHANNELS[name].unit
    before = usable & (rows <= last)
    shapes = _shapes(rows, (y, expected), before, first)
    misfits = {
        kind: float(np.mean(np.abs(y - expected - error)[before]))
        * (1.0 if kind != "drift" else 1.2)
        for kind, error in shapes.items()
    }
    best: Kind = min(misfits, key=lambda each: misfits[each])
    at_end = shapes[best][last]
    texts = {
        "scale": f"{100.0 * at_end / expected[last]:+.1f} % against what {against} say",
        "bias": f"{at_end:+.4g} {unit} against what {against} say",
        "drift": f"drifts by {at_end:+.4g} {unit} against what {against} say",
    }
    if best == "drift":
        noticed = np.abs(shapes[best]) > found.bank.sigma[name] * np.abs(expected)
        first = int(np.argmax(noticed)) if noticed.any() else first
    return best, texts[best], (first, last)


_STILL = 0.2  # of the motion that the other channels show
_STILL_S, _LEAST_STILL_S = 60.0, 30.0


def _motionless(bank: Bank, subject: _Subject) -> _Subject:
    """A channel that shows noise, or nothing, while the others say that it moves."""
    tested = [name for name in subject.channels if CHANNELS[name].role != "lever"]
    if len(subject.channels) < 3 or not tested:
        return subject
    found = residuals(bank, subject.signals, subject.channels)
    motion = {name: _without_motion(found, name) for name in tested}
    motionless = {name: each for name, (each, _) in motion.items()}
    name = max(motionless, key=lambda each: int(motionless[each].sum()))
    spread = spans(motionless[name])
    if not spread or motionless[name].sum() * subject.signals.step_s < _LEAST_STILL_S:
        return subject
    y, first, last = subject.signals.values[name], spread[0][0], spread[-1][1] - 1
    part = y[motionless[name]]
    kind: Kind = "stuck" if np.ptp(part) == 0.0 else "dead"
    against = _listed(subject.channels, name)
    text = f"stays at {np.median(part):.4g} {CHANNELS[name].unit} while {against} move"
    dead = _spanned(subject.log, (name,), (kind, text), found, (first, last))
    dead = replace(dead, confidence=_confidence(found, motion[name][1]))
    return subject.found(dead, without=name)


def _without_motion(found: Residuals, name: str) -> tuple[BoolArray, float]:
    """Samples at which the channel stays within 60 s, and the others say that it must move.

    Also the largest move that they ask for, in sigma.

    They say so where most of them ask for a move by the limit of S: a step of height h has a
    standard deviation of h / 2. A switched load moves fuel and temperature, too, though by less.
    The level at which it stays is followed to both sides for as long as the channel does.
    """
    size = round(_STILL_S / found.signals.step_s)
    y = found.signals.values[name]
    sigma = found.bank.sigma[name] * abs(found.bank.centre[name]) * found.corrected.scale[name]
    own, other = _moving_spread(y, size), _implied_motion(found, name, size)
    quiet = (own < _STILL * other) & (other > 0.5 * LIMITS[0] * sigma)
    motionless = np.zeros(len(y), dtype=np.bool_)
    largest = 2.0 * float(np.max((other / sigma)[quiet], initial=0.0))
    half = size // 2
    for start, stop in spans(quiet):
        first, last = max(start - half, 0), min(stop + half, len(y))
        level, width = np.nanmedian(y[first:last]), 4.0 * float(np.nanmax(own[start:stop]))
        same = np.abs(moving_mean(y, 5) - level) <= max(width, 1e-9)
        while first > 0 and same[first - 1]:
            first -= 1
        while last < len(y) and same[last]:
            last += 1
        motionless[first:last] = True
    return motionless, largest


def _implied_motion(found: Residuals, name: str, size: int) -> FloatArray:
    """Standard deviation in a window (time,) that the middle one of the other channels asks for.

    A step of one of them, such as the begin of its own fault, is no reason for this one to move.
    """
    x, expected = found.corrected.x[name], found.expected[name]
    scale = 0.5 * np.maximum(expected, 0.0) + 0.5 * abs(found.bank.centre[name])
    implied = [
        _moving_spread(found.corrected.raw(name, x - error * scale), size)
        for error in found.errors[name].values()
    ]
    return np.nan_to_num(np.median(implied, axis=0))


def _moving_spread(values: FloatArray, size: int) -> FloatArray:
    """Standard deviation in a centred window."""
    centred = values - (np.nanmean(values) if np.isfinite(values).any() else 0.0)
    square = moving_mean(centred**2, size) - moving_mean(centred, size) ** 2
    return np.sqrt(np.maximum(square, 0.0))


def _shapes(
    rows: FloatArray, signals: tuple[FloatArray, FloatArray], before: BoolArray, first: int
) -> dict[Kind, FloatArray]:
    """The error (time,) that a scale, a bias and a drift give at best, up to the end of a span."""
    y, expected = signals
    error, on = y - expected, (rows >= first).astype(np.float64)
    shapes: dict[Kind, FloatArray] = {
        "scale": _fitted(error, on * expected, before),
        "bias": _fitted(error, on, before),
    }
    drifts = [
        _fitted(error, np.maximum(rows - begin, 0.0) * factor, before)
        for begin in np.linspace(0, first, 8)
        for factor in (1.0, expected)
    ]
    shapes["drift"] = min(drifts, key=lambda each: float(np.mean(np.abs(error - each)[before])))
    return shapes


def _fitted(error: FloatArray, shape: FloatArray, usable: BoolArray) -> FloatArray:
    """`shape` times the factor that fits the error in the least-squares sense."""
    square = float(np.sum(shape[usable] ** 2))
    return shape * (float(np.sum(shape[usable] * error[usable])) / square if square > 0.0 else 0.0)


_NOISY = 6.0


def _noisy(bank: Bank, subject: _Subject) -> _Subject:
    """Channels that follow the others with much more noise than in any training log."""
    for name in subject.channels:
        own, usual = noise_of(subject.log, name), bank.noise.get(name, 0.0)
        matters = 0.5 * bank.sigma[name] * abs(bank.centre[name])
        if own > _NOISY * max(usual, 1e-12) and own > matters and _follows(bank, subject, name):
            text = f"noise of {own:.2g} {CHANNELS[name].unit}, {usual:.2g} in the training logs"
            subject = subject.found(fault(subject.log, (name,), ("noise", text)), without=name)
    return subject


def _follows(bank: Bank, subject: _Subject, name: str) -> bool:
    """Whether a channel is correlated with what the others say, in means over 10 s."""
    found = residuals(bank, subject.signals, subject.channels)
    size = round(10.0 / subject.signals.step_s)
    pair = [moving_mean(each[name], size) for each in (found.corrected.x, found.expected)]
    known = np.isfinite(pair[0]) & np.isfinite(pair[1])
    spread = min((float(np.std(each[known])) for each in pair), default=0.0) if known.any() else 0.0
    return spread > 0.0 and bool(np.corrcoef(pair[0][known], pair[1][known])[0, 1] > _FOLLOWS)


_FOLLOWS = 0.5
_STEPS: tuple[Callable[[Bank, _Subject], _Subject], ...] = (
    _airspeed, _without_air, _coarse, _noisy, _stretched, _whole, _late, _motionless, _isolated,
    _isolated,
)  # fmt: skip
