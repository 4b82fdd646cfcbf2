"""Sensor faults as they are put into a raw log, and the list of issue 29 at several sizes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from data_prep.log import Kind, Log
from narxcal.atmosphere import KELVIN, isa
from narxcal.support.arrays import FloatArray

Apply = Callable[[FloatArray, FloatArray], FloatArray]


@dataclass(frozen=True, eq=False)
class Injection:
    """A fault as it is put into a raw log: `channels`, `kind`, size, and `change(values, time_s)`.

    `begins` is the share of the log at which it begins, `ends` at which it ends.
    """

    kind: Kind
    channels: tuple[str, ...]
    size: str
    change: Apply
    begins: float = 0.0
    ends: float = 1.0

    def into(self, log: Log) -> Log:
        """The log with the fault; channels that the reader derives follow."""
        if self.channels == ("time_s",):
            return self._stretched(log)
        changed = {}
        first, last = (round(share * len(log)) for share in (self.begins, self.ends))
        part = slice(first, last)
        if self.kind == "exchanged":
            a, b = self.channels
            changed = {a: log[b], b: log[a]}
        else:
            for name in self.channels:
                changed[name] = log[name].copy()
                changed[name][part] = self.change(log[name][part], log.time_s[part])
        return _derived(log.with_channels(changed))

    def _stretched(self, log: Log) -> Log:
        """Time stamps times a factor, on the log's sampling grid."""
        factor = float(self.change(np.ones(1), np.ones(1))[0])
        time_s = np.arange(0.0, log.time_s[-1] * factor - log.time_s[0] * factor, log.dt_s)
        channels = {
            name: np.interp(time_s / factor + log.time_s[0], log.time_s, values)
            for name, values in log.channels.items()
        }
        return replace(log, time_s=time_s + log.time_s[0], channels=channels, interpolated={})


def _derived(log: Log) -> Log:
    """Temperature deviation anew from the temperature and altitude of the log."""
    if not {"SAT_C", "ALT_ft", "dT_C"} <= log.channels.keys():
        return log
    deviation = log["SAT_C"] + KELVIN - isa(log["ALT_ft"])[0]
    return log.with_channels({"dT_C": deviation})


def _dead(level: float, noise: float) -> Apply:
    draw = np.random.default_rng(5)
    return lambda x, _t: np.nanpercentile(x, level) * (1.0 + noise * draw.standard_normal(len(x)))


def _late(delay_s: float) -> Apply:
    return lambda x, t: np.asarray(np.interp(t - delay_s, t, x))


def _held(every_s: float) -> Apply:
    def change(x: FloatArray, t: FloatArray) -> FloatArray:
        size = max(1, round(every_s / float(t[1] - t[0])))
        rows: NDArray[np.intp] = (np.arange(len(x)) // size) * size
        return x[rows]

    return change


def _affine(gain: float, offset: float = 0.0) -> Apply:
    return lambda x, _t: gain * x + offset


def _drift(end: float, *, relative: bool = False) -> Apply:
    def change(x: FloatArray, t: FloatArray) -> FloatArray:
        grown = end * (t - t[0]) / (t[-1] - t[0])
        return np.asarray(x * (1.0 + grown) if relative else x + grown)

    return change


def _noise(share: float) -> Apply:
    draw = np.random.default_rng(7)
    return lambda x, _t: x + share * np.nanstd(x) * draw.standard_normal(len(x))


def _stuck(x: FloatArray, _t: FloatArray) -> FloatArray:
    return np.full_like(x, x[0])


def injections(log: Log) -> Iterator[Injection]:
    """The list of faults, each at up to three sizes; only of channels that the log has."""
    for one in _all():
        if all(name in log.channels or name == "time_s" for name in one.channels):
            yield one


def _all() -> Iterator[Injection]:
    yield from _units()
    yield from _levels()
    yield from _lost()
    for delay in (1.0, 3.0, 6.0):
        yield Injection("late", ("FF_kgph",), f"{delay:g} s", _late(delay))
    yield Injection("late", ("N2_pct",), "2 s", _late(2.0))
    yield Injection("noise", ("EGT_C",), "0.3 sd", _noise(0.3))
    yield Injection("exchanged", ("N1_pct", "N2_pct"), "", _affine(1.0))
    for factor in (0.5, 2.0):
        yield Injection("stretched", ("time_s",), f"x {factor:g}", _affine(factor))


def _levels() -> Iterator[Injection]:
    """Scales, biases and drifts."""
    for channel, gains in (("N1_pct", (1.025, 1.05, 1.1)), ("FF_kgph", (1.05, 1.1, 1.2))):
        for gain in gains:
            yield Injection("scale", (channel,), f"x {gain:g}", _affine(gain))
    for gain in (0.5, 0.8):
        yield Injection("scale", ("Mach",), f"x {gain:g}", _affine(gain))
    for bias in (50.0, 100.0):
        yield Injection("bias", ("EGT_C",), f"{bias:+g} K", _affine(1.0, bias))
    yield Injection("bias", ("N2_pct",), "+3 %", _affine(1.0, 3.0))
    for end in (50.0, 100.0, 200.0):
        yield Injection("drift", ("EGT_C",), f"to {end:+g} K", _drift(end))
    for end in (0.1, 0.2, 0.4):
        change = _drift(end, relative=True)
        yield Injection("drift", ("FF_kgph",), f"to {100.0 * end:+g} %", change, begins=0.2)


def _lost() -> Iterator[Injection]:
    """Channels that are dead, held or stuck."""
    for name in ("FF_kgph", "N1_pct"):
        for share in (1.0, 0.3, 0.1):
            begins, ends = 0.5 - share / 2.0, 0.5 + share / 2.0
            yield Injection("stuck", (name,), f"{share:g} of log", _dead(50.0, 0.01), begins, ends)
        for every in (2.0, 5.0, 10.0):
            yield Injection("held", (name,), f"{every:g} s", _held(every))
    for begins in (0.2, 0.5):
        for name in ("ALT_ft", "CAS_kt", "FF_kgph"):
            yield Injection("stuck", (name,), f"from {begins:g}", _stuck, begins)
    for name in ("CAS_kt", "Mach"):
        yield Injection("stuck", (name,), "at 0", _affine(0.0))


def _units() -> Iterator[Injection]:
    yield Injection("unit", ("EGT_C",), "K", _affine(1.0, KELVIN))
    yield Injection("unit", ("EGT_C",), "degF", _affine(1.8, 32.0))
    yield Injection("unit", ("N1_pct",), "fraction", _affine(0.01))
    yield Injection("unit", ("N2_pct",), "fraction", _affine(0.01))
    yield Injection("unit", ("N1_pct",), "rpm", _affine(160.0))
    yield Injection("unit", ("FF_kgph",), "lb/h", _affine(1.0 / 0.45359237))
    yield Injection("unit", ("Mach",), "percent", _affine(100.0))
    yield Injection("unit", ("ALT_ft",), "m", _affine(0.3048))
