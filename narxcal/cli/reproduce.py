"""`narxcal reproduce PAPER`: a paper's tables and figures, our numbers next to its claims.

OUT holds the page and its JSON; of the calibration paper also the flights (unless the user brought
some) and the model.
"""

from __future__ import annotations

import shutil
from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from eval import terminal
from eval.judging.outcome import Outcome
from eval.report.page import RunHeader
from eval.reproduce.citation_static import KINDS
from eval.reproduce.citation_x import CONTRADICTIONS
from eval.reproduce.citation_x import reproduce as citation_x
from eval.reproduce.data import (
    TABLE,
    Effort,
    flown,
    paper_scenario,
    read_data_sets,
    with_table,
    write_records,
)
from eval.reproduce.narx_paper import SCHEMA, Reproduction, reproduce
from eval.reproduce.spey import spey_studies
from eval.reproduce.study import Study, counts, missed, outcome_of, reproduction_page
from narxcal.calibration.bundle import write_bundle
from narxcal.cli.console import Console
from narxcal.cli.options import add_data, add_jobs, add_out, seed
from narxcal.cli.results import data_files, read_config
from narxcal.support.files import Results, atomic_write_text, to_json, versions
from training.config import RunConfig
from training.responses.rules import rules

DOCUMENT, PAGE, FLIGHTS, MODEL = "reproduce.json", "reproduce.html", "flights", "model"
RESULTS = Results(SCHEMA, DOCUMENT, (PAGE, FLIGHTS, MODEL))
OWN = "narx_paper.toml"
QUICK = ((2, 2), 2)  # iterations per horizon, random divisions
PAPERS = ("narx-paper", "spey", "citation-x")
SPEY_SEEDS, SPEY_QUICK_SEEDS = 100, 4


def add_options(parser: ArgumentParser) -> None:
    parser.add_argument("paper", metavar="PAPER", choices=PAPERS, help=", ".join(PAPERS))
    add_out(parser)
    parser.add_argument(
        "--config", metavar="CONFIG", default="narx_paper.toml", help="default narx_paper.toml"
    )
    add_data(parser, "folder of your own data sets, instead of virtual flights")
    parser.add_argument("--seed", metavar="N", type=seed, default=0, help="of the virtual flights")
    parser.add_argument("--quick", action="store_true", help="few steps and two divisions")
    add_jobs(parser, "folds")


def run(options: Namespace, console: Console) -> int:
    """Run every study of the paper; 1 where a claim was not reached."""
    out: Path = options.out.resolve()
    RESULTS.check(out)
    if options.paper != PAPERS[0]:
        return _identification_paper(options, out, console)
    config, base = read_config(options.config, options.data)
    _warn(options, console)
    _begin(out)
    with console.progress("Flying the data sets"):
        config = _placed(config, base, out, options)
    with console.progress("Reading the data sets"):
        data = read_data_sets(config, base)
    iterations, splits = QUICK if options.quick else ((), 10)
    with console.progress("Studies") as advance:
        found = reproduce(data, Effort(iterations, splits, options.jobs), advance)
    document = {**found.document(), "complete": True, "quick": options.quick, "seed": options.seed}
    write_bundle(out / MODEL, found.bundle)
    atomic_write_text(out / PAGE, reproduction_page(_header(found, options), found.studies))
    atomic_write_text(out / DOCUMENT, to_json(document))
    _show_studies(console, found.studies, found.outcome)
    console.finish(document, f"Page: {options.out / PAGE}")
    return found.outcome.exit_code


def _identification_paper(options: Namespace, out: Path, console: Console) -> int:
    """Studies of the two older papers, which need neither flights nor a trained network."""
    with console.progress("Identifying") as advance:
        if options.paper == "spey":
            title = "Output-error identification of the Spey reproduced"
            seeds = SPEY_QUICK_SEEDS if options.quick else SPEY_SEEDS
            studies = spey_studies(seeds, options.jobs, advance)
            contradictions: tuple[str, ...] = ()
        else:
            title = "Identification of the Citation X engine reproduced"
            kinds = KINDS[:1] if options.quick else KINDS
            studies = citation_x(kinds=kinds, progress=advance)
            contradictions = CONTRADICTIONS
    outcome = outcome_of(studies)
    document = {
        "schema": SCHEMA,
        "paper": options.paper,
        "ok": bool(outcome.passed),
        "missed": missed(studies),
        "studies": [study.row() for study in studies],
        "contradictions": list(contradictions),
        "versions": versions(),
        "complete": True,
        "quick": options.quick,
    }
    header = RunHeader(title=title)
    RESULTS.save(out, document, reproduction_page(header, studies))
    _show_studies(console, studies, outcome)
    console.finish(document, f"Page: {options.out / PAGE}")
    return outcome.exit_code


def _begin(out: Path) -> None:
    """Mark the folder as one that is not done, and clear what an earlier run left."""
    atomic_write_text(out / DOCUMENT, to_json({"schema": SCHEMA, "complete": False}))
    for name in (FLIGHTS, MODEL):
        shutil.rmtree(out / name, ignore_errors=True)
    (out / PAGE).unlink(missing_ok=True)


def _flown_before(folder: Path) -> bool:
    return (folder / TABLE).is_file()


def _warn(options: Namespace, console: Console) -> None:
    if options.data is not None and options.config == OWN and not _flown_before(options.data):
        console.warn(
            f"{OWN} has the virtual engine's steady-state model; name your own one by --config"
        )


def _placed(config: RunConfig, base: Path, out: Path, options: Namespace) -> RunConfig:
    """The configuration with its logs in place: flown now, where the user brought none."""
    if options.data is not None:
        return with_table(config, options.data) if _flown_before(options.data) else config
    write_records(out / FLIGHTS, paper_scenario(options.seed), options.jobs)
    return flown(config, base, out / FLIGHTS)


def _header(found: Reproduction, options: Namespace) -> RunHeader:
    config = found.data.config
    rule_set = rules(config.evaluate.get("transients", {}).get("rules", "paper"))
    origin = "the user's own" if options.data else f"virtual flights, seed {options.seed}"
    return RunHeader(
        title="The calibration paper reproduced",
        run=config.name,
        model=found.bundle.calibration.words,
        rules=rule_set.name,
        tolerances=f"Ti {rule_set.Ti}; Tt {rule_set.Tt} ({rule_set.source})",
        sources=data_files(log.source for log in found.data.logs),
        facts={
            "Data": origin,
            "Test data sets": found.data.labels(found.data.tests),
            "Effort": "quick: too few training steps to judge by" if options.quick else "full",
            "Training": f"{found.bundle.record.training.wall_s:.0f} s",
        },
        config=config.model_dump_json(by_alias=True, indent=1),
    )


def _show_studies(console: Console, studies: Sequence[Study], outcome: Outcome) -> None:
    for study in studies:
        rows = [
            [claim.what, claim.claimed, claim.ours, _OUTCOME[claim.met]] for claim in study.claims
        ]
        if rows:
            console.table(study.title, ["claim", "claimed", "ours", ""], rows)
    # The tables above name the missed claims already.
    judged = [claim for study in studies for claim in study.claims if claim.met is not None]
    terminal.print_outcome(console.page, replace(outcome, lines=tuple(counts(judged))))


_OUTCOME = {True: "reached", False: "missed", None: "not measured"}
