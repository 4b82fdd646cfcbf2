"""`narxcal denoise`: the calibration paper's noise experiment on the held-out logs."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from typing import Any

from eval import terminal
from eval.denoising import (
    CURVES,
    NoiseSweep,
    SweepConfig,
    flight_of,
    noise_outcome,
    snr_sweep,
    summarise,
)
from eval.outcome import Outcome
from eval.report.page import noise_page
from eval.run_logs import run_config
from narxcal.calibration.bundle import load_bundle
from narxcal.cli.console import Console
from narxcal.cli.options import add_data, add_logs, add_out, add_run
from narxcal.cli.results import header_of, logs_for
from narxcal.support.files import Results

SCHEMA, PAGE = "narxcal.denoise/1", "denoise.html"
RESULTS = Results(SCHEMA, "denoise.json", (PAGE,))


def add_options(parser: ArgumentParser) -> None:
    """Add what the command takes to `parser`."""
    add_run(parser)
    add_logs(parser)
    add_out(parser)
    parser.add_argument("--channel", metavar="NAME", help="default N2_pct, or the first output")
    add_data(parser, "folder of the held-out logs, if they have moved")


def run(options: Namespace, console: Console) -> int:
    """Sweep the noise; 1 where the fused value does not beat both of what it was made of."""
    RESULTS.check(options.out)
    bundle = load_bundle(options.bundle, trust=options.trust)
    config, settings = run_config(bundle)
    logs = logs_for(bundle, options.logs, options.data, console)
    channel = options.channel or usual_channel(bundle.calibration.output_names)
    sweep = SweepConfig(channel=channel, fuser=config.fuser)
    sweeps = []
    with console.progress("Adding noise") as advance:
        for number, log in enumerate(logs):
            advance(number, len(logs), log.name)
            found = summarise(snr_sweep(flight_of(bundle, log), sweep))
            sweeps.append(NoiseSweep(log.name, channel, found))
    outcome = noise_outcome(sweeps)
    document = _document(str(options.bundle), sweep, sweeps, outcome)
    header = header_of(
        f"Denoising: {config.name}", options.bundle, bundle, logs, settings.transients.rule_set
    )
    RESULTS.save(options.out, document, noise_page(header, outcome, sweeps))
    _show(console, sweeps)
    terminal.print_outcome(console.page, outcome)
    console.finish(document, f"Page: {options.out / PAGE}")
    return outcome.exit_code


def usual_channel(outputs: Sequence[str]) -> str:
    """The paper's N2, or the speed of an engine of one spool."""
    return "N2_pct" if "N2_pct" in outputs else outputs[0]


def _document(
    run_folder: str, sweep: SweepConfig, sweeps: Sequence[NoiseSweep], outcome: Outcome
) -> dict[str, Any]:
    return {
        "schema": SCHEMA,
        "run": run_folder,
        "ok": outcome.passed,
        "sweep": sweep.model_dump(mode="json"),
        "logs": [{"log": one.log, "ratios": one.table.to_dict(orient="records")} for one in sweeps],
    }


def _show(console: Console, sweeps: Sequence[NoiseSweep]) -> None:
    head = ["SNR [dB]", "raw", "fused", "free run", "from raw", "from fused", "NIS", "beats both"]
    for one in sweeps:
        rows = [
            [
                f"{row['snr_db']:g}",
                *(f"{row[name]:.3g}" for name in (*CURVES, "mean_nis")),
                "yes" if row["beats_both"] else "no",
            ]
            for row in one.table.to_dict(orient="records")
        ]
        console.table(f"{one.log}: RMSE of {one.channel}", head, rows)
