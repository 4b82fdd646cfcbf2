"""`narxcal export`: a run as C, FMU, ONNX or JSBSim with the proof of it, or a steady state.

A steady-state model is written as a table or a compiled FMU, with its largest errors.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from data_prep.prepare import hold_inputs
from eval.run_logs import evaluation_logs
from narxcal.calibration.bundle import Bundle, load_bundle
from narxcal.channels import channel
from narxcal.cli.console import Console
from narxcal.cli.options import add_interval, add_logs, add_out_file, add_trust, count
from narxcal.cli.results import check_ending
from narxcal.export import (
    ExportOptions,
    ExportReport,
    Grid,
    export_fmu,
    export_table,
    fmu_run,
    jsbsim,
    onnx_graph,
    proof,
)
from narxcal.export.compiler import Compiled, compiler
from narxcal.export.fmu import write_fmu
from narxcal.export.onnx_model import write_onnx
from narxcal.export.program import Exportable
from narxcal.intervals import LEVEL
from narxcal.steady.model import SteadyStateModel
from narxcal.steady.opening import open_steady
from narxcal.steady.table import read_steady_table
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError, DataError, ModelError
from narxcal.support.files import (
    Results,
    atomic_folder,
    atomic_write_bytes,
    atomic_write_text,
    check_file,
    check_output_folder,
)
from narxcal.support.progress import Progress
from narxcal.turbofan import VirtualEngine
from narxcal.turbofan.design import PRESETS
from narxcal.turbofan.engine import INPUT_NAMES, OUTPUT_NAMES

SCHEMA, RUN_SCHEMA = "narxcal.export/1", "narxcal.export_run/1"
_ENDINGS = {
    "table": (".csv", ".csv.gz"), "fmu": (".fmu",), "onnx": (".onnx",), "jsbsim": (".xml",),
}  # fmt: skip
_STEADY = ("table", "fmu")
# Rows of a proof, None where the file cannot be run here, and what else is said of it.
_Compared = tuple[list[dict[str, Any]] | None, dict[str, Any]]
_WRITTEN = Results(proof.SCHEMA, proof.FILE, ("engine.c", "engine.h"))


def add_options(parser: ArgumentParser) -> None:
    parser.add_argument(
        "source",
        metavar="SOURCE",
        help="run folder, table (.csv), FMU, module:function, or a virtual engine's name",
    )
    parser.add_argument(
        "--to", choices=("table", "fmu", "c", "onnx", "jsbsim"), required=True, help="what to write"
    )
    add_out_file(parser, "OUT", ".csv, .csv.gz, .fmu, .onnx, .xml; a folder for C")
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
    """Export SOURCE and show its errors; returns 1 where a tolerance or bound was missed."""
    if options.to != "table" and Path(options.source).is_dir() and not options.steady:
        return _export_run(options, console)
    if options.to not in _STEADY:
        raise ConfigError(
            f"--to {options.to} takes a run folder, and SOURCE is {options.source}",
            hint="Train one, or export a table or an FMU",
        )
    _check_file(options)
    model = open_source(options.source, options.inputs, options.outputs, trust=options.trust)
    grid = Grid.of_model(model, _nodes(options))
    with console.progress("Exporting") as advance:
        how = _how(options, advance)
        if options.to == "fmu":
            report = export_fmu(model, grid, options.out, options.fmi, how)
        else:
            report = export_table(model, grid, options.out, how)
    _show(console, report)
    console.document({"schema": SCHEMA, "to": options.to, **report.to_dict()})
    return 0 if report.met else 1


def _check_file(options: Namespace) -> None:
    endings = _ENDINGS[options.to]
    what = f"--to {options.to} writes a {' or '.join(endings)} file"
    check_ending(options.out, what, *endings)
    check_file(options.out, Path(options.source), overwrite=options.overwrite)


def _how(options: Namespace, advance: Progress) -> ExportOptions:
    """Options of the export; its source without folders, which a file must not contain."""
    source = options.source
    return ExportOptions(
        tolerance_pct=options.tolerance,
        max_rows=options.max_rows,
        refine=not options.no_refine,
        strict=options.strict,
        source=Path(source).resolve().name if Path(source).exists() else source,
        progress=advance,
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


def _nodes(options: Namespace) -> dict[str, tuple[float, ...]]:
    """Read --nodes: `NAME=V`, `NAME=V,V,...` and `NAME=LOW:HIGH:COUNT`; raises `ConfigError`."""
    found: dict[str, tuple[float, ...]] = {}
    for word in options.nodes or ():
        name, _, text = word.partition("=")
        try:
            if text.count(":") == 2:
                low, high, many = text.split(":")
                if int(many) > options.max_rows:
                    raise ConfigError(
                        f"the nodes '{word}' are more than the limit of {options.max_rows} rows",
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


# --- a run ---


def _export_run(options: Namespace, console: Console) -> int:
    out, nodes = options.out, _nodes(options)
    if options.to == "c":
        check_output_folder(out, _WRITTEN if options.overwrite else None)
    else:
        _check_file(options)
        proof.read(out.absolute().parent)
    bundle = load_bundle(options.source, trust=options.trust)
    with console.progress("Exporting") as advance:
        exported = Exportable.of(bundle, options.engine, nodes, _how(options, advance))
        cases = _cases(bundle, exported, options, console)
        if options.to == "c":
            with atomic_folder(out, _WRITTEN if options.overwrite else None) as folder:
                found = _write(exported, options, cases, folder / "engine.c")
        else:
            found = _write(exported, options, cases, out)
    _show_run(console, exported, found)
    console.document({"schema": RUN_SCHEMA, "to": options.to, "out": str(out), **found})
    met = exported.sampled is None or exported.sampled.met
    return 0 if found.get("ok", True) and met else 1


def _cases(
    bundle: Bundle, exported: Exportable, options: Namespace, console: Console
) -> list[proof.Case]:
    """Inputs to compare over: the logs of the run or those named, and drawn ones."""
    model, engine = exported.model, options.engine or ""
    cases = [proof.drawn(exported.program().envelope, engine)]
    try:
        logs = evaluation_logs(bundle, options.logs)
    except (DataError, ConfigError) as error:
        if options.logs:
            raise
        console.warn(f"the proof is over drawn inputs alone, without the run's logs: {error}")
        return cases
    for log in logs:
        own = log.source.engine
        if options.engine in {None, own}:
            used = hold_inputs(log.without_faults(), model.input_names)
            cases.append(proof.Case(log.name, own, used.matrix(model.input_names)))
    return cases


def _write(
    exported: Exportable, options: Namespace, cases: list[proof.Case], file: Path
) -> dict[str, Any]:
    """Write a file, and enter its proof in the folder; without a tool to run it there is none."""
    rows, more = _WRITERS[options.to](exported, options, cases, file)
    found: dict[str, Any] = {"file": file.name, "rows": [], **more}
    if rows is not None:
        if options.to != "jsbsim":
            more["sampled"] = _sampling(exported, cases)
        found = proof.document(file, rows, _BOUNDS.get(options.to, proof.BOUND), **more)
    proof.write(file.absolute().parent, found)
    return found


def _c(exported: Exportable, options: Namespace, cases: list[proof.Case], file: Path) -> _Compared:
    program = exported.program(options.interval)
    for name, text in program.code.items():
        atomic_write_text(file.parent / name, text)
    if compiler() is None:
        return None, {}
    model = Compiled.of(program)

    def run_c(trials: Sequence[proof.Trial]) -> Iterator[FloatArray]:
        for case, start in trials:
            found = model.run(case.inputs, start, program.number_of(case.engine))
            yield found[:, : model.outputs]

    rows = proof.compare(exported.model, run_c, cases)
    step_us = model.step_us(proof.held(cases[-1].inputs))
    return rows, {"step_us": step_us, "states": program.states}


def _fmu(
    exported: Exportable, options: Namespace, cases: list[proof.Case], file: Path
) -> _Compared:
    program = exported.program(options.interval)
    size = write_fmu(program, file, options.fmi)
    if compiler() is None:
        return None, {"bytes": size}
    rows, step_us = fmu_run.compare(program, file, cases)
    return rows, {"bytes": size, "step_us": step_us, "states": program.states}


def _onnx(
    exported: Exportable, options: Namespace, cases: list[proof.Case], file: Path
) -> _Compared:
    engine = options.engine or ""
    size = write_onnx(exported.program(), file)
    if onnx_graph.runtime() is None:
        return None, {"bytes": size}
    given = [proof.Case(case.name, engine, proof.held(case.inputs)) for case in cases]

    def run_onnx(trials: Sequence[proof.Trial]) -> list[FloatArray]:
        return onnx_graph.run(file, [case.inputs for case, _ in trials])

    return proof.compare(exported.model, run_onnx, given, starts=False), {"bytes": size}


def _jsbsim(
    exported: Exportable, options: Namespace, cases: list[proof.Case], file: Path
) -> _Compared:
    model, envelope = exported.model.for_engine(options.engine or ""), exported.program().envelope
    logs = cases[1:] or cases
    turbine = jsbsim.Turbine.of(model, envelope, logs)
    data = turbine.xml(exported.about)
    atomic_write_bytes(file, data)
    if jsbsim.runtime() is None:
        return None, {"bytes": len(data)}
    rows, misfit = jsbsim.compare(model, turbine, data, logs)
    return rows, {"bytes": len(data), "misfit": misfit, "throttle": turbine.to_json()}


def _sampling(exported: Exportable, cases: list[proof.Case]) -> dict[str, Any] | None:
    """What sampling the steady state changed: at random conditions, and in free run."""
    if exported.sampled is None:
        return None
    rows = proof.compare(
        exported.original, proof.simulated(exported.model), cases[1:], starts=False
    )
    return {"steady": exported.sampled.to_dict(), "rows": rows}


_WRITERS: dict[str, Callable[[Exportable, Namespace, list[proof.Case], Path], _Compared]] = {
    "c": _c,
    "fmu": _fmu,
    "onnx": _onnx,
    "jsbsim": _jsbsim,
}
_BOUNDS = {"onnx": onnx_graph.BOUND, "jsbsim": jsbsim.BOUND}  # of the others, that of `proof`
_NO_COMPILER = "there is no C compiler 'cc' on the PATH: sources alone, and no proof"
_NO_PROOF = {
    ".onnx": "onnxruntime is not installed: no proof",
    ".xml": "jsbsim is not installed: no proof",
}


def _show_run(console: Console, exported: Exportable, found: dict[str, Any]) -> None:
    for line in exported.about[2:]:
        console.say(line)
    if exported.sampled is not None and not exported.sampled.met:
        console.warn(f"steady state: {exported.sampled.shortfall}")
    rows = [
        [row["log"], row["what"], str(row["samples"]), f"{max(row['largest'].values()):.2g}"]
        for row in found["rows"]
    ]
    if not rows:
        console.warn(_NO_PROOF.get(Path(found["file"]).suffix, _NO_COMPILER))
        return
    console.table(
        "Largest difference from simulate", ["log", "what", "samples", "any output"], rows
    )
    if "step_us" in found:
        console.say(f"{found['step_us']:.2f} us a step, {found['states']} numbers in the state")
    if "misfit" in found:
        _show_misfit(console, found["misfit"])
    if not found["ok"]:
        console.warn(f"the largest difference, {found['largest']:.3g}, is above {found['bound']:g}")


def _show_misfit(console: Console, misfit: dict[str, Any]) -> None:
    rows = [
        [what, *(f"{value:.2f}" for value in by.values())]
        for part, suffix in (("largest", "largest"), ("rms", "RMS"))
        for what, by in ((f"{name}, {suffix}", one) for name, one in misfit[part].items())
    ]
    rows += [
        [f"{what}, s to 90 %", *(f"{one['run']:.2f} -> {one['jsbsim']:.2f}" for one in by.values())]
        for what, by in misfit["t90_s"].items()
    ]
    spools = list(next(iter(misfit["t90_s"].values())))
    console.table("What the form of JSBSim's turbine does not hold, %", ["", *spools], rows)
