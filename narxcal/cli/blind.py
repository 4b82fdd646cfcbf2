"""`narxcal blind`: cases whose effect is withheld, the answers to them, and how good these are."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from typing import Final, get_args

from eval.diagnosis.blind.altered import make_altered
from eval.diagnosis.blind.cases import BlindPlan
from eval.diagnosis.blind.files import CASES, KEY, SCHEMA
from eval.diagnosis.blind.make import make_cases, write_key
from eval.diagnosis.blind.run import Judge, Limits, run_cases
from eval.diagnosis.blind.score import SCHEMA as SCORE_SCHEMA
from eval.diagnosis.blind.score import CaseSet, render, score_answers, tables
from eval.diagnosis.blind.sim_logs import make_log_cases
from narxcal.cli.console import Console
from narxcal.cli.options import (
    add_jobs,
    add_mapping,
    add_output,
    count,
    path,
    seconds,
    seed,
)
from narxcal.cli.results import read_config
from narxcal.support.errors import ConfigError
from narxcal.support.files import Results, atomic_write_text, to_json

RESULTS = Results(SCHEMA, CASES, (KEY,), r"case_.*")
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


_ACTIONS = {
    "make": "Fly the virtual engine with drawn effects; seal what they are in a key.",
    "run": "Diagnose every case without opening the key; goes on where it was cut short.",
    "score": "Open the key, and say how good the answers are.",
}


def add_options(parser: ArgumentParser) -> None:
    """Add the actions make, run and score, each with what it takes, to `parser`."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    for (name, text), add in zip(_ACTIONS.items(), (_add_make, _add_run, _add_score), strict=True):
        own = actions.add_parser(name, help=text, description=text, allow_abbrev=False)
        add(own)
        add_output(own, after_action=True)


def _add_make(parser: ArgumentParser) -> None:
    parser.add_argument("--out", metavar="DIR", type=path, required=True, help="folder")
    for key, metavar, kind, of in (
        ("cases", "N", count, ""),
        ("flights", "N", count, "of a case, "),
        ("held_out", "N", count, "more, "),
        ("duration_s", "S", float, "of a flight, "),
        ("rate_hz", "HZ", float, ""),
    ):
        default = BlindPlan.model_fields[key].default
        parser.add_argument(
            _PLANNED[key], metavar=metavar, type=kind, default=default, dest=key,
            help=f"{of}default {default:g}",
        )  # fmt: skip
    for key, text in (
        ("style", None),
        (
            "engine",
            "component-level engines, lumped ones, or all: every third case lumped (default)",
        ),
        ("build", "the recorded engine: one of its type (default), or the simulator's own"),
    ):
        field = BlindPlan.model_fields[key]
        choices = get_args(field.annotation)
        parser.add_argument(_PLANNED[key], choices=choices, default=field.default, help=text)
    parser.add_argument("--seed", metavar="N", type=seed, default=0, help="default 0")
    parser.add_argument("--secret", metavar="WORD", help="opens the key; the seed if left out")
    add_jobs(parser, "cases")
    other = parser.add_argument_group("instead of flights of an engine that is made up")
    other.add_argument(
        "--altered",
        metavar="CONFIG",
        type=path,
        help="recorded flights of a configuration, a channel or two of each made wrong",
    )
    other.add_argument(
        "--sim-logs",
        metavar="DIR",
        type=path,
        help="logs of any simulator, without noise, onto which effects are put",
    )


def _add_run(parser: ArgumentParser) -> None:
    parser.add_argument("folder", metavar="CASES", type=path, help="folder that make wrote")
    parser.add_argument("--out", metavar="ANSWERS", type=path, required=True, help="folder")
    parser.add_argument(
        "--timeout",
        metavar="S",
        type=seconds,
        default=900.0,
        dest="timeout_s",
        help="for one case, default 900; a case that takes longer has no answer",
    )
    parser.add_argument(
        "--sim", metavar="SIM", help="simulator of altered flights: run folder, FMU, function"
    )
    add_mapping(parser)
    add_jobs(parser, "cases")


def _add_score(parser: ArgumentParser) -> None:
    parser.add_argument("folder", metavar="CASES", type=path, help="folder that make wrote")
    parser.add_argument("answers", metavar="ANSWERS", type=path, help="folder that run wrote")
    parser.add_argument(
        "--secret",
        metavar="WORD",
        required=True,
        action="append",
        dest="secrets",
        help="that of make, or its seed; again for every folder of --also that has another",
    )
    parser.add_argument(
        "--also",
        metavar=("CASES", "ANSWERS"),
        nargs=2,
        type=path,
        action="append",
        default=[],
        help="further cases with their answers, scored together with these; as often as wanted",
    )
    parser.add_argument(
        "--out", metavar="DIR", type=path, help="folder of the score; ANSWERS if left out"
    )


def run(options: Namespace, console: Console) -> int:
    """Make, run or score; 0 whatever the answers are."""
    {"make": _make, "run": _run, "score": _score}[options.action](options, console)
    return 0


def _make(options: Namespace, console: Console) -> None:
    if options.sim_logs is not None and options.altered is not None:
        raise ConfigError("--sim-logs and --altered exclude each other", hint="Give one of them")
    if options.build == "same" and options.altered is not None:
        raise ConfigError("--build same is for simulated flights", hint="Leave out --altered")
    plan = BlindPlan.parse({key: getattr(options, key) for key in _PLANNED}, options=_PLANNED)
    RESULTS.check(options.out)
    secret = str(plan.seed) if options.secret is None else options.secret
    with RESULTS.writing(options.out) as folder, console.progress("Flying") as advance:
        if options.sim_logs is not None:
            made = make_log_cases(folder, plan, options.sim_logs)
        elif options.altered is not None:
            config, base = read_config(options.altered, None)
            made = make_altered(folder, plan, config.logs, base)
        else:
            made = make_cases(folder, plan, options.jobs)
        document = write_key(folder, plan, secret, made, advance)
    console.say(f"Cases: {options.out}. Sealed key: {options.out / KEY}")
    if options.secret is None:
        console.say("The secret is the seed: do not show it to whoever runs the cases.")
    console.document({**document, "out": str(options.out)})


def _run(options: Namespace, console: Console) -> None:
    with console.progress("Diagnosing") as advance:
        config = None if options.config is None else read_config(options.config, None)[0]
        judge = None if options.sim is None else Judge(options.sim, config)
        limits = Limits(options.jobs, options.timeout_s)
        summary = run_cases(options.folder, options.out, limits, judge, advance)
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
