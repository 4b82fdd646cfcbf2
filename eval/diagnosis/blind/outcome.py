"""One case with its answer: what was true, what was said, and what follows from both."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from narxcal.effects.library import name_of

FLOOR: Final = 0.05  # share of the gap below which nobody has to find an effect
NONE, UNKNOWN, FAILED = "none", "unknown", "failed"
NO_EFFECT: Final = ("build", "offsets", "noise", "unexplained")  # other causes of a budget
_FAMILIES: Final = {"business_jet": "virtual", "single_aisle": "virtual"}
# Names of sizes in the engines, and in the library.
_SAME: Final = {"offset": "bias"}
_SIZED: Final = (
    "throttle_backlash",
    "throttle_delay",
    "throttle_rate_limit",
    "throttle_bias",
    "actuator_lag",
    "sensor_lag",
    "sensor_bias",
    "sensor_drift",
    "sensor_gain",
    "driver_gain",
    "time_skew",
)  # effects whose parameters mean the same in an engine or a recording as in the library


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
        return self.low <= self.true <= self.high


class Outcome(NamedTuple):
    """`truth` is the row of the key, `answer` a `gap.json` or a failure."""

    name: str
    truth: Mapping[str, Any]
    answer: Mapping[str, Any]

    @property
    def kind(self) -> str:
        return str(self.truth["kind"])

    @property
    def family(self) -> str:
        """Kind of engine: virtual, lumped, maker, real, or the name of a foreign one."""
        engine = str(self.truth["engine"])
        return _FAMILIES.get(engine, "lumped" if engine.startswith("lumped") else engine)

    @property
    def altered(self) -> bool:
        """Whether it is a recorded flight, altered or not: further causes may act there."""
        return "times_nameable" in self.truth

    @property
    def gap_share(self) -> float:
        return float(self.truth.get("gap_share", float("nan")))

    @property
    def in_library(self) -> bool:
        return self.kind in ("single", "pair")

    @property
    def nameable(self) -> bool:
        """Whether an answer has to name what acts: enough of the gap, or a nameable size."""
        enough = self.truth["times_nameable"] >= 1.0 if self.altered else self.gap_share >= FLOOR
        return self.in_library and bool(enough)

    @property
    def true_effects(self) -> tuple[str, ...]:
        return tuple(name_of(row) for row in self.truth["effects"])

    @property
    def failed(self) -> bool:
        """Whether there is no answer: refused, an error, or too late."""
        return "verdict" not in self.answer

    @property
    def verdict(self) -> str:
        return FAILED if self.failed else str(self.answer["verdict"]["kind"])

    @property
    def claims(self) -> bool:
        return len(self.claimed) > 0

    @property
    def firm(self) -> bool:
        return self.claims and self.verdict == "effects"

    @property
    def claimed(self) -> tuple[str, ...]:
        if self.verdict not in ("effects", "ambiguous"):
            return ()
        return tuple(self.answer["verdict"]["effects"])

    @property
    def named_set(self) -> tuple[str, ...]:
        if not self.claims:
            return ()
        return (*self.claimed, *self.answer["verdict"]["ambiguous_with"])

    @property
    def ranked(self) -> tuple[str, ...]:
        return tuple(name_of(row) for row in self.answer.get("effects", ()))

    @property
    def sureness(self) -> float:
        if not self.claims:
            return 0.0
        return float(self._rows().get(self.claimed[0], {}).get("probability") or 0.0)

    @property
    def said(self) -> str:
        """The answer as one label: the effect named first, none, unknown or failed."""
        return self.claimed[0] if self.claims else self.verdict

    @property
    def true_label(self) -> str:
        """What the label should be; of two effects the one that was named, or else the first."""
        if not self.in_library:
            return NONE if self.kind == "null" else UNKNOWN
        return self.said if self.said in self.true_effects else self.true_effects[0]

    @property
    def found(self) -> bool:
        """Whether a true effect is ranked first; among other real causes: is named."""
        ranked = self.claimed if self.altered else self.ranked[:1]
        return any(name in self.true_effects for name in ranked)

    @property
    def exact(self) -> bool:
        """Whether the answer names what acts and nothing else, no alternative either."""
        return {*self.named_set} == {*self.true_effects}

    @property
    def others(self) -> int:
        return len({*self.claimed} - {*self.true_effects})

    @property
    def channel_right(self) -> bool | None:
        """Whether most energy of what acts is said to be in its channel; None if not known."""
        true, said = _most(self._true_channels()), _most(self._said_channels())
        return None if true is None or self.failed else said == true

    @property
    def magnitudes(self) -> list[Magnitude]:
        """Sizes of effects that are rightly named, where engine and library mean the same."""
        rows, found = self._rows(), []
        for true in self.truth["effects"]:
            name = name_of(true)
            fitted = rows.get(name, {}).get("parameters", {})
            for parameter, size in true.get("parameters", {}).items():
                of = fitted.get(_SAME.get(parameter, parameter))
                if of is not None and size and true["id"] in _SIZED and name in self.claimed:
                    values = (float(size), *(float(of[each]) for each in ("value", "low", "high")))
                    found.append(Magnitude(name, parameter, *values))
        return found

    @property
    def shrinkage(self) -> tuple[float, float] | None:
        """Predicted and realised shrinkage; None without a claim."""
        shrink = self.answer.get("shrink") or {}
        if not self.claims or shrink.get("realised") is None:
            return None
        return float(shrink["predicted"]["value"]), float(shrink["realised"])

    @property
    def share_errors(self) -> dict[str, float]:
        """Said less true share of every cause of the budget; none where either has no budget.

        An effect that is not in the answer has no share there, and the other way round.
        """
        true, rows = self.truth.get("budget"), self.answer.get("budget")
        if not true or not rows:
            return {}
        said = _summed((row["cause"], row["share"]) for row in rows)
        return {
            name: said[name] - true.get(name, {}).get("share", 0.0)
            for name in sorted({*said, *true})
        }

    @property
    def seconds(self) -> float | None:
        found = self.answer.get("seconds")
        return None if found is None else float(found)

    def _rows(self) -> dict[str, Mapping[str, Any]]:
        return {name_of(row): row for row in self.answer.get("effects", ())}

    def _true_channels(self) -> dict[str, float]:
        rows = [self.truth.get("budget", {}).get(name, {}) for name in self.true_effects]
        return _summed(each for row in rows for each in row.get("channels", {}).items())

    def _said_channels(self) -> dict[str, float]:
        rows = [row for row in self.answer.get("budget", ()) if row["cause"] not in NO_EFFECT]
        if rows:
            return _summed(each for row in rows for each in row["channels"].items())
        return _summed((row["channel"], row["share"]) for row in self.answer.get("where", ()))


def _summed(rows: Any) -> defaultdict[str, float]:
    found: defaultdict[str, float] = defaultdict(float)
    for name, value in rows:
        found[name] += float(value)
    return found


def _most(shares: Mapping[str, float]) -> str | None:
    return max(shares, key=lambda name: shares[name]) if any(shares.values()) else None
