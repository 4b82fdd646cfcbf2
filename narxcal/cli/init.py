"""`narxcal init`: a configuration drafted from logs, each line with its evidence, and a plot.

What the logs do not settle is written as `"?"`, which no command runs with.
"""

from __future__ import annotations

import glob
import io
import os
import tomllib
from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from data_prep.derive import DeriveConfig, WeightOnWheels, derive
from data_prep.drafting.draft import Draft, draft
from data_prep.equilibrium import BELOW_IDLE, in_equilibrium
from data_prep.log import Log
from data_prep.prepare import crowded
from data_prep.ranking import other_driver
from data_prep.reading import read_logs
from eval.report.figures import recorded_figure
from eval.report.style import without_math
from narxcal.atmosphere import cas_of_mach
from narxcal.channels import CHANNELS, SPOOLS, described
from narxcal.cli.console import Console
from narxcal.cli.options import add_out_file, path
from narxcal.cli.results import check_pair
from narxcal.support.errors import NarxcalError
from narxcal.support.files import atomic_write_bytes, atomic_write_text
from narxcal.support.settings import OPEN, in_toml
from training.config import SCHEMA, RunConfig

_MOST_READ = 3  # files that are read as a whole
_AIR = ("ALT_ft", "Mach", "dT_C")
_OUTPUTS = ("N1_pct", "N2_pct", "EGT_C")
_SPEEDS = ("%", "rpm")  # units of a response that is fast and smooth
_BELOW = 0.9  # of the lowest idle: where the engine no longer counts as running
_IDLES_S = 10.0  # a speed that stands for so long
_IDLES_PCT = 1.0  # within so much
_MOST_UNKNOWN = 20  # columns that are named in one line
_TRAINED = 2.0 / 3.0  # of the files


def add_options(parser: ArgumentParser) -> None:
    parser.add_argument("logs", metavar="LOG", type=path, nargs="+", help="logs of one recorder")
    add_out_file(parser, "FILE.toml", "and FILE.png next to it")


def run(options: Namespace, console: Console) -> int:
    """Write the configuration and the plot; returns 0 whether anything is open or not."""
    out: Path = options.out
    plot = check_pair(options, "a configuration", (".toml", ".png"), *options.logs)
    with console.progress("Reading the logs"):
        columns = draft(options.logs)
        logs, trouble = _read(options.logs[:_MOST_READ], columns)
    found = _Text(columns, logs, options.logs, out.resolve().parent, trouble)
    text = found.text()
    asked = [line for line in text.splitlines() if OPEN in line.partition("#")[0]]
    if not asked:
        RunConfig.parse(tomllib.loads(text), out)
    if logs:  # the plot first, which takes the most of a disk
        picture, figure = io.BytesIO(), recorded_figure(logs[0])
        without_math(figure)
        figure.savefig(picture, format="png", dpi=110)
        atomic_write_bytes(plot, picture.getvalue())
    atomic_write_text(out, text)
    for line in asked:
        console.say(f"To be filled in: {line}")
    if found.lacking and columns.unknown:
        console.say(f"No column is known as {', '.join(found.lacking)}. Not known: {found.unknown}")
    then = "fill these in, then " if asked else ""
    drawn = f"plot: {plot}" if logs else f"no plot ({trouble})"
    console.say(f"Configuration: {out}, {drawn}. Next: {then}narxcal train {out} --out RUN")
    console.document({"schema": "narxcal.init/1", "out": str(out), "open": asked})
    return 0


def _read(files: Sequence[Path], columns: Draft) -> tuple[list[Log], str]:
    """Return the logs that can be read so far, and why there are no others."""
    if any(line.keys.get("column") == OPEN for line in columns.lines):
        return [], "the column of time is open"
    try:
        return read_logs(files, columns.logs()), ""
    except NarxcalError as error:
        return [], " ".join(str(error).split())


@dataclass(frozen=True)
class _Text:
    """The text of a configuration, table by table."""

    columns: Draft
    logs: Sequence[Log]
    files: Sequence[Path]
    base: Path
    trouble: str

    def text(self) -> str:
        driver, why = self._driver
        air = [name for name in _AIR if name in self._there]
        outputs = self._outputs
        lacking = ", ".join(name for name in self.lacking if name in _AIR)
        without = f"  # no column is known as {lacking}: the model knows none" if lacking else ""
        response = next((name for name in outputs if described(name).unit in _SPEEDS), outputs[0])
        parts = [
            f'schema = "{SCHEMA}"\nname = {in_toml(self.files[0].stem.partition(".")[0])}\n',
            self._logs(),
            self._running(),
            f"[events]\ndriver = {in_toml(driver)}  # {why}\nresponse = {in_toml([response])}\n",
            f"[steady_state]\ninputs = {in_toml([driver, *air])}{without}\n",
            f"[narx]\noutputs = {in_toml(outputs)}\n",
            self._split(),
        ]
        return "\n".join(parts)

    @cached_property
    def _there(self) -> set[str]:
        """Channels that were recorded; where no log could be read, those of the columns."""
        if not self.logs:
            names = {line.channel for line in self.columns.lines} - {"time_s"}
            return names | {*derive({name: np.zeros(1) for name in names}, DeriveConfig(), "")}
        return {name for log in self.logs for name in log.channels if log.recorded([name])}

    @property
    def lacking(self) -> list[str]:
        """Lever and air data of which there is no channel: the model knows none."""
        return [name for name in ("TRA_deg", *_AIR) if name not in self._there]

    @cached_property
    def _outputs(self) -> list[str]:
        """Speeds and temperature; without any, what else is measured of an engine."""
        left = self._there - {self._driver[0]}
        found = [name for name in _OUTPUTS if name in left]
        other = [name for name in left & {*CHANNELS} if CHANNELS[name].role == "output"]
        own = [line.channel for line in self.columns.others]
        states = [name for name in own if not name.endswith("_kPa")]
        return found or [*sorted(other), *(states or own)] or [OPEN]

    def _logs(self) -> str:
        folder = Path(os.path.commonpath([file.resolve().parent for file in self.files]))
        names = [str(file.resolve().relative_to(folder)) for file in self.files]
        lines = [
            "[logs]",
            f"folder = {in_toml(os.path.relpath(folder, self.base))}",
            f"files = {in_toml([glob.escape(name) for name in names])}",
            *(f"# {log.name}: {len(log)} samples, one every {log.dt_s:.4g} s" for log in self.logs),
            *([f"# could not be read yet: {self.trouble}"] if self.trouble else []),
            *(
                f'{key} = "{OPEN}"  # the file leaves it open; read as {in_toml(value)} here'
                for key, value in self.columns.assumed.items()
            ),
        ]
        if any(map(crowded, self.logs)):
            why = "rows share their time stamps: which columns tell engines apart? [] for none"
            lines.append(f'instances = ["{OPEN}"]  # {why}')
        if self.columns.engines:
            lines += ["", "[logs.engines]  # by the columns that differ in this alone"]
            lines += [f"{name} = {in_toml(mark)}" for name, mark in self.columns.engines.items()]
        lines += ["", "[logs.columns]", *map(str, self.columns.lines)]
        lines += [
            f"# not used: {in_toml(name)}, {why}" for name, why in self.columns.unused.items()
        ]
        if self.columns.unknown:
            lines.append(f"# not known, give one to a channel to use it: {self.unknown}")
        others = sorted(self.columns.others, key=lambda line: line.channel not in self._outputs)
        marks = ["" if line.channel in self._outputs else "# " for line in others]
        if "# " in marks:
            lines += [
                "# no built-in channels: to use one, take the # away here and below, and name it",
                "# in [narx] outputs or [steady_state] inputs",
            ]
        lines += [f"{mark}{line}" for mark, line in zip(marks, others, strict=True)]
        if others:
            what = "# the lowest and highest value that are possible"
            lines += ["", f"{marks[0]}[logs.channels]  {what}"]
        lines += [
            f'{mark}{line.channel} = {{ range = ["?", "?"] }}'
            for mark, line in zip(marks, others, strict=True)
        ]
        named = {line.channel for line in self.columns.lines}
        if "WOW" not in named and ("CAS_kt" in named or self._flies()):
            lines += [
                "",
                "[logs.derive]  # no switch: on the ground below 60 kt, in flight above 70",
                'WOW = { airspeed = "CAS_kt", below_kt = 60.0, hysteresis_kt = 10.0 }',
            ]
        return "\n".join(lines) + "\n"

    @property
    def unknown(self) -> str:
        """Columns whose name says nothing."""
        names = [in_toml(each) for each in self.columns.unknown[:_MOST_UNKNOWN]]
        more = len(self.columns.unknown) - len(names)
        return ", ".join([*names, *([f"and {more} more"] if more else [])])

    def _flies(self) -> bool:
        """Whether Mach and altitude show an aircraft in flight, not an engine on a bench."""
        logs = [log for log in self.logs if len(log.recorded(("Mach", "ALT_ft"))) == 2]
        rule = WeightOnWheels()
        flies_kt = rule.below_kt + rule.hysteresis_kt
        return any(np.nanmax(cas_of_mach(log["Mach"], log["ALT_ft"])) > flies_kt for log in logs)

    @cached_property
    def _driver(self) -> tuple[str, str]:
        there = self._there
        warned = [text for log in self.logs if (text := other_driver(log, "TRA_deg"))]
        if "TRA_deg" in there and 2 * len(warned) < max(len(self.logs), 1):
            return "TRA_deg", "the lever"
        if "FF_kgph" in there:
            why = warned[0].partition(":")[0] if warned else "there is no lever, fuel is the input"
            return "FF_kgph", why
        known = f"; one of {', '.join(sorted(there))}?" if there else ""
        return OPEN, f"neither a lever nor a fuel flow was found{known}"

    def _running(self) -> str:
        """Put the threshold below idle where engines start or stop; elsewhere none is needed."""
        above = {}
        lines = ["[running]"]
        for name in SPOOLS:
            started = [log for log in self.logs if _stops(log, name)]
            idle = min((_idle(log, name) for log in started), default=np.inf)
            if np.isfinite(idle):
                above[name] = round(max(BELOW_IDLE[name], _BELOW * idle), 1)
                lines.append(f"# {name} stands at {idle:.1f} % at the lowest: {_BELOW:g} of that")
        if not self.logs:
            return ""
        if not above:
            return "# [running]: no engine starts or stops in these logs\n"
        found = ", ".join(f"{name} = {value}" for name, value in above.items())
        return "\n".join([*lines, f"above = {{ {found} }}"]) + "\n"

    def _split(self) -> str:
        names = [glob.escape(file.name) + "*" for file in self.files]
        if len(names) == 1:
            return (
                '[split]\ntrain = ["*"]  # one recording: nothing is left to judge the model by\n'
            )
        trained = min(max(round(_TRAINED * len(names)), 1), len(names) - 1)
        why = f"the first {trained} of {len(names)} files, whole; the others judge the model"
        train, test = in_toml(names[:trained]), in_toml(names[trained:])
        return f"[split]  # {why}\ntrain = {train}\ntest = {test}\n"


def _stops(log: Log, name: str) -> bool:
    return bool(log.recorded([name]) and np.nanmin(log[name]) < BELOW_IDLE[name])


def _idle(log: Log, name: str) -> float:
    """Return the lowest speed [%] at which a running engine stands; inf where it never does."""
    size = 2 * round(0.5 * _IDLES_S / log.dt_s) + 1
    bands = {each: _IDLES_PCT for each in SPOOLS if log.recorded([each])}
    still = in_equilibrium(log, bands, size, longest_gap=size)
    for each in bands:  # a windmilling engine does not idle
        still &= log[each] > BELOW_IDLE[each]
    return float(np.min(log[name][still], initial=np.inf))
