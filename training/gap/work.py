"""How strict a diagnosis is, and everything it has at hand while it goes on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from narxcal.effects.input_side import ThrottleBacklash
from narxcal.effects.running import Emulator
from narxcal.effects.steady import HeatSoak
from narxcal.support.arrays import FloatArray
from training.gap.allowance import Allowance
from training.gap.fitting import Fit, Problem, in_nearly_all
from training.gap.quadratic import Misfit
from training.gap.unlogged import has_load, witnesses

_FAINT = 0.02  # of the peak of a response: where it counts half
_LEAST = 0.01  # of the noise's energy: less of a gap is none to take shares of
_SILENT, _WITNESSES = 0.03, 3  # of what the average flight tells; flights that have to tell
_PAIR, _MOST = 2, 0.5  # flights that are enough where each loses so much of its gap
_WITHIN = 0.05  # what a gain counts that any simulator's misfit would explain, too
_PLIANT = (HeatSoak, ThrottleBacklash)  # what follows anything slow, or at small moves
Watch = Callable[[str, int, int], None]  # what is at work, its number, how many there are
_AT_END = 0.8  # what a fit counts whose time constant would go on past its bound
_LOOPLESS = 0.9  # and one that takes a valve out of the loop of an engine that is under control


@dataclass(frozen=True)
class Options:
    """How strict the diagnosis is.

    `material` is the least share of the gap, `further` that of one more effect, of `most` at once.
    `unexplained` is the share that may be left before the answer is unknown, `unexplained_inside`
    that for one effect on how the engine moves, whose forms no two engines share, and
    `unexplained_together` that for two, which can follow more; more may be left,
    as build scatter and other misfit leave it, by an effect that takes `distinct` of the gap and
    explains `aligned` of it where it acts. One that takes `telling[0]` and explains `telling[1]` is
    believed of a smaller gap, from `faint[0]` on, and from `faint[1]` if it takes `wholly` of it,
    which nothing did that was not there. Beyond the small misfit that any simulator may have
    an effect takes at least `beyond`; one that takes `apart[0]` there, times what it explains where
    it acts, `apart[1]` at least, may leave anything. A rival is the leader's equal if it leaves no
    more than `close` times what the leader leaves, or if flights differ on who leads. `audible` is
    the least gap, as a share of the noise's energy, that is a gap at all; below `quiet`, as a share
    of a channel's range, it is a misfit that nobody has to explain.
    """

    material: float = 0.05
    further: float = 0.10
    unexplained: float = 0.40
    unexplained_inside: float = 0.55
    unexplained_together: float = 0.30
    distinct: float = 0.15
    aligned: float = 0.70
    telling: tuple[float, float] = (0.40, 0.82)
    beyond: float = 0.02
    apart: tuple[float, float] = (0.04, 0.40)
    quiet: float = 0.005
    faint: tuple[float, float] = (0.003, 0.001)
    wholly: float = 0.9
    close: float = 1.2
    audible: float = 0.03
    most: int = 2


class Simulators(NamedTuple):
    """What answers for the simulator: an emulator, and itself where it can be run again.

    Effects that act on readings alone need neither.
    """

    emulator: Emulator | None
    itself: Emulator | None = None


@dataclass
class Work:
    """Everything a diagnosis has at hand while it goes on."""

    problem: Problem
    options: Options
    before: FloatArray  # Q per flight without any effect
    noise: FloatArray
    tight: Misfit  # of the gap with its offsets, which `problem` counts as nuisances
    itself: Emulator | None = None  # the simulator, where it can be run again
    fits: list[Fit] = field(default_factory=list)
    allowance: Allowance | None = None
    offered: list[Fit] = field(default_factory=list)  # offsets of the whole gap, best first
    _refits: dict[Fit | None, FloatArray] = field(default_factory=dict)

    @property
    def whole(self) -> float:
        """Q of the gap with its offsets, beyond noise."""
        return max(float((self.tight.size(self.tight.gap) - self.tight.floor).sum()), 1e-9)

    @property
    def audible(self) -> float:
        """Q of the gap beyond noise."""
        floor = self.problem.misfit.floor
        return max(float((self.before - floor).sum()), _LEAST * float(floor.sum()))

    def gain(self, tried: Fit) -> float:
        """Share of the audible gap taken off held-out flights."""
        return float((self.before - tried.held_out).sum()) / self.audible

    def gains(self, tried: Fit) -> FloatArray:
        """The same per flight."""
        floor = self.problem.misfit.floor
        own = np.maximum(self.before - floor, _LEAST * floor)
        return np.asarray((self.before - tried.held_out) / own)

    def left(self, tried: Fit) -> float:
        """Share of the audible gap that the fit leaves on the flights it saw."""
        return float((tried.left - self.problem.misfit.floor).sum()) / self.audible

    def aligned(self, tried: Fit) -> float:
        """Share of the gap that the fit explains where its response is, noise aside: 0 to 1.

        Every sample counts by the energy of the response there, up to a fiftieth of its peak:
        whatever else is wrong elsewhere says nothing about the effect.
        """
        return self.explained(tried.response, self.problem.misfit.gap)

    def explained(self, response: FloatArray, gap: FloatArray) -> float:
        """The same for any response to any gap, (flights, time, outputs) each."""
        measure = self.problem.misfit
        gap, response = measure.cleaned(gap), measure.cleaned(response)
        energy = measure.weights * response**2
        peak = float(energy.max())
        if peak <= 0.0:
            return 0.0
        acts = measure.weights * energy / (energy + _FAINT * peak)
        before = float((acts * (gap**2 - self.noise**2)).sum())
        after = float((acts * ((gap - response) ** 2 - self.noise**2)).sum())
        return 0.0 if before <= 0.0 else float(np.clip(1.0 - after / before, 0.0, 1.0))

    def beyond(self, tried: Fit) -> FloatArray:
        """Q per flight that a fit takes beyond the small misfit that any simulator may have."""
        return self._refitted(None) - self._refitted(tried)

    def witnesses(self, tried: Fit, best: Fit | None = None) -> NDArray[np.bool_]:
        """Flights (flights,) that tell for or against what a fit has more than `best`, or none.

        A flight in which no switch of an effect moves, or no load was on, says nothing about it:
        of the parameters it tells less than 3 % of what the average flight does.
        """
        if has_load(tried):
            return witnesses(tried, self.problem.flights.price)
        known = () if best is None else best.effects
        owners = [
            effect for effect, n in zip(tried.effects, tried.sizes, strict=True) for _ in range(n)
        ]
        slopes = tried.slopes[[owner not in known for owner in owners]]
        told = np.einsum("fpp->fp", self.problem.misfit.inner(slopes, slopes))
        return np.asarray((told > _SILENT * told.mean(axis=0)).any(axis=1))

    def holds(self, gained: FloatArray, tried: Fit, best: Fit | None = None) -> bool:
        """Whether what is `gained` (flights,) is so in nearly all flights that tell, three or more.

        Two are enough if each loses most of its gap by what the other says. How many have to tell
        of an unlogged load is asked where its windows are found.
        """
        rows = self.witnesses(tried, best)
        whole = (self.before - self.problem.misfit.floor)[rows]
        most = int(rows.sum()) == _PAIR and bool((gained[rows] > _MOST * whole).all())
        enough = has_load(tried) or most or int(rows.sum()) >= min(_WITNESSES, len(rows))
        return enough and in_nearly_all(gained[rows])

    def stands_out(self, tried: Fit) -> bool:
        """Whether a fit takes so much beyond small misfit that whatever else is left may be.

        Heat soak follows anything slow, kinks and errors over altitude as well, and play anything
        at small moves, a dead band too, so that they have to explain what `aligned` asks for where
        they act.
        """
        taken, aligned = self.beyond(tried), self.aligned(tried)
        share, least = float(taken.sum()) / self.audible, self.options.apart
        pliant = any(isinstance(effect, _PLIANT) for effect in tried.effects)
        asked = self.options.aligned if pliant else least[1]
        return share * aligned >= least[0] and aligned >= asked and self.holds(taken, tried)

    def still(self, tried: Fit) -> float:
        """Q that a fit leaves beside small misfit, beyond noise."""
        return float((self._refitted(tried) - self.problem.misfit.floor).sum())

    def _refitted(self, tried: Fit | None) -> FloatArray:
        """Q per flight of a fit, or of none, with small misfit; a load pays for its windows."""
        if self.allowance is None:
            return self.before if tried is None else tried.held_out
        if tried not in self._refits:
            left = self.allowance.held_out(tried)
            price = self.problem.flights.price if tried is not None and has_load(tried) else None
            self._refits[tried] = left if price is None else left + price
        return self._refits[tried]

    def worth(self, tried: Fit) -> float:
        """Share of the gap that a fit takes; what small misfit would take as well counts little.

        A valve outside any loop makes all outputs late alike, as any delay does, and an engine
        under control has its valve in the loop: where both say the same, it is the delay.
        """
        taken = _WITHIN * self.gain(tried) + float(self.beyond(tried).sum()) / self.audible
        return taken * (_LOOPLESS if tried.loopless else 1.0)

    def rank(self, tried: Fit) -> float:
        """What candidates are ordered by: what one is worth, times what it explains where it acts.

        Of two that gain much the same, one that explains what it touches is there; one that
        explains it in part follows something else, of which it may gain as much by its size. So
        does one whose time constant ends on its bound: what it follows is slower or faster than the
        effect can be.
        """
        return self.worth(tried) * self.aligned(tried) * (_AT_END if tried.at_end else 1.0)

    @property
    def loudest(self) -> float:
        """Largest RMS of any channel's gap beyond noise, nuisances taken out, over its range."""
        measure, signals = self.problem.misfit, self.problem.flights.signals
        gap, known = measure.cleaned(measure.gap), measure.weights > 0.0
        power = [
            max(float(np.mean(gap[..., c][known[..., c]] ** 2)) - float(self.noise[c]) ** 2, 0.0)
            for c in range(gap.shape[-1])
        ]
        return float(np.max(np.sqrt(power) / np.maximum(signals.high - signals.low, 1e-9)))

    def tells(self, tried: Fit) -> bool:
        """Whether a fit takes so much of the gap, and so well where it acts, that it may be small.

        Where simulators were wrong otherwise, no effect that was not there did both; what they are
        wrong in may be an effect itself, a probe of 6 % more, and is not asked for below `faint`.
        """
        least, aligned = self.options.telling
        gain, (faint, fainter) = self.gain(tried), self.options.faint
        large = self.loudest >= (fainter if gain >= self.options.wholly else faint)
        return large and gain >= least and self.aligned(tried) >= aligned

    def unexplained(self, tried: Fit) -> float:
        """Share of what flights tell that is left; a load says nothing of flights without it."""
        rows, floor = witnesses(tried, self.problem.flights.price), self.problem.misfit.floor
        gap = max(float((self.before - floor)[rows].sum()), _LEAST * float(floor[rows].sum()))
        return float((tried.left - floor)[rows].sum()) / gap
