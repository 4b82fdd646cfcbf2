"""What a configuration of columns and split alone is worth: `python -m eval.bench --untuned`.

On every set one recording takes no part in training. The figures of the model stand beside those
of the better baseline (first-order lag or linear ARX, channel by channel).
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from eval.benchmarks.row import Row
from eval.benchmarks.untuned_sets import SETS, UntunedSet
from eval.evaluate import Evaluation, evaluate
from eval.runs import ARX, FIRST_ORDER
from narxcal.channels import channel
from narxcal.errors import DataError
from training.config import SCHEMA, RunConfig
from training.pipeline import calibrate, configured_files, prepare_logs, split_logs

_SOURCE: Final = "the better of first-order lag and linear ARX on the same rows"


def rows(data: Path, seed: int, sets: Sequence[UntunedSet] = SETS) -> Iterator[Row]:
    """Measure every set whose logs are there; flights are drawn from `seed`."""
    for one in sets:
        with tempfile.TemporaryDirectory() as folder:
            try:
                found = judged(one, one.logs(Path(folder), seed, data))
            except DataError as error:
                yield Row(one.name, "all", math.nan, "", note=f"not measured: {error}")
                continue
        yield from rows_of(one.name, found)


def judged(one: UntunedSet, folder: Path) -> Evaluation:
    """Train on a set as its configuration says, and evaluate what took no part."""
    tables: dict[str, Any] = {**one.tables, "schema": SCHEMA}
    tables["logs"] = {**tables.get("logs", {}), "folder": str(folder)}
    config = RunConfig.parse(tables, one.name)
    split = split_logs(prepare_logs(config, configured_files(config, folder)), config.split)
    return evaluate(calibrate(config, folder, split), split.test)


def rows_of(group: str, found: Evaluation) -> Iterator[Row]:
    """Error of each channel, and the share of response times in tolerance."""
    for name, pooled in found.pooled.items():
        best = min(pooled.first_order_rmse, pooled.arx_rmse, key=_known)
        unit = channel(name).unit
        yield Row(group, f"RMSE {name}", pooled.rmse, unit, best, "at most", _SOURCE)
    rivals = [_passed(found, name) for name in (FIRST_ORDER, ARX)]
    counts = found.tally
    passed = math.nan if counts.passed_pct is None else counts.passed_pct
    best = max(rivals) * 100.0 / counts.assessed if counts.assessed else math.nan
    note = f"{counts.passed} of {counts.assessed}; best baseline {max(rivals)}"
    yield Row(group, "Ti and Tt passed", passed, "%", best, "at least", _SOURCE, note)


def _passed(found: Evaluation, rival: str) -> int:
    return sum(log.rivals[rival].passed for log in found.logs if rival in log.rivals)


def _known(value: float) -> float:
    return math.inf if math.isnan(value) else value
