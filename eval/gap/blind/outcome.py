"""One case with its answer: what was true, what was said, and what follows from both."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

from eval.gap.blind.oracle import bin_name, channel_of_most, core, share_of_most
from narxcal.effects.library import LIBRARY

FLOOR: Final = 0.05  # share of the gap below which nobody has to find an effect
NONE, UNKNOWN, FAILED = "none", "unknown", "failed"
# Effect -> name of its size in the engines, and in the library.
SAME: Final = {
    "throttle_backlash": ("width_deg", "width_deg"),
    "throttle_delay": ("delay_s", "delay_s"),
    "throttle_rate_limit": ("rate_degps", "rate_degps"),
    "throttle_bias": ("bias_deg", "bias_deg"),
    "actuator_lag": ("tau_s", "tau_s"),
    "sensor_lag": ("tau_s", "tau_s"),
    "sensor_bias": ("offset", "bias"),
    "sensor_drift": ("rate_per_h", "rate_per_h"),
    "time_skew": ("skew_s", "skew_s"),
}


class Magnitude(NamedTuple):
    """A size that was put in, and what was found of it: parameter `name` of an effect."""

    effect: str
    name: str
    true: float
    value: float
    low: float
    high: float

    @property
    def inside(self) -> bool:
        """Whether the interval holds the truth."""
        return self.low <= self.true <= self.high

    def row(self) -> dict[str, Any]:
        """Give it as plain values."""
        return {**self._asdict(), "inside": self.inside}


class Outcome(NamedTuple):
    """`truth` is the row of the key, `answer` a document of narxcal.gap/1, or why there is none.

    `reruns` are answers to the same case with other seeds.
    """

    name: str
    truth: Mapping[str, Any]
    answer: Mapping[str, Any]
    reruns: tuple[Mapping[str, Any], ...] = ()

    @property
    def kind(self) -> str:
        """What the case is: single, pair, null, outside."""
        return str(self.truth["kind"])

    @property
    def gap_share(self) -> float:
        """Share of the squared gap that the true content makes."""
        return float(self.truth["gap_share"])

    @property
    def in_library(self) -> bool:
        """Whether it holds effects that can be named."""
        return self.kind in ("single", "pair")

    @property
    def true_effects(self) -> tuple[str, ...]:
        """Names of the effects that it holds."""
        return tuple(_name(row) for row in self.truth["effects"])

    @property
    def failed(self) -> bool:
        """Whether there is no answer: refused, an error, or too late."""
        return "verdict" not in self.answer

    @property
    def verdict(self) -> str:
        """Kind of the verdict: none, effects, ambiguous, unknown; or failed."""
        return FAILED if self.failed else str(self.answer["verdict"]["kind"])

    @property
    def claims(self) -> bool:
        """Whether effects are named."""
        return self.verdict in ("effects", "ambiguous")

    @property
    def claimed(self) -> tuple[str, ...]:
        """Effects that are named; nothing where the verdict names none."""
        return tuple(self.answer["verdict"]["effects"]) if self.claims else ()

    @property
    def named_set(self) -> tuple[str, ...]:
        """Effects that are named, with those that they cannot be told from."""
        if not self.claims:
            return ()
        return (*self.claimed, *self.answer["verdict"]["ambiguous_with"])

    @property
    def ranked(self) -> tuple[str, ...]:
        """All effects in the order of the answer, whatever the verdict."""
        return tuple(_name(row) for row in self.answer.get("effects", ()))

    @property
    def probabilities(self) -> dict[str, float]:
        """Probability of each effect."""
        return {_name(row): float(row["probability"]) for row in self.answer.get("effects", ())}

    @property
    def said(self) -> str:
        """The answer as one label: the effect named first, none, unknown or failed."""
        return self.claimed[0] if self.claimed else self.verdict

    @property
    def true_label(self) -> str:
        """What the label should be; of two effects the one that was named, or else the first."""
        if not self.in_library:
            return NONE if self.kind == "null" else UNKNOWN
        return self.said if self.said in self.true_effects else self.true_effects[0]

    def first(self, count: int) -> bool:
        """Whether a true effect is among the first `count` of the ranking."""
        return any(name in self.true_effects for name in self.ranked[:count])

    @property
    def family_first(self) -> bool:
        """Whether the effect ranked first is of a true one's family."""
        families = {LIBRARY[name.partition(":")[0]].family for name in self.true_effects}
        return any(LIBRARY[n.partition(":")[0]].family in families for n in self.ranked[:1])

    @property
    def overlap_of(self) -> tuple[set[str], set[str]]:
        """Bins that hold 70 % of the energy: said, and true."""
        return core(self._said_shares()), core(self.truth["where"])

    @property
    def channel_right(self) -> bool:
        """Whether most energy is said to be in the channel that truly has most."""
        return channel_of_most(self._said_shares()) == channel_of_most(self.truth["where"])

    @property
    def direction_right(self) -> bool:
        """Whether push, pull or rest is said to hold most energy, as it truly does."""
        return share_of_most(self._said_shares(), 1) == share_of_most(self.truth["where"], 1)

    @property
    def has_bands(self) -> bool:
        """Whether the key knows bands of frequency, and the answer has any."""
        return bool(self.truth.get("bands")) and bool(self._said_bands())

    @property
    def band_right(self) -> bool:
        """Whether most energy of the channel with most is said to be in the band that it is in."""
        channel = channel_of_most(self.truth["where"]) or ""
        true = self.truth["bands"].get(channel, ())
        said = self._said_bands().get(channel, ())
        return len(true) > 0 and len(said) > 0 and _largest(true) == _largest(said)

    @property
    def strength(self) -> float:
        """The largest gain that any effect has: what a claim would rest on."""
        gains = [row.get("gain", {}).get("value") for row in self.answer.get("effects", ())]
        return max((float(gain) for gain in gains if gain is not None), default=0.0)

    @property
    def sureness(self) -> float:
        """Probability of the effect that is named first; 0 where none is."""
        return self.probabilities.get(self.claimed[0], 0.0) if self.claimed else 0.0

    @property
    def labels(self) -> tuple[str, ...]:
        """The answer and those of the reruns in short: verdict and effects."""
        every = (self, *(self._replace(answer=each) for each in self.reruns))
        return tuple(" ".join([each.verdict, *sorted(each.claimed)]) for each in every)

    @property
    def magnitudes(self) -> list[Magnitude]:
        """Sizes of effects that are rightly named, where engine and library mean the same."""
        rows = {_name(row): row for row in self.answer.get("effects", ())}
        found = []
        for true in self.truth["effects"]:
            own, theirs = SAME.get(true["id"], ("", ""))
            said = rows.get(_name(true), {}).get("parameters", {}).get(theirs)
            size = true.get("parameters", {}).get(own)
            if said is not None and size and _name(true) in self.claimed:
                sizes = (float(size), *(float(said[each]) for each in ("value", "low", "high")))
                found.append(Magnitude(_name(true), theirs, *sizes))
        return found

    @property
    def shrinkage(self) -> tuple[Mapping[str, float], float] | None:
        """Predicted shrinkage with its interval, and the realised one; None without a claim."""
        shrink = self.answer.get("shrink", {})
        if not self.claims or shrink.get("realised") is None:
            return None
        return shrink["predicted"], float(shrink["realised"])

    @property
    def seconds(self) -> float | None:
        """What the answer took."""
        found = self.answer.get("seconds")
        return None if found is None else float(found)

    def _said_bands(self) -> dict[str, list[float]]:
        bands = self.answer.get("quality", {}).get("bands", {})
        return {name: [float(row["share"]) for row in rows] for name, rows in bands.items()}

    def _said_shares(self) -> dict[str, float]:
        return {
            bin_name(row["channel"], row["direction"], row["phase"]): float(row["share"])
            for row in self.answer.get("where", ())
            if row["share"] > 0.0
        }


def _largest(values: Sequence[float]) -> int:
    return max(range(len(values)), key=lambda k: values[k])


def _name(row: Mapping[str, Any]) -> str:
    return row["id"] if row.get("channel") is None else f"{row['id']}:{row['channel']}"
