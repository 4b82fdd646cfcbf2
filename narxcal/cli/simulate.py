"""`narxcal simulate`: a free run over a file of inputs, or over a folder with found effects."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from data_prep.config import LogsConfig
from data_prep.log import Log
from data_prep.log_file import open_table
from data_prep.prepare import hold_inputs, prepare
from data_prep.reading import read_logs
from eval.evaluate import bank_of
from narxcal.calibration.bundle import Bundle, load_bundle
from narxcal.calibration.calibration import Calibration
from narxcal.calibration.certificate import certificate_of
from narxcal.cli import simulate_effects
from narxcal.cli.console import Console
from narxcal.cli.options import SIMULATOR, add_interval, add_mapping, add_overwrite, add_trust, path
from narxcal.cli.results import interval_words
from narxcal.support.errors import ConfigError
from narxcal.support.files import TIME_FORMAT, atomic_write_text, check_file, text_cell
from training.config import RunConfig
from training.pipeline import calibration_for
from training.screening import screened

SCHEMA = "narxcal.simulate/1"


@dataclass(frozen=True, eq=False)
class _Run:
    """One log simulated: a table with `inside_envelope` and flags, and the log it came from."""

    log: Log
    table: pd.DataFrame


def add_options(parser: ArgumentParser) -> None:
    """Add what the command takes to `parser`."""
    parser.add_argument(
        "bundle", metavar="RUN", type=path, nargs="?", help="folder that train wrote"
    )
    parser.add_argument(
        "inputs",
        metavar="INPUTS.csv",
        type=path,
        nargs="?",
        help="inputs, by RUN's mapping or canonical",
    )
    parser.add_argument(
        "--out",
        metavar="OUT",
        type=path,
        required=True,
        help="CSV file, -, or folder",
    )
    add_interval(parser)
    add_overwrite(parser)
    add_trust(parser)
    group = parser.add_argument_group("with the effects that diagnose found")
    group.add_argument("--sim", metavar="SIM", help=SIMULATOR)
    group.add_argument("--effects", metavar="GAP.json", type=path, help="what diagnose wrote")
    group.add_argument(
        "--inputs", metavar="DIR", type=path, dest="inputs_folder", help="folder of input logs"
    )
    add_mapping(parser)


def run(options: Namespace, console: Console) -> int:
    """Simulate every engine of the file and write one CSV; with `--effects`, a folder of them."""
    if options.effects is not None or options.sim is not None or options.inputs_folder is not None:
        return simulate_effects.run(options, console)
    if options.bundle is None or options.inputs is None:
        raise ConfigError(
            "expected RUN and INPUTS.csv, or --sim, --effects and --inputs",
            hint="See narxcal simulate --help",
        )
    console = console.for_output(options.out)
    check_file(options.out, options.inputs, options.bundle, overwrite=options.overwrite)
    bundle = load_bundle(options.bundle, trust=options.trust)
    settling = certificate_of(bundle.calibration, bundle.record.certificate)
    if not settling.settled:
        console.warn(f"the model {settling.words}")
    logs = read_inputs(bundle, Path(options.inputs))
    runs = [_simulated(bundle.calibration, log, options.interval) for log in logs]
    tables = [one.table for one in runs]
    if len({one.log.source.engine for one in runs}) == 1:
        tables = [table.drop(columns="engine") for table in tables]
    joined = pd.concat(tables).sort_values("time_s", kind="stable")
    joined["time_s"] = joined["time_s"].map(TIME_FORMAT.__mod__)
    atomic_write_text(
        options.out, joined.to_csv(index=False, float_format="%.9g", lineterminator="\n")
    )
    document = _document(str(options.out), runs)
    for row in document["logs"]:
        outside = f", {row['outside']} outside the envelope" if row["outside"] else ""
        console.say(f"{row['log']}: {row['samples']} samples{outside}")
    for one in runs:
        for each in one.log.findings:
            console.warn(each.caution)
    if options.interval is not None:
        console.say(interval_words(bundle.calibration.interval, options.interval))
    console.say(f"Simulated: {options.out}")
    console.document(document)
    return 0


def read_inputs(bundle: Bundle, file: Path) -> list[Log]:
    """Read the inputs in `file` by the bundle's column mapping, or by canonical headers.

    Outputs need not be there. The logs are on the model's sampling grid, prepared as those
    that it was trained on; masked samples stay NaN. Raises `DataError`.
    """
    config = RunConfig.parse(bundle.record.config)
    names = bundle.calibration.input_names
    header = open_table(file, config.logs).header
    logs = config.logs
    if {"time_s", *names} <= set(header):
        logs = LogsConfig(max_gap_s=logs.max_gap_s, bridge_s=logs.bridge_s, channels=logs.channels)
    else:
        logs = logs.for_inputs(names)
    prepared = prepare(read_logs([file], logs.every(bundle.calibration.dt_s)), config)
    return screened(bank_of(bundle), [one.log for one in prepared])


def _simulated(calibration: Calibration, log: Log, interval: float | None) -> _Run:
    own = calibration_for(calibration, log)
    used = log.without_faults()
    known = np.isfinite(used.matrix([name for name in own.input_names if name in used.channels]))
    log = hold_inputs(used, own.input_names)
    inputs = log.matrix(own.input_names)
    outputs = own.simulate(inputs)
    table = pd.DataFrame(outputs, columns=list(own.output_names))
    if interval is not None:
        half = own.half_width(inputs, outputs, interval)
        for k, name in enumerate(own.output_names):
            table[f"{name}_low"] = outputs[:, k] - half[:, k]
            table[f"{name}_high"] = outputs[:, k] + half[:, k]
    table.insert(0, "time_s", log.time_s)
    table.insert(1, "engine", text_cell(log.source.engine))
    table["inside_envelope"] = own.steady.inside(inputs).astype(int)
    for name in own.output_names:
        table[f"{name}_valid"] = known.all(axis=1).astype(int)
    return _Run(log, table)


def _document(out: str, runs: Sequence[_Run]) -> dict[str, Any]:
    return {
        "schema": SCHEMA,
        "out": out,
        "logs": [
            {
                "log": one.log.name,
                "sha256": one.log.source.sha256,
                "samples": len(one.table),
                "outside": int((one.table["inside_envelope"] == 0).sum()),
                "findings": [each.row() for each in one.log.findings],
                "audit": [
                    {
                        "channel": entry.channel,
                        "action": entry.action,
                        "samples": entry.samples,
                        "reason": entry.reason,
                    }
                    for entry in one.log.audit.entries
                ],
            }
            for one in runs
        ],
    }
