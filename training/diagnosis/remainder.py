r"""Where what no effect explains lies, and how large it is there.

What the nuisances leave is sorted over power, altitude and time of samples at rest, and over the
phases of moves. In a bin, its mean over units, m +- t s / sqrt(n) by Student's distribution, is
beyond noise and build where its nearer end is farther from 0 than the standard deviation that what
builds differ by, N, has there, (mean of sum_k N_k^2)^(1/2), with a thousandth of the range. Offsets
and starts are of a form that is known, and taken off: nothing that is left can be theirs.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np
from scipy import stats

from narxcal.channels import symbol
from narxcal.effects.base import unit
from narxcal.support.arrays import BoolArray, FloatArray, IntArray
from training.diagnosis.budget import Phases
from training.diagnosis.fit import Frame
from training.diagnosis.metric import TOLERANCE, Record
from training.diagnosis.nuisances import BUILD, SMALL

_BINS: Final = 5
_FEWEST_S: Final = 5.0  # of a bin in a unit
_LEVEL: Final = 0.95  # of Student's distribution: a 90 % interval
_LEFT: Final = 0.5  # of what builds differ by, RMS: most nulls leave less (docs/blind.md)
_REST: Final = "steady"  # the phase in which nothing moves


class _Sorted(NamedTuple):
    """Numbers of bins (flights, time), -1 for none; what they are along, and words of each."""

    along: str
    bins: IntArray
    words: tuple[str, ...]


def largest_left(frame: Frame, phases: Phases) -> str:
    """The place of the most that is beyond noise and build, in words; empty without any.

    Nuisances that imitate a part of it spread the rest: said is how large the gap itself is.
    """
    record, left, allowed = frame.record, frame.cleaned(frame.none), _allowed(frame)
    most, said = 0.0, ""
    for each in _sorted(record, phases):
        for c, name in enumerate(record.flights.signals.outputs):
            mean, beyond, count = _bins(record, left[..., c], allowed[..., c], each, c)
            energy = float((count * mean**2)[beyond].sum()) / record.span[c] ** 2
            if energy > most:
                whole = _bins(record, record.gap[..., c], allowed[..., c], each, c)[0]
                most, said = energy, _said(name, each, whole)
    return said or _throughout(frame)


def _allowed(frame: Frame) -> FloatArray:
    """Variance (flights, time, outputs) of what builds differ by, and nobody would call a gap."""
    of_build = np.isin(frame.nuisances.kind, (BUILD, SMALL))
    columns = frame.nuisances.columns[of_build]
    return np.asarray((columns**2).sum(axis=0) + (TOLERANCE * frame.record.span) ** 2)


def left_of_build(frame: Frame) -> tuple[FloatArray, FloatArray]:
    """RMS (outputs,) of what the nuisances leave beyond noise, and over that of build."""
    known, left = frame.record.known, frame.cleaned(frame.none)
    square = np.mean(left**2, axis=(0, 1), where=known) - frame.record.noise**2
    rms = np.sqrt(np.maximum(square, 0.0))
    return rms, rms / np.sqrt(np.mean(_allowed(frame), axis=(0, 1), where=known))


def _throughout(frame: Frame) -> str:
    """The output of which most is left without a place, by its root mean square."""
    rms, of_build = left_of_build(frame)
    c = int(np.argmax(of_build))
    if of_build[c] <= (_LEFT if frame.nuisances.of_build else 1.0):
        return ""
    name = frame.record.flights.signals.outputs[c]
    return f"a {symbol(name)} error of {rms[c]:.2g} {unit(name)} RMS in no one place"


def _sorted(record: Record, phases: Phases) -> Iterator[_Sorted]:
    """All that an error is looked for along."""
    flights, signals = record.flights, record.flights.signals
    rest = phases.index == phases.names.index(_REST)
    speed = f"{unit(signals.outputs[0])} {symbol(signals.outputs[0])}"
    along = {"power": (flights.y[..., 0], "at {:.0f} " + speed)}
    if "ALT_ft" in signals.active:
        along["altitude"] = flights.u[..., signals.u("ALT_ft")], "at {:.0f} ft"
    time_min = np.arange(rest.shape[1]) * signals.dt_s / 60.0
    along["time"] = np.broadcast_to(time_min, rest.shape), "{:.0f} min into a flight"
    for name, (values, text) in along.items() if rest.any() else ():
        edges = np.linspace(values[rest].min(), values[rest].max(), _BINS + 1)
        index = np.searchsorted(edges[1:-1], values, side="right")
        middles = 0.5 * (edges[1:] + edges[:-1])
        yield _Sorted(name, np.where(rest, index, -1), tuple(map(text.format, middles)))
    moves = tuple(f"in the {p} of a {m}" for m, _, p in (n.partition("_") for n in phases.names))
    yield _Sorted("", np.where(rest, -1, phases.index), moves)


def _bins(
    record: Record, left: FloatArray, allowed: FloatArray, along: _Sorted, c: int
) -> tuple[FloatArray, BoolArray, FloatArray]:
    """Mean over units of each bin, whether that is beyond noise and build, and its samples."""
    use = record.known[..., c] & (along.bins >= 0)
    shape = (record.units, len(along.words))
    place = np.ravel_multi_index((record.unit[use], along.bins[use]), shape)
    count, total, prior = (
        np.bincount(place, each, record.units * shape[1]).reshape(shape)
        for each in (np.ones(len(place)), left[use], allowed[use])
    )
    there = count >= _FEWEST_S / record.flights.signals.dt_s
    units = there.sum(axis=0)
    each = np.where(there, total / np.maximum(count, 1.0), 0.0)
    mean = each.sum(axis=0) / np.maximum(units, 1)
    spread = ((each - mean) ** 2 * there).sum(axis=0) / np.maximum(units - 1, 1)
    reach = stats.t.ppf(_LEVEL, np.maximum(units - 1, 1)) * np.sqrt(spread / np.maximum(units, 1))
    build = np.sqrt(prior.sum(axis=0) / np.maximum(count.sum(axis=0), 1.0))
    return mean, (units > 1) & (np.abs(mean) - reach > build), count.sum(axis=0)


def _said(name: str, along: _Sorted, mean: FloatArray) -> str:
    """The largest mean, its place, and whether it grows towards it from the other end."""
    size = np.abs(mean)
    at = int(np.argmax(size))
    grows = at == len(size) - 1 and int(np.argmin(size)) == 0 and along.along
    words = f"a{' steady' if along.along else 'n'} {symbol(name)} error"
    words += f" that grows with {along.along}" if grows else ""
    return f"{words}, {float(f'{mean[at]:.2g}'):+g} {unit(name)} {along.words[at]}"
