"""`narxcal export`: a run as C, or a steady-state model as a table or a compiled FMU."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from narxcal.calibration.bundle import load_bundle
from narxcal.channels import channel
from narxcal.cli import export_run
from narxcal.cli.console import Console
from narxcal.cli.options import add_interval, add_logs, add_overwrite, add_trust, count, path
from narxcal.export import ExportOptions, ExportReport, Grid, export_fmu, export_table
from narxcal.intervals import LEVEL
from narxcal.steady.model import SteadyStateModel
from narxcal.steady.opening import open_steady
from narxcal.steady.table import read_steady_table
from narxcal.support.errors import ConfigError, ModelError
from narxcal.support.files import check_file
from narxcal.turbofan import VirtualEngine
from narxcal.turbofan.design import PRESETS
from narxcal.turbofan.engine import INPUT_NAMES, OUTPUT_NAMES

SCHEMA = "narxcal.export/1"
_ENDINGS = {"table": (".csv", ".csv.gz"), "fmu": (".fmu",)}


def add_options(parser: ArgumentParser) -> None:
    """Add what the command takes to `parser`."""
    parser.add_argument(
        "source",
        metavar="SOURCE",
        help="run folder, table (.csv), FMU, module:function, or a virtual engine's name",
    )
    parser.add_argument(
        "--to", choices=("table", "fmu", "c", "onnx", "jsbsim"), required=True, help="what to write"
    )
    parser.add_argument(
        "--out",
        metavar="OUT",
        type=path,
        required=True,
        help=".csv, .csv.gz, .fmu, .onnx, .xml; a folder for C",
    )
    add_overwrite(parser)
    add_trust(parser)
    parser.add_argument("--fmi", choices=("2.0", "3.0"), default="2.0", help="default 2.0")
    parser.add_argument(
        "--tolerance", metavar="PCT", type=float, default=0.5, help="of each range (default 0.5)"
    )
    parser.add_argument(
        "--max-rows", metavar="N", type=count, default=100_000, help="default 100000"
    )
    parser.add_argument(
        "--nodes",
        metavar="NAME=NODES",
        nargs="+",
        action="extend",
        help="nodes to have, as ALT_ft=0,36089,43000 or dT_C=-30:30:7; one node fixes an input",
    )
    parser.add_argument("--no-refine", action="store_true", help="add no nodes")
    parser.add_argument("--strict", action="store_true", help="write nothing beyond the tolerance")
    parser.add_argument("--inputs", metavar="NAME", nargs="+", help="where SOURCE names none")
    parser.add_argument("--outputs", metavar="NAME", nargs="+", help="where SOURCE names none")
    group = parser.add_argument_group("of a run: its dynamic model")
    group.add_argument("--steady", action="store_true", help="its steady state alone, instead")
    group.add_argument("--engine", metavar="NAME", help="that engine alone (default: all)")
    add_interval(group, LEVEL)
    add_logs(group)


def run(options: Namespace, console: Console) -> int:
    """Export SOURCE and show its errors; returns 1 where the tolerance was missed."""
    if options.to != "table" and Path(options.source).is_dir() and not options.steady:
        return export_run.run(options, console, _nodes(options.nodes or (), options.max_rows))
    if options.to not in _ENDINGS:
        raise ConfigError(
            f"--to {options.to} takes a run folder, and SOURCE is {options.source}",
            hint="Train one, or export a table or an FMU",
        )
    _check_name(options.out, options.to)
    check_file(options.out, Path(options.source), overwrite=options.overwrite)
    model = open_source(options.source, options.inputs, options.outputs, trust=options.trust)
    grid = Grid.of_model(model, _nodes(options.nodes or (), options.max_rows))
    with console.progress("Exporting") as advance:
        how = ExportOptions(
            tolerance_pct=options.tolerance,
            max_rows=options.max_rows,
            refine=not options.no_refine,
            strict=options.strict,
            source=_shown(options.source),
            progress=advance,
        )
        if options.to == "fmu":
            report = export_fmu(model, grid, options.out, options.fmi, how)
        else:
            report = export_table(model, grid, options.out, how)
    _show(console, report)
    console.document({"schema": SCHEMA, "to": options.to, **report.to_dict()})
    return 0 if report.met else 1


def _check_name(out: Path, kind: str) -> None:
    """Refuse, before any work is done, a file name with the ending of another kind."""
    endings = _ENDINGS[kind]
    if not out.name.endswith(endings):
        raise ConfigError(
            f"--to {kind} writes a {' or '.join(endings)} file, and --out names {out.name}",
            hint=f"Name it {out.name.partition('.')[0]}{endings[0]}",
        )


def open_source(
    source: str,
    inputs: Sequence[str] | None,
    outputs: Sequence[str] | None,
    *,
    trust: bool = False,
) -> SteadyStateModel:
    """Open a run folder, a virtual engine's name, `module:function`, a CSV file or an FMU.

    `inputs` and `outputs` name the columns where SOURCE does not. Raises `ConfigError` for any
    other source, else as the source's own reader.
    """
    path = Path(source)
    if source in PRESETS:
        return VirtualEngine(source)
    if path.is_dir():
        return load_bundle(path, trust=trust).calibration.steady
    if path.name.endswith((".csv", ".csv.gz")):
        return read_steady_table(path, inputs, outputs)
    if path.suffix == ".fmu":
        if not (inputs and outputs):
            raise ConfigError(
                "an FMU does not say which of its variables to export",
                file=path,
                hint="Name them with --inputs and --outputs",
            )
        return open_steady("fmu", source, (inputs, outputs))
    if ":" in source:
        return _function(source, inputs or INPUT_NAMES, outputs)
    raise ConfigError(
        f"'{source}' is no run folder, table (.csv), FMU, module:function or virtual engine",
        hint=f"Virtual engines are {' and '.join(PRESETS)}",
    )


def _function(
    source: str, inputs: Sequence[str], outputs: Sequence[str] | None
) -> SteadyStateModel:
    """Open a function; without `outputs` its columns are the first ones of the virtual engine."""
    if outputs:
        return open_steady("callable", source, (inputs, outputs))
    problem = ""
    for width in range(len(OUTPUT_NAMES), 0, -1):
        model = open_steady("callable", source, (inputs, OUTPUT_NAMES[:width]))
        try:
            model.outputs(np.zeros((1, len(inputs))))
        except ModelError as error:
            problem = error.problem
        else:
            return model
    raise ModelError(problem, hint="Name its columns with --inputs and --outputs")


def _nodes(words: Sequence[str], most: int) -> dict[str, tuple[float, ...]]:
    """Read `NAME=V`, `NAME=V,V,...` and `NAME=LOW:HIGH:COUNT`, of at most `most` nodes each.

    Raises `ConfigError`.
    """
    found: dict[str, tuple[float, ...]] = {}
    for word in words:
        name, _, text = word.partition("=")
        try:
            if text.count(":") == 2:
                low, high, many = text.split(":")
                if int(many) > most:
                    raise ConfigError(
                        f"the nodes '{word}' are more than the limit of {most} rows",
                        hint="Give fewer nodes, or allow more rows by --max-rows",
                    )
                values = np.linspace(float(low), float(high), int(many)).tolist()
            else:
                values = [float(part) for part in text.split(",")]
        except ValueError:
            values = []
        if not values:
            raise ConfigError(
                f"cannot read the nodes '{word}'",
                hint="Write NAME=VALUE, NAME=VALUE,VALUE,... or NAME=LOW:HIGH:COUNT",
            )
        found[channel(name).name] = tuple(values)
    return found


def _shown(source: str) -> str:
    """Name of a source without its folders, which an exported file must not contain."""
    return Path(source).resolve().name if Path(source).exists() else source


def _show(console: Console, report: ExportReport) -> None:
    _show_errors(console, report)
    _show_nodes(console, report)
    for name, value in report.fixed.items():
        console.say(f"{name} is fixed at {value:g} and left out")
    if report.additive:
        console.say(f"Switches on grids of their own: {', '.join(report.additive)}")
    if not report.met:
        console.warn(report.shortfall)
    console.say(f"Exported: {report.file} ({report.bytes / 1e6:.2f} MB)")


def _show_errors(console: Console, report: ExportReport) -> None:
    title = f"Interpolation error at {report.measured.inside} random conditions"
    rows = [
        [one.name, one.unit, f"{one.range:.4g}"]
        + [f"{error:.3g}" for error in (one.max, one.rms, one.max_pct)]
        for one in report.measured.outputs
    ]
    console.table(title, ["output", "unit", "range", "largest", "RMS", "largest %"], rows)


def _show_nodes(console: Console, report: ExportReport) -> None:
    title = f"Nodes ({report.rows} rows; {report.why})"
    rows = [
        [name, f"{axis[0]:g}", f"{axis[-1]:g}", str(len(axis))]
        for name, axis in report.axes.items()
    ]
    console.table(title, ["input", "low", "high", "nodes"], rows)
