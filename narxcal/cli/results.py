"""What commands share around a run: configuration, held-out logs, provenance in words."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from data_prep.log import Log, Source
from narxcal.channels import described
from narxcal.cli.console import Console
from narxcal.intervals import ENOUGH, LEVEL, HalfWidths
from narxcal.support.errors import ConfigError
from narxcal.support.files import check_file
from training.config import IdentifyConfig, RunConfig, load_config

if TYPE_CHECKING:
    from eval.report.page import RunHeader
    from narxcal.calibration.bundle import Bundle
    from narxcal.calibration.run_record import RunRecord, SteadyRecord


def read_config(path: str, data: Path | None, method: str | None = None) -> tuple[RunConfig, Path]:
    """Read CONFIG; `data` takes the place of `[logs] folder`, `method` of that of `[identify]`.

    Returns the configuration and the folder that its paths are relative to; raises
    `ConfigError` as `load_config`.
    """
    config, base = load_config(path)
    if method is not None:
        table = {**config.identify.model_dump(), "method": method}
        section = IdentifyConfig.parse(table, options={"method": f"--method {method}"})
        config = config.model_copy(update={"identify": section})
    return config if data is None else config.with_logs_in(data), base


def logs_for(
    bundle: Bundle, files: Sequence[Path] | None, data: Path | None, console: Console
) -> list[Log]:
    """Read `files`, or the held-out logs; `data` says where the latter are now.

    Warns of a held-out log whose file has changed since the training. Raises `DataError`.
    """
    from eval.run_logs import logs_of  # noqa: PLC0415 -- `prepare` needs no model

    with console.progress("Reading the logs"):
        return logs_of(bundle, files, data, console.warn)


_LAGS = {
    "plain": "without limits of acceleration",
    "limits": "with limits of acceleration and deceleration",
    "governed": "with N1 governed by the control",
}
_KINDS = {"fmu": "FMU", "callable": "function"}


def steady_words(record: RunRecord) -> str:
    """Describe where the steady-state model of a bundle comes from; empty if it is not recorded."""
    found = record.steady_state
    if found is None:
        return ""
    if not found.fitted:
        section = record.config.get("steady_state", {})
        kind = section.get("kind", "model")
        return f"the maker's {_KINDS.get(kind, kind)} {section.get('source', '')}".strip()
    left = ", ".join(
        f"{name} {rms:.3g} {described(name).unit}".removesuffix(" -")
        for name, rms in found.rms.items()
    )
    return (
        f"fitted to {found.samples} quasi-steady samples over {100 * found.coverage:.0f} % "
        f"of the driver's range{_form(found)}; RMS left: {left}"
    )


def _form(found: SteadyRecord) -> str:
    """Describe the form of the fitted curves; empty for a bundle that does not record it."""
    if found.corrected is None:
        return ""
    words = ["corrected parameters" if found.corrected else "parameters as they are"]
    if found.exponents:
        words.append(f"fitted exponents of {' and '.join(found.exponents)}")
    if found.assumed:
        words.append(f"{' and '.join(found.assumed)} taken as 0 for want of a record")
    if found.blend:
        words.append(f"blended over {' and '.join(found.blend)}")
    if found.switches:
        words.append(f"shifted by {', '.join(found.switches)}")
    return f"; {', '.join(words)}"


def lag_words(record: RunRecord) -> str:
    """Describe the form of the lags and how it was chosen; empty without lags."""
    found = record.lag_form
    if found is None or not found.form:
        return ""
    left = ", ".join(f"{form} {loss:.2g}" for form, loss in found.left.items())
    chosen = f"; loss of Ti and Tt on logs that were left out: {left}" if left else ""
    return f"{_LAGS.get(found.form, found.form)}{chosen}"


def mixture_words(record: RunRecord) -> str:
    """Say of which models each output is mixed, and on what grounds; empty without a choice."""
    found = record.weighed
    parts = []
    for name, one in found.channels.items():
        words = [f"{weight:.2f} {model.replace('_', ' ')}" for model, weight in one.ordered]
        parts.append(f"{name} {' + '.join(words)}")
    return f"{', '.join(parts)} ({found.status})" if parts else ""


def held_out_words(record: RunRecord) -> str:
    """Say what parts held out of the training logs leave: response times first, then errors."""
    passed = judged = 0
    errors = []
    for name, one in record.weighed.channels.items():
        leader = one.ordered[0][0]
        responses = one.held_out_responses.get(leader)
        if responses is not None:
            passed, judged = passed + responses.passed, judged + responses.judged
        error = one.held_out_rmse.get("mixture")
        if error is not None:
            errors.append(f"{name} {error:.3g} {described(name).unit}")
    times = f"Ti and Tt {passed} of {judged} passed; " if judged else ""
    return f"Held out of the training logs: {times}RMSE {', '.join(errors)}" if errors else ""


def interval_words(
    found: HalfWidths | None, level: float = LEVEL, names: Sequence[str] = ()
) -> str:
    """Say what the interval of a model of the outputs `names` rests on, or that it has none."""
    if found is None:
        return "No interval: the model stores no errors of held-out logs"
    logs = f"{found.pieces} held-out log{'' if found.pieces == 1 else 's'}"
    few = ", so few that it is widened" if found.pieces < ENOUGH else ""
    pairs = zip(names, found.between, strict=False)
    levels = ", ".join(f"{name} {each:.2g} {described(name).unit}" for name, each in pairs)
    days = f"; another day or engine is off by {levels} (standard deviation)" if levels else ""
    return f"Interval of {100.0 * level:g} % by the errors of {logs}{few}{days}"


def check_ending(out: Path, what: str, *endings: str) -> None:
    """Refuse, before any work is done, a name with the ending of another kind of file."""
    if not out.name.endswith(endings):
        stem = out.name.removesuffix(".gz").rpartition(".")[0] or out.name or "result"
        raise ConfigError(f"{what}, and --out names {out.name}", hint=f"Name it {stem}{endings[0]}")


def check_pair(options: Namespace, what: str, endings: tuple[str, str], *read: Path) -> Path:
    """Refuse --out where it, or the file next to it, has another ending or is in the way.

    `read` is what the command reads. Returns the second file; raises `ConfigError`.
    """
    check_ending(options.out, f"{what} is a {endings[0]} file", endings[0])
    second: Path = options.out.with_suffix(endings[1])
    for out in (options.out, second):
        check_file(out, *read, overwrite=options.overwrite)
    return second


def config_header(
    title: str, config: RunConfig, sources: Iterable[Source], cautions: Sequence[str]
) -> RunHeader:
    """Header of a page about logs and the configuration that they were read by."""
    from eval.report.page import RunHeader  # noqa: PLC0415 -- `train` draws no page

    text = config.model_dump_json(by_alias=True, indent=1)
    return RunHeader(title=title, sources=data_files(sources), config=text, cautions=cautions)


def hash_words(sha256: str) -> str:
    return f"sha256 {sha256[:16]}"


def data_files(sources: Iterable[Source]) -> list[Source]:
    """Every recording once, however many parts it was split into."""
    return list({(source.file, source.engine): source for source in sources}.values())
