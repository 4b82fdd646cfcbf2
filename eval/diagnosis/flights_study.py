"""What the two open Citation II flights hold that a model of the other flight does not.

    python -m eval.diagnosis.flights_study --data ../shared/data/flights --out FOLDER

For either flight the simulator is a calibration of the other one (`citation2.toml`), fuel flow
being the input, as a free run over the whole flight. It writes `citation_gap.md`.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from data_prep.log import Log
from eval.diagnosis.diagnose import diagnose_pairs
from eval.diagnosis.page import budget_table
from eval.diagnosis.pairs import Pair, match_simulated, pair_logs
from eval.diagnosis.simulators import Simulate
from eval.diagnosis.words import sentences
from narxcal.channels import symbol
from narxcal.support.arrays import FloatArray
from training.config import RunConfig, load_config
from training.folds import leave_one_flight_out
from training.pipeline import calibrate, calibration_for, configured_files, prepare_logs
from training.records import Split

PAGE = "citation_gap.md"
Document = Mapping[str, Any]


class FlightStudy(NamedTuple):
    """One flight judged by a model of another.

    `both` is the answer for its engines together; `crossed` maps an engine to the answer for it
    alone, checked on the other engine.
    """

    title: str
    both: Document
    crossed: Mapping[str, Document]


def main(arguments: Sequence[str] | None = None) -> int:
    """Study all flights of the folder and write the page."""
    parser = argparse.ArgumentParser(
        prog="python -m eval.diagnosis.flights_study", description=__doc__
    )
    parser.add_argument("--data", type=Path, default=Path("../shared/data/flights"))
    parser.add_argument("--out", type=Path, default=Path())
    parser.add_argument("--config", default="citation2.toml")
    options = parser.parse_args(arguments)
    config, base = load_config(options.config)
    moved = config.logs.model_copy(update={"folder": str(options.data.resolve())})
    found = list(studies(config.model_copy(update={"logs": moved}), base))
    (options.out / PAGE).write_text(written(found), encoding="utf-8")
    return 0


def studies(config: RunConfig, base: Path) -> Iterator[FlightStudy]:
    """Every flight in turn, simulated by a calibration of the others."""
    logs = prepare_logs(config, configured_files(config, base))
    for plan in leave_one_flight_out(logs, config.events):
        train, test = ([part.log for part in parts] for parts in (plan.train, plan.test))
        title = f"{_flight(test)}, by a model of {_flight(train)}"
        yield study(title, paired(test, simulator(config, base, train)))


def simulator(config: RunConfig, base: Path, train: Sequence[Log]) -> Simulate:
    """A calibration of logs, as a simulator of other flights."""
    calibration = calibrate(config, base, Split(tuple(train), (), ())).calibration

    def simulate(log: Log) -> Mapping[str, FloatArray]:
        own = calibration_for(calibration, log)
        outputs = own.simulate(log.matrix(own.input_names))
        return dict(zip(own.output_names, outputs.T, strict=True))

    return simulate


def paired(logs: Sequence[Log], simulate: Simulate) -> list[Pair]:
    """Each engine's log with what the simulator says of its inputs."""
    names = [log.source.engine or log.name for log in logs]
    return [
        pair_logs(name, log, match_simulated(name, log, simulate))
        for name, log in zip(names, logs, strict=True)
    ]


def study(title: str, pairs: Sequence[Pair]) -> FlightStudy:
    """Diagnose all engines of a flight together, and each alone with the others held out."""
    crossed = {
        one.name: diagnose_pairs([one], [other for other in pairs if other is not one]).document
        for one in pairs
    }
    return FlightStudy(title, diagnose_pairs(pairs).document, crossed)


def _flight(logs: Sequence[Log]) -> str:
    return ", ".join(dict.fromkeys(Path(log.source.file).name.split(".")[0] for log in logs))


def written(found: Sequence[FlightStudy]) -> str:
    """The page."""
    return "\n".join([_HEAD, *(line for one in found for line in _section(one))])


_HEAD = """# What the two Citation II flights hold that a model of the other does not

This page is made by

    python -m eval.diagnosis.flights_study --data ../shared/data/flights

There are two flights of one aircraft, a year apart, both engines of each. Each flight is simulated
by a calibration of the other one (`citation2.toml`), fuel flow being the input, as a free run over
the whole flight; both engines together are then diagnosed as `narxcal diagnose` does, with
nothing learned beforehand. ITT stands in the column EGT. Last, each engine is diagnosed alone, and
what was found is added to the simulation of the other one.
"""


def _section(one: FlightStudy) -> Iterator[str]:
    yield f"## {one.title}\n"
    yield " ".join(sentences(one.both)) + "\n"
    table = budget_table(one.both)
    yield from _rows(table.head, [[cell.text for cell in row] for row in table.rows])
    windows = [row for effect in one.both["effects"] for row in effect.get("windows", ())]
    if windows:
        yield "\nWhen the load was on, in seconds of the logs' own clock:\n"
        ends = ("start_s", "end_s")
        rows = [[row["log"], *(f"{row[end]:.0f}" for end in ends)] for row in windows]
        yield from _rows(("engine", "from, s", "to, s"), rows)
    yield "\nRMS of recorded less simulated:\n"
    rows = [
        [symbol(name), f"{row['before']:.3g}", f"{row['after']:.3g}", f"{row['floor']:.2g}"]
        for name, row in one.both["shrink"]["channels"].items()
    ]
    yield from _rows(("channel", "before", "after", "noise"), rows)
    yield "\nWhat the diagnosis of one engine alone explains in the other:\n"
    yield from _rows(
        ("diagnosed", "named", "expected off the squared gap of the other", "taken off it"),
        [[name, *_expected(document)] for name, document in one.crossed.items()],
    )
    yield ""


def _expected(document: Document) -> list[str]:
    shrink, named = document["shrink"], document["verdict"]["effects"]
    low, high = (100.0 * shrink["predicted"][key] for key in ("low", "high"))
    expected = f"{100.0 * shrink['predicted']['value']:.0f} % ({low:.0f} to {high:.0f})"
    effects = ", ".join(f"`{name}`" for name in named) or "nothing"
    return [effects, expected, f"{100.0 * shrink['realised']:.0f} %"]


def _rows(head: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    for row in (head, ["---"] * len(head), *rows):
        yield f"| {' | '.join(row)} |"


if __name__ == "__main__":
    sys.exit(main())
