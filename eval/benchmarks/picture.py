"""The README's picture: `python -m eval.benchmarks.picture RUN OUT.png`.

Shows the fast push with the largest lever movement of the first held-out log, whatever the model
makes of it.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from eval.evaluate import evaluate, evaluation_logs, run_config
from eval.report.content import EventTrace
from eval.report.evaluation import page_of
from eval.report.event_figures import summary_figure
from narxcal.atomic import atomic_write_bytes
from narxcal.bundle import load_bundle
from narxcal.errors import DataError


def main(arguments: Sequence[str] | None = None) -> int:
    """Evaluate the first held-out log of a run and draw one event of it."""
    parser = argparse.ArgumentParser(prog="python -m eval.benchmarks.picture", description=__doc__)
    parser.add_argument("bundle", metavar="RUN", type=Path)
    parser.add_argument("out", metavar="OUT.png", type=Path)
    options = parser.parse_args(arguments)
    bundle = load_bundle(options.bundle)
    config, settings = run_config(bundle)
    [one] = evaluate(bundle, evaluation_logs(bundle)[:1], None, settings).logs
    page = page_of(one, config.events.driver, bundle.calibration.input_names)
    picture = summary_figure(largest_push(page.events), config.events.driver)
    atomic_write_bytes(options.out, picture)
    return 0


def largest_push(traces: Sequence[EventTrace]) -> EventTrace:
    """The fast push, assessed in every channel, that moves the driver most; or `DataError`."""
    pushes = [
        trace
        for trace in traces
        if trace.event.label == 0 and trace.event.speed == "fast" and _assessed(trace)
    ]
    if not pushes:
        raise DataError("no fast push could be assessed in every channel")
    return max(pushes, key=lambda trace: trace.event.lever_after - trace.event.lever_before)


def _assessed(trace: EventTrace) -> bool:
    verdicts = [response.verdict for response in trace.responses.values()]
    return all(verdict is not None and verdict.ok is not None for verdict in verdicts)


if __name__ == "__main__":
    sys.exit(main())
