"""Screen logs by the bank of `redundancy`: what is masked, and what is only reported.

**Masked** is a stretch of one channel with a beginning or an end inside the log
(`training.screening.stretches`). It is at fault if its height is beyond the limit of sound logs
(`training.screening.scatter`), while the rest of the log is within the scatter of levels between
logs. What two channels show at the same time is a state of the engine and no fault, and so is what
both engines of a file show, which share clock, air and manoeuvre
(`training.screening.redundancy.agreement` of r of one and of the difference). Levers are commands,
which an engine may not follow: nothing is concluded from them.

**Reported** is what the whole log disagrees in: its levels u and its delays are compared with their
scatter between logs (`training.screening.scatter.Scatter`). Another unit or an exchange is named
where it makes the log sound, and is more likely than an error of one channel. The longest part of a
recording stands for it. One stated rate of false alarms gives all thresholds.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from data_prep.log import Finding, Log
from data_prep.sources.units import conversions, to_canonical
from narxcal.channels import CHANNELS, symbol
from narxcal.support.arrays import FloatArray, spans
from training.screening.redundancy import (
    AIR,
    STRETCHES,
    Bank,
    delays_of,
    excess,
    log_ratio,
    minutes_of,
    noise_of,
)
from training.screening.stretches import motionless, strongest
from training.screening.subject import TELLING, Subject

_MOST_STRETCHES = 6
_SELDOM, _LEAST_UPDATE_S = 3.0, 0.5
_TENTH = 0.1 * 0.05  # of the largest value: Ti is read at a tenth of responses of 5 % and more
_LEAST_DELAY_S = 0.4
_FAULT = 0.2  # standard deviation of the share by which faults scale or shift a channel


def screened(bank: Bank | None, logs: Sequence[Log]) -> list[Log]:
    """Return prepared logs with what the bank shows added to their findings."""
    if bank is None:
        return list(logs)
    subjects = [Subject.of(bank, log, logs) for log in logs]
    found = [[] if one is None else _wrong_unit_or_swap(one) for one in subjects]
    if not any(found):  # exchanged channels have other lags
        found = _stretched(bank, logs)
    found = [
        more or ([] if one is None else _examine(one))
        for more, one in zip(found, subjects, strict=True)
    ]
    return [
        replace(log, findings=(*log.findings, *more)) for log, more in zip(logs, found, strict=True)
    ]


def _examine(subject: Subject) -> list[Finding]:
    """What the bank shows of one prepared log with its own clock, units and order of channels."""
    of_whole = (_slow_updates, _noisy, _late) if subject.whole else ()
    found = [each for detect in of_whole for each in detect(subject)]
    # Of a channel with other dynamics all the log no stretch is at fault.
    whole = {each.channel for each in found if not each.local}
    suspects = [name for name in subject.sensed if name not in whole]
    for name in suspects:
        subject = subject.after([*motionless(subject, name)])
    for _ in range(_MOST_STRETCHES):
        more = strongest(subject, suspects)
        if not more:
            break
        subject = subject.after(more)
    stretches = {each.channel for each in subject.findings}
    found = [each for each in found if not (each.local and each.channel in stretches)]
    found = [*_alone(subject.findings), *found]
    if subject.whole and not any(each.kind in {"held", "late", "stuck"} for each in found):
        found += _level(subject)
    used = {*subject.bank.used, *AIR, "time_s"}
    return [each for each in found if used & {*each.channels}]


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


# ---------------------------------------------------------------- dynamics and noise


def _slow_updates(subject: Subject) -> Iterator[Finding]:
    """Channels that change much more seldom than in the training logs."""
    for name in subject.sensed:
        every_s = subject.log.updates.get(name, 0.0)
        usual_s = subject.bank.updates.get(name, 0.0)
        if every_s > max(_LEAST_UPDATE_S, _SELDOM * usual_s, _SELDOM * subject.log.dt_s):
            text = f"changes every {every_s:.2g} s only, every {usual_s:.2g} s in the training logs"
            yield subject.log.finding("held", name, text, size=every_s, unit="s")


def _noisy(subject: Subject) -> Iterator[Finding]:
    """Coarse channels; minutes of others with more noise than sound logs, and their scatter."""
    limits, time_s = subject.bank.noise_limits(subject.share), subject.log.time_s
    for name in subject.sensed:
        if coarse := _coarse(subject, name):
            yield coarse
            continue
        usual = subject.bank.scatter[name].limit(0.3173)  # two levels of three are within
        matters = 0.5 * usual * abs(subject.bank.centre[name])
        own, limit = noise_of(subject.log, name), max(limits.get(name, np.inf), matters)
        for start, stop in spans(own > limit):
            size, unit = float(np.median(own[start:stop])), CHANNELS[name].unit
            text = f"noise of {size:.2g} {unit}, sound logs have less than {limit:.2g}"
            first, last = time_s[minutes_of(subject.log)[[start, stop]] - [0, 1]].tolist()
            span_s = (first, last) if stop - start < len(own) else None
            yield subject.log.finding("noise", name, text, span_s, size=size, unit=unit)


def _coarse(subject: Subject, name: str) -> Finding | None:
    """Coarser steps than those of the training logs, by which no Ti can be read."""
    step, usual = (each.rounding.get(name, 0.0) for each in (subject.log, subject.bank))
    tenth = _TENTH * float(np.nanmax(np.abs(subject.log[name]), initial=0.0))
    if not step > max(tenth, _SELDOM * usual):
        return None
    unit = CHANNELS[name].unit
    text = f"moves in steps of {step:.3g} {unit}, of {usual:.3g} in the training logs; Ti of a "
    text += f"small response is read at {tenth:.2g}"
    return subject.log.finding("noise", name, text, size=step, unit=unit)


def _late(subject: Subject) -> Iterator[Finding]:
    """The channel that is later against all others than in the training logs."""
    bank, found = subject.bank, delays_of(subject.log, subject.channels)
    late = {n: excess(bank.delays.get(n, {}), found, n) for n in subject.channels}
    limits = {n: max(_LEAST_DELAY_S, bank.late_scatter[n].limit(subject.share)) for n in late}
    late = {name: delay_s for name, delay_s in late.items() if abs(delay_s) > limits[name]}
    if late:
        name = max(late, key=lambda each: abs(late[each]))
        word = "late" if late[name] > 0.0 else "early"
        text = f"{abs(late[name]):.2g} s {word} against {subject.others(name)}"
        yield subject.log.finding("late", name, text, size=late[name], unit="s")


def _stretched(bank: Bank, logs: Sequence[Log]) -> list[list[Finding]]:
    """Stretched time stamps of each log: of all engines of a file or of none.

    r(k) is the ratio of the dynamic residual, were the stamps stretched by k, to that as they are
    (`training.screening.redundancy.log_ratio`). Of a sound log it is that of the training logs, of
    one that is stretched by k it is 1 / r(1/k) of these.
    """
    found: list[list[Finding]] = [[] for _ in logs]
    for own in files_of(logs):
        subjects = [one for k in own if (one := Subject.of(bank, logs[k], ())) is not None]
        if not subjects or min(len(one.sensed) for one in subjects) < TELLING:
            continue
        alarms = max(one.alarms for one in subjects)
        for stretch in STRETCHES:
            ratios = np.array([log_ratio(one.shown, stretch) for one in subjects])
            if not np.isfinite(ratios).any():
                continue
            ratio = float(np.nanmean(ratios))
            usual, scatter = bank.stretch[str(stretch)]
            other = -bank.stretch[str(1.0 / stretch)][0]
            odds = ((ratio - usual) ** 2 - (ratio - other) ** 2) / (2.0 * scatter**2)
            if ratio < 0.0 and odds > -np.log(alarms):
                word, times = "long" if stretch > 1.0 else "short", max(stretch, 1.0 / stretch)
                text = f"all responses are {times:g} times as {word} as in the training logs"
                for k in own:
                    found[k] = [logs[k].finding("stretched", "time_s", text, size=stretch)]
                break
    return found


def files_of(logs: Sequence[Log]) -> list[list[int]]:
    """Numbers of the logs of each file."""
    names = [log.source.file or log.name for log in logs]
    return [[k for k, each in enumerate(names) if each == name] for name in dict.fromkeys(names)]


# ---------------------------------------------------------------- levels, units, order


def _level(subject: Subject) -> list[Finding]:
    """The channel whose level is furthest beyond the scatter."""
    levels, scatter = subject.levels, subject.bank.scatter
    beyond = [name for name, level in levels.items() if abs(level) > subject.limit[name]]
    if len(subject.sensed) < TELLING or not beyond:
        return []
    worst = min(beyond, key=lambda each: scatter[each].tail(levels[each]))
    return [subject.misfit(subject.shown, worst, levels[worst])]


def _wrong_unit_or_swap(subject: Subject) -> list[Finding]:
    """Another unit or an exchange that makes a log sound, and more so than an error of one channel.

    Where channels cannot be compared they may be beyond what training logs show. Air data are not
    accused: engines share them, and what physics allows no statistic of one engine refutes.
    """
    comparable = len(subject.levels) == len(subject.sensed)
    if not subject.whole or (comparable and subject.sound):
        return []
    likely: list[tuple[float, Finding]] = []
    for found, values in _alternatives(subject):
        other = subject.having(values)
        if len(other.levels) == len(subject.sensed) and other.sound:
            likely.append((_log_likelihood(subject, other.levels), found))
    best = max(likely, key=lambda each: each[0], default=None)
    least = _one_at_fault(subject) if comparable else -np.inf
    return [best[1]] if best and best[0] > least else []


def _alternatives(subject: Subject) -> Iterator[tuple[Finding, Mapping[str, FloatArray]]]:
    """What a log may be instead, with the values that some channels have then."""
    values = subject.signals.values
    for a, b in combinations(subject.sensed, 2):
        if CHANNELS[a].unit == CHANNELS[b].unit:
            text = f"{symbol(a)} and {symbol(b)} fit the training logs when exchanged"
            found = subject.log.finding("exchanged", a, text, partner=b)
            yield found, {a: values[b], b: values[a]}
    for name in subject.log.recorded(subject.sensed):
        for words, unit in conversions(name).items():
            text = f"looks like {words}: median {np.nanmedian(subject.log[name]):.4g}"
            found = subject.log.finding("unit", name, text, size=1.0 / unit.scale)
            yield found, {name: to_canonical(values[name], unit)}


def _one_at_fault(subject: Subject) -> float:
    """Log likelihood of the levels, were one channel at fault by any size."""
    found = []
    for name, level in subject.levels.items():
        others = {each: x for each, x in subject.levels.items() if each != name}
        own = -0.5 * (level / _FAULT) ** 2 - float(np.log(_FAULT * np.sqrt(2.0 * np.pi)))
        found.append(_log_likelihood(subject, others) + own)
    return max(found)


def _log_likelihood(subject: Subject, levels: Mapping[str, float]) -> float:
    return sum(subject.bank.scatter[name].log_density(level) for name, level in levels.items())
