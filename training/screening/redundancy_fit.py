"""Fit the bank of `redundancy` to logs, and measure what it leaves on logs left out.

A bank follows from the sum of the normal equations of its logs, so that leaving one out is a
difference of sums; scaling and robust weights are those of all logs (downdating; Golub and Van
Loan 2013, section 6.5).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from data_prep.log import Log
from narxcal.channels import CHANNELS
from narxcal.support.arrays import FloatArray, IntArray
from training.screening.levels import PRIOR_LOGS
from training.screening.redundancy import (
    FEATURES,
    STEP_S,
    STRETCHES,
    Bank,
    Corrected,
    Delays,
    Design,
    Residuals,
    Signals,
    blocks_of,
    compared,
    delays_of,
    excess,
    log_ratio,
    mate_of,
    noise_of,
    recording_of,
)
from training.screening.scatter import PRIORS, Priors, heights

MOST_FOLDS = 6
_LEAST_STEPS = 10  # of a log; fewer show no relation of channels
_RIDGE = 1e-4
_ENGINE = frozenset({"output", "lever"})
_LEAST_STAY_S = 10.0  # in a cell
_RATIO_PRIOR = 0.15  # scatter of ln r(k) between logs


@dataclass(frozen=True, eq=False)
class _Part:
    """One log of a pool: its design and its moments.

    `moments` are [phi y]' W [phi y] (source, target, 17, 17), with y the scaled target and W the
    weights of the fit to all parts; `stays` is source -> samples in each of the pool's cells.
    """

    log: Log
    design: Design
    moments: FloatArray
    stays: Mapping[str, IntArray]
    delays: Mapping[tuple[str, str], float]


@dataclass(frozen=True, eq=False)
class Pool:
    """Logs from which banks are learned, with any of them left out."""

    scaling: Bank  # without models; its cells are all in which a log has been
    parts: tuple[_Part | None, ...]  # None for a log without information

    @classmethod
    def of(cls, logs: Sequence[Log], priors: Priors = PRIORS) -> Self:
        """Prepare what does not depend on which logs are left out."""
        usable = [_is_informative(log) for log in logs]
        known = [log for log, one in zip(logs, usable, strict=True) if one]
        names = _engine_channels(known)
        if len(names) < 2:
            return cls(Bank(), (None,) * len(logs))
        scaling, designs = _scaled([Signals.of(log) for log in known], names)
        scaling = replace(scaling, priors=priors)
        found = iter(_parts(scaling, known, designs))
        return cls(scaling, tuple(next(found) if one else None for one in usable))

    def bank(self, channels: Sequence[str], without: Sequence[int] = ()) -> Bank | None:
        """Fit the bank to all logs but those numbered `without`; None without any.

        `channels` are those of the model: the others support the comparison, and no fault of them
        is reported. Each log is left out once to measure what is left, of many logs groups of them;
        a single log is cut into halves.
        """
        kept = [one for k, one in enumerate(self.parts) if one is not None and k not in without]
        if not kept:
            return None
        parts = kept if len(kept) > 1 else _halves(self.scaling, kept[0])
        left_out: dict[_Part, Residuals] = {}
        for fold in _folds(parts):
            bank = self._fitted([one for one in parts if one not in fold])
            left_out |= {one: compared(bank, one.design) for one in fold}
        logs = [one.log for one in kept]
        names, whole = self.scaling.channels, _longest(kept)
        of = {one.log: found for one, found in left_out.items()}
        mates = {log: mate_of(log, [*of]) for log in of}
        apart = [of[log].apart_from(of[mate]) for log, mate in mates.items() if mate is not None]
        return replace(
            self._fitted(kept),
            level={
                name: _known([found.level(name) for one, found in left_out.items() if one in whole])
                for name in names
            },
            steps={name: _heights(left_out.values(), name) for name in names},
            apart={name: _heights(apart, name) for name in names},
            stretch={
                str(k): _mean_and_scatter([log_ratio(found, k) for found in left_out.values()])
                for k in STRETCHES
            },
            delays=_mean_delays([one.delays for one in whole], names),
            late=_lateness([one.delays for one in whole], names),
            noise={
                name: [float(noise_of(log, name).max()) for log in logs if log.recorded([name])]
                for name in names
            },
            updates=_largest(logs, lambda log: log.updates),
            rounding=_largest(logs, lambda log: log.rounding),
            logs=len(whole),
            used=tuple(name for name in names if name in channels),
        )

    def _fitted(self, parts: Sequence[_Part]) -> Bank:
        names, step_s = self.scaling.channels, parts[0].design.air.signals.step_s
        moments = np.sum([one.moments for one in parts], axis=0)
        models: dict[str, dict[str, tuple[float, ...]]] = {name: {} for name in names}
        for j, source in enumerate(names):
            for i, target in enumerate(names):
                if i != j:
                    models[target][source] = tuple(_solved(moments[j, i]).tolist())
        cells = {}
        for name in names:
            stayed = np.sum([one.stays[name] for one in parts], axis=0) * step_s >= _LEAST_STAY_S
            cells[name] = np.asarray(self.scaling.cells[name], dtype=np.int64)[stayed].tolist()
        return replace(self.scaling, models=models, cells=cells)


def _is_informative(log: Log) -> bool:
    engine = tuple(name for name in CHANNELS if CHANNELS[name].role in _ENGINE)
    enough = len(log) > 1 and len(log) * log.dt_s >= _LEAST_STEPS * STEP_S
    return enough and len(log.recorded(engine)) > 1


def _engine_channels(logs: Sequence[Log]) -> tuple[str, ...]:
    """Outputs and levers that every log has, most with samples, and that move."""
    return tuple(
        name
        for name in CHANNELS
        if CHANNELS[name].role in _ENGINE
        and all(name in log.channels for log in logs)
        and 2 * sum(bool(log.recorded([name])) for log in logs) > len(logs)
        and np.nanstd(np.concatenate([log[name] for log in logs])) > 0.0
    )


def _folds(parts: Sequence[_Part]) -> list[list[_Part]]:
    """Parts that are left out together: recordings, or of a single one stretches of its time.

    Parts next to each other in time are so alike that they say nothing of other recordings.
    """
    files: dict[str, list[_Part]] = {}
    for one in parts:
        files.setdefault(recording_of(one.log)[0], []).append(one)
    groups = list(files.values())
    if len(groups) == 1:
        ordered = sorted(parts, key=lambda one: float(one.design.air.signals.time_s[0]))
        size = -(-len(ordered) // MOST_FOLDS)
        groups = [ordered[k : k + size] for k in range(0, len(ordered), size)]
    count = min(MOST_FOLDS, len(groups))
    return [[one for group in groups[k::count] for one in group] for k in range(count)]


def _halves(scaling: Bank, whole: _Part) -> list[_Part]:
    signals = whole.design.air.signals
    middle = len(signals.time_s) // 2
    parts = [signals.part(slice(None, middle)), signals.part(slice(middle, None))]
    designs = [Design.of(scaling, Corrected.of(one, scaling.channels)) for one in parts]
    return _parts(scaling, [whole.log] * 2, designs)


def _parts(scaling: Bank, logs: Sequence[Log], designs: Sequence[Design]) -> list[_Part]:
    names, found = scaling.channels, []
    for log, design, moments in zip(logs, designs, _moments(scaling, designs), strict=True):
        stays = {}
        for name in names:
            codes = scaling.cells[name]
            own = design.cells[name][np.isfinite(_in_known_air(design.air, name))]
            stays[name] = np.bincount(np.searchsorted(codes, own), minlength=len(codes))
        found.append(_Part(log, design, moments, stays, delays_of(log, names)))
    return found


def _scaled(logs: Sequence[Signals], names: Sequence[str]) -> tuple[Bank, list[Design]]:
    """A bank with the scaling of the channels and all cells, and the designs by it."""
    air = [Corrected.of(one, names) for one in logs]
    bank = Bank(tuple(names))
    centre, spread, low, high = {}, {}, {}, {}
    for name in names:
        x = np.concatenate([_in_known_air(one, name) for one in air])
        x = x[np.isfinite(x)]
        centre[name] = float(np.mean(x)) if len(x) else 0.0
        spread[name] = max(float(np.std(x)), 1e-9) if len(x) else 1.0
        ends = np.percentile(x, (0.1, 99.9)) - centre[name] if len(x) else np.zeros(2)
        margin = 0.05 * float(np.ptp(ends))
        low[name] = float(ends[0] - margin) / spread[name]
        high[name] = float(ends[1] + margin) / spread[name]
    bank = replace(bank, centre=centre, spread=spread, low=low, high=high)
    designs = [Design.of(bank, one) for one in air]
    cells = {
        name: np.unique(np.concatenate([one.cells[name] for one in designs])).tolist()
        for name in names
    }
    return replace(bank, cells=cells), designs


def _moments(scaling: Bank, designs: Sequence[Design]) -> list[FloatArray]:
    """[phi y]' W [phi y] (source, target, 17, 17) of each design; see `_Part`."""
    names = scaling.channels
    x = {name: np.concatenate([_in_known_air(one.air, name) for one in designs]) for name in names}
    ends = np.cumsum([0, *(len(one.air.mach) for one in designs)])
    found = [np.zeros((len(names), len(names), FEATURES + 1, FEATURES + 1)) for _ in designs]
    for j, source in enumerate(names):
        phi = np.concatenate([one.phi[source] for one in designs])
        for i, target in enumerate(names):
            usable = np.isfinite(x[source]) & np.isfinite(x[target])
            if i == j or usable.sum() < FEATURES:
                continue
            y = np.where(usable, (x[target] - scaling.centre[target]) / scaling.spread[target], 0.0)
            weight = np.zeros(len(y))
            weight[usable] = robust_weights(phi[usable], y[usable])
            rows = np.column_stack([phi, y]) * weight[:, None]
            for own, start, stop in zip(found, ends, ends[1:], strict=False):
                own[j, i] = rows[start:stop].T @ rows[start:stop]
    return found


def _in_known_air(air: Corrected, name: str) -> FloatArray:
    """A channel where the air is known: elsewhere it was corrected by a guess."""
    return np.where(air.known, air.x[name], np.nan)


def robust_weights(phi: FloatArray, target: FloatArray) -> FloatArray:
    """Soft-L1 weights of a ridge regression, by reweighting; roots of those of the squares."""
    rows, weight = np.column_stack([phi, target]), np.ones(len(target))
    for _ in range(3):
        weighted = rows * weight[:, None]
        error = target - phi @ _solved(weighted.T @ weighted)
        spread = 1.4826 * float(np.median(np.abs(error))) + 1e-12
        weight = 1.0 / np.sqrt(1.0 + (error / (2.0 * spread)) ** 2)
    return weight


def _solved(moments: FloatArray) -> FloatArray:
    """Coefficients of the ridge regression with the moments [phi y]'[phi y], phi_0 = 1.

    NaN where there are fewer samples than coefficients.
    """
    total = float(moments[0, 0])
    if total < FEATURES:
        return np.full(FEATURES, np.nan)
    size = np.sqrt(np.diag(moments)[:-1] / total) + 1e-12
    matrix = moments[:-1, :-1] / np.outer(size, size) + _RIDGE * total * np.eye(FEATURES)
    return np.asarray(np.linalg.solve(matrix, moments[:-1, -1] / size) / size)


def _known(levels: Sequence[float]) -> list[float]:
    return [each for each in levels if np.isfinite(each)]


def _longest(parts: Sequence[_Part]) -> list[_Part]:
    """The longest part of each recording of an engine: it stands for the recording as a whole."""
    found: dict[tuple[str, str], list[_Part]] = {}
    for one in parts:
        found.setdefault(recording_of(one.log), []).append(one)
    return [max(own, key=lambda one: len(one.log)) for own in found.values()]


def _mean_delays(logs: Sequence[Delays], names: Sequence[str]) -> dict[str, dict[str, float]]:
    seen = {(i, j): [one[i, j] for one in logs if (i, j) in one] for i in names for j in names}
    return {i: {j: float(np.mean(seen[i, j])) for j in names if seen[i, j]} for i in names}


def _lateness(logs: Sequence[Delays], names: Sequence[str]) -> dict[str, list[float]]:
    usual = [_mean_delays([*logs[:k], *logs[k + 1 :]], names) for k in range(len(logs))]
    pairs = list(zip(usual, logs, strict=True))
    return {name: _known([excess(mean[name], one, name) for mean, one in pairs]) for name in names}


def _heights(logs: Iterable[Residuals], name: str) -> dict[str, list[float]]:
    """Octave -> largest heights of the logs that have stretches of such lengths."""
    found: dict[str, list[float]] = {}
    for one in logs:
        for k, height in heights(blocks_of(one, name)).items():
            found.setdefault(str(k), []).append(height)
    return found


def _mean_and_scatter(values: Sequence[float]) -> tuple[float, float]:
    known = np.array([each for each in values if np.isfinite(each)])
    if not len(known):
        return 0.0, 1.0
    mean = float(known.mean())
    square = PRIOR_LOGS * _RATIO_PRIOR**2 + float(np.sum((known - mean) ** 2))
    return mean, float(np.sqrt(square / (PRIOR_LOGS + len(known) - 1)))


def _largest(logs: Sequence[Log], of: Callable[[Log], Mapping[str, float]]) -> dict[str, float]:
    """Of each channel over the logs that record it."""
    names = {name for log in logs for name in log.recorded(tuple(of(log)))}
    return {
        name: max(of(log).get(name, 0.0) for log in logs if log.recorded([name]))
        for name in sorted(names)
    }
