"""What the two open Citation II flights hold that a model of the other flight does not.

    python -m eval.diagnosis.flights_study --data ../shared/data/flights

For either flight the simulator is a calibration of the other one (`citation2.toml`), fuel flow
being the input, as a free run over the whole flight; nothing is learned beforehand. It prints the
answer for both engines together, and what that for one engine explains in the other.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from eval.diagnosis.diagnose import diagnose_pairs
from eval.diagnosis.pairs import pair_logs, simulated_log
from eval.diagnosis.simulators import simulate_by
from eval.diagnosis.words import percent, sentences
from narxcal.channels import symbol
from training.config import RunConfig, load_config
from training.folds import leave_one_flight_out
from training.pipeline import calibrate, configured_files, prepare_logs
from training.records import Split


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m eval.diagnosis.flights_study", description=__doc__
    )
    parser.add_argument("--data", type=Path, default=Path("../shared/data/flights"))
    parser.add_argument("--config", default="citation2.toml")
    options = parser.parse_args(arguments)
    config, base = load_config(options.config)
    logs = config.logs.model_copy(update={"folder": str(options.data.resolve())})
    for line in study(config.model_copy(update={"logs": logs}), base):
        sys.stdout.write(f"{line}\n")
    return 0


def study(config: RunConfig, base: Path) -> Iterator[str]:
    """Diagnose every flight in turn, simulated by a calibration of the others."""
    logs = prepare_logs(config, configured_files(config, base))
    for plan in leave_one_flight_out(logs, config.events):
        train, test = ([part.log for part in parts] for parts in (plan.train, plan.test))
        simulate = simulate_by(calibrate(config, base, Split(tuple(train), (), ())).calibration)
        pairs = [
            pair_logs(log.source.engine or log.name, log, simulated_log(log, simulate))
            for log in test
        ]
        yield f"{test[0].source.file}, by a model of {train[0].source.file}"
        yield from written(diagnose_pairs(pairs).document)
        for one in pairs:
            found = diagnose_pairs([one], [other for other in pairs if other is not one]).document
            shrink = found["shrink"]
            expected = ", ".join(percent(shrink["predicted"][k]) for k in ("value", "low", "high"))
            yield f"  {one.name} alone: {', '.join(found['verdict']['effects']) or 'nothing'}"
            yield f"    off the other: expected {expected}; taken {percent(shrink['realised'])}"


def written(document: Mapping[str, Any]) -> Iterator[str]:
    """The answer in words, its budget, windows of a load, and RMS of the gap."""
    yield from sentences(document)
    for row in document["budget"]:
        yield f"  {row['cause']}: {percent(row['share'])}"
    for effect in document["effects"]:
        for row in effect.get("windows", ()):
            yield f"  {row['log']}: on from {row['start_s']:.0f} to {row['end_s']:.0f} s"
    for name, row in document["shrink"]["channels"].items():
        yield f"  {symbol(name)}: RMS {row['before']:.3g}, without the effects {row['after']:.3g}"


if __name__ == "__main__":
    sys.exit(main())
