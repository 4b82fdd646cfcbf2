"""`narxcal info`: what a model is and where it comes from."""

from __future__ import annotations

import json
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import Any

import numpy as np

from narxcal.calibration.bundle import Bundle, load_bundle, read_document
from narxcal.calibration.dynamic import DynamicCalibration
from narxcal.cli.console import Console
from narxcal.cli.options import add_run
from narxcal.cli.results import hash_words, interval_words, lag_words, steady_words

SCHEMA = "narxcal.info/1"
_KEPT = ("split", "seeds", "steady_state", "lag_form", "training")
_FIGURES = ("rmse", "one_step_rmse", "steady_state_rmse")


def add_options(parser: ArgumentParser) -> None:
    add_run(parser)


def run(options: Namespace, console: Console) -> int:
    """Load a bundle, which checks it, and print what is stored about it."""
    bundle = load_bundle(options.bundle, trust=options.trust)
    document = _document(str(options.bundle), bundle, read_document(options.bundle))
    console.facts(_facts(document, bundle))
    console.table(
        "Outputs and the guaranteed bounds of their deviation from steady state",
        ["channel", "unit", "low", "high"],
        [
            [name, document["units"].get(name, ""), f"{low:.4g}", f"{high:.4g}"]
            for name, (low, high) in document["deviation_bounds"].items()
        ],
    )
    if document["metrics"] is None:
        console.say(
            f"{options.bundle / 'evaluate'} holds no evaluation of these weights: one that "
            "evaluate --out DIR wrote is in DIR"
        )
    else:
        _show_metrics(console, document["metrics"], document["units"])
    console.table(
        "Data",
        ["file", "sha256"],
        [[file, digest[:16]] for file, digest in document["data"].items()],
    )
    console.document(document)
    return 0


def _show_metrics(console: Console, metrics: dict[str, Any], units: dict[str, str]) -> None:
    trim = f", trim {metrics['trim']:g}" if metrics["trim"] else ""
    rows = [
        [name, units.get(name, ""), *(_number(figures[key]) for key in _FIGURES)]
        for name, figures in metrics["channels"].items()
    ]
    head = ["channel", "unit", "free run RMSE", "one step RMSE", "steady state RMSE"]
    console.table(f"Last evaluation{trim}: {', '.join(metrics['logs'])}", head, rows)
    found = metrics["ti_tt"]
    console.say(f"Ti/Tt: {found['passed']} of {found['assessed']} assessed transients pass")


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"


def _document(run: str, bundle: Bundle, stored: dict[str, Any]) -> dict[str, Any]:
    calibration, record = bundle.calibration, bundle.record
    low, high = calibration.bounds()
    network = calibration if isinstance(calibration, DynamicCalibration) else None
    return {
        "schema": SCHEMA,
        "run": run,
        "name": record.config.get("name", ""),
        "channels": stored["channels"],
        "units": stored["units"],
        "dt_s": calibration.dt_s,
        "method": record.method,
        "model": calibration.words,
        "parameters": calibration.size,
        **({} if network is None else _network(network)),
        "weights_sha256": stored["weights"]["sha256"],
        "sha256": bundle.sha256 or None,
        "interval": {
            "words": interval_words(calibration.interval, names=calibration.output_names),
            "held_out": 0 if calibration.interval is None else calibration.interval.pieces,
        },
        "certificate": bundle.certificate.row(),
        "deviation_bounds": {
            name: [float(low[k]), float(high[k])]
            for k, name in enumerate(calibration.output_names)
            if np.isfinite(low[k])
        },
        **{key: record.to_json().get(key) for key in _KEPT},
        "metrics": _metrics(Path(run), stored["weights"]["sha256"]),
        "data": record.data,
        "hardware": record.hardware,
        "versions": record.versions,
        "config": record.config,
    }


def _network(calibration: DynamicCalibration) -> dict[str, Any]:
    narx = calibration.narx.config
    return {
        "schedule": list(calibration.schedule),
        "lags": narx.lags,
        "taps": list(narx.taps),
        "hidden": narx.hidden,
        "weights": int(calibration.narx.weights.theta.size),
    }


def _metrics(run: Path, weights: str) -> dict[str, Any] | None:
    """Read the figures of the last `evaluate` of these weights from RUN/evaluate; None without."""
    try:
        found = json.loads((run / "evaluate" / "evaluate.json").read_text(encoding="utf-8"))
        if found["weights_sha256"] != weights:
            return None
        counts, channels = found["pooled"]["ti_tt"], found["pooled"]["channels"]
        return {
            "logs": {str(log["log"]): log["role"] for log in found["logs"]},
            "trim": None if found["trim"] is None else float(found["trim"]),
            **found["pooled"],
            "channels": {
                name: {
                    **row,
                    **{key: None if row[key] is None else float(row[key]) for key in _FIGURES},
                }
                for name, row in channels.items()
            },
            "ti_tt": {**counts, **{key: int(counts[key]) for key in ("passed", "assessed")}},
        }
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return None


def _facts(document: dict[str, Any], bundle: Bundle) -> dict[str, str]:
    record = bundle.record
    split = record.split.items()
    facts = {
        "Model": document["name"] or document["run"],
        "Inputs": ", ".join(document["channels"]["inputs"]),
        "Outputs": ", ".join(document["channels"]["outputs"]),
        "Sampling": f"{document['dt_s']:.6g} s ({1.0 / document['dt_s']:.4g} Hz)",
        "Method": document["method"],
        "Dynamics": f"{document['model']}; {document['parameters']} parameters",
        "Bundle": hash_words(document["sha256"]),
        "Steady state": steady_words(record),
        "Lags": lag_words(record),
        "Interval": document["interval"]["words"],
        "Constant inputs": bundle.certificate.words,
        **{f"{part.capitalize()} logs": ", ".join(logs) or "none" for part, logs in split},
        "Seeds": ", ".join(map(str, record.seeds)),
        "Versions": ", ".join(f"{name} {text}" for name, text in record.versions.items()),
    }
    if record.training.status:
        facts["Training"] = f"{record.training.status} ({record.training.wall_s:.1f} s)"
    return {name: text for name, text in facts.items() if text}
