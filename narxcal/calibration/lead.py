"""Simple models of one output: the baselines, which lead where held-out logs say so.

Each is driven by the steady-state values `ss` (time, n_out) of all outputs, and runs free:

| kind | y(k) |
|---|---|
| steady_state | ss(k) |
| first_order | y(k-1) + g (ss(k) - y(k-1)), g = push where ss(k) > y(k-1), else pull |
| arx | sum_i a_i y(k-i) + sum_i B_i ss(k-i) + c, i from 0 in the second sum |
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, Self

import numpy as np

from narxcal.support.arrays import FloatArray
from narxcal.support.compiled import compiled
from narxcal.support.errors import ModelError

Kind = Literal["steady_state", "first_order", "arx"]
KINDS: tuple[Kind, ...] = ("steady_state", "first_order", "arx")


@dataclass(frozen=True)
class Lead:
    """A simple model of one output: `channel` is its column among the outputs.

    `push` and `pull` are gains per sample of a first-order lag; `poles` (order,), `gains`
    (order + 1, n_out) and `offset` those of an ARX model.
    """

    kind: Kind
    channel: int
    push: float = 1.0
    pull: float = 1.0
    poles: tuple[float, ...] = ()
    gains: tuple[tuple[float, ...], ...] = ()
    offset: float = 0.0

    def started(self, ss: FloatArray, first: float) -> LeadState:
        """State at a sample with steady-state values `ss` (n_out,) and output `first`.

        The past was constant, as in a free run from equilibrium.
        """
        order = max(len(self.poles), 1)
        return LeadState(self, np.full(order, first), np.tile(ss, (order, 1)))

    def simulate(self, ss: FloatArray, first: float) -> FloatArray:
        """Free run (time,) over `ss` (time, n_out) from the output `first`."""
        later = self.started(ss[0], first).advance(ss[1:])
        return np.concatenate([[first], later])

    def poles_of(self) -> FloatArray:
        """Moduli of the poles at constant inputs."""
        if self.kind == "first_order":
            return np.abs([1.0 - self.push, 1.0 - self.pull])
        roots = np.roots([1.0, *(-pole for pole in self.poles)])
        return np.abs(np.asarray(roots, dtype=np.complex128))

    def predict(self, ss: FloatArray, measured: FloatArray) -> FloatArray:
        """One step ahead (time,) from measured values (time,); NaN where the past is unknown."""
        result = np.full(len(measured), np.nan)
        for k in range(1, len(measured)):
            rows = np.maximum(np.arange(k - 1, k - 1 - max(len(self.poles), 1), -1), 0)
            state = LeadState(self, measured[rows].copy(), ss[rows].copy())
            result[k] = state.advance(ss[k : k + 1])[0]
        return result

    def to_json(self) -> dict[str, Any]:
        """JSON-able."""
        return {
            "kind": self.kind,
            "channel": self.channel,
            "push": self.push,
            "pull": self.pull,
            "poles": list(self.poles),
            "gains": [list(row) for row in self.gains],
            "offset": self.offset,
        }

    @classmethod
    def from_json(cls, stored: Mapping[str, Any]) -> Self:
        """Inverse of `to_json`; `ModelError` for a kind that is none or a number that is none."""
        if stored["kind"] not in KINDS:
            raise ModelError(f"expected a lead of kind {', '.join(KINDS)}, found {stored['kind']}")
        return cls(
            stored["kind"],
            int(stored["channel"]),
            float(stored["push"]),
            float(stored["pull"]),
            tuple(float(pole) for pole in stored["poles"]),
            tuple(tuple(float(gain) for gain in row) for row in stored["gains"]),
            float(stored["offset"]),
        )


class LeadState:
    """Past outputs (order,) and steady-state values (order, n_out), newest first."""

    def __init__(self, lead: Lead, past: FloatArray, drive: FloatArray) -> None:
        self.lead, self.past, self.drive = lead, past, drive

    def correct(self, value: float) -> None:
        """Replace the newest output by a measured one; NaN keeps the model's own."""
        if np.isfinite(value):
            self.past[0] = value

    def advance(self, ss: FloatArray) -> FloatArray:
        """Outputs (n,) at the next samples, whose steady-state values are `ss` (n, n_out)."""
        lead = self.lead
        if not len(ss):
            return np.empty(0)
        order = len(self.past)
        rows = np.concatenate([self.drive[::-1], ss])
        own = rows[order:, lead.channel]
        if lead.kind == "steady_state":
            y = own.copy()
        elif lead.kind == "first_order":
            y = _lagged(own, self.past[0], lead.push, lead.pull)
        else:
            forced = np.full(len(ss), lead.offset)
            for i, gain in enumerate(lead.gains):
                forced += rows[order - i : len(rows) - i] @ np.array(gain)
            y = _recursive(forced, np.array(lead.poles), self.past)
        self.past = np.concatenate([y[::-1], self.past])[:order]
        self.drive = rows[::-1][:order].copy()
        return y


@compiled
def _lagged(target: FloatArray, y: float, push: float, pull: float) -> FloatArray:
    """First-order lag towards `target` (n,) from `y`."""
    found = np.empty(len(target))
    for k in range(len(target)):
        ahead = target[k] - y
        y += (push if ahead > 0.0 else pull) * ahead
        found[k] = y
    return found


@compiled
def _recursive(forced: FloatArray, poles: FloatArray, past: FloatArray) -> FloatArray:
    """y(k) = forced(k) + sum_i poles_i y(k-i), from past outputs, newest first."""
    history = past.copy()
    found = np.empty(len(forced))
    for k in range(len(forced)):
        y = forced[k]
        for i in range(len(poles)):
            y += poles[i] * history[i]
        for i in range(len(history) - 1, 0, -1):
            history[i] = history[i - 1]
        history[0] = y
        found[k] = y
    return found
