"""`narxcal train`: from logs to a bundle, to be cut short and gone on with at any time.

RUN holds the bundle once there is one, and `checkpoints/` while a training is unfinished. An
interrupted training leaves both: its best network so far, and the place to go on from.
"""

from __future__ import annotations

import math
import shutil
from argparse import ArgumentParser, Namespace
from contextlib import suppress
from pathlib import Path
from typing import Any

from narxcal.calibration.bundle import (
    DOCUMENT,
    Bundle,
    check_bundle,
    settle_bundle,
    write_bundle,
)
from narxcal.calibration.run_record import RunRecord
from narxcal.cli.console import Console
from narxcal.cli.options import add_config
from narxcal.cli.results import (
    held_out_words,
    interval_words,
    lag_words,
    mixture_words,
    read_config,
    steady_words,
)
from narxcal.support.errors import ConfigError
from narxcal.support.files import check_writable, recover
from training.config import RunConfig
from training.methods import TrainOptions
from training.pipeline import calibrate, configured_files, doubts, read_split

SCHEMA = "narxcal.train/1"
CHECKPOINTS = "checkpoints"


def add_options(parser: ArgumentParser) -> None:
    add_config(parser, "RUN", "folder for the model")
    parser.add_argument("--resume", action="store_true", help="continue an interrupted training")


def run(options: Namespace, console: Console) -> int:
    """Train, or go on with a training; an interrupted one ends well with its best network."""
    run_folder: Path = options.out
    config, base = read_config(options.config, options.data)
    check(run_folder, resume=options.resume)
    if options.resume and _complete(run_folder, config):
        _settle(run_folder)
        console.say(f"{run_folder} is complete; nothing is left to do.")
        console.document(_document(run_folder, check_bundle(run_folder)))
        return 0
    if options.resume and not (run_folder / CHECKPOINTS).is_dir():
        console.warn(f"nothing to resume in {run_folder}: the training begins anew")
    bundle = train_or_stop(config, base, run_folder, (options.resume, console))
    _show(console, run_folder, bundle)
    console.document(_document(run_folder, bundle.record))
    return 0


def train_or_stop(config: RunConfig, base: Path, folder: Path, how: tuple[bool, Console]) -> Bundle:
    """As `train`; Ctrl-C says where the training stands."""
    try:
        return train(config, base, folder, how)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(_where_it_stands(folder)) from None


def train(config: RunConfig, base: Path, folder: Path, how: tuple[bool, Console]) -> Bundle:
    """Calibrate on the logs of `config` and write the bundle to `folder`.

    `how` says whether to go on from checkpoints, and where to show progress.
    """
    resume, console = how
    with console.progress("Reading the logs") as advance:
        split, said = read_split(config, configured_files(config, base), advance)
    for warning in said:
        console.warn(warning)
    checkpoints = folder / CHECKPOINTS
    with console.progress("Training") as advance:
        bundle = calibrate(config, base, split, TrainOptions(advance, checkpoints, resume))
    for warning in doubts(bundle.record):
        console.warn(warning)
    write_bundle(folder, bundle)
    if not bundle.record.interrupted:
        shutil.rmtree(checkpoints, ignore_errors=True)
    return bundle


def check(folder: Path, *, resume: bool) -> None:
    """Refuse a folder that cannot be written or, but for a training to resume, holds anything."""
    recover(folder)
    check_writable(folder)
    if not folder.exists():
        return
    if not folder.is_dir():
        raise ConfigError(f"output folder {folder} is not a folder", hint="Choose another name")
    found = {entry.name for entry in folder.iterdir()}
    if not found or (resume and found & {DOCUMENT, CHECKPOINTS}):
        return
    if DOCUMENT in found:
        what, hint = "holds a trained model", "Choose another name"
    elif CHECKPOINTS in found:
        what, hint = (
            "holds an unfinished training",
            "Go on with it by --resume, or choose another name",
        )
    else:
        what, hint = "exists and is not empty", "Choose another name"
    raise ConfigError(f"output folder {folder} {what}", hint=hint)


def _complete(folder: Path, config: RunConfig) -> bool:
    """Whether `folder` holds the finished model of `config`; another's is refused."""
    if not (folder / DOCUMENT).is_file():
        return False
    stored = check_bundle(folder)
    given = stored.config if stored.configured is None else stored.configured
    if given != config.model_dump(mode="json", by_alias=True):
        raise ConfigError(
            f"output folder {folder} holds a model of another configuration",
            hint="Choose another name",
        )
    return not stored.interrupted


def _settle(folder: Path) -> None:
    """Remove what a training left that was killed after its model was written."""
    with suppress(OSError):  # a folder that can only be read stays as it is
        settle_bundle(folder)
        shutil.rmtree(folder / CHECKPOINTS, ignore_errors=True)


def _where_it_stands(folder: Path) -> str:
    if (folder / CHECKPOINTS).is_dir():
        return f"no model was written; train --resume --out {folder} goes on from the last step"
    return ""


def _document(folder: Path, record: RunRecord) -> dict[str, Any]:
    table = record.to_json()
    kept = (
        "training",
        "steady_state",
        "lag_form",
        "mixture",
        "screening",
        "split",
        "seeds",
        "data",
        "metrics",
        "config",
    )
    return {
        "schema": SCHEMA,
        "run": str(folder),
        "interrupted": record.interrupted,
        **{key: table.get(key) for key in (*kept, "hardware")},
    }


def _show(console: Console, folder: Path, bundle: Bundle) -> None:
    record, training = bundle.record, bundle.record.training
    facts = {
        "Steady state": steady_words(record),
        "Delay": "" if bundle.calibration.delay is None else bundle.calibration.delay.words,
        "Lags": lag_words(record),
        "Mixture": mixture_words(record),
        "Interval": interval_words(
            bundle.calibration.interval, names=bundle.calibration.output_names
        ),
        "Constant inputs": bundle.certificate.words,
    }
    console.facts({name: words for name, words in facts.items() if words})
    ends = [
        row
        for history in training.history
        for row, after in zip(history, [*history[1:], None], strict=True)
        if after is None or after.iteration <= row.iteration
    ]
    head = ["start", "horizon [s]", "steps", "training error", "validation error"]
    rows = [
        [
            str(row.start),
            f"{row.horizon_s:g}",
            str(row.iteration),
            f"{math.sqrt(2.0 * row.loss):.4f}",
            "" if row.validation is None else f"{row.validation:.4f}",
        ]
        for row in ends
    ]
    if all(row.validation is None for row in ends):
        head, rows = head[:-1], [cells[:-1] for cells in rows]
    console.table("Free-run error in scaled units at the end of each stage", head, rows)
    if bundle.record.interrupted:
        console.say("Interrupted: the best network so far was kept; --resume goes on with it.")
    console.say(f"Model: {folder} ({training.wall_s:.1f} s). Next: narxcal evaluate {folder}")
    if words := held_out_words(record):
        console.say(words)
