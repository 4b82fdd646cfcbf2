"""All tables and figures of the calibration paper, and our own goal where it left something open.

The goal takes in take-off, approach and throttle rate, which the paper's structure and segments do
not reach: the control governs N1, so that after a pull N2 and the temperature undershoot; fast
pushes from ground idle are limited by its acceleration schedule; and on whole circuits a switch
moves the engine between two moves of the lever, which segments leave out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from data_prep.log import Log
from eval.judging.log_evaluation import LogEvaluation
from eval.judging.outcome import Outcome
from eval.reproduce.data import FAMILIES, DataSets, Effort, cut, within
from eval.reproduce.inputs import deviations, inputs
from eval.reproduce.noise import noise
from eval.reproduce.recordings import correlation, segments, smoothing
from eval.reproduce.response import (
    Classed,
    accuracy,
    assessments_of,
    class_rows,
    class_table,
    classed,
    error_claims,
    figures_of,
    judged,
    passed_claim,
    response_times,
    splits,
    times_table,
    worst_pct,
)
from eval.reproduce.study import Study, claim, missed, or_nan, outcome_of
from narxcal.calibration.bundle import Bundle
from narxcal.support.files import versions
from narxcal.support.progress import Progress, silent
from training.config import RunConfig
from training.methods import TrainOptions
from training.pipeline import calibrate
from training.records import Split

ERROR_PCT = 2.0
_PAPER_FAMILY = "the paper's data sets"
_WHOLE = "take_off_approach/"  # training records that are not cut into segments
_EVERY = 2  # every second sample: dynamics of seconds lose nothing, training takes half the time
# Many steps, over windows so long that a state that does not decay shows.
_TRAIN = {
    "horizons_s": (5.0, 240.0),
    "iterations": (8, 24),
    "score_every_s": 0.19,
    "rest_far": True,
    "emphasis": "motion",
}


def goal_config(config: RunConfig) -> RunConfig:
    """Configuration of `goal`: lags under N1 governing, where there are lags, and more steps.

    N1 governing can be described only for an engine whose two speeds are outputs.
    """
    spools = {"N1_pct", "N2_pct"} <= set(config.narx.outputs)
    form = {"lag_governed": True, "linear_feedback": True} if spools else {"lag_limits": True}
    return config.having(narx=form if config.narx.lag else {}, train=_TRAIN)


def goal_training(data: DataSets) -> Split:
    """All records at half their sampling rate: segments of most, circuits whole."""
    split = data.whole_split
    whole = [log for log in split.train if log.name.startswith(_WHOLE)]
    parts = [log for log in split.train if not log.name.startswith(_WHOLE)]
    train = [*cut([thinned(log) for log in parts], data.config.events), *map(thinned, whole)]
    return replace(split, train=tuple(train), validate=tuple(map(thinned, split.validate)))


def thinned(log: Log, every: int = _EVERY) -> Log:
    """Every so many-th sample of a log that was smoothed."""
    channels = {name: values[::every] for name, values in log.channels.items()}
    return replace(log, time_s=log.time_s[::every], channels=channels)


def goal(data: DataSets, bundle: Bundle) -> Study:
    """Judge the calibration of all records on every record held out."""
    tests = [*data.tests, *data.further_tests]
    step = round(bundle.calibration.dt_s / tests[0].dt_s)
    tests = [thinned(log, step) for log in tests]
    found = judged(bundle, tests)
    events = classed(data.config.events.driver, found)
    pooled = worst_pct(found)
    classes = class_rows(events)
    rows = _families(found, events)
    every = figures_of(assessments_of(events))
    return Study(
        key="goal",
        title="Our own goal: every phase and every throttle rate",
        source="section 4, where the paper names both as future work",
        text="A calibration from the training part of all records, judged in free run on whole "
        f"records that it has not seen: {_tested(data, tests)}. Pushes and pulls, fast, slow and "
        "small, on the ground and in the air.",
        claims=[
            *error_claims(pooled, classes, "goal_largest"),
            passed_claim(every, "goal_passed"),
            *(
                claim("narx-paper", "goal_time", or_nan(every[f"mean_{name}_pct"]), name=name)
                for name in ("Ti", "Tt")
            ),
        ],
        tables=[times_table(rows), class_table(pooled, classes, ERROR_PCT)],
        results={"families": rows, "max_rel_pct": pooled, "classes": classes, "all": every},
    )


def family_of(name: str) -> str:
    """Which family of records a log belongs to, in words."""
    return FAMILIES.get(name.partition("/")[0], _PAPER_FAMILY)


def _families(found: Sequence[LogEvaluation], events: Sequence[Classed]) -> list[dict[str, Any]]:
    rows = []
    for family in dict.fromkeys(family_of(one.log.name) for one in found):
        own = [one for one in events if family_of(one.log.log.name) == family]
        times = figures_of(assessments_of(own))
        worst = worst_pct([one for one in found if family_of(one.log.name) == family])
        rows.append({"group": family, **times, "max_rel_pct": worst})
    return rows


def _tested(data: DataSets, tests: Sequence[Log]) -> str:
    parts = [f"data sets {data.labels(data.tests)}"]
    for family in dict.fromkeys(family_of(log.name) for log in tests):
        if family != _PAPER_FAMILY:
            count = sum(family_of(log.name) == family for log in tests)
            parts.append(f"{count} of {family}")
    return "; ".join(parts)


SCHEMA = "narxcal.reproduce/1"
PAPER = "narx-paper"


@dataclass(frozen=True, eq=False)
class Reproduction:
    """Every study, and the calibration that most of them judge."""

    studies: tuple[Study, ...]
    bundle: Bundle
    data: DataSets

    @property
    def outcome(self) -> Outcome:
        """The verdict: it passes where no claim was missed."""
        return outcome_of(self.studies)

    def document(self) -> dict[str, Any]:
        data, said = self.data, missed(self.studies)
        training = self.bundle.record.training
        return {
            "schema": SCHEMA,
            "paper": PAPER,
            "ok": not said,
            "missed": said,
            "data_sets": [
                {"data_set": data.number(log.name), "log": log.name, "sha256": log.source.sha256}
                for log in data.logs
            ],
            "test": [data.number(log.name) for log in data.tests],
            "studies": [study.row() for study in self.studies],
            "training": {"status": training.status, "wall_s": training.wall_s},
            "config": data.config.model_dump(mode="json", by_alias=True),
            "versions": versions(),
        }


def reproduce(data: DataSets, effort: Effort, progress: Progress = silent) -> Reproduction:
    """Run all studies; the same data, configuration and effort give the same numbers.

    Raises what the studies raise: `DataError` for logs that they cannot be run on, `ConfigError`
    for a configuration that does not fit the logs.
    """
    progress(0, 0, "Reading the flights")
    first = [correlation(data), smoothing(data), segments(data)]
    config = within(data.config, effort)
    options = TrainOptions(_named(progress, "Calibrating"))
    bundle = calibrate(config, data.base, data.training, options)
    return Reproduction((*first, *_judging(data, bundle, effort, progress)), bundle, data)


def _judging(data: DataSets, bundle: Bundle, effort: Effort, progress: Progress) -> Iterator[Study]:
    progress(0, 0, "Comparing inputs")
    yield inputs(data, effort)
    progress(0, 0, "Comparing deviations")
    yield deviations(data, bundle, effort)
    found = judged(bundle, data.tests)
    events = classed(data.config.events.driver, found)
    yield accuracy(data, bundle, found, events)
    yield response_times(data, bundle, found, events)
    progress(0, 0, "Dividing at random")
    yield splits(data, effort, _named(progress, "Dividing at random"))
    yield noise(data, bundle, effort, _named(progress, "Adding noise"))
    yield goal(data, _widened(data, bundle, effort, progress))


def _named(progress: Progress, what: str) -> Progress:
    """Progress of one step of the reproduction, whatever is at work within it."""
    return lambda done, total, _within="": progress(done, total, what)


def _widened(data: DataSets, bundle: Bundle, effort: Effort, progress: Progress) -> Bundle:
    """The calibration of all records, which is `bundle` where there are no further ones."""
    if not data.further:
        return bundle
    config = within(goal_config(data.config), effort)
    options = TrainOptions(_named(progress, "Calibrating on all records"))
    return calibrate(config, data.base, goal_training(data), options)
