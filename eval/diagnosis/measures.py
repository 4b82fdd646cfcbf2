"""Measures of a gap that name no effect: frequency bands, Theil's split, errors of Ti and Tt."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.signal import csd, welch

from data_prep.events import PUSH, Event
from eval.diagnosis.flights import GapData
from eval.response import Transient, TransientConfig, measure_transient
from narxcal.support.arrays import FloatArray, bridge_gaps

EDGES_HZ = (0.0, 0.03, 0.1, 0.3, 1.0, 1e9)
_SEGMENT_S = 128.0
_DRAWS = 300


class Band(NamedTuple):
    """A band of frequencies: share of the channel's gap energy above the floor, and coherence.

    `low` to `high` is the share's 90 % interval. `coherence` is the part of the gap there that a
    linear system could make of the driver.
    """

    low_hz: float
    high_hz: float
    share: float
    coherence: float
    low: float = 0.0
    high: float = 1.0


def bands_of(
    data: GapData, gap: FloatArray | None = None, seed: int = 0
) -> dict[str, tuple[Band, ...]]:
    """Bands of every output, from Welch's spectra averaged over all flights.

    `gap` (flights, time, outputs) takes the place of recorded less simulated.
    """
    gap = data.gap if gap is None else gap
    spectra = _Spectra(data, seed)
    return {
        name: spectra.bands(gap[..., k], float(data.noise[k]))
        for k, name in enumerate(data.flights.signals.outputs)
    }


class _Spectra:
    def __init__(self, data: GapData, seed: int) -> None:
        self.lengths = data.flights.lengths
        count = len(self.lengths)
        draws = np.random.default_rng(seed).multinomial(
            count, np.full(count, 1.0 / count), size=_DRAWS
        )
        # What was found first, then flights drawn anew.
        self.weights = np.concatenate([np.ones((1, count)), draws])
        self.rate_hz = 1.0 / data.flights.signals.dt_s
        signals = data.flights.signals
        self.driver = data.flights.u[..., signals.u(signals.driver)]
        self.segment = int(min(_SEGMENT_S * self.rate_hz, self.lengths.min()))

    def bands(self, gap: FloatArray, noise: float) -> tuple[Band, ...]:
        """Bands of one output's gap (flights, time)."""
        frequency, cross, own, driver = self._spectra(gap)
        # White noise spreads its variance evenly over all frequencies up to half the rate.
        floor = noise**2 / (0.5 * self.rate_hz)
        weights = self.lengths / self.lengths.sum()
        excess = weights[:, None] * (own - floor)
        edges = [edge for edge in EDGES_HZ if edge < 0.5 * self.rate_hz] + [0.5 * self.rate_hz]
        insides = [(frequency >= low) & (frequency < high) for low, high in pairwise(edges)]
        energies = np.stack([excess[:, inside].sum(axis=1) for inside in insides], axis=1)
        shares = _shares(self.weights @ energies)
        ends = [(0.0, 1.0)] * len(insides) if len(own) == 1 else _ends(shares)
        mean = [(weights[:, None] * each).sum(axis=0) for each in (cross, own, driver)]
        return tuple(
            Band(*edge, float(share), _coherence(*(each[inside] for each in mean)), *end)
            for edge, share, inside, end in zip(
                pairwise(edges), shares[0], insides, ends, strict=True
            )
        )

    def _spectra(self, gap: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Frequencies, and spectra (flights, frequencies): cross, gap's, driver's."""
        rate, segment = self.rate_hz, self.segment
        found = []
        for f, n in enumerate(self.lengths):
            own, lever = bridge_gaps(gap[f, :n]), self.driver[f, :n] - self.driver[f, :n].mean()
            frequency, cross = csd(own, lever, rate, nperseg=segment, detrend=False)
            power = [welch(x, rate, nperseg=segment, detrend=False)[1] for x in (own, lever)]
            found.append((cross, *power))
        cross, own, driver = (np.stack([each[k] for each in found]) for k in range(3))
        return frequency, cross, own, driver


def _shares(energies: FloatArray) -> FloatArray:
    """Energies (draws, bands) as shares of what each draw holds; none where it holds nothing."""
    above = np.maximum(energies, 0.0)
    return np.asarray(above / np.maximum(above.sum(axis=1, keepdims=True), 1e-300))


def _ends(shares: FloatArray) -> list[tuple[float, float]]:
    """90 % intervals of shares (1 + draws, bands), to which the first one belongs."""
    low, high = np.percentile(shares[1:], (5.0, 95.0), axis=0)
    low, high = np.minimum(low, shares[0]), np.maximum(high, shares[0])
    return list(zip(low.tolist(), high.tolist(), strict=True))


def _coherence(cross: FloatArray, own: FloatArray, driver: FloatArray) -> float:
    both = float((own * driver).sum())
    return min(1.0, float((np.abs(cross) ** 2).sum()) / both) if both > 0.0 else 0.0


class Theil(NamedTuple):
    """Shares of the mean squared gap, which add up to 1, and Theil's inequality U.

    U is 0 for equal series and at most 1.
    """

    bias: float
    variance: float
    covariance: float
    inequality: float


def theil(real: FloatArray, sim: FloatArray) -> Theil:
    """Split the gap between two series (time,); samples where either is NaN are left out."""
    known = np.isfinite(real) & np.isfinite(sim)
    a, b = real[known], sim[known]
    mean_square = float(np.mean((a - b) ** 2)) if len(a) else 0.0
    if mean_square == 0.0:
        return Theil(0.0, 0.0, 0.0, 0.0)
    bias = float(a.mean() - b.mean()) ** 2 / mean_square
    variance = float(a.std() - b.std()) ** 2 / mean_square
    size = float(np.sqrt(np.mean(a**2)) + np.sqrt(np.mean(b**2)))
    return Theil(bias, variance, 1.0 - bias - variance, float(np.sqrt(mean_square)) / size)


def theil_of(data: GapData) -> dict[str, Theil]:
    """Theil's split of every output, over all flights as one series."""
    sim = np.where(np.isfinite(data.real), data.flights.y, np.nan)
    return {
        name: theil(data.real[..., k].ravel(), sim[..., k].ravel())
        for k, name in enumerate(data.flights.signals.outputs)
    }


_LEAST = 0.08  # of the channel's range: the smallest response that is read
_BEFORE_S, _AFTER_S = 1.0, 8.0


@dataclass(frozen=True)
class EventTimes:
    """One event on one channel: what the model has too little (flight less model), in seconds."""

    flight: int
    start: int
    direction: str
    Ti_s: float
    Tt_s: float


@dataclass(frozen=True)
class TimeErrors:
    """All events of one channel that could be read on both sides."""

    events: tuple[EventTimes, ...]

    def shared_with(self, other: TimeErrors) -> TimeErrors:
        """Those of the events that could be read in `other` as well."""
        there = {(event.flight, event.start) for event in other.events}
        return TimeErrors(tuple(e for e in self.events if (e.flight, e.start) in there))

    def mean_abs(self, name: str) -> float:
        """Mean absolute error of `Ti_s` or `Tt_s`; NaN without an event."""
        values = [abs(getattr(event, name)) for event in self.events]
        return float(np.mean(values)) if values else float("nan")

    def median(self, name: str, direction: str) -> float:
        """Median error of `Ti_s` or `Tt_s` over pushes or pulls; NaN without one."""
        values = [getattr(e, name) for e in self.events if e.direction == direction]
        return float(np.median(values)) if values else float("nan")

    def count(self, direction: str) -> int:
        """Events that were read."""
        return sum(event.direction == direction for event in self.events)


def time_errors(
    data: GapData, model: FloatArray, events: Sequence[Sequence[Event]]
) -> Mapping[str, TimeErrors]:
    """Read every event on every output of `data.real` and of `model` (flights, time, outputs).

    Events that end before the speeds settle, responses below 8 % of the channel's range, and
    those that either side does not settle on are left out. A response is followed for up to 8 s
    after its event, as far as the lever rests: the flight may be slower than the model.
    """
    dt_s, lengths = data.flights.signals.dt_s, data.flights.lengths
    longer = [
        (f, replace(event, stop=min(event.stop + round(_AFTER_S / dt_s), until)))
        for f, flight in enumerate(events)
        for event, until in zip(
            flight, [*(later.start for later in flight), int(lengths[f])][1:], strict=True
        )
    ]
    return {
        name: TimeErrors(
            tuple(
                found
                for f, event in longer
                if (found := _read(data, model, (f, k), event)) is not None
            )
        )
        for k, name in enumerate(data.flights.signals.outputs)
    }


def _read(
    data: GapData, model: FloatArray, place: tuple[int, int], event: Event
) -> EventTimes | None:
    f, k = place
    if event.interrupted or not event.settled:
        return None
    dt_s = data.flights.signals.dt_s
    rows = slice(max(0, event.start - round(_BEFORE_S / dt_s)), event.stop)
    time_s = np.arange(rows.start, rows.stop, dtype=np.float64) * dt_s
    config = TransientConfig(least_response=_LEAST * float(data.span[k]), drift_share=0.1)
    flight = measure_transient(time_s, data.real[f, rows, k], event.start * dt_s, config)
    own = config.model_copy(update={"least_response": 0.0, "drift_share": 0.2})
    sim = measure_transient(time_s, model[f, rows, k], event.start * dt_s, own)
    if not _comparable(flight, sim):
        return None
    direction = "push" if event.label == PUSH else "pull"
    errors = (flight.Ti_s - sim.Ti_s, flight.Tt_s - sim.Tt_s)
    return EventTimes(f, event.start, direction, *errors)


def _comparable(flight: Transient, model: Transient) -> bool:
    if flight.reason is not None or model.reason is not None:
        return False
    return flight.response * model.response > 0.0
