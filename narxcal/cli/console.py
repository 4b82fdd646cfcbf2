"""What a command shows: tables and lines on stdout, progress and warnings on stderr."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import rich.console
from rich.console import ConsoleOptions, RenderableType
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    ProgressColumn,
    Task,
    TextColumn,
    TimeRemainingColumn,
)
from rich.progress import Progress as Bar
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from narxcal.support.errors import ConfigError, printable
from narxcal.support.files import STDOUT, to_json
from narxcal.support.progress import Progress, silent

WIDTH = 80
_RATE_OVER_S = 600.0  # a batch of a fleet takes minutes


@dataclass(frozen=True)
class Console:
    """Shows all (default), errors and warnings only (`quiet`), or one JSON document (`json`)."""

    json: bool = False
    quiet: bool = False

    @property
    def silent(self) -> bool:
        return self.json or self.quiet

    def for_output(self, out: Path) -> Console:
        """Console that leaves stdout to the output itself where `out` is `-`.

        Raises `ConfigError` where one JSON document is wanted there, too.
        """
        if out != STDOUT:
            return self
        if self.json:
            raise ConfigError("--json and --out - both print to stdout", hint="Leave one out")
        return replace(self, quiet=True)

    def say(self, text: str) -> None:
        if not self.silent:
            sys.stdout.write(f"{printable(text)}\n")

    def warn(self, text: str) -> None:
        """Print a warning to stderr, whatever the options: the result depends on it."""
        sys.stderr.write(f"narxcal: warning: {printable(text)}\n")

    def table(self, title: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Print a table of at most 80 columns; all but the first column are aligned right."""
        if self.silent:
            return
        self.page.print(Text(title, style="bold"))
        table = Table(box=None, pad_edge=False)
        for number, name in enumerate(head):
            table.add_column(name, justify="right" if number else "left", overflow="fold")
        for row in rows:
            table.add_row(*row)
        self.page.print(table)

    def facts(self, facts: Mapping[str, str]) -> None:
        """Print name and value pairs, aligned."""
        if self.silent:
            return
        table = Table(box=None, pad_edge=False, show_header=False)
        table.add_column(style="bold", no_wrap=True)
        table.add_column(overflow="fold")
        for name, value in facts.items():
            table.add_row(name, value)
        self.page.print(table)

    def document(self, document: Mapping[str, Any]) -> None:
        if self.json:
            sys.stdout.write(to_json(document))

    def finish(self, document: Mapping[str, Any], place: str, warnings: Iterable[str] = ()) -> None:
        """End a command: its warnings, where its results are, and the JSON document."""
        for text in warnings:
            self.warn(text)
        self.say(place)
        self.document(document)

    @contextmanager
    def progress(self, what: str) -> Iterator[Progress]:
        """Show a bar on stderr while the block runs, if a person is watching."""
        if self.silent or not sys.stderr.isatty():
            yield silent
            return
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            _Rate(),
            TimeRemainingColumn(),
        )
        shown = _Plain(stderr=True)
        period_s = _RATE_OVER_S
        with Bar(*columns, console=shown, transient=True, speed_estimate_period=period_s) as bar:
            task = bar.add_task(what, total=None)

            def advance(done: int, total: int, note: str = "") -> None:
                words = f"{what} ({note})" if note else what
                bar.update(task, completed=done, total=total, description=words)

            yield advance

    @property
    def page(self) -> rich.console.Console:
        """Where `eval.terminal` prints: stdout, 80 columns at most, or nothing at all."""
        found = _Stdout(highlight=False, markup=False, quiet=self.silent)
        found.width = min(WIDTH, found.width)
        return found


class _Rate(ProgressColumn):
    """Steps per second, or seconds per step."""

    def render(self, task: Task) -> Text:
        speed = task.finished_speed or task.speed
        if not speed:
            return Text("")
        return Text(f"{speed:.3g}/s" if speed >= 1.0 else f"{1.0 / speed:.3g} s each")


class _Plain(rich.console.Console):
    """A console whose texts command no terminal; its own styles are added behind them."""

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterator[Segment]:
        for found in super().render(renderable, options):
            yield found if found.control else found._replace(text=printable(found.text))


class _Stdout(_Plain):
    def on_broken_pipe(self) -> None:
        """Leave the end to the entry: rich would exit with 1, which means a missed tolerance."""
        raise BrokenPipeError
