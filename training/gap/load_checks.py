"""What speaks against windows being an unlogged load: checks that need no threshold in size.

Errors of a simulator come in levels, too: where the lever goes, which switch is set, how high it
is. A load is told from them by how it comes: at any time, at once, on several channels, and not by
the clock.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d
from scipy.stats import binom, t

from narxcal.effects.running import Flights
from narxcal.support.arrays import FloatArray, spans
from training.gap.levels import Found, Levels, contrast

WITNESSES = 2  # flights in which the load was on
_BEFORE, _AFTER = 4, 3  # blocks that tell a level next to a change, and how long it may take
_REACH = 2  # blocks by which an edge may be off
_SHARP, _MOSTLY = (0.5, 1.6), 0.7  # of the shift that comes at once, and at how many edges
_TYPICAL = 0.6
_SPREAD = 0.28  # of the shift: how far from on and off the levels may scatter
_BY_CHANCE, _WITH_LEVER = 0.1, 0.9  # edges at moves: how rarely by chance, how often if of them
_SWITCHED = 4.0  # blocks between a logged switch and what follows it
_TURNS, _PHASE, _ALIKE = 3, 0.08, 0.3  # periods that make a clock, and how exact it is
_BESIDE = 0.02  # of what the strongest channel tells: a second one that tells as much is shifted
_PROPORTION = 0.85  # cosine from which on a shift goes as the driver's; of loads it is below 0.75
_EDGES, _CHANCE = 4, 0.002  # edges that tell less than that, and how rarely they do by chance


@dataclass(frozen=True, eq=False)
class Edge:
    """One change of a flight at a `block`; `clear` if all around is known; `jump` as shares.

    `sign` is 1 where windows begin and -1 where they end, `seen` the block at which the jump is
    largest.
    """

    flight: int
    block: int
    clear: bool
    jump: float
    sign: float
    seen: int


def against(found: Found, levels: Levels, switched: Sequence[NDArray[np.float64]]) -> str:
    """Why it is no unlogged load; empty where nothing speaks against it.

    `switched` holds the blocks of each flight at which a logged switch changes.
    """
    edges, by_chance = edges_of(found, levels)
    if np.count_nonzero(found.on.any(axis=1)) < min(WITNESSES, len(found.on)):
        return "windows in one flight alone are no evidence"
    if _follow(edges, switched):
        return "the windows follow a logged switch"
    if _by_the_clock(found, levels):
        return "the windows come by the clock: a cycle, no switch"
    if _one_channel(found, levels, edges):
        return "one channel alone is shifted: a sensor or its wiring, no load"
    if _spread(found, levels) > _SPREAD:
        return "the levels scatter too much to be on or off"
    return _edges_against(edges, by_chance)


def as_the_lever(shift: FloatArray, flights: Flights) -> bool:
    """Whether a `shift` (outputs,) is in the proportion in which the driver moves the outputs.

    That is a lever that arrives elsewhere, or a fuel meter, and no load: what takes air or power
    off a spool shifts outputs against one another, and those that a control holds hardly at all.
    Only both spools' speeds tell.
    """
    signals = flights.signals
    if not {"N1_pct", "N2_pct"} <= set(signals.outputs):
        return False
    flown = np.arange(flights.u.shape[1]) < flights.lengths[:, None]
    driver, y = flights.u[..., signals.u(signals.driver)][flown], flights.y[flown]
    slope = (driver - driver.mean()) @ (y - y.mean(axis=0))
    mine, own = (each / (signals.high - signals.low) for each in (shift, slope))
    return bool(mine @ own > _PROPORTION * np.linalg.norm(mine) * np.linalg.norm(own))


def _edges_against(edges: Sequence[Edge], by_chance: float) -> str:
    """A load comes at any time and at once."""
    if _with_the_lever(sum(not edge.clear for edge in edges), len(edges), by_chance):
        return "the windows come and go with the lever"
    jumps = np.array([edge.jump for edge in edges if np.isfinite(edge.jump)])
    if len(jumps) < WITNESSES:
        return "no two changes can be seen at rest"
    sharp = np.mean((jumps > _SHARP[0]) & (jumps < _SHARP[1]))
    if sharp < _MOSTLY or np.median(jumps) < _TYPICAL:
        return "the changes are no sharp edges"
    return ""


def _with_the_lever(hidden: int, edges: int, by_chance: float) -> bool:
    """Whether so many edges at moves of the lever are too many, and as many as if it made them."""
    rare = binom.sf(hidden - 1, edges, by_chance) < _BY_CHANCE
    made = binom.pmf(hidden, edges, _WITH_LEVER) > binom.pmf(hidden, edges, by_chance)
    return bool(rare and made)


def edges_of(found: Found, levels: Levels) -> tuple[list[Edge], float]:
    """All edges inside the flights, and how often one would lie next to the unknown by chance."""
    edges, unclear = [], []
    for group in levels.groups:
        rows = list(group)
        known = levels.known[rows].all(axis=0)
        last = int(np.flatnonzero(known).max(initial=0)) + 1
        width = 2 * _AFTER + 1
        clear = minimum_filter1d(known, width, origin=-1)
        unclear.append(~clear[:last])
        step = np.mean(
            [contrast(found.there[f], levels.known[f], _BEFORE, _AFTER) for f in rows], axis=0
        )
        for first, stop in spans(found.on[rows[0]]):
            for block, sign in ((first, 1.0), (stop, -1.0)):
                if _AFTER < block < last - 2 * _AFTER:
                    near = np.arange(max(0, block - _REACH), block + _REACH + 1)
                    seen = sign * step[near[clear[near]]]
                    edges.append(_edge((rows[0], block, sign), near[clear[near]], seen))
    return edges, float(np.mean(np.concatenate(unclear)))


def _edge(where: tuple[int, int, float], near: NDArray[np.int_], seen: FloatArray) -> Edge:
    """The edge, as what is `seen` at the clear blocks `near` it tells."""
    flight, block, sign = where
    known = np.isfinite(seen)
    if not known.any():
        return Edge(flight, block, len(near) > 0, np.nan, sign, block)
    best = int(np.argmax(np.where(known, seen, -np.inf)))
    return Edge(flight, block, clear=True, jump=float(seen[best]), sign=sign, seen=int(near[best]))


def _follow(edges: Sequence[Edge], switched: Sequence[NDArray[np.float64]]) -> bool:
    """Whether most of the edges lie at changes of logged switches."""
    near = [bool((np.abs(switched[edge.flight] - edge.block) < _SWITCHED).any()) for edge in edges]
    return len(near) > 0 and 2 * sum(near) > len(near)


def _by_the_clock(found: Found, levels: Levels) -> bool:
    """Whether windows of about one length start at whole periods of one another, in all flights.

    Two windows of a flight are no clock.
    """
    rows = [own for group in levels.groups for own in [spans(found.on[group[0]])] if len(own) > 2]
    steps = np.array([b[0] - a[0] for own in rows for a, b in pairwise(own)], dtype=np.float64)
    if len(steps) < _TURNS:
        return False
    lengths = np.array([stop - first for own in rows for first, stop in own], dtype=np.float64)
    if np.mean(np.abs(lengths / np.median(lengths) - 1.0) < _ALIKE) < 0.6:
        return False
    for period in (float(np.quantile(steps, 0.1)), float(np.median(steps))):
        off = np.abs(steps / period - np.round(steps / period))
        if np.median(off) < _PHASE and np.mean(off < 2.0 * _PHASE) > 0.75:
            return True
    return False


def _one_channel(found: Found, levels: Levels, edges: Sequence[Edge]) -> bool:
    """Whether no second channel answers: none tells much of the windows, or jumps at their edges.

    Where the control holds one speed, a load moves the temperature far and the other speed hardly:
    that little is told from nothing by its coming and going with the windows, edge by edge.
    """
    if len(found.shift) < 2:
        return False
    known = found.left[levels.known]
    scale = np.maximum(1.4826 * np.median(np.abs(known), axis=0), 1e-9)
    told = (found.shift / scale) ** 2
    order = np.argsort(told)[::-1]
    if told[order[1]] >= _BESIDE * told[order[0]]:
        return False
    jumps = _jumps(found, levels, edges)[:, order[1:]]
    if len(jumps) < _EDGES:
        return True
    error = jumps.std(axis=0, ddof=1) / np.sqrt(len(jumps))
    surely = t.ppf(1.0 - _CHANCE / jumps.shape[1], len(jumps) - 1)
    return not bool((np.sign(found.shift[order[1:]]) * jumps.mean(axis=0) > surely * error).any())


def _jumps(found: Found, levels: Levels, edges: Sequence[Edge]) -> FloatArray:
    """Change of every channel at each edge seen at rest, on less off: (edges, channels)."""
    rest, rows = found.left + found.on[..., None] * found.shift, []
    for edge in edges:
        (group,) = (own for own in levels.groups if own[0] == edge.flight)
        steps = [contrast(rest[f], levels.known[f], _BEFORE, _AFTER)[edge.seen] for f in group]
        rows.append(edge.sign * np.mean(steps, axis=0))
    jumps = np.array(rows).reshape(len(rows), len(found.shift))
    return np.asarray(jumps[np.isfinite(jumps).all(axis=1)])


def _spread(found: Found, levels: Levels) -> float:
    """Typical distance of a block's level from off or on, in shifts."""
    away = np.abs(found.there - found.on)[levels.known]
    return 1.4826 * float(np.median(away))
