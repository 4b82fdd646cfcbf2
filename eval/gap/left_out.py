"""What a run gets wrong by itself, learned from its own training flights by models without them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from data_prep.clean import clean
from data_prep.log import Log
from data_prep.prepare import prepare
from data_prep.reading import read_logs
from eval.evaluate import run_config
from eval.gap.data import Pair
from eval.gap.pairs import alike, pair_logs, simulated_log
from eval.gap.simulators import simulate_by
from narxcal.calibration.bundle import Bundle
from narxcal.support.errors import DataError
from training.config import RunConfig
from training.crossval import LEAVE_ONE_OUT, Plan, Segment, run_plans
from training.records import split_logs

_FOLDS: Final = 3  # at most: each is a training


def left_out_pairs(bundle: Bundle, jobs: int = -1) -> list[Pair]:
    """Pair every training flight of a run with what a model of the others says of it.

    Up to three models, each without every third flight; of a single flight each half stands for
    one. Raises `DataError` where the training logs are not at hand any more.
    """
    config, _ = run_config(bundle)
    base = Path(bundle.record.base)
    raw = split_logs(read_logs(config.logs.resolve(base), config.logs), config.split).train
    known = bundle.record.data
    for log in raw:
        if known.get(log.source.file, log.source.sha256) != log.source.sha256:
            raise DataError("is not the file that the run was trained on", file=log.source.file)
    pairs: list[Pair] = []
    for found in run_plans(_plans(raw, config), config, base, _pairs, jobs):
        pairs += found
    return alike(pairs)


def _plans(raw: Sequence[Log], config: RunConfig) -> list[Plan]:
    """Trainings on prepared logs, and the logs as recorded that they are without."""
    prepared = {one.log.name: one.log for one in prepare(raw, config)}
    recorded = {log.name: clean(log, config.clean) for log in raw if log.name in prepared}
    flights = list(dict.fromkeys(log.source.file for log in recorded.values()))
    if len(flights) == 1:
        return [_half(prepared, recorded, second) for second in (0, 1)]
    groups = [flights[k :: min(_FOLDS, len(flights))] for k in range(min(_FOLDS, len(flights)))]
    return [
        Plan(
            LEAVE_ONE_OUT,
            f"without {', '.join(group)}",
            tuple(_whole(log) for log in prepared.values() if log.source.file not in group),
            tuple(_whole(log) for log in recorded.values() if log.source.file in group),
        )
        for group in groups
    ]


def _whole(log: Log) -> Segment:
    return Segment(log, 0, len(log), ())


def _half(prepared: dict[str, Log], recorded: dict[str, Log], number: int) -> Plan:
    """Train on the other half of every log, and try half `number`, 0 or 1."""

    def half(log: Log, which: int) -> Segment:
        middle = len(log) // 2
        return Segment(log, middle * which, middle + which * (len(log) - middle), ())

    train = tuple(half(log, 1 - number) for log in prepared.values())
    test = tuple(half(log, number) for log in recorded.values())
    return Plan(LEAVE_ONE_OUT, f"half {1 + number}", train, test)


def _pairs(bundle: Bundle, plan: Plan) -> list[Pair]:
    """What a model says of the flights that it is without."""
    simulate = simulate_by(bundle.calibration)
    found = []
    for part in plan.test:
        log = part.log
        found.append(pair_logs(log.name, log, simulated_log(log, simulate)))
    return found
