"""`narxcal benchmark`: `Narx()` on public sets, compared with published figures."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

from eval.benchmarks import public_sets
from narxcal.cli.console import Console
from narxcal.support.errors import ConfigError
from narxcal.support.files import finite
from training.estimator.ladder import Limits


def add_options(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--data", metavar="DIR", type=Path, required=True,
        help="folder with NAME.csv.gz (columns u, y) and NAME.json (train, test, init_window)",
    )  # fmt: skip
    parser.add_argument("--sets", metavar="NAME", nargs="+", default=[], help="default: all there")
    parser.add_argument(
        "--time-limit", metavar="S", type=float, default=120.0,
        help="CPU seconds for the choice on each set, as Narx(time_limit_s=...) (default 120)",
    )  # fmt: skip
    parser.add_argument(
        "--seed", metavar="N", type=int, default=0, help="of the choice's draws (default 0)"
    )


def run(options: Namespace, console: Console) -> int:
    """Fit and test each set; always 0, since a set on which another is better is a figure."""
    if not options.time_limit > 0.0:
        raise ConfigError(f"--time-limit: expected a time above 0, found {options.time_limit:g}")
    limits = Limits(options.time_limit, options.seed)
    names = public_sets.names_in(options.data, options.sets)
    found: list[public_sets.Figure] = []
    with console.progress("Benchmark") as advance:
        for number, name in enumerate(names):

            def progress(
                done: int, total: int, what: str = "", at: int = number, name: str = name
            ) -> None:
                advance(at * total + done, total * len(names), f"{name}: {what}")

            found += public_sets.figures(options.data, name, limits, progress)
    console.table(
        "RMSE of the free run on the official test range",
        ["set", "model", "recording", "RMSE", "NRMSE [%]", "CPU s"],
        [_cells(one) for one in found],
    )
    for one in found:
        if one.model == public_sets.OURS and one.record == "":
            console.say(f"{one.set}: {one.note}.")
    given = {"data": str(options.data), "time_limit_s": limits.time_limit_s, "seed": limits.seed}
    console.document(finite(public_sets.document(found, given)))
    return 0


def _cells(one: public_sets.Figure) -> list[str]:
    numbers = (f"{one.rmse:.4g} {one.unit}".strip(), f"{one.nrmse_pct:.2f}", f"{one.cpu_s:.0f}")
    return [one.set, one.model, one.record or "all", *(x.replace("nan", "-") for x in numbers)]
