"""What is counted over the answers to a blind test: the measures of GAP section 2, one by one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

from eval.gap.blind.metrics import (
    Rate,
    area_under_curve,
    brier,
    calibration_error,
    kappa,
    log_score,
    macro_f1,
    mean,
    median,
    overlap,
    rate,
    selective_accuracy,
    slope,
)
from eval.gap.blind.outcome import FLOOR, NONE, Outcome

Cases = Sequence[Outcome]
_COVERAGE: Final = 0.8  # of the cases, the surest ones, that a selective answer is judged by
_CLEAR: Final = 0.2  # share of the gap from which GAP asks for the overlap


class Measure(NamedTuple):
    """One line of the table: its group, what it is, over which cases, and its value.

    `value` is a share with its interval, or a number in `unit`.
    """

    group: str
    name: str
    value: Rate | float
    unit: str = ""

    def row(self) -> dict[str, Any]:
        """Give it as plain values."""
        found = self.value.row() if isinstance(self.value, Rate) else {"value": self.value}
        return {"group": self.group, "name": self.name, "unit": self.unit, **found}


def table(outcomes: Cases) -> list[Measure]:
    """Every measure; those on effects over cases of the library with at least 5 % of the gap."""
    above = [o for o in outcomes if o.in_library and o.gap_share >= FLOOR]
    return [
        *_detection(outcomes, above),
        *_attribution(outcomes, above),
        *_abstention(outcomes),
        *_localisation(above),
        *_shrinkage(outcomes),
        *_magnitude(outcomes),
        *_pairs(outcomes),
        *_robustness(outcomes),
        *_cost(outcomes),
    ]


def _detection(outcomes: Cases, above: Cases) -> list[Measure]:
    nulls = [o for o in outcomes if o.kind == "null"]
    strange = [o for o in outcomes if o.kind == "outside"]
    mimics = [o for o in strange if o.truth["outside"]["like"]]
    return [
        Measure("detection", "false claims on nulls", rate([o.claims for o in nulls])),
        Measure("detection", "firm false claims on nulls", rate([_firm(o) for o in nulls])),
        Measure("detection", "gap seen, g >= 5 %", rate([detected(o) for o in above])),
        Measure("detection", "effect claimed, g >= 5 %", rate([o.claims for o in above])),
        Measure(
            "detection",
            "AUC of the best gain, g >= 5 % against nulls",
            area_under_curve([o.strength for o in above], [o.strength for o in nulls]),
        ),
        Measure("abstention", "firm claims out of library", rate([_firm(o) for o in strange])),
        Measure("abstention", "firm claims on mimics", rate([_firm(o) for o in mimics])),
    ]


def _attribution(outcomes: Cases, above: Cases) -> list[Measure]:
    claims = [o for o in outcomes if o.claims]
    true = [_highest_true(o) for o in above]
    sets = [o for o in above if o.claims]
    firsts = [o.probabilities.get(o.ranked[0], 0.0) if o.ranked else 0.0 for o in claims]
    labels = [o.true_label for o in outcomes], [o.said for o in outcomes]
    answered = [o for o in outcomes if not o.failed]
    named = [o.said in o.true_effects for o in above]
    return [
        Measure("attribution", "top-1, ranked first", rate([o.first(1) for o in above])),
        Measure("attribution", "top-1, as answered", rate(named)),
        Measure("attribution", "top-2", rate([o.first(2) for o in above])),
        Measure("attribution", "family of the first", rate([o.family_first for o in above])),
        Measure("attribution", "right where it claims", rate([_named_true(o) for o in claims])),
        Measure("attribution", "macro-F1, with none and unknown", macro_f1(*labels)),
        Measure("attribution", "Cohen's kappa", kappa(*labels)),
        Measure("attribution", "mean probability of the true effect", mean(true)),
        Measure("attribution", "log score (-ln p of the true effect)", log_score(true)),
        Measure(
            "attribution",
            "Brier score",
            brier([o.probabilities for o in answered], [o.true_effects for o in answered]),
        ),
        Measure(
            "attribution",
            "calibration error (ECE) of claims",
            calibration_error(firsts, [o.first(1) for o in claims]),
        ),
        Measure(
            "attribution",
            "right among the surest 80 %",
            selective_accuracy([o.sureness for o in above], named, _COVERAGE),
        ),
        Measure("set", "true effect in the named set", rate([_covered(o) for o in sets])),
        Measure("set", "mean size", mean([float(len(o.named_set)) for o in sets])),
    ]


def _abstention(outcomes: Cases) -> list[Measure]:
    abstained = [o for o in outcomes if o.verdict in ("none", "unknown")]
    good = [not o.in_library or o.gap_share < FLOOR for o in abstained]
    strange = [o for o in outcomes if o.kind == "outside" and o.gap_share >= FLOOR]
    return [
        Measure("abstention", "precision of none and unknown", rate(good)),
        Measure(
            "abstention",
            "unknown out of library, g >= 5 %",
            rate([o.verdict == "unknown" for o in strange]),
        ),
    ]


def _localisation(above: Cases) -> list[Measure]:
    found = [o for o in above if not o.failed]
    clear = [o for o in found if o.gap_share >= _CLEAR]
    return [
        Measure("where", "channel of most energy", rate([o.channel_right for o in found])),
        Measure(
            "where", "overlap (IoU) of 70 % bins", mean([overlap(*o.overlap_of) for o in found])
        ),
        Measure("where", "overlap (IoU), g >= 20 %", mean([overlap(*o.overlap_of) for o in clear])),
        Measure("where", "direction of most energy", rate([o.direction_right for o in found])),
        Measure("where", "band of most energy", rate([o.band_right for o in found if o.has_bands])),
    ]


def _shrinkage(outcomes: Cases) -> list[Measure]:
    both = [(o, o.shrinkage) for o in outcomes]
    found = [(o, p, r) for o, each in both if each is not None for p, r in [each]]
    said, real = [float(p["value"]) for _, p, _ in found], [r for _, _, r in found]
    errors = [p - r for p, r in zip(said, real, strict=True)]
    inside = [float(p["low"]) <= r <= float(p["high"]) for _, p, r in found]
    recovered = [r / o.gap_share for o, _, r in found if o.in_library and o.gap_share >= FLOOR]
    return [
        Measure("shrinkage", "mean absolute error", mean([abs(e) for e in errors])),
        Measure("shrinkage", "bias (predicted - realised)", mean(errors)),
        Measure("shrinkage", "slope of realised over predicted", slope(said, real)),
        Measure("shrinkage", "realised within the interval", rate(inside)),
        Measure("shrinkage", "recovered (realised over g), median", median(recovered)),
    ]


def _magnitude(outcomes: Cases) -> list[Measure]:
    """Sizes that mean the same in the engine as in the library, of effects rightly named."""
    sizes = [each for o in outcomes for each in o.magnitudes]
    errors = [abs(s.value / s.true - 1.0) for s in sizes]
    return [
        Measure("magnitude", "relative error of the size, median", median(errors)),
        Measure("magnitude", "true size within its interval", rate([s.inside for s in sizes])),
    ]


def _robustness(outcomes: Cases) -> list[Measure]:
    again = [o for o in outcomes if len(o.labels) > 1]
    changed = [len({*o.labels}) > 1 for o in again]
    reruns = [label != o.labels[0] for o in again for label in o.labels[1:]]
    return [
        Measure("robustness", "cases whose answer changes", rate(changed)),
        Measure("robustness", "reruns with another answer", rate(reruns)),
    ]


def _pairs(outcomes: Cases) -> list[Measure]:
    pairs = [o for o in outcomes if o.kind == "pair" and o.gap_share >= FLOOR]
    singles = [o for o in outcomes if o.kind == "single" and o.claims]
    return [
        Measure("pairs", "exact pair", rate([{*o.claimed} == {*o.true_effects} for o in pairs])),
        Measure(
            "pairs",
            "at least one of two",
            rate([bool({*o.claimed} & {*o.true_effects}) for o in pairs]),
        ),
        Measure(
            "pairs", "second effect claimed on one", rate([len(o.claimed) > 1 for o in singles])
        ),
    ]


def _cost(outcomes: Cases) -> list[Measure]:
    seconds = [o.seconds for o in outcomes if o.seconds is not None]
    return [
        Measure("cost", "cases without an answer", rate([o.failed for o in outcomes])),
        Measure("cost", "median time per case", median(seconds), "s"),
        Measure("cost", "longest time", max(seconds, default=float("nan")), "s"),
    ]


def _firm(outcome: Outcome) -> bool:
    return outcome.verdict == "effects"


def detected(outcome: Outcome) -> bool:
    """Whether the answer says that there is a gap."""
    return not outcome.failed and outcome.verdict != NONE


def _covered(outcome: Outcome) -> bool:
    return {*outcome.true_effects} <= {*outcome.named_set}


def _named_true(outcome: Outcome) -> bool:
    """Whether the effect that is named first is a true one."""
    return outcome.claimed[0] in outcome.true_effects


def _highest_true(outcome: Outcome) -> float:
    return max(outcome.probabilities.get(name, 0.0) for name in outcome.true_effects)


def shrinkage_error(group: Cases) -> float:
    """Mean absolute error of the predicted shrinkage, over claims."""
    both = [o.shrinkage for o in group]
    return mean([abs(float(f[0]["value"]) - f[1]) for f in both if f is not None])
