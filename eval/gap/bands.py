"""At which frequencies the gap lives, and how much of it follows the driver there."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.signal import csd, welch

from data_prep.moves import bridged
from eval.gap.data import FloatArray, GapData

EDGES_HZ = (0.0, 0.03, 0.1, 0.3, 1.0, 1e9)
_SEGMENT_S = 128.0


class Band(NamedTuple):
    """A band of frequencies: share of the channel's gap energy above the floor, and coherence.

    `coherence` is the part of the gap there that a linear system could make of the driver.
    """

    low_hz: float
    high_hz: float
    share: float
    coherence: float


def bands_of(data: GapData, gap: FloatArray | None = None) -> dict[str, tuple[Band, ...]]:
    """Bands of every output, from Welch's spectra averaged over all flights.

    `gap` (flights, time, outputs) takes the place of recorded less simulated.
    """
    gap = data.gap if gap is None else gap
    spectra = _Spectra(data)
    return {
        name: spectra.bands(gap[..., k], float(data.noise[k]))
        for k, name in enumerate(data.flights.signals.outputs)
    }


class _Spectra:
    def __init__(self, data: GapData) -> None:
        self.lengths = data.flights.lengths
        self.rate_hz = 1.0 / data.flights.signals.dt_s
        signals = data.flights.signals
        self.driver = data.flights.u[..., signals.u(signals.driver)]
        self.segment = int(min(_SEGMENT_S * self.rate_hz, self.lengths.min()))

    def bands(self, gap: FloatArray, noise: float) -> tuple[Band, ...]:
        """Bands of one output's gap (flights, time)."""
        frequency, cross, own, driver = self._spectra(gap)
        # White noise spreads its variance evenly over all frequencies up to half the rate.
        floor = noise**2 / (0.5 * self.rate_hz)
        excess = own - floor
        edges = [edge for edge in EDGES_HZ if edge < 0.5 * self.rate_hz] + [0.5 * self.rate_hz]
        rows = []
        for low, high in pairwise(edges):
            inside = (frequency >= low) & (frequency < high)
            energy = max(0.0, float(excess[inside].sum()))
            both = float((own[inside] * driver[inside]).sum())
            linear = float((np.abs(cross[inside]) ** 2).sum()) / both if both > 0.0 else 0.0
            rows.append((low, high, energy, linear))
        total = sum(row[2] for row in rows)
        return tuple(
            Band(low, high, energy / total if total > 0.0 else 0.0, min(1.0, linear))
            for low, high, energy, linear in rows
        )

    def _spectra(self, gap: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Frequencies, and the spectra summed over flights: cross, gap's, driver's."""
        rate, segment = self.rate_hz, self.segment
        found = []
        for f, n in enumerate(self.lengths):
            own, lever = bridged(gap[f, :n]), self.driver[f, :n] - self.driver[f, :n].mean()
            frequency, cross = csd(own, lever, rate, nperseg=segment, detrend=False)
            weight = n / self.lengths.sum()
            power = [welch(x, rate, nperseg=segment, detrend=False)[1] for x in (own, lever)]
            found.append((weight * cross, weight * power[0], weight * power[1]))
        cross, own, driver = (np.sum([each[k] for each in found], axis=0) for k in range(3))
        return frequency, cross, own, driver
