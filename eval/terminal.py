"""Results as tables for a terminal of 80 columns."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table
from rich.text import Text

from eval.judging.outcome import Outcome
from eval.report.style import number, unit, with_unit
from eval.report.tables import measures
from narxcal.channels import symbol
from narxcal.intervals import LEVEL
from training.responses.transients import Assessment

if TYPE_CHECKING:
    from eval.judging.compare import Comparison
    from eval.judging.crossval import CrossValidation
    from eval.judging.log_evaluation import LogEvaluation
    from eval.judging.scores import ChannelScores

_WORDS = {True: ("PASS", "bold green"), False: ("FAIL", "bold red"), None: ("NOT ASSESSED", "bold")}
_BASELINES = ("steady", "1st order", "ARX")


def print_scores(console: Console, logs: Sequence[LogEvaluation]) -> None:
    """One table per log: free run and baselines, the lowest RMSE in bold."""
    for one in logs:
        heads = ("free run", "max rel", "1 step", "static", "dynamic", *_BASELINES)
        table = plain_table(one.log.name, "RMSE of", heads)
        for name, found in one.scores.items():
            best = found.best_rmse
            table.add_row(
                Text(with_unit(name)),
                _figure(found.rmse, best),
                Text(_measure(found.max_rel_pct, "%")),
                *(
                    Text(number(value))
                    for value in (found.one_step_rmse, found.static_rmse, found.dynamic_rmse)
                ),
                *(_figure(value, best) for value in found.baselines.values()),
            )
        console.print(table)


def print_interval(console: Console, pooled: Mapping[str, ChannelScores]) -> None:
    """Print how many samples of each channel lie within the interval of the free run."""
    known = {name: one for name, one in pooled.items() if math.isfinite(one.coverage)}
    if known:
        shares = ", ".join(
            f"{symbol(name)} {100.0 * one.coverage:.0f} % (±{number(one.half_width, 2)} "
            f"{unit(name)})"
            for name, one in known.items()
        )
        console.print(Text(f"Within the {100.0 * LEVEL:.0f} % interval: {shares}"))


def _measure(value: float, unit: str) -> str:
    return f"{number(value, 2)} {unit}" if math.isfinite(value) else number(None)


def _figure(value: float, best: float) -> Text:
    return Text(number(value), style="bold green" if value == best else "")


def print_transients(console: Console, logs: Sequence[LogEvaluation]) -> None:
    """Ti and Tt, one table per log: passed of assessed, worst errors, not assessable."""
    for one in logs:
        channels = dict.fromkeys(each.channel for each in one.assessments)
        if not channels:
            continue
        heads = ("passed", "worst Ti error", "worst Tt error", "not assessable")
        table = plain_table(one.log.name, "Ti and Tt of", heads)
        for channel in channels:
            own = [each for each in one.assessments if each.channel == channel]
            table.add_row(Text(symbol(channel)), *_transient_cells(own))
        console.print(table)


def print_levels(console: Console, logs: Sequence[LogEvaluation]) -> None:
    """Level and lag of the free run over each whole log, and what held-out logs allow."""
    for one in logs:
        heads = ("error", "allowed", "", "lag", "allowed lag")
        table = plain_table(one.log.name, "Level of", heads)
        for each in one.levels:
            word, look = _WORDS[each.ok]
            table.add_row(
                Text(with_unit(each.channel)),
                *(Text(number(value)) for value in (each.error, each.allowed)),
                Text(word, style=look),
                Text(_measure(each.lag_s, "s")),
                Text(_measure(math.nan if each.allowed_lag_s is None else each.allowed_lag_s, "s")),
            )
        if one.levels:
            console.print(table)


def _transient_cells(found: Sequence[Assessment]) -> list[Text]:
    assessed = [one.verdict for one in found if one.verdict.ok is not None]
    passed = sum(verdict.ok is True for verdict in assessed)
    colour = "green" if passed == len(assessed) else "red"
    worst = [
        max((abs(check.error_s) for check in checks if check is not None), default=math.nan)
        for checks in ([part.Ti for part in assessed], [part.Tt for part in assessed])
    ]
    return [
        Text(f"{passed}/{len(assessed)}", style=colour if assessed else ""),
        *(Text(_measure(value, "s")) for value in worst),
        Text(str(len(found) - len(assessed))),
    ]


def print_outcome(console: Console, outcome: Outcome) -> None:
    word, look = _WORDS[outcome.passed]
    console.print(Text.assemble((word, look), f"  {outcome.headline}"))
    for line in outcome.lines:
        console.print(Text(f"  {line}"))


def print_crossval(console: Console, found: CrossValidation) -> None:
    """Print the spread of every measure over the folds, one table per scheme."""
    for name, folds in found.schemes.items():
        heads = ("mean", "std", "min", "max", "limit")
        table = plain_table(f"{name}, {len(folds)} folds", "measure", heads, fold=True)
        spread = found.spread(name)
        for measure in measures(found):
            own = spread.get(measure.key, {})
            figures = [own.get(head) for head in ("mean", "std", "min", "max")]
            table.add_row(Text(measure.title), *map(number, (*figures, measure.limit)))
        console.print(table)


def print_comparison(console: Console, found: Comparison) -> None:
    """Print one row per model, the least RMSE of each channel in bold."""
    table = Table(
        title=Text("Ti and Tt passed, and RMSE of the free run on the same rows", style="bold"),
        title_justify="left", box=None, pad_edge=False, padding=(0, 1, 0, 0),
    )  # fmt: skip
    table.add_column("run", overflow="fold", max_width=18)
    heads = ("size", "fit [s]", "us", "in 90 %")
    for head in ("Ti, Tt", *map(with_unit, found.channels), *heads):
        table.add_column(head, justify="right", no_wrap=True)
    for row in found.rows:
        errors = [row.channels.get(name, {}).get("rmse", math.nan) for name in found.channels]
        passed = None if row.ti_tt is None else f"{row.ti_tt.passed}/{row.ti_tt.assessed}"
        coverage = None if row.coverage_90 is None else 100.0 * row.coverage_90
        table.add_row(
            Text(row.run),
            Text(passed or number(None)),
            *map(_figure, errors, found.least.values()),
            Text(number(None) if row.parameters is None else str(row.parameters)),
            *(Text(number(value, 2)) for value in (row.fit_s, row.simulate_us, coverage)),
        )
    console.print(table)


def plain_table(title: str, first: str, heads: Sequence[str], *, fold: bool = False) -> Table:
    """An empty table without lines; the first column takes text, which may `fold`."""
    # A Text title: a log name in square brackets must not be read as markup.
    look = Text(title, style="bold", overflow="fold")
    table = Table(title=look, title_justify="left", box=None, pad_edge=False)
    table.add_column(first, no_wrap=not fold, overflow="fold" if fold else "ellipsis")
    for head in heads:
        table.add_column(head, justify="right", no_wrap=True)
    return table
