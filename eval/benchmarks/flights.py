"""Leave one flight out, with the shipped configurations as they stand, against the targets.

`python -m eval.benchmarks.flights RUN OUT.png` draws the README's picture: the fast push with the
largest lever movement of the first held-out log, whatever the model's error.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from data_prep.log import Log
from data_prep.prepare import hold_inputs, prepare
from data_prep.reading import read_logs
from eval.benchmarks import Row
from eval.judging.evaluate import Evaluation, evaluate
from eval.report.event_figures import summary_figure
from eval.report.view import view_of
from eval.run_logs import evaluation_logs, run_config
from narxcal.calibration.bundle import Bundle, load_bundle
from narxcal.channels import channel
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import DataError
from narxcal.support.files import atomic_write_bytes
from training.config import RunConfig, load_config
from training.folds import leave_one_flight_out
from training.pipeline import calibrate, configured_files
from training.records import Split
from training.responses.transients import AssessedEvent, Tally, tally

_SOURCE = "our goal"
_PART = 0.2


@dataclass(frozen=True)
class Campaign:
    """Flights of one configuration; targets in the channels' units, and for errors in %.

    `unlogged` (file -> (start, stop) in s, ...) are windows of a load that no channel records;
    errors and events outside of them are shown in addition to the whole.
    """

    name: str
    config: str
    as_is: Mapping[str, float]
    trimmed: Mapping[str, float]
    max_rel_pct: float = math.nan
    passed_pct: float = 95.0
    unlogged: Mapping[str, Sequence[tuple[float, float]]] = field(default_factory=dict)


# The load that docs/results.md names, in seconds after the start: by an earlier search for its
# edges, where in both engines N1 falls by 1.9 % and ITT rises by 14, then 25 degC.
_LOADS_S = ((455.0, 1466.0), (2327.0, 2617.0), (3651.0, 4040.0))
CAMPAIGNS = (
    Campaign(
        "Citation II",
        "citation2.toml",
        {"N1_pct": 1.1, "N2_pct": 0.65, "EGT_C": 17.0},
        {"N1_pct": 0.9, "N2_pct": 0.5, "EGT_C": 14.0},
        unlogged={"citation_20190312_flight2": _LOADS_S},
    ),
    Campaign("AGTF30", "agtf30.toml", {}, {}, max_rel_pct=5.0, passed_pct=100.0),
)


def rows(data: Path | None = None, campaigns: Sequence[Campaign] = CAMPAIGNS) -> list[Row]:
    """Measure every campaign whose logs are there; `data` replaces the folder of its logs.

    A campaign without logs becomes a row that says so.
    """
    found: list[Row] = []
    for campaign in campaigns:
        config, base = load_config(campaign.config)
        if data is not None:
            config = config.with_logs_in(data)
        try:
            files = configured_files(config, base)
        except DataError as error:
            note = f"not measured: {error}"
            found.append(Row(campaign.name, "all", math.nan, "", note=note))
            continue
        for name, bundle, test in left_one_out(config, base, files):
            found += _judged(campaign, name, bundle, test)
    return found


def left_one_out(
    config: RunConfig, base: Path, files: Sequence[Path]
) -> Iterator[tuple[str, Bundle, list[Log]]]:
    """Every flight in turn as the test flight: its name, a model of all others, its logs."""
    logs = [one.log for one in prepare(read_logs(files, config.logs), config)]
    for plan in leave_one_flight_out(logs, config.events):
        train, test = ([part.log for part in parts] for parts in (plan.train, plan.test))
        yield plan.name, trained_on(config, base, train), test


def trained_on(config: RunConfig, base: Path, logs: Sequence[Log]) -> Bundle:
    """A model of all of these prepared logs."""
    held = tuple(hold_inputs(log, config.steady_state.inputs) for log in logs)
    return calibrate(config, base, Split(held, (), ()))


def _judged(campaign: Campaign, name: str, bundle: Bundle, test: Sequence[Log]) -> Iterator[Row]:
    for trim, targets in ((None, campaign.as_is), (_PART, campaign.trimmed)):
        found = evaluate(bundle, test, trim)
        group = f"{campaign.name}, {name}, {'as is' if trim is None else f'trim {trim:g}'}"
        yield from _response_times(campaign, group, found.tally, found.config.transients.rules)
        yield from _errors(campaign, group, found, targets)
        windows = _windows(campaign, test)
        if windows:
            yield from _outside(campaign, (group, found), windows, targets)


def _windows(campaign: Campaign, test: Sequence[Log]) -> Sequence[tuple[float, float]]:
    for name, windows in campaign.unlogged.items():
        if all(Path(log.source.file).name.startswith(name) for log in test):
            return windows
    return ()


def _outside(
    campaign: Campaign,
    judged: tuple[str, Evaluation],
    windows: Sequence[tuple[float, float]],
    targets: Mapping[str, float],
) -> Iterator[Row]:
    """The same figures, errors pooled over all engines, where no unlogged load was found."""
    group, found = judged[0] + ", outside unlogged loads", judged[1]
    rmse, counts = _unloaded(found, windows)
    yield from _response_times(campaign, group, counts, found.config.transients.rules)
    for output, value in zip(found.logs[0].run.channels, rmse.tolist(), strict=True):
        yield Row(
            group, f"RMSE {output}", value, channel(output).unit,
            targets[output], "at most", _SOURCE, "pooled over the engines",
        )  # fmt: skip


def _unloaded(
    found: Evaluation, windows: Sequence[tuple[float, float]]
) -> tuple[FloatArray, Tally]:
    """RMSE (outputs,) pooled over all engines and Ti/Tt outside of `windows`."""
    squares, events = [], []
    for log in found.logs:
        run, time_s = log.run, log.log.time_s
        inside = [(time_s >= start) & (time_s <= stop) for start, stop in windows]
        loaded = np.any([np.zeros(len(time_s), dtype=np.bool_), *inside], axis=0)
        squares.append(np.square(run.model - run.measured)[run.scored & ~loaded])
        events += [one for one in log.assessments if not loaded[time_s.searchsorted(one.start_s)]]
    return np.sqrt(np.nanmean(np.concatenate(squares), axis=0)), tally(events)


def _errors(
    campaign: Campaign, group: str, found: Evaluation, targets: Mapping[str, float]
) -> Iterator[Row]:
    """RMSE of the worst log where there is a target for it, else the largest relative error."""
    for output, pooled in found.pooled.items():
        scores = [log.scores[output] for log in found.logs]
        if output in targets:
            worst = max(score.rmse for score in scores)
            note = f"worst of {len(scores)} engines; pooled {pooled.rmse:.3g}"
            yield Row(
                group, f"RMSE {output}", worst, channel(output).unit,
                targets[output], "at most", _SOURCE, note,
            )  # fmt: skip
        else:
            worst = max(score.max_rel_pct for score in scores)
            yield Row(
                group, f"max relative error {output}", worst, "%",
                campaign.max_rel_pct, "at most", _SOURCE, f"RMSE {pooled.rmse:.3g}",
            )  # fmt: skip


def _response_times(campaign: Campaign, group: str, counts: Tally, rules: str) -> Iterator[Row]:
    passed = math.nan if counts.passed_pct is None else counts.passed_pct
    note = f"{counts.passed} of {counts.assessed} assessed; rules {rules}"
    yield Row(
        group, "Ti and Tt passed", passed, "%", campaign.passed_pct, "at least", _SOURCE, note
    )


class Passes(NamedTuple):
    """Response times in tolerance, how many were assessed, and those of the best baseline."""

    passed: int
    assessed: int
    baseline: int

    @classmethod
    def of(cls, found: Evaluation, baselines: Sequence[str]) -> Passes:
        """Count over all logs; `baselines` are those that the model is compared with."""
        best = max(
            sum(log.baselines[name].passed for log in found.logs if name in log.baselines)
            for name in baselines
        )
        return cls(found.tally.passed, found.tally.assessed, best)

    def row(self, group: str, name: str, source: str) -> Row:
        """As a share, with the baseline's as the target."""
        share = 100.0 / self.assessed if self.assessed else math.nan
        note = f"{self.passed} of {self.assessed}; best baseline {self.baseline}"
        return Row(
            group, name, share * self.passed, "%", share * self.baseline, "at least", source, note
        )


def main(arguments: Sequence[str] | None = None) -> int:
    """Evaluate the first held-out log of a run and draw one event of it."""
    parser = argparse.ArgumentParser(prog="python -m eval.benchmarks.flights", description=__doc__)
    parser.add_argument("bundle", metavar="RUN", type=Path)
    parser.add_argument("out", metavar="OUT.png", type=Path)
    options = parser.parse_args(arguments)
    bundle = load_bundle(options.bundle)
    config, settings = run_config(bundle)
    [one] = evaluate(bundle, evaluation_logs(bundle)[:1], None, settings).logs
    view = view_of(one, config.events.driver, bundle.calibration.input_names)
    atomic_write_bytes(options.out, summary_figure(view, largest_push(view.events)))
    return 0


def largest_push(events: Sequence[AssessedEvent]) -> AssessedEvent:
    """The fast push, assessed in every channel, that moves the driver most; or `DataError`."""
    pushes = [
        one
        for one in events
        if one.move == "fast push" and all(each.verdict.ok is not None for each in one.assessments)
    ]
    if not pushes:
        raise DataError("no fast push could be assessed in every channel")
    return max(pushes, key=lambda one: one.event.lever_after - one.event.lever_before)


if __name__ == "__main__":
    sys.exit(main())
