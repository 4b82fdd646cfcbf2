"""Check a log against physics: units, stuck air data, air data against each other.

Nothing is learned here, so that it serves every command; what the training logs say of a log is in
`training.screening.screen`. Signals are `(time,)`, NaN where nothing was measured; logs are those
of `data_prep.reading`, before cleaning.

Air data are redundant (any compressible-flow text; T in K):

    M   = mach_of_cas(CAS, ALT)     CAS, ALT, Mach
    TAS = a0 M sqrt(SAT / T0)       TAS, Mach, SAT
    TAT = SAT (1 + 0.2 r M^2)       TAT, SAT, Mach
    SAT = ISA(ALT) + slow           SAT, ALT

The channel that stands in all failed relations and in no other is at fault. Below their threshold
on the ground airspeeds are a state, not a fault, and are compared with nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from data_prep.cleaning.faults import out_of_range, repeats, unnatural
from data_prep.log import Finding, Kind, Log
from data_prep.sources.units import Unit, conversions, to_canonical
from narxcal.atmosphere import KELVIN, SOUND_KT, T0_K, isa, mach_of_cas
from narxcal.channels import CHANNELS, SPOOLS, Channel
from narxcal.support.arrays import BoolArray, FloatArray, robust_range, spans

_QUANTISED, _ONE_SIZE = 0.6, 0.02  # share of the changes that are of one size, to this part of it
# Eight gaps of no grid are all this near to multiples once in ten million channels: 0.1^7.
_GAPS, _NEAR, _ON_GRID = 8, 0.05, 0.9
_MANY = 0.2  # share of the samples outside of the physical range: no single errors, another unit
_FEW = 0.01  # likewise, of single errors in the right unit
_FRACTION = 1.6  # a spool speed below this all along is a ratio, not percent


def checked(log: Log) -> Log:
    """Return the log with its `findings`, `updates`, `rounding`; its values are unchanged."""
    if len(log) < 3:
        return log
    measured = {name: log.measured([name])[:, 0] for name in log.channels}
    updates = {name: update_interval(each) * log.dt_s for name, each in measured.items()}
    rounding = {name: rounding_step(each) for name, each in measured.items()}
    log = replace(log, updates=updates, rounding=rounding)
    found = [*_units(log), *_stuck_air(log)]
    known = {each.channel for each in found}
    rest = {name: values for name, values in log.channels.items() if name not in known}
    found += _air(replace(log, channels=rest))
    return replace(log, findings=(*log.findings, *found))


def of_cleaning(log: Log) -> Log:
    """Return the cleaned log with what cleaning masked for long as findings."""
    kinds: dict[str, tuple[Kind, str]] = {
        "frozen": ("stuck", "one value is repeated while others change"),
        "out of range": ("inconsistent", "no engine and no atmosphere shows such values"),
    }
    found = []
    for entry in log.audit.entries:
        if entry.action != "masked" or entry.reason not in kinds:
            continue
        of_unit = any(
            each.channel == entry.channel and each.kind == "unit" for each in log.findings
        )
        for start_s, stop_s in () if of_unit else entry.spans_s:
            span_s = max(start_s, float(log.time_s[0])), min(stop_s, float(log.time_s[-1]))
            if span_s[1] > span_s[0]:
                kind, text = kinds[entry.reason]
                found.append(log.finding(kind, entry.channel, text, span_s))
    return replace(log, findings=(*log.findings, *found)) if found else log


def update_interval(values: FloatArray) -> float:
    """Samples between two changes of a channel, the median weighted by the size of the changes.

    1 for a channel that is measured at every sample, N for one that is held for N. A slow channel
    whose changes are all of one size shows its quantisation and nothing else: 1.
    """
    known = np.flatnonzero(np.isfinite(values))
    step = np.abs(np.diff(values[known]))
    changed = np.flatnonzero(step > 0.0)
    if len(changed) < 3:
        return 1.0
    size, gap = step[changed][1:], np.diff(known[1:][changed])
    if np.mean(np.abs(size - np.median(size)) < _ONE_SIZE * np.median(size)) > _QUANTISED:
        return 1.0
    order = np.argsort(gap)
    middle = np.searchsorted(np.cumsum(size[order]), 0.5 * np.sum(size))
    return float(gap[order][min(int(middle), len(gap) - 1)])


def rounding_step(values: FloatArray) -> float:
    """Step of the grid that repeated values lie on; 0 of a channel whose values lie on none.

    Of gaps between values that lie on none a tenth is so near to a multiple of the smallest.
    """
    repeated = np.unique(values[:-1][values[:-1] == values[1:]])
    gaps = np.diff(repeated)
    if len(gaps) < _GAPS:
        return 0.0
    step = float(np.quantile(gaps, 0.1))
    near = np.abs(gaps / step - np.round(gaps / step)) < _NEAR
    return step if np.mean(near) > _ON_GRID else 0.0


def _units(log: Log) -> Iterator[Finding]:
    """Channels outside of their physical range that another unit brings back into it."""
    for name in log.recorded((*CHANNELS, *log.declared)):
        known = log[name][np.isfinite(log[name])]
        channel = log.channel(name)
        word = _unit(channel, known)
        if word:
            text = f"looks like {word}: median {np.median(known):.4g} {channel.unit}"
            yield log.finding("unit", name, text)


def _unit(channel: Channel, known: FloatArray) -> str:
    """Name the unit that fits where the canonical one does not; empty where it does, or none."""
    high = float(robust_range(known)[1])
    if channel.name in SPOOLS and 0.2 < high < _FRACTION:
        return "a fraction"
    if not np.mean(out_of_range(channel, known)) > _MANY:
        return ""
    if channel.name in SPOOLS and high > 2.0 * channel.high:
        return "rpm"
    return next(
        (
            words
            for words, unit in conversions(channel.name).items()
            if not np.mean(out_of_range(channel, to_canonical(known, unit))) > _FEW
        ),
        "",
    )


# What a moving aircraft shows: while one of the others changes by so much, none stays exactly.
_AIR = ("Mach", "ALT_ft", "CAS_kt", "TAS_kt", "SAT_C", "TAT_C", "dT_C")
_AIR_MOVES: Mapping[str, float] = {
    "ALT_ft": 1500.0, "Mach": 0.06, "CAS_kt": 30.0, "TAS_kt": 30.0, "SAT_C": 4.0, "TAT_C": 5.0,
}  # fmt: skip
# Channel -> those that cannot move by `_AIR_MOVES` while it stays.
_CANNOT_STAY: Mapping[str, tuple[str, ...]] = {
    "ALT_ft": ("SAT_C",),
    "Mach": ("ALT_ft", "CAS_kt", "TAS_kt"),
    "CAS_kt": ("ALT_ft", "Mach", "TAS_kt"),
    "TAS_kt": ("ALT_ft", "Mach", "CAS_kt"),
    "SAT_C": ("ALT_ft",),
    "TAT_C": ("ALT_ft",),
}
_STUCK_S = 20.0
_WHOLE = 0.98  # share of a log from which on a stretch has neither beginning nor end inside it


def _stuck_air(log: Log) -> Iterator[Finding]:
    """Air data that repeat one value while the aircraft climbs, descends or changes speed.

    Or whose noise stops in flight.
    """
    for name, others in _CANNOT_STAY.items():
        if name not in log.channels:
            continue
        constant = _without_noise(log, name)
        against = [other for other in others if other in log.channels]
        starts, stops = repeats(log[name])
        long = (stops - starts) * log.dt_s >= _STUCK_S
        for start, stop in zip(starts[long], stops[long], strict=True):
            moves = any(_moves(log, each, start, stop) for each in against)
            constant[start:stop] |= moves & _measurable(log, name, int(start), int(stop))
        yield from (_stuck(log, name, start, stop) for start, stop in spans(constant))


def _measurable(log: Log, name: str, start: int, stop: int) -> bool:
    """Whether an airspeed that stays below its threshold is contradicted by flight above it."""
    if name not in _AIRBORNE or log[name][start] > _AIRBORNE[name]:
        return True
    others = [other for other in _AIRBORNE if other != name and other in log.channels]
    part = [log[other][start:stop] > 1.5 * _AIRBORNE[other] for other in others]
    return any(float(np.mean(each)) > 0.5 for each in part)


def _without_noise(log: Log, name: str) -> BoolArray:
    """Samples (time,) in flight at which a channel that has noise repeats one value."""
    flies, found = _airborne(log), np.zeros(len(log), dtype=np.bool_)
    for start, stop in unnatural(log, name, _STUCK_S):
        found[start:stop] = bool(flies[start:stop].all())
    return found


def _moves(log: Log, name: str, start: int, stop: int) -> bool:
    part = log[name][start:stop]
    known = part[np.isfinite(part)]
    if len(known) < 0.5 * len(part) or len(np.unique(known[:: max(1, len(known) // 50)])) < 5:
        return False
    return bool(np.ptp(robust_range(known)) > _AIR_MOVES[name])


def _stuck(log: Log, name: str, start: int, stop: int) -> Finding:
    text = f"stays at {log[name][start]:.4g} while others move"
    return log.finding("stuck", name, text, _span_s(log, start, stop))


def _span_s(log: Log, start: int, stop: int) -> tuple[float, float] | None:
    """Times of rows `start:stop`; None where they are the whole log."""
    if stop - start > _WHOLE * len(log):
        return None
    return float(log.time_s[start]), float(log.time_s[stop - 1])


# Tolerances of the relations, at which they fail: Mach (plus a share of it), kt, K. About twice the
# errors of instruments and of their position; what flights and weather differ by, for ISA.
_MACH_TOLERANCE, _MACH_SHARE, _TAS_TOLERANCE, _TAT_TOLERANCE = 0.01, 0.025, 12.0, 6.0
_ISA_TOLERANCE = 15.0  # K: half of the change of the deviation from ISA over one flight
# Pitot pressure is too low to be measured below.
_AIRBORNE = {"CAS_kt": 80.0, "TAS_kt": 80.0, "Mach": 0.13}
_FAILED = 0.1  # share of the airborne samples from which on a relation fails
_SCALES = (0.5, 2.0)
_EXACT = 0.4  # part of the tolerances that a right conversion leaves
_STOPPED_S, _EXPLAINED = 60.0, 0.8  # a constant channel, and the share of a failure in that time

Relation = tuple[str, ...]


def unchecked_air(log: Log) -> tuple[str, ...]:
    """Altitude and airspeeds of a log that no other air data can contradict closely."""
    there = log.recorded(("ALT_ft", "Mach", "CAS_kt", "TAS_kt"))
    related = {name for names, _ in _relations(log.channels) if names != _ISA for name in names}
    return tuple(name for name in there if name not in related)


def _close(log: Log, flies: BoolArray) -> set[str]:
    """Air data that stand in a relation which holds closely; the weather's is too wide for that."""
    relations, loose = _failed(log.channels, flies, _EXACT)
    return {name for names in relations if names not in {*loose, _ISA} for name in names}


def _failed(
    channels: Mapping[str, FloatArray], flies: BoolArray, part: float = 1.0
) -> tuple[dict[Relation, BoolArray], set[Relation]]:
    """Where each relation is broken (time,), and those that are for too long.

    `part` scales the tolerances, `flies` (time,) are the samples that can be tested.
    """
    broken, failed = {}, set()
    for names, residual in _relations(channels):
        testable = np.isfinite(residual) & (flies if names != _ISA else True)
        broken[names] = testable & (np.abs(residual) > part)
        if broken[names].sum() > _FAILED * testable.sum():
            failed.add(names)
    return broken, failed


def _air(log: Log) -> Iterator[Finding]:
    """The channel that stands in every failed relation of air data and in no other.

    Named is, in this order: a channel that is constant where they fail; another unit or a factor
    that mends them all, if it is one channel's alone; the suspected ones, masked where they fail in
    one stretch and hold elsewhere.
    """
    flies = _airborne(log)
    broken, failed = _failed(log.channels, flies)
    if not failed:
        return
    suspected = set.intersection(*map(set, failed)) - _close(log, flies)
    suspected = suspected or set.intersection(*map(set, failed)) or set().union(*failed)
    wrong = np.any([broken[names] for names in failed], axis=0)
    stopped = list(_stopped(log, suspected, wrong))
    mended = list(_mended(log, suspected, flies))
    if stopped:
        yield from stopped
    elif len({name for name, *_ in mended}) == 1:
        name, kind, text = mended[0]
        yield log.finding(kind, name, text)
    else:
        order = tuple(name for name in _AIR if name in suspected)
        if len(order) == 1:
            text = f"contradicts the other air data{_mach_ratio(log)}"
            yield log.finding("inconsistent", order[0], text, _stretch_s(log, wrong, flies))
        else:
            text = f"{' and '.join(order)} contradict each other{_mach_ratio(log)}"
            yield log.finding("inconsistent", order[0], text, partner=order[1])


def _stretch_s(log: Log, wrong: BoolArray, flies: BoolArray) -> tuple[float, float] | None:
    """The stretch that holds all that is wrong, if most of it is, and flight goes on outside."""
    rows = np.flatnonzero(wrong)
    inside = slice(rows[0], rows[-1] + 1)
    mostly = np.mean(wrong[inside][flies[inside]]) > _EXPLAINED
    outside = flies.sum() - flies[inside].sum()
    if not mostly or outside < _FAILED * flies.sum():
        return None
    return _span_s(log, int(rows[0]), int(rows[-1]) + 1)


def _stopped(log: Log, suspected: set[str], wrong: BoolArray) -> Iterator[Finding]:
    """Accused channels that repeat one value for most of the time in which relations fail."""
    for name in (each for each in _AIR if each in suspected):
        for start, stop in zip(*repeats(log[name]), strict=True):
            long = (stop - start) * log.dt_s > _STOPPED_S
            if long and wrong[start:stop].sum() > _EXPLAINED * wrong.sum():
                yield _stuck(log, name, int(start), int(stop))


def _mended(log: Log, suspected: set[str], flies: BoolArray) -> Iterator[tuple[str, Kind, str]]:
    """Conversions of one suspected channel with which no relation fails."""
    for name in (each for each in _AIR if each in suspected):
        level = f"median {np.nanmedian(log[name]):.4g}"
        tried: list[tuple[Kind, str, Unit]] = [
            ("unit", f"looks like {words}: {level}", unit)
            for words, unit in conversions(name).items()
        ]
        tried += [
            ("scale", f"looks scaled by {1.0 / scale:g}: {level}", Unit("", scale))
            for scale in _SCALES
        ]
        for kind, text, unit in tried:
            channels = {**log.channels, name: to_canonical(log[name], unit)}
            if not _failed(channels, flies, _EXACT)[1]:
                yield name, kind, text


def _mach_ratio(log: Log) -> str:
    if not {"CAS_kt", "ALT_ft", "Mach"} <= log.channels.keys():
        return ""
    expected = mach_of_cas(log["CAS_kt"], log["ALT_ft"])
    flies = expected > _AIRBORNE["Mach"]
    if not flies.any():
        return ""
    ratio = float(np.nanmedian(log["Mach"][flies] / expected[flies]))
    return f": Mach is {ratio:.2g} times what CAS and altitude say"


_ISA: Relation = ("SAT_C", "ALT_ft")


def _relations(channels: Mapping[str, FloatArray]) -> Iterator[tuple[Relation, FloatArray]]:
    """The channels of each relation that there are, and its residual over its tolerance (time,)."""
    there = {name: channels[name] for name in _AIR if name in channels}
    mach, alt, static = (there.get(name) for name in ("Mach", "ALT_ft", "SAT_C"))
    given: Relation = ("SAT_C",)
    if static is None and alt is not None and "dT_C" in channels:
        static, given = isa(alt)[0] - KELVIN + channels["dT_C"], ("dT_C", "ALT_ft")
    if mach is not None and alt is not None and "CAS_kt" in there:
        expected = mach_of_cas(np.abs(there["CAS_kt"]), alt)
        yield (
            ("CAS_kt", "ALT_ft", "Mach"),
            (expected - mach) / (_MACH_TOLERANCE + _MACH_SHARE * expected),
        )
    if mach is not None and static is not None and "TAS_kt" in there:
        sound_kt = SOUND_KT * np.sqrt(np.maximum(static + KELVIN, 1.0) / T0_K)
        yield ("TAS_kt", "Mach", *given), (there["TAS_kt"] - sound_kt * mach) / _TAS_TOLERANCE
    if mach is not None and static is not None and "TAT_C" in there:
        total = (static + KELVIN) * (1.0 + 0.2 * mach**2)
        yield ("TAT_C", "Mach", *given), (there["TAT_C"] + KELVIN - total) / _TAT_TOLERANCE
    if alt is not None and "SAT_C" in there:
        deviation = there["SAT_C"] + KELVIN - isa(alt)[0]
        known = deviation[np.isfinite(deviation)]
        middle = 0.5 * (known.max() + known.min()) if len(known) else 0.0
        yield _ISA, (deviation - middle) / _ISA_TOLERANCE


def _airborne(log: Log) -> BoolArray:
    """Samples in which any airspeed shows a flight: one of them may be at fault."""
    flying = [log[name] > limit for name, limit in _AIRBORNE.items() if name in log.channels]
    return np.any(flying, axis=0) if flying else np.ones(len(log), dtype=np.bool_)
