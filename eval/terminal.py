"""Results as tables for a terminal of 80 columns."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

from eval.report.content import LogPage, Scheme, Score
from eval.report.page import Outcome
from eval.report.style import with_unit
from eval.report.tables import best_of, number, summary
from narxcal.channels import symbol

_WORDS = {True: ("PASS", "bold green"), False: ("FAIL", "bold red"), None: ("NOT ASSESSED", "bold")}
_SHORT = {"steady state": "steady", "first order": "1st order"}


def print_scores(console: Console, pages: Sequence[LogPage]) -> None:
    """One table per log: free run beside the baselines, the lowest RMSE in bold."""
    for page in pages:
        console.print(scores_table(page))


def scores_table(page: LogPage) -> Table:
    """Errors of one log by channel, RMSE in the channel's unit."""
    names = list(dict.fromkeys(name for score in page.scores for name in score.baselines))
    table = _table(page.name)
    table.add_column("RMSE of", no_wrap=True)
    for head in ("free run", "max rel", "1 step", "static", "dynamic"):
        table.add_column(head, justify="right", no_wrap=True)
    for name in names:
        table.add_column(_SHORT.get(name, name), justify="right", no_wrap=True)
    for score in page.scores:
        table.add_row(*_score_cells(score, names))
    return table


def _score_cells(score: Score, names: Sequence[str]) -> list[Text]:
    best = best_of(score)
    return [
        Text(with_unit(score.channel)),
        _figure(score.rmse, best),
        Text(_measure(score.max_rel_pct, "%")),
        Text(number(score.one_step_rmse)),
        Text(number(score.static_rmse)),
        Text(number(score.dynamic_rmse)),
        *(_figure(score.baselines.get(name, math.nan), best) for name in names),
    ]


def _measure(value: float, unit: str) -> str:
    return f"{number(value, 2)} {unit}" if math.isfinite(value) else number(None)


def _figure(value: float, best: float) -> Text:
    return Text(number(value), style="bold green" if value == best else "")


def print_transients(console: Console, pages: Sequence[LogPage]) -> None:
    """Ti and Tt, one table per log: passed of assessed, worst errors, not assessable."""
    for page in pages:
        if not _judged(page):
            continue
        table = _table(page.name)
        table.add_column("Ti and Tt of", no_wrap=True)
        for head in ("passed", "worst Ti error", "worst Tt error", "not assessable"):
            table.add_column(head, justify="right", no_wrap=True)
        for channel in _judged(page):
            table.add_row(*_transient_cells(page, channel))
        console.print(table)


def _judged(page: LogPage) -> list[str]:
    return list(dict.fromkeys(name for trace in page.events for name in trace.responses))


def _transient_cells(page: LogPage, channel: str) -> list[Text]:
    found = [trace.responses[channel] for trace in page.events if channel in trace.responses]
    verdicts = [response.verdict for response in found if response.verdict is not None]
    assessed = [verdict for verdict in verdicts if verdict.ok is not None]
    passed = sum(verdict.ok is True for verdict in assessed)
    colour = "green" if passed == len(assessed) else "red"
    worst = [
        max((abs(check.error_s) for check in checks if check is not None), default=math.nan)
        for checks in ([part.Ti for part in assessed], [part.Tt for part in assessed])
    ]
    return [
        Text(symbol(channel)),
        Text(f"{passed}/{len(assessed)}", style=colour if assessed else ""),
        *(Text(_measure(value, "s")) for value in worst),
        Text(str(len(verdicts) - len(assessed))),
    ]


def print_outcome(console: Console, outcome: Outcome) -> None:
    """Print the verdict in one line, then the sentences that explain it."""
    word, look = _WORDS[outcome.passed]
    console.print(Text.assemble((word, look), f"  {outcome.headline}"))
    for line in outcome.lines:
        console.print(Text(f"  {line}"))


def print_crossval(console: Console, schemes: Sequence[Scheme]) -> None:
    """Print the spread of every measure over the folds, one table per scheme."""
    for scheme in schemes:
        table = _table(f"{scheme.name}, {len(scheme.folds)} folds")
        table.add_column("measure", overflow="fold")
        spread = summary(scheme)
        for head in (*spread, "limit"):
            table.add_column(head, justify="right", no_wrap=True)
        for column, measure in enumerate(scheme.measures):
            values = [number(part[column]) for part in spread.values()]
            label = f"{measure.label} [{measure.unit}]" if measure.unit else measure.label
            table.add_row(Text(label), *values, number(measure.limit))
        console.print(table)


def _table(title: str) -> Table:
    # A Text title: a log name in square brackets must not be read as markup.
    return Table(
        title=Text(title, style="bold", overflow="fold"),
        title_justify="left",
        box=None,
        pad_edge=False,
    )
