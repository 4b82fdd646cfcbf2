"""`narxcal simulate`: a free run over a file of inputs, or over a folder with found effects.

With `--effects` OUT gets one canonical CSV for each log of inputs, so that anybody can check how
far the gap falls. A simulator that can be run again is given inputs with the effects on them; the
document and the terminal say of each effect how it was applied.
"""

from __future__ import annotations

import json
from argparse import ArgumentParser, Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from data_prep.config import LogsConfig
from data_prep.log import Log
from data_prep.prepare import hold_inputs, prepare
from data_prep.reading import read_logs
from data_prep.sources.log_file import open_table
from eval.diagnosis.applied import FoundEffects, read_effects
from eval.diagnosis.pairs import match_simulated, read_folder
from eval.diagnosis.simulators import Simulate, open_simulator
from eval.run_logs import bank_of
from narxcal.calibration.bundle import Bundle, load_bundle
from narxcal.calibration.calibration import Calibration
from narxcal.channels import CHANNELS
from narxcal.cli.console import Console
from narxcal.cli.options import SIMULATOR, add_interval, add_mapping, add_out_file, add_trust, path
from narxcal.cli.results import interval_words, read_config
from narxcal.support.arrays import FloatArray
from narxcal.support.csv_text import TIME_FORMAT, log_csv, text_cell
from narxcal.support.errors import ConfigError
from narxcal.support.files import Results, atomic_write_text, check_file, recover
from training.config import RunConfig
from training.pipeline import calibration_for
from training.screening.screen import screened

SCHEMA = "narxcal.simulate/1"
EFFECTS_SCHEMA, DOCUMENT = "narxcal.simulate_effects/1", "simulated.json"


def add_options(parser: ArgumentParser) -> None:
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
    add_out_file(parser, "OUT", "CSV file, -, or folder")
    add_interval(parser)
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
        return _with_effects(options, console)
    if options.bundle is None or options.inputs is None:
        raise ConfigError(
            "expected RUN and INPUTS.csv, or --sim, --effects and --inputs",
            hint="See narxcal simulate --help",
        )
    console = console.for_output(options.out)
    check_file(options.out, options.inputs, options.bundle, overwrite=options.overwrite)
    bundle = load_bundle(options.bundle, trust=options.trust)
    settling = bundle.certificate
    if not settling.settled:
        console.warn(f"the model {settling.words}")
    logs = read_inputs(bundle, Path(options.inputs))
    runs = [_simulated(bundle.calibration, log, options.interval) for log in logs]
    tables = [table for _, table in runs]
    if len({log.source.engine for log in logs}) == 1:
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
    for log, _ in runs:
        for each in log.findings:
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


def _simulated(
    calibration: Calibration, log: Log, interval: float | None
) -> tuple[Log, pd.DataFrame]:
    """Return the log as it was run, and a table with `inside_envelope` and flags."""
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
    return log, table


_AUDITED = ("channel", "action", "samples", "reason")


def _document(out: str, runs: Sequence[tuple[Log, pd.DataFrame]]) -> dict[str, Any]:
    return {
        "schema": SCHEMA,
        "out": out,
        "logs": [
            {
                "log": log.name,
                "sha256": log.source.sha256,
                "samples": len(table),
                "outside": int((table["inside_envelope"] == 0).sum()),
                "findings": [each.row() for each in log.findings],
                "audit": [
                    {key: getattr(entry, key) for key in _AUDITED} for entry in log.audit.entries
                ],
            }
            for log, table in runs
        ],
    }


# --- with effects ---


def _with_effects(options: Namespace, console: Console) -> int:
    """Simulate every log of a folder, add the effects, and write the logs as a whole."""
    _check_effects(options)
    results = _results(options.out)
    results.check(options.out)
    found = read_effects(options.effects)
    simulator = open_simulator(options.sim, trust=options.trust)
    how, again = simulator.how, simulator.again
    found.check(again=again is not None)
    config = None if options.config is None else read_config(options.config, None)[0]
    inputs = read_folder(options.inputs_folder, config)
    source = read_folder(how, config) if isinstance(how, Path) else how
    rows = []
    with results.writing(options.out) as folder, console.progress("Adding") as advance:
        for number, (name, log) in enumerate(inputs.items()):
            advance(number, len(inputs), name)
            sim = match_simulated(name, log, source)
            rows.append(_added(folder, found, (name, log, sim), again))
        document = {
            "schema": EFFECTS_SCHEMA,
            "effects": {name: dict(sizes) for name, sizes in found.values.items()},  # noqa: PD011
            "simulator": simulator.kind,
            "applied": found.ways(again=again is not None),
            "logs": rows,
        }
        results.write(folder, document)
    _show(console, document, options.out)
    return 0


def _added(
    folder: Path,
    found: FoundEffects,
    logs: tuple[str, Log, Log],
    again: Simulate | None,
) -> dict[str, Any]:
    """Write one log with the effects added, by `again` where the simulator can be run so.

    `logs` are its name, the inputs as they were given, and what the simulator says of them.
    """
    name, given, sim = logs
    outputs = found.added_to(sim, name) if again is None else found.run_again(sim, again, name)
    channels, change = _changed(sim, outputs, found.signals.outputs)
    channels["time_s"] = given.time_s[: len(sim)]
    (folder / f"{name}.csv").write_bytes(log_csv(channels).encode())
    unknown = {n: int(np.isnan(outputs[n]).sum()) for n in found.signals.outputs}
    return {
        "log": name,
        "samples": len(sim),
        "rms_change": change,
        "load_known": found.load_known(name),
        "blank": {n: count for n, count in unknown.items() if count},
    }


def _results(folder: Path) -> Results:
    """What may stand in the folder: the logs that an earlier run says it wrote there."""
    recover(folder.resolve())
    try:
        logs = json.loads((folder / DOCUMENT).read_text(encoding="utf-8"))["logs"]
        names = tuple(f"{row['log']}.csv" for row in logs)
    except (OSError, ValueError, LookupError, TypeError):
        names = ()
    return Results(EFFECTS_SCHEMA, DOCUMENT, names)


def _check_effects(options: Namespace) -> None:
    needed = {"--sim": "sim", "--effects": "effects", "--inputs": "inputs_folder"}
    lost = [word for word, name in needed.items() if getattr(options, name) is None]
    if lost:
        raise ConfigError(
            "expected --sim, --effects and --inputs together, but "
            f"{' and '.join(lost)} {'is' if len(lost) == 1 else 'are'} missing"
        )
    if options.bundle is not None:
        raise ConfigError("expected either RUN and INPUTS.csv or --sim, --effects and --inputs")


def _changed(
    sim: Log, outputs: Mapping[str, FloatArray], diagnosed: Sequence[str]
) -> tuple[dict[str, FloatArray], dict[str, float]]:
    """Canonical channels in their order, and by how much each diagnosed output was changed."""
    rms = {n: float(np.sqrt(np.nanmean((outputs[n] - sim[n]) ** 2))) for n in diagnosed}
    both = {**sim.channels, **outputs}
    names = [n for n, row in CHANNELS.items() if n in both and row.role != "auxiliary"]
    return {"time_s": sim.time_s, **{name: both[name] for name in names}}, rms


def _show(console: Console, document: Mapping[str, Any], out: Path) -> None:
    names = list(document["logs"][0]["rms_change"])
    console.table(
        "RMS of what the effects change",
        ["log", *names],
        [[r["log"], *(f"{r['rms_change'][n]:.3g}" for n in names)] for r in document["logs"]],
    )
    for row in document["logs"]:
        for channel, count in row["blank"].items():
            console.warn(
                f"{row['log']}: the simulator gives no {channel} in {count} of "
                f"{row['samples']} samples: they are left blank"
            )
    blind = [row["log"] for row in document["logs"] if row["load_known"] is False]
    if blind:
        console.warn(
            f"no channel records the load and no window of it is known in {', '.join(blind)}: it "
            "is not applied there"
        )
    for effect, way in document["applied"].items():
        console.say(f"{effect}: applied {way}")
    console.say(f"Effects: {', '.join(document['effects']) or 'none'}. Logs: {out}")
    console.document({**document, "out": str(out)})
