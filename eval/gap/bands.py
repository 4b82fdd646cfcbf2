"""At which frequencies the gap lives, and how much of it follows the driver there.

Intervals are by bootstrap over flights; of a single one nothing is known beside its own share.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.signal import csd, welch

from eval.gap.data import GapData
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
