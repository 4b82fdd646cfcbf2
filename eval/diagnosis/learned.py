"""What a run gets wrong by itself: learned from its own training flights, kept in its folder.

Models without some of the flights say what the run says of flights that it does not know.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from data_prep.cleaning.clean import clean
from data_prep.log import Finding, Log
from data_prep.prepare import prepare
from data_prep.reading import read_logs
from eval.diagnosis.flights import batch
from eval.diagnosis.pairs import Pair, alike, pair_logs, simulated_log, with_known_inputs
from eval.diagnosis.simulators import simulate_by
from eval.run_logs import run_config
from narxcal.calibration.bundle import DOCUMENT, Bundle, load_bundle
from narxcal.calibration.folder import seal
from narxcal.effects.library import hypotheses
from narxcal.support.errors import DataError, ModelError
from narxcal.support.files import atomic_write_text, sha256_of, to_json
from training.config import RunConfig
from training.diagnosis.dictionary import Dictionary
from training.diagnosis.discrepancy import Discrepancy, learn, read
from training.diagnosis.emulator import choose_control, fit_emulators
from training.folds import LEAVE_ONE_OUT, Plan, Segment
from training.pipeline import run_plans
from training.records import split_logs

LEARNED: Final = "discrepancy.json"  # in a run folder
_FOLDS: Final = 3  # at most: each is a training


def _plans(
    raw: Sequence[Log], config: RunConfig, faults: Mapping[str, Sequence[Finding]]
) -> list[Plan]:
    """Trainings on prepared logs, and the logs as recorded that they are without."""
    prepared = {
        one.log.name: replace(one.log, findings=tuple(faults.get(one.log.name, ())))
        for one in prepare(raw, config)
    }
    recorded = {
        log.name: with_known_inputs(
            clean(log, config.clean), faults.get(log.name, ()), config.logs.max_gap_s
        )
        for log in raw
        if log.name in prepared
    }
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
    simulate = simulate_by(bundle.calibration)
    logs = [part.log for part in plan.test]
    return [pair_logs(log.name, log, simulated_log(log, simulate)) for log in logs]


def learn_left_out(run: Path, *, trust: bool = False) -> Discrepancy:
    """Learn from a run's own training flights by models without them.

    Up to three models, each without every third flight; of a single flight halves stand for
    flights, and count as one. Raises `DataError` where the training logs are not at hand, and as
    the training.
    """
    bundle = load_bundle(run, trust=trust)
    config, base = run_config(bundle)[0], Path(bundle.record.base)
    raw = split_logs(read_logs(config.logs.resolve(base), config.logs), config.split).train
    known = bundle.record.data
    for log in raw:
        if known.get(log.source.file, log.source.sha256) != log.source.sha256:
            raise DataError("is not the file that the run was trained on", file=log.source.file)
    screening, faults = bundle.record.screening, dict[str, list[Finding]]()
    for row in () if screening is None else screening.findings:
        each = Finding.from_row(row)
        faults.setdefault(each.log, []).append(each)
    plans = _plans(raw, config, faults)
    pairs = alike([pair for some in run_plans(plans, config, base, _pairs, -1) for pair in some])
    found = learned_from(pairs)
    if len({pair.name.partition("[")[0].partition(":")[0] for pair in pairs}) == 1:
        found = replace(found, flights=1)
    return found


def learned_from(pairs: Sequence[Pair]) -> Discrepancy:
    record = batch(pairs)
    emulator = choose_control(fit_emulators(record.flights), record)
    return learn(record, Dictionary(hypotheses(record.flights.signals), record.flights, emulator))


def keep_learned(found: Discrepancy, run: Path) -> None:
    """Write what was learned into the folder of a run, with its own hash and that of the bundle.

    Raises `ConfigError` where that cannot be written.
    """
    stored = {**found.document(), "bundle_sha256": sha256_of(run / DOCUMENT)}
    atomic_write_text(run / LEARNED, to_json({**stored, "sha256": seal(stored)}))


def learned_by(run: Path) -> Discrepancy | None:
    """What was learned of a run and kept in its folder; None where nothing was.

    Raises `ModelError` for a file that was altered, or was learned for another run.
    """
    file = run / LEARNED
    if not file.is_file():
        return None
    again = "Learn it again by diagnose --learn"
    try:
        stored = json.loads(file.read_text(encoding="utf-8"))
        intact = stored.pop("sha256") == seal(stored)
        if intact and stored["bundle_sha256"] == sha256_of(file.with_name(DOCUMENT)):
            return read(stored)
    except (AttributeError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise ModelError(f"is unusable: {error!r}", file=file, hint=again) from None
    what = "was learned for another model" if intact else "was altered: its hash is another"
    raise ModelError(what, file=file, hint=again)
