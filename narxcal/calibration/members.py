"""Simple models of single outputs that take part in a calibration's mixture, in one compiled step.

    y_o(k) = (1 - sum_i w_i) y_own,o(k) + sum_i w_i y_i(k)      over the members i of output o

`y_own` are the outputs of the calibration's own model. Each member is driven by the steady-state
values `ss` (time, n_out) of all outputs, and runs free:

| kind | y(k) |
|---|---|
| steady_state | ss(k) |
| first_order | y(k-1) + g (ss(k) - y(k-1)), g = push where ss(k) > y(k-1), else pull |
| arx, output_error | sum_i a_i y(k-i) + sum_i B_i ss(k-i) + c, i from 0 in the second sum |

The last two are one equation; ARX is fitted to the next sample, output error to the free run. With
stable members and a stable model of its own the mixture is stable: it feeds nothing back.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple, Self

import numpy as np

from narxcal.support.arrays import BoolArray, FloatArray, IntArray
from narxcal.support.compiled import compiled
from narxcal.support.settings import read_stored

Kind = Literal["steady_state", "first_order", "arx", "output_error"]


@dataclass(frozen=True)
class Member:
    """A simple model of one output: `channel` is its column among the outputs.

    `push` and `pull` are gains per sample of a first-order lag; `poles` (order,), `gains`
    (order + 1, n_out) and `offset` those of a linear model. `weight` is its share of the output.
    """

    kind: Kind
    channel: int
    push: float = 1.0
    pull: float = 1.0
    poles: tuple[float, ...] = ()
    gains: tuple[tuple[float, ...], ...] = ()
    offset: float = 0.0
    weight: float = 1.0

    def simulate(self, ss: FloatArray, first: float) -> FloatArray:
        """Free run (time,) over `ss` (time, n_out) from the output `first`."""
        state = Members((self,)).started(ss[0], np.full(ss.shape[1], first))
        return np.concatenate([[first], state.advance(ss[1:])[:, 0]])

    def poles_of(self) -> FloatArray:
        """Moduli of the poles at constant inputs."""
        if self.kind == "first_order":
            return np.abs([1.0 - self.push, 1.0 - self.pull])
        roots = np.roots([1.0, *(-pole for pole in self.poles)])
        return np.abs(np.asarray(roots, dtype=np.complex128))

    def to_json(self) -> dict[str, Any]:
        return asdict(self)

    @classmethod
    def from_json(cls, stored: Mapping[str, Any]) -> Self:
        """Inverse of `to_json`; `ModelError` for a kind that is none or a number that is none."""
        return read_stored(cls, stored, "members")

    def fits(self, outputs: int) -> bool:
        """Whether shapes and weight are those of a member of a model of so many outputs."""
        shaped = len(self.gains) in (0, len(self.poles) + 1)
        shaped = shaped and {len(row) for row in self.gains} <= {outputs}
        return shaped and 0 <= self.channel < outputs and 0.0 <= self.weight <= 1.0


class _Packed(NamedTuple):
    """Members as `_advance` takes them, (members, ...) each, padded to the longest order."""

    channel: IntArray
    lag: BoolArray
    gain: FloatArray
    poles: FloatArray
    drive: FloatArray
    offset: FloatArray


@dataclass(frozen=True)
class Members:
    """The members of a mixture."""

    members: tuple[Member, ...] = ()

    def started(self, ss: FloatArray, first: FloatArray) -> MembersState:
        """State at a sample with steady-state values `ss` (n_out,) and outputs `first` (n_out,)."""
        depth = max((len(one.poles) for one in self.members), default=0)
        depth = max(depth, 1)
        channels = [one.channel for one in self.members]
        past = np.tile(first[channels][:, None], (1, depth))
        return MembersState(self, past, np.tile(ss, (depth, 1)))

    def mixed(self, own: FloatArray, found: FloatArray) -> FloatArray:
        """Outputs (time, n_out) from the calibration's `own` and the members' (time, members)."""
        share = self.rest(own.shape[1])
        added = np.zeros_like(own)
        for k, one in enumerate(self.members):
            added[:, one.channel] += one.weight * found[:, k]
        # Where members are the whole output, the own model must not count even if it is NaN.
        return np.where(share > 0.0, share * own, 0.0) + added

    def rest(self, outputs: int) -> FloatArray:
        """Share (n_out,) of the calibration's own model in each of its `outputs`."""
        share = np.ones(outputs)
        for one in self.members:
            share[one.channel] -= one.weight
        return np.where(share > _NOTHING, share, 0.0)

    def predict(self, ss: FloatArray, measured: FloatArray) -> FloatArray:
        """One step ahead (time, members) from `measured` (time, n_out); NaN where unknown."""
        ahead = self.started(ss[0], measured[0]).advance(ss[1:], measured[1:])
        return np.concatenate([np.full((1, len(self.members)), np.nan), ahead])

    @cached_property
    def packed(self) -> _Packed:
        count = len(self.members)
        depth = max((len(one.poles) for one in self.members), default=0)
        width = max((len(row) for one in self.members for row in one.gains), default=0)
        width = max(width, *(one.channel + 1 for one in self.members), 1)
        poles = np.zeros((count, max(depth, 1)))
        drive = np.zeros((count, max(depth, 1) + 1, width))
        for m, one in enumerate(self.members):
            poles[m, : len(one.poles)] = one.poles
            for i, row in enumerate(one.gains):
                drive[m, i, : len(row)] = row
            if one.kind == "steady_state":
                drive[m, 0, one.channel] = 1.0
        return _Packed(
            np.array([one.channel for one in self.members], dtype=np.int64),
            np.array([one.kind == "first_order" for one in self.members]),
            np.array([(one.push, one.pull) for one in self.members]).reshape(count, 2),
            poles,
            drive,
            np.array([one.offset for one in self.members]),
        )


_NOTHING = 1e-12  # of an output: rounding of weights that sum to one


class MembersState:
    """Past outputs (members, depth) and steady-state values (depth, n_out), newest first."""

    def __init__(self, model: Members, past: FloatArray, drive: FloatArray) -> None:
        self.model, self.past, self.drive = model, past, drive

    def correct(self, outputs: FloatArray) -> None:
        """Replace the newest outputs by measured ones (n_out,); NaN keeps the members' own."""
        for m, one in enumerate(self.model.members):
            if np.isfinite(outputs[one.channel]):
                self.past[m, 0] = outputs[one.channel]

    def advance(self, ss: FloatArray, measured: FloatArray | None = None) -> FloatArray:
        """Outputs (n, members) at the next samples, with steady-state values `ss` (n, n_out).

        `measured` (n, n_out) replaces the outputs after each sample, NaN included.
        """
        if not len(self.model.members) or not len(ss):
            return np.empty((len(ss), len(self.model.members)))
        depth = len(self.drive)
        rows = np.concatenate([self.drive[::-1], ss])
        known = np.empty((0, ss.shape[1])) if measured is None else measured
        found = _advance(self.model.packed, self.past, rows, known)
        self.drive = rows[::-1][:depth].copy()
        return found


@compiled
def _advance(
    packed: _Packed, past: FloatArray, rows: FloatArray, measured: FloatArray
) -> FloatArray:
    """Outputs (n, members) over `rows` (depth + n, n_out); changes `past` in place."""
    channel, lag, gain, poles, drive, offset = packed
    count, depth = past.shape
    samples = len(rows) - depth
    found = np.empty((samples, count))
    for m in range(count):
        for k in range(samples):
            at = k + depth
            if lag[m]:
                ahead = rows[at, channel[m]] - past[m, 0]
                y = past[m, 0] + (gain[m, 0] if ahead > 0.0 else gain[m, 1]) * ahead
            else:
                y = offset[m]
                for i in range(depth + 1):
                    for o in range(drive.shape[2]):
                        y += drive[m, i, o] * rows[at - i, o]
                for i in range(depth):
                    if poles[m, i] != 0.0:  # of a shorter order, where the past may be unknown
                        y += poles[m, i] * past[m, i]
            for i in range(depth - 1, 0, -1):
                past[m, i] = past[m, i - 1]
            past[m, 0] = measured[k, channel[m]] if len(measured) else y
            found[k, m] = y
    return found
