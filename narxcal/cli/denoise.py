"""`narxcal denoise`: the calibration paper's noise experiment on the held-out logs."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from eval import terminal
from eval.denoising import CURVES, SweepConfig, flight_of, snr_sweep, summarise
from eval.evaluate import run_config
from eval.report.building import noise_curves
from eval.report.page import Outcome, noise_page
from narxcal.calibration.bundle import load_bundle
from narxcal.cli.console import Console
from narxcal.cli.options import add_data, add_logs, add_out, add_run
from narxcal.cli.results import header_of, logs_for
from narxcal.support.files import Results, to_json

SCHEMA = "narxcal.denoise/1"
DOCUMENT, PAGE = "denoise.json", "denoise.html"
RESULTS = Results(SCHEMA, DOCUMENT, (PAGE,))


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
    run_settings, settings = run_config(bundle)
    logs = logs_for(bundle, options.logs, options.data, console)
    channel = options.channel or usual_channel(bundle.calibration.output_names)
    sweep = SweepConfig(channel=channel, fuser=run_settings.fuser)
    sweeps: dict[str, pd.DataFrame] = {}
    with console.progress("Adding noise") as advance:
        for number, log in enumerate(logs):
            advance(number, len(logs), log.name)
            sweeps[log.name] = summarise(snr_sweep(flight_of(bundle, log), sweep))
    outcome = _outcome(sweeps)
    document = _document(str(options.bundle), sweep, sweeps, outcome)
    header = header_of(
        f"Denoising: {run_settings.name}", options.bundle, bundle, logs, settings.transients.rules
    )
    figures = [noise_curves(name, sweep.channel, found, CURVES) for name, found in sweeps.items()]
    with RESULTS.writing(options.out) as folder:
        (folder / DOCUMENT).write_text(to_json(document), encoding="utf-8")
        html = noise_page(header, outcome, figures)
        (folder / PAGE).write_text(html, encoding="utf-8")
    _show(console, sweep.channel, sweeps)
    terminal.print_outcome(console.page, outcome)
    console.say(f"Page: {options.out / PAGE}")
    console.document(document)
    return 0 if outcome.passed else 1


def usual_channel(outputs: Sequence[str]) -> str:
    """The paper's N2, or the speed of an engine of one spool."""
    return "N2_pct" if "N2_pct" in outputs else outputs[0]


def _outcome(sweeps: Mapping[str, pd.DataFrame]) -> Outcome:
    ratios = sum(len(found) for found in sweeps.values())
    won = sum(int(found["beats_both"].sum()) for found in sweeps.values())
    consistent = sum(int(found["consistent"].sum()) for found in sweeps.values())
    headline = (
        f"At {won} of {ratios} signal-to-noise ratios the fused value is nearer to the truth "
        "than both the measurement and the free run"
    )
    lines = (f"The filter is consistent (mean NIS within its 95 % band) at {consistent}.",)
    return Outcome(won == ratios, headline, lines)


def _document(
    run_folder: str, sweep: SweepConfig, sweeps: Mapping[str, pd.DataFrame], outcome: Outcome
) -> dict[str, Any]:
    return {
        "schema": SCHEMA,
        "run": run_folder,
        "ok": outcome.passed,
        "sweep": sweep.model_dump(mode="json"),
        "logs": [
            {"log": name, "ratios": found.to_dict(orient="records")}
            for name, found in sweeps.items()
        ],
    }


def _show(console: Console, channel: str, sweeps: Mapping[str, pd.DataFrame]) -> None:
    head = ["SNR [dB]", "raw", "fused", "free run", "from raw", "from fused", "NIS", "beats both"]
    for name, found in sweeps.items():
        console.table(f"{name}: RMSE of {channel}", head, _rows(found))


def _rows(found: pd.DataFrame) -> Sequence[Sequence[str]]:
    return [
        [
            f"{row['snr_db']:g}",
            *(f"{row[name]:.3g}" for name in (*CURVES, "mean_nis")),
            "yes" if row["beats_both"] else "no",
        ]
        for row in found.to_dict(orient="records")
    ]
