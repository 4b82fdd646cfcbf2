"""`narxcal replay`: a log streamed through model and fuser."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from dataclasses import replace

from data_prep.log import Finding
from eval.replay import ReplayModel, ReplayOptions, ReplaySummary, replay
from eval.run_logs import file_findings
from narxcal.calibration.bundle import Bundle, load_bundle
from narxcal.cli.console import Console
from narxcal.cli.options import add_interval, add_out_file, add_run, path
from narxcal.cli.results import interval_words
from narxcal.intervals import LEVEL
from narxcal.support.files import check_file

SCHEMA = "narxcal.replay/1"


def add_options(parser: ArgumentParser) -> None:
    add_run(parser)
    parser.add_argument("log", metavar="LOG", type=path, help="log, read by RUN's mapping")
    add_out_file(parser, "OUT.csv", "CSV file or -")
    add_interval(parser, LEVEL)
    parser.add_argument("--engine", metavar="NAME", help="replay this engine only")
    parser.add_argument("--realtime", action="store_true", help="no faster than the clock")
    parser.add_argument(
        "--follow",
        action="store_true",
        help="wait for growth until none came for 10 s; rows in OUT.part",
    )


def run(options: Namespace, console: Console) -> int:
    console = console.for_output(options.out)
    check_file(options.out, options.log, options.bundle, overwrite=options.overwrite)
    bundle = load_bundle(options.bundle, trust=options.trust)
    model = ReplayModel.of(bundle)
    how = ReplayOptions(
        engine=options.engine,
        realtime=options.realtime,
        follow=options.follow,
        interval=options.interval,
    )
    if not how.live and options.log.is_file():
        model = replace(model, findings=_findings(bundle, options, console))
    with console.progress("Replaying"):
        summary = replay(model, options.log, options.out, how)
    _show(console, summary)
    console.say(f"Free run: {interval_words(bundle.calibration.interval, options.interval)}")
    console.say(f"Replayed: {options.out}")
    console.document({"schema": SCHEMA, "out": str(options.out), **summary.to_dict()})
    return 1 if summary.missed else 0


def _findings(bundle: Bundle, options: Namespace, console: Console) -> tuple[Finding, ...]:
    """What the log shows before it is streamed; nothing of one that only replay can read."""
    if not bundle.record.config:
        return ()
    with console.progress("Checking the log"):
        found = file_findings(bundle, options.log)
    engine = options.engine
    return tuple(one for one in found if engine is None or one.engine == engine)


def _show(console: Console, summary: ReplaySummary) -> None:
    rows = [
        [
            engine or "(one engine)",
            str(sum(summary.held[engine].values())),
            str(summary.restarts[engine]),
            str(summary.outside[engine]),
            str(sum(summary.gated[engine].values())),
            ", ".join(summary.unfused[engine]) or "none",
        ]
        for engine in summary.engines
    ]
    head = [
        "engine", "inputs held", "restarts after gaps", "outside envelope", "outliers not fused",
        "outputs never fused",
    ]  # fmt: skip
    console.table("Samples, of the model's grid, with something to know about", head, rows)
    pace = f"{summary.times_real_time:,.0f} times real time"
    console.say(
        f"{summary.rows} rows, {summary.log_s:.0f} s of log in {summary.wall_s:.1f} s: {pace}"
    )
    for caution in (*summary.missed, *summary.cautions):
        console.warn(caution)
    if summary.dropped:
        console.warn(f"{summary.dropped} rows had no usable stamp and were dropped")
    if summary.truncated:
        console.warn("the log breaks off in mid-line; that line was left out")
