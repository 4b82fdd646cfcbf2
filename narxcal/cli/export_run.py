"""`narxcal export RUN`: the dynamic model as C, FMU, ONNX or JSBSim, with the proof of it."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from data_prep.prepare import hold_inputs
from eval.evaluate import evaluation_logs
from narxcal.calibration.bundle import Bundle, load_bundle
from narxcal.cli.console import Console
from narxcal.export import fmu_run, jsbsim, onnx_run, proof
from narxcal.export.compiler import Compiled, compiler
from narxcal.export.dynamic import Exportable
from narxcal.export.fmu import write_fmu
from narxcal.export.onnx_model import write_onnx
from narxcal.export.report import ExportOptions
from narxcal.support.arrays import FloatArray
from narxcal.support.errors import ConfigError, DataError
from narxcal.support.files import (
    Results,
    atomic_folder,
    atomic_write_bytes,
    atomic_write_text,
    check_file,
    check_output_folder,
)

SCHEMA = "narxcal.export_run/1"
# Rows of a proof, None where the file cannot be run here, and what else is said of it.
_Compared = tuple[list[dict[str, Any]] | None, dict[str, Any]]
_WRITTEN = Results(proof.SCHEMA, proof.FILE, ("engine.c", "engine.h"))


def run(options: Namespace, console: Console, nodes: dict[str, tuple[float, ...]]) -> int:
    """Export RUN, compare the file with `simulate`, and show the proof."""
    _check(options)
    bundle = load_bundle(options.source, trust=options.trust)
    with console.progress("Exporting") as advance:
        how = ExportOptions(
            tolerance_pct=options.tolerance,
            max_rows=options.max_rows,
            refine=not options.no_refine,
            strict=options.strict,
            source=Path(options.source).resolve().name,
            progress=advance,
        )
        exported = Exportable.of(bundle, options.engine, nodes, how)
        cases = _cases(bundle, exported, options, console)
        if options.to == "c":
            with atomic_folder(options.out, _WRITTEN if options.overwrite else None) as folder:
                found = _write(exported, options, cases, folder / "engine.c")
        else:
            found = _write(exported, options, cases, options.out)
    _show(console, exported, found)
    console.document({"schema": SCHEMA, "to": options.to, "out": str(options.out), **found})
    met = exported.sampled is None or exported.sampled.met
    return 0 if found.get("ok", True) and met else 1


def _check(options: Namespace) -> None:
    """Refuse, before any work, an output that is in the way or of another kind."""
    out = options.out
    if options.to == "c":
        check_output_folder(out, _WRITTEN if options.overwrite else None)
        return
    ending = {"fmu": ".fmu", "onnx": ".onnx", "jsbsim": ".xml"}[options.to]
    if out.suffix != ending:
        raise ConfigError(
            f"--to {options.to} writes a {ending} file, and --out names {out.name}",
            hint=f"Name it {out.stem}{ending}",
        )
    check_file(out, Path(options.source), overwrite=options.overwrite)
    proof.read(out.absolute().parent)


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
    """Write the sources, compile and run them."""
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
    """Write an FMU, and run it by FMPy."""
    program = exported.program(options.interval)
    size = write_fmu(program, file, options.fmi)
    if compiler() is None:
        return None, {"bytes": size}
    rows, step_us = fmu_run.compare(program, file, cases)
    return rows, {"bytes": size, "step_us": step_us, "states": program.states}


def _onnx(
    exported: Exportable, options: Namespace, cases: list[proof.Case], file: Path
) -> _Compared:
    """Write a graph of one engine, and run it by onnxruntime."""
    engine = options.engine or ""
    size = write_onnx(exported.program(), file)
    if onnx_run.runtime() is None:
        return None, {"bytes": size}
    given = [proof.Case(case.name, engine, proof.held(case.inputs)) for case in cases]

    def run_onnx(trials: Sequence[proof.Trial]) -> list[FloatArray]:
        return onnx_run.run(file, [case.inputs for case, _ in trials])

    return proof.compare(exported.model, run_onnx, given, starts=False), {"bytes": size}


def _jsbsim(
    exported: Exportable, options: Namespace, cases: list[proof.Case], file: Path
) -> _Compared:
    """Fit JSBSim's turbine, write it, and fly it in JSBSim."""
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
_BOUNDS = {"onnx": onnx_run.BOUND, "jsbsim": jsbsim.BOUND}  # of the others, that of `proof`
_NO_COMPILER = "there is no C compiler 'cc' on the PATH: sources alone, and no proof"
_NO_PROOF = {
    ".onnx": "onnxruntime is not installed: no proof",
    ".xml": "jsbsim is not installed: no proof",
}


def _show(console: Console, exported: Exportable, found: dict[str, Any]) -> None:
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
    """What JSBSim's form does not hold."""
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
