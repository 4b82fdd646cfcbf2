"""The logs that a bundle is judged on: those named, or those that its training held out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from data_prep.log import Log
from eval.evaluate import evaluation_logs
from narxcal.bundle import Bundle
from narxcal.cli.console import Console
from narxcal.errors import DataError


def logs_for(
    bundle: Bundle, files: Sequence[Path] | None, data: Path | None, console: Console
) -> list[Log]:
    """Read `files`, or the held-out logs; `data` says where the latter are now.

    Warns of a held-out log whose file is not the one that training saw. Raises `DataError`.
    """
    with console.progress("Reading the logs"):
        if files:
            return evaluation_logs(bundle, _once(files, console))
        logs = _held_out(bundle, data)
    if not (bundle.meta.get("split") or {}).get("test"):
        console.warn("no log was held out: these are logs that the model was trained on")
    for text in changed(bundle, logs):
        console.warn(text)
    return logs


def _once(files: Sequence[Path], console: Console) -> list[Path]:
    """Each file once: a log that is judged twice would count twice in what is pooled."""
    chosen = list({file.resolve(): file for file in files}.values())
    if len(chosen) < len(files):
        console.warn("a file that is named twice is read once")
    return chosen


def changed(bundle: Bundle, logs: Sequence[Log]) -> list[str]:
    """Say which logs come from files with other bytes than at the time of the training."""
    known = {Path(file).name: digest for file, digest in bundle.meta.get("data", {}).items()}
    found = {log.source.file: log.source.sha256 for log in logs}
    return [
        f"{file}: the file has changed since the training: sha256 was "
        f"{known[Path(file).name][:12]}, is {digest[:12]}"
        for file, digest in found.items()
        if known.get(Path(file).name, digest) != digest
    ]


def _held_out(bundle: Bundle, data: Path | None) -> list[Log]:
    try:
        return evaluation_logs(_moved(bundle, data) if data else bundle)
    except DataError as error:
        if not (error.hint or "").startswith(("Set [logs] folder", "Set [logs] files")):
            raise
        hint = "Say where the held-out logs are by --data, or name others by --logs"
        raise DataError(error.problem, file=error.file, hint=hint) from None


def _moved(bundle: Bundle, data: Path) -> Bundle:
    config = bundle.meta.get("config", {})
    logs = {**config.get("logs", {}), "folder": str(data.resolve())}
    return replace(bundle, meta={**bundle.meta, "config": {**config, "logs": logs}})
