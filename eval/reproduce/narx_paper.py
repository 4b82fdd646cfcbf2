"""All tables and figures of the calibration paper, from the data sets to one page and one JSON."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol

from eval.outcome import Outcome
from eval.reproduce.data import DataSets, Effort, within
from eval.reproduce.goal import goal, goal_config, goal_training
from eval.reproduce.inputs import deviations, inputs
from eval.reproduce.noise import correlation, noise, segments, smoothing
from eval.reproduce.response import accuracy, classed, judged, response_times, splits
from eval.reproduce.study import Study, missed, outcome_of
from narxcal.calibration.bundle import Bundle
from narxcal.support.files import versions
from training.config import RunConfig
from training.network import Progress
from training.pipeline import TrainOptions, calibrate
from training.records import Split

SCHEMA = "narxcal.reproduce/1"
PAPER = "narx-paper"


class Watch(Protocol):
    """Called with the name of a step, and with the work done and in all where it is known."""

    def __call__(self, what: str, done: int = 0, total: int = 0) -> None: ...  # noqa: D102


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
        """`reproduce.json`."""
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


def reproduce(data: DataSets, effort: Effort, watch: Watch | None = None) -> Reproduction:
    """Run all studies; the same data, configuration and effort give the same numbers.

    Raises what the studies raise: `DataError` for logs that they cannot be run on, `ConfigError`
    for a configuration that does not fit the logs.
    """
    report = watch or _ignore
    report("Reading the flights")
    first = [correlation(data), smoothing(data), segments(data)]
    config = within(data.config, effort)
    bundle = _calibrated(data, (config, data.training), (report, "Calibrating"))
    return Reproduction((*first, *_judging(data, bundle, effort, report)), bundle, data)


def _calibrated(
    data: DataSets, given: tuple[RunConfig, Split], progress: tuple[Watch, str]
) -> Bundle:
    """Calibrate as `given`, on the training part; `progress` is a watch and the step's name."""
    config, split = given
    report, what = progress
    total = sum(config.train.iterations) * config.train.starts
    if not config.narx.joint:
        total *= len(config.narx.outputs)
    seen = 0

    def watch(progress: Progress) -> None:
        nonlocal seen
        seen += bool(progress.history)
        report(what, min(seen, total), total)

    return calibrate(config, data.base, split, TrainOptions(watch))


def _judging(data: DataSets, bundle: Bundle, effort: Effort, report: Watch) -> Iterator[Study]:
    report("Comparing inputs")
    yield inputs(data, effort)
    report("Comparing deviations")
    yield deviations(data, bundle, effort)
    found = judged(bundle, data.tests)
    events = classed(data.config.events.driver, found)
    yield accuracy(data, bundle, found, events)
    yield response_times(data, bundle, found, events)
    what = "Dividing at random"
    report(what)
    yield splits(data, effort, lambda _fold, done, total: report(what, done, total))
    yield noise(data, bundle, effort, lambda done, total: report("Adding noise", done, total))
    yield goal(data, _widened(data, bundle, effort, report))


def _widened(data: DataSets, bundle: Bundle, effort: Effort, report: Watch) -> Bundle:
    """The calibration of all records, which is `bundle` where there are no further ones."""
    if not data.further:
        return bundle
    config = within(goal_config(data.config), effort)
    progress = (report, "Calibrating on all records")
    return _calibrated(data, (config, goal_training(data)), progress)


def _ignore(what: str, done: int = 0, total: int = 0) -> None:
    del what, done, total
