"""`narxcal identify`: a model by one of several methods, in the same kind of run folder as `train`.

RUN holds the bundle and `identify.json`: parameters with their deviations, status and advice. The
method narx is `train`.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from typing import Any

from narxcal.calibration.bundle import Bundle
from narxcal.cli.console import Console
from narxcal.cli.options import add_config, add_method
from narxcal.cli.results import read_config, steady_words
from narxcal.cli.train import check, train_or_stop
from narxcal.support.files import atomic_write_text, to_json

SCHEMA, DOCUMENT = "narxcal.identify/1", "identify.json"
_MOST_SHOWN = 40  # parameters; a black box has hundreds without a meaning


def add_options(parser: ArgumentParser) -> None:
    add_config(parser, "RUN", "folder for the model")
    add_method(parser)


def run(options: Namespace, console: Console) -> int:
    config, base = read_config(options.config, options.data, options.method)
    check(options.out, resume=False)
    bundle = train_or_stop(config, base, options.out, (False, console))
    document = document_of(bundle)
    atomic_write_text(options.out / DOCUMENT, to_json(document))
    _show(console, bundle, document)
    console.say(f"Model: {options.out}. Next: narxcal evaluate {options.out}")
    console.document({**document, "run": str(options.out)})
    return 0


def document_of(bundle: Bundle) -> dict[str, Any]:
    """`identify.json`; a network has no parameters with a meaning."""
    record = bundle.record.to_json()
    plain = {"parameters": {}, "status": record["training"]["status"], "advice": "none"}
    return {
        "schema": SCHEMA,
        "method": bundle.record.method,
        "model": bundle.calibration.words,
        **plain,
        "warnings": [],
        **record.get("identify", {}),
        "free_run": record["free_run"],
        "fit_s": record["training"]["wall_s"],
    }


def _show(console: Console, bundle: Bundle, document: dict[str, Any]) -> None:
    console.facts({
        "Method": document["method"],
        "Dynamics": document["model"],
        "Steady state": steady_words(bundle.record),
        "Status": document["status"],
        "Advice": document["advice"],
    })  # fmt: skip
    rows = [
        [name, row["unit"], *(_number(row[key]) for key in ("value", "sd", "sd_coloured"))]
        for name, row in list(document["parameters"].items())[:_MOST_SHOWN]
    ]
    if rows:
        head = ["parameter", "unit", "value", "sd", "sd, coloured"]
        console.table("Estimates", head, rows)
    left_out = len(document["parameters"]) - len(rows)
    if left_out:
        console.say(f"{left_out} more are in {DOCUMENT}")
    errors = document["free_run"]["rmse"].items()
    console.say(f"Free run on training logs, RMSE: {', '.join(f'{n} {v:.3g}' for n, v in errors)}")
    for text in document["warnings"]:
        console.warn(text)


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.4g}"
