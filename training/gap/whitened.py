"""The measure of misfit with the colour of what is left: slow misfit counts little at quick moves.

A probe's lag is fitted to a gap that holds slow heat as well. With all samples alike the lag grows
until it follows the heat, to three times its size. Generalised least squares (Aitken, *Proceedings
of the Royal Society of Edinburgh* 55, 1936) weigh every octave of frequency by what is left in it,
so that the size comes from where nothing else is wrong.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import dct

from narxcal.effects.running import respond
from narxcal.effects.sensor_side import SensorLag
from narxcal.support.arrays import FloatArray
from training.gap.fitting import Fit, Problem, fit
from training.gap.quadratic import Misfit
from training.gap.together import is_heat
from training.gap.work import Work

QUICKEST_HZ = 1.0  # above are noise, and the jitter of a fuel flow, which any lag takes away
_TURNS = 3  # of weights by what is left, and a fit by these


def by_octave(power: FloatArray) -> FloatArray:
    """Mean of a power (k, outputs) over the octave that each coefficient is in, of that shape."""
    starts = 2 ** np.arange(int(np.log2(max(len(power), 1))) + 1) - 1
    count = np.diff(np.append(starts, len(power)))
    return np.asarray(np.repeat(np.add.reduceat(power, starts) / count[:, None], count, axis=0))


@dataclass(frozen=True, eq=False)
class Whitened(Misfit):
    """A misfit whose inner products weigh cosine coefficients by their `power` (k, outputs)."""

    power: FloatArray

    def inner(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """Inner products (flights, p, q) of `a` (p, flights, time, outputs) and `b` (q, ...)."""
        of_a = np.array([_spectra(self, values, len(self.power)) for values in a])
        of_b = np.array([_spectra(self, values, len(self.power)) for values in b])
        return np.asarray(np.einsum("pfkn,qfkn->fpq", of_a / self.power, of_b, optimize=True))


def whitened(work: Work, response: FloatArray) -> Whitened:
    """The measure of a diagnosis, weighed by what a response leaves, the same in all flights."""
    measure, dt_s = work.problem.misfit, work.problem.flights.signals.dt_s
    count = int(2.0 * QUICKEST_HZ * dt_s * measure.gap.shape[1])  # half cycles over a flight
    left = _spectra(measure, measure.gap - response, count) ** 2
    power = by_octave(left.mean(axis=0)) + work.noise**2
    plain = (measure.gap, measure.weights, measure.nuisances, measure.solved, measure.floor)
    return Whitened(*plain, power)


def _spectra(measure: Misfit, values: FloatArray, count: int) -> FloatArray:
    """The first cosine coefficients (flights, k, outputs), none for the mean."""
    known = measure.cleaned(values) * (measure.weights > 0.0)
    return np.asarray(dct(known, axis=1, norm="ortho")[:, 1 : count + 1])


def sized_by_moves(work: Work, claimed: Fit | None) -> Fit | None:
    """The claim with its size from quick moves, where it is a lag that slow heat could be as well.

    From a small size it grows as far as they ask. What it leaves is told by the measure of the
    diagnosis; it takes its own place among the fits.
    """
    heat = any(is_heat(one) and one.name in work.standing for one in work.fits)
    if claimed is None or claimed.name not in work.standing or not heat or is_heat(claimed):
        return claimed
    if not isinstance(claimed.effects[0], SensorLag) or claimed.effects[0].channel != "EGT_C":
        return claimed
    flights, emulator = work.problem.flights, work.problem.emulator
    theta = np.array([parameter.starts[0] for parameter in claimed.parameters])
    response = respond([(claimed.effects[0], theta[None])], flights, emulator)[0] - flights.y
    found = claimed
    for _ in range(_TURNS):
        problem = Problem(flights, emulator, whitened(work, response))
        found = fit(claimed.effects, problem, theta)
        theta, response = found.theta, found.response
    found = _told(work, found)
    work.fits = [found if one is claimed else one for one in work.fits]
    return found


def _told(work: Work, found: Fit) -> Fit:
    """A fit with what it leaves of each flight, without it in the fit and with it."""
    measure = work.problem.misfit
    rest, held_out = measure.gap - found.response, np.empty(len(found.left))
    for f, theta in enumerate(found.others):
        without = rest - np.tensordot(theta - found.theta, found.slopes, axes=1)
        held_out[f] = measure.size(without)[f]
    return replace(found, left=measure.size(rest), held_out=held_out)
