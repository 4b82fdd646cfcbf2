"""`narxcal blind`: cases whose effect is withheld, the answers to them, and how good these are."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path
from typing import Any, Final

from eval.gap.blind.cases import BlindPlan
from eval.gap.blind.files import CASES, KEY, SCHEMA
from eval.gap.blind.make import make_cases, write_key
from eval.gap.blind.page import render, tables
from eval.gap.blind.plasmode import Real, make_real_cases
from eval.gap.blind.run import Limits, run_cases
from eval.gap.blind.score import SCHEMA as SCORE_SCHEMA
from eval.gap.blind.score import CaseSet, score_answers
from eval.gap.blind.sim_logs import make_log_cases
from narxcal.cli.console import Console
from narxcal.cli.results import read_config
from narxcal.support.errors import ConfigError
from narxcal.support.files import Results, atomic_write_text, to_json

SCORE, PAGE = "score.json", "score.html"
# Keys of the plan, and what a person types for them.
_PLANNED: Final = {
    "cases": "--cases",
    "flights": "--flights",
    "held_out": "--held-out",
    "duration_s": "--duration",
    "rate_hz": "--rate",
    "style": "--style",
    "engine": "--engine",
    "build": "--build",
    "seed": "--seed",
}


def run(options: Namespace, console: Console) -> int:
    """Make, run or score; 0 whatever the answers are worth."""
    {"make": _make, "run": _run, "score": _score}[options.action](options, console)
    return 0


def _make(options: Namespace, console: Console) -> None:
    if (options.real is None) != (options.sim is None):
        raise ConfigError("--real and --sim belong together", hint="Give both, or neither")
    if options.sim_logs is not None and options.real is not None:
        raise ConfigError("--sim-logs and --real exclude each other", hint="Give one of them")
    if options.config is not None and options.real is None:
        raise ConfigError("--config maps the columns of --real, which is missing", hint="Give it")
    if options.build == "same" and options.real is not None:
        raise ConfigError("--build same is for simulated flights", hint="Leave out --real")
    plan = BlindPlan.parse({key: getattr(options, key) for key in _PLANNED}, options=_PLANNED)
    results = _results(options.out)
    results.check(options.out)
    secret = str(plan.seed) if options.secret is None else options.secret
    with results.writing(options.out) as folder, console.progress("Flying") as advance:

        def watch(name: str, done: int, total: int) -> None:
            advance(done, total, f"({name})")

        if options.sim_logs is not None:
            made = make_log_cases(folder, plan, options.sim_logs)
            document = write_key(folder, plan, secret, made, watch)
        elif options.real is None:
            document = make_cases(folder, plan, secret, options.jobs, watch)
        else:
            made = make_real_cases(folder, plan, _real(options))
            document = write_key(folder, plan, secret, made, watch)
    console.say(f"Cases: {options.out}. Sealed key: {options.out / KEY}")
    if options.secret is None:
        console.say("The secret is the seed: keep it from whoever answers.")
    console.document({**document, "out": str(options.out)})


def _real(options: Namespace) -> Real:
    config = None if options.config is None else read_config(options.config, None)[0]
    return Real(options.real, options.sim, config)


def _run(options: Namespace, console: Console) -> None:
    with console.progress("Diagnosing") as advance:

        def watch(name: str, done: int, total: int) -> None:
            advance(done, total, f"({name})")

        limits = Limits(options.jobs, options.timeout_s, options.seeds)
        summary = run_cases(options.folder, options.out, limits, watch)
    ends = {end: str(count) for end, count in summary["ends"].items()}
    console.facts({"Cases": str(len(summary["cases"])), **ends})
    console.document({**summary, "out": str(options.out)})


def _score(options: Namespace, console: Console) -> None:
    results = Results(SCORE_SCHEMA, SCORE, (PAGE,))
    if options.out is not None:
        results.check(options.out)
    sets = [CaseSet(options.folder, options.answers), *(CaseSet(*each) for each in options.also)]
    document = score_answers(sets, options.secrets)
    folder = options.out or options.answers
    folder.mkdir(parents=True, exist_ok=True)
    atomic_write_text(folder / SCORE, to_json(document))
    atomic_write_text(folder / PAGE, render(document))
    for title, head, rows in tables(document):
        console.table(title, head, rows)
    console.say(f"Page: {folder / PAGE}")
    console.document(document)


def _results(folder: Path) -> Results:
    """What may stand in the folder: cases of any number are an earlier run's."""
    found: Any = folder.iterdir() if folder.is_dir() else ()
    own = [entry.name for entry in found if entry.name.startswith("case_")]
    return Results(SCHEMA, CASES, (KEY, *own))
