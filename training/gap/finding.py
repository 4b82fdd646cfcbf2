"""What a diagnosis finds: plain values, ready for a page or a document."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from narxcal.support.arrays import FloatArray
from training.budget.result import Interval, Kind


@dataclass(frozen=True)
class Tried:
    """One model that was fitted: an effect, or several at once (`effects` names them).

    `gain` is the share of the squared gap that it takes away on flights that had no part in the
    fit, `flights` the same per flight. `parameters` maps effect name to parameter name to value.
    """

    effects: tuple[str, ...]
    family: str
    gain: float
    flights: tuple[float, ...]
    probability: float
    parameters: Mapping[str, Mapping[str, Interval]]
    units: Mapping[str, Mapping[str, str]]
    at_bound: tuple[str, ...] = ()


@dataclass(frozen=True)
class ChannelShrink:
    """RMSE of one channel's gap: before, after the effects are added, and the noise floor."""

    before: float
    after: float
    floor: float


@dataclass(frozen=True)
class Finding:
    """The answer: what kind, which effects, how sure, and what the evidence was.

    `tried` holds every model, best first; the first is the claimed one where `kind` is `effects`
    or `ambiguous`. `gap_share` is the share of the squared residual that is no noise, `left_share`
    what is left of it unexplained. `by_others` (flights, time, outputs) is what the claim does in
    each flight by the parameters that the other flights give, less what it does by those of all;
    nothing where nothing is claimed.
    """

    kind: Kind
    effects: tuple[str, ...]
    ambiguous_with: tuple[str, ...]
    reason: str
    separating_manoeuvre: str
    tried: tuple[Tried, ...]
    predicted: Interval
    channels: Mapping[str, ChannelShrink]
    gap_share: float
    left_share: float
    emulator_rmse: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    by_others: FloatArray | None = field(default=None, compare=False, repr=False)
